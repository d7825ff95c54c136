//! The ladder on the built-in helicopter, whole and with broken controls. Random helicopters are a test of the whole swarm.
//!
//! `cargo test -- --nocapture fit` prints what was found.

use skein_common::frame::Geodetic;
use skein_common::id::VehicleId;

use super::respond::REFERENCE;
use super::*;
use crate::aircraft::Aircraft;
use crate::helicopter::{BuiltInVehicle, Parameters, Start, Weather};

const CALM: Weather = Weather { wind_m_s: 0.0, wind_from_rad: 0.0, gust_w20_m_s: 0.0 };
/// Longer than any fit takes, s.
const LONGEST_S: f64 = 900.0;

fn shipped() -> Aircraft {
    Aircraft::shipped("xcell60").unwrap().unwrap()
}

/// One fit of a helicopter in calm air: its end, how long it took, s, and its largest tilt, rad.
struct Climbed {
    end: Result<Fitted, FitError>,
    took_s: f64,
    largest_tilt_rad: f64,
    /// Height and speed over the ground at the end.
    ends_at_m: f64,
    ends_with_m_s: f64,
    /// The last rung before the landing.
    last: Rung,
}

/// Climbs the ladder; `changes` may change the controls on their way to the vehicle.
fn climb(parameters: &Parameters, changes: impl Fn(f64, &mut Controls)) -> Climbed {
    let origin = Origin::new(Geodetic::from_degrees(28.0, -82.0, 10.0));
    let start = Start { heading_rad: 0.7, ..Start::default() };
    let mut vehicle = BuiltInVehicle::new(&origin, parameters, &start, &CALM, 1, VehicleId::new(1).unwrap());
    let mut fit = Fit::new(Rules::shipped());
    let (mut largest_tilt_rad, mut last) = (0.0_f64, Rung::Watch);
    loop {
        let frame = vehicle.frame();
        let FitStep { mut controls, rung, end } = fit.step(frame.time, &frame.measurement);
        assert!(controls.is_within_limits(), "{controls:?}");
        let attitude = frame.truth.attitude;
        largest_tilt_rad = largest_tilt_rad.max(attitude.roll_rad.abs()).max(attitude.pitch_rad.abs());
        if rung != Rung::Land {
            last = rung;
        }
        if let Some(end) = end {
            let (ends_at_m, ends_with_m_s) = (frame.truth.height_m, frame.truth.velocity.0.norm());
            return Climbed { end, took_s: frame.time.seconds(), largest_tilt_rad, ends_at_m, ends_with_m_s, last };
        }
        assert!(frame.time.seconds() < LONGEST_S, "no end: {rung:?} {last:?} {controls:?} {:?}\n{fit:#?}", frame.truth);
        changes(frame.time.seconds(), &mut controls);
        vehicle.advance(Some(controls));
    }
}

#[test]
fn the_built_in_helicopter_needs_no_gains_and_has_the_trim_of_its_file() {
    let aircraft = shipped();
    let climbed = climb(aircraft.helicopter.as_ref().unwrap(), |_, _| ());
    let fitted = climbed.end.unwrap();
    println!("{:.0} s, tilt {:.1} deg, {fitted:#?}", climbed.took_s, climbed.largest_tilt_rad.to_degrees());
    let (ours, file) = (fitted.trim, aircraft.trim);
    for (ours, file, within) in [
        (ours.roll_stick, file.roll_stick, 0.005),
        (ours.pitch_stick, file.pitch_stick, 0.005),
        (ours.yaw_stick, file.yaw_stick, 0.005),
        (ours.collective, file.collective, 0.005),
        (ours.roll_rad, file.roll_rad, 0.005),
        (ours.pitch_rad, file.pitch_rad, 0.005),
    ] {
        assert!((ours - file).abs() < within, "{ours} instead of {file}");
    }
    for gain in [fitted.gains.roll, fitted.gains.pitch, fitted.gains.yaw, fitted.gains.collective] {
        assert!((gain - 1.0).abs() < 0.02, "{REFERENCE:?} is out of date: {:?}", fitted.responses);
    }
    assert!((fitted.rotor_speed_rad_s.unwrap() - 167.0).abs() < 2.0);
    assert!(climbed.ends_at_m < 0.35 && climbed.ends_with_m_s < 0.05, "it has landed");
}

/// The rung on which the built-in helicopter's ladder ends if its controls are changed like this, and why.
fn ends(changes: impl Fn(f64, &mut Controls)) -> (Rung, FitError, f64) {
    let Climbed { end, last, ends_at_m, largest_tilt_rad, .. } = climb(&shipped().helicopter.unwrap(), changes);
    assert!(ends_at_m < 0.35, "it stands");
    (last, end.unwrap_err(), largest_tilt_rad)
}

#[test]
fn a_vehicle_with_a_broken_control_stops_at_the_rung_that_finds_it() {
    let dead = |axis: Axis| {
        ends(move |_, controls| match axis {
            Axis::Roll => controls.roll = 0.0,
            Axis::Pitch => controls.pitch = 0.0,
            Axis::Yaw => controls.yaw = 0.0,
            Axis::Collective => controls.collective = 0.0,
        })
    };
    for axis in [Axis::Roll, Axis::Pitch, Axis::Yaw] {
        let (rung, error, tilt_rad) = dead(axis);
        assert_eq!((rung, error), (Rung::Answer, FitError::NoAnswer { axis }));
        assert!(tilt_rad < TIPS_FROM_RAD);
    }
    assert_eq!(dead(Axis::Collective).1, FitError::NoLift);
    // Ten times too strong in flight only.
    let (rung, error, tilt_rad) = ends(|time_s, controls| {
        if time_s > 60.0 {
            controls.yaw *= 0.1;
        }
    });
    assert_eq!(rung, Rung::Respond);
    assert!(matches!(error, FitError::Response { axis: Axis::Yaw, .. }), "{error}");
    assert!(tilt_rad.to_degrees() < 25.0);
}

#[test]
fn a_fit_stops_on_request_and_refuses_what_cannot_be_flown() {
    let parameters = shipped().helicopter.unwrap();
    let origin = Origin::new(Geodetic::from_degrees(28.0, -82.0, 10.0));
    let vehicle = BuiltInVehicle::new(&origin, &parameters, &Start::default(), &CALM, 1, VehicleId::new(1).unwrap());
    let frame = vehicle.frame();
    let mut fit = Fit::new(Rules::shipped());
    let mut broken = frame.measurement;
    broken.height_m = f64::NAN;
    assert_eq!(fit.step(frame.time, &broken).end, None);
    let mut stopped = Fit::new(Rules::shipped());
    stopped.stop();
    assert_eq!(stopped.step(frame.time, &frame.measurement).end, Some(Err(FitError::Stopped)));
    let still = |change: fn(&mut Measurement)| {
        let mut fit = Fit::new(Rules::shipped());
        let mut measurement = frame.measurement;
        change(&mut measurement);
        let steps = (0..10_000).map(|tick| fit.step(PlantTime::from_seconds(f64::from(tick) * 0.02), &measurement));
        steps.filter_map(|step| step.end).next().unwrap().unwrap_err()
    };
    assert_eq!(still(|measurement| measurement.attitude.roll_rad = 0.3), FitError::NotAtRest);
    // Four of five measurements are missing.
    let mut rare = Fit::new(Rules::shipped());
    let steps = (0..100).map(|tick| rare.step(PlantTime::from_seconds(f64::from(tick) * 0.1), &frame.measurement));
    let end = steps.filter_map(|step| step.end).next();
    assert_eq!(end, Some(Err(FitError::Data("fewer than 20 measurements a second"))));
    assert_eq!(still(|measurement| measurement.rotor_speed_rad_s = Some(0.0)), FitError::Rotor { rpm: 0.0 });
}
