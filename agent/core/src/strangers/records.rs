//! The states of strangers that the vehicles of one team receive.
//!
//! A state lies here once, with its arrivals at its receivers. Each receiver looks for the newest one that has arrived, when it
//! needs it.

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use skein_common::id::{FleetVehicle, VehicleId, VehicleSet};
use skein_common::time::LocalTime;

use super::StrangerState;

/// Time for which a stranger that sends nothing is kept, s. The receivers forget it earlier.
const KEPT_S: f64 = 2.0 * super::FORGOTTEN_S;

/// The arrivals of a message at the receivers that it reaches at the same time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ArrivalAt {
    /// Time of arrival, by the correct clock.
    pub(crate) at: LocalTime,
    pub(crate) receivers: VehicleSet,
}

/// The states of strangers that the vehicles of one team receive.
#[derive(Clone, Debug, Default)]
pub struct StrangerRecords {
    /// The strangers, by team and id.
    strangers: Vec<StrangerRecord>,
    /// Number of states added so far.
    pub(super) revision: u64,
}

/// The states of one stranger that a receiver may need, the newest first.
#[derive(Clone, Debug)]
struct StrangerRecord {
    id: FleetVehicle,
    states: VecDeque<StateOnItsWay>,
}

/// A state with its arrivals, of which the first one is kept apart because most states have one only.
#[derive(Clone, Debug)]
struct StateOnItsWay {
    state: StrangerState,
    first: ArrivalAt,
    others: Vec<ArrivalAt>,
    /// Whether the stranger may come within reach of a receiver by this state.
    matters: bool,
}

impl StateOnItsWay {
    fn arrivals(&self) -> impl Iterator<Item = &ArrivalAt> {
        core::iter::once(&self.first).chain(&self.others)
    }

    /// The state with its first time of arrival at a receiver, in the past or in the future; `None` if it does not get there.
    fn at(&self, receiver: VehicleId) -> Option<StrangerState> {
        let arrivals = self.arrivals().filter(|arrival| arrival.receivers.contains(receiver));
        arrivals.map(|arrival| arrival.at).min().map(|at| StrangerState { at, ..self.state })
    }

    /// The receivers at which it has arrived.
    fn received(&self, now: LocalTime) -> VehicleSet {
        let arrived = self.arrivals().filter(|arrival| arrival.at <= now);
        arrived.fold(VehicleSet::default(), |all, arrival| all.either(arrival.receivers))
    }

    /// All receivers that it reaches.
    fn receivers(&self) -> VehicleSet {
        self.arrivals().fold(VehicleSet::default(), |all, arrival| all.either(arrival.receivers))
    }
}

impl StrangerRecord {
    /// The states that a receiver has or will have, the newest first, up to the newest one that has arrived.
    fn of(&self, receiver: VehicleId, now: LocalTime) -> impl Iterator<Item = StrangerState> {
        let mut has_arrived = false;
        let its = self.states.iter().filter_map(move |state| state.at(receiver));
        its.take_while(move |state| !core::mem::replace(&mut has_arrived, state.at <= now))
    }

    /// Removes the states that no receiver needs any more, because a newer one has arrived there.
    fn prune(&mut self, now: LocalTime) {
        let mut served = VehicleSet::default();
        self.states.retain(|state| {
            let is_needed = !state.receivers().without(served).is_empty();
            served.extend(state.received(now));
            is_needed
        });
    }
}

impl StrangerRecords {
    /// Whether a state is kept of this stranger.
    pub(crate) fn has(&self, id: FleetVehicle) -> bool {
        self.place(id).is_ok()
    }

    /// Adds a state with its arrivals. States that do not matter are kept as long as they are newer than one that does.
    pub(crate) fn add(&mut self, state: &StrangerState, now: LocalTime, arrivals: &[ArrivalAt], matters: bool) {
        let [first, others @ ..] = arrivals else { return };
        let place = self.place(state.id).unwrap_or_else(|place| {
            self.strangers.insert(place, StrangerRecord { id: state.id, states: VecDeque::new() });
            place
        });
        let record = &mut self.strangers[place];
        // The first state with a number stays in front of others that claim the same number.
        let newer = record.states.iter().take_while(|known| known.state.order >= state.order).count();
        let sent = StateOnItsWay { state: *state, first: *first, others: others.to_vec(), matters };
        record.states.insert(newer, sent);
        record.prune(now);
        if !record.states.iter().any(|state| state.matters) {
            self.strangers.remove(place);
        }
        self.revision += 1;
    }

    /// Forgets strangers that have been silent for long.
    pub(crate) fn forget_silent(&mut self, now: LocalTime) {
        let sounds = |state: &StateOnItsWay| state.arrivals().any(|arrival| now.seconds_since(arrival.at) < KEPT_S);
        self.strangers.retain(|record| record.states.iter().any(sounds));
    }

    /// Removes all that is known at a receiver, or on its way there.
    pub(crate) fn forget(&mut self, receiver: VehicleId) {
        for state in self.strangers.iter_mut().flat_map(|record| &mut record.states) {
            state.first.receivers.remove(receiver);
            state.others.iter_mut().for_each(|arrival| arrival.receivers.remove(receiver));
        }
        self.revision += 1;
    }

    /// The newest state of a stranger that has arrived at a receiver, with its time of arrival by the correct clock.
    pub(crate) fn newest(&self, id: FleetVehicle, receiver: VehicleId, now: LocalTime) -> Option<StrangerState> {
        let record = &self.strangers[self.place(id).ok()?];
        record.of(receiver, now).find(|state| state.at <= now)
    }

    /// The strangers of which a receiver has or will have a state that `is_wanted`, by team and id.
    pub(super) fn with(
        &self,
        (receiver, now): (VehicleId, LocalTime),
        is_wanted: impl Fn(StrangerState) -> bool,
    ) -> impl Iterator<Item = FleetVehicle> {
        let has_one = move |record: &&StrangerRecord| record.of(receiver, now).any(&is_wanted);
        self.strangers.iter().filter(has_one).map(|record| record.id)
    }

    /// Number of strangers of which a state is kept.
    #[cfg(test)]
    pub(crate) fn len(&self) -> usize {
        self.strangers.len()
    }

    fn place(&self, id: FleetVehicle) -> Result<usize, usize> {
        self.strangers.binary_search_by_key(&id, |record| record.id)
    }
}
