//! `skein cluster uninstall`: removes everything that `install` put on the nodes. It refuses while a vehicle flies,
//! unless the vehicles are to be landed first.

use std::collections::{BTreeMap, BTreeSet};

use skein_common::id::VehicleName;

use super::down;
use super::nodes::{self, NodesArgs, Outcome, is_seconds};
use super::protocol::{Ask, Change, FORCED, Facts};
use super::remote::{Fault, Remote};
use skein_host::clock;
use skein_lab::error::Error;

/// `skein cluster uninstall`
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  skein cluster uninstall\n  skein cluster uninstall -f cluster.toml --node 3")]
pub struct UninstallArgs {
    /// The nodes.
    #[command(flatten)]
    pub nodes: NodesArgs,
    /// Land vehicles that fly first; without it nothing is done while one does
    #[arg(long)]
    pub force: bool,
    /// Time limit for the vehicles to land, s; without it long enough for the scenario's greatest height
    #[arg(long = "timeout", value_name = "S", value_parser = is_seconds, requires = "force")]
    pub timeout_s: Option<f64>,
}

/// Runs the command.
///
/// # Errors
/// If a vehicle flies, and then nothing is done; if the cluster file is wrong, or any node failed.
pub fn run(args: &UninstallArgs) -> Result<(), Error> {
    let (chosen, ssh, progress) = args.nodes.begin()?;
    let remote = Remote { ssh: &ssh, swarm: &chosen.inventory.swarm };
    let hosts = chosen.hosts();
    let within_s = args.timeout_s.unwrap_or_else(|| chosen.inventory.landing_s());
    let asking = Some("asking what runs");
    let asked = nodes::at_each(&hosts, &progress, asking, |host, node, _| flies(remote.facts(host, node)));
    let asked: BTreeMap<VehicleName, Result<bool, String>> = asked.into_iter().collect();
    let flying: Vec<VehicleName> = asked.iter().filter(|(_, flies)| **flies == Ok(true)).map(|(id, _)| *id).collect();
    let mut forced = BTreeSet::new();
    if !flying.is_empty() {
        if !args.force {
            return Err(Error::Refused(format!(
                "vehicles fly (node {}): land them with `skein cluster down`, or give --force; nothing was taken away",
                nodes::list(&flying)
            )));
        }
        forced = down::land(&chosen, &ssh, &progress, args.timeout_s)?.forced;
    }
    let removed = nodes::at_each(&hosts, &progress, None, |host, node, line| {
        let begun = clock::now();
        let mut outcome = Outcome::new(node);
        let removed = match asked.get(&node.id) {
            // It is unknown whether this vehicle flies.
            Some(Err(why)) => Err(Fault::Failed(why.clone())),
            _ => remote.change(host, node, Ask::Remove { within_s }),
        };
        let removed = removed.and_then(|change| remote.clear(host, node).map(|()| change).map_err(Fault::Failed));
        match removed {
            Ok(change) if change.forced || forced.contains(&node.id) => outcome.fail(format!("removed, but {FORCED}")),
            Ok(Change { changed: true, .. }) => outcome.done = "removed",
            Ok(_) | Err(Fault::NotInstalled) => outcome.done = "nothing was there",
            Err(Fault::Failed(why)) => outcome.fail(why),
        }
        outcome.seconds = (clock::now() - begun).as_secs_f64();
        line.say(&outcome.to_text());
        outcome
    });
    // Close after all are done, because two names of one host share a connection.
    hosts.iter().for_each(|(host, _)| ssh.close(host));
    let note = || Some("installed by hand: delete its folder there".to_owned());
    let left = chosen.manual().map(|node| Outcome { done: "left", note: note(), ..Outcome::new(node) });
    let mut outcomes: Vec<Outcome> = removed.into_iter().map(|(_, outcome)| outcome).chain(left).collect();
    outcomes.sort_by_key(|outcome| outcome.node);
    args.nodes.end(&chosen, progress, (None, &outcomes), "failed")
}

/// Returns whether a node's vehicle flies, or why that is unknown.
fn flies(facts: Result<Facts, Fault>) -> Result<bool, String> {
    match facts {
        Ok(facts) => Ok(facts.agent.is_some()),
        Err(Fault::NotInstalled) => Ok(false),
        Err(Fault::Failed(why)) => Err(why),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn a_vehicle_whose_host_does_not_answer_may_be_flying() {
        assert_eq!(flies(Ok(Facts::default())), Ok(false));
        assert_eq!(flies(Err(Fault::NotInstalled)), Ok(false));
        assert_eq!(flies(Err(Fault::Failed("no route".to_owned()))), Err("no route".to_owned()));
    }
}
