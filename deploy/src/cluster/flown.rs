//! Which run of the swarm flies. A vehicle that is started joins that run and takes every order that was ever sealed for it, so
//! nobody's word alone decides it: a majority of the vehicles does, or the note that the operator keeps on this PC.

use std::collections::BTreeMap;

use skein_agent::link::seal::SealKey;
use skein_agent::link::seal::runs::RunNote;
use skein_common::id::{SwarmName, VehicleId};

use super::nodes::list;
use crate::keys::run::Record;
use crate::observe::majority;

/// What is known of the run that flies.
pub(super) struct Evidence<'a> {
    /// How many vehicles the swarm has.
    pub(super) vehicles: usize,
    /// The run that each vehicle is said to fly in: by itself over the mesh, or else by its host.
    pub(super) named: BTreeMap<VehicleId, u64>,
    /// The run that this PC began last.
    pub(super) own: Option<Record>,
    /// Notes of the operator that hosts were given, newest run first or not; only sealed ones count.
    pub(super) notes: &'a [RunNote],
}

impl Evidence<'_> {
    /// The run that more than half of the swarm's vehicles name.
    pub(super) fn majority(&self) -> Option<u64> {
        let named: Vec<u64> = self.named.values().copied().collect();
        majority(&named, self.vehicles)
    }

    /// The run to join; `None` to begin one, because no vehicle is said to fly.
    ///
    /// # Errors
    /// One sentence, with what to do about it, if vehicles are said to fly in a run that neither is proven: a new run beside
    /// theirs would bring two swarms into one sky, and theirs may be an old one with orders of its own.
    pub(super) fn run(&self, key: &SealKey, swarm: &SwarmName) -> Result<Option<u64>, String> {
        if let Some(run) = self.majority() {
            return Ok(Some(run));
        }
        if self.named.is_empty() {
            return Ok(None);
        }
        let newer = |own: &Record| {
            let sealed = self.notes.iter().filter(|note| note.is_sealed(key, swarm));
            sealed.max_by_key(|note| note.began_ms).filter(|note| note.began_ms > own.note.began_ms)
        };
        let names_own = |own: &Record| self.named.values().any(|run| *run == own.note.run);
        let why = match &self.own {
            Some(own) if !own.note.is_sealed(key, swarm) => {
                "the note of the run begun here is of another key".to_owned()
            }
            Some(own) if !names_own(own) => format!("the run begun here last is {}", own.note.run),
            Some(own) if own.over => format!("run {} was ordered to land, or has ended", own.note.run),
            Some(own) => match newer(own) {
                Some(newer) => format!("run {} was begun later from another PC", newer.run),
                None => return Ok(Some(own.note.run)),
            },
            None => "no run was begun from this PC".to_owned(),
        };
        Err(format!(
            "it is not sure which run flies: {}, but {why}, and no run has a majority of the {} vehicles. `skein cluster down` \
             lands whatever flies; then `skein cluster up`. A node that names an old run even then is not to be trusted: take it \
             out of the cluster's file and revoke its key",
            self.in_words(),
            self.vehicles
        ))
    }

    /// `node 1, 2 in run 7; node 3 in run 8`
    fn in_words(&self) -> String {
        let mut runs = BTreeMap::<u64, Vec<VehicleId>>::new();
        self.named.iter().for_each(|(id, run)| runs.entry(*run).or_default().push(*id));
        let words = runs.iter().map(|(run, ids)| format!("node {} in run {run}", list(ids)));
        format!("{} said to fly", words.collect::<Vec<_>>().join("; "))
    }
}

#[cfg(test)]
mod tests;
