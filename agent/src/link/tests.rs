mod clocks;
mod orders;
mod secured;
mod teams;

use std::path::PathBuf;
use std::process;
use std::time::{Duration, Instant};

use serde_json::json;
use skein_common::frame::{Geodetic, Origin, VelocityNed};
use skein_common::id::{Incarnation, SwarmName, VehicleName, VehicleSet};
use skein_common::message::{Event, Header, Heartbeat, Message, Order, Reason, State, VERSION, Verb, encode};
use skein_common::scenario::{Source, load};
use skein_common::state::VehicleState;
use skein_common::time::{LocalTime, SenderStamp};
use skein_common::topic::{Branch, Cell};
use skein_core::peers::{Broadcast, PeerMessage, Peers, ReceivedState};
use zenoh::handlers::RingChannel;
use zenoh::qos::CongestionControl;
use zenoh::sample::Sample;

use super::error::plain;
use super::inbox::Inbox;
use super::receiver::receive;
use super::signature::SigningKey;
use super::signature::messages::KeyRing;
use super::*;
use skein_host::clock::{now, sleep_until};

/// Time limit of a wait on a busy PC; a test that passes on a quiet one needs a twentieth of it.
const TIMEOUT: Duration = Duration::from_secs(60);

/// Name of a swarm used by one test only, a session that listens, and the endpoints that reach it.
fn hub(test: &str) -> (SwarmName, Session, Vec<String>) {
    let swarm = SwarmName::new(format!("{test}-{}", process::id())).unwrap();
    let session = open_zenoh(&swarm, &["tcp/127.0.0.1:0".to_owned()], &[], &[]).unwrap();
    let locators = session.info().locators().wait().iter().map(ToString::to_string).collect();
    (swarm, session, locators)
}

fn id(number: u8) -> VehicleId {
    VehicleId::new(number).unwrap()
}

/// Trusts any vehicle that flies plan 7, and any order.
fn trust(swarm: &SwarmName) -> Trust {
    Trust {
        swarm: swarm.clone(),
        vehicles: VehicleId::MAX.into(),
        team: None,
        origin: origin(),
        plan: 7,
        orders: None,
        run: 0,
        key_ring: KeyRing::plain(swarm.clone()),
        signing_key: None,
    }
}

/// Messages that only tests publish one by one.
impl Link {
    fn publish_state(&self, state: &State, cell: Cell) {
        self.send(Messages { state: Some((*state, cell)), ..Messages::default() });
    }

    fn publish_mission(&self, mission: &Heartbeat) {
        self.send(Messages { mission: Some(*mission), ..Messages::default() });
    }

    fn publish_event(&self, event: &Event) {
        self.send(Messages { events: [*event].into(), ..Messages::default() });
    }

    fn subscribe_to(&self, cells: Vec<Cell>) {
        self.send(Messages { cells: Some(cells), ..Messages::default() });
    }
}

fn link(session: Session, own: u8, trust: Trust) -> Link {
    Link::new(session, id(own), LocalClock::start(), trust).unwrap()
}

fn state(sender: u8, sequence: u64) -> State {
    let header =
        Header { sender: id(sender), incarnation: Incarnation(1), sequence, stamp: SenderStamp::from_seconds(1.0) };
    let position = Geodetic::from_degrees(28.0, -82.0, 30.0);
    State { header, state: VehicleState { position, velocity: VelocityNed::new(1.0, 0.0, 0.0), heading_rad: 0.0 } }
}

fn origin() -> Origin {
    Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0))
}

/// The same state as the receiver's control thread gets it.
fn received_state(message: State) -> PeerMessage {
    PeerMessage::State(ReceivedState::new(message, &origin()))
}

fn mission(sender: u8, sequence: u64) -> Heartbeat {
    Heartbeat {
        header: state(sender, sequence).header,
        plan: 7,
        membership: Default::default(),
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

/// Repeats `again` until `found` finds a result in all messages received so far.
fn until<T>(link: &Link, mut again: impl FnMut(), mut found: impl FnMut(&[Received]) -> Option<T>) -> T {
    let mut received = Vec::new();
    let deadline = now() + TIMEOUT;
    loop {
        again();
        link.drain(&mut received);
        if let Some(found) = found(&received) {
            return found;
        }
        assert!(now() < deadline, "received only {received:?}, dropped {:?}", link.drops());
        pause();
    }
}

/// A function that gives what the session has received under this key since the last call. Of more than it keeps, these are the
/// newest: a channel that waits for room would stop Zenoh's threads, which all tests of a process share.
pub(crate) fn samples(session: &Session, key: &str) -> impl FnMut() -> Vec<Sample> + use<> {
    let subscriber = session.declare_subscriber(key.to_owned()).with(RingChannel::new(4096)).wait().unwrap();
    move || std::iter::from_fn(|| subscriber.try_recv().unwrap()).collect()
}

/// The first of three late agents that receives this heartbeat of a silent peer, after the peer has appeared. It can only be the
/// reply to a query, and comes within the second for which the query waits or not at all: a busy PC may need that for one agent.
fn first_to_receive(heartbeat: Heartbeat, mut late_agent: impl FnMut() -> Link) -> Link {
    let (wanted, appeared) = (PeerMessage::Mission(heartbeat), PeerMessage::Appeared(heartbeat.header.sender));
    for _ in 0..3 {
        let (late, mut received, expired) = (late_agent(), Vec::new(), now() + Duration::from_secs(5));
        while now() < expired {
            late.drain(&mut received);
            if message(&received, |message| *message == wanted).is_some() {
                assert!(message(&received, |message| *message == appeared).is_some(), "the token comes first");
                return late;
            }
            pause();
        }
    }
    panic!("no late agent has received {heartbeat:?}");
}

fn pause() {
    sleep_until(now() + Duration::from_millis(2));
}

/// The time at which a query is due again. On a busy computer queries without such pauses would queue for longer than they wait for
/// a reply, and none would be answered.
struct QueryDue(Instant);

impl QueryDue {
    fn is_now(&mut self) -> bool {
        let is_now = now() >= self.0;
        if is_now {
            self.0 = now() + Duration::from_millis(100);
        }
        is_now
    }
}

fn message(received: &[Received], wanted: impl Fn(&PeerMessage) -> bool) -> Option<Received> {
    received.iter().copied().find(|received| wanted(&received.message))
}

fn send(session: &Session, key: &str, bytes: &[u8]) {
    session.put(key, bytes).congestion_control(CongestionControl::Block).wait().unwrap();
}

#[test]
fn two_agents_receive_each_others_messages_and_not_their_own() {
    let (swarm, hub, dial) = hub("two");
    let clock = LocalClock::start();
    let one = Link::new(hub, id(1), clock, trust(&swarm)).unwrap();
    let two = Link::new(open_zenoh(&swarm, &[], &dial, &[]).unwrap(), id(2), clock, trust(&swarm)).unwrap();
    let cell = Cell { x: -1, y: 3 };
    let mut sequence = 0;
    let received = until(
        &one,
        || {
            sequence += 1;
            two.publish_state(&state(2, sequence), cell);
        },
        |received| message(received, |message| matches!(message, PeerMessage::State(_))),
    );
    // On a busy PC a later state has taken the place of the first.
    let is_sent = |content: ReceivedState| content == ReceivedState::new(state(2, content.header.sequence), &origin());
    assert!(matches!(received.message, PeerMessage::State(content) if is_sent(content)));
    assert!(LocalTime::ZERO < received.at && received.at <= clock.now());

    let mission = mission(1, 1);
    let all = until(
        &two,
        || {
            one.publish_state(&state(1, 1), cell);
            one.publish_mission(&mission);
        },
        |received| message(received, |message| matches!(message, PeerMessage::Mission(_))).map(|_| received.to_vec()),
    );
    assert!(all.iter().any(|received| received.message == PeerMessage::Mission(mission)));
    assert!(
        all.iter().any(|received| received.message == PeerMessage::Appeared(id(1))),
        "the peer that was up first is found"
    );
    let own = |message: &PeerMessage| match message {
        PeerMessage::State(content) => content.header.sender == id(2),
        PeerMessage::Appeared(vehicle) | PeerMessage::Vanished(vehicle) => *vehicle == id(2),
        _ => false,
    };
    assert_eq!(message(&all, own), None);
    // States sent faster than they are read are replaced, which is not a fault.
    assert_eq!(two.drops().refused(), 0);
}

#[test]
fn a_peer_that_closes_its_link_is_reported_at_once() {
    let (swarm, hub, dial) = hub("goes");
    let one = link(hub, 1, trust(&swarm));
    let two = link(open_zenoh(&swarm, &[], &dial, &[]).unwrap(), 2, trust(&swarm));
    until(&one, || {}, |received| message(received, |message| *message == PeerMessage::Appeared(id(2))));
    let begin = now();
    two.close();
    until(&one, || {}, |received| message(received, |message| *message == PeerMessage::Vanished(id(2))));
    assert!(now() < begin + Duration::from_secs(2));
}

/// An agent can be late in two ways: it starts late, or a peer that could not be reached is reached late.
#[test]
fn a_late_joiner_receives_the_last_heartbeat_of_a_silent_peer() {
    let (swarm, hub, dial) = hub("late");
    let silent = link(hub, 1, trust(&swarm));
    silent.publish_mission(&mission(1, 4));
    silent.publish_mission(&mission(1, 5));
    let late = first_to_receive(mission(1, 5), || link(open_zenoh(&swarm, &[], &dial, &[]).unwrap(), 2, trust(&swarm)));

    let mut hidden = None;
    let waiting = first_to_receive(mission(4, 9), || {
        let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let endpoint = vec![format!("tcp/{free}")];
        let waiting = link(open_zenoh(&swarm, &[], &endpoint, &[]).unwrap(), 3, trust(&swarm));
        let hidden = hidden.insert(link(open_zenoh(&swarm, &endpoint, &[], &[]).unwrap(), 4, trust(&swarm)));
        hidden.publish_mission(&mission(4, 9));
        waiting
    });
    assert_eq!((late.drops().forged, waiting.drops().undecodable), (0, 0));
}

#[test]
fn malformed_and_forged_messages_are_counted_and_dropped() {
    let (swarm, hub, dial) = hub("dropped");
    let link = link(hub, 1, trust(&swarm));
    let intruder = open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    let good = encode(&state(2, 1));
    until(
        &link,
        || send(&intruder, "vehicle/2/cell/0/0/state", &good),
        |received| message(received, |message| matches!(message, PeerMessage::State(_))),
    );
    let before = link.drops();

    send(&intruder, "vehicle/3/cell/0/0/state", &good);
    send(&intruder, "vehicle/0/cell/0/0/state", &good);
    send(&intruder, "vehicle/2/mission", &[&[VERSION], &b"garbage"[..]].concat());
    send(&intruder, "vehicle/2/mission", b"");
    send(&intruder, "vehicle/2/cell/0/0/state", &good[..good.len() - 1]);
    send(&intruder, "order/1", &[VERSION + 1, 1, 1, 0]);
    // Of the states that were sent until one came, others may come later, and are old.
    let expected = Drops { undecodable: 3, other_version: 1, forged: 2, ..before };
    let deadline = now() + TIMEOUT;
    while (Drops { old: before.old, ..link.drops() }) != expected {
        assert!(now() < deadline, "{:?}", link.drops());
        pause();
    }
    let mut received = Vec::new();
    link.drain(&mut received);
    assert!(
        received.iter().all(
            |received| matches!(received.message, PeerMessage::State(content) if content == ReceivedState::new(state(2, 1), &origin()))
        ),
        "{received:?}"
    );
}

#[test]
fn an_operators_order_is_received() {
    let (swarm, hub, dial) = hub("order");
    let link = link(hub, 1, trust(&swarm));
    let observer = open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    let order = Order { epoch: 1, issuer: 9, verb: Verb::Land, vehicles: None, signature: None };
    let key = Topic::Order(order.issuer).key();
    until(
        &link,
        || send(&observer, &key, &encode(&order)),
        |received| message(received, |message| *message == PeerMessage::Order(order)),
    );
}

#[test]
fn trace_and_summary_are_wanted_only_while_they_have_a_subscriber() {
    let (swarm, hub, dial) = hub("trace");
    let link = link(hub, 1, trust(&swarm));
    let observer = open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    let wanted = || (link.trace_is_wanted(), link.summary_is_wanted());
    assert_eq!(wanted(), (false, false));
    for (key, one) in [(all::TRACES, (true, false)), (all::SUMMARIES, (false, true)), (all::TRACES, (true, false))] {
        let subscriber = observer.declare_subscriber(key).wait().unwrap();
        wait_until(|| wanted() == one);
        subscriber.undeclare().wait().unwrap();
        wait_until(|| wanted() == (false, false));
    }
}

fn wait_until(mut is_so: impl FnMut() -> bool) {
    let deadline: Instant = now() + TIMEOUT;
    while !is_so() {
        assert!(now() < deadline);
        pause();
    }
}

#[test]
fn the_inbox_keeps_the_newest_message_of_each_peer_and_kind() {
    let inbox = Inbox::new();
    let at = LocalTime::from_seconds(1.0);
    let store = |message| inbox.store("vehicle/2/state", Received { message, at });
    for sequence in [1, 3, 2, 3] {
        store(received_state(state(2, sequence)));
    }
    let later_life = State { header: Header { incarnation: Incarnation(2), ..state(3, 1).header }, ..state(3, 1) };
    for state in [state(3, 8), later_life, state(3, 9)] {
        store(received_state(state));
    }
    for message in [
        PeerMessage::Appeared(id(2)),
        PeerMessage::Vanished(id(2)),
        PeerMessage::Vanished(id(4)),
        PeerMessage::Appeared(id(4)),
    ] {
        store(message);
    }
    let order = |epoch| Order { epoch, issuer: 1, verb: Verb::Hold, vehicles: None, signature: None };
    for epoch in [2, 3, 1] {
        store(PeerMessage::Order(order(epoch)));
    }
    let mut received = Vec::new();
    inbox.drain(&mut received);
    let messages: Vec<PeerMessage> = received.iter().map(|received| received.message).collect();
    assert_eq!(
        messages,
        [
            received_state(state(2, 3)),
            received_state(later_life),
            PeerMessage::Vanished(id(2)),
            PeerMessage::Appeared(id(4)),
            PeerMessage::Order(order(3))
        ]
    );
    assert_eq!(inbox.refusals.drops(), Drops { old: 4, ..Drops::default() });
    received.clear();
    inbox.drain(&mut received);
    assert_eq!(received, []);
}

#[test]
fn orders_that_are_in_force_together_all_wait_in_the_inbox() {
    let inbox = Inbox::new();
    let order = |epoch, verb, vehicles: &[u8]| Order {
        epoch,
        issuer: 1,
        verb,
        vehicles: Some(vehicles.iter().map(|number| id(*number)).collect()).filter(|_| !vehicles.is_empty()),
        signature: None,
    };
    let set = |text: &str| Verb::Set(text.parse().unwrap());
    let [radius, wider, altitude] = [(4, "radius_m=80"), (5, "radius_m=90"), (4, "altitude_m=40")]
        .map(|(epoch, key)| order(epoch, set(&format!("formation.{key}")), &[]));
    let (swarm, one, both) = (order(3, Verb::Hold, &[]), order(1, Verb::Land, &[1]), order(2, Verb::Hold, &[1, 2]));
    for order in [radius, one, swarm, altitude, wider, both, one] {
        inbox.store("order/1", Received { message: PeerMessage::Order(order), at: LocalTime::ZERO });
    }
    let mut received = Vec::new();
    inbox.drain(&mut received);
    let orders: Vec<_> = received.iter().map(|received| received.message).collect();
    assert_eq!(orders, [swarm, altitude, wider, both].map(PeerMessage::Order));
    assert_eq!(inbox.refusals.drops().old, 1, "only the order that came when a later one had taken its place");
}

#[test]
fn every_vehicle_fits_into_the_inbox_without_growing() {
    let inbox = Inbox::new();
    let at = LocalTime::ZERO;
    let before = inbox.capacity();
    for _ in 0..3 {
        for vehicle in 1..=VehicleId::MAX {
            let mission = PeerMessage::Mission(mission(vehicle, 1));
            for message in [received_state(state(vehicle, 1)), mission, PeerMessage::Appeared(id(vehicle))] {
                inbox.store("a", Received { message, at });
            }
        }
        inbox.store(
            "a",
            Received {
                message: PeerMessage::Order(Order {
                    epoch: 1,
                    issuer: 1,
                    verb: Verb::Hold,
                    vehicles: None,
                    signature: None,
                }),
                at,
            },
        );
    }
    assert_eq!(inbox.capacity(), before);
}

#[test]
fn a_replayed_message_is_dropped_by_the_core() {
    let (swarm, hub, dial) = hub("replay");
    let link = link(hub, 1, trust(&swarm));
    let replayer = open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    let key = "vehicle/2/cell/0/0/state";
    let newest = until(
        &link,
        || send(&replayer, key, &encode(&state(2, 5))),
        |received| message(received, |message| matches!(message, PeerMessage::State(_))),
    );
    let four = load(&Source { name: "test.toml", text: "swarm.vehicles = 4" }, &[]).unwrap().scenario;
    let mut peers = Peers::new(id(1), 4, 0, &four.network);
    peers.update(newest.at, &[newest], Broadcast::default());
    let before = peers.old();
    let old = until(
        &link,
        || send(&replayer, key, &encode(&state(2, 4))),
        |received| {
            message(received, |message| matches!(message, PeerMessage::State(content) if content.header.sequence == 4))
        },
    );
    peers.update(old.at, &[old], Broadcast::default());
    assert_eq!(peers.old(), before + 1);
}

#[test]
fn zenohs_errors_are_shown_without_source_locations() {
    let shown = |text: &str| plain(&text.into());
    let nested = "Cannot bind tcp/10.9.9.9:1: [10.9.9.9:1: in use at /a/tcp.rs:61.] at /b/unicast.rs:338.";
    assert_eq!(shown(nested), "Cannot bind tcp/10.9.9.9:1: [10.9.9.9:1: in use]");
    assert_eq!(shown("no route to host"), "no route to host");
}

#[test]
fn a_malformed_endpoint_is_refused() {
    let swarm = SwarmName::new("endpoint").unwrap();
    let refused = |listen: &str, dial: &str| {
        let endpoints = |text: &str| text.split_whitespace().map(str::to_owned).collect::<Vec<_>>();
        Sessions::open(&swarm, &endpoints(listen), &endpoints(dial), &Security::Plain).map(|_| ()).unwrap_err()
    };
    assert!(matches!(refused("localhost", ""), LinkError::Endpoint(text) if text == "localhost"));
    assert!(matches!(refused("", "tcp"), LinkError::Endpoint(_)));
    let (_, _taken, locators) = hub("taken");
    let error = refused(&locators[0], "");
    assert!(matches!(error, LinkError::Open(..)));
    let error = error.to_string();
    assert!(error.contains(&locators[0]) && error.contains("in use") && !error.contains(".rs"), "{error}");
}
