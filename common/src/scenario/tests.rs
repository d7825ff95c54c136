use super::*;

mod fleets;
mod loading;
mod properties;
mod refusals;

const SHIPPED: [(&str, &str); 6] = [
    ("hover.toml", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/scenarios/hover.toml"))),
    ("flock.toml", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/scenarios/flock.toml"))),
    ("tour.toml", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/scenarios/tour.toml"))),
    ("sinusoid.toml", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/scenarios/sinusoid.toml"))),
    ("crossing.toml", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/scenarios/crossing.toml"))),
    ("laws.toml", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/scenarios/laws.toml"))),
];
const HOVER: &str = SHIPPED[0].1;

fn try_load(name: &str, text: &str, sets: &[&str]) -> Result<Loaded, ScenarioError> {
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    load(&Source { name, text }, &sets)
}

/// Loads a valid file named `a.toml`.
fn loaded(text: &str, sets: &[&str]) -> Loaded {
    try_load("a.toml", text, sets).unwrap_or_else(|error| panic!("{error}\n{text}\n{sets:?}"))
}
