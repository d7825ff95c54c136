use std::process;
use std::time::{Duration, Instant};

use skein_common::id::{Incarnation, SwarmName, VehicleId, VehicleSet};
use skein_common::message::{
    Event, EventKind, Header, Health, Heartbeat, Message, Order, PeerAge, Reason, Refused, Summary, Trace, Verb,
    decode, encode,
};
use skein_common::scenario::{self, EventAction, Fault, Graph, Network, Source, load};
use skein_common::state::{Activity, Membership, PeerStatus};
use skein_common::time::SenderStamp;
use skein_common::topic::{Topic, all};
use tokio::runtime::Runtime;
use zenoh::Session;
use zenoh::Wait;

use super::*;
use crate::link::signature::orders::sign;
use crate::link::signature::tests::signing_key;
use crate::link::tests::samples;
use crate::link::{self, Security};
use crate::plant::PlantChoice;
use skein_core::aircraft::Aircraft;
use skein_core::builtin::BuiltInPlant;
use skein_core::control::Rules;
use skein_core::helicopter::Start;
use skein_host::clock::{now, sleep_until};

/// Time limit of a wait; a test that passes needs a third of it.
const TIMEOUT: Duration = Duration::from_secs(30);

/// Vehicle `number` of a swarm of two, 60 m from the other.
fn node(swarm: &SwarmName, number: u8) -> Node {
    let text = format!("swarm.vehicles = 2\nswarm.name = {:?}\nformation.safety_filter = \"none\"", swarm.as_str());
    let scenario = load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario;
    let id = VehicleId::new(number).unwrap();
    let aircraft = Aircraft::shipped("xcell60").unwrap().unwrap();
    let start = Start { north_m: 60.0 * f64::from(number), ..Start::default() };
    let plant = PlantChoice::BuiltIn(Box::new(BuiltInPlant::new(&scenario, id, &aircraft, &start).unwrap()));
    let (listen, dial, notes) = (vec!["tcp/127.0.0.1:0".to_owned()], Vec::new(), Vec::new());
    Node {
        scenario,
        notes,
        id,
        listen,
        dial,
        aircraft,
        rules: Rules::shipped(),
        plant,
        flown_s: None,
        security: Security::Plain,
        orders_key: None,
        run: 0,
        inputs: None,
    }
}

/// An agent in flight, on a thread of its own.
struct Flight {
    stop: Arc<Stop>,
    thread: thread::JoinHandle<Result<(), RunError>>,
}

impl Flight {
    fn begin(node: Node, session: Session, tokio: &Runtime) -> Self {
        let (stop, handle) = (Arc::new(Stop::default()), tokio.handle().clone());
        let of_thread = stop.clone();
        Self { stop, thread: thread::spawn(move || fly(&node, session, &of_thread, &handle)) }
    }

    /// Waits for the end of the flight and checks that it has ended without an error.
    fn end(self) {
        wait_until("the end of the flight", || self.thread.is_finished());
        self.thread.join().unwrap().unwrap();
    }
}

fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let deadline: Instant = now() + TIMEOUT;
    while !is_so() {
        assert!(now() < deadline, "timed out waiting for {what}");
        sleep_until(now() + Duration::from_millis(5));
    }
}

/// Name of a swarm, a session for vehicle 1, and the endpoints that reach it.
fn hub(test: &str) -> (SwarmName, Session, Vec<String>) {
    let swarm = SwarmName::new(format!("run-{test}-{}", process::id())).unwrap();
    let session = link::open_zenoh(&swarm, &["tcp/127.0.0.1:0".to_owned()], &[], &[]).unwrap();
    let locators = session.info().locators().wait().iter().map(ToString::to_string).collect();
    (swarm, session, locators)
}

/// Returns a function that gives the new messages of one kind.
fn listen<M: Message>(observer: &Session, key: &'static str) -> impl FnMut() -> Vec<M> + use<M> {
    let mut samples = samples(observer, key);
    move || samples().iter().map(|sample| decode(&sample.payload().to_bytes()).unwrap()).collect()
}

#[test]
fn two_agents_find_each_other_become_active_and_land_on_request() {
    let tokio = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let (swarm, session, mut dial) = hub("two");
    let one = Flight::begin(node(&swarm, 1), session, &tokio);
    let second = link::open_zenoh(&swarm, &["tcp/127.0.0.1:0".to_owned()], &dial, &[]).unwrap();
    dial.extend(second.info().locators().wait().iter().map(ToString::to_string));
    let observer = link::open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    let mut events = listen::<Event>(&observer, all::EVENTS);
    let mut healths = listen::<Health>(&observer, all::HEALTH);
    let mut traces = listen::<Trace>(&observer, all::TRACES);
    let mut summaries = listen::<Summary>(&observer, all::SUMMARIES);
    let begin = now();
    let two = Flight::begin(node(&swarm, 2), second, &tokio);

    let mut recorded: Vec<Event> = Vec::new();
    let has = |recorded: &[Event], number: u8, what| {
        recorded.iter().any(|event| event.header.sender.get() == number && event.what == what)
    };
    wait_until("two members", || {
        recorded.extend(events());
        has(&recorded, 1, EventKind::BecameActive) && has(&recorded, 2, EventKind::BecameActive)
    });
    assert!(now() < begin + Duration::from_secs(5));
    for number in [1, 2] {
        let other = VehicleId::new(3 - number).unwrap();
        assert!(has(&recorded, number, EventKind::PeerFound(other)), "{recorded:?}");
    }

    let (mut health, mut trace): (Vec<Health>, Vec<Trace>) = (Vec::new(), Vec::new());
    wait_until("health and traces of both", || {
        health.extend(healths());
        trace.extend(traces());
        [1, 2].iter().all(|&number| {
            let of_both = |message: &Health| {
                message.header.sender.get() == number && message.peers.first().is_some_and(|peer| peer.clock.is_some())
            };
            health.iter().any(of_both) && trace.iter().any(|message| message.header.sender.get() == number)
        })
    });
    let last = health.last().unwrap();
    assert_eq!((last.plant.as_str(), last.drops.total()), ("builtin", 0));
    assert!(last.frame_rate_hz > 25.0 && last.step_p50_us > 0.0 && last.step_p50_us <= last.step_p99_us, "{last:?}");
    assert_eq!(last.peers[0].standing, PeerStatus::Fresh);
    let clocks: Vec<_> = health.iter().filter_map(|message| message.peers.first()?.clock).collect();
    assert!(clocks.iter().all(|clock| clock.offset_s.abs() <= clock.bound_s && clock.bound_s < 0.5), "{clocks:?}");
    assert!(
        last.failures.is_empty() && last.refused.is_empty() && last.version == env!("CARGO_PKG_VERSION"),
        "{last:?}"
    );
    let of_one = trace.iter().filter(|message| message.header.sender.get() == 1);
    let sequence: Vec<u64> = of_one.map(|message| message.header.sequence).collect();
    assert!(sequence.windows(2).all(|pair| pair[0] < pair[1]));
    assert!(trace.iter().all(|message| message.step_us.is_some() || message.header.sequence == 1));
    assert_summarised(&summaries(), &trace);

    one.stop.request();
    two.stop.request();
    one.end();
    two.end();
    recorded.extend(events());
    assert!(has(&recorded, 1, EventKind::Landed) && has(&recorded, 2, EventKind::Landed), "{recorded:?}");
    let last = summaries();
    for number in [1, 2] {
        let shown =
            last.iter().rfind(|summary| summary.header.sender.get() == number).map(|summary| summary.facts.activity);
        assert_eq!(shown, Some(Activity::Landed), "the last summary of vehicle {number}");
    }
}

/// Summaries of vehicle 1 are sent at most ten times a second, and at a new activity, and show what its traces do, by its own
/// estimate.
fn assert_summarised(summaries: &[Summary], traces: &[Trace]) {
    let is_of_one = |header: &Header| header.sender.get() == 1;
    let of_one: Vec<_> = summaries.iter().filter(|summary| is_of_one(&summary.header)).collect();
    assert!(of_one.len() > 5, "{summaries:?}");
    let seconds = |summary: &Summary| summary.header.stamp.nanoseconds() as f64 * 1e-9;
    let elapsed_s = seconds(of_one[of_one.len() - 1]) - seconds(of_one[0]);
    let changes = of_one.windows(2).filter(|pair| pair[0].facts.activity != pair[1].facts.activity).count();
    // One that was late is made up for.
    let at_most = 2.0 + 10.0 * elapsed_s + changes as f64;
    assert!(of_one.len() as f64 <= at_most, "{} in {elapsed_s} s with {changes} new activities", of_one.len());
    let compared = of_one.iter().filter_map(|summary| {
        let trace = traces.iter().find(|trace| is_of_one(&trace.header) && trace.plant_time == summary.plant_time)?;
        let position = summary.facts.position?;
        assert!((position - trace.estimate).amax() <= 0.000_501, "{summary:?}\n{trace:?}");
        assert_eq!(
            (summary.facts.activity, summary.facts.step, summary.facts.live),
            (trace.activity, trace.step, trace.live)
        );
        assert_eq!(summary.facts.flown_s.is_some(), trace.membership == Membership::Active);
        assert_eq!(summary.facts.controls.is_some(), trace.controls.is_some(), "{summary:?}\n{trace:?}");
        let ids = |peers: &[PeerAge]| peers.iter().map(|peer| peer.id).collect::<Vec<_>>();
        assert_eq!(summary.facts.peers.iter().map(|peer| peer.id).collect::<Vec<_>>(), ids(&trace.peers));
        Some(summary)
    });
    assert!(compared.count() > 5, "no trace of the same frames");
    let last = &of_one[of_one.len() - 1].facts;
    assert!(last.process.is_some_and(|process| process.frame_rate_hz > 25.0) && !last.peers.is_empty(), "{last:?}");
}

#[test]
fn a_cut_in_the_scenario_separates_two_agents_until_it_ends() {
    let tokio = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let (swarm, session, mut dial) = hub("cut");
    let [one, two] = [1, 2].map(|number| {
        let mut node = node(&swarm, number);
        let [one, two] = [1, 2].map(|number| vec![VehicleId::new(number).unwrap()]);
        let cut = Fault::Cut { from: one, to: two, both_ways: false };
        node.scenario.mission.events =
            vec![scenario::ScriptedEvent { at_s: 1.0, for_s: Some(2.0), what: EventAction::Fault(cut) }];
        (node.scenario.network.loss, node.scenario.network.delay_s) = (0.1, 0.1);
        node
    });
    let second = link::open_zenoh(&swarm, &["tcp/127.0.0.1:0".to_owned()], &dial, &[]).unwrap();
    dial.extend(second.info().locators().wait().iter().map(ToString::to_string));
    let observer = link::open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    let mut events = listen::<Event>(&observer, all::EVENTS);
    let flights = [Flight::begin(one, session, &tokio), Flight::begin(two, second, &tokio)];
    let mut recorded: Vec<(Instant, Event)> = Vec::new();
    for number in [1, 2] {
        let other = VehicleId::new(3 - number).unwrap();
        let mut when = |what, nth: usize| {
            let mut at = None;
            wait_until(&format!("{number}: {what}"), || {
                recorded.extend(events().into_iter().map(|event| (now(), event)));
                let mut its =
                    recorded.iter().filter(|(_, event)| event.header.sender.get() == number && event.what == what);
                at = its.nth(nth).map(|(at, _)| *at);
                at.is_some()
            });
            at.unwrap()
        };
        let (member, lost) = (when(EventKind::BecameActive, 0), when(EventKind::PeerLost(other), 0));
        let back = when(EventKind::PeerFound(other), 1);
        // Lost: the lease and the delay after the cut. Found again: at least one retry after its end. Half a second for
        // the event to reach this test.
        assert!(lost > member + Duration::from_millis(1_600), "{:?}", lost - member);
        assert!(back > lost + Duration::from_millis(700), "{:?}", back - lost);
    }
    for flight in flights {
        flight.stop.request();
        flight.stop.request();
        flight.end();
    }
}

#[test]
fn an_agent_publishes_ages_that_include_the_delay_of_the_network() {
    let tokio = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let (swarm, session, mut dial) = hub("delayed");
    let [one, two] = [1, 2].map(|number| {
        let mut node = node(&swarm, number);
        node.scenario.network.delay_s = 2.0;
        node.scenario.vehicle[1].clock_offset_s = -7200.0;
        node
    });
    let second = link::open_zenoh(&swarm, &["tcp/127.0.0.1:0".to_owned()], &dial, &[]).unwrap();
    dial.extend(second.info().locators().wait().iter().map(ToString::to_string));
    let observer = link::open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    let mut healths = listen::<Health>(&observer, all::HEALTH);
    let mut traces = listen::<Trace>(&observer, all::TRACES);
    let flights = [Flight::begin(one, session, &tokio), Flight::begin(two, second, &tokio)];
    let (mut health, mut oldest_s): (Vec<Health>, [f64; 2]) = (Vec::new(), [0.0; 2]);
    wait_until("the round trip in the ages of both", || {
        health.extend(healths());
        for step in traces() {
            let oldest_s = &mut oldest_s[usize::from(step.header.sender.get()) - 1];
            *oldest_s = step.peers.iter().map(|peer| peer.age_s).fold(*oldest_s, f64::max);
        }
        [1, 2].iter().all(|&number| {
            let mut its = health.iter().filter(|message| message.header.sender.get() == number);
            its.any(|message| message.peers.iter().any(|peer| peer.delay_s.is_some()))
        }) && oldest_s.iter().all(|age_s| *age_s >= 4.0)
    });
    let peers = || health.iter().flat_map(|message| &message.peers);
    for peer in peers().filter(|peer| peer.standing != PeerStatus::Lost) {
        let Some(delay_s) = peer.delay_s else { continue };
        assert!((4.0..5.0).contains(&delay_s) && peer.age_s >= delay_s, "{peer:?}");
        assert_eq!(peer.standing, PeerStatus::Stale);
    }
    assert!(peers().any(|peer| peer.delay_s.is_none()), "the delay is unknown before the first round trip");
    for flight in flights {
        flight.stop.request();
        flight.stop.request();
        flight.end();
    }
}

#[test]
fn a_delay_that_starts_in_flight_increases_the_ages_and_loses_no_peer() {
    let tokio = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let (swarm, session, mut dial) = hub("slower");
    let [one, two] = [1, 2].map(|number| {
        let mut node = node(&swarm, number);
        let [from, to] = [1, 2].map(|number| vec![VehicleId::new(number).unwrap()]);
        let delay = Fault::Delay { from, to, both_ways: true, delay_s: 0.6 };
        node.scenario.mission.events =
            vec![scenario::ScriptedEvent { at_s: 3.0, for_s: Some(4.0), what: EventAction::Fault(delay) }];
        node
    });
    let second = link::open_zenoh(&swarm, &["tcp/127.0.0.1:0".to_owned()], &dial, &[]).unwrap();
    dial.extend(second.info().locators().wait().iter().map(ToString::to_string));
    let observer = link::open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    let mut traces = listen::<Trace>(&observer, all::TRACES);
    let mut events = listen::<Event>(&observer, all::EVENTS);
    let flights = [Flight::begin(one, session, &tokio), Flight::begin(two, second, &tokio)];
    // For each vehicle: time since its take-off, age and delivered age of the other's newest state, s.
    let mut ages: [Vec<(f64, f64, f64)>; 2] = [const { Vec::new() }; 2];
    let mut took_off_s = [None; 2];
    wait_until("ten seconds of flight", || {
        for step in traces() {
            let index = usize::from(step.header.sender.get()) - 1;
            let t_s = step.plant_time.seconds();
            if step.membership != Membership::Joining {
                let begins_s = *took_off_s[index].get_or_insert(t_s);
                ages[index].extend(step.peers.iter().map(|peer| (t_s - begins_s, peer.age_s, peer.delivered_age_s)));
            }
        }
        ages.iter().all(|ages| ages.last().is_some_and(|(t_s, ..)| *t_s > 10.0))
    });
    for ages in ages {
        let between = |from_s: f64, until_s: f64| {
            let them = ages.iter().filter(move |(t_s, ..)| (from_s..until_s).contains(t_s)).map(|(_, age_s, _)| *age_s);
            them.fold((f64::INFINITY, 0.0), |(least, most): (f64, f64), age_s| (least.min(age_s), most.max(age_s)))
        };
        assert!(between(1.0, 2.5).1 < 0.6, "before the delay {:?}", between(1.0, 2.5));
        // At least the one-way delay; at most the round trip, the period of the states and a margin for a busy
        // computer.
        let (least_s, most_s) = between(5.0, 6.5);
        assert!(least_s >= 0.6 && most_s < 2.2, "under the delay {least_s} to {most_s}");
        assert!(between(9.0, 10.0).1 < 0.6, "after the delay {:?}", between(9.0, 10.0));
        assert!(
            ages.iter().all(|(_, age_s, delivered_s)| age_s >= delivered_s),
            "a state is younger than its delivery: {ages:?}"
        );
    }
    assert!(!events().iter().any(|event| matches!(event.what, EventKind::PeerLost(_))));
    for flight in flights {
        flight.stop.request();
        flight.stop.request();
        flight.end();
    }
}

#[test]
fn network_impairments_and_clock_offsets_of_the_scenario_apply_to_real_agents() {
    let tokio = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let (swarm, session, mut dial) = hub("impaired");
    let [one, two] = [1, 2].map(|number| {
        let mut node = node(&swarm, number);
        node.scenario.network = Network {
            loss: 0.2,
            burst_s: Some(0.1),
            delay_s: 0.2,
            jitter_s: 0.3,
            reorder: 0.2,
            reorder_s: 0.4,
            duplicate: 0.3,
            bandwidth_bit_s: Some(1e6),
            range_m: Some(500.0),
            graph: Graph::Nearest,
            neighbours: 1,
            ..node.scenario.network
        };
        node.scenario.vehicle[1].clock_offset_s = -7200.0;
        node.scenario.vehicle[1].clock_drift_ppm = 100.0;
        node
    });
    let second = link::open_zenoh(&swarm, &["tcp/127.0.0.1:0".to_owned()], &dial, &[]).unwrap();
    dial.extend(second.info().locators().wait().iter().map(ToString::to_string));
    let observer = link::open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    let mut healths = listen::<Health>(&observer, all::HEALTH);
    let mut traces = listen::<Trace>(&observer, all::TRACES);
    let flights = [Flight::begin(one, session, &tokio), Flight::begin(two, second, &tokio)];
    let (mut steps, mut health): (Vec<Trace>, Vec<Health>) = (Vec::new(), Vec::new());
    let of = |header: &Header, number: u8| header.sender.get() == number;
    for number in [1, 2] {
        wait_until("two hundred steps of a member in contact that has dropped reordered messages", || {
            steps.extend(traces().into_iter().filter(|step| step.peers.first().is_some_and(|peer| peer.age_s < 3.0)));
            health.extend(healths());
            steps.iter().filter(|step| of(&step.header, number) && step.membership == Membership::Active).count() > 200
                && health.iter().any(|message| of(&message.header, number) && message.drops.old > 3)
        });
    }
    let named = |message: &Health| {
        message.refused.iter().any(|kind| kind.reason == Reason::Old && kind.key.starts_with("vehicle/"))
    };
    assert!(health.iter().filter(|message| message.drops.old > 3).all(named), "{health:?}");
    let late: Vec<f64> = steps.iter().map(|step| step.peers[0].delivered_age_s).collect();
    assert!(late.iter().all(|late_s| (0.2..=0.9 + 0.2).contains(late_s)), "{late:?}");
    let spread_s = late.iter().fold(0.0, |most: f64, late_s| most.max(*late_s)) - 0.2;
    assert!(spread_s > 0.1, "{spread_s} s of 0.3 s");
    // Neither vehicle learns the other's clock setting, and no age shows it.
    let hours = |number| steps.iter().rfind(|step| of(&step.header, number)).unwrap().header.stamp.seconds() / 3600.0;
    assert!((2.0..2.1).contains(&hours(1)) && (0.0..0.1).contains(&hours(2)), "{} and {}", hours(1), hours(2));
    assert!(health.iter().all(|message| message.uptime_s < 100.0), "{health:?}");
    for flight in flights {
        flight.stop.request();
        flight.stop.request();
        flight.end();
    }
}

#[test]
fn an_agent_whose_launcher_is_gone_flies_until_an_order_has_landed_it() {
    let tokio = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let (swarm, session, dial) = hub("order");
    let flight = Flight::begin(node(&swarm, 1), session, &tokio);
    flight.stop.abandon();
    let observer = link::open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    let mut events = listen::<Event>(&observer, all::EVENTS);
    let mut recorded: Vec<EventKind> = Vec::new();
    wait_until("a member", || {
        recorded.extend(events().iter().map(|event| event.what));
        recorded.contains(&EventKind::BecameActive)
    });
    assert!(!flight.thread.is_finished());
    let order = Order { epoch: 1, issuer: 5, verb: Verb::Land, vehicles: None, signature: None };
    observer.put(Topic::Order(order.issuer).key(), encode(&order)).wait().unwrap();
    flight.end();
    recorded.extend(events().iter().map(|event| event.what));
    assert!(recorded.contains(&EventKind::OrderTaken(order)) && recorded.contains(&EventKind::Landed), "{recorded:?}");
}

#[test]
fn an_invented_order_lands_no_vehicle_and_a_signed_one_does() {
    let tokio = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let (swarm, session, dial) = hub("signed");
    let operator = signing_key();
    let one = Node { orders_key: Some(operator.key()), run: 7, ..node(&swarm, 1) };
    let plan = one.scenario.plan_hash();
    let flight = Flight::begin(one, session, &tokio);
    flight.stop.abandon();
    let other = link::open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    let (mut events, mut healths) = (listen::<Event>(&other, all::EVENTS), listen::<Health>(&other, all::HEALTH));
    let mut missions = listen::<Heartbeat>(&other, all::MISSIONS);
    let mut recorded: Vec<EventKind> = Vec::new();
    let abort = Order { epoch: u64::MAX, issuer: 5, verb: Verb::Abort, vehicles: None, signature: None };
    let mut heartbeat = Heartbeat {
        header: Header {
            sender: VehicleId::new(2).unwrap(),
            incarnation: Incarnation(1),
            sequence: 0,
            stamp: SenderStamp::ZERO,
        },
        plan,
        membership: Membership::Active,
        step: 0,
        vouched: 0,
        reached: None,
        progress_m: 0.0,
        order: None,
        orders: 0,
        echo: None,
        lost: VehicleSet::default(),
    };
    let put = |topic: Topic, bytes: Vec<u8>| other.put(topic.key(), bytes).wait().unwrap();
    let mut named: Vec<Refused> = Vec::new();
    wait_until("a member that has refused an invented order and an order of an earlier run", || {
        heartbeat.header.sequence += 1;
        heartbeat.order = Some(abort);
        put(Topic::Mission(heartbeat.header.sender), encode(&heartbeat));
        put(Topic::Order(5), encode(&sign(&operator, &swarm, Branch::SWARM, 6, abort)));
        recorded.extend(events().iter().map(|event| event.what));
        named = healths().pop().map_or_else(|| named.clone(), |message| message.refused);
        let refused = |key: &str| named.iter().any(|kind| kind.reason == Reason::Unsealed && kind.key == key);
        recorded.contains(&EventKind::BecameActive) && refused("vehicle/2/mission") && refused("order")
    });
    assert!(!recorded.iter().any(|what| matches!(what, EventKind::OrderTaken(_))), "{recorded:?}");
    let heartbeats: Vec<_> = missions().into_iter().filter(|message| message.header.sender.get() == 1).collect();
    assert!(!heartbeats.is_empty() && heartbeats.iter().all(|message| message.order.is_none()), "{heartbeats:?}");

    // The order travels only in the other vehicle's heartbeat: it needs to reach just one vehicle.
    let land = Order { epoch: 1, issuer: 5, verb: Verb::Land, vehicles: None, signature: None };
    heartbeat.order = Some(sign(&operator, &swarm, Branch::SWARM, 7, land));
    wait_until("the order to be passed on", || {
        heartbeat.header.sequence += 1;
        put(Topic::Mission(heartbeat.header.sender), encode(&heartbeat));
        missions().iter().any(|message| message.header.sender.get() == 1 && message.order == heartbeat.order)
    });
    flight.end();
    recorded.extend(events().iter().map(|event| event.what));
    assert!(recorded.contains(&EventKind::OrderTaken(land)) && recorded.contains(&EventKind::Landed), "{recorded:?}");
}

#[test]
fn a_second_request_ends_at_once() {
    let tokio = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let (swarm, session, _) = hub("twice");
    let flight = Flight::begin(node(&swarm, 1), session, &tokio);
    flight.stop.request();
    flight.stop.request();
    let begin = now();
    flight.end();
    assert!(now() < begin + Duration::from_secs(3));
}

#[test]
fn without_a_simulator_the_agent_ends_on_request_without_landing() {
    let tokio = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let (swarm, session, _) = hub("no-simulator");
    // The port is in use, but never replies.
    let silent = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let plant = PlantChoice::Standin(silent.local_addr().unwrap());
    let flight = Flight::begin(Node { plant, ..node(&swarm, 1) }, session, &tokio);
    let mut request = [0; 64];
    silent.set_read_timeout(Some(TIMEOUT)).unwrap();
    silent.recv(&mut request).unwrap();
    assert!(!flight.thread.is_finished());
    flight.stop.request();
    flight.end();
}

#[test]
fn an_agent_without_its_launcher_ends_with_the_stated_duration() {
    let waits = |stop: &Stop| {
        let until = now() + TIMEOUT;
        while !stop.is_requested() && now() < until {
            sleep(Duration::from_millis(5));
        }
        stop.is_requested()
    };
    let stop = Arc::new(Stop::default());
    stop_on_input(io::empty(), stop.clone(), Some(Duration::from_millis(1)));
    assert!(waits(&stop) && stop.is_abandoned() && !stop.is_urgent());
    // The launcher's own request is not repeated, because a second one would end the agent before it has landed.
    let stop = Arc::new(Stop::default());
    stop_on_input(&b"stop\n"[..], stop.clone(), Some(Duration::ZERO));
    assert!(waits(&stop));
    let until = now() + TIMEOUT;
    while !stop.is_abandoned() && now() < until {
        sleep(Duration::from_millis(5));
    }
    assert!(!stop.is_urgent());
    // Without a stated duration it flies on.
    let stop = Arc::new(Stop::default());
    stop_on_input(io::empty(), stop.clone(), None);
    while !stop.is_abandoned() {
        sleep(Duration::from_millis(5));
    }
    assert!(!stop.is_requested());
}
