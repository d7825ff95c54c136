//! `skein study` as it is typed.

use std::num::NonZeroUsize;
use std::ops::Range;
use std::path::PathBuf;
use std::thread;

use comfy_table::{CellAlignment, Table, presets};

use super::{Study, Summary, progress, summarize, write};
use crate::error::Error;
use crate::scenario::ScenarioArgs;
use crate::{json, out, say};

/// `skein study`
#[derive(Clone, Debug, clap::Args)]
pub struct StudyArgs {
    /// The scenario.
    #[command(flatten)]
    pub scenario: ScenarioArgs,
    /// One seed; without it the scenario's own
    #[arg(long, value_name = "N", conflicts_with = "seeds")]
    pub seed: Option<u64>,
    /// Seeds A to B, B not included
    #[arg(long, value_name = "A..B", value_parser = seeds)]
    pub seeds: Option<Range<u64>>,
    /// Runs at once; without it one for each core. The results do not depend on it
    #[arg(long, value_name = "N")]
    pub jobs: Option<NonZeroUsize>,
    /// Folder for what is written, new or empty; without it a new one in skein-runs
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write no recordings. There are none yet: without effect
    #[arg(long)]
    pub no_record: bool,
    /// Print the summary (of one seed: its figures) as JSON on stdout, everything else on stderr
    #[arg(long)]
    pub json: bool,
}

/// `A..B`, half open and not empty.
fn seeds(text: &str) -> Result<Range<u64>, String> {
    let range = text.split_once("..").and_then(|(from, to)| Some(from.parse().ok()?..to.parse().ok()?));
    range.filter(|range| !range.is_empty()).ok_or_else(|| "two numbers A..B with A below B".to_owned())
}

/// Flies the seeds, writes what they measured, prints the summary.
///
/// # Errors
/// What stands against the study: nothing was written then.
pub fn run(args: &StudyArgs) -> Result<(), Error> {
    let loaded = args.scenario.read(Vec::new())?;
    loaded.notes.iter().for_each(|note| eprintln!("{note}"));
    let ready = args.scenario.ready(&loaded.scenario)?;
    let out = out::folder(args.out.as_deref(), &format!("{}-study", loaded.scenario.name))?;
    let own = args.seed.unwrap_or(loaded.scenario.seed);
    let seeds = args.seeds.clone().unwrap_or(own..own + 1);
    let jobs = args.jobs.or_else(|| thread::available_parallelism().ok()).unwrap_or(NonZeroUsize::MIN);

    let study = Study { scenario: loaded.scenario, aircraft: ready.aircraft, rules: ready.rules };
    let bar = progress(seeds.end - seeds.start);
    let reports = study
        .fly_all(seeds, jobs, |_| bar.inc(1))
        .map_err(|error| Error::Refused(format!("{}: {error}", args.scenario.name())))?;
    bar.finish_and_clear();
    let as_flown = |seed| args.scenario.read(vec![format!("seed={seed}")]).map(|loaded| loaded.to_toml());
    write(&out, as_flown, &reports)?;

    let summary = summarize(&reports);
    match reports.as_slice() {
        _ if !args.json => say(&table(&summary)),
        [report] => say(&json(report)),
        _ => say(&json(&summary)),
    }
    eprintln!("written to {}", out.display());
    Ok(())
}

/// The summary for people.
fn table(summary: &Summary) -> String {
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

/// The digits that say something.
fn rounded(value: f64) -> String {
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
    use super::*;

    #[test]
    fn seeds_are_half_open() {
        assert_eq!(seeds("0..100"), Ok(0..100));
        for bad in ["5..5", "7..3", "1..", "..4", "a..b", "3"] {
            assert!(seeds(bad).is_err(), "{bad}");
        }
    }

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
}
