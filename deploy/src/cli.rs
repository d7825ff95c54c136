//! Defines the command line of `skein` and calls the module of each command.

use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use clap::{CommandFactory, Parser, Subcommand};
use skein_agent::config::AgentOptions;
use skein_agent::plant::xplane::standin::{StandinOptions, run_standin};
use skein_core::formation::laws::Laws;
use tracing_subscriber::EnvFilter;

use crate::check::{self, CheckArgs};
use crate::cluster::host::{self, NodeArgs};
use crate::cluster::{self, ClusterArgs};
use crate::doctor::{self, DoctorArgs};
use crate::explain::{self, ExplainArgs};
use crate::fit::{self, FitArgs};
use crate::fly::{self, FlyArgs};
use crate::manual::{self, CompletionsArgs, ManArgs};
use crate::new::{self, NewArgs};
use crate::order::{self, OrderArgs};
use crate::os;
use crate::place::{self, PlaceArgs};
use crate::record::{self, RecordArgs};
use crate::release::{self, ReleaseArgs};
use crate::replay::{self, ReplayArgs};
use crate::report::{self, ReportArgs};
use crate::scenarios::{self, ScenariosArgs};
use crate::status::{self, StatusArgs};
use crate::version;
use crate::view::{self, ViewArgs};
use skein_lab::cli::{finish, parsed};
use skein_lab::compare::{self, CompareArgs};
use skein_lab::error::Error;
use skein_lab::study::{self, StudyArgs};
use skein_lab::terminal::draw;

/// Flies a swarm of helicopters without a central computer.
///
/// Exit status: 0 success, 1 a run that failed, 2 an argument or a file at fault.
#[derive(Debug, Parser)]
#[command(name = "skein", version = version::line(), max_term_width = 110)]
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
    /// Watch a live swarm, or play a recording, on a page in the browser; or on the terminal
    View(ViewArgs),
    /// Draw what was flown: pictures and tables on one page
    Report(ReportArgs),
    /// Run the core of an agent again with its recorded inputs, and compare what it gives with what it gave in flight
    Replay(ReplayArgs),
    /// Send an order to a live swarm through any of its agents, which pass it on
    Order(OrderArgs),
    /// How the vehicles of a live swarm are, as they report it: on this PC or on a cluster
    Status(StatusArgs),
    /// What would stop a flight: of a scenario, with the origin of every value; of a cluster; of an X-Plane
    Check(CheckArgs),
    /// Put an X-Plane's aircraft to its vehicle's start, in the scenario's weather
    Place(PlaceArgs),
    /// Give the controls of X-Planes back after an agent's PC has died
    Release(ReleaseArgs),
    /// What of this PC would stop or disturb a flight: ports, firewall, cores, clock, limits, disk, X-Plane's beacon
    Doctor(DoctorArgs),
    /// What the keys of a scenario mean: kind, range, default and reason
    Explain(ExplainArgs),
    /// The scenarios that come with the program, and fly by their name
    Scenarios(ScenariosArgs),
    /// Write a commented start: a scenario, a law, an aircraft, a cluster file, a study
    New(NewArgs),
    /// Fly an unknown helicopter of X-Plane up a ladder that finds its trim and gains, and write its aircraft file
    Fit(FitArgs),
    /// Print the completions for a shell
    Completions(CompletionsArgs),
    /// Write the manual pages
    #[command(hide = true)]
    Man(ManArgs),
    /// Install a swarm on every node of a cluster, start it, look at it, land it
    Cluster(ClusterArgs),
    /// A node's own side of the cluster's commands
    #[command(hide = true)]
    Node(NodeArgs),
    /// Fly one vehicle; the same as the program skein-agent
    #[command(
        after_help = "Examples:\n  skein agent --scenario deploy/scenarios/hover.toml --id 1\n  skein agent --config node3.toml"
    )]
    Agent(AgentOptions),
    /// A helicopter without a screen that uses X-Plane's UDP protocol; the same as the program xplane-standin
    #[command(after_help = "Examples:\n  skein standin\n  skein standin --port 49010")]
    Standin(StandinOptions),
}

/// Parses the arguments of this process and runs its command.
pub fn main() -> ExitCode {
    main_with(Laws::default())
}

/// Runs the program with additional formation laws: every command accepts their names in `formation.law`, and the
/// agents that it starts can fly them. See [`skein_lab::law`].
pub fn main_with(laws: Laws) -> ExitCode {
    // clap would make this text at every start, and it needs the whole file of the program.
    if std::env::args_os().skip(1).eq(["--version"]) {
        draw(&version::details());
        return finish(Ok(()));
    }
    os::report_file_size_limit();
    match laws.add() {
        Ok(()) => run(parsed::<Cli>().command),
        Err(fault) => Error::Refused(fault.to_string()).report(),
    }
}

/// Runs one command and returns its exit status: 0 success, 1 a run that failed, 2 an argument or a file at fault.
pub fn run(command: Command) -> ExitCode {
    let done = match command {
        Command::Fly(args) => fly::run(&args),
        Command::Study(args) => study::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Record(args) => record::run(&args),
        Command::View(args) => view::run(&args),
        Command::Report(args) => report::run(&args),
        Command::Replay(args) => replay::run(&args),
        Command::Order(args) => order::run(&args),
        Command::Status(args) => status::run(&args),
        Command::Check(args) => check::run(&args),
        Command::Place(args) => place::run(&args),
        Command::Release(args) => release::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Explain(args) => explain::run(&args),
        Command::Scenarios(args) => scenarios::run(&args),
        Command::New(args) => new::run(&args),
        Command::Fit(args) => fit::run(&args),
        Command::Completions(args) => {
            manual::complete(&args, Cli::command());
            Ok(())
        }
        Command::Man(args) => manual::write_pages(&args, Cli::command()),
        Command::Cluster(args) => cluster::run(&args),
        Command::Node(args) => host::run(&args),
        // Both set their own exit status and logging.
        Command::Agent(options) => return host::fly(&options),
        Command::Standin(options) => standin(&options),
    };
    finish(done)
}

fn standin(options: &StandinOptions) -> Result<(), Error> {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    tracing_subscriber::fmt().with_env_filter(filter).with_ansi(false).with_writer(std::io::stderr).init();
    run_standin(options, &AtomicBool::new(false)).map_err(|error| Error::Refused(error.to_string()))
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::PlantKind;
    use skein_lab::cli::parse_from;

    use super::*;

    fn parse(line: &str) -> Result<Command, clap::Error> {
        parse_from::<Cli>(line.split(' ')).map(|cli| cli.command)
    }

    #[test]
    fn clap_accepts_the_definition_of_the_command_line() {
        Cli::command().debug_assert();
    }

    /// Every command that is shown, each below its parents.
    fn shown(command: &clap::Command, found: &mut Vec<clap::Command>) {
        for below in command.get_subcommands().filter(|below| !below.is_hide_set() && below.get_name() != "help") {
            found.push(below.clone());
            // The verbs of an order have their examples there.
            if below.get_name() != "order" {
                shown(below, found);
            }
        }
    }

    #[test]
    fn every_command_ends_its_help_with_examples_that_can_be_typed() {
        let mut commands = Vec::new();
        shown(&Cli::command(), &mut commands);
        assert!(commands.len() > 15);
        for command in commands {
            let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            let examples: Vec<&str> = help.strip_prefix("Examples:\n").unwrap_or_default().lines().collect();
            assert!(examples.len() >= 2, "{}: {help:?}", command.get_name());
            for example in examples {
                let example = example.split(" > ").next().unwrap_or_default();
                assert!(parse(example.trim()).is_ok(), "{example}: {:?}", parse(example.trim()).err());
            }
        }
    }

    #[test]
    fn f_is_the_file_of_the_cluster_in_every_command() {
        let mut commands = Vec::new();
        shown(&Cli::command(), &mut commands);
        for command in commands {
            let short = command.get_arguments().find(|argument| argument.get_short() == Some('f'));
            assert!(short.is_none_or(|argument| argument.get_long() == Some("file")), "{}", command.get_name());
        }
        let Ok(Command::Cluster(logs)) = parse("skein cluster logs -f lab.toml -F -n 3 2") else { panic!("logs") };
        let cluster::ClusterCommand::Logs(logs) = logs.command else { panic!("logs") };
        assert!(logs.follow && logs.file == Some("lab.toml".into()) && logs.nodes.len() == 1);
        for old in ["skein cluster logs -f", "skein cluster logs -f 3", "skein cluster logs -f -n 5"] {
            let refused = parse(old).unwrap_err();
            assert!(refused.exit_code() == 2 && refused.to_string().contains("-F or --follow"), "{old}: {refused}");
        }
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
            assert!(message.contains("\nCommands: "), "all commands are listed instead: {message}");
        }
        assert!(message("skein order landd").contains("Commands: hold, goto, land, abort, release, set\n"));
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
        assert_eq!(
            (args.plant, args.duration_s, args.seed),
            (Some(fly::PlantArg(PlantKind::Standin)), Some(20.0), Some(4))
        );
        assert!(args.json && args.out.is_none() && args.xplane.is_empty());
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
            "skein report here --json",
        ] {
            assert_eq!(parse(line).unwrap_err().exit_code(), 2, "{line}");
        }
        assert!(parse("skein order land --swarm lab").is_ok());
        assert!(parse("skein order --swarm lab goto 2").is_ok() && parse("skein order goto").is_err());
        assert!(parse("skein check").is_ok() && parse("skein check -f lab.toml --json").is_ok());
        assert!(
            parse("skein new law a --lang rust").is_err() && parse("skein new law a --lang rust --source .").is_ok()
        );
        assert!(parse("skein new scenario ../a").is_err() && parse("skein scenarios tour --json").is_err());
        assert!(parse("skein explain").is_ok() && parse("skein explain radius --json").is_ok());
        assert!(parse("skein check --xplane heli7").is_ok() && parse("skein check my.toml -f lab.toml").is_err());
        assert!(
            parse("skein record --swarm lab --out a.mcap").is_ok() && parse("skein record --repair a.mcap").is_ok()
        );
        assert!(parse("skein record --merge a.mcap b.mcap --out c.mcap").is_ok());
        assert!(
            parse("skein report --capacity --json --out x").is_ok()
                && parse("skein report --capacity my-fleet").is_ok()
        );
    }
}
