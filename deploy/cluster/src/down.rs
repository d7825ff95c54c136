//! `skein cluster down`: orders the swarm to land over the mesh, which reaches all vehicles in contact; and over ssh it
//! ends every agent after the landing, so that nothing restarts it.

use std::collections::{BTreeMap, BTreeSet};
use std::thread;
use std::time::Duration;

use crate::keys::Role;
use skein_common::id::{VehicleId, VehicleName};
use skein_common::message::Verb;

use super::nodes::{self, ChosenNodes, NodesArgs, Outcome, Progress, ProgressLine, is_seconds};
use super::protocol::{Ask, Change, FORCED};
use super::remote::{Fault, Remote};
use super::ssh::{Host, Ssh};
use crate::inventory::Node;
use crate::keys::run::RunFile;
use crate::mesh::observe::Observer;
use crate::mesh::order;
use crate::mesh::reach::Reach;
use crate::mesh::ready::Watch;
use skein_host::clock;
use skein_host::parallel::at_once;
use skein_lab::error::Error;

/// Text for a node without ssh, if no order was sent over the mesh.
const NOT_ORDERED: &str = "installed by hand, and not ordered to land: end it there, or land all with `skein cluster down` or `skein order land`";

/// `skein cluster down`
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  skein cluster down\n  skein cluster down -f cluster.toml --node 3")]
pub struct DownArgs {
    /// The nodes.
    #[command(flatten)]
    pub nodes: NodesArgs,
    /// Time limit for the vehicles to land, s; then agents are ended wherever they are. Without it long enough for the scenario's
    /// greatest height
    #[arg(long = "timeout", value_name = "S", value_parser = is_seconds)]
    pub timeout_s: Option<f64>,
}

/// Runs the command.
///
/// # Errors
/// If the cluster file is wrong, or the landing and end of any vehicle is not confirmed.
pub fn run(args: &DownArgs) -> Result<(), Error> {
    let (chosen, ssh, progress) = args.nodes.begin()?;
    let landed = land(&chosen, &ssh, &progress, args.timeout_s)?;
    args.nodes.end(&chosen, progress, (Some(landed.order), &landed.nodes), "not known to be down")?;
    match RunFile::of(&chosen.inventory) {
        Some(file) if chosen.ids.len() == chosen.inventory.nodes.len() => file.note_end(),
        _ => Ok(()),
    }
}

/// Result of landing the vehicles.
pub(super) struct Landed {
    pub(super) order: String,
    pub(super) nodes: Vec<Outcome>,
    /// Vehicles whose agent was ended before they had landed.
    pub(super) forced: BTreeSet<VehicleName>,
}

/// Lands the chosen vehicles and ends their agents.
///
/// # Errors
/// If the swarm cannot be observed.
pub(super) fn land(
    chosen: &ChosenNodes,
    ssh: &Ssh,
    progress: &Progress,
    timeout_s: Option<f64>,
) -> Result<Landed, Error> {
    let timeout_s = timeout_s.unwrap_or_else(|| chosen.inventory.landing_s());
    let until = clock::now() + Duration::from_secs_f64(timeout_s);
    let all = chosen.ids.len() == chosen.inventory.nodes.len();
    let line = progress.line(&"swarm");
    let (mut watch, order) = match chosen.inventory.reaches(Role::Operator) {
        // An order over the mesh is for all vehicles.
        Ok(reaches) if all => {
            let mut watch = Watch::open(&reaches, 0)?;
            let order = order_to_land(&mut watch, &reaches, &line);
            (Some(watch), order)
        }
        Ok(_) => (None, "landed each by its own host".to_owned()),
        Err(error) => (None, format!("landed each by its own host, without an order ({error})")),
    };
    line.say(&order);
    let was_ordered = watch.is_some();
    let received: BTreeSet<VehicleName> = match &watch {
        Some(watch) => chosen.ids.iter().copied().filter(|id| watch.is_there(*id)).collect(),
        None => BTreeSet::new(),
    };
    let remote = Remote { ssh, swarm: &chosen.inventory.swarm };
    let (still, stopped) = thread::scope(|scope| {
        let still = scope.spawn(|| {
            let gone = |id| line.say(&format!("node {id} has landed and is gone"));
            watch.as_mut().map_or_else(BTreeSet::new, |watch| watch.gone(&received, until, gone))
        });
        let stopped = stop_all(chosen, &remote, progress, timeout_s);
        (still.join().unwrap_or_else(|_| received.clone()), stopped)
    });
    let forced = stopped.iter().filter(|(_, (done, _))| *done == Ok(Stopped::Forced)).map(|(id, _)| *id).collect();
    let nodes = chosen.nodes().map(|node| {
        let received = match (was_ordered, received.contains(&node.id)) {
            (_, true) if still.contains(&node.id) => Mesh::There,
            (_, true) => Mesh::Gone,
            (true, false) => Mesh::Silent,
            (false, false) => Mesh::NotAsked,
        };
        let (done, seconds) = stopped.get(&node.id).cloned().unzip();
        Outcome { seconds: seconds.unwrap_or_default(), ..became(node, received, done) }
    });
    Ok(Landed { order, nodes: nodes.collect(), forced })
}

/// State of a vehicle on the mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mesh {
    /// It was ordered to land and is still in contact.
    There,
    /// It was ordered to land and has left the mesh.
    Gone,
    /// All vehicles were ordered to land, but this one was not in contact.
    Silent,
    /// No order was sent over the mesh.
    NotAsked,
}

/// Result for a node, from the mesh and from its host, if it has ssh.
fn became(node: &Node, mesh: Mesh, done: Option<Result<Stopped, Fault>>) -> Outcome {
    let mut outcome = Outcome::new(node);
    let was_in_contact = matches!(mesh, Mesh::There | Mesh::Gone);
    match done {
        Some(Ok(Stopped::Forced)) => outcome.fail(FORCED.to_owned()),
        Some(Ok(Stopped::Landed)) => outcome.done = "landed",
        Some(Ok(Stopped::Nothing)) => outcome.done = if was_in_contact { "landed" } else { "was not running" },
        Some(Err(Fault::NotInstalled)) => outcome.done = "nothing is installed",
        Some(Err(Fault::Failed(why))) if mesh == Mesh::Gone => {
            outcome.done = "landed";
            outcome.note = Some(format!("ordered over the network, and gone from it; {why}"));
        }
        Some(Err(Fault::Failed(why))) => outcome.fail(why),
        None => match mesh {
            Mesh::Gone => outcome.done = "landed",
            Mesh::There => outcome.fail("is still on the network".to_owned()),
            Mesh::Silent => outcome.done = "was not in contact",
            Mesh::NotAsked => outcome.fail(NOT_ORDERED.to_owned()),
        },
    }
    outcome
}

/// Sends the order to land, to all teams at once, and describes the result.
fn order_to_land(watch: &mut Watch, reaches: &[Reach], line: &ProgressLine<'_>) -> String {
    line.say("listening who flies");
    let observers = watch.observers.each();
    order::wait_for_heartbeats(observers, reaches);
    let there = observers.iter().flat_map(|observer| observer.vehicles().values()).filter(|view| view.alive).count();
    if there == 0 {
        return "no vehicle was in contact on the network".to_owned();
    }
    line.say(&format!("ordering {there} vehicles to land"));
    reaches.iter().take(1).for_each(|reach| order::note_order(reach, Verb::Land));
    let land = |observer: &mut Observer| {
        let order = order::new_order(observer, Verb::Land);
        let (taken, unresponsive) = order::distribute(observer, std::slice::from_ref(&order))?;
        let named = |ids: Vec<VehicleId>| ids.into_iter().map(|id| observer.branch().name(id)).collect::<Vec<_>>();
        Ok::<_, Error>((named(taken), named(unresponsive)))
    };
    let results = at_once(observers.iter_mut().map(|observer| || land(observer)));
    let (mut taken, mut unresponsive, mut failures) = (Vec::new(), Vec::new(), Vec::new());
    for result in results {
        match result {
            Ok(of_team) => {
                taken.extend(of_team.0);
                unresponsive.extend(of_team.1);
            }
            Err(error) => failures.push(format!("not ordered to land: {error}")),
        }
    }
    let mut parts = Vec::new();
    if !taken.is_empty() || !unresponsive.is_empty() {
        let not = if unresponsive.is_empty() { "" } else { &format!(", not by {}", nodes::list(&unresponsive)) };
        parts.push(format!("ordered to land: taken by node {}{not}", nodes::list(&taken)));
    }
    parts.extend(failures);
    parts.join("; ")
}

/// The result of ending an agent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stopped {
    /// After its vehicle had landed.
    Landed,
    /// Before its vehicle had landed, because the time was up.
    Forced,
    /// No agent was running.
    Nothing,
}

/// Result for each node, and how long it took, s.
type ByHost = BTreeMap<VehicleName, (Result<Stopped, Fault>, f64)>;

/// Ends every agent over ssh, after its landing, so that nothing restarts it.
fn stop_all(chosen: &ChosenNodes, remote: &Remote<'_>, progress: &Progress, within_s: f64) -> ByHost {
    let stop = |host: &Host, node: &Node, line: &ProgressLine<'_>| {
        let begun = clock::now();
        let done = remote.change(host, node, Ask::Stop { within_s }).map(|change| match change {
            Change { forced: true, .. } => Stopped::Forced,
            Change { changed: true, .. } => Stopped::Landed,
            Change { changed: false, .. } => Stopped::Nothing,
        });
        line.say(&match &done {
            Ok(Stopped::Landed) => format!("node {} landed", node.id),
            Ok(Stopped::Forced) => format!("node {} {FORCED}", node.id),
            Ok(Stopped::Nothing) => format!("node {} does not run", node.id),
            Err(fault) => fault.clone().sentence(host),
        });
        (done, (clock::now() - begun).as_secs_f64())
    };
    let waiting = "waiting until its vehicles have landed";
    nodes::at_each(&chosen.hosts(), progress, Some(waiting), stop).into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ssh::tests::node;

    #[test]
    fn only_a_vehicle_that_has_landed_is_reported_as_landed() {
        let text = |host, mesh, done| {
            let outcome = became(&node(1, host), mesh, done);
            outcome.why.unwrap_or_else(|| outcome.done.to_owned())
        };
        let ssh = |mesh, done| text(Some("heli1"), mesh, Some(done));
        assert_eq!(ssh(Mesh::Gone, Ok(Stopped::Landed)), "landed");
        assert_eq!(ssh(Mesh::NotAsked, Ok(Stopped::Landed)), "landed");
        assert_eq!(ssh(Mesh::Gone, Ok(Stopped::Nothing)), "landed");
        assert_eq!(ssh(Mesh::Silent, Ok(Stopped::Nothing)), "was not running");
        assert_eq!(ssh(Mesh::Gone, Ok(Stopped::Forced)), FORCED, "gone, and not because it had landed");
        assert_eq!(ssh(Mesh::Gone, Err(Fault::Failed("no route".to_owned()))), "landed");
        assert_eq!(ssh(Mesh::There, Err(Fault::Failed("no route".to_owned()))), "no route");
        assert_eq!(text(None, Mesh::Gone, None), "landed");
        assert_eq!(text(None, Mesh::There, None), "is still on the network");
        assert_eq!(text(None, Mesh::Silent, None), "was not in contact");
        assert_eq!(text(None, Mesh::NotAsked, None), NOT_ORDERED);
    }
}
