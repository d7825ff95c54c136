//! Flies a plan and writes its results.

use std::fs;
use std::num::NonZeroUsize;

use super::flight::fly_side_by_side;
use super::plan::{Plan, UNRECORDED};
use super::recorded::record;
use super::summary::{by_point, csv, summary};
use crate::error::Error;
use crate::metrics::Measured;
use crate::out::write;
use crate::record::FLEET_FILE;
use crate::terminal::json;
use skein_host::parallel::{cores, in_parallel};

/// Shows how far a study is.
pub trait Progress: Sync {
    /// The study begins: `done` of its `runs` were there already.
    fn begin(&self, runs: usize, done: usize);
    /// One more run is done.
    fn inc(&self);
}

/// The results of a study.
#[derive(Debug)]
pub struct FlownStudy {
    /// The figures of all runs.
    pub runs: Vec<Measured>,
    /// Whether everything was recorded that should be. The figures are written in any case, and the same study continues with
    /// its recordings.
    pub recorded: Result<(), Error>,
}

/// Flies the runs that are not there yet, writes `runs.csv` and `summary.json`, and then records what the scenario asks for
/// unless `is_recorded` is false.
///
/// # Errors
/// A run that failed; those that were done are written.
pub fn fly_planned(plan: &Plan, is_recorded: bool, progress: &dyn Progress) -> Result<FlownStudy, Error> {
    let jobs = plan.jobs.unwrap_or_else(|| share_of(cores(), plan.threads.map_or(1, NonZeroUsize::get)));
    let (runs, recorded) = fly(plan, jobs, is_recorded, progress)?;
    // As long as this file is there, the study is not finished.
    let unrecorded = plan.out.join(UNRECORDED);
    if is_recorded {
        write(&unrecorded, "")?;
    }
    write_results(plan, &runs)?;
    let recorded = if is_recorded && !plan.is_fleet { record(plan, &runs, jobs) } else { recorded };
    if recorded.is_ok() && is_recorded {
        let failed = |error| Error::Failed(format!("{}: {error}", unrecorded.display()));
        fs::remove_file(&unrecorded).map_err(failed)?;
    }
    Ok(FlownStudy { runs, recorded })
}

/// The cores for each of so many that want them at once: one at least.
fn share_of(cores: NonZeroUsize, at_once: usize) -> NonZeroUsize {
    NonZeroUsize::new(cores.get() / at_once.max(1)).unwrap_or(NonZeroUsize::MIN)
}

/// Writes `runs.csv`, then `summary.json`.
///
/// # Errors
/// If a file cannot be written.
pub fn write_results(plan: &Plan, runs: &[Measured]) -> Result<(), Error> {
    write(&plan.out.join("runs.csv"), csv(&plan.points, runs))?;
    let text = if plan.is_swept { json(&by_point(&plan.points, runs)) } else { json(&summary(runs)) };
    // The last of the figures: they are complete when it is there.
    write(&plan.out.join("summary.json"), &text)
}

/// All runs in their order, and of a fleet whether they were recorded; those that were there already are only read.
fn fly(
    plan: &Plan,
    jobs: NonZeroUsize,
    is_recorded: bool,
    progress: &dyn Progress,
) -> Result<(Vec<Measured>, Result<(), Error>), Error> {
    // A fleet is recorded while it flies: one whose recording has failed flies again.
    let lacks_recording = plan.is_fleet && is_recorded && plan.out.join(UNRECORDED).exists();
    let is_done = |nth: usize| !lacks_recording || plan.run(nth).folder().join(FLEET_FILE).exists();
    let measured = |nth: usize| plan.run(nth).measured().filter(|_| is_done(nth));
    let mut there: Vec<Option<Measured>> = (0..plan.runs()).map(measured).collect();
    let mut recorded = Ok(());
    let left: Vec<usize> = (0..there.len()).filter(|&nth| there[nth].is_none()).collect();
    progress.begin(there.len(), there.len() - left.len());
    let flown = if plan.is_fleet {
        let idle = share_of(cores(), left.len().min(jobs.get()));
        let fly = |nth: usize| plan.run(left[nth]).fly_fleet(idle, is_recorded).inspect(|_| progress.inc());
        let (flown, each): (Vec<_>, Vec<_>) = in_parallel(left.len(), jobs, fly)?.into_iter().unzip();
        recorded = each.into_iter().collect();
        flown
    } else {
        let begin = |nth: usize| {
            let run = plan.run(left[nth]);
            run.begin().map(|(files, flight)| ((run, files), flight))
        };
        fly_side_by_side(left.len(), jobs, begin, |(run, files), report| {
            run.end(&files, report).inspect(|_| progress.inc())
        })?
    };
    left.into_iter().zip(flown).for_each(|(nth, measured)| there[nth] = Some(measured));
    Ok((there.into_iter().flatten().collect(), recorded))
}
