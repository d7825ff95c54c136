//! Orders that name vehicles, and a human pilot at the controls.

use super::*;

/// An order to these vehicles.
fn to(vehicles: &[u8], epoch: u64, verb: Verb) -> Order {
    Order { epoch, verb, vehicles: Some(vehicles.iter().copied().map(id).collect()), ..HOLD }
}

#[test]
fn an_order_to_other_vehicles_is_passed_on_and_not_executed() {
    let mut one = One::active(ONE, "");
    let other = to(&[2, 3], 5, Verb::Land);
    one.order(other);
    formation(one.step(20.0, 30.0));
    assert_eq!((one.mission.newest_order, one.take_events()), (Some(other), vec![]));
    one.order(HOLD);
    assert!(matches!(one.step(21.0, 30.0), Task::Stay { .. }), "an older order to the whole swarm still applies here");
}

#[test]
fn a_vehicle_on_hold_alone_is_not_waited_for_and_joins_again_after_listening() {
    let mut one = One::active(ONE, "");
    one.order(to(&[1], 1, Verb::Hold));
    assert!(matches!(one.step(20.0, 30.0), Task::Stay { .. }));
    assert_eq!((one.mission.membership(), one.mission.activity), (Membership::Joining, Activity::Holding));
    assert!(matches!(one.step(29.0, 30.0), Task::Stay { .. }), "however long");
    assert_eq!(one.mission.membership(), Membership::Joining);
    one.order(to(&[1], 2, Verb::Goto(0)));
    assert!(matches!(one.step(30.0, 30.0), Task::Stay { .. }));
    assert!(matches!(one.step(31.9, 30.0), Task::Stay { .. }));
    formation(one.step(32.0, 30.0));
    assert_eq!(one.mission.membership(), Membership::Active);
}

#[test]
fn a_hold_of_the_whole_swarm_ends_a_hold_alone_and_keeps_the_vehicle_in_the_swarm() {
    let mut one = One::active(ONE, "");
    one.order(to(&[1], 1, Verb::Hold));
    one.step(20.0, 30.0);
    one.order(Order { epoch: 2, ..HOLD });
    one.step(21.0, 30.0);
    assert!(matches!(one.step(23.0, 30.0), Task::Stay { .. }));
    assert_eq!((one.mission.membership(), one.mission.activity), (Membership::Active, Activity::Holding));
}

#[test]
fn a_released_vehicle_leaves_its_controls_to_the_pilot_until_an_order_names_it() {
    let mut one = One::active(TWO, "");
    one.order(to(&[1], 1, Verb::Release));
    assert_eq!(one.step(20.0, 30.0), Task::Release);
    assert_eq!((one.mission.membership(), one.mission.activity), (Membership::Joining, Activity::Released));
    one.order(Order { epoch: 2, verb: Verb::Goto(1), ..HOLD });
    one.order(Order { epoch: 3, ..LAND });
    one.view.conditions.insert(Failure::Engine.into());
    one.mission.leave();
    assert_eq!(one.step(21.0, 30.0), Task::Release, "whatever happens to it and to the swarm");
    assert_eq!(one.mission.at(), 1, "it follows the others' steps");
}

#[test]
fn a_vehicle_that_is_taken_back_stays_where_it_is_before_it_joins() {
    let mut one = One::active(ONE, "");
    one.order(to(&[1], 1, Verb::Release));
    one.step(20.0, 30.0);
    let mut elsewhere = estimate(44.0, 0.0);
    elsewhere.position = PositionNed::new(50.0, 60.0, -44.0);
    elsewhere.attitude.heading_rad = 2.0;
    one.step_at(39.98, &elsewhere);
    one.order(to(&[1], 2, Verb::Goto(0)));
    let stay = Task::Stay { at_ne_m: Vector2::new(50.0, 60.0), altitude_m: 44.0, heading_rad: 2.0, lands: false };
    assert_eq!(one.step_at(40.0, &elsewhere), stay);
    assert_eq!(one.step_at(41.9, &elsewhere), stay);
    assert_eq!(formation(one.step_at(42.0, &elsewhere)).heading_rad, 2.0);
    assert_eq!(one.mission.membership(), Membership::Active);
}

#[test]
fn a_pilot_who_moves_the_stick_keeps_the_controls_until_an_order_names_the_vehicle() {
    let mut one = One::active(ONE, "");
    one.order(to(&[1], 1, Verb::Goto(0)));
    one.view.pilot_takes_over = true;
    assert_eq!(one.step(20.0, 30.0), Task::Release);
    one.view.pilot_takes_over = false;
    one.order(Order { epoch: 2, ..HOLD });
    assert_eq!(one.step(21.0, 30.0), Task::Release, "whatever the stick does then");
    one.order(to(&[1], 3, Verb::Goto(0)));
    assert!(matches!(one.step(22.0, 30.0), Task::Stay { .. }));
}

#[test]
fn an_order_to_a_step_that_names_a_vehicle_sends_it_ahead_without_the_others() {
    let mut one = One::active(TWO, "");
    one.order(to(&[1], 1, Verb::Goto(1)));
    assert_eq!(formation(one.step(20.0, 30.0)).step, 1);
    assert_eq!(
        (one.mission.at(), one.mission.agreement_state().vouched),
        (1, 0),
        "two such vehicles would lead the others along"
    );
}

#[test]
fn a_vehicle_on_hold_alone_can_be_ordered_to_land() {
    let mut one = One::active(ONE, "");
    one.order(to(&[1], 1, Verb::Hold));
    one.step(20.0, 30.0);
    one.order(to(&[1], 2, Verb::Land));
    one.step(21.0, 30.0);
    assert_eq!((one.mission.membership(), one.mission.activity), (Membership::Left, Activity::Landing));
}

#[test]
fn above_another_partition_the_landing_at_the_end_waits_and_a_landing_by_order_does_not() {
    let mut one = One::active("{ hold_s = 1 }, { land = true }", "");
    one.view = View { altitude_error_m: Some(0.0), flies_above: true, ..View::default() };
    for tick in 1..40 {
        let goal = formation(one.step(2.0 + 0.1 * f64::from(tick), 40.0));
        assert!(goal.step <= 1);
    }
    assert_eq!((one.mission.at(), one.mission.membership()), (1, Membership::Active), "it keeps its place above");
    assert_eq!(
        one.take_events(),
        [EventKind::Reached(0), EventKind::Advanced(1), EventKind::LandingWaits],
        "reported once"
    );
    one.view.flies_above = false;
    assert!(matches!(one.step(6.1, 40.0), Task::Stay { lands: true, .. }));
    one.view.flies_above = true;
    assert!(matches!(one.step(6.2, 39.9), Task::Stay { lands: true, .. }), "a landing that has begun continues");
    assert_eq!(one.take_events(), []);

    let mut one = One::active("{ hold_s = 1000 }, { land = true }", "");
    one.view = View { altitude_error_m: Some(0.0), flies_above: true, ..View::default() };
    one.order(LAND);
    assert!(matches!(one.step(2.1, 40.0), Task::Stay { lands: true, .. }));
    assert!(!one.take_events().contains(&EventKind::LandingWaits));
}
