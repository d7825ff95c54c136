//! Flies a plan and writes its results.

use std::num::NonZeroUsize;
use std::thread;

use super::flight::fly_side_by_side;
use super::plan::{Plan, write};
use super::recorded::record;
use super::summary::{by_point, csv, summary};
use crate::error::Error;
use crate::metrics::Measured;
use crate::terminal::json;
use skein_host::parallel::in_parallel;

/// Shows how far a study is.
pub trait Progress: Sync {
    /// The study begins: `done` of its `runs` were there already.
    fn begin(&self, runs: usize, done: usize);
    /// One more run is done.
    fn inc(&self);
}

/// Flies the runs that are not there yet, records what the scenario asks for unless `is_recorded` is false, and writes
/// `runs.csv` and, last of all, `summary.json`. Returns the figures of all runs.
///
/// # Errors
/// A run that failed; those that were done are written.
pub fn fly_planned(plan: &Plan, is_recorded: bool, progress: &dyn Progress) -> Result<Vec<Measured>, Error> {
    let cores = thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
    let jobs = plan.jobs.unwrap_or(NonZeroUsize::new(cores.get() / plan.threads()).unwrap_or(NonZeroUsize::MIN));
    let runs = fly(plan, jobs, is_recorded, progress)?;
    if is_recorded && !plan.is_fleet {
        record(plan, &runs, jobs)?;
    }
    write_results(plan, &runs)?;
    Ok(runs)
}

/// Writes `runs.csv` and, last of all, `summary.json`.
pub(super) fn write_results(plan: &Plan, runs: &[Measured]) -> Result<(), Error> {
    write(&plan.out.join("runs.csv"), &csv(&plan.points, runs))?;
    let text = match plan.is_swept() {
        true => json(&by_point(&plan.points, runs)),
        false => json(&summary(runs)),
    };
    // The last of all: the study is finished when it is there.
    write(&plan.out.join("summary.json"), &text)
}

/// All runs in their order; those that were there already are only read.
fn fly(plan: &Plan, jobs: NonZeroUsize, is_recorded: bool, progress: &dyn Progress) -> Result<Vec<Measured>, Error> {
    let mut there: Vec<Option<Measured>> = (0..plan.runs()).map(|nth| plan.run(nth).measured()).collect();
    let left: Vec<usize> = (0..there.len()).filter(|&nth| there[nth].is_none()).collect();
    progress.begin(there.len(), there.len() - left.len());
    let flown = if plan.is_fleet {
        in_parallel(left.len(), jobs, |nth| plan.run(left[nth]).fly_fleet(is_recorded).inspect(|_| progress.inc()))?
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
    Ok(there.into_iter().flatten().collect())
}
