//! Start positions of a scenario's vehicles, the same for every agent that computes them.

use alloc::vec::Vec;
use core::f64::consts::TAU;

use rand::Rng;
use skein_common::math;
use skein_common::scenario::{Scenario, StartPattern};

use crate::helicopter::Start;
use crate::random::{self, Purpose};

/// Number of draws per vehicle in one attempt, and number of attempts, after which the square counts as too full.
const DRAWS_PER_VEHICLE: usize = 1_000;
const ATTEMPTS: usize = 100;

/// The start positions do not fit into their square.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{vehicles} vehicles {separation_m} m apart do not fit into a square of {square_m} m")]
pub struct StartAreaTooSmall {
    vehicles: usize,
    separation_m: f64,
    square_m: f64,
}

/// The start of every vehicle, in the order of ids. It depends only on the seed and the keys of `[start]` and
/// `[vehicle.N]`.
///
/// # Errors
///
/// The square is too small for the vehicles at their separation.
pub fn starts(scenario: &Scenario) -> Result<Vec<Start>, StartAreaTooSmall> {
    let vehicles = scenario.swarm.vehicles;
    let mut generator = random::generator(scenario.seed, None, Purpose::Start);
    let each = |start: &dyn Fn(usize) -> Start| -> Vec<Start> { (0..vehicles).map(start).collect() };
    let mut starts = match scenario.start.pattern {
        StartPattern::Random => random_starts(scenario, &mut generator)?,
        StartPattern::Ring => each(&|index| {
            let (sin, cos) = math::sin_cos(TAU * index as f64 / vehicles as f64);
            let radius_m = scenario.start.square_m / 2.0;
            Start { north_m: radius_m * cos, east_m: radius_m * sin, heading_rad: 0.0 }
        }),
        StartPattern::Line | StartPattern::AsIs => each(&|index| {
            let from_middle = index as f64 - (vehicles - 1) as f64 / 2.0;
            Start { north_m: 0.0, east_m: from_middle * scenario.start.separation_m, heading_rad: 0.0 }
        }),
    };
    for (start, vehicle) in starts.iter_mut().zip(&scenario.vehicle) {
        if let Some([north_m, east_m]) = vehicle.start_ne_m {
            *start = Start { north_m, east_m, ..*start };
        }
        if let Some(heading_rad) = vehicle.heading_rad() {
            start.heading_rad = heading_rad;
        }
    }
    Ok(starts)
}

/// Starts evenly distributed over the square around the origin, at least the separation apart, with random headings.
fn random_starts(scenario: &Scenario, generator: &mut impl Rng) -> Result<Vec<Start>, StartAreaTooSmall> {
    let (vehicles, start) = (scenario.swarm.vehicles, &scenario.start);
    for _ in 0..ATTEMPTS {
        let mut starts: Vec<Start> = Vec::with_capacity(vehicles);
        for _ in 0..DRAWS_PER_VEHICLE * vehicles {
            let Some(vehicle) = scenario.vehicle.get(starts.len()) else { return Ok(starts) };
            let mut coordinate = || (random::uniform(generator) - 0.5) * start.square_m;
            let (north_m, east_m) = (coordinate(), coordinate());
            let heading_rad = (random::uniform(generator) - 0.5) * TAU;
            // Positions from the file are reserved before any draw. A vehicle with such a position is drawn as well,
            // then moved.
            let mut given = scenario.vehicle.iter().filter_map(|vehicle| vehicle.start_ne_m);
            let is_far = |[n_m, e_m]: [f64; 2]| math::hypot(n_m - north_m, e_m - east_m) >= start.separation_m;
            let is_free = starts.iter().all(|start| is_far([start.north_m, start.east_m])) && given.all(is_far);
            if vehicle.start_ne_m.is_some() || is_free {
                starts.push(Start { north_m, east_m, heading_rad });
            }
        }
    }
    Err(StartAreaTooSmall { vehicles, separation_m: start.separation_m, square_m: start.square_m })
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::{Source, load};

    use super::*;

    fn scenario(text: &str) -> Scenario {
        load(&Source { name: "test.toml", text }, &[]).unwrap().scenario
    }

    #[test]
    fn random_starts_keep_their_distance_and_follow_the_seed() {
        let of_seed = |seed: u64| starts(&scenario(&format!("seed = {seed}\nswarm.vehicles = 12"))).unwrap();
        for seed in 0..50 {
            let starts = of_seed(seed);
            assert_eq!(starts.len(), 12);
            for (index, one) in starts.iter().enumerate() {
                assert!(one.north_m.abs() <= 75.0 && one.east_m.abs() <= 75.0);
                for other in &starts[..index] {
                    assert!(math::hypot(one.north_m - other.north_m, one.east_m - other.east_m) >= 15.0);
                }
            }
            assert_eq!(starts, of_seed(seed));
            assert_ne!(starts, of_seed(seed + 1));
        }
    }

    #[test]
    fn random_starts_keep_their_distance_from_given_ones() {
        for seed in 0..50 {
            let text = format!("seed = {seed}\nswarm.vehicles = 9\n[vehicle.9]\nstart_ne_m = [0, 0]");
            let starts = starts(&scenario(&text)).unwrap();
            assert_eq!((starts[8].north_m, starts[8].east_m), (0.0, 0.0));
            assert!(starts[..8].iter().all(|start| math::hypot(start.north_m, start.east_m) >= 15.0), "seed {seed}");
        }
    }

    #[test]
    fn a_vehicle_with_a_given_start_position_starts_there() {
        let text = "swarm.vehicles = 2\n[start]\npattern = \"line\"\nseparation_m = 20\n[vehicle.2]\nstart_ne_m = [7, 8]\nheading_deg = 90";
        let starts = starts(&scenario(text)).unwrap();
        assert_eq!(starts[0], Start { north_m: 0.0, east_m: -10.0, heading_rad: 0.0 });
        assert_eq!(starts[1], Start { north_m: 7.0, east_m: 8.0, heading_rad: TAU / 4.0 });
    }
}
