//! Every fault against a small mission: what it does to the swarm, and how soon the swarm is over it.

use std::collections::BTreeSet;

use skein_common::id::VehicleId;
use skein_common::scenario::{Scenario, Source, load};
use skein_common::state::Membership;
use skein_core::agent::Agent;
use skein_core::peers::Role;
use skein_lab::metrics::COLLISION_M;
use skein_lab::world::World;

use crate::{airborne_pairs, in_parallel, median_and_worst, of_scenario};

/// Name of a fault, and the event that it is; vehicle 2 has it, and the seed says when.
pub const FAULTS: [(&str, &str); 9] = [
    ("engine out", r#"fault = "engine_out", vehicle = 2"#),
    ("servo stuck", r#"fault = "servo_stuck", vehicle = 2, servo = "SERVO""#),
    ("gyro off", r#"fault = "gyro_off", vehicle = 2"#),
    ("gps frozen", r#"fault = "gps_frozen", vehicle = 2"#),
    ("agent killed", r#"fault = "kill", vehicle = 2, for_s = 20"#),
    ("simulator frozen", r#"fault = "simulator_freeze", vehicle = 2, for_s = 20"#),
    ("cut one way", r#"fault = "cut", from = [2], to = [OTHERS], for_s = 20"#),
    ("cut both ways", r#"fault = "cut", from = [2], to = [OTHERS], both_ways = true, for_s = 20"#),
    ("clock jump", r#"fault = "clock_jump", vehicle = 2, by_s = 3600"#),
];

/// The mission is given up after this time, s.
const LIMIT_S: f64 = 900.0;

/// One flight with one fault.
#[derive(Clone, Copy, Debug, Default)]
pub struct Flight {
    /// Pairs of which one was healthy that came too near to each other.
    pub collisions: usize,
    /// Least distance between two in the air, m.
    pub closest_m: f64,
    /// Everybody who was healthy came to the mission's end.
    pub finished: bool,
    /// From the fault until no other vehicle counts the one that has it, s.
    pub noticed_s: Option<f64>,
    /// From the fault until all others count it again and it takes part, s.
    pub back_s: Option<f64>,
    /// From the fault until the healthy ones go on to the next place, s.
    pub next_place_s: Option<f64>,
    /// Length of the mission, s.
    pub mission_s: f64,
}

/// The scenario of one flight; `fault` is one of [`FAULTS`], or nothing.
///
/// # Panics
/// If a fault is not spelled as scenarios spell it.
pub fn scenario(fault: Option<&str>, vehicles: usize, seed: u64) -> Scenario {
    let others = (1..=vehicles).filter(|&id| id != 2).map(|id| id.to_string()).collect::<Vec<_>>().join(", ");
    let servo = ["roll", "pitch", "collective"][seed as usize % 3];
    let event = fault.map_or_else(String::new, |fault| {
        // On the way up, in place, between places: whatever the seed brings.
        let at_s = 10 + 7 * seed;
        let fault = fault.replace("OTHERS", &others).replace("SERVO", servo);
        format!("{{ at_s = {at_s}, {fault} }}")
    });
    let text = format!(
        r#"
        name = "faults"
        seed = {seed}
        swarm.vehicles = {vehicles}
        formation.radius_m = 60
        [mission]
        steps = [
          {{ centre_ne_m = [0, 0] }},
          {{ centre_ne_m = [120, 0] }},
          {{ centre_ne_m = [120, 120], formation = {{ altitude_m = 45 }} }},
          {{ land = true }},
        ]
        events = [{event}]
        "#
    );
    load(&Source { name: "faults", text: &text }, &[]).expect("a scenario that may fly").scenario
}

/// Flies it.
///
/// # Panics
/// If it cannot begin.
pub fn fly(fault: Option<&str>, vehicles: usize, seed: u64) -> Flight {
    let study = of_scenario(scenario(fault, vehicles, seed));
    let mut world = World::new(&study.scenario, &study.aircraft, &study.rules).expect("it may fly");
    let at_s = study.scenario.mission.events.first().map(|event| event.at_s);
    let victim = VehicleId::new(2).expect("an id");
    let mut flight = Flight { closest_m: f64::INFINITY, ..Flight::default() };
    let (mut began_s, mut step_then, mut near) = (None, 0, BTreeSet::new());
    while world.t_s() < LIMIT_S && !flight.finished {
        world.tick();
        if began_s.is_none() && world.all_active() {
            began_s = Some(world.t_s());
        }
        let Some(began_s) = began_s else { continue };
        look_at_pairs(&world, &mut flight, &mut near);
        let since_s = at_s.map(|at_s| world.t_s() - began_s - at_s);
        let healthy = || world.vehicles().filter(|(id, ..)| *id != victim || fault.is_none());
        let step = healthy().map(|(_, agent, ..)| agent.at_step()).min().unwrap_or(0);
        match since_s {
            Some(since_s) if since_s >= 0.0 => {
                let counts =
                    |agent: &Agent| agent.peers().iter().any(|peer| peer.id == victim && peer.role == Role::Member);
                if !healthy().any(|(_, agent, ..)| counts(agent)) {
                    flight.noticed_s.get_or_insert(since_s);
                }
                let takes_part = |(id, agent, ..): (VehicleId, &Agent, _, _)| {
                    id == victim && agent.membership() == Membership::Active
                };
                if flight.noticed_s.is_some()
                    && healthy().all(|(_, agent, ..)| counts(agent))
                    && world.vehicles().any(takes_part)
                {
                    flight.back_s.get_or_insert(since_s);
                }
                if step > step_then {
                    flight.next_place_s.get_or_insert(since_s);
                }
            }
            _ => step_then = step,
        }
        flight.finished = healthy().all(|(_, agent, ..)| agent.has_finished());
        flight.mission_s = world.t_s() - began_s;
    }
    flight.collisions = near.len();
    flight
}

fn look_at_pairs(world: &World, flight: &mut Flight, near: &mut BTreeSet<(VehicleId, VehicleId)>) {
    for (one, other, distance_m) in airborne_pairs(world) {
        flight.closest_m = flight.closest_m.min(distance_m);
        if distance_m < COLLISION_M {
            near.insert((one, other));
        }
    }
}

/// The table: every fault with each of these numbers of vehicles, over so many seeds.
pub fn table(vehicles: &[usize], seeds: u64) -> String {
    let mut lines = vec![format!(
        "{:<17} {:>8} {:>6} {:>10} {:>9} {:>9} {:>15} {:>15} {:>15} {:>17}",
        "fault",
        "vehicles",
        "flights",
        "collisions",
        "finished",
        "closest m",
        "noticed s",
        "back s",
        "next place s",
        "mission s"
    )];
    let cells = vehicles.iter().flat_map(|&n| {
        [("none", None)].into_iter().chain(FAULTS.map(|(name, event)| (name, Some(event)))).map(move |fault| (n, fault))
    });
    for (vehicles, (name, fault)) in cells {
        let flights = in_parallel(0..seeds, |seed| fly(fault, vehicles, seed));
        lines.push(row(name, vehicles, &flights));
    }
    lines.join("\n")
}

fn row(name: &str, vehicles: usize, flights: &[Flight]) -> String {
    let of = |figure: fn(&Flight) -> Option<f64>| median_and_worst(flights.iter().map(figure));
    let collisions: usize = flights.iter().map(|flight| flight.collisions).sum();
    let finished = flights.iter().filter(|flight| flight.finished).count();
    let closest_m = flights.iter().map(|flight| flight.closest_m).fold(f64::INFINITY, f64::min);
    format!(
        "{name:<17} {vehicles:>8} {:>6} {collisions:>10} {finished:>9} {closest_m:>9.1} {:>15} {:>15} {:>15} {:>17}",
        flights.len(),
        of(|flight| flight.noticed_s),
        of(|flight| flight.back_s),
        of(|flight| flight.next_place_s),
        of(|flight| Some(flight.mission_s)),
    )
}
