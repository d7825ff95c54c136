use proptest::prelude::*;
use skein_common::frame::{Geodetic, Origin, VelocityNed};
use skein_common::scenario::{ScriptedOrder, ScriptedVerb, Servo};

use super::*;
use crate::helicopter::tests::xcell60;
use crate::helicopter::{BuiltInVehicle, Helicopter, LocalWind, Start, TICK_S, Weather};
use crate::plant::{Controls, Frame, Measurement};
use crate::random::{self, Purpose, uniform};
use crate::tests::id;

const HOVER: Controls = Controls { roll: 0.0185, pitch: 0.0, yaw: 0.0, collective: 0.6 };
const CLIMB: Controls = Controls { collective: 0.7, ..HOVER };

const HEALTHY: Failures = Failures { engine_out: false, gyro_off: false, stuck: [false; 3], position_frozen: false };
const ENGINE_OUT: Failures = Failures { engine_out: true, ..HEALTHY };
const GYRO_OFF: Failures = Failures { gyro_off: true, ..HEALTHY };
const POSITION_FROZEN: Failures = Failures { position_frozen: true, ..HEALTHY };

/// A climbing vehicle more than 4 m above the ground.
fn in_the_air() -> BuiltInVehicle {
    let origin = Origin::new(Geodetic::from_degrees(28.0, -82.0, 10.0));
    let (start, weather) = (Start::default(), Weather { wind_m_s: 3.0, wind_from_rad: 0.5, gust_w20_m_s: 3.0 });
    let mut vehicle = BuiltInVehicle::new(&origin, &xcell60(), &start, &weather, 1, id(1));
    fly(&mut vehicle, CLIMB, 4.0);
    assert!(vehicle.frame().truth.height_m > 4.0);
    vehicle
}

fn fly(vehicle: &mut BuiltInVehicle, controls: Controls, seconds: f64) -> Frame {
    (0..(seconds / TICK_S) as u32).for_each(|_| vehicle.advance(Some(controls)));
    vehicle.frame()
}

/// The vehicle after 2 s from the climb with these failures and controls.
fn flown(failures: Failures, controls: Controls) -> BuiltInVehicle {
    let mut vehicle = in_the_air();
    vehicle.fail(failures);
    fly(&mut vehicle, controls, 2.0);
    vehicle
}

/// Blade pitch δ_lat, δ_lon, θ0 of the servos, rad.
fn servos(vehicle: &BuiltInVehicle) -> [f64; 3] {
    let state = vehicle.helicopter().state.0;
    [state[18], state[19], state[20]]
}

#[test]
fn without_power_the_rotor_slows_down_and_with_power_it_recovers() {
    let mut vehicle = flown(ENGINE_OUT, HOVER);
    let frame = vehicle.frame();
    assert!(frame.measurement.rotor_speed_rad_s.unwrap() < 120.0, "{frame:?}");
    assert_eq!(frame.truth.power_w, Some(0.0));
    assert_eq!(vehicle.failures(), ENGINE_OUT);
    vehicle.fail(HEALTHY);
    let frame = fly(&mut vehicle, Controls { collective: 0.3, ..HOVER }, 2.0);
    assert!(frame.measurement.rotor_speed_rad_s.unwrap() > 150.0, "{frame:?}");
}

#[test]
fn a_rotor_without_power_comes_to_rest() {
    let mut helicopter = Helicopter::at_rest(&xcell60(), 0.0, 0.0, 0.0, 0.0);
    helicopter.fail(&ENGINE_OUT);
    let mut speed_rad_s = helicopter.rotor_speed_rad_s();
    // The drag falls with the square of the speed, so the last turns take long.
    for _ in 0..1_000 {
        (0..50).for_each(|_| helicopter.advance(&HOVER, VelocityNed::default()));
        assert!((0.0..=speed_rad_s).contains(&helicopter.rotor_speed_rad_s()));
        speed_rad_s = helicopter.rotor_speed_rad_s();
    }
    assert_eq!(speed_rad_s, 0.0);
    assert!((helicopter.height_m() - 0.242).abs() < 1e-3, "{helicopter:?}");
}

#[test]
fn without_its_gyro_the_tail_rotor_keeps_its_pitch() {
    let pedals = Controls { yaw: 0.5, ..HOVER };
    let turning = flown(HEALTHY, pedals).helicopter().rates().yaw_rad_s;
    assert!((0.8..1.2).contains(&turning), "{turning}");
    let mut vehicle = in_the_air();
    vehicle.fail(GYRO_OFF);
    let before = vehicle.helicopter().state.0[17];
    fly(&mut vehicle, pedals, 2.0);
    assert_eq!(vehicle.helicopter().state.0[17], before);
    let (pedalled, other) = (flown(GYRO_OFF, pedals), flown(GYRO_OFF, HOVER));
    assert_eq!(pedalled.frame(), other.frame(), "the pedals have no effect");
    assert!(other.helicopter().rates().yaw_rad_s > 0.3, "less torque than in the climb: it turns right");
    vehicle.fail(HEALTHY);
    let healed = fly(&mut vehicle, HOVER, 5.0).measurement.rates.yaw_rad_s;
    assert!(healed.abs() < 0.1, "{healed}");
}

#[test]
fn a_stuck_servo_keeps_its_position_while_the_others_move() {
    let away = Controls { roll: 0.1, pitch: 0.1, yaw: 0.0, collective: 0.65 };
    for axis in 0..3 {
        let mut vehicle = in_the_air();
        let before = servos(&vehicle);
        let mut stuck = [false; 3];
        stuck[axis] = true;
        vehicle.fail(Failures { stuck, ..HEALTHY });
        fly(&mut vehicle, away, 0.3);
        let after = servos(&vehicle);
        for other in 0..3 {
            assert_eq!(after[other] == before[other], other == axis, "servo {other} while {axis} is stuck");
        }
        vehicle.fail(HEALTHY);
        fly(&mut vehicle, away, 0.02);
        assert_ne!(servos(&vehicle)[axis], before[axis], "healed");
    }
}

#[test]
fn a_frozen_position_repeats_while_the_vehicle_flies() {
    let mut vehicle = in_the_air();
    let before = vehicle.frame();
    vehicle.fail(POSITION_FROZEN);
    assert_eq!(vehicle.frame(), before);
    let frozen = fly(&mut vehicle, CLIMB, 2.0);
    assert_eq!(frozen.measurement.position, before.measurement.position);
    // A second failure neither ends the freeze nor moves the frozen position.
    vehicle.fail(Failures { gyro_off: true, ..POSITION_FROZEN });
    assert_eq!(vehicle.frame(), frozen);
    vehicle.fail(HEALTHY);
    let mut never = in_the_air();
    let never = fly(&mut never, CLIMB, 2.0);
    assert_eq!(vehicle.frame(), never, "all other measurements stayed live");
    // Velocity and heading are measured from the meridian of the measured position, which is the frozen one.
    let Measurement { position, velocity, attitude, .. } = frozen.measurement;
    assert!((velocity - never.measurement.velocity).norm() < 1e-4);
    assert!((attitude.heading_rad - never.measurement.attitude.heading_rad).abs() < 1e-5);
    assert_eq!(
        Frame { measurement: Measurement { position, velocity, attitude, ..never.measurement }, ..never },
        frozen
    );
}

#[test]
fn a_failure_cured_at_once_has_no_effect() {
    let mut vehicle = in_the_air();
    let all = Failures { engine_out: true, gyro_off: true, stuck: [true; 3], position_frozen: true };
    vehicle.fail(all);
    vehicle.fail(HEALTHY);
    assert_eq!(fly(&mut vehicle, HOVER, 5.0), fly(&mut in_the_air(), HOVER, 5.0));
}

/// No rotor is faster, rad/s. In a fall the air drives a rotor of little pitch far past its speed: of 4,300 falls the fastest
/// reached 907 rad/s, and one in 350 more than 600.
const FASTEST_ROTOR_RAD_S: f64 = 2_000.0;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    /// A fall from 1000 m that ends on the ground, with new failures and controls each second.
    #[test]
    fn no_failure_makes_a_number_non_finite(seed: u64, heals: bool) {
        let weather = Weather { wind_m_s: 20.0, wind_from_rad: 1.0, gust_w20_m_s: 20.0 };
        let mut air = LocalWind::new(&weather, random::generator(seed, None, Purpose::Wind));
        let mut chance = random::generator(seed, None, Purpose::Start);
        let mut helicopter = Helicopter::at_rest(&xcell60(), 0.0, 0.0, 0.0, 0.0);
        helicopter.state.0[2] -= 1_000.0;
        let mut failures = HEALTHY;
        for _ in 0..120 {
            let mut deflection = || 2.0 * uniform(&mut chance) - 1.0;
            let controls = Controls { roll: deflection(), pitch: deflection(), yaw: deflection(), collective: deflection().abs() };
            let mut fails = |before: bool| uniform(&mut chance) < 0.2 || before && !heals;
            failures.engine_out = fails(failures.engine_out);
            failures.gyro_off = fails(failures.gyro_off);
            failures.stuck = failures.stuck.map(fails);
            helicopter.fail(&failures);
            for _ in 0..50 {
                helicopter.advance(&controls, air.advance(helicopter.height_m()));
                let state = helicopter.state.0;
                prop_assert!(state.iter().all(|value| value.is_finite()), "{state:?}");
                prop_assert!((0.0..FASTEST_ROTOR_RAD_S).contains(&state[15]), "rotor speed {}", state[15]);
                prop_assert!(helicopter.velocity().0.norm() < 150.0, "{:?}", helicopter.velocity());
                prop_assert!(helicopter.rates().is_finite() && helicopter.attitude().is_finite());
            }
        }
    }
}

#[test]
fn a_script_holds_the_plants_faults_of_one_vehicle() {
    let fault = |at_s, for_s, fault| ScriptedEvent { at_s, for_s, what: EventAction::Fault(fault) };
    let (one, two) = (id(1), id(2));
    let hold = ScriptedOrder { verb: ScriptedVerb::Hold, vehicles: None };
    let events = [
        fault(10.0, Some(5.0), Fault::EngineOut { vehicle: one }),
        fault(12.0, None, Fault::ServoStuck { vehicle: one, servo: Servo::Pitch }),
        fault(13.0, Some(1.0), Fault::ServoStuck { vehicle: one, servo: Servo::Collective }),
        fault(13.0, Some(1.0), Fault::ServoStuck { vehicle: one, servo: Servo::Roll }),
        fault(20.0, Some(1.0), Fault::SimulatorFreeze { vehicle: one }),
        fault(30.0, Some(1.0), Fault::GyroOff { vehicle: one }),
        fault(30.5, Some(1.0), Fault::GyroOff { vehicle: one }),
        fault(40.0, Some(1.0), Fault::GpsFrozen { vehicle: one }),
        fault(0.0, None, Fault::Kill { vehicle: one }),
        fault(0.0, None, Fault::ClockJump { vehicle: one, by_s: 1.0 }),
        fault(0.0, None, Fault::EngineOut { vehicle: two }),
        ScriptedEvent { at_s: 0.0, for_s: None, what: EventAction::Order(hold) },
    ];
    let script = Script::of(&events, one);
    let now = |failures: Failures| ActiveFaults { failures, simulator_frozen: false };
    let pitch = Failures { stuck: [false, true, false], ..HEALTHY };
    let all_stuck = [true; 3];
    for (at_s, expected) in [
        (0.0, now(HEALTHY)),
        (9.99, now(HEALTHY)),
        (10.0, now(ENGINE_OUT)),
        (12.0, now(Failures { engine_out: true, ..pitch })),
        (13.5, now(Failures { engine_out: true, stuck: all_stuck, ..HEALTHY })),
        (14.0, now(Failures { engine_out: true, ..pitch })),
        (15.0, now(pitch)),
        (20.5, ActiveFaults { failures: pitch, simulator_frozen: true }),
        (21.0, now(pitch)),
        (30.7, now(Failures { gyro_off: true, ..pitch })),
        (31.2, now(Failures { gyro_off: true, ..pitch })),
        (31.5, now(pitch)),
        (40.0, now(Failures { position_frozen: true, ..pitch })),
        (1e9, now(pitch)),
    ] {
        assert_eq!(script.at(at_s), expected, "{at_s} s");
    }
    assert_eq!(Script::of(&events, id(3)), Script::default());
}
