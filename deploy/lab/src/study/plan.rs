//! The plan of a study: every point checked before anything flies, and a folder that a study which
//! was interrupted finds again.
//!
//! ```text
//! DIR/study.json            identity of the study: only the same study of the same program resumes here
//! DIR/runs.csv, summary.json    when all runs are there
//! DIR/scenario.toml, metrics.json           of a single run
//! DIR/seed-N/...                            of several seeds, or flights in real time
//! DIR/point-P/seed-N/...                    of a sweep
//! ```
//!
//! A run is there when its `metrics.json` is. Files are renamed when they are whole, so that a kill leaves none torn.
//! Flights in real time that follow each other have the same folder.

mod identity;
mod run;

use std::collections::BTreeSet;
use std::env;
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::num::NonZeroUsize;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use skein_common::scenario::{ControlMode, SafetyFilter, Scenario};
use skein_core::start::starts;
use skein_host::external::is_external;
use skein_host::external::protocol::Time;

use super::sweep::{self, Point, Sweep};
use super::{Stop, StudyArgs};
use crate::error::Error;
use crate::external::{self, LawPool, Trial};
use crate::out::{self, Claim, write};
use crate::prepare::prepare;
use crate::scenario::{Ready, ScenarioArgs};
use identity::hash_file;
pub use run::PlannedRun;

/// A study has at most this many runs: more would take too long.
const MOST_RUNS: usize = 10_000_000;
/// Name of the file in a study's folder that is there while recordings are missing.
pub(super) const UNRECORDED: &str = ".skein-unrecorded";

/// The things that a program which flies studies puts in.
#[derive(Clone, Debug)]
pub struct Host {
    /// The file of the program: only the same program resumes a study.
    pub program: PathBuf,
    /// The pool in which external laws wait for their next run.
    pub laws: LawPool,
    /// Stops the study.
    pub stop: Stop,
}

impl Host {
    /// This program, which nothing stops.
    fn own(laws: LawPool) -> Result<Self, Error> {
        let program = env::current_exe().map_err(|error| Error::Failed(format!("the program itself: {error}")))?;
        Ok(Self { program, laws, stop: Stop::default() })
    }
}

/// A study before it flies.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The scenario that flies.
    pub(super) scenario: ScenarioArgs,
    /// The points of the sweep; one with nothing set without a sweep.
    pub points: Vec<Point>,
    /// Flown at each point.
    pub seeds: Range<u64>,
    /// The folder.
    pub out: PathBuf,
    /// Runs at once, if limited by the operator.
    pub jobs: Option<NonZeroUsize>,
    /// Threads that step each run, if the operator has given their number.
    pub(super) threads: Option<NonZeroUsize>,
    /// Whether it has the points of a sweep.
    pub(super) is_swept: bool,
    /// Whether the scenario is a fleet of teams.
    pub is_fleet: bool,
    /// Whether its runs fly in real time.
    is_live: bool,
    host: Host,
    /// Keeps other commands from the folder.
    claim: Option<Arc<Claim>>,
}

impl Plan {
    /// Checks every run and finds the folder. Nothing is flown yet, and nothing written but `study.json`.
    ///
    /// # Errors
    /// The reason against the study; of a sweep, at which point.
    pub fn new(args: &StudyArgs) -> Result<Self, Error> {
        Self::of(args, Host::own(LawPool::with_timeout(args.law_timeout))?)
    }

    /// Checks every run and finds the folder, as [`Self::new`] does, for this program.
    ///
    /// # Errors
    /// The same as of [`Self::new`].
    pub fn of(args: &StudyArgs, host: Host) -> Result<Self, Error> {
        let described = args.scenario.read_any(Vec::new())?;
        let seed = described.seed();
        let own = args.seed.unwrap_or(seed);
        let plan = Self {
            points: sweep::points(&args.sweep, args.points, seed).map_err(Error::Refused)?,
            jobs: args.jobs,
            threads: args.threads,
            is_swept: !args.sweep.is_empty(),
            is_fleet: described.is_fleet(),
            ..Self::of_seeds(&args.scenario, args.seeds.clone().unwrap_or(own..own + 1), host)
        };
        plan.checked(&described.first().scenario.name, &args.sweep, args.out.as_deref())
    }

    /// Flights in real time, one after another with these seeds. Whether each can begin is checked before it begins.
    ///
    /// # Errors
    /// The same as of [`Self::new`]; or the scenario is a fleet.
    pub fn of_flights(scenario: &ScenarioArgs, seeds: Range<u64>, out: Option<&Path>) -> Result<Self, Error> {
        let name = scenario.read(Vec::new())?.scenario.name;
        let plan = Self { is_live: true, ..Self::of_seeds(scenario, seeds, Host::own(LawPool::default())?) };
        let plan = plan.checked(&name, &[], out)?;
        // What failed is flown again, and the series is not finished until then. Usually the file is not there.
        let _ = fs::remove_file(plan.out.join("summary.json"));
        Ok(plan)
    }

    /// Flights of a swarm with these seeds, before they are checked and have a folder.
    fn of_seeds(scenario: &ScenarioArgs, seeds: Range<u64>, host: Host) -> Self {
        Self {
            scenario: scenario.clone(),
            points: vec![Point::default()],
            seeds,
            out: PathBuf::new(),
            jobs: None,
            threads: None,
            is_swept: false,
            is_fleet: false,
            is_live: false,
            host,
            claim: None,
        }
    }

    /// Checks every run, and finds and marks the folder.
    fn checked(mut self, name: &str, sweep: &[Sweep], out: Option<&Path>) -> Result<Self, Error> {
        let seeds = usize::try_from(self.seeds.end - self.seeds.start).ok();
        if seeds.and_then(|seeds| seeds.checked_mul(self.points.len())).is_none_or(|runs| runs > MOST_RUNS) {
            return Err(Error::Refused(format!("more than {MOST_RUNS} runs")));
        }
        let fingerprint = self.check()?;
        let study = self.describe(name, sweep, fingerprint)?;
        self.out = self.folder_for(&study, out, name)?;
        self.claim = Some(Arc::new(out::claim(&self.out)?));
        // Another command may have had it until now.
        self.folder_for(&study, Some(&self.out), name)?;
        write(&self.out.join("study.json"), crate::terminal::json(&study))?;
        Ok(self)
    }

    /// Its `summary.json`.
    ///
    /// # Errors
    /// If not all runs have been flown.
    pub fn summary(&self) -> Result<String, Error> {
        read_text(&self.out.join("summary.json"))
    }

    /// The number of its runs: all seeds of the first point, then those of the next.
    pub fn runs(&self) -> usize {
        self.points.len() * (self.seeds.end - self.seeds.start) as usize
    }

    /// The run at this place.
    pub fn run(&self, nth: usize) -> PlannedRun<'_> {
        let seeds = (self.seeds.end - self.seeds.start) as usize;
        PlannedRun { plan: self, point: nth / seeds, seed: self.seeds.start + (nth % seeds) as u64 }
    }

    /// Reads every run's scenario and makes sure that it can begin. Gives the study's fingerprint.
    fn check(&mut self) -> Result<u64, Error> {
        let mut hasher = DefaultHasher::new();
        let mut law_files = BTreeSet::new();
        let mut jobs = self.jobs;
        let mut trial = Trial::default();
        let mut has_warned = false;
        for point in 0..self.points.len() {
            let first = PlannedRun { plan: self, point, seed: self.seeds.start };
            let described = first.read().map_err(|error| first.at_point(error))?;
            if point == 0 && !self.is_live {
                described.first().notes.iter().for_each(|note| eprintln!("{note}"));
            }
            let mut like_before: Option<(Scenario, Ready)> = None;
            for loaded in described.all() {
                let mut scenario = loaded.scenario.clone();
                self.check_team(&scenario).map_err(|error| first.at_point(error))?;
                let ready = match like_before.take() {
                    Some((before, ready)) if differ_only_in_place(&before, &scenario) => ready,
                    // A law in this process needs no trial, and each flight in real time has its own.
                    _ if self.host.laws.is_local() || self.is_live => {
                        self.scenario.ready(&scenario).map_err(|error| first.at_point(error))?
                    }
                    _ => prepare(&self.scenario, &scenario, Time::Virtual, &mut trial)
                        .map_err(|error| first.at_point(error))?,
                };
                if !self.is_live && !std::mem::replace(&mut has_warned, true) {
                    ready.rules.warnings.iter().for_each(|warning| eprintln!("warning: {warning}"));
                }
                jobs = external::jobs(&scenario, jobs).map_err(|error| first.at_point(Error::Refused(error)))?;
                for seed in self.seeds.clone() {
                    scenario.seed = scenario.team.map_or(seed, |team| team.id.seed(seed));
                    let run = PlannedRun { seed, ..first };
                    starts(&scenario).map_err(|error| Error::Refused(format!("{run}: {error}")))?;
                }
                values_of(&scenario).hash(&mut hasher);
                ready.aircraft_files.hash(&mut hasher);
                format!("{:?}", ready.rules).hash(&mut hasher);
                law_files.extend(files_of_law(&scenario));
                like_before = Some((scenario, ready));
            }
        }
        law_files.iter().try_for_each(|path| hash_file(path, &mut hasher))?;
        self.jobs = jobs;
        Ok(hasher.finish())
    }

    /// Checks what only matters to a team of a fleet.
    fn check_team(&self, scenario: &Scenario) -> Result<(), Error> {
        let Some(team) = scenario.team else { return Ok(()) };
        let refused = |why: &str| Err(Error::Refused(format!("{}: team {}: {why}", self.scenario.name(), team.id)));
        if is_external(scenario) {
            return refused("an external law flies one swarm, not a team of a fleet");
        }
        if scenario.control.mode == ControlMode::Central {
            return refused("`control.mode` = \"central\" is for one swarm, not for a team of a fleet");
        }
        if scenario.formation.safety_filter != SafetyFilter::Cbf {
            let name = self.scenario.name();
            eprintln!(
                "{name}: team {} does not avoid the other teams: that takes `formation.safety_filter` = \"cbf\"",
                team.id
            );
        }
        Ok(())
    }
}

/// Whether two scenarios differ at most in the place and the seed of their teams.
fn differ_only_in_place(one: &Scenario, other: &Scenario) -> bool {
    let Scenario { seed, origin, team, .. } = *other;
    Scenario { seed, origin, team, ..one.clone() } == *other
}

/// The text of a file that the study has written.
fn read_text(path: &Path) -> Result<String, Error> {
    fs::read_to_string(path).map_err(|error| Error::Failed(format!("{}: {error}", path.display())))
}

/// Every value of a scenario.
fn values_of(scenario: &Scenario) -> String {
    // A struct of numbers, texts and lists always has a JSON form; the seed is the study's.
    serde_json::to_string(&Scenario { seed: 0, ..scenario.clone() }).unwrap_or_default()
}

/// Files of an external law's command: program and arguments, as far as they are files.
fn files_of_law(scenario: &Scenario) -> impl Iterator<Item = PathBuf> {
    let command = scenario.formation.external.command.as_deref().filter(|_| is_external(scenario));
    command.unwrap_or_default().iter().map(PathBuf::from).filter(|path| path.is_file())
}
