//! The command line of a study program: what this crate can do by itself. `skein` has these commands too, and all others.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use skein_core::formation::laws::Laws;

use crate::compare::{self, CompareArgs};
use crate::error::Error;
use crate::report::{self, ReportArgs};
use crate::study::{self, StudyArgs};

/// Swarms in virtual time: flown, measured, compared.
///
/// Exit status: 0 success, 1 a run that failed, 2 an argument or a file at fault.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 110)]
pub struct Cli {
    /// What to do
    #[command(subcommand)]
    pub command: Command,
}

/// What a study program can do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Fly a scenario in virtual time, many seeds at once, and measure it
    Study(StudyArgs),
    /// Judge the runs of one folder against those of another, seed by seed; exit status 1 if a figure is worse
    Compare(CompareArgs),
    /// Draw what was flown: pictures and tables on one page
    Report(ReportArgs),
}

/// A study program whose scenarios may name these laws besides those of Skein. See [`crate::law`].
pub fn main_with(laws: Laws) -> ExitCode {
    let done = laws.add().map_err(|fault| Error::Refused(fault.to_string())).and_then(|()| run(&Cli::parse().command));
    done.map_or_else(|error| error.report(), |()| ExitCode::SUCCESS)
}

fn run(command: &Command) -> Result<(), Error> {
    match command {
        Command::Study(args) => study::run(args),
        Command::Compare(args) => compare::run(args),
        Command::Report(args) => report::run(args),
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_definition_holds_together() {
        Cli::command().debug_assert();
    }
}
