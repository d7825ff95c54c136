mod approach;
mod landing;
mod orders;

use proptest::prelude::*;
use skein_common::frame::{Attitude, BodyRates, Geodetic, PositionNed, VelocityNed};
use skein_common::scenario::{Source, load};

use super::*;
use crate::tests::{header, heartbeat, id, progress, report};

const LAND: Order = Order { epoch: 2, issuer: 1, verb: Verb::Land, vehicles: None, signature: None };
const HOLD: Order = Order { epoch: 1, issuer: 1, verb: Verb::Hold, vehicles: None, signature: None };

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

fn scenario(steps: &str, more: &str) -> Scenario {
    let text = format!("swarm.vehicles = 3\nmission.steps = [{steps}]\n{more}\n");
    load(&Source { name: "test", text: &text }, &[]).unwrap().scenario
}

/// Vehicle 1 of three, with its events.
struct One {
    mission: Mission,
    view: View,
    events: Vec<EventKind>,
    sequence: u64,
    /// The newest heartbeat of each peer.
    heartbeats: Vec<message::Heartbeat>,
    /// The peers in contact.
    contact: VehicleSet,
}

impl One {
    fn new(steps: &str, more: &str) -> Self {
        let mission = Mission::new(&scenario(steps, more), id(1), None);
        let contact = [2, 3].map(id).into_iter().collect();
        Self { mission, view: View::default(), events: Vec::new(), sequence: 0, heartbeats: Vec::new(), contact }
    }

    /// Vehicle 1 after its two seconds of joining.
    fn active(steps: &str, more: &str) -> Self {
        let mut one = Self::new(steps, more);
        one.step(0.0, 0.24);
        one.step(2.0, 0.24);
        one
    }

    fn step(&mut self, seconds: f64, altitude_m: f64) -> Task {
        self.step_at(seconds, &estimate(altitude_m, 0.0))
    }

    fn step_at(&mut self, seconds: f64, estimate: &Estimate) -> Task {
        let plan = self.mission.plan;
        let heartbeats = self.heartbeats.iter().filter(|last| self.contact.contains(last.header.sender));
        let heartbeats = heartbeats.filter(|last| last.plan == plan).map(progress);
        self.view.revision += 1;
        self.mission.step(at(seconds), estimate, &self.view, heartbeats, &mut self.events)
    }

    fn order(&mut self, order: Order) {
        self.mission.merge(order, &mut self.events);
    }

    /// Receives a heartbeat of an active peer.
    fn receive(&mut self, sender: u8, step: u32, reached: Option<u32>, progress_m: f64) {
        let heartbeat = self.heartbeat(sender, step, reached, progress_m);
        self.mission.take_report(&report(&heartbeat), &mut self.events);
        self.heartbeats.retain(|last| last.header.sender != heartbeat.header.sender);
        self.heartbeats.push(heartbeat);
    }

    fn heartbeat(&mut self, sender: u8, step: u32, reached: Option<u32>, progress_m: f64) -> message::Heartbeat {
        self.sequence += 1;
        let plan = self.mission.plan;
        message::Heartbeat {
            plan,
            step,
            vouched: step,
            reached,
            progress_m,
            ..heartbeat(header(sender, self.sequence))
        }
    }

    fn take_events(&mut self) -> Vec<EventKind> {
        core::mem::take(&mut self.events)
    }
}

const ONE: &str = "{ centre_ne_m = [3, 4] }";
const TWO: &str = "{ centre_ne_m = [0, 0] }, { centre_ne_m = [300, 0] }";

fn formation(task: Task) -> MissionGoal {
    let Task::Formation(goal) = task else { panic!("no formation: {task:?}") };
    goal
}

#[test]
fn after_two_seconds_of_listening_the_vehicle_takes_off_with_its_first_heading() {
    let mut one = One::new(ONE, "");
    assert_eq!(one.step(5.0, 0.24), Task::Wait);
    assert_eq!(one.step(6.9, 0.24), Task::Wait);
    assert_eq!(one.mission.membership(), Membership::Joining);
    let goal = formation(one.step(7.0, 0.24));
    assert_eq!((goal.step, goal.centre_ne_m, goal.heading_rad), (0, Vector2::new(3.0, 4.0), 1.0));
    assert_eq!((one.mission.membership(), one.mission.activity), (Membership::Active, Activity::TakingOff));
    one.view.altitude_error_m = Some(0.0);
    one.step(20.0, 29.5);
    assert_eq!(one.mission.activity, Activity::Formation);
}

#[test]
fn an_agent_that_joins_in_the_air_stays_there_until_it_is_active() {
    let mut one = One::new(ONE, "");
    let Task::Stay { at_ne_m, altitude_m, .. } = one.step(0.0, 25.0) else { panic!("it must hold in the air") };
    assert_eq!((at_ne_m, altitude_m), (Vector2::new(10.0, 20.0), 25.0));
    formation(one.step(2.0, 25.0));
}

#[test]
fn a_step_is_left_when_all_active_members_have_reached_it() {
    let mut one = One::active(TWO, "");
    one.receive(2, 0, Some(0), 0.0);
    one.receive(3, 0, None, 0.0);
    one.view.in_place = true;
    one.step(3.0, 30.0);
    one.step(4.9, 30.0);
    assert_eq!(one.mission.reached(), None, "in place for less than the three seconds of dwell");
    one.step(5.1, 30.0);
    assert_eq!((one.mission.reached(), one.mission.at()), (Some(0), 0));
    one.view.in_place = false;
    one.step(7.0, 30.0);
    assert_eq!(one.mission.reached(), Some(0), "a reached step stays reached");
    one.receive(3, 0, Some(0), 0.0);
    assert_eq!(formation(one.step(8.0, 30.0)).centre_ne_m, Vector2::new(300.0, 0.0));
    assert_eq!(one.take_events(), [EventKind::Reached(0), EventKind::Advanced(1)]);
}

#[test]
fn dwell_is_counted_without_interruption() {
    let mut one = One::active(ONE, "");
    for tenth in 0..100 {
        one.view.in_place = tenth % 25 != 0;
        one.step(3.0 + 0.1 * f64::from(tenth), 30.0);
    }
    assert_eq!(one.mission.reached(), None, "2.4 s without interruption are not 3 s");
}

#[test]
fn a_lost_vehicle_is_not_waited_for_and_is_reported() {
    let mut one = One::active(TWO, "");
    one.receive(2, 0, Some(0), 0.0);
    one.receive(3, 0, None, 0.0);
    one.view.in_place = true;
    one.step(3.0, 30.0);
    one.step(7.0, 30.0);
    assert_eq!(one.mission.at(), 0);
    one.contact.remove(id(3));
    one.step(7.1, 30.0);
    let without = [id(3)].into_iter().collect();
    assert_eq!(one.take_events(), [EventKind::Reached(0), EventKind::ForcedAdvance { to: 1, without }]);
}

#[test]
fn a_straggler_is_moved_forward_and_reports_the_skipped_steps() {
    let mut one = One::active("{ centre_ne_m = [0, 0] }, { centre_ne_m = [9, 0] }, { centre_ne_m = [5, 5] }", "");
    // Vehicle 3 has sent nothing yet.
    one.view.absent_may_fly = true;
    one.receive(2, 2, Some(1), 0.0);
    assert_eq!(formation(one.step(2.5, 30.0)).step, 0, "a single vehicle moves no other");
    one.receive(3, 2, None, 0.0);
    assert_eq!(formation(one.step(3.0, 30.0)).centre_ne_m, Vector2::new(5.0, 5.0));
    assert_eq!(one.take_events(), [EventKind::Skipped { from: 0, to: 2 }]);
}

#[test]
fn a_hold_ends_by_the_own_clock() {
    let mut one = One::active("{ hold_s = 40 }, { centre_ne_m = [9, 0] }", "");
    one.view = View { altitude_error_m: Some(0.0), ..View::default() };
    for second in 2..42 {
        one.step(f64::from(second), 30.0);
        assert_eq!(one.mission.at(), 0, "after {} s", second - 2);
    }
    one.step(42.0, 30.0);
    assert_eq!(one.mission.at(), 1);
}

/// Steps at 50 Hz from 2 s on and returns the last goal.
fn fly_along(one: &mut One, seconds: f64, mut each: impl FnMut(&mut One, f64)) -> MissionGoal {
    let mut goal = None;
    for tick in 0..(seconds * 50.0) as u32 {
        let now_s = 2.02 + 0.02 * f64::from(tick);
        each(one, now_s);
        goal = Some(formation(one.step(now_s, 30.0)));
    }
    goal.unwrap()
}

const PATH: &str = "{ path_ne_m = [[0, 0], [100, 0]], speed_m_s = 2 }, { centre_ne_m = [9, 0] }";

#[test]
fn the_centre_moves_along_its_path_at_its_speed_and_stops_at_its_end() {
    let mut one = One::active(PATH, "");
    one.view = View { altitude_error_m: Some(0.0), ..View::default() };
    let goal = fly_along(&mut one, 10.0, |_, _| {});
    assert!((goal.centre_ne_m - Vector2::new(20.0, 0.0)).norm() < 0.05, "{goal:?}");
    assert_eq!(goal.centre_velocity_ne_m_s, Vector2::new(2.0, 0.0));
    let mut one = One::active(PATH, "");
    one.view = View { altitude_error_m: Some(0.0), ..View::default() };
    let goal = fly_along(&mut one, 60.0, |_, _| {});
    assert_eq!((goal.centre_ne_m, goal.centre_velocity_ne_m_s), (Vector2::new(100.0, 0.0), Vector2::zeros()));
}

#[test]
fn a_centre_that_is_behind_speeds_up_one_ahead_waits_and_none_goes_back() {
    let with_other_at = |offset_m: f64| {
        let mut one = One::active(PATH, "");
        let mut goals = Vec::new();
        fly_along(&mut one, 8.0, |one, now_s| {
            one.receive(2, 0, None, (2.0 * (now_s - 2.0) + offset_m).max(0.0));
            goals.push(one.mission.progress_m());
        });
        assert!(goals.windows(2).all(|pair| pair[1] >= pair[0]), "never back");
        one.mission.progress_m()
    };
    assert!(with_other_at(8.0) > 17.5 && with_other_at(8.0) <= 24.0, "{}", with_other_at(8.0));
    assert!(with_other_at(-8.0) < 14.5, "{}", with_other_at(-8.0));
    assert!((with_other_at(0.0) - 16.0).abs() < 0.1);
}

#[test]
fn a_late_joiner_takes_the_centres_progress_from_two_others() {
    let mut one = One::new(PATH, "");
    one.step(0.0, 30.0);
    for (second, progress_m) in [(0.5, 70.0), (1.0, 71.0), (1.9, 73.0)] {
        one.receive(2, 0, None, progress_m);
        one.receive(3, 0, None, progress_m + 10.0);
        one.step(second, 30.0);
    }
    one.receive(2, 0, None, 73.2);
    one.receive(3, 0, None, 1e8);
    let goal = formation(one.step(2.0, 30.0));
    assert!((goal.centre_ne_m.x - 73.2).abs() < 0.1, "a single vehicle does not move it: {goal:?}");
}

#[test]
fn a_vehicle_moved_forward_begins_at_the_others_centre() {
    let mut one = One::active(&format!("{{ centre_ne_m = [0, 0] }}, {PATH}"), "");
    one.receive(2, 1, Some(0), 40.0);
    one.receive(3, 1, Some(0), 42.0);
    let north_m = formation(one.step(3.0, 30.0)).centre_ne_m.x;
    assert!((40.0..44.1).contains(&north_m), "at 2 to 4 m/s for the second since the last step: {north_m}");
}

#[test]
fn the_last_step_lands() {
    let mut one = One::active("{ hold_s = 1 }, { land = true }", "");
    one.contact = VehicleSet::default();
    for second in 2..5 {
        one.step(f64::from(second), 30.0);
    }
    assert!(one.mission.is_at_landing());
    assert_eq!((one.mission.membership(), one.mission.activity), (Membership::Left, Activity::Landing));
}

#[test]
fn a_minority_holds_its_position_under_quorum() {
    let mut one = One::active(TWO, "mission.partition = \"quorum\"");
    for peer in [2, 3] {
        one.receive(peer, 0, None, 0.0);
    }
    formation(one.step(3.0, 30.0));
    one.contact = VehicleSet::default();
    assert!(matches!(one.step(4.0, 30.0), Task::Stay { .. }));
    one.contact.insert(id(2));
    formation(one.step(5.0, 30.0));
    let quorum = |event: &EventKind| matches!(event, EventKind::QuorumLost | EventKind::QuorumBack);
    let events: Vec<_> = one.take_events().into_iter().filter(quorum).collect();
    assert!(events.ends_with(&[EventKind::QuorumLost, EventKind::QuorumBack]), "{events:?}");
}

#[test]
fn a_vehicle_without_own_data_is_not_waited_for_and_rejoins() {
    let mut one = One::active(TWO, "");
    one.mission.withdraw();
    assert_eq!(one.mission.membership(), Membership::Joining);
    assert!(matches!(one.step(10.0, 30.0), Task::Stay { .. }));
    assert!(matches!(one.step(11.9, 30.0), Task::Stay { .. }));
    formation(one.step(12.0, 30.0));
}

#[test]
fn a_vehicle_back_on_the_ground_takes_off_at_once_if_it_has_received_its_peers_meanwhile() {
    let mut one = One::active(TWO, "");
    one.mission.withdraw();
    formation(one.step(10.0, 0.24));
    one.mission.withdraw();
    one.view.conditions.insert(Condition::AllPeersLost);
    assert_eq!(one.step(20.0, 0.24), Task::Wait, "it has received none");
    assert_eq!(one.mission.membership(), Membership::Joining);
}

#[test]
fn a_vehicle_holds_while_alone_and_continues_when_a_peer_is_back() {
    let mut one = One::active(ONE, "");
    one.step(20.0, 30.0);
    one.view.conditions.insert(Condition::AllPeersLost);
    let held = one.step(21.0, 30.0);
    assert!(matches!(held, Task::Stay { altitude_m: 30.0, .. }));
    assert_eq!(one.mission.activity, Activity::Holding);
    let mut elsewhere = estimate(30.0, 0.0);
    elsewhere.position = PositionNed::new(50.0, 50.0, -30.0);
    assert_eq!(one.step_at(22.0, &elsewhere), held, "the position does not drift with the vehicle");
    one.view.conditions = Conditions::default();
    formation(one.step_at(23.0, &elsewhere));
}

#[test]
fn a_goto_order_ends_a_hold() {
    let mut one = One::active(TWO, "");
    one.order(HOLD);
    assert!(matches!(one.step(20.0, 30.0), Task::Stay { .. }));
    one.order(Order { epoch: 2, issuer: 1, verb: Verb::Goto(0), vehicles: None, signature: None });
    assert_eq!(formation(one.step(21.0, 30.0)).step, 0);
    one.order(Order { epoch: 3, issuer: 1, verb: Verb::Goto(1), vehicles: None, signature: None });
    assert_eq!(formation(one.step(22.0, 30.0)).step, 1);
}

#[test]
fn the_larger_order_wins() {
    let mut one = One::active(ONE, "");
    for order in [HOLD, HOLD, LAND, HOLD] {
        one.order(order);
    }
    assert_eq!(one.take_events(), [EventKind::OrderTaken(HOLD), EventKind::OrderTaken(LAND)]);
    assert_eq!(one.mission.orders.to_swarm(), Some(LAND));
}

#[test]
fn a_landing_can_be_recalled_but_an_abort_cannot() {
    let later = Order { epoch: 9, issuer: 1, verb: Verb::Goto(0), vehicles: None, signature: None };
    let mut one = One::active(ONE, "");
    one.order(LAND);
    assert!(matches!(one.step(20.0, 30.0), Task::Stay { .. }));
    assert_eq!(one.mission.membership(), Membership::Left);
    one.order(later);
    formation(one.step(21.0, 28.0));
    assert_eq!(one.mission.membership(), Membership::Active);
    let mut one = One::active(ONE, "");
    one.order(Order { verb: Verb::Abort, ..LAND });
    one.order(later);
    assert!(matches!(one.step(21.0, 28.0), Task::Stay { .. }));
    assert_eq!(one.mission.activity, Activity::Landing);
}

#[test]
fn a_failure_makes_the_vehicle_land_despite_any_order() {
    let mut one = One::active(ONE, "");
    one.order(HOLD);
    one.view.conditions.insert(Failure::Gyro.into());
    assert!(matches!(one.step(20.0, 30.0), Task::Stay { .. }));
    assert_eq!((one.mission.membership(), one.mission.activity), (Membership::Left, Activity::Landing));
    one.view.conditions.insert(Failure::Engine.into());
    assert!(matches!(one.step(20.1, 30.0), Task::Autorotate { .. }));
}

#[test]
fn orders_spread_among_peers_with_the_same_plan() {
    let mut one = One::active(ONE, "");
    let friend = message::Heartbeat { order: Some(LAND), ..one.heartbeat(2, 0, None, 0.0) };
    let other_plan = message::Heartbeat { plan: friend.plan ^ 1, ..friend };
    for heartbeat in [other_plan, other_plan] {
        one.mission.take_report(&report(&heartbeat), &mut one.events);
    }
    assert_eq!(one.take_events(), [EventKind::PlanDiffers(id(2))], "reported once");
    assert_eq!(one.mission.orders.to_swarm(), None, "an order of another plan is ignored");
    for heartbeat in [friend, friend] {
        one.mission.take_report(&report(&heartbeat), &mut one.events);
    }
    assert_eq!(one.take_events(), [EventKind::OrderTaken(LAND)]);
}

#[test]
fn no_vehicle_becomes_active_before_its_rotor_is_at_speed() {
    let with_rotor = |speed_rad_s| Estimate { rotor_speed_rad_s: speed_rad_s, ..estimate(0.24, 0.0) };
    let mut one = One::new(ONE, "");
    one.mission.take_off_rotor_rad_s = Some(150.0);
    one.step_at(0.0, &with_rotor(Some(0.0)));
    assert_eq!(one.step_at(9.0, &with_rotor(Some(149.0))), Task::Wait);
    assert_eq!(one.mission.membership(), Membership::Joining);
    let mut leaving = one.mission.clone();
    leaving.leave();
    for tick in 0..150 {
        leaving.step(
            at(9.1 + 0.02 * f64::from(tick)),
            &with_rotor(Some(0.0)),
            &one.view,
            core::iter::empty(),
            &mut one.events,
        );
    }
    assert_eq!(leaving.activity, Activity::Landed, "a vehicle that leaves does not wait for the rotor");
    formation(one.step_at(9.1, &with_rotor(Some(151.0))));
    let mut unmeasured = One::new(ONE, "");
    unmeasured.mission.take_off_rotor_rad_s = Some(150.0);
    unmeasured.step_at(0.0, &with_rotor(None));
    formation(unmeasured.step_at(2.0, &with_rotor(None)));
}

/// The heartbeat of a mission's vehicle.
fn heartbeat_of(mission: &Mission, number: u8, sequence: u64) -> message::Heartbeat {
    message::Heartbeat {
        plan: mission.plan,
        membership: mission.membership(),
        step: mission.at(),
        vouched: mission.agreement_state().vouched,
        reached: mission.reached(),
        progress_m: mission.progress_m(),
        ..heartbeat(header(number, sequence))
    }
}

proptest! {
    /// Three vehicles, each in place, in contact and received at random times.
    #[test]
    fn steps_never_go_back_and_are_left_only_after_all_members_reached_them(
        script in proptest::collection::vec((0_u8..8, any::<u16>(), any::<u16>()), 1..150),
    ) {
        const STEP: &str = "{ centre_ne_m = [0, 0], dwell_s = 0.1 }";
        let steps = [STEP; 6].join(", ");
        let mut missions: [_; 3] = std::array::from_fn(|nth| Mission::new(&scenario(&steps, ""), id(nth as u8 + 1), None));
        let mut plain = missions.clone();
        let (mut revisions, mut last_known) = ([0_u64; 3], [const { Vec::new() }; 3]);
        // The heartbeats each vehicle has last received from each.
        let mut received: [[Option<message::Heartbeat>; 3]; 3] = [[None; 3]; 3];
        for (tick, (in_place, contact, delivered)) in script.into_iter().enumerate() {
            let sent = [0, 1, 2].map(|nth| heartbeat_of(&missions[nth], nth as u8 + 1, tick as u64 + 1));
            for own in 0..3 {
                let has = |bits: u16, other: usize| bits >> (3 * own + other) & 1 == 1;
                let others = (0..3).filter(|&other| other != own);
                let in_contact: Vec<usize> = others.filter(|&other| has(contact, other)).collect();
                for &other in in_contact.iter().filter(|&&other| has(delivered, other)) {
                    received[own][other] = Some(sent[other]);
                    missions[own].take_report(&report(&sent[other]), &mut Vec::new());
                    plain[own].take_report(&report(&sent[other]), &mut Vec::new());
                }
                let known: Vec<_> = in_contact.iter().filter_map(|&other| received[own][other]).map(|it| progress(&it)).collect();
                let agreed = |known: &[PeerProgress]| known.iter().map(|it| PeerProgress { progress_m: 0.0, ..*it }).collect::<Vec<_>>();
                if agreed(&known) != last_known[own] {
                    revisions[own] += 1;
                    last_known[own] = agreed(&known);
                }
                let view = View {
                    revision: revisions[own],
                    absent_may_fly: in_contact.len() < 2,
                    altitude_error_m: Some(0.0),
                    in_place: in_place >> own & 1 == 1,
                    ..View::default()
                };
                let (left, reached) = (missions[own].at(), missions[own].reached());
                let now = at(0.1 * tick as f64);
                let (mut events, mut plain_events) = (Vec::new(), Vec::new());
                let now_at = estimate(30.0, 0.0);
                let task = missions[own].step(now, &now_at, &view, known.iter().copied(), &mut events);
                // The same mission that decides anew at every step.
                let view = View { revision: 1_000 + tick as u64, ..view };
                let plain_task = plain[own].step(now, &now_at, &view, known.iter().copied(), &mut plain_events);
                prop_assert_eq!((task, events), (plain_task, plain_events));
                prop_assert_eq!(missions[own].agreement.own(), plain[own].agreement.own());
                prop_assert!(missions[own].at() >= left && missions[own].reached() >= reached);
                if missions[own].at() == left {
                    continue;
                }
                for counted in known.iter().filter(|sent| sent.membership == Membership::Active) {
                    let member = &missions[usize::from(counted.id.get()) - 1];
                    prop_assert!(member.at() > left || member.reached() >= Some(left), "{left}: {counted:?}");
                }
            }
        }
    }
}
