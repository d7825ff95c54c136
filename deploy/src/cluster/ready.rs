//! Waiting on the mesh until vehicles say by themselves that they take part, or are gone: not because ssh said so.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use skein_common::id::{Incarnation, VehicleId};
use skein_common::state::Membership;

use crate::observe::{Observer, Seen, Steps};
use crate::reach::Reach;
use skein_host::clock;
use skein_lab::error::Error;

/// Whoever flies is heard within this time.
pub const HEARD: Duration = Duration::from_secs(3);
/// How often what was heard is looked at.
pub(super) const LOOK: Duration = Duration::from_millis(10);

/// Listens to a swarm.
pub struct Watch {
    /// With what is known of every vehicle.
    pub observer: Observer,
    /// What was last waited for was that of this run of the swarm.
    pub run: u64,
}

impl Watch {
    /// Listens.
    ///
    /// # Errors
    /// If Zenoh refuses.
    pub fn open(reach: &Reach, run: u64) -> Result<Self, Error> {
        Ok(Self { observer: Observer::open(reach, Steps::Off)?, run })
    }

    /// What keeps this vehicle from being ready, in words; in a life after this one.
    pub fn lacks(&self, id: VehicleId, after: Option<Incarnation>) -> Option<String> {
        lacks(self.observer.vehicles().get(&id), self.run, after)
    }

    /// The run that each vehicle in contact flies in, by its own word, where runs are sealed.
    pub fn named_runs(&mut self) -> BTreeMap<VehicleId, u64> {
        self.observer.poll();
        let there = self.observer.vehicles().iter().filter(|(_, view)| view.alive);
        there.filter_map(|(id, view)| Some((*id, view.run.filter(|run| *run != 0)?))).collect()
    }

    /// In which life it is now: it is given a moment to be heard.
    pub fn life(&mut self, id: VehicleId) -> Option<Incarnation> {
        let until = clock::now() + HEARD;
        loop {
            self.observer.poll();
            let said = self.observer.vehicles().get(&id).and_then(|view| view.mission.as_ref());
            if said.is_some() || clock::now() >= until {
                return said.map(|said| said.header.incarnation);
            }
            clock::sleep(LOOK);
        }
    }

    /// Whether its token is there.
    pub fn is_there(&self, id: VehicleId) -> bool {
        self.observer.vehicles().get(&id).is_some_and(|view| view.alive)
    }

    /// Waits until all of these are ready, each in a life after the one given with it; for each until its own `until`. Tells
    /// each as it comes. Gives who is not.
    pub fn ready(
        &mut self,
        ids: &BTreeMap<VehicleId, Option<Incarnation>>,
        until: impl Fn(VehicleId) -> Instant,
        mut tell: impl FnMut(VehicleId),
    ) -> BTreeSet<VehicleId> {
        let mut missing: BTreeSet<VehicleId> = ids.keys().copied().collect();
        loop {
            self.observer.poll();
            missing.retain(|id| {
                let is_missing = self.lacks(*id, ids[id]).is_some();
                if !is_missing {
                    tell(*id);
                }
                is_missing
            });
            let now = clock::now();
            if missing.iter().all(|id| now >= until(*id)) {
                return missing;
            }
            clock::sleep(LOOK);
        }
    }

    /// Waits until none of these has a token any more, until `until`. Tells each as it goes. Gives who is still there.
    pub fn gone(
        &mut self,
        ids: &BTreeSet<VehicleId>,
        until: Instant,
        mut tell: impl FnMut(VehicleId),
    ) -> BTreeSet<VehicleId> {
        let mut told = BTreeSet::new();
        loop {
            self.observer.poll();
            // One that was only lost for a moment comes back, and is waited for again.
            let (there, gone): (BTreeSet<_>, BTreeSet<_>) = ids.iter().partition(|id| self.is_there(**id));
            for id in &gone {
                if told.insert(*id) {
                    tell(*id);
                }
            }
            if there.is_empty() || clock::now() >= until {
                return there;
            }
            clock::sleep(LOOK);
        }
    }
}

fn lacks(view: Option<&Seen>, run: u64, after: Option<Incarnation>) -> Option<String> {
    let Some((view, true)) = view.map(|view| (view, view.alive)) else {
        return Some("not heard on the network".to_owned());
    };
    let Some(mission) = &view.mission else { return Some("there, but silent".to_owned()) };
    if after.is_some_and(|before| mission.header.incarnation <= before) {
        return Some("not started again".to_owned());
    }
    if view.run.is_some_and(|said| said != run) {
        return Some("flies in another run of the swarm; `skein cluster down` first".to_owned());
    }
    match mission.membership {
        Membership::Active if view.health.is_some() && view.health_run.is_none_or(|said| said == run) => None,
        Membership::Active => Some("does not tell how it does".to_owned()),
        Membership::Joining => Some("joins still: it waits for its simulator, or listens".to_owned()),
        Membership::Left => Some("has landed for good".to_owned()),
    }
}

#[cfg(test)]
mod tests;
