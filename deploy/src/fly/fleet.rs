//! One flight, or those of all teams of a fleet side by side: they share this process, the terminal and the air.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use skein_agent::config::fleet;
use skein_common::frame::Origin;
use skein_common::id::TeamId;
use skein_common::scenario::{Described, RecordRuns, Scenario};

use super::flight::{Flight, FlightResult};
use super::launch::prepare_site;
use super::plan::Plans;
use super::stream::{Happened, Line, Stream};
use crate::record::{FleetRecorder, told};
use skein_cluster::display::screen::Screen;
use skein_cluster::display::status::{self, FlightStatus};
use skein_cluster::endpoints::EndpointsFile;
use skein_cluster::findings::as_table;
use skein_cluster::os::Interrupts;
use skein_cluster::place;
use skein_host::clock;
use skein_lab::error::Error;
use skein_lab::metrics::across::{Across, Airborne};
use skein_lab::metrics::{FleetReport, Measured, Report, Run, TRAFFIC_FILE, Wall, traffic_csv};
use skein_lab::out::write;
use skein_lab::record::FLEET_FILE;
use skein_lab::terminal::complain;

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
    separations: Option<Separations>,
    /// `None` for a swarm that flies alone, or if the scenario wants no recording.
    recorder: Option<FleetRecorder>,
    out: PathBuf,
    screen: Screen,
    /// `--json`.
    stream: Option<Stream>,
    /// There while the swarms are.
    file: EndpointsFile,
}

/// The results of flights that are over.
pub struct FlightsResult {
    /// The flight, or that of each team in the order of teams.
    pub flights: Vec<FlightResult>,
    /// Whether it was a flight.
    pub verdict: Result<(), Error>,
    /// The figures of a fleet.
    fleet: Option<FleetReport>,
    out: PathBuf,
}

impl FlightsResult {
    /// The figures that a reader looks for first, and what to do next.
    pub fn summary(&self) -> String {
        match &self.fleet {
            Some(report) => text(&self.flights, report, &self.out),
            None => self.flights.iter().filter_map(FlightResult::summary).collect(),
        }
    }
}

impl Flights {
    /// Starts everything, X-Planes with their aircraft at the starts.
    ///
    /// # Errors
    /// If something cannot be started; then nothing is left running.
    pub fn begin(plans: Plans, gather_within: Duration, json: bool, interrupts: &Interrupts) -> Result<Self, Error> {
        let Plans { described, out, plans } = plans;
        let (endpoints, file, _claim) = prepare_site(&described, &out)?;
        // Of a swarm that flies here already nothing was placed: it is refused before.
        for plan in plans.iter().filter(|plan| !plan.xplanes.is_empty()) {
            let lines = place::before_flight(plan.scenario(), &plan.xplanes, || interrupts.count() > 0);
            complain(as_table(&lines, true).trim_end());
        }
        let fleet = described.first().scenario.team.map(|team| Origin::new(team.origin.geodetic()));
        let separations = fleet.map(|fleet| Separations { across: Across::new(fleet), since: None });
        let is_recorded = described.all().iter().any(|team| team.scenario.record.runs != RecordRuns::None);
        let recorder = || FleetRecorder::begin(&out.join(FLEET_FILE), &described);
        let recorder = (described.is_fleet() && is_recorded).then(recorder).transpose()?;
        let begin = |plan| Flight::begin(plan, &described, &endpoints, gather_within);
        let running = plans.into_iter().map(begin).collect::<Result<Vec<_>, _>>()?;
        let stream = json.then(|| begin_stream(&described, &out)).transpose()?;
        let screen = Screen::open(json);
        let (over, statuses) = (Vec::new(), Vec::new());
        Ok(Self { running, over, statuses, separations, recorder, out, screen, stream, file })
    }

    /// Shows the lines about the page beside the flights, and offers the QR code of its address.
    pub fn tell_of_page(&mut self, lines: Vec<String>, code: Option<String>) {
        self.screen.code = code;
        if let Some(first) = self.running.first_mut() {
            lines.into_iter().for_each(|line| first.show(clock::now(), line));
        }
    }

    /// Flies all of them to the end: a flight fails that never began, lost all its vehicles, or did not end on the ground.
    pub fn fly(mut self, interrupts: &Interrupts) -> FlightsResult {
        let mut next = clock::now();
        loop {
            let now = clock::now();
            for _ in 0..self.screen.asked_to_end() {
                interrupts.add();
            }
            let asked = interrupts.count();
            let over: Vec<usize> =
                (0..self.running.len()).filter(|nth| self.running[*nth].advance(now, asked)).collect();
            if let Some(separations) = &mut self.separations {
                separations.observe(&self.running, now);
            }
            self.pass_on(now);
            if over.len() == self.running.len() {
                break;
            }
            for nth in over.into_iter().rev() {
                let mut flight = self.running.remove(nth);
                let (status, news) = (flight.status(now), flight.journal.take_news(now, true));
                let news = shown(flight.scenario(), news);
                self.screen.show(&self.status(now), &news, now);
                self.statuses.push(status);
                self.over.push(flight.end());
            }
            let has_news = self.running.iter().any(|flight| flight.journal.has_news(now));
            if self.screen.is_due(now, has_news) {
                self.draw(now, false);
            }
            next = (next + TICK).max(now);
            clock::sleep(next.saturating_duration_since(clock::now()));
        }
        self.draw(clock::now(), true);
        let Self { running, mut over, separations, recorder, screen, stream, file, out, .. } = self;
        over.extend(running.into_iter().map(Flight::end));
        over.sort_by_key(|result| result.plan.scenario().team.map(|team| team.id));
        // The terminal is restored before anything is written to it.
        drop(screen);
        if over.iter().any(|result| result.leaves) {
            file.stay();
        }
        let notes = over.iter().flat_map(|result| shown(result.plan.scenario(), result.notes.clone()));
        let notes: Vec<String> = notes.chain(recorder.and_then(|recorder| told(recorder.file.finish()))).collect();
        notes.iter().for_each(|note| complain(note));
        let failures = over.iter().filter_map(|result| Some((result.plan.scenario(), result.verdict().err()?)));
        let failures: Vec<_> = failures.flat_map(|(scenario, why)| shown(scenario, vec![why])).collect();
        let verdict = if failures.is_empty() { Ok(()) } else { Err(Error::Failed(failures.join("; "))) };
        let fleet = separations.map(|separations| report(&over, &separations.across));
        let written = fleet.as_ref().map_or(Ok(()), |report| write_fleet(&over, report, &out));
        let verdict = verdict.and(written);
        if let Some(stream) = stream {
            let error = verdict.as_ref().err().map(ToString::to_string);
            let about = (error.as_deref(), notes.as_slice());
            let (now, out) = (clock::now(), out.display().to_string());
            match (&fleet, over.first()) {
                (Some(report), _) => stream.end(now, Some(report), about, &out),
                (None, first) => stream.end(now, first.and_then(|only| only.report.as_ref()), about, &out),
            }
        }
        FlightsResult { flights: over, verdict, fleet, out }
    }

    /// Writes what has happened to the stream of `--json`, and to the recording of a fleet, which also gets where the vehicles are
    /// from the moment when all teams are active.
    fn pass_on(&mut self, now: Instant) {
        let is_due = self.stream.as_ref().is_some_and(|stream| stream.is_due(now));
        let status = is_due.then(|| self.status(now));
        let all_have_begun = || self.running.iter().all(Flight::has_begun);
        let wants_places = self.recorder.as_mut().is_some_and(|recorder| recorder.is_due(now, all_have_begun));
        for flight in &mut self.running {
            let (happened, team) = (std::mem::take(&mut flight.happened), flight.scenario().team.map(|team| team.id));
            if let (Some(recorder), Some(team)) = (&mut self.recorder, team) {
                for Happened { at, line, .. } in &happened {
                    match line {
                        Line::Active(event) | Line::Landed(event) | Line::Event(event) => {
                            recorder.event(*at, team, event.vehicle, event.what);
                        }
                        Line::Fault { what, .. } => recorder.fault(*at, team, what),
                        _ => {}
                    }
                }
                if wants_places {
                    recorder.places(now, flight.scenario(), flight.steps(now));
                }
            }
            if let Some(stream) = &self.stream {
                happened.iter().for_each(|happened| stream.write(team, happened));
            }
        }
        if let (Some(stream), Some(status)) = (&mut self.stream, status) {
            stream.progress(now, &status);
        }
    }

    /// Brings the screen up to date; at the `end` with all news.
    fn draw(&mut self, now: Instant, end: bool) {
        let news = self.running.iter_mut().flat_map(|flight| {
            let news = flight.journal.take_news(now, end);
            shown(flight.scenario(), news)
        });
        let news: Vec<String> = news.collect();
        self.screen.show(&self.status(now), &news, now);
    }

    /// All flights as people look at them.
    fn status(&self, now: Instant) -> FlightStatus {
        let mut statuses: Vec<_> = self.running.iter().map(|flight| flight.status(now)).collect();
        if self.separations.is_none() && statuses.len() == 1 {
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

/// Begins the stream of `--json` with its first line.
fn begin_stream(described: &Described, out: &Path) -> Result<Stream, Error> {
    let now = clock::now();
    let stream = Stream::begin(now)?;
    let scenarios = || described.all().iter().map(|team| &team.scenario);
    let first = &described.first().scenario;
    let line = Line::Began {
        swarm: first.swarm.name.to_string(),
        ids: scenarios().flat_map(fleet::names).collect(),
        duration_s: first.duration_s,
        out: out.display().to_string(),
        run: Run::of_all(scenarios(), "fly"),
    };
    stream.write(None, &Happened { at: now, window_s: None, line });
    Ok(stream)
}

/// Writes the figures of a fleet into its folder.
fn write_fleet(over: &[FlightResult], report: &FleetReport, out: &Path) -> Result<(), Error> {
    let traffic: Vec<_> = over.iter().flat_map(|result| result.traffic.iter().cloned()).collect();
    write(&out.join("teams.csv"), report.teams_csv())?;
    write(&out.join(TRAFFIC_FILE), traffic_csv(&traffic))?;
    write(&out.join("metrics.json"), skein_lab::terminal::json(report))
}

/// The separations of vehicles of different teams, both in the air.
#[derive(Debug)]
struct Separations {
    across: Across,
    /// The time at which the first vehicle was in the air.
    since: Option<Instant>,
}

impl Separations {
    /// Observes the newest positions in all flights that are not over.
    fn observe(&mut self, flights: &[Flight], now: Instant) {
        let airborne = |flight: &Flight| {
            let scenario = flight.scenario();
            let mut airborne = Airborne::new(scenario.team?.id, Origin::new(scenario.origin.geodetic()));
            let mut vehicles = flight.airborne(now).peekable();
            if vehicles.peek().is_some() {
                self.since.get_or_insert(now);
            }
            airborne.add(self.since.map_or(0.0, |since| (now - since).as_secs_f64()), vehicles);
            Some(airborne)
        };
        let teams: Vec<Airborne> = flights.iter().filter_map(airborne).collect();
        self.across.observe(&teams.iter().collect::<Vec<_>>());
    }
}

/// The figures of these flights as those of one fleet.
fn report(over: &[FlightResult], across: &Across) -> FleetReport {
    let flown = |result: &'_ FlightResult| Some((result.plan.scenario().team?.id, result.report.clone()?));
    let reports: Vec<(TeamId, Report)> = over.iter().filter_map(flown).collect();
    let run = Run::of_all(over.iter().map(|result| result.plan.scenario()), "fly");
    let of_all = |figure: fn(&Report) -> f64| reports.iter().map(move |(_, report)| figure(report));
    let wall = Wall {
        wall_s: of_all(|report| report.wall_s).fold(0.0, f64::max),
        real_time_factor: of_all(|report| report.real_time_factor).fold(f64::INFINITY, f64::min),
    };
    let teams: Vec<_> = reports.iter().map(|(team, report)| (*team, report)).collect();
    FleetReport::new(run, &teams, across, None, wall)
}

/// The figures that a reader looks for first: a line for each team, and those across teams.
fn text(over: &[FlightResult], report: &FleetReport, out: &Path) -> String {
    let figure = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.2}"));
    let titles = ["team", "flown s", "rms m", "least m", "collisions", "crashes", "step p99 µs", "late frames"];
    let line = |cells: [String; 8]| {
        let cells = cells.iter().zip(titles).map(|(cell, title)| format!("{cell:>0$}", title.chars().count().max(8)));
        cells.collect::<Vec<_>>().join("  ") + "\n"
    };
    let mut text = line(titles.map(str::to_owned));
    for result in over {
        let team = result.plan.scenario().team.map(|team| team.id.to_string()).unwrap_or_default();
        let Some(report) = &result.report else {
            text += &format!("{team:>8}  no flight\n");
            continue;
        };
        text += &line([
            team,
            figure(Some(report.duration_s)),
            figure(report.radial_rms_m),
            figure(report.min_separation_m),
            report.collisions.to_string(),
            report.crashes.to_string(),
            figure(report.step_p99_us),
            report.frame_overruns.map_or_else(|| "-".to_owned(), |late| late.to_string()),
        ]);
    }
    let fleet = Measured::of(report);
    let of_fleet = |key: &str| fleet.value(key);
    text += &format!("\nleast separation across teams  {} m", figure(of_fleet("across_separation_m")));
    text += &fleet.texts.get("nearest_across").map(|pair| format!(" ({pair})")).unwrap_or_default();
    let collisions = of_fleet("across_collisions").unwrap_or_default();
    text += &format!("\ncollisions across teams        {collisions:.0}\n");
    text + &format!("files                          {}\n", out.display())
}
