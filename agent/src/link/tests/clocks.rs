//! Clock offsets between sessions of one process, where the true offset is known.

use std::sync::atomic::AtomicUsize;

use skein_common::message::{ClockAnswer, Health, PeerHealth, Traffic, decode};
use skein_common::state::{Activity, PeerStatus};
use zenoh::query::Query;

use super::*;
use skein_host::clock::utc_nanoseconds;

/// A UTC clock that is a quarter of a second fast.
fn fast() -> u64 {
    utc_nanoseconds() + 250_000_000
}

fn health(sender: u8, sequence: u64, peers: &[u8]) -> Health {
    let peer =
        |&peer: &u8| PeerHealth { id: id(peer), standing: PeerStatus::Fresh, age_s: 0.0, delay_s: None, clock: None };
    Health {
        header: state(sender, sequence).header,
        uptime_s: 1.0,
        activity: Activity::Formation,
        in_place_s: None,
        plant: "builtin".to_owned(),
        version: "0".to_owned(),
        failures: Vec::new(),
        simulator_faults: Vec::new(),
        frame_rate_hz: 50.0,
        jitter_ms: 0.0,
        step_p50_us: 0.0,
        step_p99_us: 0.0,
        frame_overruns: 0,
        drops: Drops::default(),
        unsent: 0,
        refused: Vec::new(),
        state_messages: 0,
        state_bytes: 0,
        links: 0,
        sent: Traffic::default(),
        received: Traffic::default(),
        peers: peers.iter().map(peer).collect(),
    }
}

/// Publishes health and queries clocks until a health message satisfies `wanted`; returns that message.
fn measure(
    publisher: &mut HealthPublisher,
    listener: &Session,
    own: u8,
    peers: &[u8],
    wanted: fn(&Health) -> bool,
) -> Health {
    let mut received = samples(listener, &Topic::Health(id(own)).key());
    let deadline = now() + TIMEOUT;
    let mut last = None;
    let mut query_due = QueryDue(now());
    for sequence in 1.. {
        publisher.publish(health(own, sequence, peers));
        if query_due.is_now() {
            publisher.query_next_clock();
        }
        pause();
        for sample in received() {
            let report = decode::<Health>(&sample.payload().to_bytes()).unwrap();
            if wanted(&report) {
                return report;
            }
            last = Some(report);
        }
        assert!(now() < deadline, "{last:?}");
    }
    unreachable!()
}

#[test]
fn clocks_are_measured_within_their_bounds_and_a_wrong_one_is_detected() {
    let (swarm, hub, mut dial) = hub("clocks");
    let second = open_zenoh(&swarm, &["tcp/127.0.0.1:0".to_owned()], &dial, &[]).unwrap();
    dial.extend(second.info().locators().wait().iter().map(ToString::to_string));
    let third = open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    let listener = open_zenoh(&swarm, &[], &dial[..1], &[]).unwrap();
    let [one, two, three] = [(1, hub), (2, second), (3, third)].map(|(own, session)| link(session, own, trust(&swarm)));
    let mut asking = one.health(utc_nanoseconds).unwrap();
    let _right = two.health(utc_nanoseconds).unwrap();
    let _wrong = three.health(fast).unwrap();
    // On a busy computer a single exchange may tell little.
    let report = measure(&mut asking, &listener, 1, &[2, 3], |report| {
        report.peers.iter().all(|peer| peer.clock.is_some_and(|clock| clock.bound_s < 0.1))
    });
    let [right, wrong] = [0, 1].map(|nth| report.peers[nth].clock.unwrap());
    println!("{right:?}, {wrong:?}");
    assert!(right.offset_s.abs() <= right.bound_s, "{right:?}");
    assert!((wrong.offset_s - 0.25).abs() <= wrong.bound_s, "{wrong:?}");
    assert!([right, wrong].iter().all(|clock| clock.bound_s >= 0.0));
}

#[test]
fn false_clock_replies_do_no_harm_and_replies_for_another_vehicle_are_ignored() {
    let (swarm, hub, dial) = hub("liar");
    let agent = link(hub, 1, trust(&swarm));
    let liar = open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    // Gives one answer after the other.
    let lie = |key: &'static str, answers: Vec<fn(u64) -> Vec<u8>>| {
        let next = AtomicUsize::new(0);
        let answer = move |query: Query| {
            let nth = next.fetch_add(1, Relaxed) % answers.len();
            // Echoes the number of the query; otherwise the reply is ignored.
            let question =
                query.payload().map_or(0, |asked| u64::from_le_bytes(asked.to_bytes().as_ref().try_into().unwrap()));
            query.reply(key, answers[nth](question)).wait().unwrap();
        };
        liar.declare_queryable(key).callback(answer).wait().unwrap()
    };
    fn clock(sender: u8, question: u64, received_ns: u64, answered_ns: u64) -> Vec<u8> {
        encode(&ClockAnswer { sender: id(sender), question, received_ns, answered_ns })
    }
    let _garbage = lie(
        "vehicle/2/clock",
        vec![
            |_| vec![],
            |_| b"garbage".to_vec(),
            |question| clock(3, question, 0, 0),
            |question| clock(2, question - 1, 0, 0),
            |question| clock(2, question, u64::MAX, u64::MAX),
        ],
    );
    let _in_the_past = lie(
        "vehicle/3/clock",
        vec![
            |question| clock(3, question, 5, 4),
            |question| clock(3, question, 0, u64::MAX),
            |question| clock(3, question, 0, 0),
            |question| clock(3, question, 9, 9),
        ],
    );
    let mut asking = agent.health(utc_nanoseconds).unwrap();
    let listener = open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    let report = measure(&mut asking, &listener, 1, &[2, 3, 4], |report| {
        report.peers[..2].iter().all(|peer| peer.clock.is_some())
    });
    let offsets_s = [0, 1].map(|nth| report.peers[nth].clock.unwrap().offset_s);
    assert!(offsets_s[0] > 1e9 && offsets_s[1] < -1e9, "{report:?}");
    assert_eq!(report.peers[2].clock, None, "vehicle 4 is not up");
}
