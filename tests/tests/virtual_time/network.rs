//! A swarm in virtual time over a bad network and with faults: flights are repeatable bit for bit, and peers notice
//! faults in time.

use skein_common::id::VehicleId;
use skein_common::message::{EventKind, Verb};
use skein_common::state::{Activity, Membership};
use skein_core::agent::Agent;
use skein_core::plant::GroundTruth;
use skein_lab::faults::InjectedFault;
use skein_lab::study::Study;
use skein_lab::world::World;
use skein_tests::study;

const FRAME_S: f64 = 0.02;

fn id(number: u8) -> VehicleId {
    VehicleId::new(number).unwrap()
}

/// Whether two times are the same tick.
fn near(one_s: f64, other_s: f64) -> bool {
    (one_s - other_s).abs() < 1e-6
}

/// A flight with a list of its faults and events.
struct Flight {
    world: World,
    /// Time at which all vehicles were active, s.
    zero_s: f64,
    /// Faults with their times since then, s.
    faults: Vec<(f64, InjectedFault)>,
    happened: Vec<(f64, VehicleId, EventKind)>,
}

impl Flight {
    /// Flies four vehicles in the hover with these events, until all are active.
    fn new(sets: &[&str], events: &str) -> Self {
        let list = format!("mission.events=[{events}]");
        let sets: Vec<_> = sets.iter().copied().chain((!events.is_empty()).then_some(list.as_str())).collect();
        let Study { scenario, aircraft, rules, .. } = study("hover.toml", &sets);
        let mut world = World::new(&scenario, &aircraft, &rules).unwrap();
        while !world.all_active() {
            world.tick();
        }
        let zero_s = world.t_s();
        Self { world, zero_s, faults: Vec::new(), happened: Vec::new() }
    }

    fn t_s(&self) -> f64 {
        self.world.t_s() - self.zero_s
    }

    fn until(&mut self, t_s: f64) {
        while self.t_s() < t_s {
            self.tick();
        }
    }

    fn tick(&mut self) {
        self.world.tick();
        let t_s = self.t_s();
        self.faults.extend(self.world.faults().iter().map(|fault| (t_s, fault.clone())));
        self.happened.extend(self.world.events().map(|(id, what)| (t_s, id, what)));
    }

    fn agent(&self, number: u8) -> Option<&Agent> {
        self.world.all_vehicles().find(|(of, ..)| *of == id(number)).and_then(|(_, agent, ..)| agent)
    }

    fn truth(&self, number: u8) -> GroundTruth {
        *self.world.all_vehicles().find(|(of, ..)| *of == id(number)).unwrap().2
    }

    /// Time of the only fault that satisfies the condition, s.
    fn done_s(&self, is_it: impl Fn(&InjectedFault) -> bool) -> f64 {
        let times: Vec<_> = self.faults.iter().filter(|(_, fault)| is_it(fault)).map(|(t_s, _)| *t_s).collect();
        assert_eq!(times.len(), 1, "{:?}", self.faults);
        times[0]
    }

    /// The vehicles that reported this event after `since_s`, with the time since then, s.
    fn reported(&self, what: EventKind, since_s: f64) -> Vec<(u8, f64)> {
        let reported = self.happened.iter().filter(|(t_s, _, event)| *event == what && *t_s >= since_s);
        reported.map(|(t_s, id, _)| (id.get(), t_s - since_s)).collect()
    }
}

/// All kinds of events.
const EVERYTHING: &str = "
    { at_s = 10, fault = 'kill', vehicle = 3, for_s = 3 },
    { at_s = 20, fault = 'cut', from = [1, 2], to = [3, 4], both_ways = true, for_s = 5 },
    { at_s = 30, fault = 'cut', from = [1], to = [2], for_s = 5 },
    { at_s = 35, fault = 'clock_jump', vehicle = 1, by_s = -7200 },
    { at_s = 36, fault = 'clock_jump', vehicle = 2, by_s = 3600, for_s = 4 },
    { at_s = 40, fault = 'simulator_freeze', vehicle = 4, for_s = 2 },
    { at_s = 45, fault = 'gps_frozen', vehicle = 2, for_s = 0.5 },
    { at_s = 50, order = 'hold', for_s = 5 },
    { at_s = 60, fault = 'engine_out', vehicle = 1 }";

#[test]
fn a_seed_gives_the_same_flight_bit_for_bit_over_a_bad_network_with_faults() {
    let sets = |seed: &'static str| ["network.loss=0.2", "network.delay_s=0.15", "world.gust_w20_m_s=3", seed];
    let [mut one, mut same, mut other] =
        ["seed=1", "seed=1", "seed=2"].map(|seed| Flight::new(&sets(seed), EVERYTHING));
    let bits = |flight: &Flight| {
        let bits = |number| {
            let truth = flight.truth(number);
            let (place, velocity): ([f64; 3], [f64; 3]) = (truth.position.into(), truth.velocity.into());
            (place.map(f64::to_bits), velocity.map(f64::to_bits), flight.agent(number).map(Agent::states_sent))
        };
        [1, 2, 3, 4].map(bits)
    };
    while one.t_s() < 80.0 {
        [&mut one, &mut same, &mut other].into_iter().for_each(Flight::tick);
        assert_eq!(bits(&one), bits(&same), "at {} s", one.t_s());
    }
    assert_eq!((&one.faults, &one.happened), (&same.faults, &same.happened));
    assert_ne!(one.happened, other.happened, "another seed");
    let kinds = |flight: &Flight| flight.faults.iter().map(|(_, fault)| fault.clone()).collect::<Vec<_>>();
    assert_eq!(kinds(&one), kinds(&other), "the scenario decides the faults, not the seed");
    assert_eq!(one.faults.len(), 11, "{:?}", one.faults);
}

#[test]
fn the_helicopter_of_a_killed_agent_flies_on_and_the_restarted_agent_takes_over() {
    for seed in ["seed=0", "seed=1", "seed=2"] {
        let mut flight = Flight::new(&[seed], "{ at_s = 60, fault = 'kill', vehicle = 3, for_s = 3 }");
        flight.until(59.9);
        let (before, controls) = (flight.truth(3), flight.world.vehicles().nth(2).unwrap().3);
        assert!(controls.is_some() && flight.world.vehicles().count() == 4);
        flight.until(62.9);
        assert!(near(flight.done_s(|fault| *fault == InjectedFault::Died(id(3))), 60.0));
        assert!(flight.agent(3).is_none() && flight.world.vehicles().count() == 3);
        assert_eq!(flight.world.all_vehicles().count(), 4);
        let after = flight.truth(3);
        assert!(after.height_m > 10.0 && after.position != before.position, "{after:?}");
        flight.until(63.0);
        let restarted_s = flight.done_s(|fault| *fault == InjectedFault::Restarted(id(3)));
        assert!(near(restarted_s, 63.0));
        assert_eq!(flight.agent(3).unwrap().membership(), Membership::Joining);
        flight.until(72.0);
        let [(3, active_s)] = flight.reported(EventKind::BecameActive, restarted_s)[..] else {
            panic!("{:?}", flight.happened)
        };
        assert!((2.0..3.0).contains(&active_s), "active {active_s} s after the restart");
        // The first messages of a new incarnation take at least a frame.
        let found = flight.reported(EventKind::PeerFound(id(3)), restarted_s);
        assert_eq!(found.len(), 3, "{found:?}");
        assert!(found.iter().all(|(_, found_s)| (FRAME_S..0.3).contains(found_s)), "{found:?}");
        let finds: Vec<_> = [1, 2, 4].map(|peer| flight.reported(EventKind::PeerFound(id(peer)), restarted_s)).concat();
        assert!(finds.len() == 3 && finds.iter().all(|(by, found_s)| *by == 3 && *found_s < 0.3), "{finds:?}");
        flight.until(120.0);
        let truth = flight.truth(3);
        assert!(
            (truth.height_m - 30.0).abs() < 2.0,
            "taken over at {:.1} m, at {:.1} m now",
            after.height_m,
            truth.height_m
        );
    }
}

/// A cut is noticed when the lease of its link is over, or when a peer was silent for as long: its last message came up to a
/// fifth of a second before the cut, s.
const CUT_NOTICED_S: std::ops::Range<f64> = 0.8..1.05;

#[test]
fn a_killed_agent_is_noticed_in_two_frames_and_a_cut_after_a_second() {
    let events = "{ at_s = 20, fault = 'kill', vehicle = 4, for_s = 10 },
                  { at_s = 50, fault = 'cut', from = [1], to = [2, 3], for_s = 5 },
                  { at_s = 70, fault = 'cut', from = [1, 2], to = [3, 4], both_ways = true, for_s = 5 }";
    let mut flight = Flight::new(&[], events);
    flight.until(20.5);
    let died_s = flight.done_s(|fault| *fault == InjectedFault::Died(id(4)));
    let lost = flight.reported(EventKind::PeerLost(id(4)), died_s);
    assert_eq!(lost.iter().map(|(by, _)| *by).collect::<Vec<_>>(), [1, 2, 3]);
    assert!(lost.iter().all(|(_, lost_s)| (0.01..0.03).contains(lost_s)), "{lost:?}");

    flight.until(49.0);
    let link = |sender, receiver| (id(sender), id(receiver));
    let one_way = vec![link(1, 2), link(1, 3)];
    flight.until(60.0);
    let cut_s = flight.done_s(|fault| *fault == InjectedFault::Cut { links: one_way.clone() });
    let healed_s = flight.done_s(|fault| *fault == InjectedFault::Healed { links: one_way.clone() });
    assert!(near(cut_s, 50.0) && near(healed_s, 55.0));
    // A session is lost in both directions: vehicle 1 also loses the peers that do not receive its messages.
    for (lost, by) in [(1, vec![2, 3]), (2, vec![1]), (3, vec![1]), (4, vec![])] {
        let lost = flight.reported(EventKind::PeerLost(id(lost)), cut_s);
        assert_eq!(lost.iter().map(|(by, _)| *by).collect::<Vec<_>>(), by);
        assert!(lost.iter().all(|(_, lost_s)| CUT_NOTICED_S.contains(lost_s)), "{lost:?}");
    }
    let found = [1, 2, 3, 4].map(|peer| flight.reported(EventKind::PeerFound(id(peer)), healed_s)).concat();
    assert_eq!(found.len(), 4, "{found:?}");
    assert!(found.iter().all(|(_, found_s)| (0.2..1.05).contains(found_s)), "{found:?}");

    flight.until(80.0);
    let is_partition =
        |(_, fault): &&(f64, InjectedFault)| matches!(fault, InjectedFault::Cut { links } if links.len() == 8);
    let cut_s = flight.faults.iter().find(is_partition).unwrap().0;
    let lost = [1, 2, 3, 4].map(|peer| flight.reported(EventKind::PeerLost(id(peer)), cut_s)).concat();
    assert_eq!(lost.len(), 8);
    assert!(lost.iter().all(|(_, lost_s)| CUT_NOTICED_S.contains(lost_s)), "{lost:?}");
}

#[test]
fn a_restarted_agent_receives_an_order_given_while_it_was_down() {
    let events = "{ at_s = 20, fault = 'kill', vehicle = 2, for_s = 5 }, { at_s = 22, order = 'hold' }";
    let mut flight = Flight::new(&[], events);
    flight.until(28.0);
    let orders = |flight: &Flight, verb| {
        let taken = |(t_s, by, what): &(f64, VehicleId, EventKind)| match what {
            EventKind::OrderTaken(order) if order.verb == verb => Some((by.get(), *t_s)),
            _ => None,
        };
        flight.happened.iter().filter_map(taken).collect::<Vec<_>>()
    };
    let taken = orders(&flight, Verb::Hold);
    assert_eq!(taken.iter().map(|(by, _)| *by).collect::<Vec<_>>(), [1, 3, 4, 2]);
    assert!(taken[..3].iter().all(|(_, t_s)| near(*t_s, 22.02)), "{taken:?}");
    assert!(near(taken[3].1, 25.02), "{taken:?}");
    assert!([1, 2, 3, 4].iter().all(|&number| flight.agent(number).unwrap().activity() == Activity::Holding));
}

#[test]
fn a_hold_reaches_every_vehicle_over_a_bad_network_and_ends() {
    let mut flight =
        Flight::new(&["network.loss=0.6", "network.delay_s=0.3"], "{ at_s = 30, order = 'hold', for_s = 10 }");
    flight.until(35.0);
    assert!(flight.world.vehicles().all(|(_, agent, ..)| agent.activity() == Activity::Holding));
    flight.until(45.0);
    assert!(flight.world.vehicles().all(|(_, agent, ..)| agent.activity() == Activity::Formation));
}

#[test]
fn a_frozen_simulator_stops_while_the_others_fly() {
    let mut flight = Flight::new(&[], "{ at_s = 10, fault = 'simulator_freeze', vehicle = 2, for_s = 4 }");
    flight.until(10.1);
    let (frozen, free) = (flight.truth(2), flight.truth(1));
    assert!(frozen.velocity.0.norm() > 0.5, "the vehicle was moving");
    flight.until(13.9);
    assert_eq!(flight.truth(2), frozen);
    assert_ne!(flight.truth(1), free);
    assert!(near(flight.done_s(|fault| *fault == InjectedFault::Failed(id(2), "simulator_freeze")), 10.0));
    assert!(flight.agent(2).is_some());
    flight.until(14.5);
    assert_ne!(flight.truth(2), frozen);
}

#[test]
fn a_clock_jump_changes_no_flight() {
    let jumps = "{ at_s = 20, fault = 'clock_jump', vehicle = 2, by_s = 3600 },
                 { at_s = 25, fault = 'clock_jump', vehicle = 2, by_s = -100000, for_s = 10 }";
    let [mut steady, mut jumping] = ["", jumps].map(|events| Flight::new(&[], events));
    steady.until(40.0);
    jumping.until(40.0);
    let reported = jumping.reported(EventKind::ClockJumped, 0.0);
    assert_eq!(reported.iter().map(|(by, _)| *by).collect::<Vec<_>>(), [2, 2, 2]);
    for number in [1, 2, 3, 4] {
        let apart_m = (steady.truth(number).position - jumping.truth(number).position).norm();
        assert!(apart_m < 0.5, "vehicle {number} is {apart_m} m from its position without the jump");
        assert!(jumping.reported(EventKind::PeerLost(id(number)), 0.0).is_empty());
    }
}

#[test]
fn a_study_ends_with_the_mission_or_after_its_duration() {
    let ends_s = |sets: &[&str]| study("hover.toml", sets).fly(1).unwrap().duration_s;
    let steps = "mission.steps=[{ centre_ne_m = [0, 0] }, { land = true }]";
    let early_s = ends_s(&[steps]);
    assert!((20.0..300.0).contains(&early_s), "{early_s} s");
    assert!((ends_s(&[steps, "duration_s=15"]) - 15.0).abs() < 1e-9);
    let abort_s = ends_s(&["mission.events=[{ at_s = 30, order = 'abort' }]"]);
    assert!((30.0..30.2).contains(&abort_s), "{abort_s} s");
}
