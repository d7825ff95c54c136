//! The outcome of a failure after its response.

use super::flight::{Flight, FlightSensing};
use super::*;
use crate::failsafe::Response;

/// Motion at touchdown.
#[derive(Clone, Copy, Debug, Default)]
struct Touchdown {
    sink_m_s: f64,
    along_m_s: f64,
    turn_rad_s: f64,
    /// Largest distance from the position at which the failure was found, m.
    away_m: f64,
}

impl Touchdown {
    fn worst(self, other: Self) -> Self {
        Self {
            sink_m_s: self.sink_m_s.max(other.sink_m_s),
            along_m_s: self.along_m_s.max(other.along_m_s),
            turn_rad_s: self.turn_rad_s.max(other.turn_rad_s),
            away_m: self.away_m.max(other.away_m),
        }
    }
}

/// Height of the centre of gravity at which a skid touches the ground at any tilt, and when level, m.
const CONTACT_M: f64 = 0.35;
const LEVEL_CONTACT_M: f64 = 0.26;

/// The controls of an agent that has found a failure and descends to the flight's target.
fn response_controls(flight: &mut Flight) -> Controls {
    if flight.diagnosis.is_frozen {
        flight.dead_reckon();
    }
    let estimate = flight.estimate();
    let sink_m_s = if estimate.height_m > 6.0 { 2.0 } else { 0.7 };
    flight.altitude_m = (flight.altitude_m - sink_m_s * TICK_S).max(estimate.position.altitude_m() - 3.0);
    let setpoint = flight.setpoint(&estimate);
    let controls = match flight.diagnosis.conditions().response() {
        Response::Autorotate => flight.controller.autorotate(TICK_S, &estimate, setpoint.heading_rad),
        Response::LandTurning => flight.controller.turn(TICK_S, &estimate, &setpoint),
        _ => flight.controller.step(TICK_S, &estimate, &setpoint),
    };
    controls.controls
}

/// Fails, flies on until the failure is found, then descends on the spot. `None` if the failure is not found within 30
/// s or the helicopter is not on the ground two minutes later.
fn touchdown(mut flight: Flight, failures: Failures) -> Option<Touchdown> {
    flight.fail(failures);
    let until_s = flight.time_s() + 30.0;
    while flight.found.is_empty() && flight.time_s() < until_s {
        flight.fly(TICK_S);
    }
    flight.found.first()?;
    let from = flight.truth().position;
    flight.stop_here();
    let mut touchdown = Touchdown::default();
    for _ in 0..6_000 {
        let controls = response_controls(&mut flight);
        flight.advance(controls);
        let truth = flight.truth();
        if truth.height_m < CONTACT_M {
            return Some(touchdown);
        }
        touchdown = Touchdown {
            sink_m_s: truth.velocity.down_m_s(),
            along_m_s: truth.velocity.horizontal().norm(),
            turn_rad_s: flight.vehicle.helicopter().rates().yaw_rad_s.abs(),
            away_m: touchdown.away_m.max((truth.position - from).xy().norm()),
        };
    }
    None
}

/// Touchdowns of sixteen flights in each of these phases and winds.
fn touchdowns<'a>(
    failures: Failures,
    phases: &'a [&'a str],
    winds_m_s: &'a [f64],
) -> impl Iterator<Item = (String, Vec<Option<Touchdown>>)> {
    phases.iter().flat_map(move |phase| {
        winds_m_s.iter().map(move |&wind_m_s| {
            let down = (0..16).map(|seed| touchdown(flight_before_failure(phase, wind_m_s, seed), failures)).collect();
            (format!("{phase}, wind and gusts {wind_m_s} m/s"), down)
        })
    })
}

fn worst(down: &[Option<Touchdown>]) -> Touchdown {
    down.iter().flatten().copied().fold(Touchdown::default(), Touchdown::worst)
}

/// Impact speed of an engine failure in a hover at this height in calm air, if the failure is found and if it is not,
/// m/s.
fn impact_speeds_m_s(height_m: f64) -> [f64; 2] {
    let mut flight = Flight::new(FlightSensing::Exact, 0.0, 0.0, 1);
    flight.altitude_m = height_m;
    flight.fly(30.0 + height_m);
    flight.fail(ENGINE_OUT);
    [true, false].map(|answers| {
        let mut flight = flight.clone();
        let mut sink_m_s = 0.0;
        while flight.truth().height_m > LEVEL_CONTACT_M {
            sink_m_s = flight.truth().velocity.down_m_s();
            if answers && !flight.found.is_empty() {
                let controls = response_controls(&mut flight);
                flight.advance(controls);
            } else {
                flight.fly(TICK_S);
            }
        }
        sink_m_s
    })
}

/// From 3 m and below, the helicopter hits the ground at 3 to 4 m/s with any response.
#[test]
fn without_power_the_vehicle_brakes_its_fall() {
    for height_m in [4.0, 5.0, 8.0, 12.0, 17.0, 20.0, 25.0, 30.0, 40.0, 60.0, 100.0] {
        let [braked_m_s, unbraked_m_s] = impact_speeds_m_s(height_m);
        println!(
            "engine out at {height_m:3.0} m: hits at {braked_m_s:.1} m/s, without a response {unbraked_m_s:.1} m/s"
        );
        assert!(braked_m_s < 7.7 && braked_m_s < unbraked_m_s, "{height_m} m");
    }
}

#[test]
fn without_power_the_vehicle_autorotates_to_the_ground_nearby() {
    for (what, down) in touchdowns(ENGINE_OUT, &["take-off", "hover", "step", "transit"], &[0.0, 5.0]) {
        let worst = worst(&down);
        println!("engine out, {what}: {worst:.1?}");
        assert!(down.iter().all(Option::is_some), "{what}");
        assert!(worst.sink_m_s < 7.7 && worst.along_m_s < 5.0, "{what}");
        assert!(worst.away_m < if what.starts_with("transit") { 27.0 } else { 12.0 }, "{what}");
    }
}

/// Without the response it tips over and leaves at 20 m/s.
#[test]
fn with_a_stuck_cyclic_the_vehicle_turns_and_lands_nearby() {
    for servo in [0, 1] {
        for (what, down) in touchdowns(stuck(servo), &["take-off", "hover", "transit"], &[3.0, 5.0]) {
            let worst = worst(&down);
            println!("servo {servo} stuck, {what}: {worst:.1?}");
            assert!(down.iter().all(Option::is_some), "{what}");
            assert!(worst.sink_m_s < 2.5 && worst.along_m_s < 6.0 && worst.away_m < 30.0, "{what}");
        }
    }
}

/// A servo that gets stuck during a hard manoeuvre may make the vehicle unrecoverable.
#[test]
fn with_a_cyclic_stuck_in_a_manoeuvre_most_vehicles_land_nearby() {
    for servo in [0, 1] {
        for (what, down) in touchdowns(stuck(servo), &["step"], &[0.0, 3.0, 5.0]) {
            let lands = |t: &Touchdown| t.sink_m_s < 2.5 && t.along_m_s < 5.0 && t.away_m < 30.0;
            let landed = down.iter().flatten().filter(|t| lands(t)).count();
            println!("servo {servo} stuck, {what}: {landed} of {} land, worst {:.1?}", down.len(), worst(&down));
            assert!(landed >= 13, "{what}");
        }
    }
}

#[test]
fn without_its_gyro_the_vehicle_lands_turning() {
    for (what, down) in touchdowns(GYRO_OFF, &["take-off", "hover", "step", "transit"], &[0.0, 5.0]) {
        let worst = worst(&down);
        println!("gyro off, {what}: {} found, {worst:.1?}", down.iter().flatten().count());
        assert!(worst.sink_m_s < 2.0 && worst.along_m_s < 1.5 && worst.away_m < 20.0, "{what}");
    }
}

#[test]
fn with_a_frozen_position_the_vehicle_dead_reckons_and_lands() {
    for (what, down) in touchdowns(POSITION_FROZEN, &["take-off", "step", "transit"], &[0.0, 5.0]) {
        let worst = worst(&down);
        println!("position frozen, {what}: {worst:.1?}");
        assert!(down.iter().all(Option::is_some), "{what}");
        assert!(worst.sink_m_s < 1.5 && worst.along_m_s < 2.0 && worst.away_m < 20.0, "{what}");
    }
}

/// It cannot follow a climb command, but it stays above its target.
#[test]
fn with_a_stuck_collective_the_vehicle_stays_above_its_target() {
    for seed in 0..16 {
        let mut flight = flight_before_failure("step", 5.0, seed);
        flight.fail(stuck(2));
        flight.fly(30.0);
        if flight.found.is_empty() {
            continue;
        }
        assert_eq!(flight.diagnosis.conditions().response(), Response::Land);
        flight.stop_here();
        for _ in 0..1_500 {
            let controls = response_controls(&mut flight);
            flight.advance(controls);
            let truth = flight.truth();
            let off_m = (truth.position.horizontal() - flight.place_ne_m).norm();
            assert!(off_m < 3.0 || truth.height_m < CONTACT_M, "seed {seed}: {truth:?}");
        }
    }
}
