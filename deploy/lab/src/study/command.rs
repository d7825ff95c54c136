//! The command `skein study` and its options.

use std::num::NonZeroUsize;
use std::ops::Range;
use std::path::PathBuf;
use std::time::Duration;

use super::plan::Plan;
use super::planned::{FlownStudy, fly_planned};
use super::progress::Shown;
use super::sweep::Sweep;
use super::{summary, table, verdict};
use crate::error::Error;
use crate::metrics::Measured;
use crate::scenario::{ScenarioArgs, quoted};
use crate::terminal::{say, what_next};

/// `skein study`
#[derive(Clone, Debug, Default, clap::Args)]
#[command(
    after_help = "Examples:\n  skein study --seeds 0..20 --out my-study\n  skein study --seed 3 --set duration_s=100 --all\n  skein study --seeds 0..10 --sweep network.loss=0,0.1,0.3"
)]
pub struct StudyArgs {
    /// The scenario.
    #[command(flatten)]
    pub scenario: ScenarioArgs,
    /// One seed; without it the scenario's own
    #[arg(long, value_name = "N", conflicts_with = "seeds", value_parser = seed, allow_negative_numbers = true)]
    pub seed: Option<u64>,
    /// Seeds A to B, B not included
    #[arg(long, value_name = "A..B", value_parser = seeds)]
    pub seeds: Option<Range<u64>>,
    /// Any scenario key at each of several values, such as network.loss=0,0.1,0.3; several sweeps span a grid. A range
    /// LO..HI, or LO..HI:log, both ends included, is sampled instead, see --points
    #[arg(long = "sweep", value_name = "KEY=V1,V2,...")]
    pub sweep: Vec<Sweep>,
    /// Points of a Latin hypercube over all swept ranges, at each point of the grid if there is one. The scenario's own
    /// seed selects them (--set seed=N gives others)
    #[arg(long, value_name = "N", value_parser = samples)]
    pub points: Option<usize>,
    /// Runs at once; without it one for each core, or for each --threads cores. The results do not depend on it
    #[arg(long, value_name = "N", value_parser = at_least_one, allow_negative_numbers = true)]
    pub jobs: Option<NonZeroUsize>,
    /// Threads that step each run; without it a fleet takes the cores that no other run uses. The results do not depend
    /// on it
    #[arg(long, value_name = "N", value_parser = at_least_one, allow_negative_numbers = true)]
    pub threads: Option<NonZeroUsize>,
    /// Longest silence of an external law, seconds of wall clock, or none: a law with a breakpoint does not end the study. Without
    /// it 10, and 60 until its first line
    #[arg(long, value_name = "S|none", value_parser = law_timeout)]
    pub law_timeout: Option<Duration>,
    /// Folder for the results, new or empty, or that of the very same study, interrupted: the study resumes there.
    /// Without it a new one in skein-runs
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write no recordings, whatever record.runs is set to
    #[arg(long)]
    pub no_record: bool,
    /// Print every figure that was measured, not only about a dozen
    #[arg(long, conflicts_with = "json")]
    pub all: bool,
    /// Print the summary (of one seed: its figures) as JSON on stdout, everything else on stderr
    #[arg(long)]
    pub json: bool,
}

/// `A..B`, half open and not empty.
fn seeds(text: &str) -> Result<Range<u64>, String> {
    let range = text.split_once("..").and_then(|(from, to)| Some(from.parse().ok()?..to.parse().ok()?));
    range.filter(|range| !range.is_empty()).ok_or_else(|| "two numbers A..B with A below B, such as 0..20".to_owned())
}

/// A seed.
///
/// # Errors
/// If it is not a whole number from 0.
pub fn seed(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| "a whole number from 0 on".to_owned())
}

fn at_least_one(text: &str) -> Result<NonZeroUsize, String> {
    text.parse().map_err(|_| "a whole number, at least 1".to_owned())
}

/// Seconds, or `none` for a time that no study reaches.
fn law_timeout(text: &str) -> Result<Duration, String> {
    const YEAR_S: f64 = 3.2e7;
    let seconds = if text == "none" { Some(YEAR_S) } else { text.parse().ok().filter(|s| (1.0..=YEAR_S).contains(s)) };
    seconds.map(Duration::from_secs_f64).ok_or_else(|| "seconds, at least 1, or none".to_owned())
}

/// At least one.
fn samples(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|&n| n > 0).ok_or_else(|| "a number of points, at least 1".to_owned())
}

/// Flies what is not there yet, writes what was measured, prints the summary.
///
/// # Errors
/// The reason against the study: nothing was flown then. Or a run that failed; those that were done are written.
pub fn run(args: &StudyArgs) -> Result<(), Error> {
    let plan = Plan::new(args)?;
    let FlownStudy { runs, recorded } = fly_planned(&plan, !args.no_record, &Shown::default())?;
    let which = if args.all { table::Which::All } else { table::Which::Headline };
    let output = match (args.sweep.is_empty(), runs.as_slice()) {
        (true, [run]) => table::of_run(run, which),
        (true, runs) => table::of_figures(&summary(runs), which),
        (false, runs) => {
            let summaries = summary::by_point(&plan.points, runs);
            let mut output = table::of_points(&plan.points, &summaries);
            for (point, summary) in plan.points.iter().zip(&summaries).filter(|_| args.all) {
                output +=
                    &format!("\npoint {}: {point}\n{}", summary.point, table::of_figures(&summary.figures, which));
            }
            output
        }
    };
    match runs.as_slice() {
        _ if !args.json => say(&format!("{}\n{output}", verdict::verdict(&args.scenario, &plan.points, &runs))),
        [_] if args.sweep.is_empty() => say(&plan.run(0).text()?),
        _ => say(&plan.summary()?),
    }
    let out = plan.out.display().to_string();
    eprintln!("written to {out}");
    if !args.json {
        if !args.all {
            eprintln!("summary.json and runs.csv in it have every figure; --all prints them");
        }
        eprint!("{}", next(&out, args, &runs));
    }
    recorded.map_err(|error| {
        Error::Failed(format!("{error}; the figures are complete, and the same command continues with the recordings"))
    })
}

/// The commands to run next on a study in this folder.
fn next(out: &str, args: &StudyArgs, runs: &[Measured]) -> String {
    let out = quoted(out);
    let mut lines = vec![(format!("skein report {out}"), "pictures and tables on one page")];
    match runs {
        [run] if args.sweep.is_empty() => {
            lines.push((args.scenario.command("fly", &[], Some(run.seed)), "the same flight in real time"));
        }
        _ => lines.push((format!("skein compare {out} OTHER"), "against another study's folder, seed by seed")),
    }
    what_next(&lines)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_law_timeout_is_a_number_of_seconds_or_none() {
        assert_eq!(law_timeout("2.5"), Ok(Duration::from_millis(2500)));
        assert!(law_timeout("none").unwrap() > Duration::from_secs(30_000_000));
        for bad in ["0", "-1", "nan", "inf", "never"] {
            assert!(law_timeout(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn seeds_are_half_open() {
        assert_eq!(seeds("0..100"), Ok(0..100));
        for bad in ["5..5", "7..3", "1..", "..4", "a..b", "3"] {
            assert!(seeds(bad).is_err(), "{bad}");
        }
    }
}
