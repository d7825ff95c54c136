//! Closed loop on the built-in helicopter; `cargo test -- --nocapture diagnosis` prints the measured figures.

mod flight;
mod responses;

use std::collections::VecDeque;

use nalgebra::Vector2;
use proptest::prelude::*;
use skein_common::frame::VelocityNed;
use skein_common::scenario::{Source, load};

use super::*;
use crate::helicopter::{Failures, TICK_S};
use flight::{Flight, FlightSensing};

/// A scenario in which a formation flies at 30 m.
fn scenario() -> Scenario {
    load(&Source { name: "test", text: "swarm.vehicles = 1\nformation.altitude_m = 30.0" }, &[]).unwrap().scenario
}

const HEALTHY: Failures = Failures { engine_out: false, gyro_off: false, stuck: [false; 3], position_frozen: false };
const ENGINE_OUT: Failures = Failures { engine_out: true, ..HEALTHY };
const GYRO_OFF: Failures = Failures { gyro_off: true, ..HEALTHY };
const POSITION_FROZEN: Failures = Failures { position_frozen: true, ..HEALTHY };

/// A stuck roll, pitch or collective servo.
fn stuck(servo: usize) -> Failures {
    let mut stuck = [false; 3];
    stuck[servo] = true;
    Failures { stuck, ..HEALTHY }
}

/// Largest share of each limit in normal flights (roll, pitch, climb, yaw), and the lowest rotor speed.
#[derive(Clone, Copy, Debug, Default)]
struct LimitShares {
    shares: [f64; 4],
    rotor_lost_rad_s: f64,
}

impl LimitShares {
    fn look(&mut self, flight: &Flight) {
        let monitor = flight.diagnosis.monitor.as_ref().unwrap();
        let ControlMonitor { roll, pitch, yaw, climb, .. } = monitor;
        for (share, excess) in self.shares.iter_mut().zip([&roll.excess, &pitch.excess, &climb.excess, &yaw.excess]) {
            *share = share.max(excess.sum / excess.limit);
        }
        self.rotor_lost_rad_s = self.rotor_lost_rad_s.max(167.0 - flight.vehicle.helicopter().rotor_speed_rad_s());
    }
}

/// Take-off, hover, steps across and up, turns on the spot, transit at 7 m/s round two corners, zigzag, landing.
fn normal_flight(mut flight: Flight) -> (Flight, LimitShares) {
    let mut nearest = LimitShares::default();
    let mut fly = |flight: &mut Flight, seconds: f64| {
        for _ in 0..(seconds * 50.0) as u32 {
            flight.fly(0.02);
            nearest.look(flight);
        }
    };
    fly(&mut flight, 60.0);
    flight.place_ne_m += Vector2::new(30.0, 30.0);
    flight.altitude_m = 60.0;
    fly(&mut flight, 20.0);
    flight.heading_rad += 3.0;
    fly(&mut flight, 10.0);
    flight.altitude_m = 25.0;
    fly(&mut flight, 25.0);
    for moves_ne_m_s in [[7.0, 0.0], [0.0, 7.0], [-7.0, 0.0], [0.0, 0.0]] {
        flight.moves_ne_m_s = moves_ne_m_s.into();
        fly(&mut flight, 20.0);
    }
    for east_m in [28.0, -28.0, 28.0, -28.0] {
        flight.place_ne_m += Vector2::new(10.0, east_m);
        fly(&mut flight, 4.0);
    }
    fly(&mut flight, 10.0);
    flight.land();
    (flight, nearest)
}

#[test]
fn normal_flights_raise_no_alarm() {
    let mut worst = LimitShares::default();
    for seed in 0..384 {
        let (wind_m_s, gust_w20_m_s) = [(0.0, 0.0), (3.0, 3.0), (8.0, 8.0), (5.0, 8.0)][seed as usize % 4];
        let sensing = if seed % 8 < 4 { FlightSensing::Exact } else { FlightSensing::Paper };
        let (flight, nearest) = normal_flight(Flight::new(sensing, wind_m_s, gust_w20_m_s, seed));
        assert_eq!(flight.found, [], "seed {seed}");
        for (worst, share) in worst.shares.iter_mut().zip(nearest.shares) {
            *worst = worst.max(share);
        }
        worst.rotor_lost_rad_s = worst.rotor_lost_rad_s.max(nearest.rotor_lost_rad_s);
    }
    println!("shares of the limits of roll, pitch, climb, yaw: {worst:.2?}");
}

/// A flight just before a failure: during take-off, in the hover, on a step of 14 m across and 5 m up, or while
/// accelerating to 7 m/s.
fn flight_before_failure(phase: &str, wind_m_s: f64, seed: u64) -> Flight {
    let sensing = if seed.is_multiple_of(2) { FlightSensing::Exact } else { FlightSensing::Paper };
    let mut flight = Flight::new(sensing, wind_m_s, wind_m_s, seed);
    match phase {
        "take-off" => flight.fly(4.0),
        "hover" => flight.fly(60.0),
        "step" => {
            flight.fly(60.0);
            flight.place_ne_m += Vector2::new(10.0, 10.0);
            flight.altitude_m += 5.0;
        }
        "transit" => {
            flight.fly(60.0);
            flight.moves_ne_m_s = Vector2::new(7.0, 0.0);
            flight.fly(1.5);
        }
        _ => unreachable!("{phase}"),
    }
    flight.fly(0.2 * (seed % 16) as f64);
    flight
}

#[test]
fn a_vehicle_whose_agent_is_late_has_not_failed() {
    // Frames at their rate with commands 160 ms late, and frames that come too rarely for a judgement.
    for (period_ticks, late_ticks) in [(1, 8), (3, 8), (5, 8), (6, 12), (8, 12), (15, 12), (15, 16), (25, 16), (50, 8)]
    {
        for phase in ["hover", "step", "transit"] {
            for seed in 0..32 {
                let mut flight = flight_before_failure(phase, 5.0 * (seed / 2 % 2) as f64, seed);
                let mut under_way = VecDeque::from(vec![flight.command.unwrap(); late_ticks]);
                // A vehicle that its late agent cannot keep in the air ends the flight.
                for tick in 0..500 {
                    if flight.truth().height_m < FREE_ABOVE_M {
                        break;
                    }
                    if tick % period_ticks == 0 {
                        flight.decide(TICK_S * f64::from(period_ticks));
                    }
                    under_way.extend(flight.command);
                    flight.fly_with(under_way.pop_front().unwrap());
                }
                assert_eq!(flight.found, [], "{phase} {seed}, every {period_ticks} ticks, {late_ticks} late");
            }
        }
    }
}

/// Number of flights of each kind.
const FLIGHTS: u64 = 16;
/// Enough flights that the 95th percentile of their times does not depend on a single one.
const MANY_FLIGHTS: u64 = 64;

/// Statistics of the detection of one failure.
#[derive(Debug, Default)]
struct Detections {
    flights: u64,
    /// Detection times, sorted, s.
    after_s: Vec<f64>,
    /// Largest distance from the moving target over the ground where the failure was not found within 30 s, m.
    unfound_off_m: f64,
}

impl Detections {
    fn median_s(&self) -> f64 {
        self.after_s.get(self.after_s.len() / 2).copied().unwrap_or(f64::INFINITY)
    }

    /// Time within which 95 % of all flights found the failure, s.
    fn p95_s(&self) -> f64 {
        self.after_s.get((0.95 * self.flights as f64) as usize).copied().unwrap_or(f64::INFINITY)
    }

    fn worst_s(&self) -> f64 {
        self.after_s.last().copied().unwrap_or(f64::INFINITY)
    }
}

/// Flies on without a response until the failure is found, for 30 s at most.
fn detections(flights: u64, phase: &str, wind_m_s: f64, failures: Failures, expected: Failure) -> Detections {
    let mut detections = Detections { flights, ..Detections::default() };
    for seed in 0..flights {
        let mut flight = flight_before_failure(phase, wind_m_s, seed);
        assert_eq!(flight.found, [], "{phase} {wind_m_s} {seed}");
        let from_s = flight.time_s();
        flight.fail(failures);
        while flight.found.is_empty() && flight.time_s() < from_s + 30.0 {
            flight.fly(TICK_S);
        }
        match flight.found.first() {
            Some(&(time_s, found)) => {
                assert_eq!(found, expected, "{phase} {wind_m_s} {seed}");
                detections.after_s.push(time_s - from_s);
            }
            None => {
                let off_m = (flight.truth().position.horizontal() - flight.place_ne_m).norm();
                detections.unfound_off_m = detections.unfound_off_m.max(off_m);
            }
        }
    }
    detections.after_s.sort_by(f64::total_cmp);
    println!(
        "{expected:?}, {phase}, wind and gusts {wind_m_s} m/s: {} of {flights} found, median {:.2} s, 95 % within {:.2} s, worst {:.2} s",
        detections.after_s.len(),
        detections.median_s(),
        detections.p95_s(),
        detections.worst_s()
    );
    detections
}

#[test]
fn an_engine_that_stops_is_found_at_once() {
    for phase in ["take-off", "hover", "step", "transit"] {
        for wind_m_s in [0.0, 5.0, 8.0] {
            let detections = detections(FLIGHTS, phase, wind_m_s, ENGINE_OUT, Failure::Engine);
            assert!(detections.after_s.len() as u64 == FLIGHTS && detections.worst_s() < 0.4, "{detections:?}");
        }
    }
}

#[test]
fn a_frozen_position_is_found_within_two_metres() {
    for (phase, within_s) in [("take-off", 1.6), ("step", 1.6), ("transit", 0.6)] {
        for wind_m_s in [0.0, 5.0] {
            let detections = detections(FLIGHTS, phase, wind_m_s, POSITION_FROZEN, Failure::Position);
            assert!(detections.after_s.len() as u64 == FLIGHTS && detections.worst_s() < within_s, "{detections:?}");
        }
    }
}

#[test]
fn a_stuck_cyclic_is_found_when_it_is_used() {
    for servo in [0, 1] {
        for (phase, median_s, p95_s) in [("step", 2.5, 5.0), ("transit", 3.5, 10.5), ("take-off", 20.0, 23.0)] {
            for wind_m_s in [0.0, 5.0] {
                let detections = detections(MANY_FLIGHTS, phase, wind_m_s, stuck(servo), Failure::Servo);
                assert!(detections.after_s.len() as u64 == MANY_FLIGHTS, "{detections:?}");
                assert!(detections.median_s() < median_s && detections.p95_s() < p95_s, "{detections:?}");
            }
        }
        for (phase, worst_s) in [("step", 6.0), ("transit", 11.0)] {
            for wind_m_s in [0.0, 5.0] {
                let detections = detections(FLIGHTS, phase, wind_m_s, stuck(servo), Failure::Servo);
                assert!(detections.worst_s() < worst_s, "{detections:?}");
            }
        }
    }
}

#[test]
fn a_failed_gyro_is_found_when_it_is_used() {
    for wind_m_s in [0.0, 5.0] {
        // A vehicle without a gyro spins, and whether it is found in gusts depends on the last bits: of 64 flights 56 or 57 are.
        let detections = detections(MANY_FLIGHTS, "step", wind_m_s, GYRO_OFF, Failure::Gyro);
        let least = if wind_m_s == 0.0 { 62 } else { 52 };
        assert!(detections.after_s.len() >= least && detections.median_s() < 2.5, "{detections:?}");
    }
}

#[test]
fn a_stuck_collective_is_found_when_the_climb_differs() {
    for wind_m_s in [0.0, 5.0] {
        let detections = detections(MANY_FLIGHTS, "transit", wind_m_s, stuck(2), Failure::Servo);
        assert!(detections.after_s.len() >= 56 && detections.median_s() < 11.0, "{detections:?}");
    }
}

#[test]
fn a_collective_stuck_on_the_ground_is_found() {
    let mut flight = Flight::new(FlightSensing::Exact, 3.0, 3.0, 1);
    flight.fail(stuck(2));
    flight.fly(20.0);
    println!("collective stuck on the ground: {:?}", flight.found);
    assert!(flight.truth().height_m < 0.3);
    assert!(matches!(flight.found[..], [(_, Failure::Servo)]), "{:?}", flight.found);
}

#[test]
fn a_failure_of_an_unused_actuator_is_not_found_and_does_no_harm() {
    for (failures, failure) in [
        (GYRO_OFF, Failure::Gyro),
        (stuck(0), Failure::Servo),
        (stuck(1), Failure::Servo),
        (stuck(2), Failure::Servo),
        (POSITION_FROZEN, Failure::Position),
    ] {
        let detections = detections(FLIGHTS, "hover", 0.0, failures, failure);
        assert!((detections.after_s.len() as u64) < FLIGHTS && detections.unfound_off_m < 2.5, "{detections:?}");
    }
}

/// A measurement of a hover with this position and rotor speed.
fn measured(east_m: f64, rotor_speed_rad_s: Option<f64>) -> Measurement {
    let flight = Flight::new(FlightSensing::Exact, 0.0, 0.0, 1);
    let still = flight.vehicle.frame().measurement;
    let longitude_rad = still.position.longitude_rad + east_m / 6.4e6;
    let position = Geodetic { longitude_rad, ..still.position };
    Measurement { position, height_m: 30.0, velocity: VelocityNed::new(0.0, 5.0, 0.0), rotor_speed_rad_s, ..still }
}

fn xcell60() -> Aircraft {
    Aircraft::shipped("xcell60").unwrap().unwrap()
}

#[test]
fn a_failure_stays_found_and_only_a_worse_one_or_the_position_is_reported() {
    let mut diagnosis = Diagnosis::new(&scenario(), &xcell60());
    let trim = Some(xcell60().trim.controls());
    let mut seconds = |number: u32, turn_rad_s: f64, rotor_rad_s: f64, moves: bool| {
        let news = (0..50 * number).filter_map(|tick| {
            let mut measured = measured(if moves { f64::from(tick) } else { 0.0 }, Some(rotor_rad_s));
            measured.rates.yaw_rad_s = turn_rad_s;
            diagnosis.update(TICK_S, &measured, trim)
        });
        (news.collect::<Vec<_>>(), diagnosis.worst)
    };
    assert_eq!(seconds(10, 0.0, 167.0, true), (vec![], None));
    assert_eq!(seconds(10, 2.0, 167.0, true), (vec![Failure::Gyro], Some(Failure::Gyro)));
    assert_eq!(seconds(10, 2.0, 167.0, false), (vec![Failure::Position], Some(Failure::Gyro)));
    assert_eq!(seconds(10, 2.0, 100.0, true), (vec![Failure::Engine], Some(Failure::Engine)));
    assert_eq!(seconds(10, 0.0, 167.0, false), (vec![], Some(Failure::Engine)));
}

#[test]
fn a_rotor_that_speeds_up_or_is_not_measured_has_not_failed() {
    let mut diagnosis = Diagnosis::new(&scenario(), &xcell60());
    for speed in 0..150 {
        assert_eq!(diagnosis.update(TICK_S, &measured(f64::from(speed), Some(f64::from(speed))), None), None);
    }
    assert_eq!(diagnosis.update(TICK_S, &measured(0.0, Some(167.0)), None), None);
    assert_eq!(diagnosis.update(TICK_S, &measured(1.0, None), None), None);
    assert_eq!(diagnosis.update(TICK_S, &measured(2.0, Some(150.0)), None), Some(Failure::Engine));
}

#[test]
fn a_restarted_simulator_with_its_rotor_at_rest_is_not_a_failure() {
    let mut diagnosis = Diagnosis::new(&scenario(), &xcell60());
    assert_eq!(diagnosis.update(TICK_S, &measured(0.0, Some(167.0)), None), None);
    diagnosis.restart();
    for speed in 0..168 {
        assert_eq!(diagnosis.update(TICK_S, &measured(f64::from(speed), Some(f64::from(speed))), None), None);
    }
    assert_eq!(diagnosis.update(TICK_S, &measured(0.0, Some(100.0)), None), Some(Failure::Engine), "a later failure");
}

#[test]
fn without_a_flight_model_only_engine_and_position_are_watched() {
    let aircraft = Aircraft { helicopter: None, rotor_speed_rad_s: Some(167.0), ..xcell60() };
    let mut diagnosis = Diagnosis::new(&scenario(), &aircraft);
    let full = Some(Controls { roll: 1.0, pitch: -1.0, yaw: 1.0, collective: 0.0 });
    for tick in 0..500 {
        assert_eq!(diagnosis.update(TICK_S, &measured(f64::from(tick), Some(167.0)), full), None);
    }
    assert_eq!(diagnosis.update(TICK_S, &measured(0.0, Some(149.0)), full), Some(Failure::Engine));
}

#[test]
fn a_vehicle_on_the_ground_with_a_noisy_velocity_has_no_frozen_position() {
    let mut diagnosis = Diagnosis::new(&scenario(), &xcell60());
    let standing = Measurement { height_m: 0.25, ..measured(0.0, Some(167.0)) };
    assert!((0..5000).all(|_| diagnosis.update(TICK_S, &standing, None).is_none()));
    let flying = Measurement { height_m: 2.0, ..standing };
    assert!((0..50).any(|_| diagnosis.update(TICK_S, &flying, None) == Some(Failure::Position)));
}

#[test]
fn a_position_in_the_air_is_not_believed_by_a_vehicle_that_stands_on_the_ground() {
    let in_air = |height_m: f64, altitude_m: f64| {
        let mut standing = Measurement { height_m, velocity: VelocityNed::default(), ..measured(0.0, Some(167.0)) };
        standing.position.altitude_m = altitude_m;
        let mut diagnosis = Diagnosis::new(&scenario(), &xcell60());
        let found = (0..100).find_map(|_| diagnosis.update(TICK_S, &standing, None));
        (found, diagnosis.is_position_stuck())
    };
    let origin_m = scenario().origin.geodetic().altitude_m;
    // The formation flies at 30 m.
    assert_eq!(in_air(0.25, origin_m + 30.0), (Some(Failure::Position), true));
    assert_eq!(in_air(0.25, origin_m + 29.5), (Some(Failure::Position), true));
    assert_eq!(in_air(0.25, origin_m + 0.25), (None, false), "on the ground");
    assert_eq!(in_air(0.25, origin_m + 12.0), (None, false), "on a hill, or it takes off and notices");
    assert_eq!(in_air(30.0, origin_m + 30.0), (None, false), "at rest in the air, as a point mass");
}

#[test]
fn a_position_that_lags_behind_the_vehicle_in_the_air_is_stuck_before_it_is_frozen() {
    let mut diagnosis = Diagnosis::new(&scenario(), &xcell60());
    let flying = Measurement { height_m: 20.0, ..measured(0.0, Some(167.0)) };
    let found: Vec<_> =
        (0..8).map(|_| (diagnosis.update(TICK_S, &flying, None), diagnosis.is_position_stuck())).collect();
    assert_eq!(found.iter().filter(|(failure, _)| failure.is_some()).count(), 0, "{found:?}");
    assert!(!found[0].1 && found[7].1, "{found:?}");
}

#[test]
fn a_nose_that_the_wind_turns_against_the_pedals_is_no_failure_of_the_gyro() {
    let trim = xcell60().trim.controls();
    // The vehicle banks, its pedals command a turn and its heading stays.
    let found = |roll_rad: f64, pedals: f64| {
        let mut diagnosis = Diagnosis::new(&scenario(), &xcell60());
        (0..300).find_map(|tick| {
            let mut measured = measured(f64::from(tick), Some(167.0));
            measured.attitude.roll_rad = roll_rad;
            diagnosis.update(TICK_S, &measured, Some(Controls { yaw: trim.yaw + pedals, ..trim }))
        })
    };
    assert_eq!(found(-0.3, 0.6), None, "the wind from the left turns the nose left");
    assert_eq!(found(0.3, -0.6), None, "the wind from the right turns the nose right");
    for (roll_rad, pedals) in [(-0.3, -0.6), (0.3, 0.6), (0.0, 0.6), (0.0, -0.6)] {
        assert_eq!(found(roll_rad, pedals), Some(Failure::Gyro), "banked by {roll_rad} rad");
    }
}

#[test]
fn stopped_time_does_not_freeze_the_position() {
    let mut diagnosis = Diagnosis::new(&scenario(), &xcell60());
    for dt_s in [0.0, -5.0] {
        for _ in 0..1_000 {
            assert_eq!(diagnosis.update(dt_s, &measured(0.0, Some(167.0)), None), None);
        }
    }
}

/// Any number, often an impossible one.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(0.0), any::<f64>(), -10.0..10.0, 100.0..200.0]
}

proptest! {
    #[test]
    fn for_any_measurement_failures_only_get_worse_and_are_reported_once(
        steps in prop::collection::vec((number(), number(), number(), number(), [number(), number(), number(), number()]), 1..200),
    ) {
        let mut diagnosis = Diagnosis::new(&scenario(), &xcell60());
        for (dt_s, east_m, turn_rad_s, rotor_rad_s, [roll, pitch, yaw, collective]) in steps {
            let mut measured = measured(if east_m.is_finite() { east_m } else { 0.0 }, Some(rotor_rad_s));
            (measured.rates.yaw_rad_s, measured.rates.roll_rad_s) = (turn_rad_s, turn_rad_s);
            let (worst, was_frozen) = (diagnosis.worst, diagnosis.is_position_frozen());
            let news = diagnosis.update(dt_s, &measured, Some(Controls { roll, pitch, yaw, collective }));
            prop_assert!(diagnosis.worst >= worst && diagnosis.is_position_frozen() >= was_frozen);
            let is_new = diagnosis.worst > worst || diagnosis.is_position_frozen() && !was_frozen;
            prop_assert_eq!(news.is_some(), is_new, "{:?} after {:?}", news, worst);
            prop_assert!(news.is_none_or(|found| diagnosis.found().any(|known| known == found)));
        }
    }
}
