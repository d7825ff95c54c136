//! Functions that the whole-swarm tests share.

pub mod central;
pub mod central_summary;
pub mod conversion;
pub mod divergence;
pub mod faults;
pub mod fit;
pub mod fleets;
pub mod formation_error;
pub mod golden;
pub mod halves;
pub mod hostile_pages;
pub mod laws;
pub mod missions;
#[cfg(target_os = "linux")]
pub mod namespaces;
#[cfg(target_os = "linux")]
pub mod one_pc;
pub mod page_client;
pub mod processes;
pub mod python;
pub mod schedule;
pub mod share;
#[cfg(unix)]
pub mod soak;
pub mod tour;
pub mod variants;
pub mod wind;
pub mod wire;
pub mod world;

use std::convert::Infallible;
use std::ops::Range;

use skein_common::id::VehicleId;
use skein_common::scenario::{Scenario, Source, load, load_any};
use skein_common::statistics::median;
use skein_core::aircraft::Aircraft;
use skein_core::control::Rules;
use skein_lab::external::LawPool;
use skein_lab::metrics::AIRBORNE_ABOVE_M;
use skein_lab::study::{self, Study};
use skein_lab::world::World;

/// The shipped scenarios, by name.
pub const SHIPPED: [(&str, &str); 6] = [
    ("hover.toml", include_str!("../../deploy/scenarios/hover.toml")),
    ("flock.toml", include_str!("../../deploy/scenarios/flock.toml")),
    ("tour.toml", include_str!("../../deploy/scenarios/tour.toml")),
    ("sinusoid.toml", include_str!("../../deploy/scenarios/sinusoid.toml")),
    ("crossing.toml", include_str!("../../deploy/scenarios/crossing.toml")),
    ("laws.toml", include_str!("../../deploy/scenarios/laws.toml")),
];

/// A shipped scenario with some keys set.
///
/// # Panics
/// If the scenario is unknown, or a setting is not valid.
pub fn scenario(name: &str, sets: &[&str]) -> Scenario {
    let (_, text) = SHIPPED.iter().find(|(shipped, _)| *shipped == name).expect("a shipped scenario");
    let sets: Vec<_> = sets.iter().map(|&set| set.to_owned()).collect();
    load(&Source { name, text }, &sets).expect("a valid scenario").scenario
}

/// A study of a shipped scenario with some keys set.
///
/// # Panics
/// If the scenario is unknown, or a setting is not valid.
pub fn study(name: &str, sets: &[&str]) -> Study {
    of_scenario(scenario(name, sets))
}

/// A study of a scenario with the shipped aircraft and rules.
///
/// # Panics
/// If the shipped files are not well formed.
pub fn of_scenario(scenario: Scenario) -> Study {
    let aircraft = Aircraft::shipped("xcell60").expect("a shipped aircraft").expect("a well-formed file");
    Study {
        aircraft: vec![aircraft; scenario.swarm.vehicles],
        scenario,
        rules: Rules::shipped(),
        laws: LawPool::default(),
    }
}

/// The studies of the teams of a fleet's file with these keys set, and the shipped aircraft and rules.
///
/// # Panics
/// If the text does not describe a fleet.
pub fn fleet(text: &str, sets: &[String]) -> Vec<Study> {
    let described = load_any(&Source { name: "fleet.toml", text }, sets).expect("a valid fleet");
    described.all().iter().map(|team| of_scenario(team.scenario.clone())).collect()
}

/// Every pair of airborne vehicles, the smaller id first, with its distance, m.
pub fn airborne_pairs(world: &World) -> Vec<(VehicleId, VehicleId, f64)> {
    let airborne = world.all_vehicles().filter(|(_, _, truth, _)| truth.height_m > AIRBORNE_ABOVE_M);
    let places: Vec<_> = airborne.map(|(id, _, truth, _)| (id, truth.position)).collect();
    let pairs = places.iter().enumerate().flat_map(|(nth, one)| places[..nth].iter().map(move |other| (other, one)));
    pairs.map(|(one, other)| (one.0, other.0, (one.1 - other.1).norm())).collect()
}

/// The results of `fly` for each seed, in the order of the seeds; one thread for each core.
pub fn in_parallel<T: Send>(seeds: Range<u64>, fly: impl Fn(u64) -> T + Sync) -> Vec<T> {
    let count = (seeds.end - seeds.start) as usize;
    let Ok(flown) = skein_host::parallel::in_parallel(count, skein_host::parallel::cores(), |nth| {
        Ok::<_, Infallible>(fly(seeds.start + nth as u64))
    });
    flown
}

/// `median [largest]` of the values that exist, with the number of those that do not: `1.20 [3.40] 2 never`.
pub fn median_and_worst(values: impl Iterator<Item = Option<f64>>) -> String {
    let all: Vec<_> = values.collect();
    let mut some: Vec<f64> = all.iter().copied().flatten().collect();
    let never = if some.len() < all.len() { format!(" {} never", all.len() - some.len()) } else { String::new() };
    let worst = some.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    median(&mut some).map_or_else(|| "-".to_owned(), |median| format!("{median:.2} [{worst:.2}]{never}"))
}
