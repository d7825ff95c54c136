//! `skein cluster install`: installs the program, its configuration and its keys on every node. It makes three calls to
//! each host: what is there, the program if it is missing, the configuration; a second time nothing is done. If
//! anything fails, the node stays as it was. Vehicles in the air fly on; then those whose node has something new are
//! restarted one by one.

mod manual;
pub(super) mod owner;
pub(super) mod roll;
mod row;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use serde::Serialize;
use skein_common::id::VehicleName;

use super::bundle::Bundle;
use super::nodes::{self, ChosenNodes, NodesArgs, Progress, ProgressLine, is_seconds};
use super::pack::pack;
use super::program::Program;
use super::protocol::{Ask, Change, FORCED, Facts, Installed, Setup};
use super::remote::{Fault, Remote};
use super::ssh::{Host, at_once};
use crate::inventory::Node;
use roll::Restart;
use row::{InstalledNode, UNCHANGED};
use skein_host::clock;
use skein_lab::error::Error;

/// Free space to leave on a disk, bytes: logs need some.
pub(super) const ROOM: u64 = 32 << 20;

/// `skein cluster install`
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  skein cluster install\n  skein cluster install -f cluster.toml --node 3")]
pub struct InstallArgs {
    /// The nodes.
    #[command(flatten)]
    pub nodes: NodesArgs,
    /// Look at every node and say what would be done; nothing is changed
    #[arg(long)]
    pub dry_run: bool,
    /// Bring back what each node had before, instead of installing anything
    #[arg(long, conflicts_with = "dry_run")]
    pub rollback: bool,
    /// Install also where another authority owns the node; refused while a vehicle of that authority flies
    #[arg(long, conflicts_with = "rollback")]
    pub take_over: bool,
    /// Time limit for a vehicle that is restarted to be ready again, s
    #[arg(long = "timeout", value_name = "S", default_value_t = 60.0, value_parser = is_seconds)]
    pub timeout_s: f64,
    /// Folder for the files of nodes that are installed by hand
    #[arg(long, value_name = "FOLDER", default_value = "manual")]
    pub out: PathBuf,
}

/// Result of the command.
#[derive(Debug, Serialize)]
struct InstallReport {
    swarm: String,
    dry_run: bool,
    /// Total duration, s.
    seconds: f64,
    /// Time until every node had its files, s.
    installed_s: f64,
    nodes: Vec<InstalledNode>,
}

/// Runs the command.
///
/// # Errors
/// If the cluster file is wrong, or any node failed; the other nodes are installed then.
pub fn run(args: &InstallArgs) -> Result<(), Error> {
    let (chosen, ssh, progress) = args.nodes.begin()?;
    let remote = Remote { ssh: &ssh, swarm: &chosen.inventory.swarm };
    let given = if args.rollback { BTreeMap::new() } else { prepare(&chosen)? };
    if args.take_over || args.rollback {
        let flown = owner::flown_by_another(&remote, &chosen);
        if !flown.is_empty() {
            drop(progress);
            return Err(Error::Refused(flown));
        }
    }
    let install = Installer { args, remote, given: &given, progress: &progress };
    let done = at_once(&chosen.hosts(), |(host, nodes)| install.on(host, nodes));
    let (mut rows, mut restarts) = (BTreeMap::new(), Vec::new());
    for (row, restart) in done.into_iter().flatten() {
        rows.insert(row.outcome.node, row);
        restarts.extend(restart);
    }
    for node in chosen.manual() {
        rows.insert(node.id, manual::write(args, &chosen, node, given.get(&node.id)));
    }
    let installed_s = progress.seconds();
    if !restarts.is_empty() && !args.dry_run {
        restarts.sort_by_key(|restart| restart.node.id);
        roll::roll(&install.remote, &chosen.inventory, &restarts, args.timeout_s, &progress, &mut rows)?;
    }
    let seconds = progress.seconds();
    drop(progress);
    let swarm = chosen.inventory.swarm.to_string();
    let report =
        InstallReport { swarm, dry_run: args.dry_run, seconds, installed_s, nodes: rows.into_values().collect() };
    args.nodes.show(&report, || row::table(&report.nodes, args.dry_run));
    let outcomes = report.nodes.iter().map(|row| &row.outcome);
    nodes::fail_if_any(outcomes.map(|outcome| (outcome.node, outcome.why.is_some())), "failed")
}

/// The program and the files to install on a node.
struct Payload {
    program: Arc<Program>,
    bundle: Bundle,
}

impl Payload {
    fn installed(&self) -> Installed {
        Installed { release: self.program.release.clone(), bundle: self.bundle.id() }
    }
}

/// Reads and checks everything before the first host is called.
fn prepare(chosen: &ChosenNodes) -> Result<BTreeMap<VehicleName, Payload>, Error> {
    let mut programs = BTreeMap::<Option<PathBuf>, Arc<Program>>::new();
    let mut given = BTreeMap::new();
    for node in chosen.nodes() {
        if !programs.contains_key(&node.binary) {
            programs.insert(node.binary.clone(), Arc::new(Program::read(node.binary.as_deref())?));
        }
        let (program, bundle) = (programs[&node.binary].clone(), pack(&chosen.inventory, node.id)?);
        given.insert(node.id, Payload { program, bundle });
    }
    Ok(given)
}

struct Installer<'a> {
    args: &'a InstallArgs,
    remote: Remote<'a>,
    given: &'a BTreeMap<VehicleName, Payload>,
    progress: &'a Progress,
}

/// Result for a node, and the restart of its vehicle if one is needed.
type Became<'a> = (InstalledNode, Option<Restart<'a>>);

impl Installer<'_> {
    /// Installs all nodes of a host, one after the other.
    fn on<'a>(&self, host: &Host, nodes: &[&'a Node]) -> Vec<Became<'a>> {
        let line = self.progress.line(host);
        // A probe and a copy for one node serve all nodes with the same folder and program.
        let mut places = BTreeMap::new();
        let mut all = Vec::new();
        for node in nodes {
            let begun = clock::now();
            let mut row = InstalledNode::new(node);
            let facts = match self.args.rollback {
                true => self.roll_back(host, node, &mut row),
                false => self.install(host, node, &mut row, &mut places, &line),
            };
            row.outcome.seconds = (clock::now() - begun).as_secs_f64();
            let restart = match facts {
                Ok(facts) => {
                    row.outcome.runs = facts.current.clone();
                    Restart::needed(host, node, &facts)
                }
                Err(why) => {
                    row.outcome.fail(why);
                    None
                }
            };
            line.say(&row.outcome.to_text());
            all.push((row, restart));
        }
        all
    }

    fn install(
        &self,
        host: &Host,
        node: &Node,
        row: &mut InstalledNode,
        places: &mut BTreeMap<(String, String), Result<(), String>>,
        line: &ProgressLine<'_>,
    ) -> Result<Facts, String> {
        let given = &self.given[&node.id];
        let place = (node.folder.clone(), given.program.release.clone());
        if !places.contains_key(&place) {
            let there = self.prepare(host, node, given, row, line);
            places.insert(place.clone(), there);
        }
        places[&place].clone()?;
        if self.args.dry_run {
            return self.foresee(host, node, given, row);
        }
        line.say(&format!("configuring node {}", node.id));
        let begun = clock::now();
        let setup = Setup { bundle: given.bundle.clone(), service: node.service, log: node.log.clone() };
        let ask = if self.args.take_over { Ask::TakeOver(setup) } else { Ask::Apply(setup) };
        let applied = self.remote.change_by(host, node, &given.program.release, ask);
        row.apply_s = (clock::now() - begun).as_secs_f64();
        let Change { changed, facts, .. } = done(host, applied)?;
        if facts.current.as_ref() != Some(&given.installed()) {
            return Err(format!("{host}: has {:?} now, not what it was given", facts.current));
        }
        row.outcome.done = match (changed || row.copied_bytes > 0, &facts.previous) {
            (false, _) => UNCHANGED,
            (true, None) => "installed",
            (true, Some(_)) => "upgraded",
        };
        Ok(facts)
    }

    /// Makes sure that the program is on this host, verified.
    fn prepare(
        &self,
        host: &Host,
        node: &Node,
        given: &Payload,
        row: &mut InstalledNode,
        line: &ProgressLine<'_>,
    ) -> Result<(), String> {
        let program = &given.program;
        line.say("asking what it is");
        let begun = clock::now();
        let probed = self.remote.probe(host, node, &program.release)?;
        row.probe_s = (clock::now() - begun).as_secs_f64();
        program.fits(&probed.platform, probed.glibc).map_err(|why| format!("{host}: {why}"))?;
        probed.folder.usable(program.bytes.len() as u64).map_err(|fault| format!("{host}: {fault}"))?;
        if probed.sum.as_ref() == Some(&program.sum) {
            return Ok(());
        }
        let size = program.bytes.len() as u64;
        if probed.free_bytes < size + ROOM {
            return Err(format!(
                "{host}: has {} free where {} is to be, and {} are needed; make room there, or set another `folder`",
                row::megabytes(probed.free_bytes),
                node.folder,
                row::megabytes(size + ROOM)
            ));
        }
        row.copied_bytes = size;
        if !self.args.dry_run {
            line.say(&format!("copying {}", row::megabytes(size)));
            let begun = clock::now();
            let copied = self.remote.copy(host, node, program);
            row.copy_s = (clock::now() - begun).as_secs_f64();
            copied?;
        }
        Ok(())
    }

    /// Determines what would be done on a node.
    fn foresee(&self, host: &Host, node: &Node, given: &Payload, row: &mut InstalledNode) -> Result<Facts, String> {
        let facts = match self.remote.facts(host, node) {
            Ok(facts) => facts,
            Err(Fault::NotInstalled) => Facts::default(),
            Err(Fault::Failed(why)) => return Err(why),
        };
        row.outcome.done = match &facts.current {
            None => "installed",
            Some(current) if *current == given.installed() && row.copied_bytes == 0 => UNCHANGED,
            Some(_) => "upgraded",
        };
        Ok(facts)
    }

    fn roll_back(&self, host: &Host, node: &Node, row: &mut InstalledNode) -> Result<Facts, String> {
        let change = done(host, self.remote.change(host, node, Ask::Rollback))?;
        row.outcome.done = if change.changed { "rolled-back" } else { UNCHANGED };
        Ok(change.facts)
    }
}

/// The result of a request that changes something; an agent that was ended in flight is a failure too.
fn done(host: &Host, change: Result<Change, Fault>) -> Result<Change, String> {
    match change {
        Ok(Change { forced: true, .. }) => Err(format!("{host}: {FORCED}")),
        change => change.map_err(|fault| fault.sentence(host)),
    }
}

#[cfg(test)]
#[cfg(unix)]
mod tests;
