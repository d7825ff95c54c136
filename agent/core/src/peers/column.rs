//! The messages of one kind from one sender, and which of them is the newest at each receiver.

use alloc::vec;
use alloc::vec::Vec;
use core::num::NonZeroU16;

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::MessageOrder;
use skein_common::time::LocalTime;

use super::arrival::Arrival;
use super::index;

/// The messages of one kind from one sender that may still be needed, and the newest one at each receiver.
///
/// Nearly every receiver has one of the two newest messages, so these have sets of receivers; a receiver with an earlier one has an
/// entry of its own.
///
/// Agents read the columns of their near peers in each step, and find them in no near cache: what they need of a column lies in its
/// first two lines of 64 bytes, and what they need of a message in the first two of its slot.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(super) struct Column<M> {
    /// The receivers at which each recent message is their newest.
    at: [VehicleSet; 2],
    /// The newest messages that any receiver has received so far, the newest one first.
    recent: [Option<SlotIndex>; 2],
    slots: Vec<Slot<M>>,
    /// The arrival of the newest message at each receiver, by its clock; empty while all arrivals of each message are in its slot.
    arrived_at: Vec<LocalTime>,
    /// The order of the newest message.
    newest: Option<MessageOrder>,
    free: Vec<SlotIndex>,
    /// The newest message of each receiver without a recent one.
    behind: Vec<Option<SlotIndex>>,
    /// The message that each receiver's link holds back; empty if none ever did.
    held: Vec<Option<SlotIndex>>,
}

/// The index of a slot. It is kept plus one, so that none takes no more room than one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SlotIndex(NonZeroU16);

impl SlotIndex {
    fn new(index: usize) -> Self {
        Self(NonZeroU16::MIN.saturating_add(index as u16))
    }

    #[inline]
    fn get(self) -> usize {
        usize::from(self.0.get() - 1)
    }
}

/// A state or heartbeat in the inbox.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parcel {
    pub(super) sender: VehicleId,
    pub(super) kind: ParcelKind,
    pub(super) slot: SlotIndex,
}

impl Parcel {
    /// Whether it is a state.
    pub fn is_state(&self) -> bool {
        self.kind == ParcelKind::State
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ParcelKind {
    State,
    Heartbeat,
}

/// A message with what the inbox knows of it.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(super) struct Slot<M> {
    pub(super) message: M,
    /// Its arrivals by the receivers' clocks, as of the first delivery.
    arrival: Option<Arrival>,
    pub(super) order: MessageOrder,
    pub(super) sent_at: LocalTime,
    /// Number of the deliveries that are still to come.
    pub(super) in_flight: u16,
    /// The length that all vehicles had travelled at most in the frame in which it was sent, m.
    pub(super) travelled_m: f64,
}

impl<M> Slot<M> {
    /// A message that is sent now.
    pub(super) fn new(message: M, order: MessageOrder, sent_at: LocalTime, travelled_m: f64) -> Self {
        Self { message, order, sent_at, in_flight: 0, travelled_m, arrival: None }
    }
}

impl<M: Clone> Column<M> {
    /// The column of a swarm with so many receivers, before any message.
    pub(super) fn new(count: usize) -> Self {
        let (at, recent, slots, arrived_at) = Default::default();
        let (newest, free, behind, held) = (None, Vec::new(), vec![None; count], Vec::new());
        Self { at, recent, slots, arrived_at, newest, free, behind, held }
    }

    /// Puts a message into a slot.
    pub(super) fn put(&mut self, slot: Slot<M>) -> SlotIndex {
        if self.free.is_empty() {
            self.sweep();
        }
        if let Some(index) = self.free.pop() {
            *self.slot_mut(index) = slot;
            index
        } else {
            self.slots.push(slot);
            SlotIndex::new(self.slots.len() - 1)
        }
    }

    /// Frees the slots of messages that are the newest at no receiver, are held back from none and will not be delivered. If they
    /// are few, more room is made, so that the next sweep is some messages away.
    fn sweep(&mut self) {
        self.keep_no_arrivals();
        let mut is_needed: Vec<bool> = self.slots.iter().map(|slot| slot.in_flight > 0).collect();
        let behind = self.all_behind().iter().map(|id| self.behind[index(id)]);
        let needed = behind.chain(self.recent).chain(self.held.iter().copied());
        needed.flatten().for_each(|slot| is_needed[slot.get()] = true);
        let unneeded = is_needed.iter().enumerate().filter(|(_, is_needed)| !**is_needed);
        self.free.extend(unneeded.map(|(index, _)| SlotIndex::new(index)));
        const ROOM: usize = 3;
        let more = ROOM.saturating_sub(self.free.len());
        if let (Some(any), true) = (self.slots.last().cloned(), more > 0) {
            let begin = self.slots.len();
            self.slots.reserve_exact(more);
            self.slots.resize(begin + more, any);
            self.slots[begin..].iter_mut().for_each(|slot| slot.in_flight = 0);
            self.free.extend((begin..self.slots.len()).map(SlotIndex::new));
        }
    }

    /// The message in a slot.
    #[inline]
    pub(super) fn slot(&self, index: SlotIndex) -> &Slot<M> {
        &self.slots[index.get()]
    }

    /// The message in a slot, to be changed.
    pub(super) fn slot_mut(&mut self, index: SlotIndex) -> &mut Slot<M> {
        &mut self.slots[index.get()]
    }

    /// The newest message at a receiver, and its arrival.
    #[inline]
    pub(super) fn newest(&self, receiver: VehicleId) -> Option<(&Slot<M>, LocalTime)> {
        let slot = self.slot(self.newest_slot(receiver)?);
        let of_slot = || slot.arrival.as_ref().map(|arrival| arrival.at(index(receiver)));
        Some((slot, self.arrived_at.get(index(receiver)).copied().or_else(of_slot)?))
    }

    /// The slot of the newest message at a receiver.
    #[inline]
    pub(super) fn newest_slot(&self, receiver: VehicleId) -> Option<SlotIndex> {
        match self.at.iter().position(|at| at.contains(receiver)) {
            Some(nth) => self.recent[nth],
            None => *self.behind.get(index(receiver))?,
        }
    }

    /// The receivers without a recent message.
    fn all_behind(&self) -> VehicleSet {
        let all: VehicleSet = VehicleId::first(self.behind.len()).collect();
        self.at.iter().fold(all, |behind, at| behind.without(*at))
    }

    /// Makes a message the newest one at a receiver.
    #[inline]
    pub(super) fn receive(&mut self, receiver: VehicleId, slot: SlotIndex, at: LocalTime) {
        let of_slot = self.slot_mut(slot).arrival.get_or_insert(Arrival::Alike(at));
        if of_slot.at(index(receiver)) != at && self.arrived_at.is_empty() {
            self.keep_arrivals();
        }
        let mut is_behind = true;
        for (at, recent) in self.at.iter_mut().zip(self.recent) {
            let is_it = recent == Some(slot);
            at.set(receiver, is_it);
            is_behind &= !is_it;
        }
        if is_behind {
            self.behind[index(receiver)] = Some(slot);
        }
        if let Some(arrived_at) = self.arrived_at.get_mut(index(receiver)) {
            *arrived_at = at;
        }
    }

    /// Makes the newest message the newest one at these receivers too, whose arrivals have been noted.
    pub(super) fn fill(&mut self, receivers: VehicleSet, arrival: &Arrival) {
        let [at_newest, at_before] = &mut self.at;
        at_newest.extend(receivers);
        *at_before = at_before.without(receivers);
        if !self.arrived_at.is_empty() {
            receivers.iter().for_each(|id| self.arrived_at[index(id)] = arrival.at(index(id)));
        }
    }

    /// Notes the arrivals of a message at receivers that get it now or later. Over most networks these are all of its arrivals, and
    /// lie in its slot; a message of which they are not makes the column keep the arrival at each receiver for a while.
    pub(super) fn note_arrival(&mut self, slot: SlotIndex, arrival: &Arrival) {
        let of_slot = self.slot_mut(slot).arrival.get_or_insert_with(|| arrival.clone());
        if !of_slot.is(arrival) && self.arrived_at.is_empty() {
            self.keep_arrivals();
        }
    }

    /// The arrival of the newest message at a receiver as its slot has it.
    fn arrival_in_slot(&self, receiver: VehicleId) -> Option<LocalTime> {
        Some(self.slot(self.newest_slot(receiver)?).arrival.as_ref()?.at(index(receiver)))
    }

    fn keep_arrivals(&mut self) {
        let receivers = VehicleId::first(self.behind.len());
        self.arrived_at = receivers.map(|id| self.arrival_in_slot(id).unwrap_or(LocalTime::ZERO)).collect();
    }

    /// Keeps the arrivals in the slots alone again once all of the newest messages are there.
    fn keep_no_arrivals(&mut self) {
        let is_in_slot =
            |(id, at): (VehicleId, &LocalTime)| self.newest_slot(id).is_none() || self.arrival_in_slot(id) == Some(*at);
        if VehicleId::first(self.behind.len()).zip(&self.arrived_at).all(is_in_slot) {
            self.arrived_at = Vec::new();
        }
    }

    /// Forgets what a receiver has received.
    pub(super) fn forget(&mut self, receiver: VehicleId) {
        self.at.iter_mut().for_each(|at| at.remove(receiver));
        self.behind[index(receiver)] = None;
    }

    /// Holds a message back from these receivers, in the place of an earlier one.
    pub(super) fn hold(&mut self, slot: SlotIndex, receivers: VehicleSet) {
        if self.held.is_empty() {
            self.held = vec![None; self.behind.len()];
        }
        receivers.runs().for_each(|run| self.held[run].fill(Some(slot)));
    }

    /// Takes out the message that is held back from a receiver.
    pub(super) fn take_held(&mut self, receiver: VehicleId) -> Option<SlotIndex> {
        self.held.get_mut(index(receiver))?.take()
    }

    /// Notes that a message reaches receivers. Returns whether none has received another one that is as new.
    pub(super) fn note_delivery(&mut self, slot: SlotIndex) -> bool {
        let order = self.slot(slot).order;
        let ([at_newest, at_before], [newest, before]) = (self.at, self.recent);
        if self.newest.is_none_or(|newest| newest < order) {
            at_before.iter().for_each(|id| self.behind[index(id)] = before);
            self.at = [VehicleSet::default(), at_newest];
            self.recent = [Some(slot), newest];
            self.newest = Some(order);
        }
        self.recent[0] == Some(slot)
    }

    /// The slot of the newest message before the newest one.
    pub(super) fn before(&self) -> Option<SlotIndex> {
        self.recent[1]
    }

    /// The receivers at which the newest message before the newest one is their newest.
    pub(super) fn with_before(&self) -> VehicleSet {
        self.at[1]
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use skein_common::id::Incarnation;

    use super::super::arrival::Spread;
    use super::*;

    fn message(number: u64) -> Slot<u64> {
        Slot::new(number, MessageOrder { incarnation: Incarnation(1), sequence: number }, LocalTime::ZERO, 0.0)
    }

    /// An arrival of a message at each receiver, at once or by random delays.
    fn arrival(number: u64, numbers: Option<Vec<u32>>) -> Arrival {
        let sent_at = LocalTime::from_nanoseconds(1000 * number);
        match numbers {
            None => Arrival::Alike(sent_at),
            Some(numbers) => Arrival::Spread(Spread { sent_at, delay_s: 0.0, jitter_s: 1e-6, numbers: numbers.into() }),
        }
    }

    proptest! {
        #[test]
        fn each_receiver_has_the_newest_message_and_its_arrival(
            count in 1_usize..=250,
            messages in prop::collection::vec((any::<[u64; 4]>(), any::<bool>(), 0..12_u64), 1..20),
            numbers in prop::collection::vec(any::<u32>(), 250),
        ) {
            let receivers: VehicleSet = VehicleId::first(count).collect();
            let mut column = Column::new(count);
            let mut expected = vec![None; count];
            for (number, (bits, reaches_most, kind)) in (1..).zip(messages) {
                let drawn = receivers.iter().filter(|id| bits[index(*id) / 64] >> (index(*id) % 64) & 1 == 1).collect();
                let reached = if reaches_most { receivers } else { receivers.without(drawn) };
                let slot = column.put(message(number));
                prop_assert!(column.note_delivery(slot) && column.note_delivery(slot));
                let arrival = arrival(number, (kind % 2 == 1).then(|| numbers.clone()));
                // Some arrive later at one receiver, which no arrival of a delivery says.
                let late = |receiver: usize| if kind == 0 && receiver == 7 { 1e-3 } else { 0.0 };
                let arrives = |receiver: usize| arrival.at(receiver).plus_seconds(late(receiver));
                if kind < 4 {
                    reached.iter().for_each(|id| column.receive(id, slot, arrives(index(id))));
                } else {
                    column.note_arrival(slot, &arrival);
                    column.fill(reached, &arrival);
                }
                reached.iter().for_each(|id| expected[index(id)] = Some((number, arrives(index(id)))));

                let newest = |receiver| column.newest(receiver).map(|(slot, at)| (slot.message, at));
                prop_assert_eq!(VehicleId::first(count).map(newest).collect::<Vec<_>>(), expected.clone());
                let has_before = |id: &VehicleId| expected[index(*id)].is_some_and(|(newest, _)| newest + 1 == number);
                prop_assert_eq!(column.with_before(), receivers.iter().filter(has_before).collect());
            }
        }
    }
}
