//! The controller on the built-in helicopter with exact estimates: error = target − position, without a formation
//! field.
//!
//! `cargo test -- --nocapture closed_loop` prints the measured figures.

use core::f64::consts::TAU;

use nalgebra::Vector3;
use skein_common::frame::{Geodetic, Origin};
use skein_common::id::VehicleId;
use skein_common::math;

use super::*;
use crate::helicopter::{BuiltInVehicle, Parameters, Start, TICK_S, Weather};
use crate::setpoint::VELOCITY_PER_ERROR_PER_S;

const CALM: Weather = Weather { wind_m_s: 0.0, wind_from_rad: 0.0, gust_w20_m_s: 0.0 };
const ALTITUDE_M: f64 = 30.0;

/// A helicopter with its controller.
#[derive(Clone)]
struct Flight {
    vehicle: BuiltInVehicle,
    controller: VehicleController,
    setpoint_ned_m: Vector3<f64>,
    heading_rad: f64,
}

/// The vehicle's state after a tick.
struct Sample {
    time_s: f64,
    /// Position north, east, down, m.
    position_ned_m: Vector3<f64>,
    /// Velocity, m/s.
    velocity_ned_m_s: Vector3<f64>,
    /// Height of the centre of gravity above the ground, m.
    height_m: f64,
    /// Larger magnitude of bank and pitch.
    tilt_deg: f64,
    /// Heading minus its setpoint.
    heading_error_deg: f64,
}

impl Flight {
    /// A helicopter on the ground at the origin, with the command to hover above it.
    fn on_the_ground(heading_rad: f64, auto_trim: bool) -> Self {
        #[derive(serde::Deserialize)]
        struct Aircraft {
            helicopter: Parameters,
        }
        let text = include_str!("../../../../../deploy/aircraft/xcell60.toml");
        let parameters = toml::from_str::<Aircraft>(text).unwrap().helicopter;
        let origin = Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0));
        let start = Start { heading_rad, ..Start::default() };
        Self {
            vehicle: BuiltInVehicle::new(&origin, &parameters, &start, &CALM, 1, VehicleId::new(1).unwrap()),
            controller: VehicleController::new(Rules::shipped(), TRIM, Gains::default(), auto_trim),
            setpoint_ned_m: Vector3::new(0.0, 0.0, -ALTITUDE_M),
            heading_rad,
        }
    }

    /// A helicopter at rest at the setpoint, heading north.
    fn hovering() -> Self {
        let mut flight = Self::on_the_ground(0.0, false);
        flight.fly(60.0);
        flight
    }

    /// Flies for this time and returns one sample per tick.
    fn fly(&mut self, seconds: f64) -> Vec<Sample> {
        (1..=(seconds / TICK_S).round() as usize).map(|tick| self.tick(tick as f64 * TICK_S)).collect()
    }

    fn tick(&mut self, time_s: f64) -> Sample {
        let frame = self.vehicle.frame();
        let estimate = Estimate {
            position: frame.truth.position,
            geodetic: frame.measurement.position,
            height_m: frame.measurement.height_m,
            velocity: frame.measurement.velocity,
            attitude: frame.measurement.attitude,
            rates: frame.measurement.rates,
            rotor_speed_rad_s: frame.measurement.rotor_speed_rad_s,
        };
        let setpoint = Setpoint {
            relative_velocity_ne_m_s: (self.setpoint_ned_m - estimate.position.0).xy() * VELOCITY_PER_ERROR_PER_S,
            feedforward_ne_m_s: Vector2::zeros(),
            altitude_m: -self.setpoint_ned_m.z,
            heading_rad: self.heading_rad,
        };
        let controls = self.controller.step(TICK_S, &estimate, &setpoint);
        assert_eq!(controls.fault, None);
        self.vehicle.advance(Some(controls.controls));

        let truth = self.vehicle.frame().truth;
        let attitude = truth.attitude;
        Sample {
            time_s,
            position_ned_m: truth.position.0,
            velocity_ned_m_s: truth.velocity.0,
            height_m: truth.height_m,
            tilt_deg: attitude.roll_rad.abs().max(attitude.pitch_rad.abs()).to_degrees(),
            heading_error_deg: wrap_rad(attitude.heading_rad - self.heading_rad).to_degrees(),
        }
    }
}

/// Maximum of a quantity over a flight.
fn most(samples: &[Sample], of: impl Fn(&Sample) -> f64) -> f64 {
    samples.iter().map(of).fold(f64::MIN, f64::max)
}

/// The time from which `holds` is true until the end, s.
fn settled_s(samples: &[Sample], holds: impl Fn(&Sample) -> bool) -> f64 {
    samples.iter().rev().take_while(|sample| holds(sample)).last().map_or(f64::INFINITY, |sample| sample.time_s)
}

/// Figures of a step of 10 m to the east.
#[derive(Debug)]
struct Step {
    overshoot_percent: f64,
    ninety_percent_s: f64,
    within_two_percent_s: f64,
    top_speed_m_s: f64,
    tilt_deg: f64,
    across_m: f64,
    lowest_m: f64,
    highest_m: f64,
    heading_error_deg: f64,
    /// Half the peak-to-peak amplitude over the last 10 s of 30 s.
    ripple_m: f64,
}

/// A step of 10 m to the east from the hover, after a turn to this heading.
fn step_east(hover: &Flight, heading_rad: f64) -> Step {
    const STEP_M: f64 = 10.0;
    let mut flight = hover.clone();
    flight.heading_rad = heading_rad;
    flight.fly(20.0);
    flight.setpoint_ned_m.y += STEP_M;
    let samples = flight.fly(30.0);
    let along = |sample: &Sample| sample.position_ned_m.y;
    let altitude = |sample: &Sample| -sample.position_ned_m.z - ALTITUDE_M;
    let end = &samples[samples.len() - 500..];
    Step {
        overshoot_percent: (most(&samples, along) / STEP_M - 1.0) * 100.0,
        ninety_percent_s: settled_s(&samples, |sample| along(sample) >= 0.9 * STEP_M),
        within_two_percent_s: settled_s(&samples, |sample| (along(sample) - STEP_M).abs() <= 0.02 * STEP_M),
        top_speed_m_s: most(&samples, |sample| sample.velocity_ned_m_s.xy().norm()),
        tilt_deg: most(&samples, |sample| sample.tilt_deg),
        across_m: most(&samples, |sample| sample.position_ned_m.x.abs()),
        lowest_m: -most(&samples, |sample| -altitude(sample)),
        highest_m: most(&samples, altitude),
        heading_error_deg: most(&samples, |sample| sample.heading_error_deg.abs()),
        ripple_m: 0.5 * (most(end, along) + most(end, |sample| -along(sample))),
    }
}

#[test]
fn a_step_across_is_quick_and_quiet() {
    let step = step_east(&Flight::hovering(), 0.0);
    println!("10 m east, heading north: {step:.3?}");
    assert!((0.0..5.0).contains(&step.overshoot_percent));
    // The reference gives 4.5 s, 5.3 s and 3.0 m/s.
    assert!((step.ninety_percent_s - 4.5).abs() < 0.05);
    assert!((step.within_two_percent_s - 5.3).abs() < 0.05);
    assert!((step.top_speed_m_s - 3.0).abs() < 0.05);
    assert!(step.tilt_deg <= 20.0);
    assert!(step.across_m < 0.05);
    assert!(step.lowest_m > -0.3 && step.highest_m < 0.3);
    assert!(step.heading_error_deg < 3.0);
    assert!(step.ripple_m < 0.01);
}

/// On oblique headings the saturated axes couple.
#[test]
fn a_step_on_any_heading_stays_within_limits() {
    let hover = Flight::hovering();
    let steps: Vec<Step> = (0..72).map(|i| step_east(&hover, TAU * f64::from(i) / 72.0)).collect();
    let worst = |of: fn(&Step) -> f64| steps.iter().map(of).fold(f64::MIN, f64::max);
    let [overshoot_percent, within_two_percent_s] = [worst(|s| s.overshoot_percent), worst(|s| s.within_two_percent_s)];
    let [across_m, lowest_m, highest_m] = [worst(|s| s.across_m), -worst(|s| -s.lowest_m), worst(|s| s.highest_m)];
    let [heading_error_deg, ripple_m] = [worst(|s| s.heading_error_deg), worst(|s| s.ripple_m)];
    println!(
        "10 m east, worst of 72 headings: overshoot {overshoot_percent:.2} %, within 2 % {within_two_percent_s:.2} s"
    );
    println!("  across {across_m:.3} m, altitude {lowest_m:+.3} {highest_m:+.3} m, tilt {:.1}°", worst(|s| s.tilt_deg));
    println!("  heading within {heading_error_deg:.2}°, ripple {ripple_m:.4} m");
    assert!(overshoot_percent < 5.0);
    assert!(within_two_percent_s < 9.0);
    assert!(across_m < 0.8);
    assert!(lowest_m > -0.8 && highest_m < 0.8);
    assert!(heading_error_deg < 3.0);
    assert!(ripple_m < 0.01);
}

#[test]
fn take_off_is_straight_up() {
    for auto_trim in [false, true] {
        let samples = Flight::on_the_ground(0.6, auto_trim).fly(60.0);
        let low = &samples[..samples.iter().position(|sample| sample.height_m > 1.5).unwrap()];
        let at_altitude_s = settled_s(&samples, |sample| (-sample.position_ned_m.z - ALTITUDE_M).abs() <= 3.0);
        let climb_m_s = most(&samples, |sample| -sample.velocity_ned_m_s.z);
        let drift_m = most(low, |sample| sample.position_ned_m.xy().norm());
        let heading_error_deg = most(&samples, |sample| sample.heading_error_deg.abs());
        println!(
            "take-off, auto-trim {auto_trim}: 30 m within 10 % in {at_altitude_s:.2} s, climb {climb_m_s:.2} m/s,"
        );
        println!("  drift below 1.5 m {drift_m:.3} m, heading within {heading_error_deg:.2}°");
        assert!(at_altitude_s < 20.0);
        assert!(climb_m_s <= 2.6);
        assert!(drift_m < 0.5);
        assert!(heading_error_deg < 3.0);
    }
}

#[test]
fn altitude_is_held_in_calm_air() {
    for auto_trim in [false, true] {
        let mut flight = Flight::on_the_ground(0.0, auto_trim);
        flight.fly(100.0);
        let samples = flight.fly(100.0);
        let square = |sample: &Sample| math::square(sample.position_ned_m.z + ALTITUDE_M);
        let rms_m = (samples.iter().map(square).sum::<f64>() / samples.len() as f64).sqrt();
        let away_m = most(&samples, |sample| sample.position_ned_m.xy().norm());
        println!("hover, auto-trim {auto_trim}: altitude rms {rms_m:.4} m, place within {away_m:.3} m");
        assert!(rms_m < 0.05);
    }
}
