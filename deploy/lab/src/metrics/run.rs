//! Identity and duration of a run.

use serde::Serialize;
use skein_common::scenario::{ModelKind, Scenario};

/// Identity of a run: scenario, seed and program.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Run {
    /// Name of the scenario.
    pub scenario: String,
    /// Preset of the scenario.
    pub preset: String,
    /// Formation law.
    pub law: String,
    /// Field conversion.
    pub conversion: String,
    /// Plant that flew: `builtin`, `standin`, `xplane`, or the built-in `point_mass`.
    pub plant: String,
    /// Command that flew: `fly` or `study`.
    pub target: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Version of the program.
    pub version: String,
    /// Git revision of the program.
    pub revision: String,
    /// Number of vehicles.
    pub vehicles: usize,
}

impl Run {
    /// The identity of a run of this scenario by the command `target`.
    pub fn new(scenario: &Scenario, target: &str) -> Self {
        Self {
            scenario: scenario.name.clone(),
            preset: spelling(&scenario.preset),
            law: spelling(&scenario.formation.law),
            conversion: spelling(&scenario.formation.conversion),
            plant: match scenario.plant.model {
                ModelKind::Helicopter => spelling(&scenario.swarm.plant),
                ModelKind::PointMass => spelling(&scenario.plant.model),
            },
            target: target.to_owned(),
            seed: scenario.seed,
            version: crate::VERSION.to_owned(),
            revision: crate::REVISION.to_owned(),
            vehicles: scenario.swarm.vehicles,
        }
    }

    /// The identity of a flight of a swarm, or of the teams of a fleet, with the fleet's seed. What the teams differ in
    /// is that of the first.
    pub fn of_all<'a>(mut teams: impl Iterator<Item = &'a Scenario>, target: &str) -> Self {
        let Some(first) = teams.next() else { return Self::default() };
        let run = Self::new(first, target);
        Self {
            seed: first.team.map_or(run.seed, |team| team.seed),
            vehicles: run.vehicles + teams.map(|team| team.swarm.vehicles).sum::<usize>(),
            ..run
        }
    }
}

/// The spelling of a choice in scenario files and in JSON.
pub(crate) fn spelling(choice: &impl Serialize) -> String {
    match serde_json::to_value(choice) {
        Ok(serde_json::Value::String(text)) => text,
        _ => String::new(),
    }
}

/// Duration of a run by the wall clock.
#[derive(Clone, Copy, Debug)]
pub struct Wall {
    /// Wall-clock time that the run took, s.
    pub wall_s: f64,
    /// Seconds flown, joining included, for each second of wall clock.
    pub real_time_factor: f64,
}
