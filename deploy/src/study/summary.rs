//! Many runs in one table, and in one line a figure.

use std::collections::BTreeMap;

use serde::Serialize;
use serde_json::Value;

use crate::metrics::{DIRECTIONS, Direction, Report};

/// One figure over all seeds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figure {
    /// Runs in which it has a value or never came to one.
    pub n: usize,
    /// Runs in which it never came to a value; they rank worst.
    pub never: usize,
    /// First quartile; `null` where the rank falls on a run without a value.
    pub q1: Option<f64>,
    /// Median.
    pub median: Option<f64>,
    /// Third quartile.
    pub q3: Option<f64>,
    /// Least value.
    pub min: Option<f64>,
    /// Largest value.
    pub max: Option<f64>,
    /// The worst value, where more or less is worse; `null` also if the worst run has none.
    pub worst: Option<f64>,
    /// The seed of the worst run.
    pub worst_seed: Option<u64>,
}

/// Every figure over all seeds, by its key in `metrics.json`.
pub type Summary = BTreeMap<String, Figure>;

/// Every number of a report by its key, `null` included.
fn figures(report: &Report) -> Vec<(String, Option<f64>)> {
    // A struct of numbers always has a JSON form.
    let Ok(Value::Object(keys)) = serde_json::to_value(report) else { return Vec::new() };
    let keys = keys.into_iter().filter(|(key, _)| !["seed", "vehicles"].contains(&key.as_str()));
    keys.filter(|(_, value)| value.is_number() || value.is_null()).map(|(key, value)| (key, value.as_f64())).collect()
}

/// Medians, quartiles and the worst of each figure.
pub fn summarize(reports: &[Report]) -> Summary {
    let mut columns: BTreeMap<String, Vec<(u64, Option<f64>)>> = BTreeMap::new();
    for report in reports {
        for (key, value) in figures(report) {
            if value.is_some() || report.never.contains(&key.as_str()) {
                columns.entry(key).or_default().push((report.run.seed, value));
            }
        }
    }
    columns.into_iter().map(|(key, column)| (key.clone(), figure(&key, &column))).collect()
}

fn figure(key: &str, column: &[(u64, Option<f64>)]) -> Figure {
    let direction = DIRECTIONS.iter().find(|(known, _)| *known == key).map(|(_, direction)| *direction);
    // From best to worst; without a direction, from least to largest. What never happened stands last.
    let sign = if direction == Some(Direction::Less) { -1.0 } else { 1.0 };
    let mut ranked = column.to_vec();
    let rank = |value: Option<f64>| value.map_or(f64::INFINITY, |value| sign * value);
    ranked.sort_by(|one, other| rank(one.1).total_cmp(&rank(other.1)));
    let at = |share: f64| {
        let place = share * (ranked.len() - 1) as f64;
        let (low, high) = (ranked[place.floor() as usize].1?, ranked[place.ceil() as usize].1?);
        Some(low + (high - low) * place.fract())
    };
    let (first, third) = if sign < 0.0 { (0.75, 0.25) } else { (0.25, 0.75) };
    let values = || column.iter().filter_map(|(_, value)| *value);
    let worst = ranked.last().filter(|_| direction.is_some());
    Figure {
        n: column.len(),
        never: column.iter().filter(|(_, value)| value.is_none()).count(),
        q1: at(first),
        median: at(0.5),
        q3: at(third),
        min: values().reduce(f64::min),
        max: values().reduce(f64::max),
        worst: worst.and_then(|(_, value)| *value),
        worst_seed: worst.map(|(seed, _)| *seed),
    }
}

/// One row a run: the seed, then every figure; empty where there is none.
pub(super) fn csv(reports: &[Report]) -> String {
    let mut text = String::new();
    for (nth, report) in reports.iter().enumerate() {
        let figures = figures(report);
        if nth == 0 {
            let names: Vec<_> = figures.iter().map(|(key, _)| key.as_str()).collect();
            text += &format!("seed,{}\n", names.join(","));
        }
        let cells: Vec<_> =
            figures.iter().map(|(_, value)| value.map(|number| number.to_string()).unwrap_or_default()).collect();
        text += &format!("{},{}\n", report.run.seed, cells.join(","));
    }
    text
}
