//! A swarm that a network cut splits into two partitions for a while: the steps of each partition during the cut, and
//! the time until the swarm is one again.

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::scenario::{Scenario, Source, load};
use skein_lab::faults::InjectedFault;
use skein_lab::metrics::COLLISION_M;
use skein_lab::world::World;

use crate::{airborne_pairs, in_parallel, median_and_worst, of_scenario};

/// Duration of the cut, s.
const CUT_S: f64 = 20.0;
/// Time after which every vehicle has noticed the cut, s: a lease and one or two frames.
const NOTICED_S: f64 = 1.2;

/// One flight.
#[derive(Clone, Copy, Debug)]
pub struct PartitionFlight {
    /// Steps that the first partition advanced while it knew of the cut.
    pub first_steps: u32,
    /// Steps that the second partition advanced while it knew of the cut.
    pub second_steps: u32,
    /// Time from the end of the cut until all vehicles are in contact and at the same step, s. One vehicle may be a
    /// step ahead: it left the step just before it received the others again, and waits for them at the next.
    pub rejoined_s: Option<f64>,
    /// Least distance between two airborne vehicles, m.
    pub closest_m: f64,
}

impl PartitionFlight {
    /// Whether two vehicles came closer than the collision distance.
    pub fn has_collided(&self) -> bool {
        self.closest_m < COLLISION_M
    }
}

/// The scenario: a cut between vehicles 1 to `first` and the rest of `vehicles`, with many places close to each other.
fn scenario(partition: &str, first: usize, vehicles: usize, seed: u64) -> Scenario {
    let ids = |range: std::ops::RangeInclusive<usize>| range.map(|id| id.to_string()).collect::<Vec<_>>().join(", ");
    let places: Vec<_> = (0..30).map(|nth| format!("{{ centre_ne_m = [{}, 0] }}", 10 * nth)).collect();
    let (from, to) = (ids(1..=first), ids(first + 1..=vehicles));
    let text = format!(
        r#"
        name = "halves"
        seed = {seed}
        swarm.vehicles = {vehicles}
        formation.radius_m = 40
        [mission]
        partition = "{partition}"
        dwell_s = 1
        steps = [{}]
        events = [{{ at_s = {}, fault = "cut", from = [{from}], to = [{to}], both_ways = true, for_s = {CUT_S} }}]
        "#,
        places.join(", "),
        40 + seed
    );
    load(&Source { name: "halves", text: &text }, &[]).expect("a valid scenario").scenario
}

/// Flies the scenario until 30 s after the end of the cut.
///
/// # Panics
/// If the flight cannot start.
pub fn fly(partition: &str, first: usize, vehicles: usize, seed: u64) -> PartitionFlight {
    let study = of_scenario(scenario(partition, first, vehicles, seed));
    let mut world = World::new(&study.scenario, &study.aircraft, &study.rules).expect("a valid scenario");
    let is_first = |id: VehicleId| usize::from(id.get()) <= first;
    let foremost = |world: &World, in_first: bool| {
        let part = world.vehicles().filter(|(id, ..)| is_first(*id) == in_first);
        part.map(|(_, agent, ..)| agent.at_step()).max().unwrap_or(0)
    };
    let (mut cut_s, mut healed_s, mut steps_then) = (None, None, None);
    let mut flight = PartitionFlight { first_steps: 0, second_steps: 0, rejoined_s: None, closest_m: f64::INFINITY };
    while healed_s.is_none_or(|healed_s| world.t_s() < healed_s + 30.0) {
        world.tick();
        let t_s = world.t_s();
        for fault in world.faults() {
            match fault {
                InjectedFault::Cut { .. } => cut_s = cut_s.or(Some(t_s)),
                InjectedFault::Healed { .. } if healed_s.is_none() => {
                    healed_s = Some(t_s);
                    let (one, two) = steps_then.unwrap_or_default();
                    flight.first_steps = foremost(&world, true) - one;
                    flight.second_steps = foremost(&world, false) - two;
                }
                _ => {}
            }
        }
        if cut_s.is_some_and(|cut_s| t_s >= cut_s + NOTICED_S) && steps_then.is_none() {
            steps_then = Some((foremost(&world, true), foremost(&world, false)));
        }
        if let Some(healed_s) = healed_s
            && is_one(&world)
        {
            flight.rejoined_s.get_or_insert(t_s - healed_s);
        }
        let distances_m = airborne_pairs(&world).into_iter().map(|(.., distance_m)| distance_m);
        flight.closest_m = distances_m.fold(flight.closest_m, f64::min);
    }
    flight
}

fn is_one(world: &World) -> bool {
    let all: VehicleSet = world.vehicles().map(|(id, ..)| id).collect();
    let last = world.vehicles().map(|(_, agent, ..)| agent.at_step()).min().unwrap_or_default();
    let ahead: Vec<u32> = world.vehicles().map(|(_, agent, ..)| agent.at_step() - last).filter(|by| *by > 0).collect();
    let are_together = matches!(ahead[..], [] | [1]);
    are_together
        && world.vehicles().all(|(id, agent, ..)| {
            let mut known = agent.peers_in_contact();
            known.insert(id);
            known == all
        })
}

/// Policy, size of the first partition, size of the swarm.
pub const CASES: [(&str, usize, usize); 4] =
    [("continue", 2, 4), ("continue", 3, 5), ("quorum", 2, 4), ("quorum", 3, 5)];

/// The table over this many seeds.
pub fn table(seeds: u64) -> String {
    let mut lines = vec![format!(
        "{:<9} {:>6} {:>7} {:>14} {:>14} {:>10} {:>15} {:>9}",
        "policy", "parts", "flights", "first steps", "second steps", "collisions", "rejoined s", "closest m"
    )];
    for (partition, first, vehicles) in CASES {
        let flights = in_parallel(0..seeds, |seed| fly(partition, first, vehicles, seed));
        let range = |steps: fn(&PartitionFlight) -> u32| {
            let steps = || flights.iter().map(steps);
            format!("{} to {}", steps().min().unwrap_or(0), steps().max().unwrap_or(0))
        };
        lines.push(format!(
            "{partition:<9} {:>6} {:>7} {:>14} {:>14} {:>10} {:>15} {:>9.1}",
            format!("{first}+{}", vehicles - first),
            flights.len(),
            range(|flight| flight.first_steps),
            range(|flight| flight.second_steps),
            flights.iter().filter(|flight| flight.has_collided()).count(),
            median_and_worst(flights.iter().map(|flight| flight.rejoined_s)),
            flights.iter().map(|flight| flight.closest_m).fold(f64::INFINITY, f64::min),
        ));
    }
    lines.join("\n")
}
