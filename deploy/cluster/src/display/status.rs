//! A flight as people look at it: figures of every vehicle, what happened, how it stands.

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::time::{Duration, Instant};

use nalgebra::Vector2;
use serde::{Serialize, Serializer};
use skein_common::id::{TeamId, VehicleId};
use skein_common::math;
use skein_common::message::{FactValues, VehicleFacts, Verb};
use skein_common::scenario::{Pattern, Scenario, Vertical};
use skein_common::state::{Activity, Membership};
use skein_core::formation;

use crate::mesh::observe::VehicleView;
use skein_lab::metrics::Run;
use skein_lab::terminal::shortened;

/// A vehicle silent for this long is shown as silent.
pub const SILENT: Duration = Duration::from_secs(1);

/// The stage of a flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// The agents start and find each other.
    Gathering,
    /// The clock of the flight runs.
    Flying,
    /// All vehicles are ordered to land.
    Landing,
    /// The processes end.
    Ending,
    /// Another process has started the swarm, and this one only watches it.
    Watched,
}

/// Everything that the screen shows.
#[derive(Clone, Debug, PartialEq)]
pub struct FlightStatus {
    /// The swarm's name.
    pub swarm: String,
    /// Name of the plant.
    pub plant: String,
    /// The stage of the flight.
    pub stage: Stage,
    /// Time flown, s.
    pub flown_s: f64,
    /// Time to be flown, s; `None` until the operator stops the flight.
    pub duration_s: Option<f64>,
    /// The folder with the files of the run; empty if the swarm is only watched.
    pub out: String,
    /// One for each vehicle, by id.
    pub rows: Vec<Row>,
    /// In a large fleet one for each team, which the table shows instead.
    pub teams: Vec<Row>,
    /// The team, if the swarm is one of a fleet.
    pub team: Option<TeamId>,
    /// The formation has even gaps around its centre.
    pub has_gaps: bool,
    /// The events so far, the newest last.
    pub events: Vec<String>,
}

impl FlightStatus {
    /// A swarm that is only watched, with these vehicles: without time, files and events.
    pub fn new(scenario: &Scenario, vehicles: &[Known]) -> Self {
        let rows = rows(vehicles, scenario);
        Self {
            swarm: scenario.swarm.name.to_string(),
            plant: Run::new(scenario, "fly").plant,
            stage: Stage::Watched,
            flown_s: 0.0,
            duration_s: None,
            out: String::new(),
            has_gaps: has_gaps(scenario, rows.iter().find_map(|row| row.step)),
            rows,
            teams: Vec::new(),
            team: scenario.team.map(|team| team.id),
            events: Vec::new(),
        }
    }

    /// Summary of the swarm, in as many parts as fit into so many columns, the most important first:
    /// `16/16 in formation, worst gap 3.8°, nearest 22.6 m`.
    pub fn summary(&self, columns: usize) -> String {
        let values = |of: fn(&Row) -> Option<f64>| self.rows.iter().filter_map(of);
        let least = |of| values(of).reduce(f64::min);
        let most = |of| values(of).reduce(f64::max);
        let span = |name: &str, of: fn(&Row) -> Option<f64>| {
            let [least, most] = [least(of)?, most(of)?].map(|value| format!("{value:.1}"));
            let both = if least == most { least } else { format!("{least} to {most}") };
            Some(format!("{name} {both} m"))
        };
        let parts = [
            worst_gap_deg(&self.rows, self.has_gaps).map(|off| format!("worst gap {off:.1}°")),
            least(|row| row.nearest_m).map(|nearest| format!("nearest {nearest:.1} m")),
            span("altitude", |row| row.altitude_m),
            span("from centre", |row| row.from_centre_m),
            most(|row| row.facts.get("step_p99_us")).map(|step_us| format!("step p99 {step_us:.0} µs")),
        ];
        let phases = phases(&self.rows);
        let mut phases = phases.split(", ").map(str::to_owned);
        let mut summary = shortened(&phases.next().unwrap_or_default(), columns);
        for part in phases.chain(parts.into_iter().flatten()) {
            if summary.chars().count() + 2 + part.chars().count() > columns {
                break;
            }
            summary += &format!(", {part}");
        }
        summary
    }
}

/// The most that a gap differs from an even share, degrees; `None` where gaps need not be even.
pub fn worst_gap_deg(rows: &[Row], has_gaps: bool) -> Option<f64> {
    let off = rows.iter().filter_map(|row| row.gap_deg.map(|(_, excess)| excess.abs()));
    off.reduce(f64::max).filter(|_| has_gaps)
}

/// The number of vehicles in formation, and the activities of the others: `14/16 in formation, 2 silent`.
pub fn phases(rows: &[Row]) -> String {
    let mut others: BTreeMap<&str, usize> = BTreeMap::new();
    rows.iter().for_each(|row| *others.entry(row.doing()).or_default() += 1);
    let all = rows.len();
    let in_formation = others.remove(IN_FORMATION);
    let first = match (in_formation, others.first_key_value()) {
        // All vehicles do the same.
        (None, Some((doing, count))) if *count == all => return format!("{all}/{all} {doing}"),
        (in_formation, _) => format!("{}/{all} {IN_FORMATION}", in_formation.unwrap_or(0)),
    };
    others.iter().fold(first, |messages, (doing, count)| format!("{messages}, {count} {doing}"))
}

/// The phase [`Activity::Formation`].
const FORMATION: &str = "formation";
/// The text for a vehicle in the phase formation that is in its place, and for one that is not.
const IN_FORMATION: &str = "in formation";
const UNDER_WAY: &str = "under way";

/// A fleet with more vehicles is shown with one row for each team.
const MAX_ROWS: usize = 16;

/// The flights of all teams of a fleet as one. `out` is the folder of the fleet's files.
pub fn of_fleet(mut teams: Vec<FlightStatus>, out: String) -> FlightStatus {
    teams.sort_by_key(|status| status.team);
    let name = |status: &FlightStatus| status.team.map_or_else(String::new, |team| team.to_string());
    let vehicles: usize = teams.iter().map(|status| status.rows.len()).sum();
    let rows_of_teams =
        if vehicles > MAX_ROWS { teams.iter().map(|team| team.as_row(name(team))).collect() } else { Vec::new() };
    let mut events: Vec<String> = Vec::new();
    for team in &teams {
        let in_front = |event: &String| {
            let at = event.char_indices().nth(EVENT_TIME).map_or(event.len(), |(at, _)| at);
            format!("{}team {}: {}", &event[..at], name(team), &event[at..])
        };
        events.extend(team.events.iter().map(in_front));
    }
    // Each begins with its time.
    events.sort();
    let first = teams.first();
    FlightStatus {
        swarm: first.map(|team| team.swarm.clone()).unwrap_or_default(),
        plant: first.map(|team| team.plant.clone()).unwrap_or_default(),
        stage: teams.iter().map(|team| team.stage).min().unwrap_or(Stage::Ending),
        flown_s: teams.iter().map(|team| team.flown_s).fold(0.0, f64::max),
        duration_s: first.and_then(|team| team.duration_s),
        out,
        has_gaps: teams.iter().all(|team| team.has_gaps),
        team: None,
        rows: teams.iter().flat_map(|team| team.rows.iter().map(|row| row.named(&name(team)))).collect(),
        teams: rows_of_teams,
        events,
    }
}

/// Columns of the time in front of an event.
pub const EVENT_TIME: usize = 10;

/// A phase as a column of a table shows it: `formation` only of a vehicle in its place, else `under way`.
pub fn shown_phase(phase: &str, in_place_s: Option<f64>) -> &str {
    if phase == FORMATION && in_place_s.is_none() { UNDER_WAY } else { phase }
}

impl FlightStatus {
    /// The whole swarm as one row.
    fn as_row(&self, name: String) -> Row {
        let values = |of: fn(&Row) -> Option<f64>| self.rows.iter().filter_map(of).collect::<Vec<_>>();
        let least = |of| values(of).into_iter().reduce(f64::min);
        let mean =
            |of| Some(values(of)).filter(|all| !all.is_empty()).map(|all| all.iter().sum::<f64>() / all.len() as f64);
        let all = self.rows.len();
        let count = |doing: &str| self.rows.iter().filter(|row| row.doing() == doing).count();
        // What most of its vehicles do.
        let doing = self.rows.iter().map(Row::doing).max_by_key(|doing| count(doing)).unwrap_or_default();
        let shared = self.rows.first().map(|row| row.phase.clone());
        let placed: Option<Vec<f64>> = self.rows.iter().map(|row| row.in_place_s).collect();
        let gap =
            self.rows.iter().filter_map(|row| row.gap_deg).max_by(|one, other| one.1.abs().total_cmp(&other.1.abs()));
        let counted =
            self.rows.iter().filter_map(|row| row.late_dropped).reduce(|sum, row| (sum.0 + row.0, sum.1 + row.1));
        Row {
            name,
            phase: match shared.filter(|_| count(doing) == all) {
                Some(phase) => phase,
                None => format!("{}/{all} {doing}", count(doing)),
            },
            in_place_s: placed.and_then(|placed| placed.into_iter().reduce(f64::min)),
            bad: self.rows.iter().any(|row| row.bad),
            altitude_m: mean(|row| row.altitude_m),
            step: self.rows.iter().filter_map(|row| row.step).min(),
            from_centre_m: mean(|row| row.from_centre_m),
            gap_deg: gap,
            nearest_m: least(|row| row.nearest_m),
            facts: FactValues::of_team(&self.rows.iter().map(|row| row.facts).collect::<Vec<_>>()),
            late_dropped: counted,
        }
    }

    /// The rows of the table.
    pub fn shown(&self) -> &[Row] {
        if self.teams.is_empty() { &self.rows } else { &self.teams }
    }
}

impl Row {
    /// The doing of the vehicle: its phase, and in the phase formation whether it is in its place.
    pub fn doing(&self) -> &str {
        if self.phase == FORMATION && self.in_place_s.is_some() { IN_FORMATION } else { self.shown_phase() }
    }

    /// The phase as a column of a table shows it.
    pub fn shown_phase(&self) -> &str {
        shown_phase(&self.phase, self.in_place_s)
    }

    /// The row of a vehicle with its team's name.
    fn named(&self, team: &str) -> Self {
        Self { name: format!("{team}/{}", self.name), ..self.clone() }
    }
}

/// One vehicle. As JSON it is an element of `vehicles` in the progress lines of `fly --json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// The vehicle, or a team of several.
    pub name: String,
    /// The phase of its flight.
    pub phase: String,
    /// Time for which it has been in formation without interruption, s; `None` while it is not. Of a team the least.
    pub in_place_s: Option<f64>,
    /// Something is wrong with it.
    pub bad: bool,
    /// Above the origin.
    pub altitude_m: Option<f64>,
    /// The step of the mission that it is at, counted from 0.
    pub step: Option<u32>,
    /// ρ: distance from the centre, measured as the formation's ellipse does.
    pub from_centre_m: Option<f64>,
    /// Angle to the next vehicle clockwise, and how much that is more than an even share.
    pub gap_deg: Option<(f64, f64)>,
    /// To the nearest other vehicle.
    pub nearest_m: Option<f64>,
    /// The facts that have a column.
    #[serde(flatten, serialize_with = "with_columns")]
    pub facts: FactValues,
    /// Steps that were late, and messages and datagrams that were dropped.
    pub late_dropped: Option<(u64, u64)>,
}

fn with_columns<S: Serializer>(facts: &FactValues, to: S) -> Result<S::Ok, S::Error> {
    to.collect_map(facts.iter().filter(|(fact, _)| fact.column.is_some()).map(|(fact, value)| (fact.key, value)))
}

/// One vehicle with everything that this process knows of it.
#[derive(Clone, Debug)]
pub struct Known {
    /// The vehicle.
    pub id: VehicleId,
    /// The newest that was received of its flight, and how long ago.
    pub newest: Option<(VehicleFacts, Duration)>,
    /// Whether its agent has sent a health report.
    pub is_healthy: bool,
    /// The end of its process, if that has ended.
    pub ended: Option<Ending>,
    /// The order that it follows.
    pub order: Option<Verb>,
}

/// The end of an agent's process: asked for, by the scenario, or unexpected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// It ended as expected: it had landed, or was ordered to end.
    Asked,
    /// By the scenario's hand.
    Killed,
    /// Unexpectedly: it failed, or another process killed it.
    Lost,
}

impl Known {
    /// The vehicle with what the observer has received of it by `now`.
    pub fn new(id: VehicleId, seen: Option<&VehicleView>, ended: Option<Ending>, now: Instant) -> Self {
        let newest = seen.and_then(VehicleView::newest);
        let newest = newest.map(|(sample, at)| (sample, now.saturating_duration_since(at)));
        let order = seen.and_then(|seen| seen.orders.obeyed_by(id)).map(|order| order.verb);
        Self { id, newest, is_healthy: seen.is_some_and(|seen| seen.health.is_some()), ended, order }
    }

    /// Its newest facts while it flies and is in contact.
    pub fn flying(&self) -> Option<&VehicleFacts> {
        let (sample, silent) = self.newest.as_ref().filter(|_| self.ended.is_none())?;
        (*silent < SILENT).then_some(sample)
    }

    fn phase(&self) -> (String, bool) {
        match (self.ended, &self.newest, self.flying()) {
            (Some(Ending::Asked), ..) => ("ended".to_owned(), false),
            (Some(Ending::Killed), ..) => ("killed".to_owned(), true),
            (Some(Ending::Lost), ..) => ("lost".to_owned(), true),
            (None, None, _) if self.is_healthy => ("no frames".to_owned(), true),
            (None, None, _) => ("starting".to_owned(), false),
            (None, Some(_), None) => ("silent".to_owned(), true),
            (None, Some(_), Some(sample)) => (sample.activity.to_string(), sample.activity == Activity::Blind),
        }
    }
}

/// One row for each vehicle of a swarm that flies this scenario.
pub fn rows(vehicles: &[Known], scenario: &Scenario) -> Vec<Row> {
    let from_centre_ne_m = |sample: &VehicleFacts| sample.place().horizontal() - Vector2::from(sample.centre_ne_m);
    // The bearing of each active member from the formation's centre.
    let members: Vec<(VehicleId, f64)> = vehicles
        .iter()
        .filter_map(|known| Some((known.id, known.flying()?)))
        .filter(|(_, sample)| sample.membership == Membership::Active)
        .map(|(id, sample)| (id, math::atan2(from_centre_ne_m(sample).y, from_centre_ne_m(sample).x)))
        .collect();
    let row = |known: &Known| {
        let sample = known.flying();
        let process = sample.and_then(|sample| sample.process);
        let others = || vehicles.iter().filter(|other| other.id != known.id).filter_map(Known::flying);
        let (phase, bad) = known.phase();
        Row {
            name: known.id.to_string(),
            phase,
            in_place_s: sample.and_then(|sample| sample.in_place_s),
            bad,
            altitude_m: sample.map(|sample| sample.place().altitude_m()),
            step: sample.map(|sample| sample.step),
            from_centre_m: sample.and_then(|sample| {
                let formation = scenario.formation_with(sample.step, &sample.settings)?;
                Some(formation::ring(&formation).level_m(from_centre_ne_m(sample)))
            }),
            gap_deg: gap_deg(known.id, &members),
            nearest_m: sample
                .and_then(|own| others().map(|other| (own.place() - other.place()).norm()).reduce(f64::min)),
            facts: sample.map(FactValues::of).unwrap_or_default(),
            late_dropped: process.map(|process| (process.frame_overruns, process.dropped)),
        }
    };
    vehicles.iter().map(row).collect()
}

/// Whether the vehicles are to have even gaps around the formation's centre at this step.
pub fn has_gaps(scenario: &Scenario, step: Option<u32>) -> bool {
    let Some(step) = scenario.mission.steps.get(step.unwrap_or(0) as usize) else { return false };
    let flown = &step.formation;
    let is_radial = !flown.law.has_slots() || flown.slots.pattern == Pattern::Circle;
    is_radial && !flown.law.is_flock() && flown.vertical == Vertical::Bands
}

/// Angle from a member clockwise to the next, and its excess over an even share, given the bearings of all members.
fn gap_deg(id: VehicleId, members: &[(VehicleId, f64)]) -> Option<(f64, f64)> {
    let (_, own_rad) = members.iter().find(|(member, _)| *member == id)?;
    let others = members.iter().filter(|(member, _)| *member != id);
    let gap_rad = others.map(|(_, bearing_rad)| (bearing_rad - own_rad).rem_euclid(TAU)).reduce(f64::min)?;
    Some((gap_rad.to_degrees(), (gap_rad - TAU / members.len() as f64).to_degrees()))
}

#[cfg(test)]
mod tests {
    use skein_common::message::ProcessFigures;

    use super::*;

    #[test]
    fn a_summary_has_the_essential_figures() {
        let process = ProcessFigures { step_p99_us: 80.0, ..ProcessFigures::default() };
        let flying = VehicleFacts { process: Some(process), ..VehicleFacts::default() };
        let row = |id: u8, altitude_m: Option<f64>| Row {
            name: id.to_string(),
            phase: altitude_m.map_or("silent", |_| "formation").to_owned(),
            in_place_s: altitude_m.map(|_| 12.0),
            bad: false,
            altitude_m,
            step: altitude_m.map(|_| 0),
            from_centre_m: altitude_m.map(|_| 100.0 + f64::from(id)),
            gap_deg: altitude_m.map(|_| (90.0, -1.5)),
            nearest_m: altitude_m.map(|_| 141.0),
            facts: altitude_m.map(|_| FactValues::of(&flying)).unwrap_or_default(),
            late_dropped: None,
        };
        let mut status = FlightStatus {
            swarm: "hover".to_owned(),
            plant: "builtin".to_owned(),
            stage: Stage::Flying,
            flown_s: 10.0,
            duration_s: None,
            out: String::new(),
            rows: vec![row(1, Some(29.5)), row(2, Some(30.0)), row(3, None)],
            teams: Vec::new(),
            team: None,
            has_gaps: true,
            events: Vec::new(),
        };
        let short = "2/3 in formation, 1 silent, worst gap 1.5°, nearest 141.0 m";
        let long = format!("{short}, altitude 29.5 to 30.0 m, from centre 101.0 to 102.0 m, step p99 80 µs");
        assert_eq!(status.summary(1000), long);
        assert_eq!(status.summary(80), short);
        assert_eq!(status.summary(20), "2/3 in formation");
        status.has_gaps = false;
        assert_eq!(status.summary(45), "2/3 in formation, 1 silent, nearest 141.0 m");
        status.rows = vec![row(1, None)];
        assert_eq!(status.summary(80), "1/1 silent");
        let strayed = Row { in_place_s: None, ..row(1, Some(30.0)) };
        status.rows = vec![strayed.clone(), row(2, Some(30.0)), row(3, None)];
        assert_eq!(status.summary(45), "1/3 in formation, 1 silent, 1 under way");
        status.rows = vec![strayed.clone(), strayed];
        assert!(status.summary(80).starts_with("2/2 under way, "), "{}", status.summary(80));
        assert_eq!(Activity::Formation.to_string(), FORMATION);
    }

    #[test]
    fn gaps_run_clockwise_and_add_up_to_a_circle() {
        let id = |number| VehicleId::new(number).unwrap();
        let bearings = [(1, 10.0_f64), (2, 350.0), (3, 100.0), (4, 200.0)];
        let members: Vec<_> = bearings.iter().map(|(number, deg)| (id(*number), deg.to_radians())).collect();
        let gaps: Vec<_> = members.iter().map(|(id, _)| gap_deg(*id, &members).unwrap()).collect();
        for ((gap, excess), expected) in gaps.iter().zip([90.0, 20.0, 100.0, 150.0]) {
            assert!((gap - expected).abs() < 1e-9 && (excess - (expected - 90.0)).abs() < 1e-9, "{gaps:?}");
        }
        assert_eq!(gap_deg(id(9), &members), None, "no member");
        assert_eq!(gap_deg(id(1), &members[..1]), None, "no other member");
    }
}
