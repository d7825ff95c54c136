//! A whole cluster as in a lab: eight hosts, each with its own network, sshd, home and process tree, and the operator's
//! PC, which has only ssh and `skein`.
//!
//! Needs Linux, root, `ip`, `nft`, util-linux and OpenSSH's server. Without them these tests print a message and pass,
//! unless `SKEIN_NAMESPACES=required`.

mod accounts;
mod attacks;
mod faults;
mod finished;
mod fleet;
mod flight;
mod host;
mod intruders;
mod lab;
mod ordered;
mod page;
mod sky;
mod teams;

use std::sync::{Mutex, MutexGuard, PoisonError};

use flight::Flight;
use host::Host;
use lab::{HOSTS, Lab};
use skein_tests::share::Share;

use super::namespaces::{self, print_line};

/// Permission to run one cluster at a time, with the processors that it needs; `None` if these tests cannot run here.
fn alone() -> Option<(MutexGuard<'static, ()>, Share)> {
    static ALONE: Mutex<()> = Mutex::new(());
    let Some(missing) = lab::missing() else {
        // Measured: its eight agents take 30 % of a processor, its watcher 6, an installation the rest.
        return Some((ALONE.lock().unwrap_or_else(PoisonError::into_inner), Share::of(60)));
    };
    namespaces::refuse(&format!("cluster tests skipped: {missing}"));
    None
}

#[test]
fn the_hosts_of_the_lab_share_no_home_no_name_and_no_process() {
    let Some(_alone) = alone() else { return };
    let mut lab = Lab::new("hosts", |_| &[]);
    let before: Vec<_> = lab.hosts.iter().map(Host::files).collect();
    assert!(lab.skein("--version", 10).succeeded().out.starts_with("skein "));
    let all =
        (1..=HOSTS).map(|id| format!("ssh heli{id} 'hostname >~/own; ls -A ~; ls /tmp; ls /proc/[0-9]* -d | wc -l' &"));
    let finished = lab.operator().sh(&format!("{} wait", all.collect::<String>())).succeeded();
    assert_eq!(finished.out.lines().filter(|line| *line == "own").count(), usize::from(HOSTS), "{finished}");
    for host in &lab.hosts {
        assert_eq!(std::fs::read_to_string(host.path("/root/own")).unwrap(), format!("{}\n", host.name));
        assert_eq!(host.processes(&["sshd"]).len(), 1, "only its own sshd");
    }
    lab.hosts.iter().for_each(|host| assert!(host.sh("rm /root/own").status == Some(0)));
    assert!(lab.hosts.iter().map(Host::files).eq(before), "no other file is left");
    assert!(!lab.operator().path("/root/own").exists());

    let reach = |lab: &Lab| lab.operator().sh("ssh -o ConnectTimeout=5 heli3 true").status;
    lab.cut(3, true);
    assert_eq!(reach(&lab), Some(255), "the host is disconnected");
    lab.cut(3, false);
    assert_eq!(reach(&lab), Some(0), "the host is connected again");
    lab.take_operator();
    lab.put_operator();
    assert_eq!(reach(&lab), Some(0), "another PC with the same key");
    lab.host(3).processes(&["sshd"]).into_iter().for_each(host::kill);
    assert_eq!(reach(&lab), Some(255), "no sshd runs any more");
}

#[test]
fn a_swarm_is_installed_flown_disturbed_upgraded_and_uninstalled() {
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
    flight.order_from_the_page(&sky);
    // The upgrade mostly waits for landings: another cluster test may use the computer meanwhile.
    drop(alone_until_the_upgrade);
    let sky = flight.upgrade(sky);
    let _alone = alone();
    flight.end(&sky);
}

#[test]
fn a_fleet_of_teams_is_installed_flown_ordered_by_team_and_uninstalled() {
    let Some(_alone) = alone() else { return };
    teams::fly();
}

#[test]
fn a_check_finds_every_problem_with_its_remedy() {
    let Some(_alone) = alone() else { return };
    match faults::missing() {
        None => faults::are_found(),
        Some(missing) => namespaces::refuse(&missing),
    }
}

#[test]
fn a_cluster_is_used_whatever_a_shell_prints_and_ssh_is_set_to() {
    let Some(_alone) = alone() else { return };
    accounts::are_used();
}

#[test]
fn a_second_operator_does_not_take_a_flying_swarm_over() {
    let Some(_alone) = alone() else { return };
    accounts::are_not_taken_over();
}

#[test]
#[ignore = "a process that the other tests start, on its own host"]
fn watcher() {
    sky::observe_swarm();
}

#[test]
#[ignore = "a process that the other tests start, on its own host"]
fn intruder() {
    intruders::intrude();
}

#[test]
#[ignore = "prints what the commands of the book's pages on clusters print: `.ci/long`"]
fn page() {
    let Some(_alone) = alone() else { return };
    page::print();
}

#[test]
#[ignore = "five minutes on a quiet PC: `.ci/long`"]
fn attacks_disturb_no_vehicle() {
    let Some(_alone) = alone() else { return };
    attacks::print();
}

#[test]
#[ignore = "a process that the attacks' test starts, on its own host"]
fn attacker() {
    attacks::attack();
}

#[test]
#[ignore = "a process that the other tests start, on the operator's PC"]
fn browser() {
    ordered::browse();
}
