//! A human pilot takes one of four helicopters over and gives it back, in virtual time over the bytes of X-Plane's protocol:
//! by an order, and by the stick. The agent leaves the controls alone meanwhile, the others space themselves without the
//! vehicle and never stop, and the hand-back moves no control farther than a take-off does.

use skein_common::id::VehicleId;
use skein_common::message::{EventKind, Order, Verb};
use skein_common::scenario::Scenario;
use skein_common::state::{Activity, Membership};
use skein_core::aircraft::Aircraft;
use skein_core::control::Rules;
use skein_core::pilot::SimulatedPilot;
use skein_core::plant::{Command, Controls};
use skein_lab::metrics::largest_gap_deviation_rad;
use skein_tests::scenario;
use skein_tests::wire::{Frames, Swarm};

const CELL: Frames = Frames { rate: 50, jitter: 0.2, drop: 0.02 };
/// The vehicle that the pilot flies, counted from 0.
const FLOWN: usize = 2;
/// When the pilot gets the controls, and for how long: the ring of four is even, s.
const RELEASE_S: f64 = 100.0;
const RELEASED_S: f64 = 20.0;
/// Longest time until the agent has the controls again, s.
const TAKEN_WITHIN_S: f64 = 1.0;
/// Longest time until the ring is even again, s: the limit of the default ring.
const EVEN_WITHIN_S: f64 = 120.0;
/// Largest change of roll or pitch from one command to the next, as a share of full deflection: that of a take-off.
const LARGEST_STEP: f64 = 0.25;
/// Distance below which two vehicles are too close, m.
const CLOSEST_M: f64 = 10.0;
/// Functions of the stick's axes: pitch, roll, yaw, collective.
const AXES: [usize; 4] = [1, 2, 3, 5];

/// A swarm of four with a person at one of the simulators.
struct Flight {
    swarm: Swarm,
    pilot: SimulatedPilot,
    has_stick: bool,
    closest_m: f64,
}

impl Flight {
    fn new(sets: &[&str]) -> Self {
        let scenario = Scenario { seed: 3, ..scenario("hover.toml", sets) };
        let aircraft = Aircraft::shipped("xcell60").unwrap().unwrap();
        let pilot = SimulatedPilot::new(&scenario, &aircraft, &Rules::shipped());
        Self { swarm: Swarm::new(&scenario, CELL), pilot, has_stick: false, closest_m: f64::MAX }
    }

    fn run_for(&mut self, for_s: f64) {
        let until_s = self.swarm.now().seconds() + for_s;
        while self.swarm.now().seconds() < until_s {
            if self.has_stick {
                self.move_stick();
            }
            self.swarm.run();
            self.closest_m = self.closest_m.min(closest(&self.swarm));
            self.others_never_stop();
        }
    }

    /// The pilot flies as far as the simulator lets the stick through.
    fn move_stick(&mut self) {
        let frame = self.swarm.truth(FLOWN);
        let Some(Command::Controls(controls)) = self.pilot.fly(Some(Command::Release), || frame) else { return };
        let Controls { roll, pitch, yaw, collective } = controls;
        for (function, value) in AXES.into_iter().zip([pitch, roll, yaw, collective]) {
            self.swarm.write(FLOWN, &format!("sim/joystick/joy_mapped_axis_value[{function}]"), value as f32);
        }
    }

    /// Every other vehicle was commanded in the last fifth of a second, from the time on when the ring is even.
    fn others_never_stop(&self) {
        let now = self.swarm.now();
        for nth in (0..4).filter(|nth| *nth != FLOWN && now.seconds() > RELEASE_S) {
            let age_s = self.swarm.commanded(nth).map(|at| now.seconds_since(at));
            assert!(age_s.is_some_and(|age_s| age_s < 0.2), "vehicle {} has stopped: {age_s:?}", nth + 1);
        }
    }

    fn order(&mut self, epoch: u64, verb: Verb) {
        let vehicles = Some([vehicle()].into_iter().collect());
        self.swarm.give(Order { epoch, issuer: 1, verb, vehicles, signature: None });
    }

    fn activity(&self) -> Activity {
        self.swarm.agent(FLOWN).activity()
    }

    fn has_happened(&self, what: EventKind) -> bool {
        self.swarm.events.iter().any(|(_, id, happened)| (*id, *happened) == (vehicle(), what))
    }

    /// Gives the vehicle back; returns the times until its agent flies it, and until the ring is even, s.
    fn give_back(&mut self, epoch: u64) -> [f64; 2] {
        let returned = self.swarm.now();
        self.order(epoch, Verb::Goto(0));
        while self.swarm.commanded(FLOWN).is_none_or(|at| at <= returned) {
            self.run_for(0.02);
            assert!(self.swarm.now().seconds_since(returned) < 30.0, "no controls: {:?}", self.activity());
        }
        self.has_stick = false;
        let taken_s = self.swarm.now().seconds_since(returned);
        while !(self.swarm.all_active() && gap_deg(&self.swarm, &[0, 1, 2, 3]) < 10.0) {
            self.run_for(0.5);
            assert!(self.swarm.now().seconds_since(returned) < 400.0, "never even");
        }
        [taken_s, self.swarm.now().seconds_since(returned)]
    }

    fn largest_step(&self) -> f64 {
        (0..4).flat_map(|nth| self.swarm.largest_step(nth)).fold(0.0, f64::max)
    }
}

fn vehicle() -> VehicleId {
    VehicleId::new(FLOWN as u8 + 1).unwrap()
}

fn closest(swarm: &Swarm) -> f64 {
    let places: Vec<_> = (0..4).map(|nth| swarm.place(nth)).filter(|(_, height_m)| *height_m > 2.0).collect();
    let pairs = places.iter().enumerate().flat_map(|(nth, one)| places[..nth].iter().map(move |other| (one, other)));
    pairs.map(|(one, other)| (one.0 - other.0).norm()).fold(f64::MAX, f64::min)
}

/// Largest deviation of an angular gap between these vehicles from an even one, degrees.
fn gap_deg(swarm: &Swarm, among: &[usize]) -> f64 {
    let centre = swarm.agent(0).centre_ne_m();
    let bearing = |nth: &usize| {
        let from_centre = swarm.place(*nth).0.0.xy() - centre;
        skein_common::math::atan2(from_centre.y, from_centre.x)
    };
    let mut bearings: Vec<f64> = among.iter().map(bearing).collect();
    largest_gap_deviation_rad(&mut bearings).unwrap().to_degrees()
}

fn keeps_its_limits(what: &str, flight: &Flight, [taken_s, even_s]: [f64; 2]) {
    let (step, closest_m) = (flight.largest_step(), flight.closest_m);
    println!(
        "{what}: controls {taken_s:.2} s after the order, even after {even_s:.1} s, closest {closest_m:.1} m, largest step of \
         the cyclic {step:.2}"
    );
    assert!(taken_s < TAKEN_WITHIN_S && even_s < EVEN_WITHIN_S, "{what}: {taken_s} s, {even_s} s");
    assert!(step < LARGEST_STEP && closest_m > CLOSEST_M, "{what}: {step}, {closest_m} m");
    assert!(flight.has_happened(EventKind::ControlsReleased) && flight.has_happened(EventKind::ControlsTakenBack));
}

#[test]
fn a_released_vehicle_is_flown_by_its_pilot_and_given_back() {
    let mut flight = Flight::new(&[]);
    flight.run_for(RELEASE_S);
    assert!(gap_deg(&flight.swarm, &[0, 1, 2, 3]) < 10.0);
    flight.has_stick = true;
    flight.order(1, Verb::Release);
    flight.run_for(1.0);
    let (commanded, released) = (flight.swarm.commanded(FLOWN), flight.swarm.now());
    assert_eq!((flight.activity(), flight.swarm.agent(FLOWN).membership()), (Activity::Released, Membership::Joining));
    flight.run_for(RELEASED_S - 1.0);
    assert_eq!(flight.swarm.commanded(FLOWN), commanded, "no control is written meanwhile");
    assert!(flight.swarm.place(FLOWN).1 > 25.0, "the pilot flies");
    let peers = flight.swarm.agent(0).peers();
    let age_s = peers.filter(|peer| peer.id == vehicle()).map(|peer| peer.age_s).next();
    assert!(age_s.is_some_and(|age_s| age_s < 0.5), "the others know where it is: {age_s:?} at {released:?}");
    let times = flight.give_back(2);
    keeps_its_limits("released for 20 s", &flight, times);
}

#[test]
fn the_others_space_themselves_without_a_vehicle_that_stays_released() {
    let mut flight = Flight::new(&[]);
    flight.run_for(RELEASE_S);
    flight.has_stick = true;
    flight.order(1, Verb::Release);
    flight.run_for(EVEN_WITHIN_S);
    let gap_deg = gap_deg(&flight.swarm, &[0, 1, 3]);
    println!("a ring of three after {EVEN_WITHIN_S} s: largest deviation of a gap {gap_deg:.1} deg");
    assert!(gap_deg < 10.0, "{gap_deg}");
    assert!(flight.closest_m > CLOSEST_M, "{} m", flight.closest_m);
}

#[test]
fn the_stick_takes_the_controls_only_where_the_scenario_lets_it() {
    let moved = |sets: &[&str]| {
        let mut flight = Flight::new(sets);
        flight.run_for(RELEASE_S);
        flight.swarm.write(FLOWN, "sim/joystick/joy_mapped_axis_value[1]", 0.5);
        flight.run_for(1.0);
        flight
    };
    assert_eq!(moved(&[]).activity(), Activity::Formation);
    let mut flight = moved(&["plant.stick_release=0.3"]);
    assert_eq!(flight.activity(), Activity::Released);
    assert!(flight.has_happened(EventKind::ControlsReleased));
    flight.order(1, Verb::Goto(0));
    flight.run_for(0.5);
    assert_eq!(flight.activity(), Activity::Released, "while the stick is held beyond the threshold");
}
