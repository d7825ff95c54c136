//! Records runs of a study: they are flown again, with a recorder looking on.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::BufWriter;
use std::num::NonZeroUsize;
use std::path::Path;

use skein_common::scenario::{RecordRuns, Scenario};

use super::plan::{Plan, PlannedRun};
use super::{Study, StudyError};
use crate::error::Error;
use crate::metrics::{Measured, Report, Run, WALL_CLOCK_KEYS, worst_and_median};
use crate::record::{self, Draft, RecordError, RecordingInfo, Writer, log_time_ns};
use skein_host::parallel::in_parallel;

/// Records what the scenario of each point asks for, beside the figures of the run. What is there already is left.
///
/// # Errors
/// If a recording cannot be written, or a run measures something else than the first time.
pub(super) fn record(plan: &Plan, runs: &[Measured], jobs: NonZeroUsize) -> Result<(), Error> {
    let per_point = (runs.len() / plan.points.len().max(1)).max(1);
    let mut chosen = Vec::new();
    for (point, its) in runs.chunks(per_point).enumerate() {
        let first = point * per_point;
        let (study, _) = plan.run(first).study()?;
        let seeds: BTreeSet<u64> = match study.scenario.record.runs {
            RecordRuns::None => BTreeSet::new(),
            RecordRuns::All => its.iter().map(|run| run.seed).collect(),
            RecordRuns::WorstAndMedian => worst_and_median(its).into_iter().flat_map(|(w, m)| [w, m]).collect(),
        };
        chosen.extend((first..first + its.len()).filter(|&nth| seeds.contains(&runs[nth].seed)));
    }
    chosen.retain(|&nth| !plan.run(nth).folder().join(record::FILE).exists());
    in_parallel(chosen.len(), jobs, |nth| again(&plan.run(chosen[nth]), &runs[chosen[nth]])).map(|_| ())
}

/// Flies a run again and records it.
fn again(run: &PlannedRun<'_>, measured: &Measured) -> Result<(), Error> {
    let (study, text) = run.study()?;
    let path = run.folder().join(record::FILE);
    let report = record_run(&study, run.seed, &text, &path);
    let report = report.map_err(|error| Error::Failed(format!("{run}: recording: {error}")))?;
    match first_difference(measured, &Measured::of(&report)) {
        None => Ok(()),
        Some(key) => {
            // Of another flight than the figures: it must not be taken for the run's.
            fs::remove_file(&path).map_err(|error| Error::Failed(format!("{}: {error}", path.display())))?;
            Err(Error::Failed(format!(
                "{run}: flown again to be recorded, it measured another {key}: something in it is not repeatable; the study goes \
                 on in its folder with --no-record"
            )))
        }
    }
}

/// The first figure that differs, besides those of the wall clock.
fn first_difference<'a>(one: &'a Measured, other: &'a Measured) -> Option<&'a str> {
    let keys = one.figures.keys().chain(other.figures.keys()).map(String::as_str);
    let same = |key: &str| one.figures.get(key) == other.figures.get(key);
    let differs = |key: &&str| !WALL_CLOCK_KEYS.contains(key) && !same(key);
    keys.into_iter().find(differs).or((one.never != other.never).then_some("never"))
}

/// The origin of log times.
const CLOCK: &str = "virtual: 0 is the beginning of the window of the figures";

/// The recording of a flight in virtual time, which appears under its name when it is complete.
pub(super) struct RunRecorder {
    /// The file that is written.
    pub(super) writer: Writer<BufWriter<File>>,
    draft: Draft,
}

impl RunRecorder {
    /// Begins a recording at `path`.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(super) fn begin(path: &Path, about: &RecordingInfo<'_>) -> Result<Self, RecordError> {
        let draft = Draft::new(path);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(|error| draft.error(error))?;
        }
        let mut writer = Writer::begin(BufWriter::new(draft.create()?), about, CLOCK, 0)?;
        writer.window_begins(0);
        Ok(Self { writer, draft })
    }

    /// Completes the recording of a window of this length, s.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(super) fn finish(self, duration_s: f64) -> Result<(), RecordError> {
        let Self { mut writer, draft } = self;
        writer.window_ends(log_time_ns(0, duration_s));
        let file = writer.finish(0)?.into_inner().map_err(|error| draft.error(error.into_error()))?;
        draft.finish(&file)
    }
}

/// Flies one seed again and records it at `path`, at the scenario's `record.hz`; `as_flown` is that seed's complete scenario
/// file. The file appears when it is whole. The flight, and so its report, is the same as without a recorder.
///
/// # Errors
/// If it cannot be flown or written.
pub fn record_run(study: &Study, seed: u64, as_flown: &str, path: &Path) -> Result<Report, StudyError> {
    let scenario = Scenario { seed, ..study.scenario.clone() };
    let run = Run::new(&scenario, "study");
    let about = RecordingInfo { scenario: &scenario, scenario_toml: as_flown, run: &run, is_fleet: false };
    let mut recorder = RunRecorder::begin(path, &about)?;
    let report = study.fly_watched(seed, Some((&mut recorder.writer, scenario.record.hz.in_study_hz())))?;
    recorder.finish(report.duration_s)?;
    Ok(report)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::cli::{Cli, Command};

    #[test]
    fn a_recording_of_another_flight_is_not_left() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out").display().to_string();
        let line = ["skein", "study", "--set", "swarm.vehicles=2", "--set", "duration_s=2", "--out", &out];
        let Command::Study(args) = Cli::try_parse_from(line).unwrap().command else { panic!("a study") };
        let plan = Plan::new(&args).unwrap();
        let run = plan.run(0);
        let is_there = || run.folder().join(record::FILE).exists();
        let (files, flight) = run.begin().unwrap();
        let measured = run.end(&files, flight.fly(None)).unwrap();
        let mut other = measured.clone();
        other.figures.insert("max_tilt_deg".to_owned(), Some(-1.0));
        let refusal = again(&run, &other).unwrap_err().to_string();
        assert!(refusal.contains("it measured another max_tilt_deg") && !is_there(), "{refusal}");
        again(&run, &measured).unwrap();
        assert!(is_there());
    }

    #[test]
    fn only_the_wall_clock_may_differ() {
        let run = |wall: f64, rms: f64, never: &str| {
            let text =
                format!("{{\n  \"seed\": 1,\n  \"wall_s\": {wall},\n  \"rms_m\": {rms},\n  \"never\": [{never}]\n}}");
            Measured::read(&text).unwrap()
        };
        let first = run(1.0, 0.5, "");
        assert_eq!(first_difference(&first, &run(2.0, 0.5, "")), None);
        assert_eq!(first_difference(&first, &run(1.0, 0.500_000_000_000_000_1, "")), Some("rms_m"));
        assert_eq!(first_difference(&first, &run(1.0, 0.5, "\"in_band_s\"")), Some("never"));
    }
}
