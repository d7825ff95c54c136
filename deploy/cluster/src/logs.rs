//! `skein cluster logs`: shows the agents' logs of all hosts at once, each line after its node's name.

use std::path::PathBuf;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

use serde::Serialize;
use skein_common::id::VehicleName;

use super::nodes::{self, ChosenNodes};
use super::remote::{Fault, Remote};
use super::ssh::{Host, Ssh, at_once};
use crate::inventory::{Node, find};
use skein_host::clock;
use skein_lab::error::Error;

/// Capacity of the queue of lines to be shown; beyond that, the hosts wait.
const QUEUE: usize = 1000;
/// Pause before a lost host is called again.
const AGAIN: Duration = Duration::from_secs(2);
/// ANSI numbers of the colours of the nodes' names, without red, which means an error.
const COLOURS: [u8; 6] = [36, 33, 32, 35, 34, 96];

/// `skein cluster logs`
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  skein cluster logs 3 -n 100\n  skein cluster logs -f cluster.toml --follow")]
pub struct LogsArgs {
    /// Only these nodes; without any all
    #[arg(value_name = "NODE", value_parser = node)]
    pub nodes: Vec<VehicleName>,
    /// The cluster's file; without it the one that the environment variable SKEIN_CLUSTER names, else cluster.toml of this
    /// folder
    #[arg(short = 'f', long, value_name = "CLUSTER.toml", value_parser = file, num_args = 0..=1, default_missing_value = "")]
    pub file: Option<PathBuf>,
    /// Follow the logs with new lines, until Ctrl-C
    #[arg(short = 'F', long)]
    pub follow: bool,
    /// So many of the last lines of each node
    #[arg(short = 'n', long, value_name = "N", default_value_t = 20)]
    pub lines: usize,
    /// Say every ssh command before it runs
    #[arg(short, long)]
    pub verbose: bool,
    /// A JSON object for each line
    #[arg(long)]
    pub json: bool,
}

fn node(text: &str) -> Result<VehicleName, String> {
    text.strip_prefix("node-")
        .unwrap_or(text)
        .parse()
        .map_err(|_| "not a node's number, nor a name such as 3/7; the cluster's file is named with -f".to_owned())
}

/// The cluster's file. `-f` once meant to follow the logs: without a file, or with a node behind it, it is refused.
fn file(text: &str) -> Result<PathBuf, String> {
    if text.is_empty() || node(text).is_ok() {
        return Err("-f names the cluster's file; to follow the logs, use -F or --follow".to_owned());
    }
    Ok(text.into())
}

/// Runs the command.
///
/// # Errors
/// If the cluster file is wrong, or a host could not be asked; the logs of the others are shown then.
pub fn run(args: &LogsArgs) -> Result<(), Error> {
    let chosen = ChosenNodes::read(&find::of_option(args.file.as_deref()), &args.nodes)?;
    let ssh = Ssh::new(args.verbose);
    let remote = Remote { ssh: &ssh, swarm: &chosen.inventory.swarm };
    for node in chosen.manual() {
        eprintln!("{}: installed by hand, its log is where it was started", name(node.id));
    }
    let colours = skein_lab::terminal::shows_colours(&std::io::stdout());
    let width = chosen.ids.iter().map(|id| name(*id).len()).max().unwrap_or(0);
    let (lines, inbox) = sync_channel::<LogLine>(QUEUE);
    let source = Source { remote, lines: args.lines, follow: args.follow };
    let hosts = chosen.hosts();
    let failed = thread::scope(|scope| {
        let all = hosts.iter().flat_map(|(host, nodes)| nodes.iter().map(move |node| (host, *node)));
        if args.follow {
            // All hosts at once: each has a connection open until Ctrl-C.
            for (host, node) in all {
                let (source, lines) = (&source, lines.clone());
                scope.spawn(move || source.follow(host, node, &lines));
            }
        }
        let rest = if args.follow { &[][..] } else { &hosts };
        let (source, lines) = (&source, lines);
        let asked = scope.spawn(move || {
            at_once(rest, |(host, nodes)| {
                let failed = nodes.iter().filter(|node| !source.once(host, node, &lines));
                failed.map(|node| node.id).collect::<Vec<_>>()
            })
        });
        let shown = |entry: &LogLine| match args.json {
            true => serde_json::to_string(entry).unwrap_or_default() + "\n",
            false => line(entry, width, colours),
        };
        inbox.iter().for_each(|entry| skein_lab::terminal::draw(&shown(&entry)));
        asked.join().unwrap_or_default().concat()
    });
    nodes::fail_if_any(chosen.ids.iter().map(|id| (*id, failed.contains(id))), "not shown")
}

/// A line of a node's log.
#[derive(Debug, Serialize)]
struct LogLine {
    node: VehicleName,
    line: String,
}

struct Source<'a> {
    remote: Remote<'a>,
    lines: usize,
    follow: bool,
}

impl Source<'_> {
    /// Shows the last lines. If that fails, reports why and returns false.
    fn once(&self, host: &Host, node: &Node, lines: &SyncSender<LogLine>) -> bool {
        let ended = self.ask(host, node, self.lines, lines);
        if let Err(fault) = &ended {
            skein_lab::terminal::complain(&format!("{}: {}", name(node.id), fault.clone().sentence(host)));
        }
        ended.is_ok()
    }

    /// Follows the log until Ctrl-C. A lost host is called again; what it wrote meanwhile is not shown twice.
    fn follow(&self, host: &Host, node: &Node, lines: &SyncSender<LogLine>) {
        let (mut last, mut count) = (None, self.lines);
        loop {
            let why = match self.ask(host, node, count, lines) {
                Ok(()) => format!("{host}: its log has ended"),
                Err(fault) => fault.sentence(host),
            };
            if last.as_ref() != Some(&why) {
                skein_lab::terminal::complain(&format!("{}: {why}", name(node.id)));
                last = Some(why);
            }
            count = 0;
            clock::sleep(AGAIN);
        }
    }

    fn ask(&self, host: &Host, node: &Node, count: usize, lines: &SyncSender<LogLine>) -> Result<(), Fault> {
        self.remote.log(host, node, (count, self.follow), |line| {
            // The receiver is gone only when this process ends.
            let _ = lines.send(LogLine { node: node.id, line: line.to_owned() });
        })
    }
}

fn line(LogLine { node, line }: &LogLine, width: usize, colours: bool) -> String {
    let name = name(*node);
    if !colours {
        return format!("{name:width$} | {line}\n");
    }
    let colour = COLOURS[usize::from(node.vehicle.get()) % COLOURS.len()];
    format!("\u{1b}[{colour}m{name:width$} |\u{1b}[0m {line}\n")
}

fn name(id: VehicleName) -> String {
    format!("node-{id}")
}
