//! `skein fly` on an overloaded PC, and under a flood of hostile datagrams. To overload it, the test stops agents with
//! SIGSTOP: to all others a stopped agent looks like an agent without computing time.

mod flight;
#[cfg(target_os = "linux")]
mod hostile;

use skein_tests::share::Share;
use std::process::{Output, Stdio};
use std::thread::sleep;
use std::time::Duration;

use flight::{Flight, command, wait_for};
use rustix::process::{Pid, Signal, kill_process};
use skein_common::state::Activity;

#[test]
fn airborne_agents_without_computing_time_are_not_killed_and_land_later() {
    let _share = Share::of_flight(3);
    let mut flight = Flight::start("starved", &[]);
    flight.wait_until_all(Activity::Formation);
    [2, 3].into_iter().for_each(|id| flight.signal(id, Signal::STOP));
    kill_process(Pid::from_child(&flight.process), Signal::INT).unwrap();
    // The first has landed and ended; the others are silent and were asked to end.
    wait_for(|| flight.agents().iter().all(|(_, arguments)| !arguments.contains("agents/1.toml")).then_some(()));
    // They continue two seconds before `fly` ends: too late to land by then.
    sleep(Duration::from_secs(13));
    [2, 3].into_iter().for_each(|id| flight.signal(id, Signal::CONT));
    let (status, stderr) = flight.end();
    println!("{stderr}");
    assert_eq!(status, Some(1), "{stderr}");
    assert!(stderr.contains("vehicle 2, 3: still in the air as far as is known"), "{stderr}");
    let left = flight.agents();
    assert_eq!(left.len(), 2, "{left:?}");
    wait_for(|| flight.agents().is_empty().then_some(()));
    let log = std::fs::read_to_string(flight.folder.path().join("out/agents/3.log")).unwrap();
    assert!(log.contains("vehicle 3 landed"), "{log}");
}

#[test]
fn a_swarm_that_is_not_active_in_time_is_ended_with_a_reason() {
    let _share = Share::of_flight(3);
    let mut flight = Flight::start("apart", &["--timeout", "6"]);
    flight.signal(2, Signal::STOP);
    let (status, stderr) = flight.end();
    println!("{stderr}");
    assert_eq!(status, Some(1), "{stderr}");
    assert!(stderr.contains("only 2 of 3 vehicles became active within 6 s (not vehicle 2)"), "{stderr}");
    assert_eq!(flight.agents(), [], "agents on the ground are ended");
}

#[test]
fn a_swarm_too_large_for_any_pc_is_refused_before_any_process_starts() {
    let _share = Share::of_flight(3);
    let folder = tempfile::tempdir().unwrap();
    let mut command = command(folder.path());
    command.args(["fly", "--out", "out", "--set", "swarm.vehicles=250", "--set", "formation.radius_m=1000"]);
    command.args(["--set", "start.square_m=400"]);
    let Output { status, stderr, .. } = command.stdin(Stdio::null()).output().unwrap();
    let stderr = String::from_utf8_lossy(&stderr).into_owned();
    println!("{stderr}");
    assert_eq!(status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("250 agents need ") && stderr.contains(": it can fly "), "{stderr}");
    assert!(!folder.path().join("out").exists() && !folder.path().join("runtime").exists());
}
