use nalgebra::Vector2;
use proptest::prelude::*;
use skein_common::scenario::{Source, load};

use super::*;

fn origin() -> Origin {
    Origin::new(Geodetic::from_degrees(28.0, -82.0, 10.0))
}

fn point(keys: &str) -> PointMass {
    let text = alloc::format!("swarm.vehicles = 1\n[plant.point_mass]\n{keys}");
    let scenario = load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario;
    let start = Start { north_m: 30.0, east_m: -40.0, heading_rad: 2.0 };
    PointMass::new(&origin(), &scenario.plant.point_mass, &start)
}

fn command(north_m_s: f64, east_m_s: f64, climb_m_s: f64, turn_rad_s: f64) -> Option<VelocityCommand> {
    Some(VelocityCommand { velocity_ne_m_s: Vector2::new(north_m_s, east_m_s), climb_m_s, turn_rad_s })
}

/// The point after this time under one command.
fn after(mut point: PointMass, seconds: f64, command: Option<VelocityCommand>) -> PointMass {
    for _ in 0..(seconds / TICK_S).round() as u32 {
        point.advance(command);
    }
    point
}

/// A point in a hover, without limits that the tests below reach.
fn hovering(keys: &str) -> PointMass {
    let mut point = after(point(keys), 20.0, command(0.0, 0.0, 2.0, 0.0));
    point = after(point, 20.0, command(0.0, 0.0, 0.0, 0.0));
    assert!(point.velocity.0.norm() < 1e-6 && point.position.altitude_m() > 35.0);
    point
}

#[test]
fn a_point_rests_at_its_start_until_a_climb_is_commanded() {
    let start = point("").frame();
    assert_eq!((start.truth.position, start.truth.height_m), (PositionNed::new(30.0, -40.0, 0.0), 0.0));
    assert_eq!((start.truth.attitude.heading_rad, start.truth.power_w), (2.0, None));
    for command in [None, command(5.0, 5.0, 0.0, 1.0), command(0.0, 3.0, -2.0, 0.0)] {
        let waited = after(point(""), 3.0, command).frame();
        assert_eq!((waited.truth, waited.time), (start.truth, PlantTime::from_seconds(3.0)));
    }
    assert!(after(point(""), 3.0, command(0.0, 0.0, 1.0, 0.0)).frame().truth.height_m > 1.0);
}

#[test]
fn the_measurement_is_exact() {
    let frame = after(hovering(""), 7.0, command(3.0, -2.0, 1.0, 0.3)).frame();
    let (back, convergence) = origin().locate(&frame.measurement.position);
    assert!((back - frame.truth.position).norm() < 1e-5);
    // The measured velocity and heading are local.
    let velocity = convergence.velocity_from_local(frame.measurement.velocity);
    assert!((velocity - frame.truth.velocity).norm() < 1e-12);
    let heading_rad = convergence.heading_from_local(frame.measurement.attitude.heading_rad);
    assert!((heading_rad - frame.truth.attitude.heading_rad).abs() < 1e-12);
    assert_eq!(frame.measurement.height_m, -frame.truth.position.down_m());
    assert_eq!((frame.measurement.rotor_speed_rad_s, frame.truth.attitude.roll_rad), (None, 0.0));
    assert!(frame.measurement.rates.yaw_rad_s > 0.29);
}

#[test]
fn velocities_follow_a_command_with_their_time_constants() {
    let fast = "max_acceleration_m_s2 = \"none\"\nlag_s = 0.8\nturn_lag_s = 0.5";
    let begin = hovering(fast);
    for seconds in [0.02, 0.5, 0.8, 3.0] {
        let end = after(begin.clone(), seconds, command(4.0, -3.0, 2.0, 0.4));
        let reached = 1.0 - math::exp(-seconds / 0.8);
        let expected = VelocityNed::new(4.0 * reached, -3.0 * reached, -2.0 * reached);
        assert!((end.velocity - expected).norm() < 1e-6, "after {seconds} s: {:?}", end.velocity);
        let turn_rad_s = 0.4 * (1.0 - math::exp(-seconds / 0.5));
        assert!((end.turn_rad_s - turn_rad_s).abs() < 1e-9);
        // The integral of v (1 − e^(−t/τ)) is v (t − τ (1 − e^(−t/τ))).
        let flown_m = (end.position - begin.position).norm();
        let expected_m = 29_f64.sqrt() * (seconds - 0.8 * reached);
        assert!((flown_m - expected_m).abs() < 1e-3, "after {seconds} s: {flown_m} m, not {expected_m} m");
    }
}

#[test]
fn a_point_without_lag_and_limit_of_acceleration_is_a_single_integrator() {
    let begin = hovering("max_acceleration_m_s2 = \"none\"\nlag_s = 0\nturn_lag_s = 0");
    let end = after(begin.clone(), 0.02, command(4.0, -3.0, 2.0, 0.4));
    assert!((end.velocity - VelocityNed::new(4.0, -3.0, -2.0)).norm() < 1e-12);
    let later = after(end.clone(), 1.0, command(4.0, -3.0, 2.0, 0.4));
    assert!(((later.position - end.position) - Vector3::new(4.0, -3.0, -2.0)).norm() < 1e-9);
    assert!((later.heading_rad - end.heading_rad - 0.4).abs() < 1e-9);
}

#[test]
fn a_point_that_sinks_onto_the_ground_stops_there_and_can_take_off_again() {
    let mut point = hovering("");
    let mut sank_m_s = 0.0;
    while point.frame().truth.height_m > 0.0 {
        sank_m_s = point.velocity.down_m_s();
        point.advance(command(1.0, 0.0, -0.7, 0.1));
    }
    let down = point.frame().truth;
    assert!((sank_m_s - 0.7).abs() < 1e-3 && down.velocity == VelocityNed::default() && down.height_m == 0.0);
    assert_eq!(after(point.clone(), 2.0, command(1.0, 0.0, -0.7, 0.1)).frame().truth, down);
    assert!(after(point, 5.0, command(0.0, 0.0, 1.0, 0.0)).frame().truth.height_m > 3.0);
}

#[test]
fn a_frozen_position_repeats_and_other_failures_have_no_effect() {
    let mut point = hovering("");
    let before = point.frame().measurement.position;
    let frozen = Failures { position_frozen: true, ..Failures::default() };
    let of_helicopters = Failures { engine_out: true, gyro_off: true, stuck: [true; 3], position_frozen: true };
    point.fail(frozen);
    point = after(point, 1.0, command(3.0, 0.0, 0.0, 0.0));
    point.fail(of_helicopters);
    point = after(point, 1.0, command(3.0, 0.0, 0.0, 0.0));
    assert_eq!((point.frame().measurement.position, point.failures), (before, of_helicopters));
    let cured = |mut point: PointMass| {
        point.fail(Failures::default());
        point.frame()
    };
    let flown_m = cured(point).truth.position.north_m() - origin().ned_from_geodetic(&before).north_m();
    assert!(flown_m > 3.0, "{flown_m}");
}

proptest! {
    #[test]
    fn limits_hold_under_any_commands(
        commands in proptest::collection::vec((-50.0..50.0, -50.0..50.0, -20.0..20.0, -9.0..9.0, 1_u32..40), 1..20),
    ) {
        let mut point = hovering("max_speed_m_s = 6\nmax_climb_m_s = 2\nmax_acceleration_m_s2 = 2.5\nmax_turn_deg_s = 40");
        for (north_m_s, east_m_s, climb_m_s, turn_rad_s, ticks) in commands {
            for _ in 0..ticks {
                let before = point.velocity;
                point.advance(command(north_m_s, east_m_s, climb_m_s, turn_rad_s));
                let (velocity, truth) = (point.velocity, point.frame().truth);
                prop_assert!(velocity.horizontal().norm() < 6.0 + 1e-9 && velocity.down_m_s().abs() < 2.0 + 1e-9);
                prop_assert!(point.turn_rad_s.abs() <= 40_f64.to_radians() + 1e-12 && truth.height_m >= 0.0);
                let change = (velocity - before) / TICK_S;
                let has_landed = truth.height_m == 0.0;
                prop_assert!(has_landed || change.xy().norm() < 2.5 + 1e-9 && change.z.abs() < 2.5 + 1e-9);
            }
        }
    }

    #[test]
    fn a_command_that_is_not_finite_is_ignored(bad in prop_oneof![Just(f64::NAN), Just(f64::INFINITY)], field in 0..4) {
        let mut numbers = [1.0, 2.0, 1.0, 0.1];
        numbers[field as usize] = bad;
        let [north_m_s, east_m_s, climb_m_s, turn_rad_s] = numbers;
        let begin = after(hovering(""), 1.0, command(3.0, 1.0, 0.5, 0.2));
        let expected = after(begin.clone(), 1.0, None).frame();
        prop_assert_eq!(after(begin, 1.0, command(north_m_s, east_m_s, climb_m_s, turn_rad_s)).frame(), expected);
    }
}
