use std::path::Path;

use skein_common::id::Incarnation;
use skein_common::message::{ClockOffset, Drops, Failure, Header, PeerHealth, Reason, Refused};
use skein_common::time::SenderStamp;

use super::*;
use crate::cluster::inventory::tests::lab;

fn id(number: u8) -> VehicleId {
    VehicleId::new(number).unwrap()
}

/// What vehicle `number` of four says, whose clock is ahead by so much.
fn health(number: u8, ahead_s: f64) -> Health {
    let peer = |peer: VehicleId| PeerHealth {
        id: peer,
        standing: Standing::Fresh,
        age_s: 0.1 * f64::from(peer.get()),
        clock: Some(ClockOffset { offset_s: -ahead_s, bound_s: 0.0004 }),
    };
    Health {
        header: Header { sender: id(number), incarnation: Incarnation(1), sequence: 1, stamp: SenderStamp::ZERO },
        uptime_s: 3725.4,
        activity: Activity::Formation,
        plant: "builtin".to_owned(),
        version: "0.1.0-1f2e3d4c5b6a".to_owned(),
        failures: Vec::new(),
        frame_rate_hz: 49.96,
        jitter_ms: 1.26,
        step_p50_us: 100.0,
        step_p99_us: 200.0,
        frame_overruns: 0,
        drops: Drops::default(),
        refused: Vec::new(),
        state_messages: 1,
        state_bytes: 1,
        peers: VehicleId::first(4).filter(|other| other.get() != number).map(peer).collect(),
    }
}

/// The status of four when these were heard so long ago.
fn status(folder: &Path, heard: Vec<Health>, ago: Duration) -> Status {
    let inventory = lab(folder, 4, "");
    let at = clock::now();
    let heard = heard.into_iter().map(|health| (health.header.sender, (health, at))).collect();
    Status::of(&inventory, &heard, at + ago)
}

#[test]
fn a_good_swarm_fits_the_screen() {
    let folder = tempfile::tempdir().unwrap();
    let status = status(folder.path(), (1..=4).map(|number| health(number, 0.0)).collect(), Duration::ZERO);
    assert!(status.is_good() && verdict(&status).is_ok());
    let text = table::of(&status, "cluster.toml");
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 6, "{text}");
    assert!(lines.iter().all(|line| line.chars().count() <= 120), "{text}");
    let words: Vec<&str> = lines[2].split_whitespace().collect();
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
        "-",
        "0",
        "1:02:05",
    ];
    assert_eq!(words, expected, "{text}");
}

#[test]
fn who_is_not_heard_or_faulty_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let mut second = health(2, 0.0);
    second.failures = vec![Failure::Gyro];
    second.peers[0].standing = Standing::Lost;
    second.drops.forged = 3;
    second.refused = vec![Refused { reason: Reason::Forged, key: "vehicle/1/state".to_owned(), count: 3 }];
    let status = status(folder.path(), vec![health(1, 0.0), second, health(4, 0.0)], Duration::ZERO);
    assert!(!status.is_good());
    let error = verdict(&status).unwrap_err();
    assert_eq!((error.to_string().as_str(), error.exit_code()), ("not heard: node 3; faulty: node 2", 1));
    let text = table::of(&status, "lab.toml");
    assert!(text.contains("node 2: yaw gyro off, lands\n"), "{text}");
    assert!(text.contains("node 2 refused 3 times: forged, under vehicle/1/state\n"), "{text}");
    assert!(
        text.contains("node 3 (10.0.0.13, tls/10.0.0.13:7449) is not heard\n`skein check -f lab.toml` looks"),
        "{text}"
    );
    assert_eq!(status.nodes[1].said.as_ref().unwrap().peers_seen, 2);
    let json = serde_json::to_value(&status).unwrap();
    assert_eq!(
        (&json["nodes"][2]["said"], &json["nodes"][1]["said"]["refused"]),
        (&serde_json::Value::Null, &3.into())
    );
}

#[test]
fn a_clock_that_is_off_is_warned_of_and_no_fault() {
    let folder = tempfile::tempdir().unwrap();
    let heard = vec![health(1, 0.0), health(2, 0.25), health(3, 0.0), health(4, 86_400.0)];
    let status = status(folder.path(), heard, Duration::ZERO);
    assert!(status.is_good());
    let text = table::of(&status, "cluster.toml");
    assert!(text.contains("!+250.0 ±0.4") && text.contains("!+86400 s"), "{text}");
    assert!(text.contains("node 2: its clock is +250 ms off"), "{text}");
    assert!(text.lines().take(5).all(|line| line.chars().count() <= 120), "{text}");
}

#[test]
fn who_has_fallen_silent_is_not_heard() {
    let folder = tempfile::tempdir().unwrap();
    let all = || (1..=4).map(|number| health(number, 0.0)).collect();
    assert!(status(folder.path(), all(), Duration::from_secs(3)).is_good());
    assert!(status(folder.path(), all(), Duration::from_secs(4)).nodes.iter().all(|node| node.said.is_none()));
}
