use std::time::Duration;

use ring::rand::SystemRandom;
use ring::signature::Ed25519KeyPair;
use skein_agent::link::signature::SigningKey;
use skein_agent::link::{Link, Messages, Security, Trust};
use skein_common::id::{Incarnation, SwarmName, VehicleSet};
use skein_common::message::{EventKind, Header, Verb};
use skein_common::scenario::{Source, load};
use skein_common::state::Membership;
use skein_common::time::SenderStamp;
use skein_host::clock::LocalClock;

use super::*;
use crate::mesh::reach::Flown;

impl Observer {
    /// Processes these messages as if vehicles had sent them, each in a run and at a time.
    pub(crate) fn inject(&mut self, received: impl IntoIterator<Item = (SwarmMessage, Option<u64>, Instant)>) {
        for (received, run, at) in received {
            self.take(&ReceivedMessage { received, run, at });
        }
    }
}

fn mission(sender: u8, life: u64, sequence: u64) -> Heartbeat {
    Heartbeat {
        header: Header {
            sender: VehicleId::new(sender).unwrap(),
            incarnation: Incarnation(life),
            sequence,
            stamp: SenderStamp::ZERO,
        },
        plan: 0,
        membership: Membership::Active,
        step: 0,
        vouched: 0,
        reached: None,
        progress_m: 0.0,
        order: Some(Order { epoch: sequence, issuer: 1, verb: Verb::Hold, vehicles: None, signature: None }),
        orders: 0,
        echo: None,
        lost: VehicleSet::default(),
    }
}

fn arrival(received: SwarmMessage) -> ReceivedMessage {
    ReceivedMessage { received, run: None, at: clock::now() }
}

#[test]
fn the_newest_message_of_the_newest_incarnation_is_kept() {
    let mut vehicles = BTreeMap::new();
    let mut receive = |life, sequence| {
        let news = update(&mut vehicles, &arrival(SwarmMessage::Mission(mission(2, life, sequence))));
        (news, vehicles[&VehicleId::new(2).unwrap()].mission.unwrap().header.sequence)
    };
    assert_eq!(receive(1, 5), (true, 5));
    assert_eq!(receive(1, 4), (false, 5), "late");
    assert_eq!(receive(1, 5), (false, 5), "twice");
    assert_eq!(receive(2, 1), (true, 1), "restarted");
    assert_eq!(receive(1, 9), (false, 1), "of an earlier incarnation");
}

#[test]
fn a_vehicle_is_alive_from_its_appearance_to_its_disappearance() {
    let id = VehicleId::new(1).unwrap();
    let mut vehicles = BTreeMap::new();
    let event = Event { header: mission(1, 1, 1).header, what: EventKind::Landed };
    for (received, alive) in
        [(SwarmMessage::Appeared(id), true), (SwarmMessage::Event(event), true), (SwarmMessage::Vanished(id), false)]
    {
        assert!(update(&mut vehicles, &arrival(received)));
        assert_eq!(vehicles[&id].alive, alive);
    }
}

#[test]
fn the_silence_of_a_vehicle_does_not_begin_before_it_vanished_or_was_asked() {
    let zero = clock::now();
    let at = |s: u64| zero + Duration::from_secs(s);
    let mut view = VehicleView { alive: true, summary_at: Some(at(10)), ..VehicleView::default() };
    view.vanish(at(70));
    assert_eq!(view.summary_at, Some(at(70)), "no summaries were asked for since 10 s");
    view.alive = false;
    view.forget_summary();
    assert_eq!(view.summary_at, Some(at(70)), "the last of a vehicle that is gone");
    view.alive = true;
    view.forget_summary();
    assert_eq!(view.summary_at, None, "the next one is new");
    view.vanish(at(80));
    assert_eq!(view.summary_at, None);
}

#[test]
fn a_vehicle_makes_its_trace_only_for_a_subscriber() {
    let swarm = SwarmName::new(format!("steps-{}", std::process::id())).unwrap();
    let id = VehicleId::new(1).unwrap();
    let here = ["tcp/127.0.0.1:0".to_owned()];
    let sessions = Sessions::open(&swarm, &here, &[], &Security::Plain).unwrap();
    let agents = BTreeMap::from([(id, sessions.endpoints().remove(0))]);
    let scenario = load(&Source { name: "x", text: "swarm.vehicles = 1" }, &[]).unwrap().scenario;
    let trust = Trust { swarm: swarm.clone(), ..Trust::of(&scenario) };
    let link = Link::new(sessions, id, LocalClock::start(), trust).unwrap();
    let reach = Reach::plain(swarm, agents, Flown::Text(String::new()));
    let event = Event { header: mission(1, 1, 1).header, what: EventKind::Landed };
    for wanted in [false, true] {
        let mut observer = Observer::open(&reach).unwrap();
        observer.subscribe_to_traces(wanted).unwrap();
        let until = clock::now() + Duration::from_secs(20);
        let mut has_event = false;
        while !(has_event && link.trace_is_wanted() == wanted) {
            assert!(clock::now() < until, "event received: {has_event}, trace wanted: {wanted}");
            link.send(Messages { events: [event].into(), ..Messages::default() });
            clock::sleep(Duration::from_millis(20));
            has_event |= observer.poll().contains(&SwarmMessage::Event(event));
        }
    }
}

#[test]
fn the_run_in_flight_is_the_one_that_more_than_half_report() {
    assert_eq!((majority(&[5, 7, 7], 3), majority(&[7, 7], 3), majority(&[7], 3)), (Some(7), Some(7), None));
    assert_eq!((majority(&[5, 5, 7, 7], 4), majority(&[0, 0, 0], 3), majority(&[], 0)), (None, None, None));
    let reach = Reach::plain(SwarmName::new("runs").unwrap(), BTreeMap::new(), Flown::Text(String::new()));
    let run = |own_run, named: &[(u8, u64, bool)]| {
        let mut observer = Observer::open(&Reach { own_run, ..reach.clone() }).unwrap();
        for (sender, run, alive) in named {
            let there = alive.then(|| SwarmMessage::Appeared(VehicleId::new(*sender).unwrap()));
            let received = there.into_iter().chain([SwarmMessage::Mission(mission(*sender, 1, 1))]);
            observer.inject(received.map(|received| (received, Some(*run), clock::now())));
        }
        observer.run()
    };
    assert_eq!(run(None, &[(1, 7, true), (2, 5, true), (3, 5, false)]), None, "a tie of those in contact");
    assert_eq!(run(Some(7), &[(1, 7, true), (2, 5, true)]), Some(7), "begun from here");
    assert_eq!(run(Some(7), &[(1, 7, true), (2, 5, true), (3, 5, true)]), Some(5));
    assert_eq!(run(Some(7), &[(2, 5, true), (3, 6, true)]), None, "no vehicle is in it");
}

#[test]
fn a_forged_order_is_ignored() {
    let key = Ed25519KeyPair::generate_pkcs8(&SystemRandom::new()).unwrap();
    let signing_key = Arc::new(SigningKey::from_pkcs8(key.as_ref()).unwrap());
    let swarm = SwarmName::new(format!("observe-{}", std::process::id())).unwrap();
    let public = signing_key.key();
    let scenario = Flown::Text(String::new());
    let plain = Reach::plain(swarm.clone(), BTreeMap::new(), scenario);
    let signed = Reach { orders_key: Some(public), signing_key: Some(signing_key.clone()), ..plain.clone() };
    let order = |epoch| Order { epoch, issuer: 1, verb: Verb::Hold, vehicles: None, signature: None };
    // Each vehicle's id, its run, and the order that it repeats.
    let repeated = [
        (1, 7, orders::sign(&signing_key, &swarm, Branch::SWARM, 7, order(3))),
        (2, 7, order(u64::MAX - 1)),
        (3, 6, orders::sign(&signing_key, &swarm, Branch::SWARM, 6, order(50))),
    ];
    let observe = |reach: &Reach| {
        let mut observer = Observer::open(reach).unwrap();
        for (sender, run, order) in repeated {
            let id = VehicleId::new(sender).unwrap();
            let mission = Heartbeat { order: Some(order), ..mission(sender, 1, 1) };
            let received = [SwarmMessage::Appeared(id), SwarmMessage::Mission(mission)];
            observer.inject(received.map(|received| (received, Some(run), clock::now())));
        }
        observer
    };
    let observer = observe(&signed);
    assert_eq!((observer.run(), observer.next_epoch()), (Some(7), 51));
    // An order is for every vehicle, whichever run it flies in: it is signed for each of these runs.
    let given = observer.signed(order(51));
    assert_eq!(given.len(), 2);
    for (given, run) in given.into_iter().zip([6, 7]) {
        assert!(Checker::new(public, swarm.clone(), Branch::SWARM).is_signed(run, &given));
        assert!(observer.is_issued(&given, Some(run)));
        assert!(!observer.is_issued(&given, Some(13 - run)), "a signature for another run");
    }
    let unsigned_observer = observe(&plain);
    assert_eq!(unsigned_observer.next_epoch(), u64::MAX);
    assert_eq!(unsigned_observer.signed(order(4)), [order(4)], "orders are not signed");
}
