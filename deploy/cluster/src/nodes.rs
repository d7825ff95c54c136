//! Shared by the commands that call hosts: the choice of nodes, a progress line for each host, and a table of results.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::{Duration, Instant};

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use serde::Serialize;
use skein_common::id::{SwarmName, VehicleName};
use skein_common::printable::printable_lines;

use super::ssh::{self, Host, Ssh, at_once};
use crate::FileArgs;
use crate::findings::table;
use crate::inventory::{Install, Inventory, Node};
use crate::protocol::Installed;
use skein_host::clock;
use skein_lab::error::Error;

/// Interval between two frames of a spinner.
const TICK: Duration = Duration::from_millis(120);

/// Options of every command that calls hosts.
#[derive(Clone, Debug, clap::Args)]
pub struct NodesArgs {
    /// The cluster.
    #[command(flatten)]
    pub file: FileArgs,
    /// Only these nodes; without it all
    #[arg(long = "node", value_name = "N", num_args = 1..)]
    pub nodes: Vec<VehicleName>,
    /// Say every ssh command before it runs
    #[arg(short, long)]
    pub verbose: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

impl NodesArgs {
    /// Reads the cluster file and chooses the nodes; makes the caller of hosts, and the display of progress.
    ///
    /// # Errors
    /// If the file is wrong, or has no such node.
    pub fn begin(&self) -> Result<(ChosenNodes, Ssh, Progress), Error> {
        let chosen = ChosenNodes::read(&self.file.path(), &self.nodes)?;
        Ok((chosen, Ssh::new(self.verbose), Progress::new(self.verbose)))
    }

    /// Prints a result, as JSON if asked for, else as this text.
    pub fn show(&self, result: &impl Serialize, text: impl FnOnce() -> String) {
        skein_lab::terminal::say(&if self.json { skein_lab::terminal::json(result) } else { text() });
    }

    /// Prints the results of a command that has ended at all nodes; `order` is what became of an order over the mesh.
    ///
    /// # Errors
    /// If a node failed: how many are `what`.
    pub fn end(
        &self,
        chosen: &ChosenNodes,
        progress: Progress,
        (order, nodes): (Option<String>, &[Outcome]),
        what: &str,
    ) -> Result<(), Error> {
        let seconds = progress.seconds();
        drop(progress);
        let report = Outcomes { swarm: &chosen.inventory.swarm, order, seconds, nodes };
        let below = report.order.as_ref().map_or_else(String::new, |order| format!("{order}, {seconds:.1} s\n"));
        self.show(&report, || Outcome::table(nodes) + &below);
        fail_if_any(nodes.iter().map(|one| (one.node, one.why.is_some())), what)
    }
}

/// A cluster and the nodes of it that a command is for.
#[derive(Clone, Debug)]
pub struct ChosenNodes {
    /// The whole cluster.
    pub inventory: Inventory,
    /// Ids of the chosen nodes.
    pub ids: BTreeSet<VehicleName>,
}

impl ChosenNodes {
    /// Reads a cluster file and chooses these nodes; no ids choose all.
    ///
    /// # Errors
    /// If the file is wrong, has no such node, or has hosts that are reserved for documentation.
    pub fn read(path: &Path, ids: &[VehicleName]) -> Result<Self, Error> {
        let inventory = Inventory::read(path)?;
        inventory.check_hosts()?;
        if let Some(id) = ids.iter().find(|id| !inventory.nodes.contains_key(id)) {
            return Err(Error::Refused(format!("{}: has no node {id}", path.display())));
        }
        let ids =
            if ids.is_empty() { inventory.nodes.keys().copied().collect() } else { ids.iter().copied().collect() };
        Ok(Self { inventory, ids })
    }

    /// Returns the chosen nodes.
    pub fn nodes(&self) -> impl Iterator<Item = &Node> {
        self.inventory.nodes.values().filter(|node| self.ids.contains(&node.id))
    }

    /// Returns the chosen nodes that are installed over ssh.
    pub fn over_ssh(&self) -> impl Iterator<Item = &Node> {
        self.nodes().filter(|node| node.install == Install::Ssh)
    }

    /// Returns the chosen nodes that are installed over ssh, grouped by host.
    pub fn hosts(&self) -> Vec<(Host, Vec<&Node>)> {
        ssh::by_host(self.over_ssh())
    }

    /// Returns the chosen nodes that are installed by hand.
    pub fn manual(&self) -> impl Iterator<Item = &Node> {
        self.nodes().filter(|node| node.install == Install::Manual)
    }
}

/// Result of a command.
#[derive(Debug, Serialize)]
struct Outcomes<'a> {
    swarm: &'a SwarmName,
    /// Whether the vehicles were ordered to land over the mesh, or why not.
    #[serde(skip_serializing_if = "Option::is_none")]
    order: Option<String>,
    /// Total duration, s.
    seconds: f64,
    nodes: &'a [Outcome],
}

/// Result of a command at one node.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// Id of the node.
    pub node: VehicleName,
    /// Its host.
    pub host: String,
    /// The result, briefly: `landed`. In texts for people a hyphen is a space.
    pub done: &'static str,
    /// The reason of its failure; `None` if it did not fail.
    pub why: Option<String>,
    /// Additional information that is not a fault.
    pub note: Option<String>,
    /// The program and configuration of the next start, after an installation.
    #[serde(flatten)]
    pub runs: Option<Installed>,
    /// Duration, s.
    pub seconds: f64,
}

impl Outcome {
    /// A result with nothing done yet.
    pub fn new(node: &Node) -> Self {
        Self { node: node.id, host: place(node), done: "", why: None, note: None, runs: None, seconds: 0.0 }
    }

    /// Sets the result to failed.
    pub fn fail(&mut self, why: String) {
        self.done = "failed";
        self.why = Some(why);
    }

    /// Formats the result as a line of progress.
    pub fn to_text(&self) -> String {
        let why = self.why.as_ref().map_or_else(String::new, |why| format!(": {why}"));
        format!("node {} {}{why}", self.node, self.done.replace('-', " "))
    }

    /// Formats all results as a table.
    pub fn table(all: &[Self]) -> String {
        table(&["node", "host", "done", "all s", ""], all.iter().map(|one| one.row([])))
    }

    /// Its row in a table, with these cells before the last one.
    pub fn row(&self, more: impl IntoIterator<Item = String>) -> Vec<String> {
        let Self { node, host, done, why, note, .. } = self;
        let first = [node.to_string(), host.clone(), done.replace('-', " "), above_zero(self.seconds)];
        let last = why.clone().or_else(|| note.clone()).unwrap_or_default();
        first.into_iter().chain(more).chain([last]).collect()
    }
}

/// Formats a number with one decimal; nothing if it is zero.
pub(crate) fn above_zero(number: f64) -> String {
    if number > 0.0 { format!("{number:.1}") } else { String::new() }
}

/// Shows a line on stderr for each host: a spinner on a terminal, else one line for each stage.
#[derive(Debug)]
pub struct Progress {
    bars: Option<MultiProgress>,
    begun: Instant,
}

impl Progress {
    /// Makes a display of progress; `plain` if other texts are written to stderr too.
    pub fn new(plain: bool) -> Self {
        let bars = (!plain && skein_lab::terminal::obeys_escapes(&std::io::stderr())).then(MultiProgress::new);
        Self { bars, begun: clock::now() }
    }

    /// Time since the beginning, s.
    pub fn seconds(&self) -> f64 {
        (clock::now() - self.begun).as_secs_f64()
    }

    /// Adds a line for a host, or for anything else with this name.
    pub fn line(&self, name: &impl ToString) -> ProgressLine<'_> {
        let name = name.to_string();
        let bar = self.bars.as_ref().map(|bars| {
            let style = ProgressStyle::with_template("{spinner} {prefix:16} {msg}");
            let bar = bars.add(ProgressBar::new_spinner());
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
            bar.set_prefix(name.clone());
            bar.enable_steady_tick(TICK);
            bar
        });
        ProgressLine { progress: self, name, bar }
    }
}

/// A line of progress.
#[derive(Debug)]
pub struct ProgressLine<'a> {
    progress: &'a Progress,
    name: String,
    bar: Option<ProgressBar>,
}

impl ProgressLine<'_> {
    /// Shows what is being done now.
    pub fn say(&self, what: &str) {
        match &self.bar {
            Some(bar) => bar.set_message(printable_lines(what)),
            None => skein_lab::terminal::complain(&format!("{:5.1} s  {}: {what}", self.progress.seconds(), self.name)),
        }
    }
}

impl Drop for ProgressLine<'_> {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish();
        }
    }
}

/// The host of a node, for a table.
pub fn place(node: &Node) -> String {
    match (&node.host, node.install) {
        (Some(host), Install::Ssh) => host.clone(),
        _ => format!("{} (by hand)", node.address),
    }
}

/// Parses a number of seconds.
///
/// # Errors
/// If it is not a number from 0 to 86400.
pub fn is_seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| "not a number of seconds".to_owned())?;
    let within = (0.0..=86_400.0).contains(&seconds);
    if within { Ok(seconds) } else { Err("not between 0 and 86400 s".to_owned()) }
}

/// Returns an error that names the nodes that failed, if there are any.
///
/// # Errors
/// If one failed.
pub fn fail_if_any(all: impl IntoIterator<Item = (VehicleName, bool)>, what: &str) -> Result<(), Error> {
    let (failed, others): (Vec<_>, Vec<_>) = all.into_iter().partition(|(_, has_failed)| *has_failed);
    let named = list(failed.iter().map(|(id, _)| id));
    let all = failed.len() + others.len();
    if failed.is_empty() {
        Ok(())
    } else {
        Err(Error::Failed(format!("{} of {all} {what}: node {named}", failed.len())))
    }
}

/// Runs a task for each of these nodes, at all hosts at once and for the nodes of a host one after the other. Each host has a
/// line of progress, which begins with `begin`.
pub fn at_each<'n, R: Send>(
    hosts: &[(Host, Vec<&'n Node>)],
    progress: &Progress,
    begin: Option<&str>,
    task: impl Fn(&Host, &'n Node, &ProgressLine<'_>) -> R + Sync,
) -> Vec<(VehicleName, R)> {
    let done = at_once(hosts, |(host, nodes)| {
        let line = progress.line(host);
        begin.iter().for_each(|begin| line.say(begin));
        nodes.iter().map(|node| (node.id, task(host, node, &line))).collect::<Vec<_>>()
    });
    done.into_iter().flatten().collect()
}

/// Formats sorted ids as a list: `1, 2, 5`; those of a fleet by team, `1/1-8, 3/2, 3/5-6`.
pub fn list<'a>(ids: impl IntoIterator<Item = &'a VehicleName>) -> String {
    let ids: Vec<VehicleName> = ids.into_iter().copied().collect();
    let is_next = |one: &VehicleName, next: &VehicleName| {
        one.team.is_some() && one.team == next.team && one.vehicle.get() + 1 == next.vehicle.get()
    };
    let parts = ids.chunk_by(is_next).map(|run| match run {
        [first, .., last] => format!("{first}-{}", last.vehicle),
        few => few.iter().map(VehicleName::to_string).collect(),
    });
    parts.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nodes_of_a_fleet_are_listed_by_team() {
        let listed = |names: &str| {
            let names: Vec<VehicleName> = names.split(' ').map(|name| name.parse().unwrap()).collect();
            list(&names)
        };
        assert_eq!(listed("1 2 3 5"), "1, 2, 3, 5");
        assert_eq!(listed("1/1 1/2 1/3 2/4 3/1 3/3 3/4"), "1/1-3, 2/4, 3/1, 3/3-4");
    }
}
