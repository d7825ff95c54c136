//! Many runs in one table, and in one line a figure.

use std::collections::BTreeMap;

use serde::Serialize;
use serde_json::{Map, Value};

use super::sweep::Point;
use crate::metrics::{Direction, Measured, Report, is_worse, worst_and_median};
use skein_common::statistics::quantile;

/// One figure over all seeds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FigureSummary {
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
pub type Summary = BTreeMap<String, FigureSummary>;

/// Medians, quartiles and the worst of each figure.
pub fn summarize(reports: &[Report]) -> Summary {
    summary(&reports.iter().map(Measured::of).collect::<Vec<_>>())
}

/// Medians, quartiles and the worst of each figure of runs read back.
pub fn summary(runs: &[Measured]) -> Summary {
    let mut columns: BTreeMap<&str, Vec<(u64, Option<f64>)>> = BTreeMap::new();
    for run in runs {
        for (key, value) in &run.figures {
            if value.is_some() || run.never.contains(key) {
                columns.entry(key).or_default().push((run.seed, *value));
            }
        }
    }
    columns.into_iter().map(|(key, column)| (key.to_owned(), figure(key, &column))).collect()
}

/// One point of a sweep over all seeds.
#[derive(Clone, Debug, Serialize)]
pub struct PointSummary {
    /// Counted from 1, as its folder is.
    pub point: usize,
    /// The keys that are set there.
    pub set: Map<String, Value>,
    /// The seed of the worst run, and of the middle one.
    pub worst_seed: u64,
    /// See `worst_seed`.
    pub median_seed: u64,
    /// Every figure over all seeds.
    pub figures: Summary,
}

/// The points of a sweep; `runs` are those of the first point, then those of the next.
pub(super) fn by_point(points: &[Point], runs: &[Measured]) -> Vec<PointSummary> {
    let of_each = runs.chunks(runs.len() / points.len().max(1)).zip(points).enumerate();
    let summary = |(nth, (runs, point)): (usize, (&[Measured], &Point))| {
        let (worst_seed, median_seed) = worst_and_median(runs)?;
        let set = point.0.iter().map(|(key, value)| (key.clone(), as_json(value))).collect();
        Some(PointSummary { point: nth + 1, set, worst_seed, median_seed, figures: summary(runs) })
    };
    of_each.filter_map(summary).collect()
}

/// A value as `--set` takes it: TOML, or else a text.
fn as_json(value: &str) -> Value {
    let parsed = value.parse::<toml::Value>().ok().and_then(|value| serde_json::to_value(value).ok());
    parsed.unwrap_or_else(|| Value::String(value.to_owned()))
}

fn figure(key: &str, column: &[(u64, Option<f64>)]) -> FigureSummary {
    let direction = is_worse(key);
    // From best to worst; without a direction, from least to largest. What never happened stands last.
    let sign = if direction == Some(Direction::Less) { -1.0 } else { 1.0 };
    let mut ranked = column.to_vec();
    let rank = |value: Option<f64>| value.map_or(f64::INFINITY, |value| sign * value);
    ranked.sort_by(|one, other| rank(one.1).total_cmp(&rank(other.1)));
    let at = |share: f64| {
        let mut ranks: Vec<f64> = ranked.iter().map(|(_, value)| rank(*value)).collect();
        // What never happened in as many runs has no value.
        // Adding zero turns -0.0 into 0.0.
        quantile(&mut ranks, share).filter(|rank| rank.is_finite()).map(|rank| sign * rank + 0.0)
    };
    let (first, third) = if sign < 0.0 { (0.75, 0.25) } else { (0.25, 0.75) };
    let values = || column.iter().filter_map(|(_, value)| *value);
    let worst = ranked.last().filter(|_| direction.is_some());
    FigureSummary {
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

/// The text of a run, and the column of `runs.csv`, with the reason why a flight in real time failed.
pub(super) const FAILURE: &str = "failure";

/// One row a run: the seed, what is set at its point, then every figure; an unmeasured figure is empty. If a run failed,
/// the reasons are the last column.
pub(super) fn csv(points: &[Point], runs: &[Measured]) -> String {
    let first = runs.iter().find(|run| !run.figures.is_empty()).or(runs.first());
    let (Some(first), Some(point)) = (first, points.first()) else { return String::new() };
    let swept = point.0.iter().map(|(key, _)| key.as_str());
    let has_failed = runs.iter().any(|run| run.texts.contains_key(FAILURE));
    let names = ["seed"].into_iter().chain(swept).chain(first.figures.keys().map(String::as_str));
    let names = names.chain(has_failed.then_some(FAILURE));
    let mut table = csv::Writer::from_writer(Vec::new());
    let mut written = table.write_record(names);
    for (nth, run) in runs.iter().enumerate() {
        let set = points[nth * points.len() / runs.len()].0.iter().map(|(_, value)| value.clone());
        let cell = |key| run.value(key).map(|number| number.to_string()).unwrap_or_default();
        let figures = first.figures.keys().map(|key| cell(key));
        let failure = has_failed.then(|| run.texts.get(FAILURE).cloned().unwrap_or_default());
        let row = [run.seed.to_string()].into_iter().chain(set).chain(figures).chain(failure);
        written = written.and_then(|()| table.write_record(row));
    }
    // Memory takes everything, every row has as many cells as the first, and numbers and TOML are UTF-8.
    let text = written.ok().and_then(|()| String::from_utf8(table.into_inner().ok()?).ok());
    text.unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_middle_of_zeros_is_zero_without_a_sign() {
        let zeros = [(1, Some(0.0)), (2, Some(0.0)), (3, Some(0.0))];
        for key in ["setpoints_reached", "collisions"] {
            let FigureSummary { q1, median, q3, .. } = figure(key, &zeros);
            assert_eq!([q1, median, q3].map(|value| value.map(f64::to_bits)), [Some(0); 3], "{key}");
        }
    }

    #[test]
    fn a_swept_value_has_a_cell_and_a_column_of_its_own() {
        let run = |seed| Measured::read(&format!("{{\"seed\":{seed},\"a_m\":0.5,\"b_s\":null}}")).unwrap();
        let point = |loss: &str| {
            let set = [("network.loss", loss), ("mission.steps[0]", "{ a = [1, \"x\"] }")];
            Point(set.map(|(key, value)| (key.to_owned(), value.to_owned())).to_vec())
        };
        let (points, runs) = ([point("0"), point("0.10")], [run(7), run(8), run(7), run(8)]);
        let cell = "\"{ a = [1, \"\"x\"\"] }\"";
        assert_eq!(
            csv(&points, &runs),
            format!(
                "seed,network.loss,mission.steps[0],a_m,b_s\n7,0,{cell},0.5,\n8,0,{cell},0.5,\n7,0.10,{cell},0.5,\n8,0.10,{cell},0.5,\n"
            )
        );
        let summaries = by_point(&points, &runs);
        assert_eq!((summaries.len(), summaries[1].point, summaries[1].worst_seed), (2, 2, 8));
        assert_eq!(summaries[1].set["network.loss"], serde_json::json!(0.1));
        assert_eq!(summaries[1].set["mission.steps[0]"], serde_json::json!({ "a": [1, "x"] }));
        assert_eq!(as_json("paper"), Value::String("paper".to_owned()));
    }

    proptest! {
        #[test]
        fn quartiles_are_between_the_best_and_the_worst(values in prop::collection::vec(prop::option::weighted(0.8, -1e3..1e3), 1..30)) {
            let column: Vec<_> = values.iter().copied().enumerate().map(|(seed, value)| (seed as u64, value)).collect();
            for key in ["in_band_s", "min_separation_m", "duration_s"] {
                let it = figure(key, &column);
                prop_assert_eq!((it.n, it.never), (values.len(), values.iter().filter(|value| value.is_none()).count()));
                let known: Vec<f64> = [it.min, it.q1, it.median, it.q3, it.max].into_iter().flatten().collect();
                prop_assert!(known.is_sorted(), "{} of {:?}", key, values);
                prop_assert_eq!(it.worst.is_none(), it.never > 0 || key == "duration_s");
            }
        }

        #[test]
        fn a_table_has_a_row_for_each_run_that_reads_back(figures in prop::collection::vec(prop::option::of(-1e9..1e9), 1..12)) {
            let run = |(seed, value): (usize, &Option<f64>)| {
                let figures = [("a_m".to_owned(), *value)].into();
                Measured { seed: seed as u64, figures, ..Measured::default() }
            };
            let runs: Vec<Measured> = figures.iter().enumerate().map(run).collect();
            let text = csv(&[Point::default()], &runs);
            let mut table = csv::Reader::from_reader(text.as_bytes());
            let rows: Vec<(u64, Option<f64>)> = table.deserialize().map(Result::unwrap).collect();
            prop_assert_eq!(rows, runs.iter().map(|run| (run.seed, run.value("a_m"))).collect::<Vec<_>>());
        }
    }
}
