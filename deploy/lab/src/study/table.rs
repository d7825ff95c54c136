//! A study's summary for people.

use comfy_table::{CellAlignment, Table, presets};

use super::summary::{FigureSummary, PointSummary, Summary};
use super::sweep::Point;
use crate::metrics::{Measured, Outcome, figures};

/// The figures that a reader looks for first. The table has the first [`HEADLINES`] of these that
/// the runs have.
const HEADLINE: [&str; 22] = [
    "collisions",
    "crashes",
    "law_misses",
    "fallback_share",
    "min_separation_m",
    "setpoints_reached",
    "at_altitude_s",
    "in_band_s",
    "even_10deg_s",
    "detection_s",
    "rejoin_s",
    "transient_s",
    "radial_rms_m",
    "spacing_error_deg",
    "centroid_lag_m",
    "max_centre_distance_m",
    "order",
    "band_occupancy",
    "max_tilt_deg",
    "altitude_rms_m",
    "peer_age_p99_ms",
    "duration_s",
];
const HEADLINES: usize = 12;

/// The choice of figures that a table has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Which {
    /// About a dozen that a reader looks for first.
    Headline,
    /// Every one.
    All,
}

impl Which {
    /// The keys of a table.
    fn keys<'a>(self, has: impl Fn(&str) -> bool, all: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
        match self {
            Self::Headline => HEADLINE.into_iter().filter(|key| has(key)).take(HEADLINES).collect(),
            Self::All => all.collect(),
        }
    }
}

/// The name of a figure.
fn name(key: &str) -> &'static str {
    figures::of(key).map(|figure| figure.name).unwrap_or_default()
}

/// A line for each figure over all runs.
pub(super) fn of_figures(summary: &Summary, which: Which) -> String {
    let keys = which.keys(|key| summary.contains_key(key), summary.keys().map(String::as_str));
    let has_never = keys.iter().filter_map(|key| summary.get(*key)).any(|figure| figure.never > 0);
    let mut table = Table::new();
    let never = has_never.then_some("never");
    let header = ["figure", "runs"].into_iter().chain(never).chain(["median", "quartiles", "worst", "its seed", ""]);
    table.load_style(presets::NOTHING).set_header(header);
    for key in keys {
        let Some(figure) = summary.get(key) else { continue };
        let number = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), |value| value_text(key, value));
        let quartiles = format!("{} … {}", number(figure.q1), number(figure.q3));
        let worst = match (figure.worst, figure.worst_seed) {
            (_, None) => String::new(),
            (None, Some(_)) => "never".to_owned(),
            (worst, Some(_)) => number(worst),
        };
        // Among equal runs none is the worst.
        let differs = figure.never > 0 || figure.min != figure.max;
        let seed = figure.worst_seed.filter(|_| differs).map(|seed| seed.to_string()).unwrap_or_default();
        let never = has_never.then(|| figure.never.to_string());
        let row = [key.to_owned(), figure.n.to_string()].into_iter().chain(never);
        table.add_row(row.chain([number(figure.median), quartiles, worst, seed, name(key).to_owned()]));
    }
    let between = table.column_count().saturating_sub(2);
    let columns = table.column_iter_mut().skip(1).take(between);
    columns.for_each(|column| column.set_cell_alignment(CellAlignment::Right));
    trimmed(&table)
}

/// A line for each figure of one run.
pub(super) fn of_run(run: &Measured, which: Which) -> String {
    let keys = which.keys(|key| run.outcome(key).is_some(), run.figures.keys().map(String::as_str));
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_header(["figure", "value", ""]);
    for key in keys {
        let value = match run.outcome(key) {
            Some(Outcome::Value(value)) => value_text(key, value),
            Some(Outcome::Never) => "never".to_owned(),
            None => continue,
        };
        table.add_row([key, &value, name(key)]);
    }
    if let Some(values) = table.column_mut(1) {
        values.set_cell_alignment(CellAlignment::Right);
    }
    trimmed(&table)
}

/// The table without spaces at the ends of its lines, which would wrap on a narrow terminal.
fn trimmed(table: &Table) -> String {
    table.to_string().lines().map(|line| format!("{}\n", line.trim_end())).collect()
}

/// A figure with the digits that say something; what is counted in whole numbers has no decimals.
fn value_text(key: &str, value: f64) -> String {
    let counted = ["pairs", "vehicles", "times", "steps", "messages", "bytes", "frames", "asks"];
    let is_whole = figures::of(key).is_some_and(|figure| counted.contains(&figure.unit)) && value.fract() == 0.0;
    if is_whole { format!("{value:.0}") } else { rounded(value) }
}

/// Figures that distinguish points, the most significant first; a table has the first five that are not the same in
/// every run.
const SIGNIFICANT: [&str; 9] = [
    "setpoints_reached",
    "even_10deg_s",
    "in_band_s",
    "radial_rms_m",
    "spacing_error_deg",
    "transient_s",
    "max_centre_distance_m",
    "centroid_lag_m",
    "min_separation_m",
];
const COLUMNS: usize = 5;

/// A line for each point of a sweep.
pub(super) fn of_points(points: &[Point], summaries: &[PointSummary]) -> String {
    let distinguishes = |key: &&str| {
        let figures = || summaries.iter().filter_map(|summary| summary.figures.get(*key));
        let ends = || figures().flat_map(|figure| [figure.min, figure.max]);
        figures().any(|figure| figure.never > 0) || ends().any(|end| Some(end) != ends().next())
    };
    let crash = |summary: &PointSummary| summary.figures.get("crashes").is_some_and(|figure| figure.max > Some(0.0));
    let wrecks = ["collisions"].into_iter().chain(summaries.iter().any(crash).then_some("crashes"));
    let columns = SIGNIFICANT.into_iter().filter(distinguishes).take(COLUMNS).chain(wrecks);
    let columns: Vec<&str> = columns.collect();
    let swept = points.first().map(names).unwrap_or_default();
    let header = ["point".to_owned()].into_iter().chain(swept).chain(["runs".to_owned()]);
    let header = header.chain(columns.iter().map(|key| (*key).to_owned())).chain(["worst seed".to_owned()]);
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_header(header);
    for (point, summary) in points.iter().zip(summaries) {
        // A value typed by the operator is short; a sampled one has all its digits.
        let short =
            |value: &String| value.parse().ok().filter(|_| value.len() > 8).map_or_else(|| value.clone(), rounded);
        let set = point.0.iter().map(|(_, value)| short(value));
        let runs = summary.figures.values().map(|figure| figure.n).max().unwrap_or(0);
        let cell = |key: &&str| summary.figures.get(*key).map(|figure| median_and_worst(key, figure));
        let cells = columns.iter().map(|key| cell(key).unwrap_or_default());
        let row = [summary.point.to_string()].into_iter().chain(set).chain([runs.to_string()]);
        table.add_row(row.chain(cells).chain([summary.worst_seed.to_string()]));
    }
    table.column_iter_mut().for_each(|column| column.set_cell_alignment(CellAlignment::Right));
    format!("{}median [worst] of the runs at each point\n", trimmed(&table))
}

/// The swept keys, shortened as far as they stay distinct.
fn names(point: &Point) -> Vec<String> {
    let short = |key: &str| key.rsplit_once('.').map_or(key, |(_, name)| name).to_owned();
    let names: Vec<String> = point.0.iter().map(|(key, _)| short(key)).collect();
    let is_clear = |name: &String| names.iter().filter(|other| *other == name).count() == 1;
    let keys = point.0.iter().map(|(key, _)| key);
    keys.zip(&names).map(|(key, name)| if is_clear(name) { name.clone() } else { key.clone() }).collect()
}

/// The median of a figure with its worst value, or with the number of runs in which it never came.
pub(crate) fn median_and_worst(key: &str, figure: &FigureSummary) -> String {
    let median = figure.median.map_or_else(|| "never".to_owned(), |value| value_text(key, value));
    match figure.worst.or(figure.max).filter(|_| figure.never == 0) {
        Some(worst) => format!("{median} [{}]", value_text(key, worst)),
        None => format!("{median} [{} never]", figure.never),
    }
}

/// The digits that say something.
pub fn rounded(value: f64) -> String {
    match value.abs() {
        size if size >= 1000.0 => format!("{value:.0}"),
        size if size >= 100.0 => format!("{value:.1}"),
        size if size >= 1.0 => format!("{value:.2}"),
        0.0 => "0".to_owned(),
        size if size >= 0.001 => format!("{value:.3}"),
        _ => format!("{value:.1e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::summary::by_point;
    use super::*;

    #[test]
    fn figures_are_cut_to_what_they_say() {
        let cases = [
            (123_456.7, "123457"),
            (142.56, "142.6"),
            (0.797_33, "0.797"),
            (0.0, "0"),
            (-3.456, "-3.46"),
            (1.23e-5, "1.2e-5"),
        ];
        for (value, text) in cases {
            assert_eq!(rounded(value), text);
        }
    }

    #[test]
    fn one_run_has_plain_values_and_several_have_quartiles() {
        let run = |seed: u64| {
            let text = format!(
                "{{\"seed\":{seed},\"collisions\":0,\"energy_j\":5,\"max_tilt_deg\":{seed}.5,\"in_band_s\":null,\"never\":[\"in_band_s\"]}}"
            );
            Measured::read(&text).unwrap()
        };
        let plain = of_run(&run(3), Which::Headline);
        let rows: Vec<Vec<&str>> = plain.lines().map(|line| line.split_whitespace().take(2).collect()).collect();
        assert_eq!(
            rows,
            [["figure", "value"], ["collisions", "0"], ["in_band_s", "never"], ["max_tilt_deg", "3.50"]],
            "{plain}"
        );
        assert!(of_run(&run(3), Which::All).contains("energy_j"));
        let table = of_figures(&super::super::summary::summary(&[run(1), run(2)]), Which::Headline);
        assert!(table.contains("quartiles") && table.contains("its seed") && !table.contains("energy_j"), "{table}");
        assert!(table.lines().any(|line| line.contains("in_band_s") && line.contains("never")), "{table}");
        assert!(table.lines().all(|line| line.chars().count() <= 110), "{table}");
    }

    #[test]
    fn crashes_are_shown_where_there_are_some() {
        let points = ["0", "0.5"].map(|loss| Point(vec![("network.loss".to_owned(), loss.to_owned())]));
        let table = |crashes: u64| {
            let run = |crashes| format!("{{\"seed\":1,\"collisions\":0,\"crashes\":{crashes}}}");
            let runs = [0, crashes].map(|crashes| Measured::read(&run(crashes)).unwrap());
            of_points(&points, &by_point(&points, &runs))
        };
        assert!(!table(0).contains("crashes"));
        assert!(table(3).contains("crashes") && table(3).contains("3 [3]"), "{}", table(3));
    }

    #[test]
    fn keys_are_shortened_as_long_as_they_differ() {
        let point = |keys: &[&str]| Point(keys.iter().map(|key| ((*key).to_owned(), "1".to_owned())).collect());
        assert_eq!(names(&point(&["network.loss", "preset"])), ["loss", "preset"]);
        let alike = ["vehicle.1.aircraft", "vehicle.2.aircraft", "seed"];
        assert_eq!(names(&point(&alike)), alike);
    }
}
