//! A study's summary for people.

use comfy_table::{CellAlignment, Table, presets};

use super::summary::{Figure, PointSummary, Summary};
use super::sweep::Point;

/// A line for each figure.
pub(super) fn of_figures(summary: &Summary) -> String {
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_header(["", "runs", "never", "median", "quartiles", "worst", "seed"]);
    let number = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), rounded);
    for (key, figure) in summary {
        let quartiles = format!("{} … {}", number(figure.q1), number(figure.q3));
        let worst = if figure.worst_seed.is_some() { number(figure.worst) } else { String::new() };
        let seed = figure.worst_seed.map(|seed| seed.to_string()).unwrap_or_default();
        let (n, never) = (figure.n.to_string(), figure.never.to_string());
        table.add_row([key.clone(), n, never, number(figure.median), quartiles, worst, seed]);
    }
    table.column_iter_mut().skip(1).for_each(|column| column.set_cell_alignment(CellAlignment::Right));
    format!("{table}\n")
}

/// Figures that tell one point from another, the most telling first; a table has the first five that are not the same in
/// every run.
const TELLING: [&str; 9] = [
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
    let told = |key: &&str| {
        let figures = || summaries.iter().filter_map(|summary| summary.figures.get(*key));
        let ends = || figures().flat_map(|figure| [figure.min, figure.max]);
        figures().any(|figure| figure.never > 0) || ends().any(|end| Some(end) != ends().next())
    };
    let crash = |summary: &PointSummary| summary.figures.get("crashes").is_some_and(|figure| figure.max > Some(0.0));
    let wrecks = ["collisions"].into_iter().chain(summaries.iter().any(crash).then_some("crashes"));
    let telling = TELLING.into_iter().filter(told).take(COLUMNS).chain(wrecks);
    let telling: Vec<&str> = telling.collect();
    let swept = points.first().map(names).unwrap_or_default();
    let header = ["point".to_owned()].into_iter().chain(swept).chain(["runs".to_owned()]);
    let header = header.chain(telling.iter().map(|key| (*key).to_owned())).chain(["worst seed".to_owned()]);
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_header(header);
    for (point, summary) in points.iter().zip(summaries) {
        // What somebody typed is short; what was sampled has all its digits.
        let short =
            |value: &String| value.parse().ok().filter(|_| value.len() > 8).map_or_else(|| value.clone(), rounded);
        let set = point.0.iter().map(|(_, value)| short(value));
        let runs = summary.figures.values().map(|figure| figure.n).max().unwrap_or(0);
        let cells = telling.iter().map(|key| summary.figures.get(*key).map(median_and_worst).unwrap_or_default());
        let row = [summary.point.to_string()].into_iter().chain(set).chain([runs.to_string()]);
        table.add_row(row.chain(cells).chain([summary.worst_seed.to_string()]));
    }
    table.column_iter_mut().for_each(|column| column.set_cell_alignment(CellAlignment::Right));
    format!("{table}\nmedian [worst] of the runs at each point\n")
}

/// The swept keys as short as they can be told apart.
fn names(point: &Point) -> Vec<String> {
    let short = |key: &str| key.rsplit_once('.').map_or(key, |(_, name)| name).to_owned();
    let names: Vec<String> = point.0.iter().map(|(key, _)| short(key)).collect();
    let is_clear = |name: &String| names.iter().filter(|other| *other == name).count() == 1;
    let keys = point.0.iter().map(|(key, _)| key);
    keys.zip(&names).map(|(key, name)| if is_clear(name) { name.clone() } else { key.clone() }).collect()
}

fn median_and_worst(figure: &Figure) -> String {
    let median = figure.median.map_or_else(|| "never".to_owned(), rounded);
    match figure.worst.filter(|_| figure.never == 0) {
        Some(worst) => format!("{median} [{}]", rounded(worst)),
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
    use super::super::measured::Measured;
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
    fn crashes_are_shown_where_there_are_some() {
        let points = ["0", "0.5"].map(|loss| Point(vec![("network.loss".to_owned(), loss.to_owned())]));
        let table = |crashes: u64| {
            let run = |crashes| format!("{{\"seed\":1,\"collisions\":0,\"crashes\":{crashes}}}");
            let runs = [0, crashes].map(|crashes| Measured::read(&run(crashes)).unwrap());
            of_points(&points, &by_point(&points, &runs))
        };
        assert!(!table(0).contains("crashes"));
        assert!(table(3).contains("crashes") && table(3).contains("3.00 [3.00]"), "{}", table(3));
    }

    #[test]
    fn keys_are_shortened_as_long_as_they_differ() {
        let point = |keys: &[&str]| Point(keys.iter().map(|key| ((*key).to_owned(), "1".to_owned())).collect());
        assert_eq!(names(&point(&["network.loss", "preset"])), ["loss", "preset"]);
        let alike = ["vehicle.1.aircraft", "vehicle.2.aircraft", "seed"];
        assert_eq!(names(&point(&alike)), alike);
    }
}
