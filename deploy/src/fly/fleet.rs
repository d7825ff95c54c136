//! One flight, or those of all teams of a fleet side by side: they share this process, the terminal and the air.

use std::collections::BTreeSet;
use std::fs;
use std::time::{Duration, Instant};

use serde::Serialize;
use skein_common::frame::{Origin, PositionNed};
use skein_common::id::{FleetVehicle, TeamId};
use skein_common::scenario::Scenario;

use super::flight::{Flight, FlightResult};
use super::launch::{Site, prepare_site};
use super::plan::Plans;
use super::screen::Screen;
use super::status::{self, FlightStatus};
use crate::endpoints::EndpointsFile;
use crate::os::Interrupts;
use skein_host::clock;
use skein_lab::error::Error;
use skein_lab::metrics::{COLLISION_M, Report};

/// Between two looks at the swarms: the metrics want fifty a second.
const TICK: Duration = Duration::from_millis(20);

/// All flights of this process.
pub struct Flights {
    /// Those that are not over.
    running: Vec<Flight>,
    over: Vec<FlightResult>,
    /// The last picture of those that are over.
    statuses: Vec<FlightStatus>,
    /// `None` for a swarm that flies alone.
    across: Option<Across>,
    out: std::path::PathBuf,
    screen: Screen,
    interrupts: Interrupts,
    json: bool,
    /// There while the swarms are.
    file: EndpointsFile,
}

impl Flights {
    /// Starts everything.
    ///
    /// # Errors
    /// If something cannot be started; then nothing is left running.
    pub fn begin(plans: Plans, interrupts: Interrupts, gather_within: Duration, json: bool) -> Result<Self, Error> {
        let Plans { described, out, plans } = plans;
        let Site { endpoints, file } = prepare_site(&described, &out)?;
        let across = described.first().scenario.team.map(|team| Across::new(Origin::new(team.origin.geodetic())));
        let begin = |plan| Flight::begin(plan, &described, &endpoints, gather_within);
        let running = plans.into_iter().map(begin).collect::<Result<Vec<_>, _>>()?;
        let screen = Screen::open(json);
        Ok(Self { running, over: Vec::new(), statuses: Vec::new(), across, out, screen, interrupts, json, file })
    }

    /// Flies all of them to the end.
    ///
    /// # Errors
    /// A flight that never began, lost all its vehicles, or did not end on the ground.
    pub fn fly(mut self) -> Result<(), Error> {
        let mut next = clock::now();
        loop {
            let now = clock::now();
            for _ in 0..self.screen.asked_to_end() {
                self.interrupts.add();
            }
            let asked = self.interrupts.count();
            let over: Vec<usize> =
                (0..self.running.len()).filter(|nth| self.running[*nth].advance(now, asked)).collect();
            if let Some(across) = &mut self.across {
                across.observe(&self.running, now);
            }
            if over.len() == self.running.len() {
                break;
            }
            for nth in over.into_iter().rev() {
                let mut flight = self.running.remove(nth);
                let (status, news) = (flight.status(now), flight.take_news(now, true));
                let news = shown(flight.scenario(), news);
                self.screen.show(&self.status(now), &news, now);
                self.statuses.push(status);
                self.over.push(flight.end());
            }
            let has_news = self.running.iter().any(|flight| flight.has_news(now));
            if self.screen.is_due(now, has_news) {
                self.draw(now, false);
            }
            next = (next + TICK).max(now);
            clock::sleep(next.saturating_duration_since(clock::now()));
        }
        self.draw(clock::now(), true);
        let Self { running, mut over, across, screen, json, file, out, .. } = self;
        over.extend(running.into_iter().map(Flight::end));
        over.sort_by_key(|result| result.plan.scenario().team.map(|team| team.id));
        // The terminal is restored before anything is written to it.
        drop(screen);
        if over.iter().any(|result| result.leaves) {
            file.stay();
        }
        for result in &over {
            let notes = shown(result.plan.scenario(), result.notes.clone());
            notes.iter().for_each(|note| skein_lab::terminal::complain(note));
        }
        match &across {
            None => over.iter().for_each(|result| say(result, json)),
            Some(across) => {
                let report = FleetReport::new(&over, across);
                let path = out.join("metrics.json");
                fs::write(&path, skein_lab::terminal::json(&report))
                    .map_err(|error| Error::Failed(format!("{}: {error}", path.display())))?;
                let text = if json { skein_lab::terminal::json(&report) } else { report.text(&out) };
                skein_lab::terminal::say(&text);
            }
        }
        let failures = over.iter().filter_map(|result| Some((result.plan.scenario(), result.verdict().err()?)));
        let failures: Vec<_> = failures.flat_map(|(scenario, why)| shown(scenario, vec![why])).collect();
        if failures.is_empty() { Ok(()) } else { Err(Error::Failed(failures.join("; "))) }
    }

    /// Brings the screen up to date; at the `end` with all news.
    fn draw(&mut self, now: Instant, end: bool) {
        let news = self.running.iter_mut().flat_map(|flight| {
            let news = flight.take_news(now, end);
            shown(flight.scenario(), news)
        });
        let news: Vec<String> = news.collect();
        self.screen.show(&self.status(now), &news, now);
    }

    /// All flights as people look at them.
    fn status(&self, now: Instant) -> FlightStatus {
        let mut statuses: Vec<_> = self.running.iter().map(|flight| flight.status(now)).collect();
        if self.across.is_none() && statuses.len() == 1 {
            return statuses.remove(0);
        }
        statuses.extend(self.statuses.iter().cloned());
        status::of_fleet(statuses, self.out.display().to_string())
    }
}

/// These lines, in a fleet with their team in front.
fn shown(scenario: &Scenario, lines: Vec<String>) -> Vec<String> {
    let Some(team) = scenario.team else { return lines };
    lines.into_iter().map(|line| format!("team {}: {line}", team.id)).collect()
}

fn say(result: &FlightResult, json: bool) {
    let text = if json { result.report.as_ref().map(skein_lab::terminal::json) } else { result.summary() };
    text.iter().for_each(|text| skein_lab::terminal::say(text));
}

/// The separations of vehicles of different teams, both in the air.
#[derive(Debug)]
struct Across {
    /// Origin of the fleet's frame.
    fleet: Origin,
    /// Least distance so far, m, and the two vehicles.
    nearest: Option<(f64, FleetVehicle, FleetVehicle)>,
    collided: BTreeSet<(FleetVehicle, FleetVehicle)>,
}

impl Across {
    fn new(fleet: Origin) -> Self {
        Self { fleet, nearest: None, collided: BTreeSet::new() }
    }

    /// Observes the newest positions in all flights.
    fn observe(&mut self, flights: &[Flight], now: Instant) {
        let mut airborne: Vec<(FleetVehicle, PositionNed)> = Vec::new();
        for flight in flights {
            let Some(team) = flight.scenario().team else { continue };
            let origin = Origin::new(flight.scenario().origin.geodetic());
            let before = airborne.len();
            for (vehicle, position) in flight.airborne(now) {
                let position = self.fleet.ned_from_geodetic(&origin.geodetic_from_ned(position));
                airborne.push((FleetVehicle { team: team.id, vehicle }, position));
            }
            let (others, own) = airborne.split_at(before);
            for (id, position) in own {
                for (other, other_position) in others {
                    self.compare((*other, *id), (*position - *other_position).norm());
                }
            }
        }
    }

    fn compare(&mut self, pair: (FleetVehicle, FleetVehicle), apart_m: f64) {
        if apart_m < COLLISION_M {
            self.collided.insert(pair);
        }
        if self.nearest.is_none_or(|(least_m, ..)| apart_m < least_m) {
            self.nearest = Some((apart_m, pair.0, pair.1));
        }
    }
}

/// What a live flight of a fleet has measured.
#[derive(Debug, Serialize)]
struct FleetReport {
    /// Least distance of two vehicles of different teams in the air, m.
    across_separation_m: Option<f64>,
    /// Number of pairs of vehicles of different teams that collided.
    across_collisions: usize,
    /// The two that came nearest.
    nearest: Option<String>,
    /// The figures of each team.
    teams: Vec<TeamReport>,
}

/// The figures of one team.
#[derive(Debug, Serialize)]
struct TeamReport {
    team: TeamId,
    #[serde(flatten)]
    report: Option<Report>,
}

impl FleetReport {
    fn new(over: &[FlightResult], across: &Across) -> Self {
        let team = |result: &FlightResult| {
            let team = result.plan.scenario().team?.id;
            Some(TeamReport { team, report: result.report.clone() })
        };
        Self {
            across_separation_m: across.nearest.map(|(least_m, ..)| least_m),
            across_collisions: across.collided.len(),
            nearest: across.nearest.map(|(_, one, other)| format!("{one} and {other}")),
            teams: over.iter().filter_map(team).collect(),
        }
    }

    /// The figures that a reader looks for first: a line for each team, and those across teams.
    fn text(&self, out: &std::path::Path) -> String {
        let figure = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.2}"));
        let titles = ["team", "flown s", "rms m", "least m", "collisions", "crashes", "step p99 µs", "late frames"];
        let line = |cells: [String; 8]| {
            let cells =
                cells.iter().zip(titles).map(|(cell, title)| format!("{cell:>0$}", title.chars().count().max(8)));
            cells.collect::<Vec<_>>().join("  ") + "\n"
        };
        let mut text = line(titles.map(str::to_owned));
        for TeamReport { team, report } in &self.teams {
            let Some(report) = report else {
                text += &format!("{team:>8}  no flight\n");
                continue;
            };
            text += &line([
                team.to_string(),
                figure(Some(report.duration_s)),
                figure(report.radial_rms_m),
                figure(report.min_separation_m),
                report.collisions.to_string(),
                report.crashes.to_string(),
                figure(report.step_p99_us),
                report.frame_overruns.map_or_else(|| "-".to_owned(), |late| late.to_string()),
            ]);
        }
        text += &format!("\nleast separation across teams  {} m", figure(self.across_separation_m));
        text += &self.nearest.as_ref().map(|pair| format!(" ({pair})")).unwrap_or_default();
        text += &format!("\ncollisions across teams        {}\n", self.across_collisions);
        text + &format!("files                          {}\n", out.display())
    }
}
