//! Every fault in a small mission in wind: its effect on the swarm, and the time until the swarm recovers.

use std::collections::BTreeMap;

use skein_common::id::VehicleId;
use skein_common::scenario::{Scenario, Source, load};
use skein_common::state::Membership;
use skein_core::agent::Agent;
use skein_core::peers::Role;
use skein_core::random::{self, Purpose};
use skein_lab::metrics::COLLISION_M;
use skein_lab::world::World;

use crate::{airborne_pairs, in_parallel, median_and_worst, of_scenario};

/// Name and event of each fault. It affects vehicle 2, at a time that depends on the seed.
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

/// The wind of the strongest flights, m/s; the seed decides the wind and its gusts.
const STRONGEST_M_S: f64 = 10.0;
/// Limit of the flight time, s.
const LIMIT_S: f64 = 900.0;

/// One flight with one fault.
#[derive(Clone, Debug, Default)]
pub struct FaultFlight {
    /// Pairs, with at least one healthy vehicle, that came closer than the collision distance, with the time, s.
    pub collisions: BTreeMap<(VehicleId, VehicleId), f64>,
    /// Least distance between two airborne vehicles, m.
    pub closest_m: f64,
    /// Whether every healthy vehicle finished the mission.
    pub finished: bool,
    /// Time from the fault until no other vehicle counts the faulty one as a member, s.
    pub noticed_s: Option<f64>,
    /// Time from the fault until the faulty vehicle is active again and all others count it as a member, s.
    pub back_s: Option<f64>,
    /// Time from the fault until the healthy vehicles advance to the next place, s.
    pub next_place_s: Option<f64>,
    /// Length of the mission, s.
    pub mission_s: f64,
}

/// The scenario of one flight; `fault` is the event of one of [`FAULTS`], or `None`.
///
/// # Panics
/// If the event of the fault is not valid.
pub fn scenario(fault: Option<&str>, vehicles: usize, seed: u64) -> Scenario {
    let others = (1..=vehicles).filter(|&id| id != 2).map(|id| id.to_string()).collect::<Vec<_>>().join(", ");
    let servo = ["roll", "pitch", "collective"][seed as usize % 3];
    let event = fault.map_or_else(String::new, |fault| {
        // The seed decides whether the fault occurs during the climb, in place or between places.
        let at_s = 10 + 7 * (seed % 20);
        let fault = fault.replace("OTHERS", &others).replace("SERVO", servo);
        format!("{{ at_s = {at_s}, {fault} }}")
    });
    let mut generator = random::generator(seed, None, Purpose::Study);
    let wind_m_s = STRONGEST_M_S * random::uniform(&mut generator);
    let gust_w20_m_s = wind_m_s * random::uniform(&mut generator);
    let wind_from_deg = 360.0 * random::uniform(&mut generator);
    let text = format!(
        r#"
        name = "faults"
        seed = {seed}
        swarm.vehicles = {vehicles}
        formation.radius_m = 60
        world = {{ wind_m_s = {wind_m_s}, wind_from_deg = {wind_from_deg}, gust_w20_m_s = {gust_w20_m_s} }}
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
    load(&Source { name: "faults", text: &text }, &[]).expect("a valid scenario").scenario
}

/// Flies one mission with this fault.
///
/// # Panics
/// If the flight cannot start.
pub fn fly(fault: Option<&str>, vehicles: usize, seed: u64) -> FaultFlight {
    let study = of_scenario(scenario(fault, vehicles, seed));
    let mut world = World::new(&study.scenario, &study.aircraft, &study.rules).expect("a valid scenario");
    let at_s = study.scenario.mission.events.first().map(|event| event.at_s);
    let victim = VehicleId::new(2).expect("an id");
    let mut flight = FaultFlight { closest_m: f64::INFINITY, ..FaultFlight::default() };
    let (mut began_s, mut step_then) = (None, 0);
    while world.t_s() < LIMIT_S && !flight.finished {
        world.tick();
        if began_s.is_none() && world.all_active() {
            began_s = Some(world.t_s());
        }
        let Some(began_s) = began_s else { continue };
        look_at_pairs(&world, &mut flight);
        let since_s = at_s.map(|at_s| world.t_s() - began_s - at_s);
        let healthy = || world.vehicles().filter(|(id, ..)| *id != victim || fault.is_none());
        let step = healthy().map(|(_, agent, ..)| agent.at_step()).min().unwrap_or(0);
        match since_s {
            Some(since_s) if since_s >= 0.0 => {
                let counts = |agent: &Agent| agent.peers().any(|peer| peer.id == victim && peer.role == Role::Member);
                if !healthy().any(|(_, agent, ..)| counts(agent)) {
                    flight.noticed_s.get_or_insert(since_s);
                }
                let is_active = |(id, agent, ..): (VehicleId, &Agent, _, _)| {
                    id == victim && agent.membership() == Membership::Active
                };
                if flight.noticed_s.is_some()
                    && healthy().all(|(_, agent, ..)| counts(agent))
                    && world.vehicles().any(is_active)
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
    flight
}

fn look_at_pairs(world: &World, flight: &mut FaultFlight) {
    for (one, other, distance_m) in airborne_pairs(world) {
        flight.closest_m = flight.closest_m.min(distance_m);
        if distance_m < COLLISION_M {
            flight.collisions.entry((one, other)).or_insert(world.t_s());
        }
    }
}

/// The table of every fault with each of these numbers of vehicles, over this many seeds; then every collision.
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
    let mut collisions = Vec::new();
    for (vehicles, (name, fault)) in cells {
        let flights = in_parallel(0..seeds, |seed| fly(fault, vehicles, seed));
        lines.push(row(name, vehicles, &flights));
        for (seed, flight) in flights.iter().enumerate() {
            collisions.extend(flight.collisions.iter().map(|((one, other), t_s)| {
                format!(
                    "{name}, {vehicles} vehicles, seed {seed}: collision of vehicles {one} and {other} at {t_s:.1} s"
                )
            }));
        }
    }
    lines.append(&mut collisions);
    lines.join("\n")
}

fn row(name: &str, vehicles: usize, flights: &[FaultFlight]) -> String {
    let of = |figure: fn(&FaultFlight) -> Option<f64>| median_and_worst(flights.iter().map(figure));
    let collisions: usize = flights.iter().map(|flight| flight.collisions.len()).sum();
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
