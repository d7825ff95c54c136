//! `skein fly` with a fleet: teams that share this PC and the air.

mod shows;

use skein_tests::share::Share;
use std::collections::BTreeSet;
use std::fs;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use skein_common::id::TeamId;
use skein_lab::metrics::{TRAFFIC_FILE, read_traffic};
use skein_lab::record::{self, TeamPlaces};
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
recorded = true
mission.steps = [{ centre_ne_m = [0, 0], dwell_s = 0.5 }, { centre_ne_m = [0, 150] }]
[[team]]
ids = [2]
mission.steps = [{ centre_ne_m = [0, 0], dwell_s = 0.5 }, { centre_ne_m = [0, -150] }]
"#;

/// Teams 1 and 2 want the place between them at the same time. Teams 3 and 4 are 3.5 km apart: team 4 wants the place where
/// team 3 still is.
const SAME_PLACE: &str = r#"
name = "same-place"
[fleet]
teams = 4
pattern = "list"
places_ne_m = [[0, 0], [0, 200], [1000, 3500], [1000, 0]]
record_hz = 5
[swarm]
vehicles = 2
[formation]
radius_m = 20
inner_width_m = 10
outer_width_m = 10
altitude_m = 8
[start]
square_m = 40
[[team]]
ids = [1]
mission.steps = [{ centre_ne_m = [0, 0], dwell_s = 0.5 }, { centre_ne_m = [0, 100], dwell_s = 2 }, { centre_ne_m = [100, 100] }]
[[team]]
ids = [2]
mission.steps = [{ centre_ne_m = [0, 0], dwell_s = 0.5 }, { centre_ne_m = [0, -100], dwell_s = 2 }, { centre_ne_m = [-100, -100] }]
[[team]]
ids = [3]
mission.steps = [{ centre_ne_m = [0, 0], dwell_s = 12 }, { centre_ne_m = [150, 0] }]
[[team]]
ids = [4]
mission.steps = [{ centre_ne_m = [0, 0], dwell_s = 0.5 }, { centre_ne_m = [0, 3500] }]
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

    /// Makes the report of this folder or file, into the folder `page` in `out`.
    fn report(&self, of: &str) -> (bool, String) {
        let output = self.command().args(["report", of, "--out", "out/page"]).output().unwrap();
        (output.status.success(), String::from_utf8([output.stdout, output.stderr].concat()).unwrap())
    }

    fn record(&self, file: &str) -> Child {
        let mut command = self.command();
        command.args(["record", "--out", file]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
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

/// The last line of `fly --json`: the result with the figures.
fn last_line(stdout: &[u8]) -> Value {
    let result: Value =
        serde_json::from_slice(stdout.trim_ascii_end().rsplit(|byte| *byte == b'\n').next().unwrap()).unwrap();
    assert_eq!(result["kind"], "result");
    result
}

#[test]
fn two_teams_fly_through_each_other_and_land() {
    let _share = Share::of_flight(8);
    let fleet = Fleet::new("fleet-crossing", CROSSING);
    let output = fleet.fly(35).wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    let report = last_line(&output.stdout);
    assert_eq!(report["across_collisions"], 0.0, "{report}");
    assert!(report["across_separation_m"].as_f64().unwrap() > 2.0, "{report}");
    assert_eq!((&report["teams"], &report["vehicles"], &report["target"]), (&2.0.into(), &4.into(), &"fly".into()));
    let teams = fs::read_to_string(fleet.folder.path().join("out/teams.csv")).unwrap();
    let first_cells: Vec<_> = teams.lines().map(|line| line.split(',').next().unwrap()).collect();
    assert_eq!(first_cells, ["team", "1", "2"]);
    let out = fleet.folder.path().join("out");
    let is_recorded = |team: &str| out.join(team).join(record::FILE).exists();
    assert!(is_recorded("team-1") && !is_recorded("team-2"), "only team 1 is recorded in full");
    let places = record::read_fleet(&out.join(record::FLEET_FILE)).unwrap().places;
    for team in TeamId::first(2) {
        let its: Vec<_> = places.iter().filter(|places| places.team == team).collect();
        assert!(its.len() > 10 && its.iter().filter(|places| places.vehicles.len() == 2).count() > 10, "{its:?}");
        // None is early. One that a busy PC makes late is made up for.
        assert!(its.iter().enumerate().all(|(nth, places)| places.t_s >= nth as f64), "at most once a second: {its:?}");
        assert!(its.len() as f64 > its[its.len() - 1].t_s - 1.0, "once a second: {its:?}");
    }
    let traffic = read_traffic(&out.join(TRAFFIC_FILE)).unwrap();
    let names: Vec<_> = traffic.iter().map(|row| row.vehicle.as_str()).collect();
    assert_eq!(names, ["1/1", "1/2", "2/1", "2/2"]);
    // Three other agents, and this flight's two observers or fewer.
    assert!(
        traffic.iter().all(|row| row.links.is_some_and(|links| links >= 3) && row.messages_per_s > 10.0),
        "{traffic:?}"
    );
    let (good, text) = fleet.report("out");
    assert!(
        good && fs::read_to_string(out.join("page/index.html")).unwrap().contains("The fleet from above"),
        "{text}"
    );
    assert!(stderr.contains("team 1: ") && stderr.contains("2 of 2 landed"), "{stderr}");
    assert!(!stderr.contains("lost"), "{stderr}");
}

/// The first and the last time at which a vehicle of this team flew this step of the mission, s.
fn in_step(places: &[TeamPlaces], team: u16, step: u32) -> Option<(f64, f64)> {
    let flies =
        |places: &&TeamPlaces| places.team.get() == team && places.vehicles.iter().any(|vehicle| vehicle.step == step);
    let times: Vec<f64> = places.iter().filter(flies).map(|places| places.t_s).collect();
    Some((*times.first()?, *times.last()?))
}

#[test]
fn a_team_waits_outside_a_place_that_another_takes_near_or_far() {
    let _share = Share::of_flight(8);
    let fleet = Fleet::new("fleet-same-place", SAME_PLACE);
    let output = fleet.fly(55).wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    let report = last_line(&output.stdout);
    assert_eq!(report["across_collisions"], 0.0, "{report}");
    let places = record::read_fleet(&fleet.folder.path().join("out").join(record::FLEET_FILE)).unwrap().places;
    let (first, second) = (in_step(&places, 1, 1).unwrap(), in_step(&places, 2, 1).unwrap());
    assert!(first.1 <= second.0, "the lower number first: {first:?}, then {second:?}");
    let (third, fourth) = (in_step(&places, 3, 0).unwrap(), in_step(&places, 4, 1).unwrap());
    assert!(third.1 > 12.0 && third.1 <= fourth.0, "team 4 waits 3.5 km away: {third:?}, then {fourth:?}");
}

#[test]
fn an_order_reaches_one_team_or_all_of_them() {
    let _share = Share::of_flight(8);
    let fleet = Fleet::new("fleet-orders", &CROSSING.replace("spacing_m = 150", "spacing_m = 9000"));
    let child = fleet.fly(300);
    let held = until_accepted(&fleet, &["hold", "--teams", "2"]);
    let is_held = ["accepted by vehicle 1 to 2", "accepted by vehicle 1, 2", "held at step 0, as before"];
    assert!(is_held.iter().any(|text| held.contains(text)), "{held}");
    let recording = fleet.record("all.mcap");
    let (good, refused) = fleet.order(&["hold", "--teams", "3"]);
    assert!(!good && refused.contains("has teams 1 to 2, not 3"), "{refused}");
    sleep(Duration::from_secs(4));
    kill_process(Pid::from_child(&recording), Signal::INT).unwrap();
    let recorded = recording.wait_with_output().unwrap();
    assert!(recorded.status.success(), "{recorded:?}");
    let text = String::from_utf8_lossy(&recorded.stdout);
    assert!(text.starts_with("all.mcap: 4 vehicles at ") && text.contains("dropped: 0"), "{text}");
    let places = record::read_fleet(&fleet.folder.path().join("all.mcap")).unwrap().places;
    let teams: BTreeSet<TeamId> = places.iter().filter(|it| it.vehicles.len() == 2).map(|it| it.team).collect();
    assert_eq!(teams.len(), 2, "{places:?}");
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
    let _share = Share::of_flight(8);
    let fleet = Fleet::new("fleet-large", "fleet.teams = 9\nswarm.vehicles = 8\n");
    let output = fleet.fly(10).wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("fleets larger than 64 agents fly in virtual time"), "{stderr}");
}

#[test]
#[ignore = "takes a quarter of an hour: `.ci/long`"]
fn shows_of_five_minutes() {
    let _share = Share::of_flight(8);
    println!("{}", shows::table());
}
