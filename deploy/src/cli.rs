//! Defines the command line of `skein` and calls the module of each command.

use std::ffi::OsString;
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use clap::{CommandFactory, Parser, Subcommand};
use skein_agent::config::AgentOptions;
use skein_agent::plant::xplane::standin::{Standin, StandinOptions};
use skein_core::formation::laws::Laws;
use tracing_subscriber::EnvFilter;

use crate::check::xplane::{self, XplaneCheckArgs};
use crate::check::{self, CheckArgs};
use crate::explain::{self, ExplainArgs};
use crate::fit::{self, FitArgs};
use crate::fly::{self, FlyArgs};
use crate::manual::{self, CompletionsArgs, ManArgs};
use crate::new::{self, NewArgs};
use crate::record::{self, RecordArgs};
use crate::release::{self, ReleaseArgs};
use crate::replay::{self, ReplayArgs};
use crate::report::{self, ReportArgs};
use crate::scenarios::{self, ScenariosArgs};
use crate::version;
use skein_cluster::ClusterArgs;
use skein_cluster::host::{self, NodeArgs};
use skein_cluster::mesh::order::{self, OrderArgs};
use skein_cluster::os;
use skein_cluster::place::{self, PlaceArgs};
use skein_cluster::status::{self, StatusArgs};
use skein_lab::cli::{finish, parsed};
use skein_lab::compare::{self, CompareArgs};
use skein_lab::error::Error;
use skein_lab::study::{self, StudyArgs};
use skein_lab::terminal::{complain, draw};
use skein_view::ViewArgs;

/// Flies a swarm of helicopters without a central computer.
///
/// Exit status: 0 success, 1 a run that failed, 2 an argument or a file at fault.
#[derive(Debug, Parser)]
#[command(
    name = "skein",
    version = version::line(),
    max_term_width = 110,
    disable_help_subcommand = true,
    after_help = "`skein COMMAND --help` explains a command. More, for experts: agent, replay, completions"
)]
pub struct Cli {
    /// The command
    #[command(subcommand)]
    pub command: Command,
}

/// The commands for experts: the first help names them below its list.
pub const FOR_EXPERTS: [&str; 3] = ["agent", "replay", "completions"];

/// The commands of `skein`.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Fly a swarm on this PC, a process for each vehicle
    Fly(FlyArgs),
    /// Fly a scenario in virtual time, many seeds at once, and measure it
    Study(StudyArgs),
    /// Judge the runs of one folder against those of another, seed by seed; exit status 1 if a figure is worse
    Compare(CompareArgs),
    /// Draw what was flown: pictures and tables on one page
    Report(ReportArgs),
    /// Record a live swarm until Ctrl-C; or repair a recording, or join several
    Record(RecordArgs),
    /// Watch a live swarm, or play a recording, on a page in the browser; or on the terminal
    View(ViewArgs),
    /// Send an order to a live swarm through any of its agents, which pass it on
    Order(OrderArgs),
    /// Show the state of a live swarm's vehicles, as they report it: on this PC or on a cluster
    Status(StatusArgs),
    /// Find what would stop a flight: of a scenario, with the origin of every value; of a cluster; of this PC
    Check(CheckArgs),
    /// Simulators: check an X-Plane, place its aircraft, release its controls, fit a helicopter, stand in for it
    #[command(
        after_help = "Examples:\n  skein xplane check --xplane 127.0.0.1\n  skein xplane fit my-heli --xplane 127.0.0.1",
        subcommand
    )]
    Xplane(XplaneCommand),
    /// Your files: write a commented start, explain the keys of a scenario, list the shipped scenarios
    #[command(after_help = "Examples:\n  skein files new scenario my-ring\n  skein files explain radius", subcommand)]
    Files(FilesCommand),
    /// Install a swarm on every node of a cluster, start it, look at it, land it
    Cluster(ClusterArgs),
    /// Fly one vehicle; the same as the program skein-agent
    #[command(
        hide = true,
        after_help = "Examples:\n  skein agent --scenario deploy/scenarios/hover.toml --id 1\n  skein agent --config node3.toml"
    )]
    Agent(AgentOptions),
    /// Run the core of an agent again with its recorded inputs, and compare what it gives with what it gave in flight
    #[command(hide = true)]
    Replay(ReplayArgs),
    /// Print the completions for a shell
    #[command(hide = true)]
    Completions(CompletionsArgs),
    /// Write the manual pages
    #[command(hide = true)]
    Man(ManArgs),
    /// A node's own side of the cluster's commands
    #[command(hide = true)]
    Node(NodeArgs),
}

/// The commands about simulators.
#[derive(Debug, Subcommand)]
pub enum XplaneCommand {
    /// Whether an X-Plane answers, its frames, datarefs, overrides and state, each fault with its remedy
    Check(XplaneCheckArgs),
    /// Put an X-Plane's aircraft to its vehicle's start, in the scenario's weather
    Place(PlaceArgs),
    /// Give the controls of X-Planes back after an agent's PC has died
    Release(ReleaseArgs),
    /// Fly an unknown helicopter of X-Plane up a ladder that finds its trim and gains, and write its aircraft file
    Fit(FitArgs),
    /// A helicopter without a screen that uses X-Plane's UDP protocol; the same as the program xplane-standin
    #[command(after_help = "Examples:\n  skein xplane standin\n  skein xplane standin --port 49010")]
    Standin(StandinOptions),
}

/// The commands about the files that a user writes.
#[derive(Debug, Subcommand)]
pub enum FilesCommand {
    /// Write a commented start: a scenario, a law, an aircraft, a cluster file, a study
    New(NewArgs),
    /// Explain the keys of a scenario: kind, range, default and reason
    Explain(ExplainArgs),
    /// The scenarios that come with the program, and fly by their name
    Scenarios(ScenariosArgs),
}

/// Commands under their names of release 0.1, and what they are called now. To be removed after 0.2.
const RENAMED: [(&str, &[&str]); 8] = [
    ("place", &["xplane", "place"]),
    ("release", &["xplane", "release"]),
    ("fit", &["xplane", "fit"]),
    ("standin", &["xplane", "standin"]),
    ("doctor", &["check", "--pc"]),
    ("new", &["files", "new"]),
    ("explain", &["files", "explain"]),
    ("scenarios", &["files", "scenarios"]),
];

/// The arguments of this process with an old name replaced, and the line about it for stderr. `skein help COMMAND` becomes
/// `skein COMMAND --help`: as a command of its own it would be one more entry of the first help.
fn renamed(mut arguments: Vec<OsString>) -> (Vec<OsString>, Option<String>) {
    if arguments.get(1).is_some_and(|first| first == "help") {
        arguments.remove(1);
        arguments.push("--help".into());
    }
    let Some(first) = arguments.get(1).and_then(|first| first.to_str()) else { return (arguments, None) };
    let (old, new) = if first == "check" && arguments.iter().any(is_xplane) {
        ("check --xplane", &["xplane", "check"][..])
    } else if let Some(&(old, new)) = RENAMED.iter().find(|(old, _)| *old == first) {
        (old, new)
    } else {
        return (arguments, None);
    };
    let line = format!("`skein {old}` is now `skein {}`: the old name ends with the next release", new.join(" "));
    arguments.splice(1..2, new.iter().map(OsString::from));
    (arguments, Some(line))
}

/// Whether the argument is the option `--xplane`, with its value or before it.
fn is_xplane(argument: &OsString) -> bool {
    argument.to_str().is_some_and(|text| text == "--xplane" || text.starts_with("--xplane="))
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
        Ok(()) => {
            let (arguments, line) = renamed(std::env::args_os().collect());
            line.iter().for_each(|line| complain(line));
            run(parsed::<Cli>(arguments).command)
        }
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
        Command::View(args) => skein_view::run(&args),
        Command::Report(args) => report::run(&args),
        Command::Order(args) => order::run(&args),
        Command::Status(args) => args.swarm.choose().and_then(|place| status::status(&place, args.shown)),
        Command::Check(args) => check::run(&args),
        Command::Xplane(XplaneCommand::Check(args)) => xplane::run(&args),
        Command::Xplane(XplaneCommand::Place(args)) => place::run(&args),
        Command::Xplane(XplaneCommand::Release(args)) => release::run(&args),
        Command::Xplane(XplaneCommand::Fit(args)) => fit::run(&args),
        Command::Files(FilesCommand::New(args)) => new::run(&args),
        Command::Files(FilesCommand::Explain(args)) => explain::run(&args),
        Command::Files(FilesCommand::Scenarios(args)) => scenarios::run(&args),
        Command::Replay(args) => replay::run(&args),
        Command::Completions(args) => {
            manual::complete(&args, Cli::command());
            Ok(())
        }
        Command::Man(args) => manual::write_pages(&args, Cli::command()),
        Command::Cluster(args) => skein_cluster::run(&args),
        Command::Node(args) => host::run(&args),
        // Both set their own exit status and logging.
        Command::Agent(options) => return host::fly(&options),
        Command::Xplane(XplaneCommand::Standin(options)) => standin(&options),
    };
    finish(done)
}

fn standin(options: &StandinOptions) -> Result<(), Error> {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    tracing_subscriber::fmt().with_env_filter(filter).with_ansi(false).with_writer(std::io::stderr).init();
    let mut standin = Standin::open(options).map_err(|error| Error::Refused(error.to_string()))?;
    standin.run(&AtomicBool::new(false));
    Ok(())
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
        let is_shown = |below: &&clap::Command| !below.is_hide_set() || FOR_EXPERTS.contains(&below.get_name());
        for below in command.get_subcommands().filter(is_shown) {
            found.push(below.clone());
            // The verbs of an order have their examples there.
            if below.get_name() != "order" {
                shown(below, found);
            }
        }
    }

    #[test]
    fn the_first_help_lists_twelve_commands_and_names_those_for_experts() {
        let mut program = Cli::command();
        let help = program.render_help().to_string();
        let (_, list) = help.split_once("Commands:\n").unwrap();
        let entries = list.lines().take_while(|line| !line.is_empty()).filter(|line| !line.starts_with("   "));
        assert_eq!(entries.count(), 12, "{help}");
        let (_, further) = help.split_once("More, for experts: ").unwrap();
        assert_eq!(further.split_whitespace().collect::<Vec<_>>().join(" "), FOR_EXPERTS.join(", "));
        assert!(FOR_EXPERTS.iter().all(|name| program.find_subcommand(name).is_some()), "{FOR_EXPERTS:?}");
    }

    #[test]
    fn a_command_under_its_old_name_runs_and_names_the_new_one() {
        let renamed = |line: &str| {
            let (arguments, about) = renamed(line.split(' ').map(OsString::from).collect());
            let arguments: Vec<String> =
                arguments.into_iter().map(|argument| argument.into_string().unwrap()).collect();
            (arguments.join(" "), about)
        };
        for (old, new) in [
            ("place --xplane heli", "xplane place --xplane heli"),
            ("release heli", "xplane release heli"),
            ("fit mine --xplane heli", "xplane fit mine --xplane heli"),
            ("standin --port 1", "xplane standin --port 1"),
            ("check --xplane heli", "xplane check --xplane heli"),
            ("check my.toml --json --xplane=heli", "xplane check my.toml --json --xplane=heli"),
            ("doctor --json --wait 0", "check --pc --json --wait 0"),
            ("new law mine", "files new law mine"),
            ("explain radius", "files explain radius"),
            ("scenarios", "files scenarios"),
        ] {
            let (line, about) = renamed(&format!("skein {old}"));
            assert_eq!(line, format!("skein {new}"));
            assert!(parse(&line).is_ok(), "{line}");
            let about = about.unwrap();
            let names = |begin: &str| about.contains(&format!("`skein {begin}"));
            assert!(names(old.split(' ').next().unwrap()) && names(new.split(' ').next().unwrap()), "{about}");
        }
        assert_eq!(renamed("skein help place").0, "skein xplane place --help");
        for same in ["skein", "skein check", "skein fly --xplane heli", "skein order release --vehicles 1"] {
            assert_eq!(renamed(same), (same.to_owned(), None));
        }
        assert_eq!(renamed("skein help").0, "skein --help");
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
        let skein_cluster::ClusterCommand::Logs(logs) = logs.command else { panic!("logs") };
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
            parse("skein files new law a --lang rust").is_err()
                && parse("skein files new law a --lang rust --source .").is_ok()
        );
        assert!(parse("skein files new scenario ../a").is_err() && parse("skein files scenarios tour --json").is_err());
        assert!(parse("skein files explain").is_ok() && parse("skein files explain radius --json").is_ok());
        assert!(
            parse("skein xplane check --xplane heli7").is_ok() && parse("skein check my.toml -f lab.toml").is_err()
        );
        assert!(parse("skein check --pc --wait 0").is_ok() && parse("skein check --wait 0").is_err());
        assert!(parse("skein check --pc my.toml").is_err() && parse("skein xplane check my.toml").is_err());
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
