//! A comparison for people.

use comfy_table::{CellAlignment, Table, presets};

use super::statistics::Estimate;
use super::verdict::{Compared, Verdict};
use super::{ComparedPoint, Comparison};
use crate::study::rounded;

/// So many commands are printed.
const COMMANDS: usize = 10;

/// Every point, and what to fly again.
pub(super) fn of(comparison: &Comparison) -> String {
    let mut text: String = comparison.points.iter().map(of_point).collect();
    text += "\nmedian [95 % interval]; effect: share of pairs in which B is notably better, less the share in which it is worse\n";
    let is_unclear = |figure: &Compared| figure.verdict == Verdict::Unclear;
    if comparison.points.iter().any(|point| point.figures.iter().any(is_unclear)) {
        text += "unclear: a verdict needs six pairs\n";
    }
    let commands = commands(comparison);
    if !commands.is_empty() {
        text += "\nWhere B lost most:\n";
    }
    commands
        .iter()
        .take(COMMANDS)
        .for_each(|(command, keys)| text += &format!("  {command}    # {}\n", keys.join(", ")));
    if commands.len() > COMMANDS {
        text += &format!("  and {} more, see --json\n", commands.len() - COMMANDS);
    }
    text
}

/// A table with this head, whose columns after the first are aligned to the right.
pub(super) fn with_head(head: [&str; 7]) -> Table {
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_header(head);
    table.column_iter_mut().skip(1).for_each(|column| column.set_cell_alignment(CellAlignment::Right));
    table
}

fn of_point(point: &ComparedPoint) -> String {
    let mut shown: Vec<&Compared> = point.figures.iter().filter(|figure| !figure.is_equal()).collect();
    shown.sort_by_key(|figure| figure.verdict);
    let mut table = with_head(["", "A", "B", "B − A", "effect", "verdict", "worst seed"]);
    for figure in &shown {
        let verdict = format!("{:?}", figure.verdict).to_lowercase();
        let seed = figure.worst_seed.map(|seed| seed.to_string()).unwrap_or_default();
        let effect = format!("{:+.2}", figure.effect.value);
        let [a, b] = [(figure.a, figure.never[0]), (figure.b, figure.never[1])].map(|(estimate, never)| {
            let never = if never == 0 { String::new() } else { format!(" {never} never") };
            interval(&estimate, "never") + &never
        });
        table.add_row([figure.key.to_owned(), a, b, interval(&figure.difference, "∞"), effect, verdict, seed]);
    }
    let name = match point.set.as_slice() {
        [] => String::new(),
        set => format!("{}, ", set.join(", ")),
    };
    let equal: Vec<&str> = point.figures.iter().filter(|figure| figure.is_equal()).map(|figure| figure.key).collect();
    let rest = if equal.is_empty() { String::new() } else { format!("equal in every pair: {}\n", equal.join(", ")) };
    let table = if shown.is_empty() { String::new() } else { format!("{table}\n") };
    format!("\n{name}{} pairs\n{table}{rest}", point.pairs)
}

/// The commands that fly again what became worse, each with the figures that it is for.
fn commands(comparison: &Comparison) -> Vec<(&str, Vec<&'static str>)> {
    let mut commands: Vec<(&str, Vec<&'static str>)> = Vec::new();
    for figure in comparison.points.iter().flat_map(|point| &point.figures) {
        let Some(replay) = figure.replay.as_deref().filter(|_| figure.verdict == Verdict::Worse) else { continue };
        match commands.iter_mut().find(|(command, _)| *command == replay) {
            Some((_, keys)) => keys.push(figure.key),
            None => commands.push((replay, vec![figure.key])),
        }
    }
    commands
}

/// The estimate with its interval, and `without` for what is not finite.
fn interval(estimate: &Estimate, without: &str) -> String {
    let Estimate { value, low, high } = *estimate;
    let [value, low, high] = [value, low, high].map(|it| if it.is_finite() { rounded(it) } else { without.to_owned() });
    if low == high { value } else { format!("{value} [{low}, {high}]") }
}
