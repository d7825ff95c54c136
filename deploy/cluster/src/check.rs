//! `skein check -f CLUSTER.toml`: reports what would prevent a flight of this cluster, each fault with its remedy.
//!
//! Keys are checked on this PC. Every host is asked over ssh, eight at once. Ports are called from this PC and from every host
//! that has the program. A host that hangs is given up after 7 s.

mod address;
mod clock;
mod host;
mod keys;
mod ports;

use std::path::Path;
use std::time::Duration;

use super::ssh::{CONNECT_S, Ssh, at_once, by_host};
use crate::findings::{Line, as_table, verdict};
use crate::inventory::{Inventory, Node};
use host::HostChecks;
use skein_lab::error::Error;

/// Time limit of a login, connecting included; a host that takes longer is not asked further.
const LOGIN: Duration = Duration::from_secs(CONNECT_S as u64 + 5);

impl Line {
    fn of(node: &Node, what: &'static str, found: impl Into<String>) -> Self {
        Self::new(format!("node {}", node.id), what, found)
    }

    fn of_fault(node: &Node, what: &'static str, sentence: &str, or: &str) -> Self {
        Self::of_sentence(format!("node {}", node.id), what, sentence, or)
    }

    /// Makes a fault from a sentence `what is wrong; what to do`; `or` is the remedy if the sentence has none.
    fn of_sentence(place: impl Into<String>, what: &'static str, sentence: &str, or: &str) -> Self {
        let (found, remedy) = sentence.split_once("; ").unwrap_or((sentence, or));
        Self::new(place, what, found).fault(remedy)
    }
}

/// Runs all checks and prints the results.
///
/// # Errors
/// If the cluster file or the scenario is wrong, or anything was found that would prevent a flight.
pub fn run(file: &Path, json: bool) -> Result<(), Error> {
    let inventory = Inventory::read(file)?;
    inventory.check_hosts()?;
    let lines = check_all(&inventory, &file.display().to_string());
    skein_lab::terminal::say(&if json { skein_lab::terminal::json(&lines) } else { as_table(&lines, true) });
    verdict(&lines)
}

/// Runs all checks.
fn check_all(inventory: &Inventory, file: &str) -> Vec<Line> {
    let hosts = by_host(inventory.nodes.values());
    let flown = &inventory.scenario.first().scenario;
    let count = |count: usize, what: &str| format!("{count} {what}{}", if count == 1 { "" } else { "s" });
    let found = format!("{} on {}: {}", count(inventory.nodes.len(), "node"), count(hosts.len(), "host"), flown.name);
    let mut lines = vec![Line::new("this PC", "inventory", found)];
    lines.extend(keys::lines(inventory, file));
    let ssh = Ssh::new(false);
    let programs = host::programs(inventory);
    let checks = HostChecks { inventory, ssh: &ssh, file, programs: &programs };
    // Call the ports from this PC while the hosts are asked.
    let (here, asked) = std::thread::scope(|scope| {
        let here = scope.spawn(|| ports::call_all(inventory));
        let asked = at_once(&hosts, |(host, nodes)| checks.host(host, nodes));
        (here.join().ok(), asked)
    });
    let mut calls: Vec<_> = here.into_iter().collect();
    let mut agents = std::collections::BTreeMap::new();
    for asked in asked {
        lines.extend(asked.lines);
        calls.extend(asked.calls);
        agents.extend(asked.agents);
    }
    let by_hand = inventory.nodes.values().filter(|node| node.host.is_none());
    lines.extend(by_hand.map(|node| Line::of(node, "ssh", "installed by hand: only its port is checked").unknown()));
    lines.extend(ports::lines(inventory, &calls, &agents));
    lines
}

#[cfg(test)]
#[cfg(unix)]
mod tests;
