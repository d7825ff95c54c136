//! Flights in real time that follow each other, in the folder of a study: `skein fly --runs N` flies them, and this module
//! keeps what they left.
//!
//! A flight that failed is a row too: with the reason in place of figures, or beside them. It is flown again by the
//! next such command, if it has no figures.

use std::fs;

use super::plan::{Plan, PlannedRun};
use super::summary::{FAILURE, summary};
use super::{table, verdict};
use crate::error::Error;
use crate::metrics::Measured;
use crate::out::write;

/// The file with the reason why a flight failed, in the folder of its run.
const FAILURE_FILE: &str = "failure.txt";

/// Notes why a flight failed.
///
/// # Errors
/// If the file cannot be written.
pub fn note_failure(run: &PlannedRun<'_>, why: &str) -> Result<(), Error> {
    write(&run.folder().join(FAILURE_FILE), format!("{why}\n"))
}

/// Takes the figures of a flight that was interrupted out of the study: it is flown again. Its other files stay until then.
///
/// # Errors
/// If the file cannot be renamed.
pub fn discard(run: &PlannedRun<'_>) -> Result<(), Error> {
    let [from, to] = ["metrics.json", "metrics-interrupted.json"].map(|name| run.folder().join(name));
    match fs::rename(&from, to) {
        Err(error) if from.exists() => Err(Error::Failed(format!("{}: {error}", from.display()))),
        _ => Ok(()),
    }
}

/// A row for each flight that was tried, in the order of seeds.
pub fn rows(plan: &Plan) -> Vec<Measured> {
    (0..plan.runs()).filter_map(|nth| row(&plan.run(nth))).collect()
}

/// The seeds of flights that failed, each with the reason.
pub fn failures(rows: &[Measured]) -> impl Iterator<Item = (u64, &str)> {
    rows.iter().filter_map(|row| Some((row.seed, row.texts.get(FAILURE)?.as_str())))
}

/// The verdict on the flights with these rows, and the figures that a reader looks for first.
pub fn text(plan: &Plan, rows: &[Measured]) -> String {
    let verdict = verdict::verdict(&plan.scenario, &plan.points, rows);
    format!("{verdict}\n{}", table::of_figures(&summary(rows), table::Which::Headline))
}

/// The result of a flight: its figures, and the reason if it failed. `None` if it was not tried, or was interrupted.
fn row(run: &PlannedRun<'_>) -> Option<Measured> {
    let failure = fs::read_to_string(run.folder().join(FAILURE_FILE)).ok();
    let nothing = || Measured { seed: run.seed, ..Measured::default() };
    let mut row = run.measured().or_else(|| failure.is_some().then(nothing))?;
    row.texts.extend(failure.map(|why| (FAILURE.to_owned(), why.trim_end().to_owned())));
    Some(row)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::write_results;
    use super::*;
    use crate::scenario::ScenarioArgs;

    fn plan(out: &Path) -> Result<Plan, String> {
        let sets = ["swarm.vehicles=2", "duration_s=5"].map(str::to_owned).to_vec();
        let plan = Plan::of_flights(&ScenarioArgs { scenario: None, sets }, 3..6, Some(out));
        plan.map_err(|error| error.to_string())
    }

    fn fly(run: &PlannedRun<'_>) {
        let figures = format!("{{\n  \"seed\": {},\n  \"collisions\": 0,\n  \"in_band_s\": 7.5\n}}\n", run.seed);
        write(&run.folder().join("metrics.json"), &figures).unwrap();
    }

    #[test]
    fn a_failed_flight_is_a_row_with_its_reason_and_is_flown_again() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        let first = plan(&out).unwrap();
        fly(&first.run(0));
        fly(&first.run(1));
        note_failure(&first.run(1), "vehicle 2: did not land in time").unwrap();
        assert_eq!(rows(&first).len(), 2);
        note_failure(&first.run(2), "only 1 of 2 vehicles became active").unwrap();

        let left = rows(&first);
        assert_eq!(left.len(), first.runs());
        let failed = [(4, "vehicle 2: did not land in time"), (5, "only 1 of 2 vehicles became active")];
        assert_eq!(failures(&left).collect::<Vec<_>>(), failed);
        write_results(&first, &left).unwrap();
        let table = "seed,collisions,in_band_s,failure\n3,0,7.5,\n4,0,7.5,vehicle 2: did not land in time\n5,,,only 1 of 2 vehicles became active\n";
        assert_eq!(fs::read_to_string(out.join("runs.csv")).unwrap(), table);
        let figure = &summary(&left)["in_band_s"];
        assert_eq!((figure.n, figure.median), (2, Some(7.5)));
        let text = text(&first, &left);
        let line = "2 of 3 runs not flown to the end, seeds 4 and 5: skein fly --set swarm.vehicles=2 --set duration_s=5 --seed 4\n";
        assert!(text.starts_with("1 of 3 runs: no collision") && text.contains(line), "{text}");

        drop(first);
        let again = plan(&out).expect("a flight without figures is flown again");
        let left: Vec<_> = (0..3).map(|nth| again.run(nth).measured().is_some()).collect();
        assert_eq!(left, [true, true, false]);
        again.run(2).clear().unwrap();
        assert!(!again.run(2).folder().exists());
        fly(&again.run(2));
        write_results(&again, &rows(&again)).unwrap();
        let why = plan(&out).unwrap_err();
        assert!(why.contains("this study is there already, and finished"), "{why}");
    }

    #[test]
    fn an_interrupted_flight_is_not_a_row() {
        let folder = tempfile::tempdir().unwrap();
        let plan = plan(&folder.path().join("out")).unwrap();
        let run = plan.run(0);
        discard(&run).expect("nothing to discard");
        fly(&run);
        discard(&run).unwrap();
        assert!(run.measured().is_none() && rows(&plan).is_empty());
        assert!(run.folder().join("metrics-interrupted.json").is_file(), "its figures stay to be looked at");
    }

    #[test]
    fn a_study_is_not_resumed_by_flights() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        plan(&out).unwrap();
        let identity = out.join("study.json");
        let text = fs::read_to_string(&identity).unwrap();
        fs::write(&identity, text.replace("\"fly\"", "\"study\"")).unwrap();
        let why = plan(&out).unwrap_err();
        assert!(why.contains("another study is there: its target is \"study\", not \"fly\""), "{why}");
    }
}
