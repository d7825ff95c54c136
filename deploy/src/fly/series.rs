//! Flights that follow each other without a person: the same scenario, one seed after another, `--runs`.
//!
//! Each flight begins as any other: every agent places its vehicle at its start, waits for the rotor, and takes off. In
//! between, all vehicles land and all agents end. X-Planes stay; a stand-in is started anew with its agent. The folder is
//! that of a study: [`skein_lab::study::flights`].
//!
//! A flight that fails is a row, and the next begins. The series ends early if no vehicle answers in a flight, or no X-Plane
//! before it: then the next would fail too.

use std::time::Duration;

use serde::Serialize;
use skein_common::message::Verb;
use skein_common::scenario::{Scenario, Simulator, Target};
use skein_host::clock;
use skein_host::parallel::at_once;
use skein_lab::error::Error;
use skein_lab::faults::{OperatorOrder, orders};
use skein_lab::scenario::{ScenarioArgs, quoted};
use skein_lab::study::flights::{self, discard, note_failure};
use skein_lab::study::plan::{Plan as SeriesPlan, PlannedRun};
use skein_lab::study::{self, Summary};
use skein_lab::terminal::{complain, say, what_next};

use super::FlyArgs;
use super::fleet::Flights;
use super::plan::{Plans, sets};
use skein_cluster::display::screen;
use skein_cluster::os::Interrupts;
use skein_cluster::simulators;
use skein_cluster::{endpoints, landing};

/// Interval at which a series looks whether vehicles that were left in the air are down.
const LOOK: Duration = Duration::from_secs(1);

/// The end of a flight of a series.
enum FlightEnd {
    /// With figures.
    Flown,
    /// With the reason, and perhaps with figures; the next flight begins.
    Failed(String),
    /// With the reason, and nothing answered: the next would fail too.
    Silent(String),
    /// By Ctrl-C.
    Interrupted,
}

/// The last line of `fly --runs --json`.
#[derive(Serialize)]
#[serde(tag = "kind", rename = "series")]
struct SeriesOutcome<'a> {
    /// Flights that the series has.
    runs: usize,
    /// Flights with figures.
    flown: usize,
    failed: Vec<FailedFlight<'a>>,
    /// The reason why the series ended early; null if it did not.
    error: Option<String>,
    out: String,
    /// Every figure over all flights, as in `summary.json`.
    figures: Summary,
}

#[derive(Serialize)]
struct FailedFlight<'a> {
    seed: u64,
    error: &'a str,
}

/// Flies this many times; `first` is the first flight, checked.
///
/// # Errors
/// A reason against the series; a flight that failed; or the early end of the series.
pub fn fly(args: &FlyArgs, first: Plans, runs: u64, interrupts: &Interrupts) -> Result<(), Error> {
    let first = first.described.first().scenario.clone();
    if !ends(&first) {
        return Err(Error::Refused(format!(
            "{}: nothing ends a flight of this scenario, so --runs would never begin the second; add --duration S",
            args.scenario.name()
        )));
    }
    let named = sets(&FlyArgs { seed: None, ..args.clone() })?;
    let scenario = ScenarioArgs { sets: [args.scenario.sets.clone(), named].concat(), ..args.scenario.clone() };
    let seeds = first.seed..first.seed.saturating_add(runs);
    let plan = SeriesPlan::of_flights(&scenario, seeds, args.out.as_deref())?;
    let left: Vec<usize> = (0..plan.runs()).filter(|&nth| plan.run(nth).measured().is_none()).collect();
    if left.len() < plan.runs() {
        eprintln!("{} of {} flights are there already", plan.runs() - left.len(), plan.runs());
    }
    let mut early = None;
    for (tried, nth) in left.into_iter().enumerate() {
        if interrupts.count() > 0 {
            early = Some("ended by Ctrl-C".to_owned());
            break;
        }
        let run = plan.run(nth);
        screen::say(args.json, &format!("flight {} of {}, seed {}", nth + 1, plan.runs(), run.seed));
        run.clear()?;
        early = match one(args, &run, interrupts) {
            Ok(ended) => close(&run, ended)?,
            // Nothing was flown yet.
            Err(error) if tried == 0 => return Err(error),
            Err(error) => Some(error.to_string()),
        };
        if early.is_some() {
            break;
        }
    }
    end(args, &plan, early)
}

/// Notes how a flight ended. Gives the reason if it was the last.
fn close(run: &PlannedRun<'_>, ended: FlightEnd) -> Result<Option<String>, Error> {
    let fails = |why: &str| {
        complain(&format!("seed {}: {why}", run.seed));
        note_failure(run, why)
    };
    Ok(match ended {
        FlightEnd::Flown => None,
        FlightEnd::Failed(why) => fails(&why).map(|()| None)?,
        FlightEnd::Silent(why) => {
            fails(&why)?;
            Some("no vehicle answered, so the next flight would fail too".to_owned())
        }
        FlightEnd::Interrupted => {
            discard(run)?;
            Some(format!("ended by Ctrl-C in the flight of seed {}", run.seed))
        }
    })
}

/// Prints and writes what the flights left. `early` is why the series ended before its last flight.
fn end(args: &FlyArgs, plan: &SeriesPlan, early: Option<String>) -> Result<(), Error> {
    let rows = flights::rows(plan);
    let is_whole = rows.len() == plan.runs();
    if is_whole {
        study::write_results(plan, &rows)?;
    }
    let (runs, failed) = (plan.runs(), flights::failures(&rows).count());
    let flown = (0..runs).filter(|&nth| plan.run(nth).measured().is_some()).count();
    let out = plan.out.display().to_string();
    if args.json {
        let failed = flights::failures(&rows).map(|(seed, error)| FailedFlight { seed, error }).collect();
        let figures = study::summary(&rows);
        let outcome = SeriesOutcome { runs, flown, failed, error: early.clone(), out: out.clone(), figures };
        // A line like those of each flight, in one piece.
        let line = serde_json::to_string(&outcome).map_err(|error| Error::Failed(format!("--json: {error}")))?;
        say(&format!("{line}\n"));
    } else if !rows.is_empty() {
        say(&flights::text(plan, &rows));
    }
    eprintln!("written to {out}");
    if !args.json && is_whole {
        let next = [
            (format!("skein report {}", quoted(&out)), "pictures and tables on one page"),
            (format!("skein compare {} OTHER", quoted(&out)), "against another series or a study, seed by seed"),
        ];
        eprint!("{}", what_next(&next));
    }
    let again = format!("the same command with --out {} flies the rest", quoted(&out));
    match (early, failed) {
        (Some(why), _) => Err(Error::Failed(format!("{why}: {flown} of {runs} flights are there; {again}"))),
        (None, 0) => Ok(()),
        (None, _) if flown < runs => Err(Error::Failed(format!("{failed} of {runs} flights failed; {again}"))),
        (None, _) => Err(Error::Failed(format!("{failed} of {runs} flights failed"))),
    }
}

/// Flies once.
///
/// # Errors
/// A reason against every flight of the series.
fn one(args: &FlyArgs, run: &PlannedRun<'_>, interrupts: &Interrupts) -> Result<FlightEnd, Error> {
    let (seed, out) = (Some(run.seed), Some(run.folder()));
    let args = FlyArgs { seed, out, runs: None, ..args.clone() };
    let scenario = args.scenario.read(sets(&args)?)?.scenario;
    let x_planes = match scenario.swarm.plant.spec().simulator {
        Simulator::Given => simulators::addresses(&scenario, &args.xplane)?,
        Simulator::Inside | Simulator::Launched { .. } => Vec::new(),
    };
    let plans = match ready(&x_planes).and_then(|()| Plans::new(&args)) {
        Ok(plans) => plans,
        Err(Error::Failed(why)) if simulators::any_answers(&x_planes) => return Ok(FlightEnd::Failed(why)),
        Err(Error::Failed(why)) if !x_planes.is_empty() => return Ok(FlightEnd::Silent(why)),
        Err(error) => return Err(error),
    };
    let flown = Flights::begin(plans, args.gather_within(), args.json, interrupts)?.fly(interrupts);
    if flown.flights.iter().any(|flight| flight.leaves) {
        wait_until_down(&scenario, interrupts);
    }
    if flown.flights.iter().any(|flight| flight.is_interrupted) {
        return Ok(FlightEnd::Interrupted);
    }
    let has_answered = flown.flights.iter().any(|flight| flight.has_answered);
    Ok(match flown.verdict {
        Ok(()) => FlightEnd::Flown,
        Err(why) if has_answered => FlightEnd::Failed(why.to_string()),
        Err(why) => FlightEnd::Silent(why.to_string()),
    })
}

/// Makes these X-Planes ready for a flight.
fn ready(addresses: &[String]) -> Result<(), Error> {
    simulators::ask_all(addresses)?;
    at_once(addresses.iter().map(|at| || simulators::reset::reset_if_crashed(at))).into_iter().collect()
}

/// Waits for vehicles that were left in the air: their agents land them and end.
fn wait_until_down(scenario: &Scenario, interrupts: &Interrupts) {
    let until = clock::now() + landing::limit_of(scenario);
    let flies = || matches!(endpoints::read(&endpoints::folder(), &scenario.swarm.name), Ok(Some(there)) if there.any_agent_answers());
    while clock::now() < until && interrupts.count() < 2 && flies() {
        clock::sleep(LOOK);
    }
}

/// Whether a flight ends by itself.
fn ends(scenario: &Scenario) -> bool {
    let last = scenario.mission.steps.last().map(|step| &step.target);
    let is_landing =
        |(_, order): &(f64, OperatorOrder)| order.vehicles.is_none() && matches!(order.verb, Verb::Land | Verb::Abort);
    let is_ordered = orders(&scenario.mission.events).iter().any(is_landing);
    scenario.duration_s.is_some() || matches!(last, Some(Target::Land(_))) || is_ordered
}
