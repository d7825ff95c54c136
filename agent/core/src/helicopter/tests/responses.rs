//! Step responses of one control, with the others at hover trim.

use super::*;
use skein_common::math;

const P: usize = 10;
const Q: usize = 11;
const R: usize = 12;

/// The first sample higher than its neighbours.
fn first_peak(samples: &[(f64, f64)]) -> (f64, f64) {
    samples.windows(3).find(|three| three[1].1 > three[0].1 && three[1].1 >= three[2].1).unwrap()[1]
}

fn mean(samples: &[(f64, f64)], from_s: f64, to_s: f64) -> f64 {
    let inside = samples.iter().filter(|(time, _)| (from_s - 1e-9..=to_s + 1e-9).contains(time));
    let values: Vec<f64> = inside.map(|(_, value)| *value).collect();
    values.iter().sum::<f64>() / values.len() as f64
}

/// The time at which the samples first cross `level`, interpolated, s.
fn crossing(samples: &[(f64, f64)], level: f64) -> f64 {
    let two = samples.windows(2).find(|two| two[1].1 >= level).unwrap();
    let ((t0, v0), (t1, v1)) = (two[0], two[1]);
    t0 + (t1 - t0) * (level - v0) / (v1 - v0)
}

fn step(end_s: f64, command: impl Fn(&mut ServoCommand), value: impl Fn(&Flight) -> f64) -> Vec<(f64, f64)> {
    let mut flight = Flight::trimmed(0.0);
    command(&mut flight.command);
    flight.record(end_s, value)
}

#[test]
fn the_roll_rate_step_matches_the_reference() {
    let rate =
        |deflection: f64| step(0.6, |command| command.lateral_rad += 0.1 * deflection, |flight| flight.state.0[P]);
    let quarter = rate(0.25);
    assert_within(0.05, mean(&quarter, 0.3, 0.6), 0.85);
    let (time_s, peak) = first_peak(&quarter);
    assert_within(0.05, peak, 1.25);
    assert_within(0.05, time_s, 0.190);
    assert_within(0.1, mean(&rate(1.0), 0.3, 0.6), 3.4);
}

#[test]
fn the_pitch_rate_step_matches_the_reference() {
    let quarter = step(0.6, |command| command.longitudinal_rad += 0.025, |flight| flight.state.0[Q]);
    assert_within(0.05, mean(&quarter, 0.3, 0.6), 0.855);
    let (time_s, peak) = first_peak(&quarter);
    assert_within(0.05, peak, 1.19);
    assert_within(0.05, time_s, 0.255);
}

#[test]
fn the_yaw_rate_step_matches_the_reference() {
    let half = step(2.0, |command| command.yaw_rate_rad_s = 1.0, |flight| flight.state.0[R]);
    let end = half.last().unwrap().1;
    assert_within(0.05, end, 0.97);
    assert_within(0.05, crossing(&half, 0.63 * end), 0.063);
    let (time_s, peak) = half.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
    assert_within(0.05, peak, 1.07);
    assert_within(0.05, time_s, 0.345);
}

#[test]
fn the_climb_step_matches_the_reference() {
    let collective = |command: &mut ServoCommand| command.collective_rad += 0.25 * 0.05;
    let body = step(4.0, collective, |flight| -flight.state.0[5]);
    let earth = step(10.0, collective, |flight| -flight.helicopter().velocity().down_m_s());
    let speed = step(4.0, collective, |flight| flight.state.0[15]);
    let at = |samples: &[(f64, f64)], time_s: f64| samples[(time_s / STEP_S).round() as usize].1;
    assert_within(0.05, at(&body, 4.0), 1.76);
    assert_within(0.05, crossing(&body, 0.63 * at(&body, 4.0)), 1.28);
    assert_within(0.05, at(&earth, 4.0), 1.79);
    assert_within(0.05, crossing(&earth[..801], 0.63 * at(&earth, 4.0)), 1.31);
    assert_within(0.05, at(&earth, 10.0), 2.0);
    let slowest = speed.iter().map(|(_, speed)| *speed).fold(f64::INFINITY, f64::min);
    // 5 % of the dip, not of the speed.
    assert_within(0.05, 167.0 - slowest, 167.0 - 165.3);
}

/// Thirty seconds on the ground at collective 0.2, with this start value of the gyro's integral: distance moved (m),
/// largest tilt, largest yaw and final yaw (degrees).
fn after_30_s_on_the_ground(gyro_integral: f64) -> (f64, f64, f64, f64) {
    let mut helicopter = Helicopter::at_rest(&xcell60(), 0.0, 0.0, 0.0, 0.0);
    helicopter.state.0[17] = gyro_integral;
    let controls = Controls { collective: 0.2, ..Controls::default() };
    let (mut tilt_rad, mut yaw_rad) = (0.0_f64, 0.0_f64);
    for _ in 0..1_500 {
        helicopter.advance(&controls, VelocityNed::default());
        let attitude = helicopter.attitude();
        tilt_rad = tilt_rad.max(math::hypot(attitude.roll_rad, attitude.pitch_rad));
        yaw_rad = yaw_rad.max(attitude.heading_rad.abs());
    }
    let moved_m = helicopter.position().horizontal().norm();
    (moved_m, tilt_rad.to_degrees(), yaw_rad.to_degrees(), helicopter.attitude().heading_rad.to_degrees())
}

#[test]
fn a_helicopter_at_low_collective_stays_on_the_ground() {
    for (gyro_integral, yaw_deg) in [(0.0, -33.0), (0.05, -23.0)] {
        let (moved_m, tilt_deg, _, end_deg) = after_30_s_on_the_ground(gyro_integral);
        assert!(moved_m < 0.2 && tilt_deg < 1.0, "{moved_m} m, {tilt_deg}°");
        assert_near(1.0, end_deg, yaw_deg);
    }
    // From the value at which the gyro's integral settles.
    let (moved_m, tilt_deg, yaw_deg, _) = after_30_s_on_the_ground(0.175);
    assert!(moved_m < 0.2 && tilt_deg < 1.0 && yaw_deg < 0.2, "{moved_m} m, {tilt_deg}°, {yaw_deg}°");
}
