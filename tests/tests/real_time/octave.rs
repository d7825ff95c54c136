//! A law in Octave, the tables of a study and of a recording read in Octave, and the golden values of Sugeno systems. Needs `octave-cli`, which `.ci/long` installs.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;
use skein_lab::record;
use skein_lab::shipped::TABLE_READER;

const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");

/// Runs a command line in this folder, and returns what it prints.
fn run(folder: &Path, program: &str, arguments: &[&str]) -> String {
    let output = Command::new(program).current_dir(folder).args(arguments).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{program} {arguments:?}: {stderr}");
    String::from_utf8(output.stdout).unwrap()
}

fn skein(folder: &Path, line: &str) -> String {
    run(folder, PROGRAM, &line.split_whitespace().collect::<Vec<_>>())
}

#[test]
#[ignore = "installs Octave: `.ci/long`"]
fn a_new_law_in_octave_flies_like_the_same_law_in_python() {
    let folder = tempfile::tempdir().unwrap();
    let fly = |language: &str| -> Value {
        skein(folder.path(), &format!("new law of-{language} --lang {language}"));
        skein(
            folder.path(),
            &format!("study of-{language}.toml --seeds 1..2 --set duration_s=130 --no-record --out {language}"),
        );
        serde_json::from_str(&fs::read_to_string(folder.path().join(language).join("metrics.json")).unwrap()).unwrap()
    };
    let [octave, python] = ["octave", "python"].map(fly);
    assert_eq!((octave["law_misses"].as_f64(), octave["collisions"].as_f64()), (Some(0.0), Some(0.0)));
    // Octave writes 15 digits of a number, Python all 17.
    for figure in ["at_altitude_s", "in_band_s", "even_10deg_s", "radial_rms_m", "min_separation_m", "energy_j"] {
        let (octave, python) = (octave[figure].as_f64().unwrap(), python[figure].as_f64().unwrap());
        println!("{figure}: Octave {octave}, Python {python}");
        assert!((octave - python).abs() <= 1e-4 * python.abs(), "{figure}: {octave} instead of {python}");
    }
}

#[test]
#[ignore = "installs Octave: `.ci/long`"]
fn octave_reads_a_study_and_a_recording() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    skein(
        path,
        "study hover --seeds 0..3 --sweep network.loss=0,0.3 --set swarm.vehicles=2 --set duration_s=30 --out study",
    );
    skein(path, "study hover --seeds 1..2 --set swarm.vehicles=2 --set duration_s=30 --out one");
    skein(path, "report one/run.mcap --csv --out pages");
    fs::write(path.join(TABLE_READER.name), TABLE_READER.text).unwrap();
    fs::write(path.join("quoted.csv"), "a,b.c,text\n1,,\"x, \"\"y\"\"\"\n2,3,z\n").unwrap();
    let script = "r = skein_table('study/runs.csv'); t = skein_table('pages/csv/run/trace.csv'); q = skein_table('quoted.csv'); \
                  printf('%s\\n', jsonencode(struct('seed', r.seed, 'loss', r.network_loss, 'even', r.even_10deg_s, 'steps', numel(t.t_s), \
                  'highest_m', max(-t.down_m), 'active', sum(strcmp(t.membership, 'Active')), 'quoted', q)));";
    let read: Value = serde_json::from_str(&run(path, "octave-cli", &["--quiet", "--eval", script])).unwrap();
    let seeds = [0, 1, 2, 0, 1, 2].map(Value::from);
    assert_eq!(
        (read["seed"].as_array().unwrap().as_slice(), &read["loss"]),
        (&seeds[..], &serde_json::json!([0, 0, 0, 0.3, 0.3, 0.3]))
    );
    assert!(
        read["even"].as_array().unwrap().iter().all(|even| even.is_null() || even.is_f64() || even.is_u64()),
        "{read}"
    );
    let recording = record::read(&path.join("one/run.mcap")).unwrap();
    let steps = || recording.tracks.iter().flat_map(|track| &track.steps);
    let highest_m = steps().map(|step| step.trace.position.altitude_m()).fold(f64::NEG_INFINITY, f64::max);
    assert_eq!(read["steps"].as_u64(), Some(steps().count() as u64));
    assert!((read["highest_m"].as_f64().unwrap() - highest_m).abs() < 1e-6, "{read}: {highest_m}");
    assert!(read["active"].as_u64().unwrap() > 100, "{read}");
    assert_eq!(read["quoted"], serde_json::json!({ "a": [1, 2], "b_c": [null, 3], "text": ["x, \"y\"", "z"] }));
}

#[test]
#[ignore = "installs Octave: `.ci/long`"]
fn a_new_study_for_matlab_flies_in_octave() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    skein(path, "new study my-loss --lang matlab");
    let script = fs::read_to_string(path.join("my_loss.m")).unwrap();
    assert!(script.contains("seeds = 20;") && script.contains("name = 'my-loss';"), "{script}");
    fs::write(path.join("my_loss.m"), script.replace("seeds = 20;", "seeds = 2;")).unwrap();
    // The script calls the program as a user does, by its name.
    let programs = path.join("programs");
    fs::create_dir(&programs).unwrap();
    std::os::unix::fs::symlink(PROGRAM, programs.join("skein")).unwrap();
    let search = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    let printed = run(path, "env", &[&format!("PATH={search}"), "octave-cli", "--quiet", "my_loss.m"]);
    let lines: Vec<&str> = printed.lines().filter(|line| line.starts_with("loss 0.")).collect();
    assert_eq!(lines.len(), 3, "{printed}");
    assert!(lines.iter().all(|line| line.contains("(median of 2)") && line.ends_with("collisions 0")), "{printed}");
}

#[test]
#[ignore = "installs Octave with its fuzzy-logic-toolkit: `.ci/long`"]
fn the_golden_values_of_sugeno_systems_are_those_of_octave() {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR"));
    let script = tests.join("src/sugeno.m");
    let values = run(&tests.join("golden/sugeno"), "octave-cli", &["--quiet", script.to_str().unwrap()]);
    let golden = fs::read_to_string(tests.join("golden/sugeno.csv")).unwrap();
    let rows = |text: &str| -> Vec<(String, f64)> {
        let row = |row: &str| row.rsplit_once(',').map(|(inputs, value)| (inputs.to_owned(), value.parse().unwrap()));
        text.lines().skip(1).filter_map(row).collect()
    };
    let (values, golden) = (rows(&values), rows(&golden));
    assert_eq!(values.len(), golden.len());
    for ((inputs, value), (golden_inputs, golden_value)) in values.iter().zip(&golden) {
        assert_eq!(inputs, golden_inputs);
        // Another C library may round differently.
        assert!((value - golden_value).abs() < 1e-12, "{inputs}: {value}, golden {golden_value}");
    }
}
