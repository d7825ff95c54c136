use std::fs;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread::JoinHandle;

use clap::Parser;
use skein_agent::plant::xplane::standin::{Standin, StandinOptions};
use skein_common::scenario::{Source, load};

use super::*;
use crate::release::{ReleaseArgs, run as release};
use skein_cluster::findings::State;

#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    options: StandinOptions,
}

/// A stand-in that runs until it is dropped.
struct Running {
    address: SocketAddr,
    web: WebChoice,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Running {
    fn begin() -> Self {
        Self::with(&[])
    }

    fn with(arguments: &[&str]) -> Self {
        let given = ["standin", "--port", "0", "--beacon", "false"].iter().chain(arguments);
        let options = Cli::parse_from(given).options;
        let mut standin = Standin::open(&options).unwrap();
        let (address, stop) = (standin.address, Arc::new(AtomicBool::new(false)));
        let web = standin.web_address().map_or(WebChoice::Off, |web| web.to_string().parse().unwrap());
        let of_thread = Arc::clone(&stop);
        let thread = Some(std::thread::spawn(move || standin.run(&of_thread)));
        Self { address, web, stop, thread }
    }

    fn surveyor(&self) -> Surveyor {
        Surveyor::open(&self.address.to_string()).unwrap()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop.store(true, Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn state(lines: &[Line], what: &str) -> State {
    lines.iter().find(|line| line.what == what).unwrap_or_else(|| panic!("{what}: {lines:#?}")).state
}

#[test]
fn an_x_plane_ready_for_an_agent_has_no_fault_and_a_missing_dataref_is_named() {
    let running = Running::begin();
    let text = "name = \"far\"\n[origin]\nlatitude_deg = 29.0\nlongitude_deg = -82.0\nelevation_m = 0\n[swarm]\nvehicles = 1\n";
    let scenario = load(&Source { name: "far.toml", text }, &[]).unwrap().scenario;
    let mut profile = Profile::default();
    let found = lines("here", &running.surveyor(), &profile, Some(&scenario), &WebChoice::Off).unwrap();
    for what in [
        "answer",
        "version",
        "pause",
        "replay",
        "crash",
        "speed",
        "random failures",
        "aircraft",
        "datarefs",
        "rotor",
        "overrides",
    ] {
        assert_eq!(state(&found, what), State::Good, "{what}: {found:#?}");
    }
    assert_eq!(state(&found, "origin"), State::Warning);
    assert_ne!(state(&found, "frames"), State::Fault, "{found:#?}");
    verdict(&found).unwrap();

    let missing = skein_core::aircraft::Dataref::new("laminar/r22/rotor_collective_ratio").unwrap();
    profile.collective.push(missing);
    profile.acf = Some("R22".to_owned());
    let found = lines("here", &running.surveyor(), &profile, None, &WebChoice::Off).unwrap();
    let line = found.iter().find(|line| line.what == "dataref").unwrap();
    assert!(line.state == State::Fault && line.found.starts_with("laminar/r22/rotor_collective_ratio"), "{line:?}");
    let loaded = found.iter().find(|line| line.what == "aircraft").unwrap();
    assert!(loaded.state == State::Fault && loaded.found.ends_with("xcell60.acf"), "{loaded:?}");
    assert!(verdict(&found).is_err());
}

#[test]
fn random_failures_are_as_the_scenario_wants_them() {
    let paths = RANDOM_FAILURES.map(str::to_owned);
    for (values, are_wanted, expected) in [
        (&[][..], false, State::Unknown),
        (&[0.0], false, State::Good),
        (&[0.0, 1.0], false, State::Warning),
        (&[1.0], true, State::Good),
        (&[0.0, 0.0], true, State::Warning),
    ] {
        let values: std::collections::BTreeMap<_, f64> = paths.iter().cloned().zip(values.iter().copied()).collect();
        let line = random_failures("here", &|path| values.get(path).copied(), are_wanted);
        assert_eq!(line.state, expected, "{line:?}");
    }
}

#[test]
fn a_path_that_was_not_read_to_its_end_is_no_fault() {
    let acf = format!("Aircraft/{}/R22.acf", "x".repeat(PATH_CHARACTERS));
    let running = Running::with(&["--acf", &acf]);
    let profile = Profile { acf: Some("R22".to_owned()), ..Profile::default() };
    let found = lines("here", &running.surveyor(), &profile, None, &WebChoice::Off).unwrap();
    assert_eq!(state(&found, "aircraft"), State::Warning, "{found:#?}");
}

#[test]
fn the_web_api_says_which_datarefs_exist_and_which_aircraft_is_loaded() {
    let long = format!("Aircraft/{}/R22.acf", "x".repeat(PATH_CHARACTERS));
    let running = Running::with(&["--web", "0", "--acf", &long]);
    let mut profile = Profile { acf: Some("R22".to_owned()), ..Profile::default() };
    let found = lines("here", &running.surveyor(), &profile, None, &running.web).unwrap();
    for what in ["web API", "web datarefs", "aircraft"] {
        assert_eq!(state(&found, what), State::Good, "{what}: {found:#?}");
    }
    let api = found.iter().find(|line| line.what == "web API").unwrap();
    assert!(api.found.starts_with("v1, v2, v3 of X-Plane 12.4.0, "), "{api:?}");
    let dataref = |path: &str| skein_core::aircraft::Dataref::new(path).unwrap();
    profile.collective.push(dataref("laminar/r22/rotor_collective_ratio"));
    let found = lines("here", &running.surveyor(), &profile, None, &running.web).unwrap();
    assert_eq!(state(&found, "web datarefs"), State::Good, "the aircraft's own dataref: {found:#?}");
    profile.collective.push(dataref("laminar/s76/rotor_collective_ratio"));
    let found = lines("here", &running.surveyor(), &profile, None, &running.web).unwrap();
    assert_eq!(state(&found, "web datarefs"), State::Fault);
}

#[test]
fn the_states_are_read_by_the_web_api_where_it_answers_and_the_command_that_resets_exists() {
    let running = Running::with(&["--web", "0"]);
    let surveyor = running.surveyor();
    for path in ["skein/standin/replay", "skein/standin/crash", RANDOM_FAILURES[0], "skein/standin/speed"] {
        surveyor.write(path, if path.ends_with("speed") { 0.5 } else { 1.0 });
    }
    assert!(surveyor.reads(&[RANDOM_FAILURES[0].to_owned(), REPLAY.to_owned()], 1.0).unwrap());
    surveyor.command("sim/operation/pause_on");
    assert!(surveyor.reads(&[PAUSED.to_owned()], 1.0).unwrap());
    let web = web::WebChecks(running.web.open());
    // What UDP has received says the opposite, or nothing.
    let bad = states("here", &|path| web.number(path).or(Some(0.0)));
    for what in ["pause", "replay", "crash"] {
        assert_eq!(state(&bad, what), State::Fault, "{bad:#?}");
    }
    assert_eq!(random_failures("here", &|path| web.number(path), false).state, State::Warning);
    surveyor.command("sim/operation/pause_off");
    assert!(surveyor.reads(&[PAUSED.to_owned()], 0.0).unwrap());
    assert_eq!(state(&states("here", &|path| web.number(path)), "speed"), State::Warning);
    let found = lines("here", &surveyor, &Profile::default(), None, &running.web).unwrap();
    assert_eq!((state(&found, "replay"), state(&found, "web commands")), (State::Fault, State::Good), "{found:#?}");
    assert!(states("here", &|_| None).iter().all(|line| line.state == State::Unknown));
}

#[test]
fn a_web_api_that_is_missing_is_no_fault() {
    let running = Running::begin();
    let web = "127.0.0.1:1".parse().unwrap();
    let found = lines("here", &running.surveyor(), &Profile::default(), None, &web).unwrap();
    assert_eq!(state(&found, "web API"), State::Unknown);
    verdict(&found).unwrap();
    let old = Running::with(&["--version", "11"]);
    let found = lines("here", &old.surveyor(), &Profile::default(), None, &web).unwrap();
    assert_eq!(state(&found, "web API"), State::Good, "X-Plane 11 has none");
}

#[test]
fn no_answer_is_one_fault() {
    let silent = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let surveyor = Surveyor::open(&silent.local_addr().unwrap().to_string()).unwrap();
    let found = lines("there", &surveyor, &Profile::default(), None, &WebChoice::Off).unwrap();
    assert!(matches!(&found[..], [line] if line.state == State::Fault && line.what == "answer"), "{found:#?}");
}

#[test]
fn a_report_has_the_checks_and_every_datagram() {
    let running = Running::begin();
    let file = tempfile::NamedTempFile::new().unwrap();
    let lines = [Line::new("here", "pause", "runs")];
    let objects_of = |seconds| -> Vec<serde_json::Value> {
        let time = Duration::from_secs(seconds);
        write_report(file.path(), &running.surveyor(), &Profile::default(), &lines, time).unwrap();
        let text = fs::read_to_string(file.path()).unwrap();
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    };
    let positions = |objects: &[serde_json::Value]| {
        let is_position = |object: &&serde_json::Value| {
            object["datagram"].as_str().is_some_and(|hexadecimal| hexadecimal.starts_with("52504f53"))
        };
        objects.iter().filter(is_position).count()
    };
    // On a busy PC a second has fewer datagrams.
    let objects = (1..=10).map(objects_of).find(|objects| positions(objects) > 30).expect("RPOS in hexadecimal");
    assert_eq!(objects[0]["checks"][0]["found"], "runs");
    assert!(objects[0]["values"][VERSION].as_f64().unwrap() > 110_000.0);
}

#[test]
fn controls_that_a_dead_agent_held_are_given_back() {
    let running = Running::begin();
    let surveyor = running.surveyor();
    let overrides = ["sim/operation/override/override_joystick".to_owned()];
    surveyor.write(&overrides[0], 1.0);
    assert!(surveyor.reads(&overrides, 1.0).unwrap(), "the agent held them");
    let peer = ["sim/operation/override/override_planepath[2]".to_owned()];
    surveyor.write(&peer[0], 1.0);
    let held = lines("here", &surveyor, &Profile::default(), None, &WebChoice::Off).unwrap();
    assert_eq!(state(&held, "overrides"), State::Warning, "the check does not touch them");
    assert!(surveyor.reads(&overrides, 1.0).unwrap());
    let xplanes = vec![running.address.to_string().parse().unwrap()];
    release(&ReleaseArgs { xplanes, aircraft: "xcell60".to_owned() }).unwrap();
    assert!(surveyor.reads(&overrides, 0.0).unwrap());
    assert!(surveyor.reads(&peer, 0.0).unwrap(), "the aircraft that showed a peer");
}
