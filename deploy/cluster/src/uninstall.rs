//! `skein cluster uninstall`: removes everything that `install` put on the nodes. It refuses while a vehicle flies,
//! unless the vehicles are to be landed first.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;
use skein_common::id::VehicleName;

use super::down;
use super::nodes::{self, NodesArgs, Outcome, is_seconds};
use super::protocol::{Answer, Ask, FORCED};
use super::remote::{Fault, Remote};
use super::ssh::{Host, at_once};
use crate::inventory::Node;
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
    /// How long the vehicles may take to land, s; without it long enough for the scenario's greatest height
    #[arg(long = "timeout", value_name = "S", value_parser = is_seconds, requires = "force")]
    pub timeout_s: Option<f64>,
}

/// Result of the command.
#[derive(Debug, Serialize)]
struct UninstallReport {
    swarm: String,
    /// Total duration, s.
    seconds: f64,
    nodes: Vec<Outcome>,
}

/// Runs the command.
///
/// # Errors
/// If a vehicle flies, and then nothing is done; if the cluster file is wrong, or any node failed.
pub fn run(args: &UninstallArgs) -> Result<(), Error> {
    let chosen = args.nodes.read()?;
    let ssh = args.nodes.ssh();
    let progress = args.nodes.progress();
    let remote = Remote { ssh: &ssh, swarm: &chosen.inventory.swarm };
    let hosts = chosen.hosts();
    let within_s = args.timeout_s.unwrap_or_else(|| chosen.inventory.landing_s());
    let asked = at_once(&hosts, |(host, nodes)| {
        progress.line(host).say("asking what runs");
        let flies = |node: &&Node| (node.id, flies(host, remote.ask(host, node, Ask::Facts)));
        nodes.iter().map(flies).collect::<Vec<_>>()
    });
    let asked: BTreeMap<VehicleName, Result<bool, String>> = asked.into_iter().flatten().collect();
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
    let removed = at_once(&hosts, |(host, nodes)| {
        let line = progress.line(host);
        line.say("taking away");
        let mut all = Vec::new();
        for node in nodes {
            let begun = clock::now();
            let mut outcome = Outcome::new(node);
            let removed = match asked.get(&node.id) {
                // It is unknown whether this vehicle flies.
                Some(Err(why)) => Err(Fault::Failed(why.clone())),
                _ => remote.ask(host, node, Ask::Remove { within_s }),
            };
            match removed {
                Ok(Answer::Done { forced: by_force, .. }) if by_force || forced.contains(&node.id) => {
                    outcome.fail(format!("removed, but {FORCED}"));
                }
                Ok(Answer::Done { changed: true, .. }) => outcome.done = "removed",
                Ok(Answer::Done { changed: false, .. }) | Err(Fault::NotInstalled) => {
                    outcome.done = "nothing was there"
                }
                Ok(other) => outcome.fail(format!("{host}: answers {other:?}")),
                Err(Fault::Failed(why)) => outcome.fail(why),
            }
            outcome.seconds = (clock::now() - begun).as_secs_f64();
            line.say(&outcome.to_text());
            all.push(outcome);
        }
        all
    });
    // Close after all are done, because two names of one host share a connection.
    hosts.iter().for_each(|(host, _)| ssh.close(host));
    let mut outcomes: Vec<Outcome> = removed.into_iter().flatten().collect();
    outcomes.extend(chosen.manual().map(|node| {
        let mut outcome = Outcome::new(node);
        outcome.done = "left";
        outcome.note = Some("installed by hand: delete its folder there".to_owned());
        outcome
    }));
    outcomes.sort_by_key(|outcome| outcome.node);
    let seconds = progress.seconds();
    drop(progress);
    let report = UninstallReport { swarm: chosen.inventory.swarm.to_string(), seconds, nodes: outcomes };
    skein_lab::terminal::say(&if args.nodes.json {
        skein_lab::terminal::json(&report)
    } else {
        Outcome::table(&report.nodes)
    });
    Outcome::fail_if_any(&report.nodes, "failed")
}

/// Returns whether a node's vehicle flies, or why that is unknown.
fn flies(host: &Host, answer: Result<Answer, Fault>) -> Result<bool, String> {
    match answer {
        Ok(Answer::Facts(facts)) => Ok(facts.agent.is_some()),
        Err(Fault::NotInstalled) => Ok(false),
        Ok(other) => Err(format!("{host}: answers {other:?}")),
        Err(Fault::Failed(why)) => Err(why),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::Facts;
    use crate::ssh::tests::heli;

    #[test]
    fn a_vehicle_whose_host_does_not_answer_may_be_flying() {
        let flies = |answer| flies(&heli("heli1"), answer);
        assert_eq!(flies(Ok(Answer::Facts(Facts::default()))), Ok(false));
        assert_eq!(flies(Err(Fault::NotInstalled)), Ok(false));
        assert_eq!(flies(Err(Fault::Failed("no route".to_owned()))), Err("no route".to_owned()));
        assert!(flies(Ok(Answer::Failed("busy".to_owned()))).is_err());
    }
}
