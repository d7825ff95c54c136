//! The mesh by cells as a fleet flew it: what each vehicle received of its own team, and of other teams by cells.

use std::num::NonZeroUsize;
use std::path::Path;

use serde::Serialize;
use skein_common::scenario::{Source, load_any};
use skein_lab::error::Error;
use skein_lab::external::LawPool;
use skein_lab::metrics::{TRAFFIC_FILE, VehicleTraffic, read_traffic};
use skein_lab::scenario::ScenarioArgs;
use skein_lab::study::{Study, fly_fleet};

/// A fleet in which the nine cells of most vehicles are occupied: 16 vehicles on each square kilometre.
const FLEET: Source<'_> = Source {
    name: "the fleet of the capacity",
    text: "name = \"fleet\"\nfleet = { teams = 36, spacing_m = 707 }\nswarm.vehicles = 8\n",
};

/// A figure of all vehicles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OverVehicles {
    /// The mean.
    pub mean: f64,
    /// The largest.
    pub most: f64,
}

impl OverVehicles {
    /// The figure of the vehicles' values; `None` without vehicles, or if a value is missing.
    fn of(values: impl Iterator<Item = Option<f64>>) -> Option<Self> {
        let values: Vec<f64> = values.collect::<Option<_>>()?;
        let most = values.iter().copied().reduce(f64::max)?;
        Some(Self { mean: values.iter().sum::<f64>() / values.len() as f64, most })
    }
}

/// Messages that a vehicle received.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Received {
    /// Messages a second.
    pub messages_per_s: OverVehicles,
    /// Their payload, bytes a second.
    pub bytes_per_s: OverVehicles,
}

impl Received {
    fn of(messages_per_s: Option<OverVehicles>, bytes_per_s: Option<OverVehicles>) -> Option<Self> {
        Some(Self { messages_per_s: messages_per_s?, bytes_per_s: bytes_per_s? })
    }
}

/// The messages that the vehicles of a fleet received in a flight.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FlownFleet {
    /// Name and duration of the flight.
    pub flight: String,
    /// Number of vehicles.
    pub vehicles: usize,
    /// From the own team; `None` if it was not counted apart.
    pub own_team: Option<Received>,
    /// From other teams; `None` if it was not counted apart.
    pub other_teams: Option<Received>,
    /// From all of them.
    pub all: Received,
    /// Links of an agent with other agents, and on plain links with observers; `None` in virtual time.
    pub links: Option<OverVehicles>,
}

impl FlownFleet {
    /// Flies a fleet in virtual time for so long.
    ///
    /// # Errors
    /// If it cannot be flown.
    pub fn fly(flight_s: f64) -> Result<Self, Error> {
        let failed = |why: String| Error::Failed(format!("capacity: {why}"));
        let sets = [format!("duration_s={flight_s}")];
        let described = load_any(&FLEET, &sets).map_err(|fault| failed(fault.to_string()))?;
        let first = &described.first().scenario;
        // All teams have the same aircraft and rules.
        let ready = ScenarioArgs::default().ready(first)?;
        let team = |scenario| Study {
            scenario,
            aircraft: ready.aircraft.clone(),
            rules: ready.rules.clone(),
            laws: LawPool::default(),
        };
        let teams: Vec<Study> = described.all().iter().map(|loaded| team(loaded.scenario.clone())).collect();
        let flight = format!(
            "{} teams of {} at 16 vehicles per km², {flight_s} s in virtual time",
            teams.len(),
            first.swarm.vehicles
        );
        let report = fly_fleet(&teams, NonZeroUsize::MIN, None);
        let (report, _) = report.map_err(|error| failed(error.to_string()))?;
        Self::of(flight, &report.traffic).ok_or_else(|| failed("no vehicle flew".to_owned()))
    }

    /// Reads what was received in the flight of a fleet that is in this folder.
    ///
    /// # Errors
    /// If the folder has no flight of a fleet.
    pub fn read(folder: &Path) -> Result<Self, Error> {
        let path = folder.join(TRAFFIC_FILE);
        let rows = read_traffic(&path).map_err(|error| {
            let why = "the folder of a run of a fleet is needed, which `skein study` or `skein fly` has written";
            Error::Refused(format!("{}: {error}; {why}", path.display()))
        })?;
        let refused = || Error::Refused(format!("{}: no vehicles in it", path.display()));
        Self::of(folder.display().to_string(), &rows).ok_or_else(refused)
    }

    fn of(flight: String, rows: &[VehicleTraffic]) -> Option<Self> {
        let over = |value: fn(&VehicleTraffic) -> Option<f64>| OverVehicles::of(rows.iter().map(value));
        Some(Self {
            flight,
            vehicles: rows.len(),
            own_team: Received::of(
                over(|row| row.others_messages_per_s.map(|others| row.messages_per_s - others)),
                over(|row| row.others_bytes_per_s.map(|others| row.bytes_per_s - others)),
            ),
            other_teams: Received::of(over(|row| row.others_messages_per_s), over(|row| row.others_bytes_per_s)),
            all: Received::of(over(|row| Some(row.messages_per_s)), over(|row| Some(row.bytes_per_s)))?,
            links: over(|row| row.links.map(f64::from)),
        })
    }
}

#[cfg(test)]
pub(super) mod tests;
