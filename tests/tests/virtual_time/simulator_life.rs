//! An agent's life with a real simulator, in virtual time over the bytes of the protocol: one of four simulators is paused,
//! killed, reset, put into replay. Its agent has the controls again within two seconds of the simulator's return, the ring
//! is even again, and the other three never stop.

use skein_agent::plant::xplane::client::RANDOM_FAILURES;
use skein_agent::plant::xplane::server::DEFAULT_ACF;
use skein_common::message::{EventKind, ShortText, SimulatorFault, Standstill};
use skein_common::scenario::Scenario;
use skein_common::state::Membership;
use skein_core::aircraft::{Aircraft, Dataref};
use skein_lab::metrics::largest_gap_deviation_rad;
use skein_tests::scenario;
use skein_tests::wire::{Frames, Swarm};

const CELL: Frames = Frames { rate: 50, jitter: 0.2, drop: 0.02 };
/// The vehicle whose simulator has the fault, counted from 0.
const VICTIM: usize = 1;
/// When the fault begins: the ring is even, s.
const FAULT_S: f64 = 100.0;
/// Longest time until the controls are held again, s.
const CONTROLS_WITHIN_S: f64 = 2.0;
/// Longest time until the ring is even again, s: the limit of the default ring.
const EVEN_WITHIN_S: f64 = 120.0;
/// Largest change of roll or pitch from one command to the next, as a share of full deflection: that of a take-off.
const LARGEST_STEP: f64 = 0.25;
/// A mission whose centre moves at 2 m/s.
const MOVING: &str = "mission.steps=[{ path_ne_m = [[0, 0], [300, 0]] }]";
/// Distance below which two vehicles are too close, m.
const CLOSEST_M: f64 = 10.0;

struct Flown {
    /// Time from the simulator's return to the first control, s.
    controls_s: f64,
    /// Time from there to the even ring, s.
    even_s: f64,
    /// Largest step of the cyclic of any vehicle, before and after the fault.
    steps: [f64; 2],
    closest_m: f64,
    /// Largest distance that the victim moved while its simulator was away, m.
    moved_m: f64,
    events: Vec<EventKind>,
}

fn four() -> Scenario {
    Scenario { seed: 3, ..scenario("hover.toml", &[]) }
}

/// Flies a ring, begins a fault, ends it `away_s` later, and flies on until the ring is even.
fn fly(begin: impl Fn(&mut Swarm), away_s: f64, end: impl Fn(&mut Swarm)) -> Flown {
    fly_in(Swarm::new(&four(), CELL), begin, away_s, end)
}

/// The same with these simulators.
fn fly_in(mut swarm: Swarm, begin: impl Fn(&mut Swarm), away_s: f64, end: impl Fn(&mut Swarm)) -> Flown {
    let mut closest_m = f64::MAX;
    let mut run_for = |swarm: &mut Swarm, for_s: f64| {
        let until_s = swarm.now().seconds() + for_s;
        while swarm.now().seconds() < until_s {
            swarm.run();
            closest_m = closest_m.min(closest(swarm));
            others_never_stop(swarm);
        }
    };
    run_for(&mut swarm, FAULT_S);
    assert!(gap_deg(&swarm) < 10.0, "the ring is even before the fault: {} deg", gap_deg(&swarm));
    let before = largest_step(&swarm);
    let (from, events) = (swarm.place(VICTIM).0, swarm.events.len());
    begin(&mut swarm);
    run_for(&mut swarm, away_s);
    let moved_m = (swarm.place(VICTIM).0 - from).norm();
    let returned = swarm.now();
    end(&mut swarm);
    while swarm.commanded(VICTIM).is_none_or(|at| at <= returned) {
        run_for(&mut swarm, 0.02);
        assert!(swarm.now().seconds_since(returned) < 30.0, "no controls: {:?}", &swarm.events[events..]);
    }
    let controls_s = swarm.now().seconds_since(returned);
    while !is_even(&swarm) {
        run_for(&mut swarm, 0.5);
        assert!(swarm.now().seconds_since(returned) < 400.0, "never even: {:?}", &swarm.events[events..]);
    }
    let even_s = swarm.now().seconds_since(returned);
    let victim = skein_common::id::VehicleId::new(VICTIM as u8 + 1).unwrap();
    let own = swarm.events[events..].iter().filter(|(_, id, _)| *id == victim).map(|(_, _, what)| *what);
    Flown { controls_s, even_s, steps: [before, largest_step(&swarm)], closest_m, moved_m, events: own.collect() }
}

/// Every other vehicle was commanded in the last tenth of a second, from the time on when the ring is even.
fn others_never_stop(swarm: &Swarm) {
    if swarm.now().seconds() < FAULT_S {
        return;
    }
    for nth in (0..4).filter(|nth| *nth != VICTIM) {
        let age_s = swarm.commanded(nth).map(|at| swarm.now().seconds_since(at));
        assert!(age_s.is_some_and(|age_s| age_s < 0.2), "vehicle {} has stopped: {age_s:?}", nth + 1);
    }
}

fn largest_step(swarm: &Swarm) -> f64 {
    (0..4).flat_map(|nth| swarm.largest_step(nth)).fold(0.0, f64::max)
}

fn closest(swarm: &Swarm) -> f64 {
    let places: Vec<_> = (0..4).map(|nth| swarm.place(nth)).filter(|(_, height_m)| *height_m > 2.0).collect();
    let pairs = places.iter().enumerate().flat_map(|(nth, one)| places[..nth].iter().map(move |other| (one, other)));
    pairs.map(|(one, other)| (one.0 - other.0).norm()).fold(f64::MAX, f64::min)
}

/// Largest deviation of an angular gap from 90 degrees, degrees.
fn gap_deg(swarm: &Swarm) -> f64 {
    let centre = swarm.agent(0).centre_ne_m();
    let bearing = |nth| {
        let from_centre = swarm.place(nth).0.0.xy() - centre;
        skein_common::math::atan2(from_centre.y, from_centre.x)
    };
    let mut bearings: Vec<f64> = (0..4).map(bearing).collect();
    largest_gap_deviation_rad(&mut bearings).unwrap().to_degrees()
}

/// Whether all vehicles are at their altitude, in the band and evenly spaced.
fn is_even(swarm: &Swarm) -> bool {
    let centre = swarm.agent(0).centre_ne_m();
    let in_band = (0..4).all(|nth| {
        let (place, height_m) = swarm.place(nth);
        (80.0..=120.0).contains(&(place.0.xy() - centre).norm()) && height_m > 25.0
    });
    in_band && swarm.all_active() && gap_deg(swarm) < 10.0
}

fn keeps_its_limits(what: &str, flown: &Flown) {
    let Flown { controls_s, even_s, steps: [before, after], closest_m, moved_m, events } = flown;
    println!(
        "{what}: controls after {controls_s:.2} s, even after {even_s:.1} s, closest {closest_m:.1} m, moved {moved_m:.1} m, \
         largest step of the cyclic {after:.2} ({before:.2} before), {events:?}"
    );
    assert!(*even_s < EVEN_WITHIN_S, "{what}: even after {even_s} s");
    assert!(*after < LARGEST_STEP, "{what}: {after}");
    assert!(*closest_m > CLOSEST_M, "{what}: {closest_m} m");
    assert!(events.contains(&EventKind::OwnDataBack), "{what}: {events:?}");
}

fn stopped(why: Standstill) -> EventKind {
    EventKind::SimulatorStopped(why)
}

#[test]
fn a_paused_simulator_is_waited_for() {
    let flown = fly(
        |swarm| swarm.command(VICTIM, "sim/operation/pause_on"),
        10.0,
        |swarm| {
            swarm.command(VICTIM, "sim/operation/pause_off");
        },
    );
    keeps_its_limits("paused 10 s", &flown);
    assert!(flown.controls_s < CONTROLS_WITHIN_S && flown.moved_m < 1.0);
    assert!(flown.events.contains(&stopped(Standstill::Paused)));
}

#[test]
fn a_replay_is_not_flown() {
    let flown = fly(
        |swarm| swarm.write(VICTIM, "skein/standin/replay", 1.0),
        10.0,
        |swarm| {
            swarm.write(VICTIM, "skein/standin/replay", 0.0);
        },
    );
    keeps_its_limits("replay 10 s", &flown);
    assert!(flown.controls_s < CONTROLS_WITHIN_S && flown.moved_m < 1.0);
    assert!(flown.events.contains(&stopped(Standstill::InReplay)));
}

#[test]
fn a_simulator_that_hangs_flies_on_when_it_is_back() {
    let flown = fly(|swarm| swarm.write(VICTIM, "skein/standin/freeze_s", 5.0), 5.0, |_| {});
    keeps_its_limits("frozen 5 s", &flown);
    assert!(flown.controls_s < CONTROLS_WITHIN_S);
}

#[test]
fn a_simulator_that_was_killed_and_started_again_takes_off_again() {
    let flown = fly(|swarm| swarm.write(VICTIM, "skein/standin/restart_s", 5.0), 5.0, |_| {});
    keeps_its_limits("killed, back after 5 s", &flown);
    assert!(flown.controls_s < CONTROLS_WITHIN_S);
}

#[test]
fn an_aircraft_that_is_reset_takes_off_again() {
    let flown = fly(|swarm| swarm.command(VICTIM, "sim/operation/reset_flight"), 0.1, |_| {});
    keeps_its_limits("reset", &flown);
    assert!(flown.controls_s < CONTROLS_WITHIN_S);
    assert!(flown.events.contains(&stopped(Standstill::Placed)));
}

#[test]
fn a_crashed_aircraft_is_waited_for_until_its_reset() {
    let flown = fly(
        |swarm| swarm.write(VICTIM, "skein/standin/crash", 1.0),
        5.0,
        |swarm| {
            swarm.command(VICTIM, "sim/operation/reset_flight");
        },
    );
    keeps_its_limits("crashed, reset after 5 s", &flown);
    assert!(flown.controls_s < CONTROLS_WITHIN_S);
    assert!(flown.events.contains(&stopped(Standstill::Crashed)));
}

/// Four simulators, and an aircraft file that names their aircraft.
fn with_named_aircraft() -> Swarm {
    let mut aircraft = Aircraft::shipped("xcell60").unwrap().unwrap();
    aircraft.xplane.acf = Some("xcell60".to_owned());
    Swarm::of(&four(), CELL, &aircraft, DEFAULT_ACF)
}

#[test]
fn an_aircraft_that_is_loaded_again_in_the_air_flies_on_and_rejoins() {
    let flown = fly_in(with_named_aircraft(), |swarm| swarm.load(VICTIM, DEFAULT_ACF), 3.1, |_| {});
    keeps_its_limits("loaded again", &flown);
    assert!(flown.controls_s < CONTROLS_WITHIN_S);
    for expected in [EventKind::SimulatorLost, EventKind::BecameActive] {
        assert!(flown.events.contains(&expected), "{:?}", flown.events);
    }
}

/// Path of an aircraft that the aircraft file is not for.
const OTHER: &str = "Aircraft/Laminar Research/R22/R22.acf";

/// Another aircraft was loaded 20 s ago: its pilot has the controls. Loads the right one, at its start.
fn load_the_right_one(swarm: &mut Swarm, given_back_for_s: f64) {
    let age_s = swarm.commanded(VICTIM).map(|at| swarm.now().seconds_since(at));
    assert!(age_s.is_some_and(|age_s| age_s > given_back_for_s), "it still writes the controls: {age_s:?}");
    assert!(swarm.read(VICTIM, "sim/operation/override/override_joystick") == 0.0, "the pilot has no controls");
    assert_eq!(swarm.agent(VICTIM).membership(), Membership::Joining, "the swarm does not wait for it");
    swarm.load(VICTIM, DEFAULT_ACF);
    swarm.command(VICTIM, "sim/operation/reset_flight");
}

#[test]
fn another_aircraft_is_left_to_its_pilot_until_the_right_one_is_back() {
    let flown =
        fly_in(with_named_aircraft(), |swarm| swarm.load(VICTIM, OTHER), 20.0, |swarm| load_the_right_one(swarm, 14.0));
    keeps_its_limits("another aircraft for 20 s", &flown);
    assert!(flown.events.contains(&stopped(Standstill::OtherAircraft(ShortText::of(OTHER)))), "{:?}", flown.events);
    // Loading takes 3 s, and its path is read anew.
    assert!(flown.controls_s < 3.0 + 2.0 + CONTROLS_WITHIN_S);
}

/// X-Plane sends its frames as before, and the aircraft stays in its place: only its path is another one.
#[test]
fn a_swap_of_the_aircraft_that_stops_no_frame_is_noticed_within_two_seconds() {
    let flown = fly_in(
        with_named_aircraft(),
        |swarm| {
            swarm.write(VICTIM, "skein/standin/load_s", 0.0);
            swarm.load(VICTIM, OTHER);
        },
        20.0,
        |swarm| load_the_right_one(swarm, 18.0),
    );
    keeps_its_limits("another aircraft without a stall", &flown);
    assert!(flown.events.contains(&stopped(Standstill::OtherAircraft(ShortText::of(OTHER)))), "{:?}", flown.events);
    assert!(!flown.events.contains(&EventKind::SimulatorLost), "frames never stop: {:?}", flown.events);
    assert!(flown.controls_s < 2.0 + CONTROLS_WITHIN_S);
}

#[test]
fn faults_of_the_simulators_set_up_are_reported_by_name_and_do_not_ground_the_vehicle() {
    const MISSING: &str = "laminar/s76/collective";
    let mut aircraft = Aircraft::shipped("xcell60").unwrap().unwrap();
    aircraft.xplane.hold.insert(Dataref::new(MISSING).unwrap(), 1.0);
    let mut swarm = Swarm::of(&four(), CELL, &aircraft, DEFAULT_ACF);
    swarm.run_until(30.0);
    swarm.write(VICTIM, RANDOM_FAILURES[0], 1.0);
    swarm.run_until(40.0);
    let faults = |nth: u8| -> Vec<SimulatorFault> {
        let own = swarm.events.iter().filter(|(_, id, _)| id.get() == nth + 1);
        own.filter_map(|(_, _, what)| if let EventKind::SimulatorFault(fault) = what { Some(*fault) } else { None })
            .collect()
    };
    let missing = SimulatorFault::NoDataref(ShortText::of(MISSING));
    assert_eq!(
        faults(VICTIM as u8),
        [missing, SimulatorFault::RandomFailures],
        "each once, and the second when it is turned on"
    );
    assert_eq!(faults(0), [missing]);
    assert!(swarm.place(VICTIM).1 > 25.0, "it flies all the same");
}

#[test]
fn ground_far_from_the_origins_elevation_is_reported_and_does_not_ground_the_vehicle() {
    let found = |off_m: f64| {
        let mut swarm = Swarm::on_ground(&four(), CELL, off_m);
        swarm.run_until(40.0);
        assert!(swarm.place(VICTIM).1 > 15.0, "it flies all the same: {} m", swarm.place(VICTIM).1);
        let faults = swarm.events.iter().filter_map(|(_, id, what)| match what {
            EventKind::SimulatorFault(fault) => Some((id.get(), *fault)),
            _ => None,
        });
        let mut faults: Vec<_> = faults.collect();
        faults.sort_unstable_by_key(|(id, _)| *id);
        faults
    };
    assert_eq!(found(10.0), []);
    assert_eq!(found(-20.0), [1, 2, 3, 4].map(|id| (id, SimulatorFault::GroundOffOrigin(-20))));
}

#[test]
fn every_simulator_draws_its_agents_peers_where_they_are() {
    let mut swarm = Swarm::new(&scenario("hover.toml", &["plant.show_peers=19", MOVING]), CELL);
    let speed_m_s = |swarm: &Swarm| swarm.agent(0).centre_velocity_ne_m_s().norm();
    while speed_m_s(&swarm) < 1.9 {
        swarm.run();
        assert!(swarm.now().seconds() < 200.0, "the centre does not move: {:?}", swarm.events);
    }
    // Until the ring is even its vehicles are faster than its centre.
    let from_s = swarm.now().seconds() + 60.0;
    swarm.run_until(from_s);
    let until_s = from_s + 40.0;
    let mut largest_m: f64 = 0.0;
    while swarm.now().seconds() < until_s {
        swarm.run();
        let vehicles = swarm.vehicles();
        for nth in 0..vehicles {
            let drawn = swarm.drawn(nth);
            assert_eq!(drawn.len(), vehicles - 1);
            for peer in (0..vehicles).filter(|peer| *peer != nth) {
                let (place, _) = swarm.place(peer);
                let nearest_m = drawn.iter().map(|drawn| (*drawn - place).norm()).fold(f64::MAX, f64::min);
                largest_m = largest_m.max(nearest_m);
            }
        }
    }
    assert!(speed_m_s(&swarm) > 1.9, "the centre still moves");
    println!("peers are drawn within {largest_m:.2} m of their places");
    assert!(largest_m < 0.5, "{largest_m} m");
}

#[test]
fn a_moved_local_origin_changes_nothing() {
    let scenario = Scenario { seed: 3, ..scenario("hover.toml", &[]) };
    let places = |moved: bool| {
        let mut swarm = Swarm::new(&scenario, CELL);
        swarm.run_until(60.0);
        if moved {
            swarm.write(VICTIM, "skein/standin/move_origin", 1.0);
        }
        swarm.run_until(90.0);
        swarm.place(VICTIM).0
    };
    // The order is a datagram more, so that other datagrams are lost.
    assert!((places(true) - places(false)).norm() < 0.5);
}

#[test]
fn with_fewer_than_20_frames_a_second_no_vehicle_takes_off_unless_the_scenario_asks_for_it() {
    let flown = |sets: &[&str]| {
        let mut swarm = Swarm::new(&scenario("hover.toml", sets), Frames { rate: 15, jitter: 0.0, drop: 0.0 });
        swarm.run_until(40.0);
        let heights: Vec<_> = (0..4).map(|nth| swarm.place(nth).1).collect();
        (heights, swarm.events)
    };
    let (heights, events) = flown(&[]);
    assert!(heights.iter().all(|height_m| *height_m < 1.0), "{heights:?}");
    assert!(events.iter().any(|(_, _, what)| *what == EventKind::FrameRate(15)), "{events:?}");
    let (heights, _) = flown(&["plant.min_frame_rate_hz=0"]);
    assert!(heights.iter().all(|height_m| *height_m > 25.0), "{heights:?}");
}
