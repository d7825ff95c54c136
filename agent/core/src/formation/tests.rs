pub(super) mod points;

use proptest::prelude::*;
use proptest::sample::select;
use skein_common::frame::{Attitude, BodyRates, Geodetic};
use skein_common::math;
use skein_common::scenario::{Source, load};
use skein_common::state::PeerStatus;

use super::*;

/// The formation of vehicle 2 of four, with these lines under `[formation]`.
fn formation(lines: &str) -> Formation {
    let text = format!("swarm.vehicles = 4\n[formation]\n{lines}");
    let scenario = load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario;
    Formation::new(VehicleId::new(2).unwrap(), &scenario).unwrap()
}

fn at(north_m: f64, east_m: f64, altitude_m: f64) -> Estimate {
    Estimate {
        position: PositionNed::new(north_m, east_m, -altitude_m),
        geodetic: Geodetic::from_degrees(0.0, 0.0, 0.0),
        height_m: altitude_m,
        velocity: VelocityNed::default(),
        attitude: Attitude::default(),
        rates: BodyRates::default(),
        rotor_speed_rad_s: None,
    }
}

fn member(number: u8, north_m: f64, east_m: f64, altitude_m: f64) -> PeerEstimate {
    PeerEstimate {
        id: VehicleId::new(number).unwrap(),
        position: PositionNed::new(north_m, east_m, -altitude_m),
        velocity: VelocityNed::default(),
        heading_rad: 0.0,
        age_s: 0.0,
        delay_s: Some(0.0),
        carried_s: 0.0,
        standing: PeerStatus::Fresh,
        role: Role::Member,
    }
}

fn summary(near: &[PeerEstimate], flies_above: bool) -> PeerSummary<impl Iterator<Item = PeerEstimate>> {
    let members = near.iter().filter(|peer| peer.role == Role::Member).map(|peer| peer.id).collect();
    PeerSummary { near: near.iter().copied(), members, flies_above }
}

/// The task to fly a formation around a centre at the origin that moves north.
fn task(speed_m_s: f64) -> Task {
    Task::Formation(mission::MissionGoal {
        step: 0,
        centre_ne_m: Vector2::zeros(),
        centre_velocity_ne_m_s: Vector2::new(speed_m_s, 0.0),
        heading_rad: 0.0,
    })
}

fn output(formation: &mut Formation, estimate: &Estimate, peers: &[PeerEstimate], speed_m_s: f64) -> FormationOutput {
    formation
        .step(0.02, estimate, (summary(peers, false), core::iter::empty()), &task(speed_m_s), &mut Workspace::default())
        .unwrap()
}

#[test]
fn each_law_has_its_own_rule_for_being_in_place() {
    let placed = |lines: &str, estimate: Estimate| output(&mut formation(lines), &estimate, &[], 0.0).in_place;
    assert!(placed("", at(100.0, 0.0, 30.0)) && !placed("", at(70.0, 0.0, 30.0)), "ring: in the band");
    assert!(!placed("", at(85.0, 0.0, 30.0)), "ring: only with a weak field");
    assert!(placed("law = 'flock'", at(45.0, 0.0, 30.0)) && !placed("law = 'flock'", at(51.0, 0.0, 30.0)), "inside");
    let slots = "law = 'virtual-structure'";
    assert!(placed(slots, at(102.0, 0.0, 30.0)) && !placed(slots, at(104.0, 0.0, 30.0)), "near the slot");
    for lines in ["", "law = 'flock'\nradius_m = 101", slots] {
        assert!(placed(lines, at(100.0, 0.0, 30.5)) && !placed(lines, at(100.0, 0.0, 28.0)), "{lines}: at altitude");
        let drifts = Estimate { velocity: VelocityNed::new(0.0, 0.6, 0.0), ..at(100.0, 0.0, 30.0) };
        assert!(!placed(lines, drifts), "{lines}: slow");
    }
}

#[test]
fn slow_is_relative_to_the_centre_whether_or_not_it_is_fed_forward() {
    let along = Estimate { velocity: VelocityNed::new(2.0, 0.0, 0.0), ..at(10.0, 0.0, 30.0) };
    let fed = output(&mut formation("law = 'flock'"), &along, &[], 2.0);
    assert!(fed.in_place && fed.setpoint.feedforward_ne_m_s == Vector2::new(2.0, 0.0));
    let trailing = output(&mut formation("law = 'flock'\nfeedforward = false"), &along, &[], 2.0);
    assert!(trailing.in_place && trailing.setpoint.feedforward_ne_m_s == Vector2::zeros());
}

#[test]
fn slots_and_bands_follow_the_ranks_of_the_live_members() {
    let peers = [member(1, 0.0, 100.0, 30.0), member(4, 0.0, -100.0, 30.0)];
    let lines = "law = 'virtual-structure'\nradius_m = 60\nband_step_m = 4";
    let second_of_three = output(&mut formation(lines), &at(-30.0, 50.0, 30.0), &peers, 0.0);
    assert_eq!(second_of_three.setpoint.altitude_m, 30.0, "the middle band");
    assert!(
        (second_of_three.setpoint.error_ne_m() - Vector2::new(0.0, 1.9615)).norm() < 1e-3,
        "a third of the circle further"
    );
    let first_of_two = output(&mut formation(lines), &at(-30.0, 50.0, 30.0), &peers[1..], 0.0);
    assert_eq!(first_of_two.setpoint.altitude_m, 28.0);
    assert!((first_of_two.setpoint.error_ne_m().norm() - 15.0).abs() < 1e-9, "at most 15 m");
}

#[test]
fn on_an_ellipsoid_a_vehicle_below_another_descends() {
    let mut formation = formation("vertical = 'ellipsoid'\nradius_m = 40\naltitude_m = 60");
    let peers = [member(1, 40.0, 0.0, 75.0)];
    let first_m = output(&mut formation, &at(40.0, 0.0, 60.0), &peers, 0.0).setpoint.altitude_m;
    let second = output(&mut formation, &at(40.0, 0.0, 60.0), &peers, 0.0);
    assert!(second.setpoint.altitude_m < first_m && !second.in_place);
}

#[test]
fn the_filter_includes_the_feedforward_and_ignores_vehicles_far_above() {
    let slots = "law = 'virtual-structure'\nradius_m = 100";
    // In its slot if there are three vehicles; the centre moves north, where another vehicle hovers.
    let (sin, cos) = math::sin_cos(core::f64::consts::TAU / 3.0);
    let place = at(100.0 * cos, 100.0 * sin, 30.0);
    let ahead = |altitude_m| [member(1, 100.0 * cos + 12.0, 100.0 * sin, altitude_m), member(3, 0.0, -90.0, 30.0)];
    let mut filtered = formation(slots);
    let held = output(&mut filtered, &place, &ahead(30.0), 4.0);
    let flown_m_s = held.setpoint.relative_velocity_ne_m_s + held.setpoint.feedforward_ne_m_s;
    assert!((flown_m_s.x - 0.125 * 80.0 / 12.0).abs() < 1e-9, "κ/4 h / d: {flown_m_s}");
    assert_eq!(filtered.safety_activations(), Some(1));
    output(&mut filtered, &place, &ahead(30.0), 4.0);
    assert_eq!(filtered.safety_activations(), Some(1), "counted once per intervention");
    let above = output(&mut filtered, &place, &ahead(38.5), 4.0);
    assert!(above.setpoint.relative_velocity_ne_m_s.norm() < 1e-6);
    let free = output(&mut formation("law = 'virtual-structure'\nsafety_filter = 'none'"), &place, &ahead(30.0), 4.0);
    assert!(free.setpoint.relative_velocity_ne_m_s.norm() < 1e-6);
}

/// Coordinates that often coincide with another vehicle's and are often far away.
fn coordinate_m() -> impl Strategy<Value = f64> {
    prop_oneof![Just(0.0), Just(1e-9), -1.0..1.0, -200.0..200.0, -1e5..1e5]
}

fn any_member() -> impl Strategy<Value = PeerEstimate> {
    let place = (coordinate_m(), coordinate_m(), 20.0..40.0);
    (1_u8..9, place, -300.0..300.0, prop::option::of(0.1..30.0)).prop_map(|(id, (n, e, altitude_m), speed, radius)| {
        let role = radius.map_or(Role::Member, |radius_m| Role::Obstacle { radius_m });
        PeerEstimate { velocity: VelocityNed::new(speed, -speed / 3.0, 0.0), role, ..member(id, n, e, altitude_m) }
    })
}

proptest! {
    /// Alone, coincident, with unusual ranks, with an impossible peer: every law stays finite.
    #[test]
    fn every_law_gives_finite_bounded_outputs_for_any_observation(
        law in select(laws::built_in()), pattern in select(&["circle", "line", "v", "grid"][..]),
        mut peers in prop::collection::vec(any_member(), 0..8), own in (coordinate_m(), coordinate_m()),
        speed in -300.0..300.0, centre in -5.0..5.0, dt_s in select(&[0.0, 0.02, 1e6][..]),
    ) {
        peers.sort_by_key(|peer| peer.id);
        peers.dedup_by_key(|peer| peer.id);
        peers.retain(|peer| peer.id.get() != 2);
        let estimate = Estimate { velocity: VelocityNed::new(speed, speed / 2.0, 1.0), ..at(own.0, own.1, 30.0) };
        for filter in ["cbf", "none"] {
            let lines = format!("law = '{law}'\nsafety_filter = '{filter}'\nslots.pattern = '{pattern}'");
            let mut formation = formation(&lines);
            for _ in 0..2 {
                let output = formation.step(dt_s, &estimate, (summary(&peers, false), core::iter::empty()), &task(centre), &mut Workspace::default()).unwrap();
                let Setpoint { relative_velocity_ne_m_s, feedforward_ne_m_s, altitude_m, heading_rad } = output.setpoint;
                let error_ne_m = output.setpoint.error_ne_m();
                let numbers = relative_velocity_ne_m_s.iter().chain(&feedforward_ne_m_s).chain(&output.field_ne);
                prop_assert!(numbers.chain([&altitude_m, &heading_rad]).all(|x| x.is_finite()), "{law}: {output:?}");
                let is_field = ["ring", "flock"].contains(&law);
                let bound_m = if is_field { 28.0 * 20.0 } else { 15.0 + 1e-9 };
                prop_assert!(filter == "cbf" || error_ne_m.norm() <= bound_m, "{law}: {error_ne_m}");
            }
        }
    }
}

#[test]
fn a_vehicle_keeps_away_from_an_obstacle_that_flies_towards_it_sooner_than_from_one_that_stays() {
    let north_m_s = |speed_m_s: f64| {
        let obstacle = PeerEstimate {
            role: Role::Obstacle { radius_m: 8.0 },
            velocity: VelocityNed::new(-speed_m_s, 0.0, 0.0),
            ..member(3, 30.0, 0.0, 30.0)
        };
        let mut formation = formation("law = 'displacement-consensus'");
        let stay = Task::Stay { at_ne_m: Vector2::zeros(), altitude_m: 30.0, heading_rad: 0.0, lands: false };
        let flown = formation.step(
            0.02,
            &at(0.0, 0.0, 30.0),
            (summary(&[obstacle], false), core::iter::empty()),
            &stay,
            &mut Workspace::default(),
        );
        flown.unwrap().setpoint.relative_velocity_ne_m_s.x
    };
    assert_eq!(north_m_s(0.0), 0.0, "30 m away it may stay");
    assert!(north_m_s(10.0) < -2.0 && north_m_s(10.0) < north_m_s(8.0), "{} {}", north_m_s(10.0), north_m_s(8.0));
}

#[test]
fn a_velocity_command_is_over_the_ground_with_or_without_feedforward() {
    for feedforward in [true, false] {
        let lines = format!("law = 'vasarhelyi'\nfeedforward = {feedforward}\nsafety_filter = 'none'");
        let setpoint = output(&mut formation(&lines), &at(0.0, 0.0, 30.0), &[], 3.0).setpoint;
        let flown_m_s = setpoint.relative_velocity_ne_m_s + setpoint.feedforward_ne_m_s;
        assert!((flown_m_s - Vector2::new(3.0, 0.0)).norm() < 1e-12, "at the centre: its velocity");
    }
}

/// A law with a fixed command that counts its queries.
#[derive(Clone, Debug)]
struct FixedLaw(LawCommand, usize);

impl Law for FixedLaw {
    fn update(&mut self, _: &Observation<'_>) -> LawOutput {
        self.1 += 1;
        LawOutput { command: self.0, reached: true }
    }
}

#[test]
fn a_law_may_command_a_climb_and_a_non_finite_command_counts_as_zero() {
    let mut formation = formation("altitude_m = 30\nsafety_filter = 'none'");
    let mut flown = |command, altitude_m| {
        formation.shapes[0].law = Box::new(FixedLaw(command, 0));
        output(&mut formation, &at(0.0, 0.0, altitude_m), &[], 0.0).setpoint
    };
    let climbs = |up_m_s: f64| LawCommand::Velocity { ne_m_s: Vector2::new(1.0, 0.0), down_m_s: Some(-up_m_s) };
    assert_eq!(flown(climbs(1.0), 10.0).altitude_m, 30.0, "the vehicle first takes off");
    let up = flown(climbs(1.0), 31.0);
    assert!((up.altitude_m - 31.02).abs() < 1e-9 && up.relative_velocity_ne_m_s == Vector2::new(1.0, 0.0), "{up:?}");
    for nothing in [climbs(f64::NAN), LawCommand::Displacement(Vector2::new(f64::INFINITY, 0.0))] {
        let setpoint = flown(nothing, 31.0);
        assert!(setpoint.relative_velocity_ne_m_s == Vector2::zeros() && setpoint.altitude_m == 30.0, "{setpoint:?}");
    }
}

/// Where the ground is in the hill of the next test, m above the origin.
fn ground_m(north_m: f64) -> f64 {
    (0.25 * north_m).clamp(0.0, 50.0)
}

#[test]
fn under_every_law_a_vehicle_keeps_the_floor_above_a_hill_and_lands_below_it() {
    let on_ellipsoid = "law = 'ring'\nvertical = 'ellipsoid'\nradius_m = 20\ninner_width_m = 10".to_owned();
    for law in laws::built_in().iter().map(|law| format!("law = '{law}'")).chain([on_ellipsoid]) {
        let lines = |floor: &str| format!("{law}\naltitude_m = 30\n[airspace]\nceiling_m = 60\n{floor}");
        let (mut kept, mut without) = (formation(&lines("floor_above_ground_m = 15")), formation(&lines("")));
        // North over the hill at 4 m/s, after the setpoint with a lag of 1 s.
        let (mut north_m, mut altitude_m, mut least_m) = (-100.0, 30.0, f64::INFINITY);
        while north_m < 300.0 {
            let estimate = Estimate { height_m: altitude_m - ground_m(north_m), ..at(north_m, 0.0, altitude_m) };
            let setpoint_m = output(&mut kept, &estimate, &[], 0.0).setpoint.altitude_m;
            let unlimited_m = output(&mut without, &estimate, &[], 0.0).setpoint.altitude_m;
            assert_eq!(setpoint_m, unlimited_m.max(ground_m(north_m) + 15.0), "{law} at {north_m} m");
            altitude_m += (setpoint_m - altitude_m).clamp(-2.0, 2.0) * 0.02;
            north_m += 4.0 * 0.02;
            least_m = least_m.min(estimate.height_m);
        }
        assert!((13.0..15.5).contains(&least_m), "{law}: {least_m} m above the ground");
        assert!((64.0..66.0).contains(&altitude_m), "{law}: above the ceiling, over the hill: {altitude_m} m");

        let stays = |lands| Task::Stay { at_ne_m: Vector2::new(300.0, 0.0), altitude_m: 55.0, heading_rad: 0.0, lands };
        let estimate = Estimate { height_m: altitude_m - 50.0, ..at(300.0, 0.0, altitude_m) };
        let altitudes_m = [false, true].map(|lands| {
            let stayed = kept.step(
                0.02,
                &estimate,
                (summary(&[], false), core::iter::empty()),
                &stays(lands),
                &mut Workspace::default(),
            );
            stayed.unwrap().setpoint.altitude_m
        });
        assert_eq!(altitudes_m, [65.0, 55.0], "{law}: it holds above the floor, and lands through it");
        let wrong = Estimate { height_m: -1e300, ..estimate };
        assert!(output(&mut kept, &wrong, &[], 0.0).setpoint.altitude_m <= altitude_m + 15.0, "{law}");
    }
}

#[test]
fn steps_with_the_same_formation_share_the_laws_memory() {
    let steps = "[{ hold_s = 1 }, { centre_ne_m = [9, 0], formation = { radius_m = 50 } }, { centre_ne_m = [5, 0] }]";
    let text = format!("swarm.vehicles = 4\nmission.steps = {steps}");
    let scenario = load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario;
    let formation = Formation::new(VehicleId::new(2).unwrap(), &scenario).unwrap();
    assert_eq!((formation.shapes.len(), formation.steps), (2, vec![0, 1, 0]));
}

#[test]
fn a_vehicle_that_stays_keeps_the_rise_of_its_partition() {
    let stay = |altitude_m, lands| Task::Stay { at_ne_m: Vector2::zeros(), altitude_m, heading_rad: 0.0, lands };
    let mut formation = formation("");
    let mut fly = |flies_above: bool, task: &Task| {
        let others = || summary(&[], flies_above);
        let mut workspace = Workspace::default();
        let step =
            |_| formation.step(0.02, &at(100.0, 0.0, 40.0), (others(), core::iter::empty()), task, &mut workspace);
        let steps = (0..1000).filter_map(step);
        steps.map(|output| output.setpoint.altitude_m).last().unwrap()
    };
    assert!((fly(true, &task(0.0)) - 40.0).abs() < 1e-9, "10 m above the 30 m of the other partition");
    assert!((fly(true, &stay(40.0, false)) - 40.0).abs() < 1e-9);
    assert!((fly(false, &stay(40.0, false)) - 30.0).abs() < 1e-9, "descends after the partitions rejoin");
    assert!((fly(true, &stay(12.0, true)) - 12.0).abs() < 1e-9, "nothing is added during a landing");
    assert!((fly(true, &stay(12.0, false)) - 12.0).abs() < 1e-9, "recalled, the vehicle stays at its altitude");
}
