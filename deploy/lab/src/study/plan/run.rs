//! One run of a study: where its files are, its flight, and what is written of it.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use serde::Serialize;
use skein_common::scenario::{Described, RecordRuns};
use skein_core::aircraft::Aircraft;

use super::super::flight::SeedFlight;
use super::super::{FleetRecording, Study, StudyError, fly_fleet};
use super::{Plan, differ_only_in_place, read_text};
use crate::error::Error;
use crate::metrics::{Measured, Report, TRAFFIC_FILE, traffic_csv};
use crate::out::write;

/// The files that describe a run: the text of its complete scenario, of each aircraft, by name, and of each team that
/// is recorded.
#[derive(Debug, Default)]
pub(in crate::study) struct RunFiles {
    scenario: String,
    aircraft: BTreeMap<String, String>,
    teams: Vec<String>,
}

/// One run of a study.
#[derive(Clone, Copy, Debug)]
pub struct PlannedRun<'a> {
    pub(super) plan: &'a Plan,
    /// Its point, counted from 0.
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

    /// Its figures, if it has been flown.
    pub fn measured(&self) -> Option<Measured> {
        self.measured_in(&self.plan.out)
    }

    /// Its figures, if it has been flown and the study is in this folder.
    pub(super) fn measured_in(&self, study: &Path) -> Option<Measured> {
        Measured::read(&fs::read_to_string(self.folder_in(study).join("metrics.json")).ok()?).ok()
    }

    /// Its `metrics.json`.
    ///
    /// # Errors
    /// If it has not been flown.
    pub fn text(&self) -> Result<String, Error> {
        read_text(&self.folder().join("metrics.json"))
    }

    /// Its study, whose own seed it is, and the complete scenario file.
    ///
    /// # Errors
    /// If a file has changed since the plan was made.
    pub fn study(&self) -> Result<(Study, String), Error> {
        self.only().map(|(study, files)| (study, files.scenario))
    }

    /// Flies the run of a fleet, which may use so many `idle` cores, and writes its files. It is recorded while it flies, because
    /// a fleet's recording is small. Beside its figures: whether it was recorded as far as it should be.
    ///
    /// # Errors
    /// The reason, with the name of the run.
    pub(in crate::study) fn fly_fleet(
        &self,
        idle: NonZeroUsize,
        is_recorded: bool,
    ) -> Result<(Measured, Result<(), Error>), Error> {
        self.remove_unfinished();
        let (teams, files) = self.ready()?;
        let (folder, threads) = (self.folder(), self.plan.threads.unwrap_or(idle));
        let recording = FleetRecording { folder: &folder, scenario_toml: &files.scenario, teams_toml: &files.teams };
        let is_recorded = is_recorded && teams.iter().any(|team| team.scenario.record.runs != RecordRuns::None);
        let flown = fly_fleet(&teams, threads, is_recorded.then_some(&recording));
        let (report, recorded) = flown.map_err(|error| self.failed(error))?;
        drop(teams);
        write(&folder.join("teams.csv"), report.teams_csv())?;
        write(&folder.join(TRAFFIC_FILE), traffic_csv(&report.traffic))?;
        self.write(&files, &report)?;
        Ok((Measured::of(&report), recorded.map_err(|error| self.failed(format_args!("recording: {error}")))))
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

    /// Its flight, on the ground, and the files that describe it. What an interrupted attempt was writing is removed.
    pub(in crate::study) fn begin(&self) -> Result<(RunFiles, SeedFlight), Error> {
        self.remove_unfinished();
        let (study, files) = self.only()?;
        let mut flight = SeedFlight::new(&study, self.seed).map_err(|error| self.failed(error))?;
        // The frame of a swarm is so short that a second thread gains nothing.
        flight.world.set_threads(self.plan.threads.unwrap_or(NonZeroUsize::MIN));
        flight.stop = self.plan.host.stop.clone();
        Ok((files, flight))
    }

    /// Writes its files, its flight being over.
    pub(in crate::study) fn end(
        &self,
        files: &RunFiles,
        report: Result<Report, StudyError>,
    ) -> Result<Measured, Error> {
        let report = report.map_err(|error| self.failed(error))?;
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

    fn failed(&self, error: impl fmt::Display) -> Error {
        Error::Failed(format!("{self}: {error}"))
    }

    /// The study of a swarm, and the files that describe the run.
    fn only(&self) -> Result<(Study, RunFiles), Error> {
        let (mut teams, files) = self.ready()?;
        let only = teams.pop().filter(|_| teams.is_empty());
        let changed = || Error::Refused(format!("{self}: the scenario has changed since the study began"));
        Ok((only.ok_or_else(changed)?, files))
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

    pub(super) fn read(&self) -> Result<Described, Error> {
        let point = self.plan.points[self.point].sets();
        self.plan.scenario.read_any(point.chain([format!("seed={}", self.seed)]).collect())
    }

    /// Names the point, if there is more than one.
    pub(super) fn at_point(&self, error: Error) -> Error {
        match self.plan.is_swept {
            true => Error::Refused(format!("point {} ({}): {error}", self.point + 1, self.plan.points[self.point])),
            false => error,
        }
    }
}

impl fmt::Display for PlannedRun<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: ", self.plan.scenario.name())?;
        if self.plan.is_swept {
            write!(f, "point {} ({}): ", self.point + 1, self.plan.points[self.point])?;
        }
        write!(f, "seed {}", self.seed)
    }
}
