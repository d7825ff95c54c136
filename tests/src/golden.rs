//! Golden files: figures of flights in virtual time, to the last bit. They are the same on every computer, so that a
//! test compares them exactly. `cargo run --release -p skein-tests --bin tables -- golden` writes them again and prints
//! which medians changed. The golden tables, `tests/golden/*.txt`, are what the program `tables` prints; `.ci/long`
//! writes them, and the book shows excerpts.

use skein_common::statistics::median;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::Value;
use skein_lab::metrics::{Report, WALL_CLOCK_KEYS};

use crate::{formation_error, in_parallel, study};

/// The flights of `flights.csv`: a shipped scenario and further settings.
pub const FLIGHTS: [(&str, &[&str]); 9] = [
    ("hover.toml", &[]),
    ("hover.toml", &["preset=paper"]),
    ("hover.toml", &["swarm.vehicles=8", "world.wind_m_s=8", "world.gust_w20_m_s=5", "duration_s=150"]),
    ("flock.toml", &[]),
    ("tour.toml", &[]),
    ("sinusoid.toml", &["duration_s=200"]),
    ("crossing.toml", &[]),
    ("laws.toml", &["formation.law=olfati-saber", "swarm.vehicles=8"]),
    ("laws.toml", &["formation.law=vasarhelyi", "swarm.vehicles=8"]),
];

/// Number of seeds of each of [`FLIGHTS`].
pub const SEEDS: u64 = 2;

/// A golden file and the function that makes it.
pub struct Golden {
    /// Name of the file in `tests/golden`.
    pub name: &'static str,
    /// Flies the flights and returns the text of the file.
    pub make: fn() -> String,
}

/// Every golden file.
pub const FILES: [Golden; 2] =
    [Golden { name: "flights.csv", make: flights }, Golden { name: "formation_error.csv", make: formation_error::csv }];

impl Golden {
    /// Path of the file.
    pub fn path(&self) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("golden").join(self.name)
    }
}

/// Every figure of [`FLIGHTS`] that does not depend on the wall clock, a row for each flight.
///
/// # Panics
/// If a scenario is not valid.
pub fn flights() -> String {
    let runs: Vec<(usize, u64)> = (0..FLIGHTS.len()).flat_map(|nth| (0..SEEDS).map(move |seed| (nth, seed))).collect();
    let reports = in_parallel(0..runs.len() as u64, |nth| {
        let (flight, seed) = runs[nth as usize];
        let (name, sets) = FLIGHTS[flight];
        figures(&study(name, sets).fly(seed).expect("a shipped scenario flies"))
    });
    let names: Vec<&String> = reports[0].keys().collect();
    let mut text =
        format!("scenario,set,seed,{}\n", names.iter().map(|name| name.as_str()).collect::<Vec<_>>().join(","));
    for ((flight, seed), report) in runs.iter().zip(&reports) {
        let (name, sets) = FLIGHTS[*flight];
        let cells: Vec<&str> = names.iter().map(|name| report[*name].as_str()).collect();
        text += &format!("{name},{},{seed},{}\n", sets.join(" "), cells.join(","));
    }
    text
}

/// The numbers of a report by name, empty if a figure does not apply or its event never happened.
fn figures(report: &Report) -> BTreeMap<String, String> {
    let Ok(Value::Object(keys)) = serde_json::to_value(report) else { unreachable!("a report is an object") };
    let is_figure = |key: &str, value: &Value| {
        !WALL_CLOCK_KEYS.contains(&key)
            && !["seed", "version", "revision"].contains(&key)
            && (value.is_number() || value.is_null())
    };
    let text = |value: Value| if value.is_null() { String::new() } else { value.to_string() };
    keys.into_iter().filter(|(key, value)| is_figure(key, value)).map(|(key, value)| (key, text(value))).collect()
}

/// Old and new medians of the columns that differ between two versions of a golden file.
pub fn moved(old: &str, new: &str) -> String {
    let columns = |text: &str| -> BTreeMap<String, Vec<f64>> {
        let mut lines = text.lines();
        let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
        let mut columns: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        for line in lines {
            for (name, cell) in names.iter().zip(line.split(',')) {
                columns.entry((*name).to_owned()).or_default().extend(cell.parse::<f64>().ok());
            }
        }
        columns
    };
    let mut old = columns(old);
    let rows = columns(new).into_iter().filter_map(|(name, new)| {
        let before = old.remove(&name).unwrap_or_default();
        if before == new {
            return None;
        }
        let (before, after) = (median(&mut before.clone()), median(&mut new.clone()));
        let share = before
            .zip(after)
            .filter(|(before, _)| *before != 0.0)
            .map(|(before, after)| 100.0 * (after / before - 1.0));
        let shown = |figure: Option<f64>| figure.map_or("-".to_owned(), |figure| figure.to_string());
        let share = share.map_or(String::new(), |share| format!("{share:+.3} %"));
        Some(format!("{name:<24} {:>22} {:>22} {share:>12}\n", shown(before), shown(after)))
    });
    rows.collect()
}
