//! Signs: the direction in which each control and each motion acts.

use super::*;
use skein_common::math;

/// The helicopter some time after one control was moved from hover trim, at this heading.
fn moved(heading_rad: f64, end_s: f64, control: impl Fn(&mut ServoCommand)) -> Helicopter {
    let mut flight = Flight::trimmed(0.0);
    // The trim heads north: turn the whole state about the vertical.
    let (sin, cos) = math::sin_cos(0.5 * heading_rad);
    let [w, x, y, z] = flight.helicopter().quaternion();
    let turned = [cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w];
    flight.state.0[6..10].copy_from_slice(&turned);
    control(&mut flight.command);
    flight.record(end_s, |_| 0.0);
    flight.helicopter()
}

#[test]
fn each_control_acts_in_the_right_direction() {
    let controls = HeldControls::new(&xcell60());
    let hover = controls.command(&Controls { collective: 0.6, ..Controls::default() });
    let full = controls.command(&Controls { roll: 1.0, pitch: 1.0, yaw: 1.0, collective: 1.0 });
    assert_eq!((full.lateral_rad, full.longitudinal_rad, full.yaw_rate_rad_s), (0.1, 0.1, 2.0));
    assert_near(1e-12, full.collective_rad, 0.2);
    assert_near(1e-12, hover.collective_rad, 0.1);
    assert_near(1e-12, controls.command(&Controls::default()).collective_rad, -0.05);

    let roll = moved(0.0, 0.5, |command| command.lateral_rad += 0.01);
    assert!(roll.rates().roll_rad_s > 0.1 && roll.velocity().east_m_s() > 0.01, "{roll:?}");
    let pitch = moved(0.0, 0.5, |command| command.longitudinal_rad += 0.01);
    assert!(pitch.rates().pitch_rad_s > 0.1 && pitch.velocity().north_m_s() < -0.01, "{pitch:?}");
    let yaw = moved(0.0, 0.5, |command| command.yaw_rate_rad_s = 0.2);
    assert!(yaw.rates().yaw_rad_s > 0.1 && yaw.attitude().heading_rad > 0.05, "{yaw:?}");
    let climb = moved(0.0, 0.5, |command| command.collective_rad += 0.01);
    assert!(climb.velocity().down_m_s() < -0.1 && climb.height_m() > 100.0, "{climb:?}");
}

#[test]
fn controls_act_along_the_heading() {
    let northward = moved(0.0, 2.0, |command| command.longitudinal_rad -= 0.005);
    for heading_rad in [1.0, 2.5, -2.0] {
        let turned = moved(heading_rad, 2.0, |command| command.longitudinal_rad -= 0.005);
        assert_near(1e-9, turned.attitude().roll_rad, northward.attitude().roll_rad);
        assert_near(1e-9, turned.attitude().pitch_rad, northward.attitude().pitch_rad);
        let (sin, cos) = math::sin_cos(heading_rad);
        let (north, east) = (northward.velocity().north_m_s(), northward.velocity().east_m_s());
        assert_near(1e-9, turned.velocity().north_m_s(), north * cos - east * sin);
        assert_near(1e-9, turned.velocity().east_m_s(), north * sin + east * cos);
    }
}

#[test]
fn attitude_and_velocity_are_in_the_shared_frames() {
    let mut helicopter = Helicopter::at_rest(&xcell60(), 0.0, 0.0, 0.0, 0.0);
    let attitude = Attitude { roll_rad: 0.3, pitch_rad: -0.2, heading_rad: 2.0 };
    let quaternion = nalgebra::UnitQuaternion::from_rotation_matrix(&attitude.ned_from_body());
    helicopter.state.0[6..10].copy_from_slice(&[quaternion.w, quaternion.i, quaternion.j, quaternion.k]);
    helicopter.state.0[3..6].copy_from_slice(&[1.0, 2.0, 3.0]);
    let read = helicopter.attitude();
    assert_near(1e-12, read.roll_rad, attitude.roll_rad);
    assert_near(1e-12, read.pitch_rad, attitude.pitch_rad);
    assert_near(1e-12, read.heading_rad, attitude.heading_rad);
    let velocity = attitude.ned_from_body() * nalgebra::Vector3::new(1.0, 2.0, 3.0);
    assert_near(1e-12, (helicopter.velocity().0 - velocity).norm(), 0.0);
}

#[test]
fn turning_keeps_euler_and_body_rates_together() {
    // A pure yaw of a level body turns the heading at r; a pure roll turns the roll angle at p.
    for [p, q, r] in [[0.0, 0.0, 0.4], [0.4, 0.0, 0.0], [0.0, 0.4, 0.0]] {
        let turning = body::quaternion_rate([1.0, 0.0, 0.0, 0.0], Vector::new(p, q, r));
        let [_, roll, pitch, yaw] = turning.map(|half| 2.0 * half);
        assert_eq!([roll, pitch, yaw], [p, q, r]);
    }
}

#[test]
fn the_wind_carries_the_helicopter_along() {
    for (north, east) in [(4.0, 0.0), (-4.0, 0.0), (0.0, 4.0), (0.0, -4.0)] {
        let hover = Flight::trimmed(0.0);
        let mut helicopter = hover.helicopter();
        let trim = Controls { roll: hover.command.lateral_rad / 0.1, collective: 0.6, ..Controls::default() };
        for _ in 0..50 {
            helicopter.advance(&trim, VelocityNed::new(north, east, 0.0));
        }
        let drift = helicopter.velocity();
        assert!(drift.north_m_s() * north + drift.east_m_s() * east > 0.4, "wind {north} {east}: {drift:?}");
    }
}

/// Initial tilt rates of the disc, back and right, rad/s, for a body moving at u, v with the blades not commanded.
fn tilt_rates(u: f64, v: f64) -> (f64, f64) {
    let mut flight = Flight::trimmed(0.0);
    let State(rest) = flight.dynamics.rates(&flight.state, &flight.command, CALM);
    flight.state.0[3] += u;
    flight.state.0[4] += v;
    let State(moving) = flight.dynamics.rates(&flight.state, &flight.command, CALM);
    (moving[13] - rest[13], moving[14] - rest[14])
}

#[test]
fn the_disc_tilts_away_from_the_relative_wind() {
    let (back, _) = tilt_rates(5.0, 0.0);
    assert!(back > 0.01, "moving forward must tilt the disc back: {back}");
    let (_, right) = tilt_rates(0.0, 5.0);
    assert!(right < -0.01, "sliding right must tilt the disc left: {right}");
    // Both axes follow the same law.
    assert_near(1e-3 * back, -right, back);
}

#[test]
fn thrust_in_ground_effect_follows_cheeseman_and_bennett() {
    let radius_m = 0.775;
    for (radii, factor) in [
        (0.0, 4.0 / 3.0),
        (0.4, 4.0 / 3.0),
        (0.5, 4.0 / 3.0),
        (1.0, 16.0 / 15.0),
        (1.999_999, 64.0 / 63.0),
        (2.0, 1.0),
        (50.0, 1.0),
    ] {
        assert_near(1e-6, ground::thrust_factor(radius_m, radii * radius_m), factor);
    }
}

#[test]
fn ground_effect_acts_on_thrust_alone_and_at_the_hubs_height() {
    let mut flight = Flight::trimmed(0.0);
    let far = flight.dynamics.rates(&flight.state, &flight.command, CALM).0;
    // The hub, tilted with the trim's bank, one radius above the ground.
    let hub_above_cg_m = 0.235 * math::cos(flight.helicopter().attitude().roll_rad);
    flight.state.0[2] = flight.dynamics.ground_down_m - (0.775 - hub_above_cg_m);
    let near = flight.dynamics.rates(&flight.state, &flight.command, CALM).0;
    let thrust_n = 8.2 * 9.81 * math::cos(flight.helicopter().attitude().roll_rad) / (1.0 - 0.15 / (4.0 * 0.9 * 1.887));
    assert_within(0.001, far[5] - near[5], thrust_n / 15.0 / 8.2);
    // Rotor speed, inflows and flapping are not affected.
    assert_eq!(far[13..], near[13..]);
}
