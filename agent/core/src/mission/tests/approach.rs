//! Vehicles that do not come nearer to their altitude, to their step or to joining.

use super::*;

/// The mission after 27 s at a height of 25 m, `error_m` below the altitude, climbing at `climb_m_s`.
fn flown(more: &str, error_m: f64, climb_m_s: f64, collective_limit: Option<CollectiveLimit>) -> One {
    let mut one = One::active(ONE, more);
    (one.view.altitude_error_m, one.view.collective_limit) = (Some(error_m), collective_limit);
    for second in 3..30 {
        one.step_at(f64::from(second), &estimate(25.0, -climb_m_s));
    }
    one
}

#[test]
fn a_vehicle_off_its_altitude_with_no_collective_left_lands() {
    use CollectiveLimit::{Highest, Lowest};
    // Held there, or moving away from its altitude.
    for (error_m, climb_m_s, limit) in [(5.0, 0.0, Highest), (5.0, -2.0, Highest), (-5.0, 0.2, Lowest)] {
        let mut one = flown("", error_m, climb_m_s, Some(limit));
        assert_eq!(one.mission.membership(), Membership::Left, "{error_m} m, {climb_m_s} m/s");
        assert_eq!(one.take_events(), [EventKind::Failed(Failure::Altitude)]);
        assert!(one.mission.is_stuck());
    }
    let mut one = One::active(ONE, "");
    (one.view.altitude_error_m, one.view.collective_limit) = (Some(20.0), Some(Highest));
    for second in 3..23 {
        one.step(f64::from(second), 12.0);
    }
    assert_eq!(one.mission.membership(), Membership::Active, "19 s");
}

/// Vehicle 1 at its altitude for 200 s, with this position error of each second; the second after which it has left.
fn approaching(steps: &str, more: &str, error_m: impl Fn(u16) -> f64) -> (One, Option<u16>) {
    let mut one = One::active(steps, more);
    one.view.altitude_error_m = Some(0.0);
    let left = (3..203).find(|&second| {
        one.view.error_m = Some(error_m(second));
        one.step(f64::from(second), 30.0);
        one.mission.membership() == Membership::Left
    });
    (one, left)
}

#[test]
fn a_vehicle_that_comes_no_nearer_to_its_step_reports_it_leaves_and_lands() {
    let (mut one, left) = approaching(TWO, "", |_| 12.0);
    assert_eq!(left, Some(65), "a minute after its first setpoint");
    assert_eq!(one.take_events(), [EventKind::Failed(Failure::Place)]);
    assert!(one.mission.gave_up);
    assert_eq!(one.mission.activity, Activity::Landing);
    one.receive(2, 1, None, 0.0);
    one.receive(3, 1, None, 0.0);
    one.step(204.0, 30.0);
    assert_eq!(one.mission.membership(), Membership::Left, "also when the others have gone to the next step");
    let (_, left) = approaching(TWO, "mission.progress_timeout_s = 20.0", |_| 12.0);
    assert_eq!(left, Some(25));
}

#[test]
fn a_vehicle_in_the_air_that_cannot_join_reports_it_leaves_and_lands() {
    let mut one = One::new(TWO, "");
    one.view.position_is_stuck = true;
    let left = (0..200).find(|&second| {
        one.step(f64::from(second), 30.0);
        one.mission.membership() == Membership::Left
    });
    assert!(left.is_some_and(|second| (60..70).contains(&second)), "{left:?}");
    assert_eq!(one.take_events(), [EventKind::Failed(Failure::Place)]);
    let mut on_ground = One::new(TWO, "");
    on_ground.view.position_is_stuck = true;
    (0..200).for_each(|second| {
        on_ground.step(f64::from(second), 0.24);
    });
    assert_eq!(on_ground.mission.membership(), Membership::Joining, "on the ground it keeps no place in the air");
}

#[test]
fn a_vehicle_that_comes_nearer_or_keeps_no_other_waiting_stays() {
    // Slowly against the wind.
    assert_eq!(approaching(TWO, "", |second| 12.0 - 0.02 * f64::from(second)).1, None);
    // The last step has no end that others wait for.
    assert_eq!(approaching(ONE, "", |_| 12.0).1, None);
    // The time of a hold passes without its help.
    assert_eq!(approaching("{ hold_s = 500.0 }, { centre_ne_m = [9, 9] }", "", |_| 12.0).1, None);
    // The centre comes along its path.
    let path = "{ path_ne_m = [[0, 0], [900, 0]] }, { centre_ne_m = [9, 9] }";
    assert_eq!(approaching(path, "", |_| 12.0).1, None);
}

#[test]
fn time_on_hold_and_a_change_of_the_members_begin_the_wait_for_progress_anew() {
    let mut one = One::active(TWO, "");
    (one.view.altitude_error_m, one.view.error_m) = (Some(0.0), Some(12.0));
    let fly = |one: &mut One, seconds: std::ops::Range<u16>| {
        for second in seconds {
            one.step(f64::from(second), 30.0);
        }
        one.mission.membership()
    };
    assert_eq!(fly(&mut one, 3..60), Membership::Active);
    one.order(HOLD);
    assert_eq!(fly(&mut one, 60..200), Membership::Active);
    one.receive(2, 0, None, 0.0);
    one.order(Order { epoch: 2, verb: Verb::Goto(0), ..HOLD });
    assert_eq!(fly(&mut one, 200..255), Membership::Active, "vehicle 2 has come");
    assert_eq!(fly(&mut one, 255..270), Membership::Left);
}

#[test]
fn a_vehicle_with_collective_left_is_healthy_at_any_altitude() {
    use CollectiveLimit::{Highest, Lowest};
    for (error_m, climb_m_s, limit) in [
        // Gusts and a changing wind hold it off its altitude while its trim is found.
        (-2.5, 0.0, None),
        (15.0, 0.0, None),
        // The collective limit in the other direction.
        (-5.0, 0.0, Some(Highest)),
        (5.0, 0.0, Some(Lowest)),
        // On its way to its altitude, or at it.
        (-15.0, -1.0, Some(Lowest)),
        (15.0, 1.0, Some(Highest)),
        (0.9, 0.0, Some(Highest)),
    ] {
        let one = flown("", error_m, climb_m_s, limit);
        assert_eq!(one.mission.membership(), Membership::Active, "{error_m} m, {climb_m_s} m/s, {limit:?}");
    }
}
