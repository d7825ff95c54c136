//! A scenario that passes `check` can be flown and studied; one that `check` refuses is refused by `fly` and `study`
//! with the same message.

use std::fs;
use std::net::UdpSocket;
use std::path::{Path, PathBuf};

use clap::Parser;
use tempfile::TempDir;

use crate::check;
use crate::cli::{Cli, Command};
use crate::fly;
use skein_lab::error::Error;
use skein_lab::study;

/// The report of each command about a scenario file. Nothing is started.
struct Verdicts {
    check: Result<(), Error>,
    fly: Result<(), Error>,
    study: Result<study::plan::Plan, Error>,
}

impl Verdicts {
    fn of(scenario: &Path, more: &[&str], out: &Path) -> Self {
        let parse = |verb: &str, out: &[&str]| {
            let line = ["skein", verb, scenario.to_str().unwrap()].into_iter().chain(more.iter().copied());
            Cli::try_parse_from(line.chain(out.iter().copied())).unwrap().command
        };
        let [fly_out, study_out] = ["fly", "study"].map(|name| out.join(name));
        let (Command::Check(check), Command::Fly(fly), Command::Study(study)) = (
            parse("check", &[]),
            parse("fly", &["--out", fly_out.to_str().unwrap()]),
            parse("study", &["--no-record", "--out", study_out.to_str().unwrap()]),
        ) else {
            panic!("three commands")
        };
        let loaded = check.scenario.read(Vec::new());
        Self {
            check: loaded.and_then(|loaded| check::verdict(&check, &loaded).map(drop)),
            fly: fly::plan::Plans::new(&fly).map(drop),
            study: study::plan::Plan::new(&study),
        }
    }

    /// Asserts that all three commands refuse with the same message, and returns it.
    fn refused(self, scenario: &Path) -> String {
        let why = |verdict: Result<(), Error>| match verdict {
            Ok(()) => format!("{} is not refused", scenario.display()),
            Err(error) => format!("{error} [{}]", error.exit_code()),
        };
        let [check, fly, study] = [self.check, self.fly, self.study.map(drop)].map(why);
        assert_eq!((&fly, &study), (&check, &check));
        check
    }
}

fn shipped() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios");
    let files = [root.clone(), root.join("paper")].into_iter().flat_map(|folder| fs::read_dir(folder).unwrap());
    let mut files: Vec<_> = files.map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|ending| ending == "toml"));
    files.sort();
    files
}

fn is_fleet(path: &Path) -> bool {
    fs::read_to_string(path).unwrap().contains("\n[fleet]\n")
}

#[test]
fn every_shipped_fleet_can_be_studied_and_is_too_large_to_fly_live() {
    for fleet in shipped().into_iter().filter(|path| is_fleet(path)) {
        let out = tempfile::tempdir().unwrap();
        let Verdicts { fly, study, .. } = Verdicts::of(&fleet, &[], out.path());
        assert!(study.unwrap_or_else(|error| panic!("study: {error}")).is_fleet);
        let why = fly.map_err(|error| error.to_string());
        assert!(why.as_ref().is_err_and(|why| why.contains("64 agents")), "{}: {why:?}", fleet.display());
    }
}

#[test]
fn every_shipped_scenario_passes_and_flies() {
    let all = shipped();
    assert!(all.len() >= 9, "{all:?}");
    for scenario in all.into_iter().filter(|path| !is_fleet(path)) {
        let out = tempfile::tempdir().unwrap();
        let Verdicts { check, fly, study } = Verdicts::of(&scenario, &["--set", "duration_s=3"], out.path());
        check.unwrap_or_else(|error| panic!("check: {error}"));
        fly.unwrap_or_else(|error| panic!("fly: {error}"));
        let study = study.unwrap_or_else(|error| panic!("study: {error}"));
        let (first, seed) = (study.run(0).study().unwrap().0, study.run(0).seed);
        first.fly(seed).unwrap_or_else(|error| panic!("{}: {error}", scenario.display()));
    }
}

/// A folder with every kind of file that a scenario can name, most of them broken.
fn workshop() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    };
    let xcell = skein_core::aircraft::Aircraft::SHIPPED[0].1;
    write("good.toml", xcell);
    write("winged.toml", &xcell.replacen("[trim]", "[trim]\nwings = 2", 1));
    write("weightless.toml", &xcell.replacen("mass_kg = 8.2", "mass_kg = -8.2", 1));
    write("empty.toml", "");
    write("torn.toml", "[trim\n");
    let trim = xcell.split_once("[trim]").unwrap().1;
    write("foreign.toml", &format!("[trim]{}", trim.split_once("\n[").map_or(trim, |(trim, _)| trim)));
    for axis in ["roll", "pitch", "heading", "collective"] {
        write(&format!("rules/{axis}.fis"), "[System]\n");
    }
    let shipped = [
        ("roll", include_str!("../../controllers/roll.fis")),
        ("pitch", include_str!("../../controllers/pitch.fis")),
        ("heading", include_str!("../../controllers/heading.fis")),
        ("collective", include_str!("../../controllers/collective.fis")),
    ];
    for (axis, text) in shipped {
        // The rule base of the heading instead of that of the collective, and one that hardly turns.
        write(&format!("mixed/{axis}.fis"), if axis == "collective" { shipped[2].1 } else { text });
        let is_weak = |line: &str| axis == "heading" && line.contains("'constant'");
        let weak = |line: &str| if is_weak(line) { line.replace(']', "e-3]") } else { line.to_owned() };
        write(&format!("weak/{axis}.fis"), &text.lines().map(weak).collect::<Vec<_>>().join("\n"));
    }
    folder
}

#[test]
#[cfg(unix)]
fn a_broken_scenario_is_refused_by_all_commands_with_the_same_message() {
    let taken = UdpSocket::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let udp = format!(
        "[formation]\nlaw = 'external'\nexternal.udp = {{ ask = '127.0.0.1:5700', answer = '127.0.0.1:{}' }}",
        port - 1
    );
    let law = |external: &str| format!("[formation]\nlaw = 'external'\nexternal.{external}");
    let (missing, no_program) = (law("command = ['sh', 'missing.sh']"), law("command = ['no-such-program-7']"));
    let (fails, no_law) = (law("command = ['sh', '-c', 'exit 3']"), law("command = ['echo', 'hello']"));
    let (no_file, no_port) = (law("command = ['./missing']"), law("listen = 'tcp/127.0.0.1'"));
    let broken: [(&str, &str); 28] = [
        ("[formation]\nraduis_m = 80", "unknown key"),
        ("[formation", "3:11: not TOML"),
        ("swarm.vehicles = 0", "3:1"),
        ("preset = 'papper'", "one of"),
        ("duration_s = -1", "out of its range"),
        ("[formation]\nradius_m = 10\ninner_width_m = 20", "has to be below"),
        ("[vehicle.9]\nheading_deg = 1", "vehicle 9 is not in the swarm"),
        ("[start]\nsquare_m = 1", "do not fit"),
        ("[start]\npattern = 'as_is'", "X-Plane"),
        ("[network]\nstate_json_hz = 1", "was removed"),
        ("[network]\ngraph = 'edges'", "needs"),
        ("swarm.aircraft = 'r 22'", "with or without"),
        ("swarm.aircraft = 'nowhere'", "no aircraft \"nowhere\""),
        ("[vehicle.2]\naircraft = 'winged'", "winged.toml:98:1: unknown key `trim.wings`"),
        ("[vehicle.2]\naircraft = 'weightless.toml'", "weightless.toml:11:11: `helicopter.mass_kg` is -8.2"),
        ("[vehicle.1]\naircraft = 'empty.toml'", "empty.toml:1:1: `trim` is missing"),
        ("[vehicle.1]\naircraft = 'torn'", "torn.toml:1:"),
        ("[vehicle.1]\naircraft = 'foreign'", "only X-Plane can fly"),
        ("[control]\nrules = 'nowhere'", "roll.fis"),
        ("[control]\nrules = 'rules'", "roll.fis"),
        ("[control]\nrules = 'mixed'", "collective.fis:15:6: by its inputs this is the rule base of heading"),
        ("[control]\nrules = 'weak'", "with these rules does not hold: heading error"),
        (&missing, "the law of vehicle 1 has ended"),
        (&no_program, "not found"),
        (&fails, "exit status: 3"),
        (&no_law, "the law of vehicle 1 has ended"),
        (&no_file, "not found"),
        (&no_port, "has to be tcp/HOST:PORT"),
    ];
    for (nth, (lines, why)) in broken.into_iter().chain([(udp.as_str(), "in use")]).enumerate() {
        let folder = workshop();
        let scenario = folder.path().join("broken.toml");
        let head = if lines.contains("swarm.vehicles") { "" } else { "swarm.vehicles = 2" };
        fs::write(&scenario, format!("name = 'broken'\n{head}\n{lines}\n")).unwrap();
        let refused = Verdicts::of(&scenario, &[], folder.path()).refused(&scenario);
        assert!(refused.contains(why) && refused.ends_with("[2]"), "{nth}: {lines}\n{refused}");
        assert!(!folder.path().join("study").exists(), "{nth}: nothing was written");
    }
    drop(taken);
}

#[test]
fn a_valid_scenario_in_the_same_folder_passes() {
    for lines in ["", "[vehicle.2]\naircraft = 'good'", "swarm.aircraft = 'good.toml'"] {
        let folder = workshop();
        let scenario = folder.path().join("whole.toml");
        fs::write(&scenario, format!("swarm.vehicles = 2\n{lines}\n")).unwrap();
        let Verdicts { check, fly, study } = Verdicts::of(&scenario, &[], folder.path());
        assert!(check.is_ok() && fly.is_ok() && study.is_ok(), "{lines}: {check:?} {fly:?}");
    }
}

#[test]
fn a_scenario_for_a_study_alone_is_checked_for_a_study() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = folder.path().join("central.toml");
    fs::write(&scenario, "swarm.vehicles = 2\ncontrol.mode = 'central'\n").unwrap();
    let Verdicts { check, fly, study } = Verdicts::of(&scenario, &[], folder.path());
    assert!(check.is_ok() && study.is_ok());
    let refused = fly.unwrap_err().to_string();
    assert!(refused.ends_with("central.toml: control.mode = \"central\" is flown only in a study"), "{refused}");
}

#[test]
fn x_planes_that_do_not_answer_prevent_a_flight_but_not_a_study() {
    let silent = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = silent.local_addr().unwrap().to_string();
    let folder = tempfile::tempdir().unwrap();
    let scenario = folder.path().join("lab.toml");
    let text = format!("[swarm]\nvehicles = 1\nplant = 'xplane'\n[vehicle.1]\nxplane = '{address}'\n");
    fs::write(&scenario, text).unwrap();
    let Verdicts { check, fly, study } = Verdicts::of(&scenario, &[], folder.path());
    let (check, fly) = (check.unwrap_err(), fly.unwrap_err());
    assert_eq!(check.to_string(), fly.to_string());
    assert!(check.to_string().starts_with(&format!("{address}: no answer within 2 s; is X-Plane running")), "{check}");
    assert!(study.is_ok());
}
