//! What a study flies and where it is written: every point checked before anything flies, and a folder that a study which
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

use std::collections::{BTreeMap, BTreeSet};
use std::env;
use std::fs::{self, File};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::Read;
use std::num::NonZeroUsize;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Serialize;
use serde_json::{Value, json};
use skein_common::scenario::{ControlMode, Described, RecordRuns, SafetyFilter, Scenario};
use skein_core::aircraft::Aircraft;
use skein_core::start::starts;
use skein_host::external::is_external;
use skein_host::external::protocol::Time;

use super::flight::SeedFlight;
use super::sweep::{self, Point, Sweep};
use super::{FleetRecording, FleetStudy, Stop, Study, StudyArgs, StudyError};
use crate::error::Error;
use crate::external::{self, LawPool, Trial};
use crate::metrics::{Measured, Report, TRAFFIC_FILE, traffic_csv};
use crate::out::{self, Claim, write};
use crate::prepare::prepare;
use crate::scenario::{Ready, ScenarioArgs};

/// A study has at most this many runs: more would take too long.
const MOST_RUNS: usize = 10_000_000;
/// Name of the file in a study's folder that is there while recordings are missing.
pub(super) const UNRECORDED: &str = ".skein-unrecorded";

/// What a program that flies studies puts in.
#[derive(Clone, Debug)]
pub struct Host {
    /// The file of the program: only the same program resumes a study.
    pub program: PathBuf,
    /// Where external laws wait for their next run.
    pub laws: LawPool,
    /// Stops the study.
    pub stop: Stop,
}

/// A study before it flies.
#[derive(Clone, Debug)]
pub struct Plan {
    scenario: ScenarioArgs,
    /// What differs from point to point; one with nothing set without a sweep.
    pub points: Vec<Point>,
    /// Flown at each point.
    pub seeds: Range<u64>,
    /// The folder.
    pub out: PathBuf,
    /// Runs at once, if limited by the operator.
    pub jobs: Option<NonZeroUsize>,
    /// Threads that step each run.
    threads: NonZeroUsize,
    is_swept: bool,
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
    /// What stands against it; of a sweep, at which point.
    pub fn new(args: &StudyArgs) -> Result<Self, Error> {
        let program = env::current_exe().map_err(|error| Error::Failed(format!("the program itself: {error}")))?;
        Self::of(args, Host { program, laws: LawPool::with_timeout(args.law_timeout), stop: Stop::default() })
    }

    /// As [`Self::new`], flown by this program.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn of(args: &StudyArgs, host: Host) -> Result<Self, Error> {
        let described = args.scenario.read_any(Vec::new())?;
        let seed = described.seed();
        let own = args.seed.unwrap_or(seed);
        let points = sweep::points(&args.sweep, args.points, seed).map_err(Error::Refused)?;
        let plan = Self {
            scenario: args.scenario.clone(),
            points,
            seeds: args.seeds.clone().unwrap_or(own..own + 1),
            out: PathBuf::new(),
            jobs: args.jobs,
            threads: args.threads,
            is_swept: !args.sweep.is_empty(),
            is_fleet: described.is_fleet(),
            is_live: false,
            host,
            claim: None,
        };
        plan.checked(&described.first().scenario.name, &args.sweep, args.out.as_deref())
    }

    /// Flights in real time, one after another with these seeds. Whether each can begin is checked before it begins.
    ///
    /// # Errors
    /// As [`Self::new`]; or the scenario is a fleet.
    pub fn of_flights(scenario: &ScenarioArgs, seeds: Range<u64>, out: Option<&Path>) -> Result<Self, Error> {
        let name = scenario.read(Vec::new())?.scenario.name;
        let program = env::current_exe().map_err(|error| Error::Failed(format!("the program itself: {error}")))?;
        let plan = Self {
            scenario: scenario.clone(),
            points: vec![Point::default()],
            seeds,
            out: PathBuf::new(),
            jobs: None,
            threads: NonZeroUsize::MIN,
            is_swept: false,
            is_fleet: false,
            is_live: true,
            host: Host { program, laws: LawPool::default(), stop: Stop::default() },
            claim: None,
        };
        let plan = plan.checked(&name, &[], out)?;
        // What failed is flown again, and the series is not finished until then. Usually the file is not there.
        let _ = fs::remove_file(plan.out.join("summary.json"));
        Ok(plan)
    }

    /// What flies, for the lines about its runs.
    pub(super) fn scenario(&self) -> &ScenarioArgs {
        &self.scenario
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

    /// Threads that step each run.
    pub(super) fn threads(&self) -> NonZeroUsize {
        self.threads
    }

    /// Whether it has the points of a sweep.
    pub(super) fn is_swept(&self) -> bool {
        self.is_swept
    }

    /// Its `summary.json`.
    ///
    /// # Errors
    /// If not all runs have been flown.
    pub fn summary(&self) -> Result<String, Error> {
        let path = self.out.join("summary.json");
        fs::read_to_string(&path).map_err(|error| Error::Failed(format!("{}: {error}", path.display())))
    }

    /// How many runs it has: all seeds of the first point, then those of the next.
    pub fn runs(&self) -> usize {
        self.points.len() * (self.seeds.end - self.seeds.start) as usize
    }

    /// Which run that is.
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

    fn describe(&self, name: &str, sweeps: &[Sweep], fingerprint: u64) -> Result<Value, Error> {
        let mut program = DefaultHasher::new();
        hash_file(&self.host.program, &mut program)?;
        Ok(json!({
            "scenario": name,
            "target": if self.is_live { "fly" } else { "study" },
            "version": crate::VERSION,
            "revision": crate::REVISION,
            "seeds": format!("{}..{}", self.seeds.start, self.seeds.end),
            "sweep": sweeps.iter().map(Sweep::to_string).collect::<Vec<_>>(),
            "points": self.points.len(),
            // A hash of the program's own file: the revision does not distinguish builds with uncommitted changes.
            "program": format!("{:016x}", program.finish()),
            // Of every value of every point, and of the files that they name.
            "fingerprint": format!("{fingerprint:016x}"),
        }))
    }

    /// A new folder, or that of this very study if it has not come to its end.
    fn folder_for(&self, study: &Value, out: Option<&Path>, name: &str) -> Result<PathBuf, Error> {
        // Whether a law in this process is still the same cannot be checked.
        let begun = out
            .filter(|_| !self.host.laws.is_local())
            .and_then(|out| Some((out, fs::read_to_string(out.join("study.json")).ok()?)));
        let kind = if self.is_live { "flights" } else { "study" };
        let Some((out, begun)) = begun else { return out::folder(out, &format!("{name}-{kind}")) };
        let refused =
            |why: String| Err(Error::Refused(format!("--out {}: {why}; choose another folder", out.display())));
        let begun: Value = serde_json::from_str(&begun).unwrap_or_default();
        let differs = |(key, here): &(&String, &Value)| begun.get(key.as_str()) != Some(*here);
        let differing: Vec<_> = study.as_object().into_iter().flatten().filter(differs).collect();
        match differing.iter().find(|(key, _)| *key != "fingerprint") {
            Some((key, here)) => {
                let there = begun.get(key.as_str()).unwrap_or(&Value::Null);
                return refused(format!("another study is there: its {key} is {there}, not {here}"));
            }
            None if differing.is_empty() => {}
            None => {
                return refused("another study is there: its scenario or a file that it names has changed".to_owned());
            }
        }
        // Flights in real time that failed are flown again.
        let is_whole = || !self.is_live || (0..self.runs()).all(|nth| self.run(nth).measured_in(out).is_some());
        let is_recorded = || !out.join(UNRECORDED).exists();
        if out.join("summary.json").exists() && is_whole() && is_recorded() {
            return refused("this study is there already, and finished".to_owned());
        }
        std::path::absolute(out).map_err(|error| Error::Refused(format!("{}: {error}", out.display())))
    }
}

/// Whether two scenarios differ at most in the place and the seed of their teams.
fn differ_only_in_place(one: &Scenario, other: &Scenario) -> bool {
    let Scenario { seed, origin, team, .. } = *other;
    Scenario { seed, origin, team, ..one.clone() } == *other
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

/// Adds a file's content to the hash.
fn hash_file(path: &Path, hasher: &mut impl Hasher) -> Result<(), Error> {
    let failed = |error| Error::Refused(format!("{}: {error}", path.display()));
    let mut file = File::open(path).map_err(failed)?;
    // A program's file is large: reading all of it at once would be the most memory that a study uses.
    let mut piece = vec![0; 1 << 16];
    let mut length = 0;
    loop {
        let read = file.read(&mut piece).map_err(failed)?;
        if read == 0 {
            break;
        }
        hasher.write(&piece[..read]);
        length += read;
    }
    hasher.write_usize(length);
    Ok(())
}

/// The files that describe a run: the text of its complete scenario, of each aircraft, by name, and of each team that is recorded.
#[derive(Debug, Default)]
pub(super) struct RunFiles {
    scenario: String,
    aircraft: BTreeMap<String, String>,
    teams: Vec<String>,
}

/// One run of a study.
#[derive(Clone, Copy, Debug)]
pub struct PlannedRun<'a> {
    plan: &'a Plan,
    /// Which point, from 0.
    pub point: usize,
    /// Its seed.
    pub seed: u64,
}

impl PlannedRun<'_> {
    /// Its folder.
    pub fn folder(&self) -> PathBuf {
        self.folder_in(&self.plan.out)
    }

    /// Its folder if the study is in this one.
    fn folder_in(&self, study: &Path) -> PathBuf {
        let seed = || format!("seed-{}", self.seed);
        match () {
            () if self.plan.is_swept => study.join(format!("point-{}", self.point + 1)).join(seed()),
            () if self.plan.runs() > 1 || self.plan.is_live => study.join(seed()),
            () => study.to_owned(),
        }
    }

    /// What it measured, if it has been flown.
    pub fn measured(&self) -> Option<Measured> {
        self.measured_in(&self.plan.out)
    }

    /// What it measured, if it has been flown and the study is in this folder.
    fn measured_in(&self, study: &Path) -> Option<Measured> {
        Measured::read(&fs::read_to_string(self.folder_in(study).join("metrics.json")).ok()?).ok()
    }

    /// Its `metrics.json`.
    ///
    /// # Errors
    /// If it has not been flown.
    pub fn text(&self) -> Result<String, Error> {
        let path = self.folder().join("metrics.json");
        fs::read_to_string(&path).map_err(|error| Error::Failed(format!("{}: {error}", path.display())))
    }

    /// Its study, whose own seed it is, and the complete scenario file.
    ///
    /// # Errors
    /// If a file has changed since the plan was made.
    pub fn study(&self) -> Result<(Study, String), Error> {
        self.only().map(|(study, files)| (study, files.scenario))
    }

    /// Flies the run of a fleet and writes its files. It is recorded while it flies, because a fleet's recording is small.
    /// Beside its figures: whether it was recorded as far as it should be.
    ///
    /// # Errors
    /// The reason, with the name of the run.
    pub(super) fn fly_fleet(&self, is_recorded: bool) -> Result<(Measured, Result<(), Error>), Error> {
        self.remove_unfinished();
        let (teams, files) = self.ready()?;
        let (study, folder) = (FleetStudy { teams }, self.folder());
        let recording = FleetRecording { folder: &folder, scenario_toml: &files.scenario, teams_toml: &files.teams };
        let is_recorded = is_recorded && study.teams.iter().any(|team| team.scenario.record.runs != RecordRuns::None);
        let flown = study.fly(self.plan.threads, is_recorded.then_some(&recording));
        let (report, recorded) = flown.map_err(|error| Error::Failed(format!("{self}: {error}")))?;
        drop(study);
        write(&folder.join("teams.csv"), report.teams_csv())?;
        write(&folder.join(TRAFFIC_FILE), traffic_csv(&report.traffic))?;
        self.write(&files, &report)?;
        let recorded = recorded.map_err(|error| Error::Failed(format!("{self}: recording: {error}")));
        Ok((report.measured(), recorded))
    }

    /// Removes files that an earlier attempt was writing when it was killed.
    fn remove_unfinished(&self) {
        let entries = fs::read_dir(self.folder()).into_iter().flatten().flatten();
        for path in entries.map(|entry| entry.path()).filter(|path| path.extension().is_some_and(|end| end == "draft"))
        {
            // One that stays disturbs nothing.
            let _ = fs::remove_file(path);
        }
    }

    /// Makes room for a flight that is not there: what an earlier attempt left in its folder is removed.
    ///
    /// # Errors
    /// If a file cannot be removed.
    pub fn clear(&self) -> Result<(), Error> {
        let folder = self.folder();
        match fs::remove_dir_all(&folder) {
            Err(error) if folder.exists() => Err(Error::Failed(format!("{}: {error}", folder.display()))),
            _ => Ok(()),
        }
    }

    fn changed(&self) -> Error {
        Error::Refused(format!("{self}: the scenario has changed since the study began"))
    }

    /// Flies it and writes its files.
    ///
    /// # Errors
    /// What it failed of, naming the run.
    pub fn fly(&self) -> Result<Measured, Error> {
        let (files, flight) = self.begin()?;
        self.end(&files, flight.fly(None))
    }

    /// Its flight, on the ground, and the files that describe it. What an interrupted attempt was writing is removed.
    pub(super) fn begin(&self) -> Result<(RunFiles, SeedFlight), Error> {
        self.remove_unfinished();
        let (study, files) = self.only()?;
        let flight = SeedFlight::new(&study, self.seed).map_err(|error| self.failed(&error))?;
        let flight = flight.in_threads(self.plan.threads).until(self.plan.host.stop.clone());
        Ok((files, flight))
    }

    /// Writes its files, its flight being over.
    pub(super) fn end(&self, files: &RunFiles, report: Result<Report, StudyError>) -> Result<Measured, Error> {
        let report = report.map_err(|error| self.failed(&error))?;
        self.write(files, &report)?;
        Ok(Measured::of(&report))
    }

    /// Writes the files of a run, the figures last.
    fn write(&self, files: &RunFiles, report: &impl Serialize) -> Result<(), Error> {
        let folder = self.folder();
        write(&folder.join("scenario.toml"), &files.scenario)?;
        // With these beside it, it flies again from here alone.
        let is_shipped = |name: &str| Aircraft::SHIPPED.iter().any(|(shipped, _)| *shipped == name);
        let mut own = files.aircraft.iter().filter(|(name, _)| !is_shipped(name));
        own.try_for_each(|(name, text)| write(&folder.join(format!("{name}.toml")), text))?;
        write(&folder.join("metrics.json"), crate::terminal::json(report))
    }

    fn failed(&self, error: &StudyError) -> Error {
        Error::Failed(format!("{self}: {error}"))
    }

    /// The study of a swarm, and the files that describe the run.
    fn only(&self) -> Result<(Study, RunFiles), Error> {
        let (mut teams, files) = self.ready()?;
        let only = teams.pop().filter(|_| teams.is_empty());
        Ok((only.ok_or_else(|| self.changed())?, files))
    }

    /// The studies of the swarm or of the fleet's teams, and the files that describe the run.
    fn ready(&self) -> Result<(Vec<Study>, RunFiles), Error> {
        let described = self.read()?;
        let mut studies: Vec<Study> = Vec::with_capacity(described.all().len());
        let mut files = RunFiles { scenario: described.to_toml(), ..RunFiles::default() };
        for loaded in described.all() {
            let scenario = loaded.scenario.clone();
            let is_recorded = scenario.team.is_some_and(|team| team.is_recorded);
            files.teams.push(if is_recorded { loaded.to_toml() } else { String::new() });
            let before = studies.last().filter(|before| differ_only_in_place(&before.scenario, &scenario));
            let (aircraft, rules) = match before {
                Some(before) => (before.aircraft.clone(), before.rules.clone()),
                None => {
                    let ready = self.plan.scenario.ready(&scenario)?;
                    files.aircraft.extend(ready.aircraft_files);
                    (ready.aircraft, ready.rules)
                }
            };
            studies.push(Study { scenario, aircraft, rules, laws: self.plan.host.laws.clone() });
        }
        Ok((studies, files))
    }

    fn read(&self) -> Result<Described, Error> {
        let point = self.plan.points[self.point].sets();
        self.plan.scenario.read_any(point.chain([format!("seed={}", self.seed)]).collect())
    }

    /// Names the point, if there is more than one.
    fn at_point(&self, error: Error) -> Error {
        match self.plan.is_swept {
            true => Error::Refused(format!("point {} ({}): {error}", self.point + 1, self.plan.points[self.point])),
            false => error,
        }
    }
}

impl std::fmt::Display for PlannedRun<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: ", self.plan.scenario.name())?;
        if self.plan.is_swept {
            write!(f, "point {} ({}): ", self.point + 1, self.plan.points[self.point])?;
        }
        write!(f, "seed {}", self.seed)
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::cli::{Cli, Command};

    #[test]
    #[cfg(unix)]
    fn only_the_very_same_study_goes_on() {
        // It answers every hello, and ends with its input.
        let script = |which: &str| {
            format!("# {which}\nwhile read -r line; do echo '{{\"say\":\"ready\",\"protocol\":1}}'; done\n")
        };
        let folder = tempfile::tempdir().unwrap();
        let (law, scenario) = (folder.path().join("law.sh"), folder.path().join("two.toml"));
        let text = "swarm.vehicles = 2\n[formation]\nlaw = 'external'\nexternal.command = ['sh', 'law.sh']\n";
        fs::write(&scenario, text).unwrap();
        fs::write(&law, script("first")).unwrap();
        let out = folder.path().join("out");
        let line = ["skein", "study", scenario.to_str().unwrap(), "--out", out.to_str().unwrap()];
        let Command::Study(args) = Cli::try_parse_from(line).unwrap().command else { panic!("a study") };
        let plan = || Plan::new(&args).map(|plan| plan.out).map_err(|error| error.to_string());
        assert_eq!(plan(), Ok(out.clone()));
        assert_eq!(plan(), Ok(out.clone()), "the study resumes");
        fs::write(&law, script("second")).unwrap();
        let why = plan().unwrap_err();
        assert!(why.contains("its scenario or a file that it names has changed"), "{why}");
        fs::write(&law, script("first")).unwrap();
        let there = fs::read_to_string(out.join("study.json")).unwrap();
        let mut study: Value = serde_json::from_str(&there).unwrap();
        study["program"] = "0123456789abcdef".into();
        fs::write(out.join("study.json"), study.to_string()).unwrap();
        let why = plan().unwrap_err();
        assert!(why.contains("another study is there: its program is \"0123456789abcdef\", not "), "{why}");
    }
}
