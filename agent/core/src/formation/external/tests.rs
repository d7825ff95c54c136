use nalgebra::Vector3;
use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::VehicleSet;
use skein_common::scenario::{Source, load};

use super::*;
use crate::tests::id;

/// The exchange of vehicle 2 with a law, frame by frame.
struct Session {
    external: External,
    /// Number of frames of 20 ms.
    frame: u64,
    position: PositionNed,
    velocity: VelocityNed,
    events: Vec<EventKind>,
}

impl Session {
    fn new(lines: &str) -> Self {
        let text = format!("swarm.vehicles = 3\n[formation.external]\n{lines}");
        let scenario = load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario;
        Self {
            external: External::new(&scenario.formation.external),
            frame: 100,
            position: PositionNed::new(150.0, 0.0, -30.0),
            velocity: VelocityNed::default(),
            events: Vec::new(),
        }
    }

    /// Advances by 20 ms; returns the law's output and its query.
    fn step(&mut self, answer: Option<&LawReply>) -> (Option<(LawOutput, Option<f64>)>, Option<LawQuery>) {
        self.frame += 1;
        self.external.receive_reply(PlantTime::from_nanoseconds(self.frame * 20_000_000), answer);
        let neighbour = Neighbour {
            id: id(3),
            position: PositionNed::new(1.0, 2.0, -31.0),
            velocity: VelocityNed::new(0.1, 0.2, 0.0),
            heading_rad: 0.5,
            age_s: 0.6,
            is_fresh: false,
        };
        let observation = Observation {
            own: id(2),
            position: self.position,
            velocity: self.velocity,
            heading_rad: 1.5,
            neighbours: &[neighbour],
            members: VehicleSet::default(),
            obstacles: &[],
            goal: Goal {
                step: 1,
                centre: PositionNed::new(10.0, 0.0, -30.0),
                centre_velocity: VelocityNed::new(2.0, 0.0, 0.0),
                heading_rad: 0.3,
                radius_m: 100.0,
                gamma: 4.0,
            },
            dt_s: 0.02,
        };
        let external_output = self.external.output(&observation);
        let ask = self.external.take_query(&mut self.events);
        (external_output, ask)
    }

    /// Steps until the next query; returns the output of that step and the query.
    fn next_query(&mut self) -> (Option<(LawOutput, Option<f64>)>, LawQuery) {
        for _ in 0..1000 {
            if let (external_output, Some(ask)) = self.step(None) {
                return (external_output, ask);
            }
        }
        panic!("no query")
    }

    /// The output after this reply to the next query.
    fn flown(&mut self, answer: impl FnOnce(u64) -> LawReply) -> (LawOutput, Option<f64>) {
        let (_, ask) = self.next_query();
        self.step(Some(&answer(ask.tick))).0.unwrap()
    }
}

fn answer(tick: u64, command: ReplyCommand) -> LawReply {
    LawReply { vehicle: id(2), tick, command, heading_rad: None, reached: None, log: Vec::new() }
}

fn velocity(north_m_s: f64, east_m_s: f64, down_m_s: f64) -> ReplyCommand {
    ReplyCommand::VelocityNed(Vector3::new(north_m_s, east_m_s, down_m_s))
}

fn command(external_output: Option<(LawOutput, Option<f64>)>) -> LawCommand {
    external_output.unwrap().0.command
}

const STAY: LawCommand = LawCommand::Displacement(Vector2::new(0.0, 0.0));

fn level_and_down(north_m_s: f64, east_m_s: f64, down_m_s: f64) -> LawCommand {
    LawCommand::Velocity { ne_m_s: Vector2::new(north_m_s, east_m_s), down_m_s: Some(down_m_s) }
}

#[test]
fn queries_are_periodic_and_carry_the_vehicles_observation() {
    let mut session = Session::new("");
    let (first, ask) = session.step(None);
    assert_eq!(command(first), STAY, "the vehicle stays before the first reply");
    let ask = ask.expect("a query in the first step");
    assert_eq!((ask.vehicle, ask.tick, ask.time_s, ask.dt_s), (id(2), 0, 2.02, 0.0));
    assert_eq!((ask.own.position, ask.own.heading_rad), ([150.0, 0.0, -30.0].into(), 1.5));
    let peer = ask.peers[0];
    assert_eq!((peer.id, peer.position), (id(3), [1.0, 2.0, -31.0].into()));
    assert_eq!(peer.velocity, [0.1, 0.2, 0.0].into());
    assert_eq!((peer.heading_rad, peer.age_s, peer.is_fresh), (0.5, 0.6, false));
    let goal = ask.goal;
    assert_eq!((goal.step, goal.centre), (1, [10.0, 0.0, -30.0].into()));
    assert_eq!(goal.centre_velocity, [2.0, 0.0, 0.0].into());
    assert_eq!((goal.heading_rad, goal.radius_m, goal.gamma), (0.3, 100.0, 4.0));
    let asked: Vec<u64> = (1..=20).filter(|_| session.step(None).1.is_some()).collect();
    assert_eq!(asked, [5, 10, 15, 20]);
}

#[test]
fn queries_keep_their_period_at_any_frame_period() {
    let mut session = Session::new("period_s = 0.05");
    let asked: Vec<u64> = (1..=25).filter(|_| session.step(None).1.is_some()).collect();
    assert_eq!(asked, [1, 4, 6, 9, 11, 14, 16, 19, 21, 24], "every 2.5 frames");
    let (_, ask) = session.next_query();
    assert_eq!(ask.tick, 10);
    session.frame += 100;
    let (_, ask) = session.step(None);
    let ask = ask.unwrap();
    assert!((ask.dt_s - 2.02).abs() < 1e-9, "measured: {}", ask.dt_s);
    assert!(session.step(None).1.is_none(), "missed periods are not made up");
}

#[test]
fn a_reply_is_flown_from_the_next_step_until_the_next_reply() {
    let mut session = Session::new("");
    let (_, ask) = session.next_query();
    let (flown, _) = session.step(Some(&answer(ask.tick, velocity(1.0, -2.0, 0.5))));
    assert_eq!(command(flown), level_and_down(1.0, -2.0, 0.5));
    let (_, ask) = session.next_query();
    assert_eq!(command(session.step(None).0), level_and_down(1.0, -2.0, 0.5), "the last reply is flown");
    let (flown, _) = session.step(Some(&answer(ask.tick, ReplyCommand::FieldNe(Vector2::new(0.1, 0.2)))));
    assert_eq!(command(flown), LawCommand::Field(Vector3::new(0.1, 0.2, 0.0)));
    let (flown, _) = session.step(Some(&answer(ask.tick, velocity(3.0, 0.0, 0.0))));
    assert_eq!(command(flown), LawCommand::Field(Vector3::new(0.1, 0.2, 0.0)), "a second reply is ignored");
    assert_eq!(session.external.misses, 0);
}

#[test]
fn a_fast_reply_is_limited_and_keeps_its_direction() {
    let mut session = Session::new("max_speed_m_s = 5");
    let flown = session.flown(|tick| answer(tick, velocity(6e8, 8e8, 0.0)));
    let LawCommand::Velocity { ne_m_s, down_m_s } = flown.0.command else { panic!("{flown:?}") };
    assert!((ne_m_s - Vector2::new(3.0, 4.0)).norm() < 1e-9 && down_m_s == Some(0.0), "{flown:?}");
}

#[test]
fn the_law_decides_in_place_or_else_a_slow_vehicle_near_the_centre_is() {
    let there = |reached: Option<bool>, north_m: f64, north_m_s: f64| {
        let mut session = Session::new("");
        session.position = PositionNed::new(north_m, 0.0, -30.0);
        session.velocity = VelocityNed::new(north_m_s, 0.0, 0.0);
        let flown =
            session.flown(|tick| LawReply { reached, heading_rad: Some(2.5), ..answer(tick, velocity(0.0, 0.0, 0.0)) });
        assert_eq!(flown.1, Some(2.5));
        flown.0.reached
    };
    assert!(there(None, 109.0, 2.0) && !there(None, 111.0, 2.0), "within R* of the centre");
    assert!(!there(None, 109.0, 1.4), "slow relative to the centre");
    assert!(there(Some(true), 200.0, 0.0) && !there(Some(false), 10.0, 2.0));
}

#[test]
fn after_misses_in_a_row_the_law_is_lost_until_its_next_reply() {
    let mut session = Session::new("misses = 3");
    let (_, ask) = session.next_query();
    session.step(Some(&answer(ask.tick, velocity(1.0, 0.0, 0.0))));
    for _ in 0..3 {
        assert!(session.next_query().0.is_some(), "the last reply is flown");
    }
    assert_eq!((session.external.misses, session.events.as_slice()), (2, &[][..]));
    let (flown, ask) = session.next_query();
    assert_eq!((flown, session.events.as_slice()), (None, &[EventKind::LawLost][..]));
    let late = answer(ask.tick - 1, velocity(9.0, 0.0, 0.0));
    assert_eq!(session.step(Some(&late)).0, None, "a late reply does not bring the law back");
    for _ in 0..4 {
        assert_eq!(session.next_query().0, None);
    }
    assert_eq!((session.external.misses, session.events.len()), (7, 1), "reported once");
    let flown = session.flown(|tick| answer(tick, velocity(0.0, 1.0, 0.0)));
    assert_eq!(flown.0.command, level_and_down(0.0, 1.0, 0.0));
    assert_eq!(session.events, [EventKind::LawLost, EventKind::LawBack]);
}

#[test]
fn after_a_suspension_no_old_reply_is_flown() {
    let mut session = Session::new("");
    let log = vec![LawNumber { name: "error".to_owned(), value: 0.5 }];
    session.flown(|tick| LawReply { log: log.clone(), ..answer(tick, velocity(1.0, 0.0, 0.0)) });
    assert_eq!(session.external.log(), log);
    let (_, ask) = session.next_query();
    session.external.suspend();
    assert!(session.external.log().is_empty());
    let (flown, next) = session.step(Some(&answer(ask.tick, velocity(1.0, 0.0, 0.0))));
    assert_eq!(command(flown), STAY);
    assert_eq!(next.unwrap().tick, ask.tick + 1, "queried at once, with the next number");
    assert_eq!(session.external.misses, 0, "no reply was pending");
}
