//! What the commands that call hosts have in common: which nodes, a progress line for each host, and in the end a table.

use std::collections::BTreeSet;
use std::io::IsTerminal;
use std::path::Path;
use std::time::{Duration, Instant};

use comfy_table::{CellAlignment, ContentArrangement, Table, presets};
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use serde::Serialize;
use skein_common::id::VehicleId;
use skein_common::printable::printable_lines;

use super::FileArgs;
use super::ssh::{self, Host, Ssh};
use crate::inventory::{Install, Inventory, Node};
use skein_host::clock;
use skein_lab::error::Error;

/// Between two pictures of a line.
const TICK: Duration = Duration::from_millis(120);

/// What every command that calls hosts is told.
#[derive(Clone, Debug, clap::Args)]
pub struct NodesArgs {
    /// The cluster.
    #[command(flatten)]
    pub file: FileArgs,
    /// Only these nodes; without it all
    #[arg(long = "node", value_name = "N", num_args = 1..)]
    pub nodes: Vec<VehicleId>,
    /// Say every ssh command before it runs
    #[arg(short, long)]
    pub verbose: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

impl NodesArgs {
    /// Reads the cluster's file.
    ///
    /// # Errors
    /// If it is at fault, or has no such node.
    pub fn read(&self) -> Result<Chosen, Error> {
        Chosen::read(&self.file.file, &self.nodes)
    }

    /// How hosts are called.
    pub fn ssh(&self) -> Ssh {
        Ssh::new(self.verbose)
    }

    /// Where it is shown how far they are.
    pub fn progress(&self) -> Progress {
        Progress::new(self.verbose)
    }
}

/// A cluster, and the nodes of it that a command is for.
#[derive(Clone, Debug)]
pub struct Chosen {
    /// All of it.
    pub inventory: Inventory,
    /// Which.
    pub ids: BTreeSet<VehicleId>,
}

impl Chosen {
    /// Reads a cluster's file; no ids are all.
    ///
    /// # Errors
    /// If the file is at fault, or has no such node.
    pub fn read(path: &Path, ids: &[VehicleId]) -> Result<Self, Error> {
        let inventory = Inventory::read(path)?;
        if let Some(id) = ids.iter().find(|id| !inventory.nodes.contains_key(id)) {
            return Err(Error::Refused(format!("{}: there is no node {id}", path.display())));
        }
        let ids =
            if ids.is_empty() { inventory.nodes.keys().copied().collect() } else { ids.iter().copied().collect() };
        Ok(Self { inventory, ids })
    }

    /// Those chosen.
    pub fn nodes(&self) -> impl Iterator<Item = &Node> {
        self.inventory.nodes.values().filter(|node| self.ids.contains(&node.id))
    }

    /// Those chosen that are reached over ssh, by host.
    pub fn hosts(&self) -> Vec<(Host, Vec<&Node>)> {
        ssh::by_host(self.nodes().filter(|node| node.install == Install::Ssh))
    }

    /// Those chosen that nobody reaches over ssh.
    pub fn manual(&self) -> impl Iterator<Item = &Node> {
        self.nodes().filter(|node| node.install == Install::Manual)
    }
}

/// What became of a node, where there is no more to say of it.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// Which.
    pub node: VehicleId,
    /// Where it is.
    pub host: String,
    /// What was done, in a word or two.
    pub done: &'static str,
    /// Why it failed, if it did.
    pub why: Option<String>,
    /// Something to know that is no fault.
    pub note: Option<String>,
    /// How long it took, s.
    pub seconds: f64,
}

impl Outcome {
    /// Nothing was done yet.
    pub fn new(node: &Node) -> Self {
        Self { node: node.id, host: place(node), done: "", why: None, note: None, seconds: 0.0 }
    }

    /// It failed.
    pub fn fail(&mut self, why: String) {
        self.done = "failed";
        self.why = Some(why);
    }

    /// A line of progress.
    pub fn in_words(&self) -> String {
        let why = self.why.as_ref().map_or_else(String::new, |why| format!(": {why}"));
        format!("node {} {}{why}", self.node, self.done)
    }

    /// All of them, for people.
    pub fn table(all: &[Self]) -> String {
        let row = |one: &Self| {
            let said = one.why.clone().or_else(|| one.note.clone()).unwrap_or_default();
            let seconds = if one.seconds > 0.0 { format!("{:.1}", one.seconds) } else { String::new() };
            vec![one.node.to_string(), one.host.clone(), one.done.to_owned(), seconds, said]
        };
        table(&["node", "host", "done", "all s", ""], all.iter().map(row))
    }

    /// An error if any failed.
    ///
    /// # Errors
    /// Which, of how many.
    pub fn judge(all: &[Self], what: &str) -> Result<(), Error> {
        let failed: Vec<VehicleId> = all.iter().filter(|one| one.why.is_some()).map(|one| one.node).collect();
        judge(&failed, all.len(), what)
    }
}

/// A line on stderr for every host: one that moves on a terminal, one for each stage elsewhere.
#[derive(Debug)]
pub struct Progress {
    bars: Option<MultiProgress>,
    begun: Instant,
}

impl Progress {
    /// `plain`: other things are written to stderr too.
    pub fn new(plain: bool) -> Self {
        let bars = (!plain && std::io::stderr().is_terminal()).then(MultiProgress::new);
        Self { bars, begun: clock::now() }
    }

    /// Since the beginning, s.
    pub fn seconds(&self) -> f64 {
        (clock::now() - self.begun).as_secs_f64()
    }

    /// The line of a host, or of something else of that name.
    pub fn line(&self, name: &impl ToString) -> Line<'_> {
        let name = name.to_string();
        let bar = self.bars.as_ref().map(|bars| {
            let style = ProgressStyle::with_template("{spinner} {prefix:16} {msg}");
            let bar = bars.add(ProgressBar::new_spinner());
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
            bar.set_prefix(name.clone());
            bar.enable_steady_tick(TICK);
            bar
        });
        Line { progress: self, name, bar }
    }
}

/// One of them.
#[derive(Debug)]
pub struct Line<'a> {
    progress: &'a Progress,
    name: String,
    bar: Option<ProgressBar>,
}

impl Line<'_> {
    /// What happens now.
    pub fn say(&self, what: &str) {
        match &self.bar {
            Some(bar) => bar.set_message(printable_lines(what)),
            None => skein_lab::terminal::complain(&format!("{:5.1} s  {}: {what}", self.progress.seconds(), self.name)),
        }
    }
}

impl Drop for Line<'_> {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish();
        }
    }
}

/// A table of texts, on a terminal as wide as that; columns whose name ends in a unit are numbers.
pub fn table(header: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_header(header.iter().copied());
    table.set_content_arrangement(ContentArrangement::Dynamic);
    table.add_rows(rows);
    let is_number = |name: &str| name == "node" || [" s", " MB"].iter().any(|unit| name.ends_with(unit));
    let columns = table.column_iter_mut().zip(header).filter(|(_, name)| is_number(name));
    columns.for_each(|(column, _)| column.set_cell_alignment(CellAlignment::Right));
    let text = table.to_string();
    text.lines().map(|line| line.trim_end().to_owned() + "\n").collect()
}

/// Where a node is, for a table.
pub fn place(node: &Node) -> String {
    match (&node.host, node.install) {
        (Some(host), Install::Ssh) => host.clone(),
        _ => format!("{} (by hand)", node.address),
    }
}

/// A number of seconds that somebody typed.
///
/// # Errors
/// If it is none.
pub fn is_seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| "not a number of seconds".to_owned())?;
    let within = (0.0..=86_400.0).contains(&seconds);
    if within { Ok(seconds) } else { Err("not between 0 and 86400 s".to_owned()) }
}

/// An error if any failed: which, of how many.
///
/// # Errors
/// If the list is not empty.
pub fn judge(failed: &[VehicleId], of: usize, what: &str) -> Result<(), Error> {
    if failed.is_empty() {
        return Ok(());
    }
    Err(Error::Failed(format!("{} of {of} {what}: node {}", failed.len(), list(failed))))
}

/// `1, 2, 5`
pub fn list<'a>(ids: impl IntoIterator<Item = &'a VehicleId>) -> String {
    ids.into_iter().map(VehicleId::to_string).collect::<Vec<_>>().join(", ")
}
