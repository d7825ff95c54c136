//! The command line of a study program: what this crate can do by itself. `skein` has these commands too, and all others.

use std::process::ExitCode;

use clap::builder::StyledStr;
use clap::error::{ContextKind, ContextValue};
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
    let done =
        laws.add().map_err(|fault| Error::Refused(fault.to_string())).and_then(|()| run(&parsed::<Cli>().command));
    done.map_or_else(|error| error.report(), |()| ExitCode::SUCCESS)
}

/// The arguments of this process. If they are at fault it ends with exit status 2, without suggestions that mislead.
pub fn parsed<T: Parser>() -> T {
    T::try_parse().unwrap_or_else(|error| amended(error).exit())
}

/// An error without what would mislead: that an unknown option may be passed as a value, because no command takes such values;
/// and that an order to land or abort may have been meant, because a suggestion that is followed unread must not end a flight.
fn amended(mut error: clap::Error) -> clap::Error {
    if let Some(ContextValue::StyledStrs(tips)) = error.remove(ContextKind::Suggested) {
        let helps = |tip: &StyledStr| !tip.to_string().contains("as a value, use");
        let tips: Vec<StyledStr> = tips.into_iter().filter(helps).collect();
        if !tips.is_empty() {
            error.insert(ContextKind::Suggested, ContextValue::StyledStrs(tips));
        }
    }
    if let Some(ContextValue::Strings(names)) = error.remove(ContextKind::SuggestedSubcommand) {
        let names: Vec<String> = names.into_iter().filter(|name| !["land", "abort"].contains(&name.as_str())).collect();
        if !names.is_empty() {
            error.insert(ContextKind::SuggestedSubcommand, ContextValue::Strings(names));
        }
    }
    error
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

    #[derive(Debug, Parser)]
    struct Orders {
        #[command(subcommand)]
        _order: Order,
    }

    #[derive(Debug, Subcommand)]
    enum Order {
        Land,
        Hold,
    }

    #[test]
    fn tips_that_mislead_are_left_out() {
        let said = |arguments: &[&str]| amended(Cli::try_parse_from(arguments).unwrap_err()).to_string();
        let unknown = said(&["lab", "compare", "a", "b", "--vebrose"]);
        assert!(unknown.contains("--vebrose") && !unknown.contains("as a value"), "{unknown}");
        let near = said(&["lab", "compare", "a", "b", "--onyl", "x"]);
        assert!(near.contains("--only") && !near.contains("as a value"), "{near}");
        let order = |word: &str| amended(Orders::try_parse_from(["orders", word]).unwrap_err()).to_string();
        assert!(order("hodl").contains("'hold'"), "{}", order("hodl"));
        assert!(!order("lnad").contains("'land'"), "{}", order("lnad"));
    }
}
