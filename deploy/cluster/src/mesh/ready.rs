//! Waits until vehicles report on the mesh that they are active members, or until they have left the mesh: the result
//! of an ssh command proves neither.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use skein_common::id::{Incarnation, VehicleName};
use skein_common::state::{Activity, Membership};

use crate::mesh::observe::{Observers, VehicleView};
use crate::mesh::reach::Reach;
use skein_host::clock;
use skein_lab::error::Error;

/// Time within which every vehicle in flight is in contact.
pub const CONTACT_TIMEOUT: Duration = Duration::from_secs(3);
/// Interval at which received messages are read.
pub(crate) const POLL_PERIOD: Duration = Duration::from_millis(10);

/// Observes a swarm or a fleet until vehicles reach a state.
pub struct Watch {
    /// The observers, with the newest data of every vehicle.
    pub observers: Observers,
    /// The run that vehicles must fly in to be ready.
    pub run: u64,
}

impl Watch {
    /// Connects to the swarm, or to all teams of the fleet.
    ///
    /// # Errors
    /// If Zenoh refuses.
    pub fn open(reaches: &[Reach], run: u64) -> Result<Self, Error> {
        Ok(Self { observers: Observers::open(reaches)?, run })
    }

    /// Returns why this vehicle is not ready, if so. It must run in an incarnation newer than `after`.
    pub fn lacks(&self, id: VehicleName, after: Option<Incarnation>) -> Option<String> {
        lacks(self.observers.view(id), self.run, after)
    }

    /// Returns the run that each vehicle in contact reports, where messages are signed.
    pub fn reported_runs(&mut self) -> BTreeMap<VehicleName, u64> {
        self.observers.poll();
        let there = self.observers.views().filter(|(_, view)| view.alive);
        there.filter_map(|(id, view)| Some((id, view.run.filter(|run| *run != 0)?))).collect()
    }

    /// Returns the vehicle's present incarnation, after waiting up to [`CONTACT_TIMEOUT`] for a heartbeat.
    pub fn incarnation(&mut self, id: VehicleName) -> Option<Incarnation> {
        let until = clock::now() + CONTACT_TIMEOUT;
        self.wait(until, |observers| Some(observers.view(id)?.mission.as_ref()?.header.incarnation))
    }

    /// Receives messages until `find` gives something, at most until `until`.
    fn wait<T>(&mut self, until: Instant, mut find: impl FnMut(&Observers) -> Option<T>) -> Option<T> {
        loop {
            self.observers.poll();
            let found = find(&self.observers);
            if found.is_some() || clock::now() >= until {
                return found;
            }
            clock::sleep(POLL_PERIOD);
        }
    }

    /// Whether the vehicle is in contact.
    pub fn is_there(&self, id: VehicleName) -> bool {
        self.observers.view(id).is_some_and(|view| view.alive)
    }

    /// Waits until all these vehicles are ready, each in an incarnation newer than the given one and at most until its
    /// own deadline `until`. Calls `report` for each vehicle as it gets ready. Returns the vehicles that are not ready.
    pub fn ready(
        &mut self,
        ids: &BTreeMap<VehicleName, Option<Incarnation>>,
        until: impl Fn(VehicleName) -> Instant,
        mut report: impl FnMut(VehicleName),
    ) -> BTreeSet<VehicleName> {
        let mut missing: BTreeSet<VehicleName> = ids.keys().copied().collect();
        loop {
            self.observers.poll();
            missing.retain(|id| {
                let is_missing = self.lacks(*id, ids[id]).is_some();
                if !is_missing {
                    report(*id);
                }
                is_missing
            });
            let now = clock::now();
            if missing.iter().all(|id| now >= until(*id)) {
                return missing;
            }
            clock::sleep(POLL_PERIOD);
        }
    }

    /// Whether the vehicle flies as a member of the swarm, by its newest summary: it climbs, or is in formation, or holds.
    pub fn flies(&self, id: VehicleName) -> bool {
        use Activity::{Formation, Holding, TakingOff};
        let activity = self.observers.view(id).and_then(|view| Some(view.summary.as_ref()?.facts.activity));
        activity.is_some_and(|activity| matches!(activity, TakingOff | Formation | Holding))
    }

    /// Waits until the vehicle has taken off in an incarnation newer than `after`, at most until `until`. Returns whether it has.
    pub fn has_taken_off(&mut self, id: VehicleName, after: Option<Incarnation>, until: Instant) -> bool {
        let has = |observers: &Observers| {
            let summary = observers.view(id)?.summary.as_ref()?;
            let is_new = after.is_none_or(|before| summary.header.incarnation > before);
            let on_ground = matches!(summary.facts.activity, Activity::Joining | Activity::TakingOff);
            (is_new && !on_ground).then_some(())
        };
        self.wait(until, has).is_some()
    }

    /// Waits until none of these vehicles is in contact, at most until `until`. Calls `report` for each as it leaves.
    /// Returns the vehicles still in contact.
    pub fn gone(
        &mut self,
        ids: &BTreeSet<VehicleName>,
        until: Instant,
        mut report: impl FnMut(VehicleName),
    ) -> BTreeSet<VehicleName> {
        let (mut reported, mut there) = (BTreeSet::new(), BTreeSet::new());
        self.wait(until, |observers| {
            // A vehicle that was lost only briefly returns and is waited for again.
            let is_there = |id: &VehicleName| observers.view(*id).is_some_and(|view| view.alive);
            let (present, gone): (BTreeSet<_>, BTreeSet<_>) = ids.iter().copied().partition(is_there);
            gone.into_iter().filter(|id| reported.insert(*id)).for_each(&mut report);
            there = present;
            there.is_empty().then_some(())
        });
        there
    }
}

fn lacks(view: Option<&VehicleView>, run: u64, after: Option<Incarnation>) -> Option<String> {
    let Some((view, true)) = view.map(|view| (view, view.alive)) else {
        return Some("not in contact".to_owned());
    };
    let Some(mission) = &view.mission else { return Some("in contact, but sends no heartbeats".to_owned()) };
    if after.is_some_and(|before| mission.header.incarnation <= before) {
        return Some("not restarted yet".to_owned());
    }
    if view.run.is_some_and(|reported| reported != run) {
        return Some("flies in another run of the swarm; run `skein cluster down` first".to_owned());
    }
    match mission.membership {
        Membership::Active if view.health.is_some() && view.health_run.is_none_or(|reported| reported == run) => None,
        Membership::Active => Some("sends no health reports".to_owned()),
        Membership::Joining => {
            Some("still joining: it waits for its simulator, or for its peers' heartbeats".to_owned())
        }
        Membership::Left => Some("has landed and cannot be recalled".to_owned()),
    }
}

#[cfg(test)]
mod tests;
