//! A command's scenario: read, checked against what can be flown today, refused before anything else happens.

use std::path::PathBuf;

use skein_agent::aircraft::Aircraft;
use skein_agent::plant::helicopter::Start;
use skein_agent::start::starts;
use skein_agent::supported;
use skein_common::scenario::{Loaded, PlantKind, Scenario, Source, load};

use crate::error::Error;

/// What flies when nobody says what.
const HOVER: Source<'_> = Source { name: "hover.toml", text: include_str!("../scenarios/hover.toml") };

/// Which scenario.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct ScenarioArgs {
    /// Scenario file; without one, the hover formation of Garcia & Barnes 2010 flies
    #[arg(value_name = "SCENARIO")]
    pub scenario: Option<PathBuf>,
    /// Any key of the scenario over what the file says, such as formation.radius_m=50; the last one wins
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
}

impl ScenarioArgs {
    /// Reads the scenario, `more` sets on top of those given.
    ///
    /// # Errors
    /// If the file cannot be read, or it or a set is at fault.
    pub fn read(&self, more: Vec<String>) -> Result<Loaded, Error> {
        let sets = [self.sets.clone(), more].concat();
        let loaded = |source: &Source<'_>| {
            load(source, &sets).map_err(|fault| Error::Scenario { fault, text: source.text.to_owned() })
        };
        let Some(path) = &self.scenario else { return loaded(&HOVER) };
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|error| Error::Refused(format!("{name}: {error}")))?;
        loaded(&Source { name: &name, text: &text })
    }

    /// The file as messages name it.
    pub fn name(&self) -> String {
        self.scenario.as_ref().map_or_else(|| HOVER.name.to_owned(), |path| path.display().to_string())
    }
}

/// What a flight of the scenario begins with.
#[derive(Clone, Debug)]
pub struct Ready {
    /// Where each vehicle stands, in the order of ids.
    pub starts: Vec<Start>,
}

/// Makes sure that agents of this build can fly the scenario.
///
/// # Errors
/// A sentence that says what stands against it.
pub fn ready(scenario: &Scenario) -> Result<Ready, String> {
    supported::goal(scenario).map_err(|error| error.to_string())?;
    for vehicle in &scenario.vehicle {
        let name = &vehicle.aircraft;
        let aircraft = Aircraft::shipped(name).ok_or_else(|| {
            let known = Aircraft::SHIPPED.map(|(known, _)| known).join(", ");
            format!("vehicle {}: there is no aircraft \"{name}\"; there is {known}", vehicle.id)
        })?;
        let aircraft = aircraft.map_err(|error| error.to_string())?;
        if scenario.swarm.plant != PlantKind::Xplane && aircraft.helicopter.is_none() {
            return Err(format!("vehicle {}: only X-Plane can fly the aircraft \"{name}\"", vehicle.id));
        }
    }
    Ok(Ready { starts: starts(scenario).map_err(|error| error.to_string())? })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(set: &str) -> String {
        let args = ScenarioArgs::default();
        ready(&args.read(vec![set.to_owned()]).unwrap().scenario).unwrap_err()
    }

    #[test]
    fn without_a_file_the_hover_formation_is_read() {
        let loaded = ScenarioArgs::default().read(vec!["seed=9".to_owned()]).unwrap();
        assert_eq!((loaded.scenario.name.as_str(), loaded.scenario.seed), ("hover", 9));
        assert_eq!(ScenarioArgs::default().name(), "hover.toml");
    }

    #[test]
    fn sugar_stands_above_a_set() {
        let args = ScenarioArgs { sets: vec!["seed=3".to_owned(), "duration_s=7".to_owned()], ..Default::default() };
        let scenario = args.read(vec!["seed=4".to_owned()]).unwrap().scenario;
        assert_eq!((scenario.seed, scenario.duration_s), (4, Some(7.0)));
    }

    #[test]
    fn what_is_not_flown_is_refused() {
        assert!(refused("formation.law=flock").contains("not flown yet"));
        assert_eq!(refused("vehicle.3.aircraft=r22"), "vehicle 3: there is no aircraft \"r22\"; there is xcell60");
    }

    #[test]
    fn a_file_that_is_not_there_is_refused() {
        let args = ScenarioArgs { scenario: Some("no/such.toml".into()), sets: Vec::new() };
        let error = args.read(Vec::new()).unwrap_err();
        assert!(error.to_string().starts_with("no/such.toml: "), "{error}");
        assert_eq!(error.exit_code(), 2);
    }
}
