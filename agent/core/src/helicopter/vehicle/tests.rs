use skein_common::frame::Geodetic;

use super::*;
use crate::helicopter::tests::xcell60;

const GUSTY: Weather = Weather { wind_m_s: 5.0, wind_from_rad: 0.5, gust_w20_m_s: 5.0 };
const CLIMB: Controls = Controls { roll: 0.0185, pitch: 0.0, yaw: 0.0, collective: 0.65 };

fn vehicle(number: u8, seed: u64) -> BuiltInVehicle {
    let origin = Origin::new(Geodetic::from_degrees(28.0, -82.0, 10.0));
    let start = Start { north_m: 30.0, east_m: -40.0, heading_rad: 2.0 };
    BuiltInVehicle::new(&origin, &xcell60(), &start, &GUSTY, seed, VehicleId::new(number).unwrap())
}

fn after(mut vehicle: BuiltInVehicle, messages: impl IntoIterator<Item = Option<Controls>>) -> Frame {
    messages.into_iter().for_each(|message| vehicle.advance(message));
    vehicle.frame()
}

#[test]
fn before_the_first_controls_only_time_passes() {
    let start = vehicle(1, 1).frame();
    let waited = after(vehicle(1, 1), [None; 500]);
    assert_eq!(waited.time.seconds(), 10.0);
    assert_eq!(Frame { time: start.time, ..waited }, start);
    // The following flight does not depend on the time spent on the ground.
    let flown = after(vehicle(1, 1), [Some(CLIMB); 100]);
    let flown_later = after(vehicle(1, 1), [None; 500].into_iter().chain([Some(CLIMB); 100]));
    assert_eq!(Frame { time: flown.time, ..flown_later }, flown);
}

#[test]
fn without_new_controls_the_last_are_held() {
    let held = after(vehicle(1, 1), [Some(CLIMB); 100]);
    assert!(held.truth.height_m > 0.5, "{held:?}");
    assert_eq!(after(vehicle(1, 1), [Some(CLIMB)].into_iter().chain([None; 99])), held);
}

#[test]
fn controls_are_clamped_to_their_travel_and_non_finite_ones_ignored() {
    let wild = Controls { roll: -7.0, pitch: 9.0, yaw: -1e300, collective: 44.0 };
    let end = Controls { roll: -1.0, pitch: 1.0, yaw: -1.0, collective: 1.0 };
    assert_eq!(after(vehicle(1, 1), [Some(wild); 20]), after(vehicle(1, 1), [Some(end); 20]));
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let nonsense = Some(Controls { pitch: bad, ..CLIMB });
        assert_eq!(after(vehicle(1, 1), [nonsense; 20]), after(vehicle(1, 1), [None; 20]));
        let messages = [Some(CLIMB), nonsense, nonsense];
        assert_eq!(after(vehicle(1, 1), messages), after(vehicle(1, 1), [Some(CLIMB); 3]));
    }
}

#[test]
fn a_vehicle_starts_at_its_start_position() {
    let frame = vehicle(1, 1).frame();
    assert_eq!(frame.time, PlantTime::ZERO);
    assert_eq!((frame.truth.position.north_m(), frame.truth.position.east_m()), (30.0, -40.0));
    assert!((frame.truth.attitude.heading_rad - 2.0).abs() < 1e-12);
    assert!((frame.measurement.height_m - 0.242).abs() < 5e-4);
    assert_eq!(frame.measurement.rotor_speed_rad_s, Some(167.0));
}

#[test]
fn the_measurement_is_exact() {
    let frame = after(vehicle(1, 1), [Some(CLIMB); 100]);
    let origin = Origin::new(Geodetic::from_degrees(28.0, -82.0, 10.0));
    let (back, convergence) = origin.locate(&frame.measurement.position);
    assert!((back - frame.truth.position).norm() < 1e-5, "{:?}", back - frame.truth.position);
    // The measured velocity and heading are local.
    let velocity = convergence.velocity_from_local(frame.measurement.velocity);
    assert!((velocity - frame.truth.velocity).norm() < 1e-12);
    let attitude = convergence.attitude_from_local(frame.measurement.attitude);
    assert!((attitude.heading_rad - frame.truth.attitude.heading_rad).abs() < 1e-12);
    assert_eq!(
        (attitude.roll_rad, attitude.pitch_rad),
        (frame.truth.attitude.roll_rad, frame.truth.attitude.pitch_rad)
    );
    assert!((frame.measurement.height_m + frame.truth.position.down_m()).abs() < 1e-12);
    assert!(frame.truth.power_w.unwrap() > 900.0);
}

#[test]
fn gusts_differ_between_vehicles_and_seeds() {
    let flown = |number, seed| after(vehicle(number, seed), [Some(CLIMB); 100]);
    assert_eq!(flown(1, 1), flown(1, 1));
    assert_ne!(flown(1, 1), flown(2, 1));
    assert_ne!(flown(1, 1), flown(1, 2));
}
