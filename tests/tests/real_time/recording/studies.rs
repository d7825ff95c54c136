//! What a study records.

use skein_tests::share::Share;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use skein_lab::metrics::worst_and_median;
use skein_lab::record::{FILE, read};

use super::PROGRAM;

/// Five short flights into a folder; gives the seeds that are recorded.
fn study(out: &Path, more: &[&str]) -> Vec<u64> {
    let sets = ["duration_s=12", "swarm.vehicles=2", "formation.altitude_m=8", "network.loss=0.2"];
    let mut command = Command::new(PROGRAM);
    command.args(["study", "--seeds", "3..8", "--out"]).arg(out);
    sets.iter().for_each(|set| _ = command.args(["--set", set]));
    let ran = command.args(more).output().unwrap();
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let is_recorded = |seed: &u64| folder(out, *seed).join(FILE).exists();
    (3..8).filter(is_recorded).collect()
}

fn folder(out: &Path, seed: u64) -> PathBuf {
    out.join(format!("seed-{seed}"))
}

/// Every table of figures, without the wall clock's columns.
fn figures(out: &Path) -> Vec<Value> {
    let metrics = (3..8).map(|seed| fs::read_to_string(folder(out, seed).join("metrics.json")).unwrap());
    let without_clock = |text: String| {
        let mut metrics: Value = serde_json::from_str(&text).unwrap();
        skein_lab::metrics::WALL_CLOCK_KEYS.iter().for_each(|key| metrics[key] = 0.into());
        metrics
    };
    metrics.map(without_clock).collect()
}

#[test]
fn the_worst_and_the_median_seed_are_recorded_and_nothing_else_changes() {
    let _share = Share::of(100);
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    let recorded = study(&at("default"), &[]);
    let runs: Vec<_> = (3..8)
        .map(|seed| fs::read_to_string(folder(&at("default"), seed).join("metrics.json")).unwrap())
        .map(|text| skein_lab::metrics::Measured::read(&text).unwrap())
        .collect();
    let (worst, median) = worst_and_median(&runs).unwrap();
    assert!(recorded.len() == 2 && recorded.contains(&worst) && recorded.contains(&median), "{recorded:?}");

    assert_eq!(study(&at("none"), &["--no-record"]), Vec::<u64>::new());
    assert_eq!(study(&at("off"), &["--set", "record.runs=none"]), Vec::<u64>::new());
    assert_eq!(study(&at("all"), &["--set", "record.runs=all", "--jobs", "2"]), [3, 4, 5, 6, 7]);
    assert_eq!(figures(&at("default")), figures(&at("none")));
    assert_eq!(figures(&at("default")), figures(&at("all")));
    let both = |name: &str| fs::read(folder(&at(name), worst).join(FILE)).unwrap();
    let (one, two) = (read(&folder(&at("default"), worst).join(FILE)), read(&folder(&at("all"), worst).join(FILE)));
    let (one, two) = (one.unwrap(), two.unwrap());
    assert_eq!((&one.tracks, &one.noted, one.run.seed), (&two.tracks, &two.noted, worst));
    assert_eq!(one.tracks[0].steps.len(), 120, "ten a second");
    study(&at("again"), &[]);
    assert_eq!(both("default"), both("again"), "the same study, the same bytes");
    assert_eq!(one.scenario.record.runs, skein_common::scenario::RecordRuns::WorstAndMedian);
}
