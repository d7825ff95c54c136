//! Tables of figures, each figure with its definition from [`figures`].

use super::page::Part;
use crate::metrics::{Measured, Outcome, figures};
use crate::study::{FigureSummary, Summary, rounded};

/// A value, or a dash.
pub(super) fn number(value: Option<f64>) -> String {
    value.map_or_else(|| "–".to_owned(), rounded)
}

/// Unit and definition of a figure.
fn defined(key: &str) -> [String; 2] {
    figures::of(key).map_or_else(Default::default, |figure| [figure.unit.to_owned(), plain(figure.meaning)])
}

/// A definition without the marks of Markdown.
fn plain(meaning: &str) -> String {
    meaning.replace('`', "")
}

fn head<const N: usize>(titles: [&str; N]) -> Vec<String> {
    titles.map(str::to_owned).to_vec()
}

/// A table with a row for each figure of one run.
pub(super) fn of_run(run: &Measured) -> Part {
    let row = |key: &String| {
        let value = match run.outcome(key)? {
            Outcome::Value(value) => rounded(value),
            Outcome::Never => "never".to_owned(),
        };
        let [unit, meaning] = defined(key);
        Some(vec![key.clone(), value, unit, meaning])
    };
    let caption = "The figures of this run. A figure that does not apply to it is left out.".to_owned();
    let rows = run.figures.keys().filter_map(row).collect();
    Part::Table { caption, head: head(["figure", "value", "unit", "definition"]), rows }
}

/// A table with a row for each of these figures over several runs.
pub(super) fn of_runs<'a>(caption: String, summary: &Summary, keys: impl Iterator<Item = &'a str>) -> Part {
    let row = |key: &str| {
        let figure: &FigureSummary = summary.get(key)?;
        let quartiles = format!("{} … {}", number(figure.q1), number(figure.q3));
        let worst = if figure.worst_seed.is_some() { number(figure.worst) } else { String::new() };
        let seed = figure.worst_seed.map(|seed| seed.to_string()).unwrap_or_default();
        let (n, never) = (figure.n.to_string(), figure.never.to_string());
        let [unit, meaning] = defined(key);
        Some(vec![key.to_owned(), n, never, number(figure.median), quartiles, worst, seed, unit, meaning])
    };
    let titles = ["figure", "runs", "never", "median", "quartiles", "worst", "its seed", "unit", "definition"];
    Part::Table { caption, head: head(titles), rows: keys.filter_map(row).collect() }
}

/// A table that defines these figures.
pub(super) fn definitions<'a>(keys: impl Iterator<Item = &'a str>) -> Part {
    let row = |key: &str| {
        let figure = figures::of(key)?;
        Some([key, figure.unit, figure.worse_is(), &plain(figure.meaning)].map(str::to_owned).to_vec())
    };
    let caption = "What the figures mean.".to_owned();
    Part::Table { caption, head: head(["figure", "unit", "worse", "definition"]), rows: keys.filter_map(row).collect() }
}
