use proptest::prelude::*;
use skein_common::frame::{Attitude, BodyRates, Geodetic, PositionNed, VelocityNed};
use skein_common::scenario::{Source, load};

use super::*;
use crate::testing::{header, heartbeat, id};

const LAND: Order = Order { epoch: 2, issuer: 1, verb: Verb::Land, seal: None };
const HOLD: Order = Order { epoch: 1, issuer: 1, verb: Verb::Hold, seal: None };

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

/// Vehicle 1 of three, and what it tells.
struct One {
    mission: Mission,
    view: View,
    told: Vec<Happening>,
    said: u64,
    /// The newest of each peer.
    heartbeats: Vec<message::Mission>,
    /// The peers in contact.
    contact: VehicleSet,
}

impl One {
    fn new(steps: &str, more: &str) -> Self {
        let mission = Mission::new(&scenario(steps, more), None);
        let contact = [2, 3].map(id).into_iter().collect();
        Self { mission, view: View::default(), told: Vec::new(), said: 0, heartbeats: Vec::new(), contact }
    }

    /// Its two seconds of joining are over.
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
        let heartbeats = self.heartbeats.iter().filter(|last| self.contact.contains(last.header.sender));
        self.mission.step(at(seconds), estimate, &self.view, heartbeats, &mut self.told)
    }

    fn order(&mut self, order: Order) {
        self.mission.merge(order, &mut self.told);
    }

    /// An active peer says where it is.
    fn hear(&mut self, sender: u8, step: u32, reached: Option<u32>, progress_m: f64) {
        let said = self.register(sender, step, reached, progress_m);
        self.mission.listen(&said, &mut self.told);
        self.heartbeats.retain(|last| last.header.sender != said.header.sender);
        self.heartbeats.push(said);
    }

    fn register(&mut self, sender: u8, step: u32, reached: Option<u32>, progress_m: f64) -> message::Mission {
        self.said += 1;
        let plan = self.mission.plan();
        message::Mission { plan, step, vouched: step, reached, progress_m, ..heartbeat(header(sender, self.said)) }
    }

    fn told(&mut self) -> Vec<Happening> {
        core::mem::take(&mut self.told)
    }
}

const ONE: &str = "{ centre_ne_m = [3, 4] }";
const TWO: &str = "{ centre_ne_m = [0, 0] }, { centre_ne_m = [300, 0] }";

fn formation(task: Task) -> Goal {
    let Task::Formation(goal) = task else { panic!("no formation: {task:?}") };
    goal
}

#[test]
fn two_seconds_of_listening_then_take_off_with_the_first_heading() {
    let mut one = One::new(ONE, "");
    assert_eq!(one.step(5.0, 0.24), Task::Wait);
    assert_eq!(one.step(6.9, 0.24), Task::Wait);
    assert_eq!(one.mission.membership(), Membership::Joining);
    let goal = formation(one.step(7.0, 0.24));
    assert_eq!((goal.step, goal.centre_ne_m, goal.heading_rad), (0, Vector2::new(3.0, 4.0), 1.0));
    assert_eq!((one.mission.membership(), one.mission.activity()), (Membership::Active, Activity::TakingOff));
    one.view.altitude_error_m = Some(0.0);
    one.step(20.0, 29.5);
    assert_eq!(one.mission.activity(), Activity::Formation);
}

#[test]
fn an_agent_that_joins_in_the_air_stays_there_until_it_takes_part() {
    let mut one = One::new(ONE, "");
    let Task::Stay { at_ne_m, altitude_m, .. } = one.step(0.0, 25.0) else { panic!("in the air it holds") };
    assert_eq!((at_ne_m, altitude_m), (Vector2::new(10.0, 20.0), 25.0));
    formation(one.step(2.0, 25.0));
}

#[test]
fn a_step_is_left_when_everybody_who_counts_has_reached_it() {
    let mut one = One::active(TWO, "");
    one.hear(2, 0, Some(0), 0.0);
    one.hear(3, 0, None, 0.0);
    one.view.in_place = true;
    one.step(3.0, 30.0);
    one.step(4.9, 30.0);
    assert_eq!(one.mission.reached(), None, "in place for less than the three seconds of dwell");
    one.step(5.1, 30.0);
    assert_eq!((one.mission.reached(), one.mission.at()), (Some(0), 0));
    one.view.in_place = false;
    one.step(7.0, 30.0);
    assert_eq!(one.mission.reached(), Some(0), "reached is reached");
    one.hear(3, 0, Some(0), 0.0);
    assert_eq!(formation(one.step(8.0, 30.0)).centre_ne_m, Vector2::new(300.0, 0.0));
    assert_eq!(one.told(), [Happening::Reached(0), Happening::Advanced(1)]);
}

#[test]
fn dwell_is_counted_without_interruption() {
    let mut one = One::active(ONE, "");
    for tenth in 0..100 {
        one.view.in_place = tenth % 25 != 0;
        one.step(3.0 + 0.1 * f64::from(tenth), 30.0);
    }
    assert_eq!(one.mission.reached(), None, "2.4 s at a time is not 3");
}

#[test]
fn who_is_lost_is_not_waited_for_and_is_named() {
    let mut one = One::active(TWO, "");
    one.hear(2, 0, Some(0), 0.0);
    one.hear(3, 0, None, 0.0);
    one.view.in_place = true;
    one.step(3.0, 30.0);
    one.step(7.0, 30.0);
    assert_eq!(one.mission.at(), 0);
    one.contact.remove(id(3));
    one.step(7.1, 30.0);
    let without = [id(3)].into_iter().collect();
    assert_eq!(one.told(), [Happening::Reached(0), Happening::ForcedAdvance { to: 1, without }]);
}

#[test]
fn a_straggler_is_carried_forward_and_says_what_it_skipped() {
    let mut one = One::active("{ centre_ne_m = [0, 0] }, { centre_ne_m = [9, 0] }, { centre_ne_m = [5, 5] }", "");
    // Vehicle 3 has sent nothing yet.
    one.view.misses_any = true;
    one.hear(2, 2, Some(1), 0.0);
    assert_eq!(formation(one.step(2.5, 30.0)).step, 0, "a single vehicle carries no other");
    one.hear(3, 2, None, 0.0);
    assert_eq!(formation(one.step(3.0, 30.0)).centre_ne_m, Vector2::new(5.0, 5.0));
    assert_eq!(one.told(), [Happening::Skipped { from: 0, to: 2 }]);
}

#[test]
fn a_hold_is_over_by_the_own_clock() {
    let mut one = One::active("{ hold_s = 40 }, { centre_ne_m = [9, 0] }", "");
    one.view = View { altitude_error_m: Some(0.0), ..View::default() };
    for second in 2..42 {
        one.step(f64::from(second), 30.0);
        assert_eq!(one.mission.at(), 0, "after {} s", second - 2);
    }
    one.step(42.0, 30.0);
    assert_eq!(one.mission.at(), 1);
}

/// Steps at 50 Hz from 2 s on; gives the last goal.
fn along(one: &mut One, seconds: f64, mut each: impl FnMut(&mut One, f64)) -> Goal {
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
    let goal = along(&mut one, 10.0, |_, _| {});
    assert!((goal.centre_ne_m - Vector2::new(20.0, 0.0)).norm() < 0.05, "{goal:?}");
    assert_eq!(goal.centre_velocity_ne_m_s, Vector2::new(2.0, 0.0));
    let mut one = One::active(PATH, "");
    one.view = View { altitude_error_m: Some(0.0), ..View::default() };
    let goal = along(&mut one, 60.0, |_, _| {});
    assert_eq!((goal.centre_ne_m, goal.centre_velocity_ne_m_s), (Vector2::new(100.0, 0.0), Vector2::zeros()));
}

#[test]
fn who_is_behind_hurries_and_who_is_ahead_waits_and_nobody_goes_back() {
    let with_other_at = |offset_m: f64| {
        let mut one = One::active(PATH, "");
        let mut goals = Vec::new();
        along(&mut one, 8.0, |one, now_s| {
            one.hear(2, 0, None, (2.0 * (now_s - 2.0) + offset_m).max(0.0));
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
fn who_joins_late_takes_the_centre_where_two_others_have_it() {
    let mut one = One::new(PATH, "");
    one.step(0.0, 30.0);
    for (second, progress_m) in [(0.5, 70.0), (1.0, 71.0), (1.9, 73.0)] {
        one.hear(2, 0, None, progress_m);
        one.hear(3, 0, None, progress_m + 10.0);
        one.step(second, 30.0);
    }
    one.hear(2, 0, None, 73.2);
    one.hear(3, 0, None, 1e8);
    let goal = formation(one.step(2.0, 30.0));
    assert!((goal.centre_ne_m.x - 73.2).abs() < 0.1, "one vehicle alone moves it nowhere: {goal:?}");
}

#[test]
fn a_vehicle_that_is_carried_forward_begins_where_the_others_have_the_centre() {
    let mut one = One::active(&format!("{{ centre_ne_m = [0, 0] }}, {PATH}"), "");
    one.hear(2, 1, Some(0), 40.0);
    one.hear(3, 1, Some(0), 42.0);
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
    assert_eq!((one.mission.membership(), one.mission.activity()), (Membership::Left, Activity::Landing));
}

#[test]
fn a_minority_holds_its_place_under_quorum() {
    let mut one = One::active(TWO, "mission.partition = \"quorum\"");
    for peer in [2, 3] {
        one.hear(peer, 0, None, 0.0);
    }
    formation(one.step(3.0, 30.0));
    one.contact = VehicleSet::default();
    assert!(matches!(one.step(4.0, 30.0), Task::Stay { .. }));
    one.contact.insert(id(2));
    formation(one.step(5.0, 30.0));
    let quorum = |told: &Happening| matches!(told, Happening::QuorumLost | Happening::QuorumBack);
    let told: Vec<_> = one.told().into_iter().filter(quorum).collect();
    assert!(told.ends_with(&[Happening::QuorumLost, Happening::QuorumBack]), "{told:?}");
}

#[test]
fn who_knows_nothing_of_itself_is_not_waited_for_and_joins_anew() {
    let mut one = One::active(TWO, "");
    one.mission.withdraw();
    assert_eq!(one.mission.membership(), Membership::Joining);
    assert!(matches!(one.step(10.0, 30.0), Task::Stay { .. }));
    assert!(matches!(one.step(11.9, 30.0), Task::Stay { .. }));
    formation(one.step(12.0, 30.0));
}

#[test]
fn holds_while_alone_and_goes_on_when_somebody_is_back() {
    let mut one = One::active(ONE, "");
    one.step(20.0, 30.0);
    one.view.conditions.insert(Condition::AllPeersLost);
    let held = one.step(21.0, 30.0);
    assert!(matches!(held, Task::Stay { altitude_m: 30.0, .. }));
    assert_eq!(one.mission.activity(), Activity::Holding);
    let mut elsewhere = estimate(30.0, 0.0);
    elsewhere.position = PositionNed::new(50.0, 50.0, -30.0);
    assert_eq!(one.step_at(22.0, &elsewhere), held, "the place does not drift with the vehicle");
    one.view.conditions = Conditions::default();
    formation(one.step_at(23.0, &elsewhere));
}

#[test]
fn an_order_to_go_on_ends_a_hold() {
    let mut one = One::active(TWO, "");
    one.order(HOLD);
    assert!(matches!(one.step(20.0, 30.0), Task::Stay { .. }));
    one.order(Order { epoch: 2, issuer: 1, verb: Verb::Goto(0), seal: None });
    assert_eq!(formation(one.step(21.0, 30.0)).step, 0);
    one.order(Order { epoch: 3, issuer: 1, verb: Verb::Goto(1), seal: None });
    assert_eq!(formation(one.step(22.0, 30.0)).step, 1);
}

#[test]
fn the_larger_order_stands() {
    let mut one = One::active(ONE, "");
    for order in [HOLD, HOLD, LAND, HOLD] {
        one.order(order);
    }
    assert_eq!(one.told(), [Happening::OrderTaken(HOLD), Happening::OrderTaken(LAND)]);
    assert_eq!(one.mission.order(), Some(LAND));
}

#[test]
fn whoever_lands_by_order_can_be_called_back_and_who_aborts_cannot() {
    let later = Order { epoch: 9, issuer: 1, verb: Verb::Goto(0), seal: None };
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
    assert_eq!(one.mission.activity(), Activity::Landing);
}

#[test]
fn a_failure_brings_the_vehicle_down_whatever_is_ordered() {
    let mut one = One::active(ONE, "");
    one.order(HOLD);
    one.view.conditions.insert(Failure::Gyro.into());
    assert!(matches!(one.step(20.0, 30.0), Task::Stay { .. }));
    assert_eq!((one.mission.membership(), one.mission.activity()), (Membership::Left, Activity::Landing));
    one.view.conditions.insert(Failure::Engine.into());
    assert!(matches!(one.step(20.1, 30.0), Task::Autorotate { .. }));
}

/// Flown for 27 s at a height of 25 m, `error_m` below its altitude, climbing at `climb_m_s`.
fn flown(more: &str, error_m: f64, climb_m_s: f64, collective_limit: Option<CollectiveLimit>) -> One {
    let mut one = One::active(ONE, more);
    (one.view.altitude_error_m, one.view.collective_limit) = (Some(error_m), collective_limit);
    for second in 3..30 {
        one.step_at(f64::from(second), &estimate(25.0, -climb_m_s));
    }
    one
}

#[test]
fn a_vehicle_without_collective_left_that_does_not_come_to_its_altitude_lands() {
    use CollectiveLimit::{Highest, Lowest};
    // Held there, or moving away from its altitude.
    for (error_m, climb_m_s, limit) in [(5.0, 0.0, Highest), (5.0, -2.0, Highest), (-5.0, 0.2, Lowest)] {
        let mut one = flown("", error_m, climb_m_s, Some(limit));
        assert_eq!(one.mission.membership(), Membership::Left, "{error_m} m, {climb_m_s} m/s");
        assert_eq!(one.told(), [Happening::Failed(Failure::Altitude)]);
        assert!(one.mission.is_stuck());
    }
    let mut one = One::active(ONE, "");
    (one.view.altitude_error_m, one.view.collective_limit) = (Some(20.0), Some(Highest));
    for second in 3..23 {
        one.step(f64::from(second), 12.0);
    }
    assert_eq!(one.mission.membership(), Membership::Active, "19 s");
}

#[test]
fn a_vehicle_whose_controller_has_collective_left_is_healthy_wherever_it_is() {
    use CollectiveLimit::{Highest, Lowest};
    for (error_m, climb_m_s, limit) in [
        // Gusts and a wind that changes hold it off its altitude while its trim is found.
        (-2.5, 0.0, None),
        (15.0, 0.0, None),
        // The end of the collective that is not asked for.
        (-5.0, 0.0, Some(Highest)),
        (5.0, 0.0, Some(Lowest)),
        // On its way, or there.
        (-15.0, -1.0, Some(Lowest)),
        (15.0, 1.0, Some(Highest)),
        (0.9, 0.0, Some(Highest)),
    ] {
        let one = flown("", error_m, climb_m_s, limit);
        assert_eq!(one.mission.membership(), Membership::Active, "{error_m} m, {climb_m_s} m/s, {limit:?}");
    }
}

#[test]
fn a_low_hover_is_no_touchdown() {
    let mut one = One::active(ONE, "");
    one.order(HOLD);
    one.step(3.0, 2.5);
    one.order(LAND);
    for tick in 0..60 {
        // It does not follow yet.
        let task = one.step(4.0 + 0.02 * f64::from(tick), 2.5);
        assert!(matches!(task, Task::Stay { .. }), "{task:?} after {tick} frames");
    }
}

#[test]
fn a_landing_from_below_the_place_held_goes_only_down() {
    let mut one = One::active(ONE, "");
    one.order(HOLD);
    one.step(3.0, 40.0);
    one.order(LAND);
    one.step(4.0, 30.0);
    let Task::Stay { altitude_m, .. } = one.step(4.02, 30.0) else { panic!("it comes down") };
    assert!(altitude_m < 30.0, "{altitude_m}");
}

#[test]
fn a_landing_descends_gently_unloads_and_leaves() {
    lands("", 0.0);
    // In wind, without auto-trim, it keeps above what is asked.
    lands("control.auto_trim = false", 0.0);
    lands("control.auto_trim = false", 7.6);
}

/// A vehicle that follows the altitude asked for with a lag, and so far above it.
fn lands(keys: &str, above_m: f64) {
    let mut one = One::active(ONE, keys);
    one.order(LAND);
    let (mut altitude_m, mut seconds, mut fastest_m_s) = (30.0, 20.0, 0.0_f64);
    let mut last_m_s = 0.0;
    while one.mission.activity() != Activity::Landed {
        seconds += 0.02;
        assert!(seconds < 90.0, "never landed");
        let sink_m_s = match one.step_at(seconds, &estimate(altitude_m, last_m_s)) {
            Task::Stay { altitude_m: wanted_m, .. } => (altitude_m - wanted_m - above_m) * 0.8,
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
fn an_order_to_land_on_the_ground_does_not_take_off() {
    let mut one = One::new(ONE, "");
    one.order(LAND);
    for tick in 0..300 {
        let task = one.step(f64::from(tick) * 0.02, 0.24);
        assert!(matches!(task, Task::Wait | Task::Park), "{task:?}");
    }
    assert_eq!(one.mission.activity(), Activity::Landed);
}

#[test]
fn orders_spread_from_peer_to_peer_among_those_with_the_same_plan() {
    let mut one = One::active(ONE, "");
    let friend = message::Mission { order: Some(LAND), ..one.register(2, 0, None, 0.0) };
    let stranger = message::Mission { plan: friend.plan ^ 1, ..friend };
    for said in [stranger, stranger] {
        one.mission.listen(&said, &mut one.told);
    }
    assert_eq!(one.told(), [Happening::PlanDiffers(id(2))], "told once");
    assert_eq!(one.mission.order(), None, "another plan's order is not ours");
    for said in [friend, friend] {
        one.mission.listen(&said, &mut one.told);
    }
    assert_eq!(one.told(), [Happening::OrderTaken(LAND)]);
}

#[test]
fn nobody_takes_part_before_the_rotor_is_at_speed() {
    let with_rotor = |speed_rad_s| Estimate { rotor_speed_rad_s: speed_rad_s, ..estimate(0.24, 0.0) };
    let mut one = One::new(ONE, "");
    one.mission.take_off_rotor_rad_s = Some(150.0);
    one.step_at(0.0, &with_rotor(Some(0.0)));
    assert_eq!(one.step_at(9.0, &with_rotor(Some(149.0))), Task::Wait);
    assert_eq!(one.mission.membership(), Membership::Joining);
    let mut told_to_leave = one.mission.clone();
    told_to_leave.leave();
    for tick in 0..150 {
        told_to_leave.step(
            at(9.1 + 0.02 * f64::from(tick)),
            &with_rotor(Some(0.0)),
            &one.view,
            [].iter(),
            &mut one.told,
        );
    }
    assert_eq!(told_to_leave.activity(), Activity::Landed, "nobody waits for a rotor that nobody starts");
    formation(one.step_at(9.1, &with_rotor(Some(151.0))));
    let mut untold = One::new(ONE, "");
    untold.mission.take_off_rotor_rad_s = Some(150.0);
    untold.step_at(0.0, &with_rotor(None));
    formation(untold.step_at(2.0, &with_rotor(None)));
}

/// What a mission's vehicle sends.
fn heartbeat_of(mission: &Mission, number: u8, sequence: u64) -> message::Mission {
    message::Mission {
        plan: mission.plan(),
        membership: mission.membership(),
        step: mission.at(),
        vouched: mission.vouched(),
        reached: mission.reached(),
        progress_m: mission.progress_m(),
        ..heartbeat(header(number, sequence))
    }
}

proptest! {
    /// Three vehicles, of which each is in place, in contact and received now and then.
    #[test]
    fn no_step_goes_back_and_none_is_left_before_every_counted_member_has_reached_it(
        script in proptest::collection::vec((0_u8..8, any::<u16>(), any::<u16>()), 1..150),
    ) {
        const STEP: &str = "{ centre_ne_m = [0, 0], dwell_s = 0.1 }";
        let steps = [STEP; 6].join(", ");
        let mut missions: [_; 3] = std::array::from_fn(|_| Mission::new(&scenario(&steps, ""), None));
        // What each vehicle has last received of each.
        let mut received: [[Option<message::Mission>; 3]; 3] = [[None; 3]; 3];
        for (tick, (in_place, contact, delivered)) in script.into_iter().enumerate() {
            let sent = [0, 1, 2].map(|nth| heartbeat_of(&missions[nth], nth as u8 + 1, tick as u64 + 1));
            for own in 0..3 {
                let has = |bits: u16, other: usize| bits >> (3 * own + other) & 1 == 1;
                let others = (0..3).filter(|&other| other != own);
                let in_contact: Vec<usize> = others.filter(|&other| has(contact, other)).collect();
                for &other in in_contact.iter().filter(|&&other| has(delivered, other)) {
                    received[own][other] = Some(sent[other]);
                    missions[own].listen(&sent[other], &mut Vec::new());
                }
                let known: Vec<_> = in_contact.iter().filter_map(|&other| received[own][other]).collect();
                let view = View {
                    misses_any: in_contact.len() < 2,
                    altitude_error_m: Some(0.0),
                    in_place: in_place >> own & 1 == 1,
                    ..View::default()
                };
                let (left, reached) = (missions[own].at(), missions[own].reached());
                let now = at(0.1 * tick as f64);
                missions[own].step(now, &estimate(30.0, 0.0), &view, known.iter(), &mut Vec::new());
                prop_assert!(missions[own].at() >= left && missions[own].reached() >= reached);
                if missions[own].at() == left {
                    continue;
                }
                for counted in known.iter().filter(|sent| sent.membership == Membership::Active) {
                    let member = &missions[usize::from(counted.header.sender.get()) - 1];
                    prop_assert!(member.at() > left || member.reached() >= Some(left), "{left}: {counted:?}");
                }
            }
        }
    }
}
