//! `skein fly` with a fleet: teams that share this PC and the air.
#![cfg(unix)]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]
#![expect(clippy::unwrap_used, reason = "what a test cannot do has failed")]

use std::fs;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;

const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");
/// Timeout for the start and the end of a small fleet.
const SOON: Duration = Duration::from_secs(60);

/// Two teams of two, low and close to the ground, whose rings change places.
const CROSSING: &str = r#"
name = "crossing-fleet"
[fleet]
teams = 2
pattern = "line"
spacing_m = 150
[swarm]
vehicles = 2
[formation]
radius_m = 30
altitude_m = 5
[start]
square_m = 40
[[team]]
ids = [1]
mission.steps = [{ centre_ne_m = [0, 0], dwell_s = 0.5 }, { centre_ne_m = [0, 150] }]
[[team]]
ids = [2]
mission.steps = [{ centre_ne_m = [0, 0], dwell_s = 0.5 }, { centre_ne_m = [0, -150] }]
"#;

struct Fleet {
    folder: TempDir,
    name: &'static str,
}

impl Fleet {
    fn new(name: &'static str, text: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("fleet.toml"), text).unwrap();
        Self { folder, name }
    }

    fn command(&self) -> Command {
        let mut command = Command::new(PROGRAM);
        command.env("XDG_RUNTIME_DIR", self.folder.path().join("runtime")).env_remove("RUST_LOG");
        command.current_dir(self.folder.path());
        command
    }

    fn fly(&self, duration_s: u32) -> Child {
        let mut command = self.command();
        command.args(["fly", "fleet.toml", "--out", "out", "--json", "--duration"]).arg(duration_s.to_string());
        command.arg("--set").arg(format!("swarm.name={}", self.name));
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    }

    fn order(&self, arguments: &[&str]) -> (bool, String) {
        let output = self.command().arg("order").args(arguments).output().unwrap();
        let text = [output.stdout, output.stderr].concat();
        (output.status.success(), String::from_utf8(text).unwrap())
    }
}

/// Repeats an order until it has succeeded. While the agents begin, an order may take effect after its command has given up: then
/// the next one changes nothing.
fn until_accepted(fleet: &Fleet, arguments: &[&str]) -> String {
    let deadline = Instant::now() + SOON;
    loop {
        let (good, text) = fleet.order(arguments);
        if good || text.contains("held at step 0, as before") {
            return text;
        }
        assert!(Instant::now() < deadline, "{text}");
        sleep(Duration::from_millis(500));
    }
}

#[test]
fn two_teams_fly_through_each_other_and_land() {
    let fleet = Fleet::new("fleet-crossing", CROSSING);
    let output = fleet.fly(35).wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["across_collisions"], 0.0, "{report}");
    assert!(report["across_separation_m"].as_f64().unwrap() > 2.0, "{report}");
    assert_eq!((&report["teams"], &report["vehicles"], &report["target"]), (&2.0.into(), &4.into(), &"fly".into()));
    let teams = fs::read_to_string(fleet.folder.path().join("out/teams.csv")).unwrap();
    let first_cells: Vec<_> = teams.lines().map(|line| line.split(',').next().unwrap()).collect();
    assert_eq!(first_cells, ["team", "1", "2"]);
    for team in ["team-1", "team-2"] {
        assert!(fleet.folder.path().join("out").join(team).join("run.mcap").exists());
    }
    assert!(stderr.contains("team 1: ") && stderr.contains("2 of 2 landed"), "{stderr}");
    assert!(!stderr.contains("lost"), "{stderr}");
}

#[test]
fn an_order_reaches_one_team_or_all_of_them() {
    let fleet = Fleet::new("fleet-orders", &CROSSING.replace("spacing_m = 150", "spacing_m = 9000"));
    let child = fleet.fly(300);
    let held = until_accepted(&fleet, &["hold", "--teams", "2"]);
    let is_held = ["accepted by vehicle 1 to 2", "accepted by vehicle 1, 2", "held at step 0, as before"];
    assert!(is_held.iter().any(|text| held.contains(text)), "{held}");
    let (good, refused) = fleet.order(&["hold", "--teams", "3"]);
    assert!(!good && refused.contains("has teams 1 to 2, not 3"), "{refused}");
    let (good, landed) = fleet.order(&["land"]);
    assert!(good && landed.contains("team 1: land: accepted") && landed.contains("team 2: land: accepted"), "{landed}");
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    let hold: Vec<&str> = stderr.lines().filter(|line| line.contains("accept the order: hold")).collect();
    assert!(!hold.is_empty() && hold.iter().all(|line| line.starts_with("team 2: ")), "{stderr}");
}

#[test]
fn a_fleet_of_more_than_64_agents_is_refused() {
    let fleet = Fleet::new("fleet-large", "fleet.teams = 9\nswarm.vehicles = 8\n");
    let output = fleet.fly(10).wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("fleets larger than 64 agents fly in virtual time"), "{stderr}");
}
