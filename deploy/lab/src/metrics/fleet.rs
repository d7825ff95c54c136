//! The figures of a fleet: those of all teams in one, and those across teams.

use serde::{Serialize, Serializer};
use skein_common::id::TeamId;

use super::across::Across;
use super::figures::{FIGURES, FLEET_FIGURES};
use super::traffic::VehicleTraffic;
use super::{Direction, Measured, Report, Run, Wall};

/// How the figures of teams become one figure of the fleet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OverTeams {
    /// The sum.
    Sum,
    /// The worst.
    Worst(Direction),
    /// The mean.
    Mean,
}

/// Figures that add up over teams.
const SUMS: [&str; 12] = [
    "collisions",
    "crashes",
    "safety_activations",
    "energy_j",
    "disconnected_vehicles",
    "forced_advances",
    "false_suspicions",
    "state_messages",
    "state_bytes",
    "frame_overruns",
    "law_misses",
    "never",
];

/// How this figure is taken over all teams; `None` for an unknown key.
pub fn over_teams(key: &str) -> Option<OverTeams> {
    let figure = FIGURES.iter().find(|figure| figure.key == key)?;
    Some(match figure.worse {
        _ if SUMS.contains(&key) => OverTeams::Sum,
        Some(direction) => OverTeams::Worst(direction),
        None => OverTeams::Mean,
    })
}

impl OverTeams {
    /// The fleet's figure; `None` if no team has one.
    fn of(self, values: &[f64]) -> Option<f64> {
        let values = values.iter().copied();
        match self {
            Self::Sum => values.reduce(|sum, value| sum + value),
            Self::Worst(Direction::More) => values.reduce(f64::max),
            Self::Worst(Direction::Less) => values.reduce(f64::min),
            Self::Mean if values.len() == 0 => None,
            Self::Mean => Some(values.clone().sum::<f64>() / values.len() as f64),
        }
    }
}

/// What a flight of a fleet has measured. As JSON it is the `metrics.json` of a fleet.
#[derive(Debug, Serialize)]
pub struct FleetReport {
    #[serde(flatten)]
    run: Run,
    /// Every figure of the fleet, in the order of the tables of figures.
    #[serde(flatten, serialize_with = "as_map")]
    figures: Vec<(&'static str, Option<f64>)>,
    /// The two vehicles of different teams that came nearest to each other, and when.
    #[serde(rename = "nearest_across", skip_serializing_if = "Option::is_none")]
    nearest: Option<String>,
    never: Vec<String>,
    /// The figures of each team.
    #[serde(skip)]
    pub teams: Vec<(TeamId, Measured)>,
    /// What each vehicle received, as far as it was counted.
    #[serde(skip)]
    pub traffic: Vec<VehicleTraffic>,
}

/// What the vehicles of a fleet have received.
#[derive(Clone, Copy, Debug, Default)]
pub struct FleetTraffic {
    /// Number of states of other teams, by all vehicles.
    pub stranger_states: u64,
    /// Messages that a vehicle receives in a second, as a mean over those with a vehicle in each of their nine cells, and
    /// their bytes; `None` without such vehicles.
    pub surrounded_per_s: Option<(f64, f64)>,
}

impl FleetReport {
    /// The figures of these teams, in order; `traffic` is `None` where it was not counted.
    pub fn new(
        run: Run,
        teams: &[(TeamId, &Report)],
        across: &Across,
        traffic: Option<FleetTraffic>,
        wall: Wall,
    ) -> Self {
        let measured: Vec<_> = teams.iter().map(|(id, report)| (*id, Measured::of(report))).collect();
        let least = across.least();
        let across_teams = |key: &str| match key {
            "teams" => Some(teams.len() as f64),
            "across_separation_m" => least.map(|(least_m, _)| least_m),
            "across_collisions" => Some(across.collisions() as f64),
            "stranger_states" => traffic.map(|traffic| traffic.stranger_states as f64),
            "surrounded_messages_per_s" => traffic.and_then(|traffic| Some(traffic.surrounded_per_s?.0)),
            "surrounded_bytes_per_s" => traffic.and_then(|traffic| Some(traffic.surrounded_per_s?.1)),
            _ => None,
        };
        let of_teams = |key: &'static str| {
            let values: Vec<f64> = measured.iter().filter_map(|(_, team)| team.figures.get(key).copied()?).collect();
            let over = over_teams(key).and_then(|over| over.of(&values));
            match key {
                "collisions" => over.map(|within| within + across.collisions() as f64),
                "min_separation_m" => over.into_iter().chain(least.map(|(least_m, _)| least_m)).reduce(f64::min),
                "wall_s" => Some(wall.wall_s),
                "real_time_factor" => Some(wall.real_time_factor),
                _ => over,
            }
        };
        let of_fleet = FLEET_FIGURES.iter().map(|figure| (figure.key, across_teams(figure.key)));
        let keys = FIGURES.iter().map(|figure| figure.key).filter(|key| *key != "never");
        let figures = keys.map(|key| (key, of_teams(key))).chain(of_fleet).collect();
        let mut never: Vec<String> = measured.iter().flat_map(|(_, team)| team.never.iter().cloned()).collect();
        never.sort();
        never.dedup();
        let nearest = least.map(|(_, (one, other, at_s))| format!("{one} and {other} at {at_s:.2} s"));
        Self { run, figures, nearest, never, teams: measured, traffic: Vec::new() }
    }

    /// The figures of the whole fleet.
    pub fn measured(&self) -> Measured {
        Measured::of(self)
    }

    /// One row a team: its number, then every figure; an unmeasured figure is empty.
    pub fn teams_csv(&self) -> String {
        let keys: Vec<_> = FIGURES.iter().map(|figure| figure.key).filter(|key| *key != "never").collect();
        let mut text = format!("team,{}\n", keys.join(","));
        for (id, team) in &self.teams {
            let cell = |key: &&str| team.figures.get(*key).copied().flatten().map(|value| value.to_string());
            let cells: Vec<String> = keys.iter().map(|key| cell(key).unwrap_or_default()).collect();
            text += &format!("{id},{}\n", cells.join(","));
        }
        text
    }
}

/// The figures as entries of the report's own map.
fn as_map<S: Serializer>(figures: &[(&'static str, Option<f64>)], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(figures.iter().copied())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_figure_is_a_sum_the_worst_or_the_mean_of_the_teams() {
        let of = |key: &str| over_teams(key).unwrap().of(&[1.0, 2.0, 6.0]);
        assert_eq!(
            [of("collisions"), of("in_band_s"), of("order"), of("duration_s")],
            [Some(9.0), Some(6.0), Some(1.0), Some(3.0)]
        );
        assert_eq!(over_teams("order").unwrap().of(&[]), None);
        assert_eq!(over_teams("no_such_figure"), None);
        assert!(SUMS.iter().all(|key| over_teams(key) == Some(OverTeams::Sum)));
    }
}
