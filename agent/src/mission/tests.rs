use skein_common::frame::{Attitude, BodyRates, Geodetic, PositionNed, VelocityNed};
use skein_common::id::{Incarnation, VehicleId};
use skein_common::message::Header;
use skein_common::time::SenderStamp;

use super::*;

const GOAL: Goal = Goal { centre_ne_m: Vector2::new(3.0, 4.0), altitude_m: 30.0 };
const LAND: Order = Order { epoch: 2, issuer: 1, verb: Verb::Land };
const HOLD: Order = Order { epoch: 1, issuer: 1, verb: Verb::Hold };

fn at(seconds: f64) -> Now {
    Now { plant: PlantTime::from_seconds(seconds), local: LocalTime::from_seconds(seconds) }
}

fn estimate(altitude_m: f64, down_m_s: f64) -> Estimate {
    Estimate {
        position: PositionNed::new(10.0, 20.0, -altitude_m),
        geodetic: Geodetic::from_degrees(28.0, -82.0, altitude_m),
        height_m: altitude_m,
        velocity: VelocityNed::new(0.0, 0.0, down_m_s),
        attitude: Attitude { heading_rad: 1.0, ..Attitude::default() },
        rates: BodyRates::default(),
        rotor_speed_rad_s: None,
    }
}

/// A mission whose two seconds of joining are over.
fn active() -> Mission {
    let mut mission = Mission::new(GOAL, 7, None);
    mission.step(at(0.0), &estimate(0.24, 0.0), false);
    mission.step(at(2.0), &estimate(0.24, 0.0), false);
    mission
}

#[test]
fn two_seconds_of_listening_then_take_off_with_the_first_heading() {
    let mut mission = Mission::new(GOAL, 7, None);
    assert_eq!(mission.step(at(5.0), &estimate(0.24, 0.0), false), Task::Wait);
    assert_eq!(mission.step(at(6.9), &estimate(0.24, 0.0), false), Task::Wait);
    assert_eq!(mission.membership(), Membership::Joining);
    let task = mission.step(at(7.0), &estimate(0.24, 0.0), false);
    assert_eq!(task, Task::Formation { centre_ne_m: GOAL.centre_ne_m, altitude_m: 30.0, heading_rad: 1.0 });
    assert_eq!((mission.membership(), mission.activity()), (Membership::Active, Activity::TakingOff));
    mission.step(at(20.0), &estimate(29.5, 0.0), false);
    assert_eq!(mission.activity(), Activity::Formation);
}

#[test]
fn an_agent_that_joins_in_the_air_stays_there_until_it_takes_part() {
    let mut mission = Mission::new(GOAL, 7, None);
    let Task::Stay { at_ne_m, altitude_m, .. } = mission.step(at(0.0), &estimate(25.0, 0.0), false) else {
        panic!("in the air it holds")
    };
    assert_eq!((at_ne_m, altitude_m), (Vector2::new(10.0, 20.0), 25.0));
    assert!(matches!(mission.step(at(2.0), &estimate(25.0, 0.0), false), Task::Formation { .. }));
}

#[test]
fn holds_while_alone_and_goes_on_when_somebody_is_back() {
    let mut mission = active();
    mission.step(at(20.0), &estimate(30.0, 0.0), false);
    let held = mission.step(at(21.0), &estimate(30.0, 0.0), true);
    assert!(matches!(held, Task::Stay { altitude_m: 30.0, .. }));
    assert_eq!(mission.activity(), Activity::Holding);
    let mut elsewhere = estimate(30.0, 0.0);
    elsewhere.position = PositionNed::new(50.0, 50.0, -30.0);
    assert_eq!(mission.step(at(22.0), &elsewhere, true), held, "the place does not drift with the vehicle");
    assert!(matches!(mission.step(at(23.0), &elsewhere, false), Task::Formation { .. }));
}

#[test]
fn an_order_to_go_on_ends_a_hold() {
    let mut mission = active();
    mission.merge(HOLD);
    assert!(matches!(mission.step(at(20.0), &estimate(30.0, 0.0), false), Task::Stay { .. }));
    mission.merge(Order { epoch: 2, issuer: 1, verb: Verb::Goto(0) });
    assert!(matches!(mission.step(at(21.0), &estimate(30.0, 0.0), false), Task::Formation { .. }));
}

#[test]
fn the_larger_order_stands() {
    let mut mission = active();
    assert!(mission.merge(HOLD));
    assert!(!mission.merge(HOLD), "told twice is no news");
    assert!(mission.merge(LAND));
    assert!(!mission.merge(HOLD), "an older order does not come back");
    assert_eq!(mission.order(), Some(LAND));
}

#[test]
fn a_landing_descends_gently_unloads_and_leaves() {
    let mut mission = active();
    mission.merge(LAND);
    let (mut altitude_m, mut seconds, mut fastest_m_s) = (30.0, 20.0, 0.0_f64);
    let mut last_m_s = 0.0;
    while mission.activity() != Activity::Landed {
        seconds += 0.02;
        assert!(seconds < 90.0, "never landed");
        // A vehicle that follows the altitude asked for with a lag, until the ground stops it.
        let sink_m_s = match mission.step(at(seconds), &estimate(altitude_m, last_m_s), false) {
            Task::Stay { altitude_m: wanted_m, .. } => (altitude_m - wanted_m) * 0.8,
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
    assert_eq!(mission.membership(), Membership::Left);
    assert!(altitude_m < 0.3 && fastest_m_s < 2.5, "{altitude_m} m, {fastest_m_s} m/s");
}

#[test]
fn an_order_to_land_on_the_ground_does_not_take_off() {
    let mut mission = Mission::new(GOAL, 7, None);
    mission.merge(LAND);
    for tick in 0..300 {
        let task = mission.step(at(f64::from(tick) * 0.02), &estimate(0.24, 0.0), false);
        assert!(matches!(task, Task::Wait | Task::Park), "{task:?}");
    }
    assert_eq!(mission.activity(), Activity::Landed);
}

#[test]
fn orders_spread_from_peer_to_peer_among_those_with_the_same_plan() {
    let said = |plan, order| {
        let sender = VehicleId::new(2).unwrap();
        let header = Header { sender, incarnation: Incarnation(1), sequence: 1, stamp: SenderStamp::ZERO };
        MissionMessage { header, plan, membership: Membership::Active, order }
    };
    let mut mission = active();
    let stranger = said(8, Some(LAND));
    assert_eq!(mission.listen(&stranger), Some(Happening::PlanDiffers(stranger.header.sender)));
    assert_eq!(mission.listen(&stranger), None, "told once");
    assert_eq!(mission.order(), None, "another plan's order is not ours");
    assert_eq!(mission.listen(&said(7, Some(LAND))), Some(Happening::OrderTaken(LAND)));
    assert_eq!(mission.listen(&said(7, Some(LAND))), None);
    assert_eq!(mission.order(), Some(LAND));
}

#[test]
fn nobody_takes_part_before_the_rotor_is_at_speed() {
    let mut mission = Mission::new(GOAL, 7, Some(150.0));
    let with_rotor = |speed_rad_s| Estimate { rotor_speed_rad_s: speed_rad_s, ..estimate(0.24, 0.0) };
    mission.step(at(0.0), &with_rotor(Some(0.0)), false);
    assert_eq!(mission.step(at(9.0), &with_rotor(Some(149.0)), false), Task::Wait);
    assert_eq!(mission.membership(), Membership::Joining);
    assert!(matches!(mission.step(at(9.1), &with_rotor(Some(151.0)), false), Task::Formation { .. }));
    let mut untold = Mission::new(GOAL, 7, Some(150.0));
    untold.step(at(0.0), &with_rotor(None), false);
    assert!(matches!(untold.step(at(2.0), &with_rotor(None), false), Task::Formation { .. }));
}
