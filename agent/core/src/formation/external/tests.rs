use nalgebra::Vector3;
use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::VehicleSet;
use skein_common::scenario::{Source, load};

use super::*;
use crate::testing::id;

/// The dealings of vehicle 2 with a law, frame by frame.
struct Dealings {
    external: External,
    /// Counts frames of 20 ms.
    frame: u64,
    position: PositionNed,
    velocity: VelocityNed,
    told: Vec<Happening>,
}

impl Dealings {
    fn new(lines: &str) -> Self {
        let text = format!("swarm.vehicles = 3\n[formation.external]\n{lines}");
        let scenario = load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario;
        Self {
            external: External::new(&scenario.formation.external),
            frame: 100,
            position: PositionNed::new(150.0, 0.0, -30.0),
            velocity: VelocityNed::default(),
            told: Vec::new(),
        }
    }

    /// 20 ms on: what the law wants now, and what it is asked.
    fn step(&mut self, answer: Option<&Answer>) -> (Option<Consulted>, Option<Ask>) {
        self.frame += 1;
        self.external.hear(PlantTime::from_nanoseconds(self.frame * 20_000_000), answer);
        let neighbour = Neighbour {
            id: id(3),
            position: PositionNed::new(1.0, 2.0, -31.0),
            velocity: VelocityNed::new(0.1, 0.2, 0.0),
            heading_rad: 0.5,
            age_s: 0.6,
            is_fresh: false,
        };
        let sight = Sight {
            own: id(2),
            position: self.position,
            velocity: self.velocity,
            heading_rad: 1.5,
            neighbours: &[neighbour],
            unseen: VehicleSet::default(),
            obstacles: &[],
            goal: law::Goal {
                step: 1,
                centre: PositionNed::new(10.0, 0.0, -30.0),
                centre_velocity: VelocityNed::new(2.0, 0.0, 0.0),
                heading_rad: 0.3,
                radius_m: 100.0,
                gamma: 4.0,
            },
            dt_s: 0.02,
        };
        let consulted = self.external.consult(&sight);
        let ask = self.external.asked(&mut self.told);
        (consulted, ask)
    }

    /// Steps until the next ask; what is flown then, and the ask.
    fn next_ask(&mut self) -> (Option<Consulted>, Ask) {
        for _ in 0..1000 {
            if let (consulted, Some(ask)) = self.step(None) {
                return (consulted, ask);
            }
        }
        panic!("never asked")
    }

    /// What is flown of an answer to the next ask.
    fn flown(&mut self, answer: impl FnOnce(u64) -> Answer) -> Consulted {
        let (_, ask) = self.next_ask();
        self.step(Some(&answer(ask.tick))).0.unwrap()
    }
}

fn answer(tick: u64, wanted: Wanted) -> Answer {
    Answer { vehicle: id(2), tick, wanted, heading_rad: None, reached: None, log: Vec::new() }
}

fn velocity(north_m_s: f64, east_m_s: f64, down_m_s: f64) -> Wanted {
    Wanted::VelocityNed(Vector3::new(north_m_s, east_m_s, down_m_s))
}

fn wanted(consulted: Option<Consulted>) -> law::Wanted {
    consulted.unwrap().answer.wanted
}

const STAY: law::Wanted = law::Wanted::Way(Vector2::new(0.0, 0.0));

fn level_and_down(north_m_s: f64, east_m_s: f64, down_m_s: f64) -> law::Wanted {
    law::Wanted::Velocity { ne_m_s: Vector2::new(north_m_s, east_m_s), down_m_s: Some(down_m_s) }
}

#[test]
fn it_is_asked_evenly_and_told_what_its_vehicle_sees() {
    let mut dealings = Dealings::new("");
    let (first, ask) = dealings.step(None);
    assert_eq!(wanted(first), STAY, "nobody goes anywhere before the law has said where");
    let ask = ask.expect("at once");
    assert_eq!((ask.vehicle, ask.tick, ask.time_s, ask.dt_s), (id(2), 0, 2.02, 0.0));
    assert_eq!((ask.own.position_ned_m, ask.own.heading_rad), ([150.0, 0.0, -30.0], 1.5));
    let peer = ask.peers[0];
    assert_eq!((peer.id, peer.position_ned_m, peer.velocity_ned_m_s), (id(3), [1.0, 2.0, -31.0], [0.1, 0.2, 0.0]));
    assert_eq!((peer.heading_rad, peer.age_s, peer.fresh), (0.5, 0.6, false));
    let goal = ask.goal;
    assert_eq!((goal.step, goal.centre_ned_m, goal.centre_velocity_ned_m_s), (1, [10.0, 0.0, -30.0], [2.0, 0.0, 0.0]));
    assert_eq!((goal.heading_rad, goal.radius_m, goal.gamma), (0.3, 100.0, 4.0));
    let asked: Vec<u64> = (1..=20).filter(|_| dealings.step(None).1.is_some()).collect();
    assert_eq!(asked, [5, 10, 15, 20]);
}

#[test]
fn asks_keep_their_period_whatever_that_of_the_frames() {
    let mut dealings = Dealings::new("period_s = 0.05");
    let asked: Vec<u64> = (1..=25).filter(|_| dealings.step(None).1.is_some()).collect();
    assert_eq!(asked, [1, 4, 6, 9, 11, 14, 16, 19, 21, 24], "every 2.5 frames");
    let (_, ask) = dealings.next_ask();
    assert_eq!(ask.tick, 10);
    dealings.frame += 100;
    let (_, ask) = dealings.step(None);
    let ask = ask.unwrap();
    assert!((ask.dt_s - 2.02).abs() < 1e-9, "measured: {}", ask.dt_s);
    assert!(dealings.step(None).1.is_none(), "what was slept through is not made up for");
}

#[test]
fn an_answer_flies_from_the_next_step_until_another_one() {
    let mut dealings = Dealings::new("");
    let (_, ask) = dealings.next_ask();
    let (flown, _) = dealings.step(Some(&answer(ask.tick, velocity(1.0, -2.0, 0.5))));
    assert_eq!(wanted(flown), level_and_down(1.0, -2.0, 0.5));
    let (_, ask) = dealings.next_ask();
    assert_eq!(wanted(dealings.step(None).0), level_and_down(1.0, -2.0, 0.5), "the last answer stands");
    let (flown, _) = dealings.step(Some(&answer(ask.tick, Wanted::FieldNe(Vector2::new(0.1, 0.2)))));
    assert_eq!(wanted(flown), law::Wanted::Field(Vector3::new(0.1, 0.2, 0.0)));
    let (flown, _) = dealings.step(Some(&answer(ask.tick, velocity(3.0, 0.0, 0.0))));
    assert_eq!(wanted(flown), law::Wanted::Field(Vector3::new(0.1, 0.2, 0.0)), "one ask has one answer");
    assert_eq!(dealings.external.misses(), 0);
}

#[test]
fn a_fast_answer_is_cut_and_keeps_its_direction() {
    let mut dealings = Dealings::new("max_speed_m_s = 5");
    let flown = dealings.flown(|tick| answer(tick, velocity(6e8, 8e8, 0.0)));
    let law::Wanted::Velocity { ne_m_s, down_m_s } = flown.answer.wanted else { panic!("{flown:?}") };
    assert!((ne_m_s - Vector2::new(3.0, 4.0)).norm() < 1e-9 && down_m_s == Some(0.0), "{flown:?}");
}

#[test]
fn it_is_there_where_the_law_says_or_else_near_the_centre_and_slow() {
    let there = |reached: Option<bool>, north_m: f64, north_m_s: f64| {
        let mut dealings = Dealings::new("");
        dealings.position = PositionNed::new(north_m, 0.0, -30.0);
        dealings.velocity = VelocityNed::new(north_m_s, 0.0, 0.0);
        let flown =
            dealings.flown(|tick| Answer { reached, heading_rad: Some(2.5), ..answer(tick, velocity(0.0, 0.0, 0.0)) });
        assert_eq!(flown.heading_rad, Some(2.5));
        flown.answer.is_there
    };
    assert!(there(None, 109.0, 2.0) && !there(None, 111.0, 2.0), "within R* of the centre");
    assert!(!there(None, 109.0, 1.4), "slow relative to the centre");
    assert!(there(Some(true), 200.0, 0.0) && !there(Some(false), 10.0, 2.0));
}

#[test]
fn after_misses_in_a_row_it_is_lost_until_it_answers() {
    let mut dealings = Dealings::new("misses = 3");
    let (_, ask) = dealings.next_ask();
    dealings.step(Some(&answer(ask.tick, velocity(1.0, 0.0, 0.0))));
    for _ in 0..3 {
        assert!(dealings.next_ask().0.is_some(), "the last answer stands");
    }
    assert_eq!((dealings.external.misses(), dealings.told.as_slice()), (2, &[][..]));
    let (flown, ask) = dealings.next_ask();
    assert_eq!((flown, dealings.told.as_slice()), (None, &[Happening::LawLost][..]));
    let late = answer(ask.tick - 1, velocity(9.0, 0.0, 0.0));
    assert_eq!(dealings.step(Some(&late)).0, None, "an answer to an earlier ask does not bring it back");
    for _ in 0..4 {
        assert_eq!(dealings.next_ask().0, None);
    }
    assert_eq!((dealings.external.misses(), dealings.told.len()), (7, 1), "said once");
    let flown = dealings.flown(|tick| answer(tick, velocity(0.0, 1.0, 0.0)));
    assert_eq!(flown.answer.wanted, level_and_down(0.0, 1.0, 0.0));
    assert_eq!(dealings.told, [Happening::LawLost, Happening::LawBack]);
}

#[test]
fn after_a_rest_nothing_old_is_flown() {
    let mut dealings = Dealings::new("");
    let log = vec![LawNumber { name: "error".to_owned(), value: 0.5 }];
    dealings.flown(|tick| Answer { log: log.clone(), ..answer(tick, velocity(1.0, 0.0, 0.0)) });
    assert_eq!(dealings.external.log(), log);
    let (_, ask) = dealings.next_ask();
    dealings.external.rest();
    assert!(dealings.external.log().is_empty());
    let (flown, next) = dealings.step(Some(&answer(ask.tick, velocity(1.0, 0.0, 0.0))));
    assert_eq!(wanted(flown), STAY);
    assert_eq!(next.unwrap().tick, ask.tick + 1, "asked at once, and counted on");
    assert_eq!(dealings.external.misses(), 0, "nobody owed an answer");
}
