//! Determines which run the swarm flies in. A vehicle that is started joins that run and obeys every order that was
//! ever signed for it, so no single vehicle's report decides: either a majority of the vehicles reports the run, or the
//! operator's record on this PC names it.

use std::collections::BTreeMap;

use skein_agent::link::signature::VerificationKey;
use skein_agent::link::signature::runs::RunNote;
use skein_common::id::{SwarmName, VehicleName};

use super::nodes::list;
use crate::keys::run::Record;
use crate::mesh::observe::majority;

/// The evidence for the run that the swarm flies in.
pub(super) struct Evidence<'a> {
    /// Number of vehicles in the swarm.
    pub(super) vehicles: usize,
    /// The run that each vehicle flies in, as reported by itself over the mesh, or else by its host.
    pub(super) reported: BTreeMap<VehicleName, u64>,
    /// This PC's record of the run that it began last.
    pub(super) own: Option<Record>,
    /// Notes of runs by the operator that the hosts keep, in any order; only signed notes are used.
    pub(super) notes: &'a [RunNote],
}

impl Evidence<'_> {
    /// The run that more than half of the swarm's vehicles report.
    pub(super) fn majority(&self) -> Option<u64> {
        let reported: Vec<u64> = self.reported.values().copied().collect();
        majority(&reported, self.vehicles)
    }

    /// Returns the run to join; `None` to begin a new run, because no vehicle is reported to fly.
    ///
    /// # Errors
    /// If vehicles are reported to fly in a run that cannot be proven, with the remedy: a new run beside theirs would
    /// be two swarms in the same airspace, and their run may be an old one with old orders.
    pub(super) fn run(&self, key: &VerificationKey, swarm: &SwarmName) -> Result<Option<u64>, String> {
        if let Some(run) = self.majority() {
            return Ok(Some(run));
        }
        if self.reported.is_empty() {
            return Ok(None);
        }
        let newer = |own: &Record| {
            let signed = self.notes.iter().filter(|note| note.is_signed(key, swarm));
            signed.max_by_key(|note| note.began_ms).filter(|note| note.began_ms > own.note.began_ms)
        };
        let reports_own = |own: &Record| self.reported.values().any(|run| *run == own.note.run);
        let why = match &self.own {
            Some(own) if !own.note.is_signed(key, swarm) => {
                "the record of the run begun from this PC is signed with another key".to_owned()
            }
            Some(own) if !reports_own(own) => format!("the run begun last from this PC is {}", own.note.run),
            Some(own) if own.over => format!("run {} was ordered to land, or has ended", own.note.run),
            Some(own) => match newer(own) {
                Some(newer) => format!("run {} was begun later from another PC", newer.run),
                None => return Ok(Some(own.note.run)),
            },
            None => "no run was begun from this PC".to_owned(),
        };
        Err(format!(
            "the run in flight cannot be determined: {}, but {why}, and no run has a majority of the {} vehicles. Run \
             `skein cluster down`, which lands every vehicle, then `skein cluster up`. Do not trust a node that still reports \
             an old run after that: remove it from the cluster file and revoke its key",
            self.to_text(),
            self.vehicles
        ))
    }

    /// Formats the reports: `node 1, 2 in run 7; node 3 in run 8 reported to fly`.
    fn to_text(&self) -> String {
        let mut runs = BTreeMap::<u64, Vec<VehicleName>>::new();
        self.reported.iter().for_each(|(id, run)| runs.entry(*run).or_default().push(*id));
        let parts = runs.iter().map(|(run, ids)| format!("node {} in run {run}", list(ids)));
        format!("{} reported to fly", parts.collect::<Vec<_>>().join("; "))
    }
}

#[cfg(test)]
mod tests;
