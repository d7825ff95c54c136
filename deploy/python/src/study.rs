//! Flies studies, reads and compares folders.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use pyo3::prelude::*;
use skein_host::clock::sleep;
use skein_lab::compare::folder::Folder;
use skein_lab::compare::pairs::Paired;
use skein_lab::compare::{Comparison, check_figures, divergence};
use skein_lab::error::Error;
use skein_lab::external::LawPool;
use skein_lab::metrics::figures::FIGURES;
use skein_lab::scenario::ScenarioArgs;
use skein_lab::study::plan::{Host, Plan};
use skein_lab::study::{Progress, Stop, StudyArgs, fly_planned};

use crate::error::{exception, refused, wrong_argument};
use crate::law::LawsInPython;

/// Time between two looks at the interpreter's signals, and so the longest time until Ctrl-C has an effect.
const LOOK: Duration = Duration::from_millis(20);

/// The study that `skein.study` asks for.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Wanted {
    /// The scenario's file or name; `None` for the hover formation.
    scenario: Option<PathBuf>,
    /// Keys to set, as the option `--set` takes them.
    sets: Vec<String>,
    /// The first seed, and the one after the last; `None` for the scenario's own.
    seeds: Option<(u64, u64)>,
    /// The sweeps, as the option `--sweep` takes them.
    sweeps: Vec<String>,
    points: Option<usize>,
    jobs: Option<usize>,
    threads: Option<usize>,
    /// The folder of the results.
    out: PathBuf,
    is_recorded: bool,
}

/// The progress of a study: the number of its runs, and of those done.
#[derive(Default)]
struct Count {
    runs: AtomicUsize,
    done: AtomicUsize,
}

impl Progress for Count {
    fn begin(&self, runs: usize, done: usize) {
        self.runs.store(runs, Ordering::Relaxed);
        self.done.store(done, Ordering::Relaxed);
    }

    fn inc(&self) {
        self.done.fetch_add(1, Ordering::Relaxed);
    }
}

/// Flies a study as `skein study` does and writes its folder. `program` is the file of this module; `law`, if it is not
/// `None`, makes an object for each vehicle; `progress` is called with the number of runs that are done and of all.
#[pyfunction]
pub(crate) fn fly_study(
    py: Python<'_>,
    wanted: Wanted,
    program: PathBuf,
    law: Option<Py<PyAny>>,
    progress: Option<Py<PyAny>>,
) -> PyResult<()> {
    let raised = law.map(|law| LawsInPython::new(py, law)).transpose()?;
    let laws = raised.as_ref().map(|laws| LawPool::local(laws.maker())).unwrap_or_default();
    let (stop, count) = (Stop::default(), Count::default());
    let host = Host { program, laws, stop: stop.clone() };
    let args = args(py, &wanted)?;
    let shown = Mutex::new(None);
    let show = |py: Python<'_>| -> PyResult<()> {
        let now = (count.done.load(Ordering::Relaxed), count.runs.load(Ordering::Relaxed));
        let mut last = shown.lock().unwrap_or_else(PoisonError::into_inner);
        match &progress {
            Some(progress) if *last != Some(now) && now.1 > 0 => {
                *last = Some(now);
                progress.call1(py, now).map(|_| ())
            }
            _ => Ok(()),
        }
    };
    let (flown, interrupted) = py.detach(|| {
        thread::scope(|scope| {
            let study =
                scope.spawn(|| Plan::of(&args, host).and_then(|plan| fly_planned(&plan, wanted.is_recorded, &count)));
            let mut interrupted = Ok(());
            while !study.is_finished() {
                sleep(LOOK);
                if interrupted.is_ok() {
                    interrupted = Python::attach(|py| py.check_signals().and_then(|()| show(py)));
                    if interrupted.is_err() {
                        stop.set();
                    }
                }
            }
            (study.join(), interrupted)
        })
    });
    interrupted?;
    if let Some(error) = raised.and_then(|laws| laws.take_raised()) {
        return Err(error);
    }
    match flown {
        Ok(flown) => flown.and_then(|flown| flown.recorded).map_err(|error| exception(py, &error))?,
        Err(_) => return Err(refused(py, "the study ended by a defect of Skein; its report is on stderr")),
    };
    show(py)
}

fn args(py: Python<'_>, wanted: &Wanted) -> PyResult<StudyArgs> {
    let sweep =
        wanted.sweeps.iter().map(|text| text.parse().map_err(|why| refused(py, format!("sweep {text}: {why}"))));
    Ok(StudyArgs {
        scenario: ScenarioArgs { scenario: wanted.scenario.clone(), sets: wanted.sets.clone() },
        seeds: wanted.seeds.map(|(from, to)| from..to),
        sweep: sweep.collect::<PyResult<_>>()?,
        points: wanted.points,
        jobs: wanted.jobs.and_then(NonZeroUsize::new),
        threads: wanted.threads.and_then(NonZeroUsize::new),
        out: Some(wanted.out.clone()),
        no_record: !wanted.is_recorded,
        ..StudyArgs::default()
    })
}

/// Compares two folders as `skein compare --json` does: whether they are one target flown twice, and the JSON text.
#[pyfunction]
pub(crate) fn compare(py: Python<'_>, a: PathBuf, b: PathBuf, only: Vec<String>) -> PyResult<(bool, String)> {
    check_figures(&only).map_err(|error| wrong_argument(py, error.to_string()))?;
    let compared = py.detach(|| -> Result<(bool, String), Error> {
        let (a, b) = (Folder::read(&a)?, Folder::read(&b)?);
        let paired = Paired::new(&a, &b)?;
        let text = |json: Result<String, serde_json::Error>| json.map_err(|error| Error::Failed(error.to_string()));
        if ["target", "plant"].iter().any(|key| a.texts(key) != b.texts(key)) {
            return Ok((false, text(serde_json::to_string(&divergence::divergence(&paired, &only)))?));
        }
        Ok((true, text(serde_json::to_string(&Comparison::new(&paired, &only)))?))
    });
    compared.map_err(|error| exception(py, &error))
}

/// The table of all figures: key, unit, whether more or less is worse, and meaning.
#[pyfunction]
pub(crate) fn figures() -> Vec<(&'static str, &'static str, Option<String>, &'static str)> {
    let row = |figure: &skein_lab::metrics::figures::Figure| {
        let worse = figure.worse.map(|worse| format!("{worse:?}").to_lowercase());
        (figure.key, figure.unit, worse, figure.meaning)
    };
    FIGURES.iter().map(row).collect()
}
