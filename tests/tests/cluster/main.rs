//! A whole cluster as a lab has it: eight hosts, each with its own network, sshd, home and process tree, and the operator's PC,
//! which has nothing but ssh and `skein`.
//!
//! Needs Linux, root, `ip`, `nft`, util-linux and OpenSSH's server. Without them these tests say so and pass, unless
//! `SKEIN_NAMESPACES=required`.
#![cfg(target_os = "linux")]
#![expect(clippy::disallowed_methods, reason = "real hosts take real time")]
#![expect(clippy::unwrap_used, reason = "what a test cannot do has failed")]

mod faults;
mod fleet;
mod flight;
mod host;
mod intruders;
mod lab;
mod page;
mod ran;
mod sky;

use std::io::{Write, stdout};
use std::sync::{Mutex, MutexGuard, PoisonError};

use flight::Flight;
use host::Host;
use lab::{HOSTS, Lab};

/// One cluster at a time, where these tests can run.
fn alone() -> Option<MutexGuard<'static, ()>> {
    static ALONE: Mutex<()> = Mutex::new(());
    let Some(missing) = lab::missing() else { return Some(ALONE.lock().unwrap_or_else(PoisonError::into_inner)) };
    refuse(&missing);
    None
}

/// These tests have to run only where somebody says so.
fn refuse(missing: &str) {
    assert_ne!(std::env::var("SKEIN_NAMESPACES").as_deref(), Ok("required"), "{missing}");
    say(&format!("no cluster in network namespaces: {missing}"));
}

/// To the real stdout, whatever the harness captures.
fn say(line: &str) {
    stdout().write_all(format!("{line}\n").as_bytes()).unwrap();
}

#[test]
fn the_operator_reaches_eight_hosts_that_share_no_home_no_name_and_no_process() {
    let Some(_alone) = alone() else { return };
    let mut lab = Lab::new("hosts", |_| &[]);
    let before: Vec<_> = lab.hosts.iter().map(Host::files).collect();
    assert!(lab.skein("--version", 10).good().out.starts_with("skein "));
    let all =
        (1..=HOSTS).map(|id| format!("ssh heli{id} 'hostname >~/own; ls -A ~; ls /tmp; ls /proc/[0-9]* -d | wc -l' &"));
    let ran = lab.operator().sh(&format!("{} wait", all.collect::<String>())).good();
    assert_eq!(ran.out.lines().filter(|line| *line == "own").count(), usize::from(HOSTS), "{ran}");
    for host in &lab.hosts {
        assert_eq!(std::fs::read_to_string(host.path("/root/own")).unwrap(), format!("{}\n", host.name));
        assert_eq!(host.processes(&["sshd"]).len(), 1, "its own sshd and nobody else's");
    }
    lab.hosts.iter().for_each(|host| assert!(host.sh("rm /root/own").status == Some(0)));
    assert!(lab.hosts.iter().map(Host::files).eq(before), "nothing else was left there");
    assert!(!lab.operator().path("/root/own").exists());

    let reach = |lab: &Lab| lab.operator().sh("ssh -o ConnectTimeout=1 heli3 true").status;
    lab.cut(3, true);
    assert_eq!(reach(&lab), Some(255), "nothing comes through");
    lab.cut(3, false);
    assert_eq!(reach(&lab), Some(0), "it is back");
    lab.take_operator();
    lab.put_operator();
    assert_eq!(reach(&lab), Some(0), "another PC with the same key");
    lab.host(3).processes(&["sshd"]).into_iter().for_each(host::kill);
    assert_eq!(reach(&lab), Some(255), "nobody listens there any more");
}

#[test]
fn a_swarm_is_installed_flown_disturbed_upgraded_and_taken_away() {
    let Some(alone_until_the_upgrade) = alone() else { return };
    let mut flight = Flight::prepare();
    let sky = flight.start();
    flight.form(&sky);
    flight.intrude(&sky);
    flight.take_over_one(&sky);
    flight.kill_one(&sky);
    flight.cut_one(&sky);
    flight.status_from_a_node();
    flight.unplug_the_operator(&sky);
    // Most of it is waiting for landings: the other clusters may have the computer meanwhile.
    drop(alone_until_the_upgrade);
    let sky = flight.upgrade(sky);
    let _alone = alone();
    flight.end(&sky);
}

#[test]
fn what_stands_against_a_flight_is_found_with_its_remedy() {
    let Some(_alone) = alone() else { return };
    match faults::missing() {
        None => faults::are_found(),
        Some(missing) => refuse(&missing),
    }
}

#[test]
#[ignore = "the process that looks on for the other tests, on a host of its own"]
fn watcher() {
    sky::look_on();
}

#[test]
#[ignore = "the process of somebody who is not invited, on a host of its own"]
fn intruder() {
    intruders::intrude();
}

#[test]
#[ignore = "prints the README's page on clusters"]
fn page() {
    let Some(_alone) = alone() else { return };
    page::print();
}
