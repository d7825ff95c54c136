//! The figures of a fleet: those of all teams in one, and those across teams.

use serde::{Serialize, Serializer};
use skein_common::id::TeamId;

use super::across::Across;
use super::figures::{FIGURES, FLEET_FIGURES, Figure, Report};
use super::traffic::VehicleTraffic;
use super::{Direction, Measured, Run, Wall};

/// Figures that add up over teams.
const SUMS: [&str; 11] = [
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
];

/// The figures that are numbers.
fn numbers() -> impl Iterator<Item = &'static Figure> {
    FIGURES.iter().filter(|figure| figure.key != "never")
}

/// The fleet's figure from those of its teams: the sum of what is counted, the worst of what can be worse, otherwise
/// the mean. `None` if no team has one.
fn over_teams(figure: &Figure, of_teams: &[f64]) -> Option<f64> {
    let all = of_teams.iter().copied();
    match figure.worse {
        _ if SUMS.contains(&figure.key) => all.reduce(|sum, value| sum + value),
        Some(Direction::More) => all.reduce(f64::max),
        Some(Direction::Less) => all.reduce(f64::min),
        None if of_teams.is_empty() => None,
        None => Some(all.sum::<f64>() / of_teams.len() as f64),
    }
}

/// The figures of a flight of a fleet. As JSON they are the `metrics.json` of a fleet.
#[derive(Debug, Serialize)]
pub struct FleetReport {
    #[serde(flatten)]
    run: Run,
    /// Every figure of the fleet, in the order of the tables of figures.
    #[serde(flatten, serialize_with = "in_order")]
    figures: Vec<(&'static str, Option<f64>)>,
    /// The two vehicles of different teams that came nearest to each other, and when.
    #[serde(skip_serializing_if = "Option::is_none")]
    nearest_across: Option<String>,
    never: Vec<String>,
    /// The figures of each team.
    #[serde(skip)]
    pub teams: Vec<(TeamId, Measured)>,
    /// The messages that each vehicle received, as far as they were counted.
    #[serde(skip)]
    pub traffic: Vec<VehicleTraffic>,
}

/// The messages that the vehicles of a fleet have received.
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
        let of_teams = |figure: &Figure| {
            let all: Vec<f64> = measured.iter().filter_map(|(_, team)| team.value(figure.key)).collect();
            let over = over_teams(figure, &all);
            match figure.key {
                "collisions" => over.map(|within| within + across.collisions() as f64),
                "min_separation_m" => over.into_iter().chain(least.map(|(least_m, _)| least_m)).reduce(f64::min),
                "wall_s" => Some(wall.wall_s),
                "real_time_factor" => Some(wall.real_time_factor),
                _ => over,
            }
        };
        let of_fleet = FLEET_FIGURES.iter().map(|figure| (figure.key, across_teams(figure.key)));
        let figures = numbers().map(|figure| (figure.key, of_teams(figure))).chain(of_fleet).collect();
        let mut never: Vec<String> = measured.iter().flat_map(|(_, team)| team.never.iter().cloned()).collect();
        never.sort();
        never.dedup();
        let nearest_across = least.map(|(_, (one, other, at_s))| format!("{one} and {other} at {at_s:.2} s"));
        Self { run, figures, nearest_across, never, teams: measured, traffic: Vec::new() }
    }

    /// One row a team: its number, then every figure; an unmeasured figure is empty.
    pub fn teams_csv(&self) -> String {
        let keys: Vec<_> = numbers().map(|figure| figure.key).collect();
        let mut text = format!("team,{}\n", keys.join(","));
        for (id, team) in &self.teams {
            let cell = |key: &&str| team.value(key).map(|value| value.to_string());
            let cells: Vec<String> = keys.iter().map(|key| cell(key).unwrap_or_default()).collect();
            text += &format!("{id},{}\n", cells.join(","));
        }
        text
    }
}

/// The keys in their order, each with its value.
fn in_order<S: Serializer>(figures: &[(&str, Option<f64>)], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(figures.iter().copied())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_figure_is_a_sum_the_worst_or_the_mean_of_the_teams() {
        let of = |key: &str, all: &[f64]| over_teams(super::super::figures::of(key).unwrap(), all);
        let all = &[1.0, 2.0, 6.0];
        assert_eq!(
            [of("collisions", all), of("in_band_s", all), of("order", all), of("duration_s", all)],
            [Some(9.0), Some(6.0), Some(1.0), Some(3.0)]
        );
        assert!(["collisions", "order", "duration_s"].iter().all(|key| of(key, &[]).is_none()));
        assert!(SUMS.iter().all(|key| of(key, all) == Some(9.0)), "every one of them is a figure");
    }
}
