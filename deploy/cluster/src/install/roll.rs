//! Restarts the vehicles that run something else than what is installed on their node now: one after the other lands,
//! starts again, has to report over the mesh that it is an active member, and takes off, before the next one lands. If a
//! vehicle does not return, its earlier version is restored and the roll stops.

use std::collections::BTreeMap;
use std::time::Duration;

use crate::keys::Role;
use skein_agent::link::signature::runs::RunNote;
use skein_common::id::VehicleName;

use super::done;
use super::row::{InstalledNode, UNCHANGED};
use crate::inventory::{Inventory, Node};
use crate::mesh::ready::Watch;
use crate::nodes::{Progress, ProgressLine};
use crate::protocol::{Ask, Facts};
use crate::remote::Remote;
use crate::ssh::Host;
use skein_host::clock;
use skein_lab::error::Error;

/// An agent to be restarted.
#[derive(Clone, Debug)]
pub(super) struct Restart<'a> {
    pub(super) host: Host,
    pub(super) node: &'a Node,
    /// The run of the swarm that it flies in.
    pub(super) run: u64,
    /// The operator's note of that run.
    pub(super) note: Option<RunNote>,
    /// Time limit for a landing in the scenario that it flies now, s.
    pub(super) landing_s: f64,
}

impl<'a> Restart<'a> {
    /// Returns the restart that a node needs, if its agent runs something else than what is current.
    pub(super) fn needed(host: &Host, node: &'a Node, facts: &Facts) -> Option<Self> {
        let agent = facts.agent.as_ref().filter(|agent| Some(&agent.installed) != facts.current.as_ref())?;
        Some(Self { host: host.clone(), node, run: agent.run, note: facts.note, landing_s: agent.landing_s })
    }
}

/// Restarts the agents one after the other; the result of each is written to its row.
pub(super) fn roll(
    remote: &Remote<'_>,
    inventory: &Inventory,
    restarts: &[Restart<'_>],
    timeout_s: f64,
    progress: &Progress,
    rows: &mut BTreeMap<VehicleName, InstalledNode>,
) -> Result<(), Error> {
    let mut watch = Watch::open(&inventory.reaches(Role::Observer)?, 0)?;
    let within = Duration::from_secs_f64(timeout_s);
    let stopped = until_one_fails(restarts, |restart| {
        let Some(row) = rows.get_mut(&restart.node.id) else { return true };
        let line = progress.line(&format!("node {}", restart.node.id));
        let begun = clock::now();
        watch.run = restart.run;
        // The scenario that it flies may be higher than the one that is installed now.
        let landing_s = inventory.landing_s().max(restart.landing_s);
        let incarnation = watch.incarnation(restart.node.id);
        let flew = watch.flies(restart.node.id);
        let ask = |ask| done(&restart.host, remote.change(&restart.host, restart.node, ask));
        let mut comes_back = |line: &ProgressLine<'_>| {
            ask(Ask::Stop { within_s: landing_s })?;
            line.say("landed, starting");
            ask(Ask::Start { run: restart.run, note: restart.note })?;
            let until = clock::now() + within;
            let missing = watch.ready(&BTreeMap::from([(restart.node.id, incarnation)]), |_| until, |_| {});
            if !missing.is_empty() {
                let why = watch.lacks(restart.node.id, incarnation).unwrap_or_default();
                return Err(format!("not ready within {timeout_s} s: {why}"));
            }
            // A climb takes no longer than a landing may take.
            let until = clock::now() + within + Duration::from_secs_f64(landing_s);
            if flew && !watch.has_taken_off(restart.node.id, incarnation, until) {
                return Err(format!("ready, but not in the air again within {} s", timeout_s + landing_s));
            }
            Ok(())
        };
        line.say("landing, to be restarted");
        let came_back = comes_back(&line);
        if let Err(why) = &came_back {
            line.say(&format!("{why}; bringing back what it had"));
            let back = ask(Ask::Rollback).and_then(|change| {
                row.outcome.runs = change.facts.current;
                comes_back(&line)
            });
            row.outcome.fail(match back {
                Ok(()) => format!("{why}; it flies again with what it had, and the roll has stopped"),
                Err(again) => format!("{why}; with what it had: {again}; the roll has stopped"),
            });
        } else if row.outcome.done == UNCHANGED {
            row.outcome.note = Some("restarted: it still flew what was before".to_owned());
        }
        row.restart_s = Some((clock::now() - begun).as_secs_f64());
        line.say(row.outcome.why.as_deref().unwrap_or("ready again"));
        came_back.is_ok()
    });
    let Some((at, rest)) = stopped else { return Ok(()) };
    for left in rest {
        let why = format!("flies on with what it had: the roll stopped at node {}", at.node.id);
        rows.entry(left.node.id).and_modify(|row| row.outcome.why = Some(why));
    }
    Ok(())
}

/// Restarts one after the other, in this order, until one does not come back. Returns that one and those behind it, which are left
/// alone.
pub(crate) fn until_one_fails<T>(all: &[T], mut comes_back: impl FnMut(&T) -> bool) -> Option<(&T, &[T])> {
    let failed = all.iter().position(|one| !comes_back(one))?;
    Some((&all[failed], &all[failed + 1..]))
}
