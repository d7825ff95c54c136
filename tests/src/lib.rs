//! What the whole-swarm tests share.

use skein::study::Study;
use skein_agent::aircraft::Aircraft;
use skein_agent::control::Rules;
use skein_common::scenario::{Scenario, Source, load};

/// The shipped scenarios, by name.
pub const SHIPPED: [(&str, &str); 4] = [
    ("hover.toml", include_str!("../../deploy/scenarios/hover.toml")),
    ("flock.toml", include_str!("../../deploy/scenarios/flock.toml")),
    ("tour.toml", include_str!("../../deploy/scenarios/tour.toml")),
    ("sinusoid.toml", include_str!("../../deploy/scenarios/sinusoid.toml")),
];

/// A shipped scenario with some keys set.
///
/// # Panics
/// If there is no such scenario, or a set is wrong.
pub fn scenario(name: &str, sets: &[&str]) -> Scenario {
    let (_, text) = SHIPPED.iter().find(|(shipped, _)| *shipped == name).expect("a shipped scenario");
    let sets: Vec<_> = sets.iter().map(|&set| set.to_owned()).collect();
    load(&Source { name, text }, &sets).expect("a scenario that may fly").scenario
}

/// A study of a shipped scenario with some keys set.
///
/// # Panics
/// As [`scenario`].
pub fn study(name: &str, sets: &[&str]) -> Study {
    let scenario = scenario(name, sets);
    let aircraft = Aircraft::shipped("xcell60").expect("it is shipped").expect("it is well formed");
    Study { aircraft: vec![aircraft; scenario.swarm.vehicles], scenario, rules: Rules::shipped() }
}
