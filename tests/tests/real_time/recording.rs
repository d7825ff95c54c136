//! Recordings: what was seen comes back, whatever becomes of the file.

mod damage;
#[cfg(unix)]
mod live;
mod python;
mod studies;
mod tables;

use std::path::{Path, PathBuf};

use serde_json::Value;
use skein_common::scenario::{Loaded, Source, load};
use skein_lab::metrics::{Report, Run, WALL_CLOCK_KEYS};
use skein_lab::record;
use skein_lab::recording::{Recording, Step, Track, Watch};
use skein_lab::study::Study;
use skein_lab::study::record_run;
use skein_tests::share::Share;
use skein_tests::{SHIPPED, of_scenario};
use tempfile::TempDir;

const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");

/// A flight with everything in it that can be noted.
const SETS: [&str; 5] = [
    "duration_s=40",
    "swarm.vehicles=3",
    "formation.altitude_m=8",
    "formation.radius_m=60",
    "mission.events=[\
     { at_s = 20, fault = 'kill', vehicle = 3, for_s = 5 }, \
     { at_s = 10, fault = 'cut', from = [1], to = [2], for_s = 4 }, \
     { at_s = 30, fault = 'engine_out', vehicle = 2 }]",
];

fn loaded(sets: &[&str]) -> Loaded {
    let (name, text) = SHIPPED[0];
    let sets: Vec<_> = sets.iter().map(|&set| set.to_owned()).collect();
    load(&Source { name, text }, &sets).unwrap()
}

/// A study, and one seed of it recorded.
fn flown(folder: &TempDir, sets: &[&str], seed: u64) -> (Study, Report, PathBuf) {
    let path = folder.path().join(format!("{seed}.mcap"));
    let (study, report) = fly_into(&path, sets, seed);
    (study, report, path)
}

fn fly_into(path: &Path, sets: &[&str], seed: u64) -> (Study, Report) {
    let study = of_scenario(loaded(sets).scenario);
    let as_flown = loaded(&[sets, &[&format!("seed={seed}")]].concat()).to_toml();
    let report = record_run(&study, seed, &as_flown, path).unwrap();
    (study, report)
}

/// The same with times rounded to nanoseconds, as files have them.
fn rounded(recording: Recording) -> Recording {
    let round = |t_s: f64| (t_s * 1e9).round() / 1e9;
    let step = |step: Step| Step { t_s: round(step.t_s), ..step };
    let track = |track: Track| Track { steps: track.steps.into_iter().map(step).collect(), ..track };
    Recording {
        tracks: recording.tracks.into_iter().map(track).collect(),
        noted: recording
            .noted
            .into_iter()
            .map(|mut noted| {
                noted.t_s = round(noted.t_s);
                noted
            })
            .collect(),
        ..recording
    }
}

/// Figures without the wall clock's.
fn figures(report: &Report) -> Value {
    let mut figures = serde_json::to_value(report).unwrap();
    WALL_CLOCK_KEYS.iter().for_each(|key| figures[key] = 0.into());
    figures
}

#[test]
fn what_was_seen_comes_back_bit_for_bit_and_recording_changes_nothing() {
    let _share = Share::of(100);
    let folder = tempfile::tempdir().unwrap();
    let (study, report, path) = flown(&folder, &SETS, 5);
    let plain = study.fly(5).unwrap();
    assert_eq!(figures(&report), figures(&plain));

    let scenario = skein_common::scenario::Scenario { seed: 5, ..study.scenario.clone() };
    let mut seen = Recording::new(&scenario, Run::new(&scenario, "study"));
    study.fly_watched(5, Some((&mut seen as &mut dyn Watch, 10.0))).unwrap();
    let seen = rounded(seen);
    assert!(seen.tracks.iter().all(|track| track.steps.len() > 300) && seen.noted.len() > 20, "{:?}", seen.noted);
    let read = record::read(&path).unwrap();
    assert_eq!(read.scenario, seen.scenario);
    assert_eq!(read.run, seen.run);
    assert_eq!(read.noted, seen.noted);
    for (read, seen) in read.tracks.iter().zip(&seen.tracks) {
        assert_eq!(read.steps.len(), seen.steps.len());
        for (read, seen) in read.steps.iter().zip(&seen.steps) {
            assert_eq!(read.t_s, seen.t_s);
            assert_same(&json(&read.trace), &json(&seen.trace));
        }
    }
}

fn json(message: &skein_common::message::Trace) -> Value {
    serde_json::to_value(message).unwrap()
}

/// Equal, numbers to their last bit but one.
fn assert_same(one: &Value, two: &Value) {
    match (one, two) {
        (Value::Object(one), Value::Object(two)) => {
            assert!(one.keys().eq(two.keys()));
            one.values().zip(two.values()).for_each(|(one, two)| assert_same(one, two));
        }
        (Value::Array(one), Value::Array(two)) => {
            assert_eq!(one.len(), two.len());
            one.iter().zip(two).for_each(|(one, two)| assert_same(one, two));
        }
        (Value::Number(one), Value::Number(two)) if one.is_f64() => {
            let (one, two) = (one.as_f64().unwrap(), two.as_f64().unwrap());
            assert!((one - two).abs() <= 2.0 * f64::EPSILON * two.abs(), "{one} is not {two}");
        }
        _ => assert_eq!(one, two),
    }
}
