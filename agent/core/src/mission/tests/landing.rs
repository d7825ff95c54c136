//! Landings: touchdown, descent, unloading.

use super::*;

#[test]
fn a_low_hover_is_not_a_touchdown() {
    let mut one = One::active(ONE, "");
    one.order(HOLD);
    one.step(3.0, 2.5);
    one.order(LAND);
    for tick in 0..60 {
        // The vehicle does not follow yet.
        let task = one.step(4.0 + 0.02 * f64::from(tick), 2.5);
        assert!(matches!(task, Task::Stay { .. }), "{task:?} after {tick} frames");
    }
}

#[test]
fn a_landing_from_below_the_held_altitude_only_descends() {
    let mut one = One::active(ONE, "");
    one.order(HOLD);
    one.step(3.0, 40.0);
    one.order(LAND);
    one.step(4.0, 30.0);
    let Task::Stay { altitude_m, .. } = one.step(4.02, 30.0) else { panic!("it must descend") };
    assert!(altitude_m < 30.0, "{altitude_m}");
}

#[test]
fn a_landing_descends_gently_unloads_and_leaves() {
    assert_lands("", 0.0);
    // In wind without auto-trim, the vehicle stays above its setpoint.
    assert_lands("control.auto_trim = false", 0.0);
    assert_lands("control.auto_trim = false", 7.6);
}

/// Lands a vehicle that follows its altitude setpoint with a lag, at this height above it.
fn assert_lands(keys: &str, above_m: f64) {
    let mut one = One::active(ONE, keys);
    one.order(LAND);
    let (mut altitude_m, mut seconds, mut fastest_m_s) = (30.0, 20.0, 0.0_f64);
    let mut last_m_s = 0.0;
    while one.mission.activity != Activity::Landed {
        seconds += 0.02;
        assert!(seconds < 90.0, "the vehicle has not landed");
        let sink_m_s = match one.step_at(seconds, &estimate(altitude_m, last_m_s)) {
            Task::Stay { altitude_m: command_m, .. } => (altitude_m - command_m - above_m) * 0.8,
            task => {
                assert_eq!(task, Task::Park);
                0.0
            }
        };
        let next_m = (altitude_m - sink_m_s * 0.02).max(0.24);
        last_m_s = (altitude_m - next_m) / 0.02;
        altitude_m = next_m;
        fastest_m_s = fastest_m_s.max(last_m_s);
        assert!(altitude_m > 1.0 || last_m_s < 1.0, "touches down with {last_m_s} m/s");
    }
    assert_eq!(one.mission.membership(), Membership::Left);
    assert!(altitude_m < 0.3 && fastest_m_s < 2.5, "{altitude_m} m, {fastest_m_s} m/s");
}

#[test]
fn an_order_to_land_on_the_ground_causes_no_take_off() {
    let mut one = One::new(ONE, "");
    one.order(LAND);
    for tick in 0..300 {
        let task = one.step(f64::from(tick) * 0.02, 0.24);
        assert!(matches!(task, Task::Wait | Task::Park), "{task:?}");
    }
    assert_eq!(one.mission.activity, Activity::Landed);
}
