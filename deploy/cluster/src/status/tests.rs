use std::collections::BTreeMap;
use std::path::Path;

use skein_common::id::{Incarnation, VehicleId, VehicleSet};
use skein_common::message::{ClockOffset, Drops, Failure, Header, Heartbeat, PeerHealth, Reason, Refused, Traffic};
use skein_common::state::Membership;
use skein_common::time::SenderStamp;

use super::*;
use crate::inventory::tests::lab;
use crate::mesh::observe::SwarmMessage;
use crate::mesh::reach::{Flown, Reach};

fn id(number: u8) -> VehicleId {
    VehicleId::new(number).unwrap()
}

/// The health report of vehicle `number` of four, whose clock is ahead by `ahead_s`.
fn health(number: u8, ahead_s: f64) -> Health {
    let peer = |peer: VehicleId| PeerHealth {
        id: peer,
        standing: PeerStatus::Fresh,
        age_s: 0.1 * f64::from(peer.get()),
        delay_s: Some(0.004),
        clock: Some(ClockOffset { offset_s: -ahead_s, bound_s: 0.0004 }),
    };
    Health {
        header: Header { sender: id(number), incarnation: Incarnation(1), sequence: 1, stamp: SenderStamp::ZERO },
        uptime_s: 3725.4,
        activity: Activity::Formation,
        in_place_s: Some(60.0),
        plant: "builtin".to_owned(),
        version: "0.1.0-1f2e3d4c5b6a".to_owned(),
        failures: Vec::new(),
        simulator_faults: Vec::new(),
        frame_rate_hz: 49.96,
        jitter_ms: 1.26,
        step_p50_us: 100.0,
        step_p99_us: 200.0,
        frame_overruns: 0,
        drops: Drops::default(),
        unsent: 0,
        refused: Vec::new(),
        state_messages: 1,
        state_bytes: 1,
        links: 4,
        sent: Traffic { messages: 7450, bytes: 745_080 },
        received: Traffic { messages: 37_254, bytes: 2_980_320 },
        peers: VehicleId::first(4).filter(|other| other.get() != number).map(peer).collect(),
    }
}

/// The status of four vehicles, all in contact, when these reports were received `ago`.
fn status(folder: &Path, received: Vec<Health>, ago: Duration) -> SwarmStatus {
    let at = clock::now();
    let there = VehicleId::first(4).map(|id| (SwarmMessage::Appeared(id), None, at));
    let received = received.into_iter().map(|health| (SwarmMessage::Health(health), None, at));
    status_of(folder, there.chain(received), at + ago)
}

/// The status of four vehicles from messages, each in a run of the swarm.
fn status_of(
    folder: &Path,
    received: impl IntoIterator<Item = (SwarmMessage, Option<u64>, Instant)>,
    now: Instant,
) -> SwarmStatus {
    let inventory = lab(folder, 4, "");
    let reach = Reach::plain(inventory.swarm.clone(), BTreeMap::new(), Flown::Text(String::new()));
    let mut observers = Observers::open(&[reach]).unwrap();
    observers.each()[0].inject(received);
    let place = Place::Cluster(Box::new(inventory));
    SwarmStatus::of(place.swarm(), &listed(&place), &observers, now)
}

/// The vehicle's heartbeat in this incarnation.
fn mission(number: u8, life: u64) -> Heartbeat {
    let header = Header { incarnation: Incarnation(life), ..health(number, 0.0).header };
    Heartbeat {
        header,
        plan: 0,
        membership: Membership::Active,
        step: 0,
        vouched: 0,
        reached: None,
        progress_m: 0.0,
        order: None,
        orders: 0,
        echo: None,
        lost: VehicleSet::default(),
    }
}

/// The messages of vehicle `number` in a run: its appearance, its heartbeat, its health report.
fn all_of(number: u8, run: u64) -> [(SwarmMessage, Option<u64>, Instant); 3] {
    let messages = [
        SwarmMessage::Appeared(id(number)),
        SwarmMessage::Mission(mission(number, 1)),
        SwarmMessage::Health(health(number, 0.0)),
    ];
    messages.map(|message| (message, Some(run), clock::now()))
}

#[test]
fn a_text_from_the_network_is_made_safe_for_the_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let mut second = health(2, 0.0);
    second.version = "1\u{1b}[2J\nnode 9: \u{202e}good\u{9b}".to_owned();
    second.plant = "\u{1b}]0;t\u{7}".to_owned();
    let status = status(folder.path(), vec![second], Duration::ZERO);
    let text = table::of(&status, "lab.toml");
    assert!(text.contains("1\\u001b[2J\\u000anode 9: \\u202egood\\u009b"), "{text}");
    assert!(text.contains("\\u001b]0;t\\u0007"), "{text}");
    let shown = text + &serde_json::to_string(&status).unwrap();
    assert!(!shown.contains(|c: char| c.is_control() && c != '\n' || c == '\u{202e}'), "{shown:?}");
}

#[test]
fn wanted_random_failures_are_stated_and_no_fault() {
    let folder = tempfile::tempdir().unwrap();
    for (fault, is_good) in [(SimulatorFault::RandomFailures, false), (SimulatorFault::WantedRandomFailures, true)] {
        let reports = [1, 2, 3, 4].map(|id| Health { simulator_faults: vec![fault], ..health(id, 0.0) });
        let status = status(folder.path(), reports.into(), Duration::ZERO);
        assert_eq!((status.is_good(), verdict(&status).is_ok()), (is_good, is_good), "{fault}");
        assert!(table::of(&status, "lab.toml").contains(&format!("node 3: {fault}\n")), "{fault}");
    }
}

#[test]
fn health_of_a_lost_vehicle_or_of_an_earlier_incarnation_is_ignored() {
    let folder = tempfile::tempdir().unwrap();
    let now = clock::now();
    let gone = all_of(1, 7).into_iter().chain([(SwarmMessage::Vanished(id(1)), None, now)]);
    let restarted = all_of(2, 7).into_iter().chain([(SwarmMessage::Mission(mission(2, 2)), Some(7), now)]);
    // A recorded report, replayed by another node while the vehicle is not in contact.
    let never_there = [(SwarmMessage::Health(health(3, 0.0)), Some(7), now)];
    let received = gone.chain(restarted).chain(never_there).chain(all_of(4, 7));
    let status = status_of(folder.path(), received, now);
    let reported: Vec<bool> = status.nodes.iter().map(|node| node.report.is_some()).collect();
    assert_eq!(reported, [false, false, false, true]);
    assert!(status.nodes.iter().all(|node| node.why.is_none()));
    assert_eq!(verdict(&status).unwrap_err().to_string(), "not in contact: node 1, 2, 3");
}

#[test]
fn health_of_another_run_is_ignored() {
    let folder = tempfile::tempdir().unwrap();
    let of_runs = |runs: [u64; 4]| {
        let received = (1..).zip(runs).flat_map(|(number, run)| all_of(number, run));
        status_of(folder.path(), received, clock::now())
    };
    let one_strays = of_runs([7, 7, 5, 7]);
    assert_eq!(verdict(&one_strays).unwrap_err().to_string(), "not in contact: node 3");
    let text = table::of(&one_strays, "lab.toml");
    let expected = "node 3 (10.0.0.13, tls/10.0.0.13:7449) is not in contact: it flies in run 5, and the swarm in run 7; \
                    `skein cluster down`, then `up`\n";
    assert!(text.contains(expected), "{text}");
    // As many vehicles report one run as the other: neither is accepted.
    let undecided = of_runs([7, 7, 5, 5]);
    assert!(undecided.nodes.iter().all(|node| node.report.is_none()));
    assert!(table::of(&undecided, "lab.toml").contains("no run has a majority of the vehicles in contact"));
    // A health report of an old run, from a vehicle that flies in the present run.
    let mut old = all_of(3, 7).to_vec();
    old[2].1 = Some(5);
    let received = [1, 2, 4].into_iter().flat_map(|number| all_of(number, 7)).chain(old);
    let status = status_of(folder.path(), received, clock::now());
    assert_eq!(verdict(&status).unwrap_err().to_string(), "not in contact: node 3");
}

#[test]
fn the_table_of_a_good_swarm_fits_the_screen() {
    let folder = tempfile::tempdir().unwrap();
    let status = status(folder.path(), (1..=4).map(|number| health(number, 0.0)).collect(), Duration::ZERO);
    assert!(status.is_good() && verdict(&status).is_ok());
    let text = table::of(&status, "cluster.toml");
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 11, "{text}");
    for heading in lines[0].split_whitespace().filter(|message| !["node", "ms"].contains(message)) {
        assert!(lines[5..].iter().any(|line| line.contains(heading)), "{heading}: {text}");
    }
    assert!(lines.iter().all(|line| line.chars().count() <= 120), "{text}");
    let messages: Vec<&str> = lines[2].split_whitespace().collect();
    let expected = [
        "2",
        "0.1.0-1f2e3d4c5b6a",
        "builtin",
        "formation",
        "50",
        "1.3",
        "3/3",
        "400",
        "+0.0",
        "±0.4",
        "4",
        "2/10",
        "-",
        "0",
        "1:02:05",
    ];
    assert_eq!(messages, expected, "{text}");
}

#[test]
fn a_node_in_the_phase_formation_that_is_not_in_its_place_is_under_way() {
    let folder = tempfile::tempdir().unwrap();
    let reports = [1, 2, 3, 4].map(|id| Health { in_place_s: (id != 2).then_some(3.5), ..health(id, 0.0) });
    let status = status(folder.path(), reports.into(), Duration::ZERO);
    let text = table::of(&status, "cluster.toml");
    let lines: Vec<&str> = text.lines().collect();
    assert!(lines[2].contains(" under way ") && lines[3].contains(" formation "), "{text}");
    let json = serde_json::to_value(&status).unwrap();
    let said =
        |nth: usize| (json["nodes"][nth]["said"]["phase"].clone(), json["nodes"][nth]["said"]["in_place_s"].clone());
    assert_eq!(said(1), ("formation".into(), serde_json::Value::Null));
    assert_eq!(said(2), ("formation".into(), 3.5.into()));
}

#[test]
fn messages_that_were_not_sent_are_named_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let mut reports: Vec<Health> = (1..=4).map(|id| health(id, 0.0)).collect();
    reports[2].unsent = 12;
    let status = status(folder.path(), reports, Duration::ZERO);
    let text = table::of(&status, "cluster.toml");
    assert!(text.contains("node 3 did not send 12 of its events, traces and health reports: the network"), "{text}");
    assert_eq!(text.matches("did not send").count(), 1, "{text}");
    let json = serde_json::to_value(&status).unwrap();
    assert_eq!((&json["nodes"][2]["said"]["unsent"], &json["nodes"][0]["said"]["unsent"]), (&12.into(), &0.into()));
}

#[test]
fn silent_and_faulty_nodes_are_listed() {
    let folder = tempfile::tempdir().unwrap();
    let mut second = health(2, 0.0);
    second.failures = vec![Failure::Gyro];
    second.peers[0].standing = PeerStatus::Lost;
    second.drops.forged = 3;
    second.refused = vec![Refused { reason: Reason::Forged, key: "vehicle/1/state".to_owned(), count: 3 }];
    let status = status(folder.path(), vec![health(1, 0.0), second, health(4, 0.0)], Duration::ZERO);
    assert!(!status.is_good());
    let error = verdict(&status).unwrap_err();
    assert_eq!((error.to_string().as_str(), error.exit_code()), ("not in contact: node 3; faulty: node 2", 1));
    let text = table::of(&status, &remedy(&Place::Cluster(Box::new(lab(folder.path(), 4, "")))));
    assert!(text.contains("node 2: yaw gyro failed, lands\n"), "{text}");
    assert!(text.contains("node 2 refused 3 times: forged, under vehicle/1/state\n"), "{text}");
    assert!(text.contains("node 3 (10.0.0.13, tls/10.0.0.13:7449) is not in contact\n`skein check -f "), "{text}");
    assert_eq!(status.nodes[1].report.as_ref().unwrap().peers_seen, 2);
    let json = serde_json::to_value(&status).unwrap();
    assert_eq!(
        (&json["nodes"][2]["said"], &json["nodes"][1]["said"]["refused"]),
        (&serde_json::Value::Null, &3.into())
    );
}

#[test]
fn the_age_of_a_peer_includes_its_delay_and_is_marked_while_the_delay_is_unknown() {
    let folder = tempfile::tempdir().unwrap();
    let (mut late, mut unknown) = (health(1, 0.0), health(2, 0.0));
    for peer in &mut late.peers {
        (peer.standing, peer.age_s, peer.delay_s) = (PeerStatus::Stale, 4.051, Some(4.0));
    }
    (unknown.peers[0].standing, unknown.peers[0].delay_s) = (PeerStatus::Stale, None);
    let status = status(folder.path(), vec![late, unknown], Duration::ZERO);
    let reports: Vec<_> = status.nodes.iter().filter_map(|node| node.report.as_ref()).collect();
    assert_eq!(
        (reports[0].peers_seen, reports[0].peer_age_ms, reports[0].peer_delay_ms),
        (3, Some(4051.0), Some(4000.0))
    );
    assert_eq!((reports[1].peers_seen, reports[1].peer_delay_ms), (3, None));
    let text = table::of(&status, "cluster.toml");
    assert!(text.contains(" 4051  ") && text.contains(" >400  "), "{text}");
}

#[test]
fn a_wrong_clock_is_a_warning_and_not_a_fault() {
    let folder = tempfile::tempdir().unwrap();
    let received = vec![health(1, 0.0), health(2, 0.25), health(3, 0.0), health(4, 86_400.0)];
    let status = status(folder.path(), received, Duration::ZERO);
    assert!(status.is_good());
    let text = table::of(&status, "cluster.toml");
    assert!(text.contains("!+250.0 ±0.4") && text.contains("!+86400 s"), "{text}");
    assert!(text.contains("node 2: its clock is +250 ms off"), "{text}");
    assert!(text.lines().take(5).all(|line| line.chars().count() <= 120), "{text}");
}

#[test]
fn a_node_that_has_fallen_silent_is_not_listed_as_reporting() {
    let folder = tempfile::tempdir().unwrap();
    let all = || (1..=4).map(|number| health(number, 0.0)).collect();
    assert!(status(folder.path(), all(), Duration::from_secs(3)).is_good());
    assert!(status(folder.path(), all(), Duration::from_secs(4)).nodes.iter().all(|node| node.report.is_none()));
}

/// The status of a fleet of five teams of four; the last two vehicles of team 3 are not in contact.
fn fleet_status() -> SwarmStatus {
    let node = |team: u16, vehicle: u8| {
        let team = TeamId::new(team).unwrap();
        let id = VehicleName { team: Some(team), vehicle: VehicleId::new(vehicle).unwrap() };
        let mut report = HealthReport::of(&health(vehicle, 0.0), 3);
        if id.to_string() == "2/3" {
            report.phase = "landing".to_owned();
            (report.frame_rate_hz, report.jitter_ms, report.refused) = (20.0, 30.0, 5);
            report.faults.push("no gyro".to_owned());
        }
        let report = (team.get() != 3 || vehicle < 3).then_some(report);
        NodeStatus { id, team: Some(team), host: None, endpoint: "tls/x:1".to_owned(), report, why: None }
    };
    let nodes = (1..=5).flat_map(|team| (1..=4).map(move |vehicle| node(team, vehicle))).collect();
    SwarmStatus { swarm: "lab".to_owned(), nodes }
}

#[test]
fn a_large_fleet_has_a_row_for_each_team_with_the_worst_of_its_nodes() {
    let status = fleet_status();
    let text = table::of(&status, "lab.toml");
    let rows: Vec<Vec<&str>> = text.lines().take(6).map(|line| line.split_whitespace().collect()).collect();
    assert_eq!(rows[0][0], "team");
    let begins: Vec<String> = rows[1..].iter().map(|row| row[..5].join(" ")).collect();
    let version = "0.1.0-1f2e3d4c5b6a builtin";
    assert_eq!(begins[0], format!("1 (4/4) {version} formation"));
    assert_eq!(begins[1], format!("2 (4/4) {version} several"));
    assert_eq!(begins[2], format!("3 (2/4) {version} formation"));
    assert_eq!((rows[2][5], rows[2][6], rows[1][5]), ("20", "30.0", "50"), "{text}");
    assert!(text.lines().all(|line| line.chars().count() <= 120), "{text}");
    assert!(text.contains("node 2/3: no gyro\n") && text.contains("node 3/4 (tls/x:1) is not in contact\n"), "{text}");
    assert_eq!(verdict(&status).unwrap_err().to_string(), "not in contact: node 3/3-4; faulty: node 2/3");
    let json = serde_json::to_value(&status).unwrap();
    assert_eq!((&json["nodes"][6]["id"], &json["nodes"][6]["team"]), (&"2/3".into(), &2.into()));
    // Small fleets have a row for each node.
    let small = SwarmStatus { nodes: status.nodes[..16].to_vec(), ..status };
    assert!(table::of(&small, "lab.toml").contains("\n 2/3  "), "{}", table::of(&small, "lab.toml"));
}
