//! The command line of a study program: what this crate can do by itself. `skein` has these commands too, and all others.

use std::ffi::OsString;
use std::process::ExitCode;

use clap::builder::StyledStr;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Parser, Subcommand};
use skein_common::scenario::NEVER_SUGGESTED;
use skein_core::formation::laws::Laws;

use crate::compare::{self, CompareArgs};
use crate::error::Error;
use crate::report::{self, ReportArgs};
use crate::study::{self, StudyArgs};
use crate::terminal::{lost, note};

/// Swarms in virtual time: flown, measured, compared.
///
/// Exit status: 0 success, 1 a run that failed, 2 an argument or a file at fault.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 110)]
pub struct Cli {
    /// The command
    #[command(subcommand)]
    pub command: Command,
}

/// The commands of a study program.
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
    let done = laws
        .add()
        .map_err(|fault| Error::Refused(fault.to_string()))
        .and_then(|()| run(&parsed::<Cli>(std::env::args_os()).command));
    finish(done)
}

/// Ends a command: its exit status, which is 1 instead of 0 if something that it printed did not reach stdout. Then the reason
/// stands on stderr. A closed pipe (`| head`) is no error.
pub fn finish(done: Result<(), Error>) -> ExitCode {
    done.and_then(|()| printed()).map_or_else(|error| error.report(), |()| ExitCode::SUCCESS)
}

/// Checks that everything which a command printed has reached stdout.
fn printed() -> Result<(), Error> {
    match lost() {
        Some(why) => {
            Err(Error::Failed(format!("standard output: {why}; what was printed is incomplete, send it elsewhere")))
        }
        None => Ok(()),
    }
}

/// Parses the arguments of this process, the first of which is its name. If they are wrong, the process ends with exit status 2
/// and [`parse_from`]'s message; a help that cannot be printed ends it with 1.
pub fn parsed<T: Parser>(arguments: impl IntoIterator<Item = OsString>) -> T {
    parse_from(arguments).unwrap_or_else(|error| {
        if error.use_stderr() {
            error.exit();
        }
        note(error.print());
        let printed = printed();
        let status = printed.as_ref().map_or_else(Error::exit_code, |()| 0);
        printed.map_err(|error| error.report()).ok();
        std::process::exit(status.into())
    })
}

/// Parses these arguments, the first of which is the program's name.
///
/// # Errors
/// If the arguments are wrong, without suggestions that mislead: clap's advice to pass an unknown option as a value, because no
/// command takes such values; and any command that lands or aborts the swarm, because a user who accepts a suggestion without
/// reading it must not end the flight. Where no command is suggested, all of them are listed instead. A request for the help or the version is returned as an error too.
pub fn parse_from<T: Parser>(
    arguments: impl IntoIterator<Item = impl Into<OsString> + Clone>,
) -> Result<T, clap::Error> {
    let arguments: Vec<OsString> = arguments.into_iter().map(Into::into).collect();
    T::try_parse_from(&arguments).map_err(|mut error| {
        if let Some(ContextValue::StyledStrs(tips)) = error.remove(ContextKind::Suggested) {
            let helps = |tip: &StyledStr| !tip.to_string().contains("as a value, use");
            let tips: Vec<StyledStr> = tips.into_iter().filter(helps).collect();
            if !tips.is_empty() {
                error.insert(ContextKind::Suggested, ContextValue::StyledStrs(tips));
            }
        }
        // `skein cluster down` lands the swarm.
        let ends_flight = |command: &str| command == "down" || NEVER_SUGGESTED.contains(&command);
        let is_dangerous = match error.get(ContextKind::SuggestedSubcommand) {
            Some(ContextValue::String(command)) => ends_flight(command),
            Some(ContextValue::Strings(commands)) => commands.iter().any(|command| ends_flight(command)),
            _ => false,
        };
        if is_dangerous {
            error.remove(ContextKind::SuggestedSubcommand);
        }
        list_commands::<T>(&mut error, &arguments);
        error
    })
}

/// Lists the commands that there are after the usage of an error about an unknown one for which none is suggested.
fn list_commands<T: Parser>(error: &mut clap::Error, arguments: &[OsString]) {
    let Some(ContextValue::String(unknown)) = error.get(ContextKind::InvalidSubcommand) else { return };
    if error.kind() != ErrorKind::InvalidSubcommand || error.get(ContextKind::SuggestedSubcommand).is_some() {
        return;
    }
    let mut parent = T::command();
    for argument in arguments.iter().skip(1).take_while(|argument| **argument != **unknown) {
        if let Some(below) = parent.find_subcommand(argument) {
            parent = below.clone();
        }
    }
    let shown = parent.get_subcommands().filter(|command| !command.is_hide_set());
    let names = shown.map(clap::Command::get_name).collect::<Vec<_>>().join(", ");
    if let Some(ContextValue::StyledStr(usage)) = error.get(ContextKind::Usage) {
        let usage = format!("{}\n\nCommands: {names}", usage.ansi());
        error.insert(ContextKind::Usage, ContextValue::StyledStr(usage.into()));
    }
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
        let message = |arguments: &[&str]| parse_from::<Cli>(arguments).unwrap_err().to_string();
        let unknown = message(&["lab", "compare", "a", "b", "--vebrose"]);
        assert!(unknown.contains("--vebrose") && !unknown.contains("as a value"), "{unknown}");
        let near = message(&["lab", "compare", "a", "b", "--onyl", "x"]);
        assert!(near.contains("--only") && !near.contains("as a value"), "{near}");
        let order = |verb: &str| parse_from::<Orders>(["orders", verb]).unwrap_err().to_string();
        assert!(order("hodl").contains("'hold'"), "{}", order("hodl"));
        assert!(!order("lnad").contains("'land'"), "{}", order("lnad"));
    }

    #[test]
    fn where_no_command_is_suggested_all_of_them_are_listed() {
        let message = |order: &str| parse_from::<Orders>(["orders", order]).unwrap_err().to_string();
        assert!(message("lnad").contains("\n\nCommands: land, hold\n"), "{}", message("lnad"));
        assert!(message("qqqq").contains("Commands: land, hold"), "{}", message("qqqq"));
        assert!(!message("hodl").contains("Commands"), "{}", message("hodl"));
    }
}
