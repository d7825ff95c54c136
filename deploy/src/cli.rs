//! Defines the command line of `skein` and calls the module of each command.

use std::ffi::OsString;
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use clap::error::{ContextKind, ContextValue};
use clap::{Parser, Subcommand};
use skein_agent::config::AgentOptions;
use skein_agent::plant::xplane::standin::{StandinOptions, run_standin};
use skein_common::scenario::NEVER_SUGGESTED;
use skein_core::formation::laws::Laws;
use tracing_subscriber::EnvFilter;

use crate::check::{self, CheckArgs};
use crate::cluster::host::{self, NodeArgs};
use crate::cluster::{self, ClusterArgs};
use crate::explain::{self, ExplainArgs};
use crate::fly::{self, FlyArgs};
use crate::order::{self, OrderArgs};
use crate::record::{self, RecordArgs};
use crate::report::{self, ReportArgs};
use skein_lab::compare::{self, CompareArgs};
use skein_lab::error::Error;
use skein_lab::study::{self, StudyArgs};

/// Flies a swarm of helicopters without a central computer.
///
/// Exit status: 0 success, 1 a run that failed, 2 an argument or a file at fault.
#[derive(Debug, Parser)]
#[command(name = "skein", version, max_term_width = 110)]
pub struct Cli {
    /// What to do
    #[command(subcommand)]
    pub command: Command,
}

/// The commands of `skein`.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Fly a swarm on this PC, a process for each vehicle
    Fly(FlyArgs),
    /// Fly a scenario in virtual time, many seeds at once, and measure it
    Study(StudyArgs),
    /// Judge the runs of one folder against those of another, seed by seed; exit status 1 if a figure is worse
    Compare(CompareArgs),
    /// Record a live swarm until Ctrl-C; or repair a recording, or join several
    Record(RecordArgs),
    /// Draw what was flown: pictures and tables on one page
    Report(ReportArgs),
    /// Send an order to a live swarm through any of its agents, which pass it on
    Order(OrderArgs),
    /// What would stop a flight: of a scenario, with the origin of every value; of a cluster; of an X-Plane
    Check(CheckArgs),
    /// What the keys of a scenario mean: kind, range, default and reason
    Explain(ExplainArgs),
    /// Install a swarm on every node of a cluster, start it, look at it, land it
    Cluster(ClusterArgs),
    /// A node's own side of the cluster's commands
    #[command(hide = true)]
    Node(NodeArgs),
    /// Fly one vehicle; the same as the program skein-agent
    Agent(AgentOptions),
    /// A helicopter without a screen that uses X-Plane's UDP protocol; the same as the program xplane-standin
    Standin(StandinOptions),
}

/// Parses the arguments of this process and runs its command.
pub fn main() -> ExitCode {
    main_with(Laws::default())
}

/// Runs the program with additional formation laws: every command accepts their names in `formation.law`, and the
/// agents that it starts can fly them. See [`skein_lab::law`].
pub fn main_with(laws: Laws) -> ExitCode {
    match laws.add() {
        Ok(()) => run(parse(std::env::args_os()).unwrap_or_else(|error| error.exit()).command),
        Err(fault) => Error::Refused(fault.to_string()).report(),
    }
}

/// Parses the arguments, the first of which is the program's name. An error never suggests a command that lands or
/// aborts the swarm.
///
/// # Errors
/// If the arguments are wrong. A request for the help or the version is returned as an error too.
pub fn parse(arguments: impl IntoIterator<Item = impl Into<OsString> + Clone>) -> Result<Cli, clap::Error> {
    Cli::try_parse_from(arguments).map_err(|mut error| {
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
        error
    })
}

/// Runs one command and returns its exit status: 0 success, 1 a run that failed, 2 an argument or a file at fault.
pub fn run(command: Command) -> ExitCode {
    let done = match command {
        Command::Fly(args) => fly::run(&args),
        Command::Study(args) => study::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Record(args) => record::run(&args),
        Command::Report(args) => report::run(&args),
        Command::Order(args) => order::run(&args),
        Command::Check(args) => check::run(&args),
        Command::Explain(args) => explain::run(&args),
        Command::Cluster(args) => cluster::run(&args),
        Command::Node(args) => host::run(&args),
        // Both set their own exit status and logging.
        Command::Agent(options) => return host::fly(&options),
        Command::Standin(options) => standin(&options),
    };
    done.map_or_else(|error| error.report(), |()| ExitCode::SUCCESS)
}

fn standin(options: &StandinOptions) -> Result<(), Error> {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    tracing_subscriber::fmt().with_env_filter(filter).with_ansi(false).with_writer(std::io::stderr).init();
    run_standin(options, &AtomicBool::new(false)).map_err(|error| Error::Refused(error.to_string()))
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    fn parse(line: &str) -> Result<Command, clap::Error> {
        super::parse(line.split(' ')).map(|cli| cli.command)
    }

    #[test]
    fn clap_accepts_the_definition_of_the_command_line() {
        Cli::command().debug_assert();
    }

    #[test]
    fn no_error_suggests_landing_or_aborting() {
        let message = |line: &str| parse(line).unwrap_err().to_string();
        for slip in
            ["order lnad", "order landd", "order lan", "order abrot", "order abor", "cluster dwon", "cluster dow"]
        {
            let message = message(&format!("skein {slip}"));
            let written = slip.split(' ').next_back().unwrap_or_default();
            assert!(message.contains(&format!("unrecognized subcommand '{written}'")), "{message}");
            assert!(!message.contains("tip") && !message.contains("similar"), "{message}");
            assert!(["'land'", "'abort'", "'down'"].iter().all(|verb| !message.contains(verb)), "{message}");
            assert!(message.contains("Usage: skein "), "{message}");
        }
        for (slip, meant) in
            [("order hodl", "hold"), ("order gto", "goto"), ("cluster stauts", "status"), ("stduy", "study")]
        {
            let message = message(&format!("skein {slip}"));
            assert!(message.contains(&format!("'{meant}'")), "{message}");
        }
    }

    #[test]
    fn a_flight_takes_its_options_in_any_order() {
        let line =
            "skein fly --json my.toml --set seed=3 --plant standin --set formation.radius_m=50 --duration 20 --seed 4";
        let Ok(Command::Fly(args)) = parse(line) else { panic!("a flight") };
        assert_eq!(args.scenario.scenario.as_deref(), Some("my.toml".as_ref()));
        assert_eq!(args.scenario.sets, ["seed=3", "formation.radius_m=50"]);
        assert_eq!((args.plant, args.duration, args.seed), (Some(fly::PlantArg::Standin), Some(20.0), Some(4)));
        assert!(args.json && args.out.is_none() && args.xplane.is_none());
    }

    #[test]
    fn a_wrong_command_line_is_refused_with_status_2() {
        for line in [
            "skein",
            "skein fly --plant balloon",
            "skein fly --duration soon",
            "skein fly --xplane heli:x",
            "skein fly --view 127.0.0.1:80 --no-view",
            "skein order",
            "skein order dance",
            "skein order land --swarm a/b",
            "skein record",
            "skein record --merge a.mcap b.mcap",
            "skein record --repair a.mcap --out b.mcap",
            "skein record --repair a.mcap --merge b.mcap --out c.mcap",
            "skein record --swarm lab --merge a.mcap --out b.mcap",
            "skein report",
            "skein report --capacity here",
            "skein report here --json",
        ] {
            assert_eq!(parse(line).unwrap_err().exit_code(), 2, "{line}");
        }
        assert!(parse("skein order land --swarm lab").is_ok());
        assert!(parse("skein order --swarm lab goto 2").is_ok() && parse("skein order goto").is_err());
        assert!(parse("skein check").is_ok() && parse("skein check -f lab.toml --json").is_ok());
        assert!(parse("skein explain").is_ok() && parse("skein explain radius --json").is_ok());
        assert!(parse("skein check --xplane heli7").is_ok() && parse("skein check my.toml -f lab.toml").is_err());
        assert!(
            parse("skein record --swarm lab --out a.mcap").is_ok() && parse("skein record --repair a.mcap").is_ok()
        );
        assert!(parse("skein record --merge a.mcap b.mcap --out c.mcap").is_ok());
        assert!(parse("skein report --capacity --json --out x").is_ok());
    }
}
