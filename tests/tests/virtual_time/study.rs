//! `skein study` and `skein compare` as a user runs them: files, interruptions, exit statuses.
#![cfg(unix)]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use serde_json::Value;
use skein_lab::metrics::WALL_CLOCK_KEYS;
use tempfile::TempDir;

const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");

/// Runs the program in a folder.
fn skein(folder: &Path, line: &str) -> Output {
    Command::new(PROGRAM).current_dir(folder).args(line.split_whitespace()).output().unwrap()
}

/// Runs the program, checks that it succeeds, and returns its stdout and stderr.
fn succeed(folder: &Path, line: &str) -> (String, String) {
    let output = skein(folder, line);
    let [stdout, stderr] = [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text).into_owned());
    assert!(output.status.success(), "{line}: {stderr}");
    (stdout, stderr)
}

/// Runs the program and checks its exit status and a part of its stderr.
fn fail(folder: &Path, line: &str, status: i32, why: &str) {
    let output = skein(folder, line);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(status), "{line}: {stderr}");
    assert!(stderr.contains(why), "{line}: {stderr}");
}

/// Every file below a folder, without the figures that depend on the wall clock, and without the file by which a command claims
/// the folder.
fn files(folder: &Path) -> BTreeMap<PathBuf, String> {
    let mut files = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            if path.ends_with(".skein-lock") {
                assert_eq!(fs::metadata(&path).unwrap().len(), 0, "no command writes there any more");
                continue;
            }
            let text = String::from_utf8_lossy(&fs::read(&path).unwrap()).into_owned();
            let text = match path.extension().and_then(|end| end.to_str()) {
                Some("json") => without_wall_clock(serde_json::from_str(&text).unwrap()).to_string(),
                Some("csv") => without_columns(&text),
                _ => text,
            };
            files.insert(path.strip_prefix(folder).unwrap().to_owned(), text);
        }
    }
    files
}

fn without_wall_clock(value: Value) -> Value {
    match value {
        Value::Object(keys) => {
            let keys = keys.into_iter().filter(|(key, _)| !WALL_CLOCK_KEYS.contains(&key.as_str()));
            Value::Object(keys.map(|(key, value)| (key, without_wall_clock(value))).collect())
        }
        Value::Array(items) => Value::Array(items.into_iter().map(without_wall_clock).collect()),
        value => value,
    }
}

fn without_columns(csv: &str) -> String {
    let names: Vec<&str> = csv.lines().next().unwrap().split(',').collect();
    let cells = |line: &str| {
        let kept = line.split(',').zip(&names).filter(|(_, name)| !WALL_CLOCK_KEYS.contains(name));
        kept.map(|(cell, _)| cell.to_owned()).collect::<Vec<_>>().join(",")
    };
    csv.lines().map(cells).collect::<Vec<_>>().join("\n")
}

/// A short study of a small swarm.
const SMALL: &str = "study --no-record --set swarm.vehicles=3 --set duration_s=12";

#[test]
fn a_study_gives_the_same_bytes_with_one_job_and_with_two() {
    let folder = tempfile::tempdir().unwrap();
    let study = format!("{SMALL} --seeds 3..6 --sweep network.loss=0,0.3 --sweep network.delay_s=0..1 --points 2");
    for (out, jobs) in [("one", 1), ("again", 1), ("two", 2)] {
        succeed(folder.path(), &format!("{study} --out {out} --jobs {jobs}"));
    }
    let [one, again, two] = ["one", "again", "two"].map(|out| files(&folder.path().join(out)));
    assert_eq!(one, again);
    assert_eq!(one, two);
    // Four points, three seeds, two files each; and study.json, runs.csv, summary.json.
    assert_eq!(one.len(), 4 * 3 * 2 + 3, "{:?}", one.keys());
    assert!(one.contains_key(Path::new("point-4/seed-5/metrics.json")));
    let csv = &one[Path::new("runs.csv")];
    assert!(csv.starts_with("seed,network.loss,network.delay_s,") && csv.lines().count() == 13, "{csv}");
    let summary: Value = serde_json::from_str(&one[Path::new("summary.json")]).unwrap();
    let points = summary.as_array().unwrap();
    let losses: Vec<_> = points.iter().map(|point| point["set"]["network.loss"].as_f64().unwrap()).collect();
    assert_eq!(losses, [0.0, 0.0, 0.3, 0.3]);
    assert!(points.iter().all(|point| point["figures"]["at_altitude_s"]["n"] == 3), "{summary}");
    assert!(points.iter().all(|point| (3..6).contains(&point["worst_seed"].as_u64().unwrap())));
}

#[test]
fn a_study_of_a_fleet_gives_the_same_bytes_with_one_job_and_with_two() {
    let folder = tempfile::tempdir().unwrap();
    let fleet = "duration_s = 30\nfleet = { teams = 3, pattern = 'line', spacing_m = 300 }\nswarm.vehicles = 3\nnetwork.loss = 0.2\n";
    fs::write(folder.path().join("fleet.toml"), fleet).unwrap();
    let [one, two] = ["1", "2"].map(|jobs| {
        succeed(folder.path(), &format!("study fleet.toml --seeds 0..2 --jobs {jobs} --out jobs-{jobs}"));
        files(&folder.path().join(format!("jobs-{jobs}")))
    });
    assert_eq!(one.keys().collect::<Vec<_>>(), two.keys().collect::<Vec<_>>());
    one.iter().for_each(|(name, text)| assert!(two[name] == *text, "{} differs", name.display()));
    assert!(one[Path::new("seed-1/fleet.mcap")].len() > 10_000 && one.contains_key(Path::new("seed-0/teams.csv")));
}

#[test]
fn a_killed_study_resumes_and_gives_the_same_files() {
    let folder = tempfile::tempdir().unwrap();
    let runs = 60;
    let study = format!(
        "study --no-record --set swarm.vehicles=4 --set duration_s=60 --seeds 0..{} --sweep network.loss=0,0.2",
        runs / 2
    );
    succeed(folder.path(), &format!("{study} --out whole"));
    let whole = files(&folder.path().join("whole"));

    let killed = folder.path().join("killed");
    let done = || {
        let folders = ["point-1", "point-2"].into_iter().filter_map(|point| fs::read_dir(killed.join(point)).ok());
        folders.flatten().filter(|entry| entry.as_ref().unwrap().path().join("metrics.json").exists()).count()
    };
    let line = format!("{study} --out killed --jobs 1");
    let mut child = Command::new(PROGRAM)
        .current_dir(folder.path())
        .args(line.split_whitespace())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    for least in [3, 12] {
        while done() < least {
            assert_eq!(child.try_wait().unwrap(), None, "over after {} runs", done());
            std::thread::sleep(Duration::from_millis(2));
        }
        child.kill().unwrap();
        child.wait().unwrap();
        let there = done();
        assert!((least..runs).contains(&there), "{there} runs at the kill");
        if least == 3 {
            // An incomplete run does not count as a run, and a file that was being written is not left behind.
            for (name, text) in [("metrics.json", "{\"seed\": 0,"), ("metrics.json.7.draft", "{")] {
                fs::write(killed.join("point-1/seed-0").join(name), text).unwrap();
            }
            child = Command::new(PROGRAM)
                .current_dir(folder.path())
                .args(line.split_whitespace())
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .unwrap();
        }
    }
    let there = done();
    fail(
        folder.path(),
        &format!("{study} --out killed --set formation.radius_m=60"),
        2,
        "its scenario or a file that it names has changed",
    );
    fail(
        folder.path(),
        "study --no-record --set swarm.vehicles=4 --set duration_s=60 --seeds 0..9 --sweep network.loss=0,0.2 --out killed",
        2,
        "another study is there: its seeds is \"0..30\", not \"0..9\"; choose another folder",
    );
    let (_, stderr) = succeed(folder.path(), &format!("{study} --out killed --jobs 2"));
    assert!(stderr.contains(&format!("{there} of {runs} runs are there already")), "{stderr}");
    assert_eq!(files(&killed), whole);
    fail(folder.path(), &line, 2, "this study is there already, and finished");
}

#[test]
fn a_folder_into_which_a_study_writes_is_refused_until_its_process_has_ended() {
    let folder = tempfile::tempdir().unwrap();
    let study = "study --no-record --set duration_s=300 --seeds 0..2000 --out shared";
    let mut first = Command::new(PROGRAM);
    first.current_dir(folder.path()).args(study.split(' ')).stdout(Stdio::null()).stderr(Stdio::null());
    let mut first = first.spawn().unwrap();
    while !folder.path().join("shared/study.json").exists() {
        assert_eq!(first.try_wait().unwrap(), None);
        std::thread::sleep(Duration::from_millis(2));
    }
    fail(folder.path(), study, 2, &format!("process {} on ", first.id()));
    let flight = "fly --no-view --duration 1 --out shared";
    fail(folder.path(), flight, 2, "the folder already contains files");
    first.kill().unwrap();
    first.wait().unwrap();
    let mut second = Command::new(PROGRAM);
    second.current_dir(folder.path()).args(study.split(' ')).stdout(Stdio::null()).stderr(Stdio::piped());
    let mut second = second.spawn().unwrap();
    let mut line = String::new();
    std::io::BufRead::read_line(&mut std::io::BufReader::new(second.stderr.take().unwrap()), &mut line).unwrap();
    assert!(line.contains("of 2000 runs"), "it resumes: {line}");
    second.kill().unwrap();
    second.wait().unwrap();
}

#[test]
fn an_invalid_study_is_refused_before_any_run() {
    let folder = tempfile::tempdir().unwrap();
    for (sweep, why) in [
        ("--sweep network.loss=0,0.5,2", "point 3 (network.loss=2): --set network.loss=2: "),
        ("--sweep formation.raduis_m=1,2", "did you mean `formation.radius_m`?"),
        ("--sweep swarm.vehicles=4,200", "point 2 (swarm.vehicles=200): "),
        ("--sweep vehicle.1.aircraft=xcell60,zeppelin", "point 2 (vehicle.1.aircraft=zeppelin): "),
        ("--sweep network.loss=0..0.5", "a range needs --points N"),
        ("--sweep seed=1,2", "--seeds"),
        ("--points 4", "no --sweep has a range"),
        ("--sweep network.loss=0..0.5 --points 0", "at least 1"),
    ] {
        fail(folder.path(), &format!("study --out refused {sweep}"), 2, why);
        assert!(!folder.path().join("refused").exists(), "{sweep}");
    }
}

/// Two studies that differ in one key.
fn two_studies(folder: &TempDir, common: &str, a: &str, b: &str) {
    for (out, set) in [("a", a), ("b", b)] {
        succeed(folder.path(), &format!("{common} {set} --out {out}"));
    }
}

#[test]
fn a_comparison_reports_worse_figures_by_its_exit_status() {
    let folder = tempfile::tempdir().unwrap();
    two_studies(&folder, &format!("{SMALL} --seeds 0..8"), "--set network.loss=0", "--set network.loss=0.6");
    let (same, _) = succeed(folder.path(), "compare a a");
    assert!(same.contains("equal in every pair: at_altitude_s, "), "{same}");
    let worse =
        "connectivity, connected_share, disconnected_vehicles, min_cluster_vehicles, peer_age_p50_ms, peer_age_p99_ms";
    fail(folder.path(), "compare a b", 1, worse);
    succeed(folder.path(), "compare b a --only connectivity,peer_age_p99_ms");
    succeed(folder.path(), "compare a b --only collisions");

    let output = skein(folder.path(), "compare a b --json --only peer_age_p99_ms");
    assert_eq!(output.status.code(), Some(1));
    let compared: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(compared["differ"], serde_json::json!({ "network.loss": ["0", "0.6"] }));
    let figure = &compared["points"][0]["figures"][0];
    assert_eq!((&figure["pairs"], &figure["worse"], &figure["verdict"]), (&8.into(), &8.into(), &"worse".into()));
    assert_eq!(figure["effect"]["median"], -1.0);

    // The printed command repeats that run exactly.
    let replay = figure["replay"].as_str().unwrap();
    let seed = figure["worst_seed"].as_u64().unwrap();
    assert_eq!(replay, format!("skein study b/seed-{seed}/scenario.toml"));
    succeed(folder.path(), &format!("{} --out again", replay.strip_prefix("skein ").unwrap()));
    let [again, before] = ["again".to_owned(), format!("b/seed-{seed}")].map(|path| {
        let text = fs::read_to_string(folder.path().join(path).join("metrics.json")).unwrap();
        without_wall_clock(serde_json::from_str(&text).unwrap())
    });
    assert_eq!(again, before);

    fail(folder.path(), "compare a nowhere", 2, "nowhere: ");
    fail(folder.path(), "compare a b --only colisions", 2, "--only colisions: no figure that can be worse");
    fs::create_dir(folder.path().join("empty")).unwrap();
    fail(folder.path(), "compare a empty", 2, "empty: no runs in it");
}

#[test]
fn a_run_can_be_repeated_from_its_own_folder() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("mine")).unwrap();
    let aircraft = include_str!("../../../deploy/aircraft/xcell60.toml");
    fs::write(folder.path().join("mine/heavy.toml"), aircraft).unwrap();
    let scenario = "duration_s = 8\n[swarm]\nvehicles = 2\naircraft = \"heavy\"\n";
    fs::write(folder.path().join("mine/two.toml"), scenario).unwrap();
    succeed(folder.path(), "study mine/two.toml --no-record --seed 4 --out first");
    fs::remove_dir_all(folder.path().join("mine")).unwrap();
    succeed(folder.path(), "study first/scenario.toml --no-record --out second");
    let figures = |out: &str| files(&folder.path().join(out))[Path::new("metrics.json")].clone();
    assert_eq!(figures("first"), figures("second"));
}

#[test]
fn a_comparison_pairs_by_seed_and_by_swept_point() {
    let folder = tempfile::tempdir().unwrap();
    let sweep = "--sweep network.loss=0,0.4 --sweep formation.conversion=linear,nonlinear";
    two_studies(
        &folder,
        SMALL,
        &format!("--seeds 0..3 {sweep}"),
        &format!("--seeds 1..4 {sweep} --set formation.radius_m=60"),
    );
    let output = skein(folder.path(), "compare a b --json");
    let compared: Value = serde_json::from_slice(&output.stdout).unwrap();
    let points = compared["points"].as_array().unwrap();
    assert_eq!((points.len(), &compared["unpaired"]), (4, &serde_json::json!([4, 4])));
    assert_eq!(points[1]["set"], serde_json::json!(["network.loss=0", "formation.conversion=\"nonlinear\""]));
    assert!(points.iter().all(|point| point["pairs"] == 2));
    assert_eq!(compared["differ"], serde_json::json!({ "formation.radius_m": ["100", "60"] }));
    let (text, _) = succeed(folder.path(), "compare a b");
    assert!(text.contains("4 runs of A, 4 of B") && text.contains("unclear: a verdict needs six pairs"), "{text}");

    succeed(folder.path(), &format!("{SMALL} --seeds 1..3 --out plain"));
    fail(folder.path(), "compare a plain", 2, "differ in formation.conversion, which the other side does not vary");
    succeed(folder.path(), &format!("{SMALL} --seeds 7..9 --out others"));
    fail(folder.path(), "compare plain others", 2, "no run of one has a partner of equal seed");
    succeed(folder.path(), "compare plain a/point-1");
}

#[test]
fn a_study_and_flights_are_compared_without_a_verdict() {
    let folder = tempfile::tempdir().unwrap();
    succeed(folder.path(), &format!("{SMALL} --seeds 0..2 --out virtual"));
    // Files as a flight of the same scenario would leave them.
    succeed(folder.path(), &format!("{SMALL} --seeds 0..2 --set network.loss=0.3 --out real"));
    for seed in 0..2 {
        let path = folder.path().join(format!("real/seed-{seed}/metrics.json"));
        let text = fs::read_to_string(&path).unwrap();
        let text = text
            .replace("\"target\": \"study\"", "\"target\": \"fly\"")
            .replace("\"step_p50_us\": null", "\"step_p50_us\": 9.5");
        fs::write(&path, text).unwrap();
    }
    let (text, _) = succeed(folder.path(), "compare virtual real");
    assert!(text.contains("study builtin") && text.contains("fly builtin") && text.contains("max_tilt_deg"), "{text}");
    assert!(text.contains("only of fly builtin: step_p50_us") && !text.contains("verdict"), "{text}");
    let (json, _) = succeed(folder.path(), "compare virtual real --json --only peer_age_p50_ms");
    let divergence: Value = serde_json::from_str(&json).unwrap();
    let figure = &divergence["figures"][0];
    assert_eq!((&figure["key"], figure["each"].as_array().unwrap().len()), (&"peer_age_p50_ms".into(), 2));
    assert!(figure["difference"].as_f64().unwrap() > 0.0 && figure["relative"].as_f64().unwrap() > 0.0, "{figure}");
}
