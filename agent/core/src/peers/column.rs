//! The messages of one kind from one sender, and which of them is the newest at each receiver.

use alloc::vec;
use alloc::vec::Vec;
use core::num::NonZeroU16;

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::MessageOrder;
use skein_common::time::LocalTime;

use super::arrival::Arrival;

/// The messages of one kind from one sender that may still be needed, and the newest one at each receiver.
#[derive(Clone, Debug)]
pub(super) struct Column<M> {
    slots: Vec<Slot<M>>,
    free: Vec<SlotIndex>,
    /// The newest message at each receiver.
    newest: Vec<Option<SlotIndex>>,
    /// Its arrival at each receiver, by the receiver's clock; empty while all arrivals of each message are in its slot.
    arrived_at: Vec<LocalTime>,
    /// The newest message that any receiver has received so far: its order, and its slot then.
    delivered: Option<(MessageOrder, SlotIndex)>,
    /// The slot of the newest one before that.
    pub(super) before: Option<SlotIndex>,
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
pub(super) struct Slot<M> {
    pub(super) message: M,
    pub(super) order: MessageOrder,
    pub(super) sent_at: LocalTime,
    /// Number of the deliveries that are still to come.
    pub(super) in_flight: u16,
    /// The length that all vehicles had travelled at most in the frame in which it was sent, m.
    pub(super) travelled_m: f64,
    /// Its arrivals by the receivers' clocks, as of the first delivery.
    arrival: Option<Arrival>,
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
        let newest = vec![None; count];
        let (slots, free, arrived_at) = Default::default();
        Self { slots, free, newest, arrived_at, delivered: None, before: None }
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

    /// Frees the slots of messages that are the newest at no receiver and will not be delivered. If they are few, more room is
    /// made, so that the next sweep is some messages away.
    fn sweep(&mut self) {
        let mut is_needed: Vec<bool> = self.slots.iter().map(|slot| slot.in_flight > 0).collect();
        self.newest.iter().flatten().for_each(|slot| is_needed[slot.get()] = true);
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
    pub(super) fn newest(&self, receiver: usize) -> Option<(&Slot<M>, LocalTime)> {
        let slot = self.slot(self.newest_slot(receiver)?);
        let of_slot = || slot.arrival.as_ref().map(|arrival| arrival.at(receiver));
        Some((slot, self.arrived_at.get(receiver).copied().or_else(of_slot)?))
    }

    /// The slot of the newest message at a receiver.
    #[inline]
    pub(super) fn newest_slot(&self, receiver: usize) -> Option<SlotIndex> {
        *self.newest.get(receiver)?
    }

    /// Makes a message the newest one at a receiver.
    #[inline]
    pub(super) fn receive(&mut self, receiver: usize, slot: SlotIndex, at: LocalTime) {
        if self.arrived_at.is_empty() {
            let of_slot = self.slot_mut(slot).arrival.get_or_insert(Arrival::Alike(at));
            if of_slot.at(receiver) != at {
                self.keep_arrivals();
            }
        }
        self.newest[receiver] = Some(slot);
        if let Some(arrived_at) = self.arrived_at.get_mut(receiver) {
            *arrived_at = at;
        }
    }

    /// Notes the arrivals of a message at receivers that get it now or later. Over most networks these are all of its arrivals, and
    /// lie in its slot; the first message of which they are not makes the column keep the arrivals of each receiver from then on.
    pub(super) fn note_arrival(&mut self, slot: SlotIndex, arrival: &Arrival) {
        if self.arrived_at.is_empty() && !self.slot_mut(slot).arrival.get_or_insert_with(|| arrival.clone()).is(arrival)
        {
            self.keep_arrivals();
        }
    }

    fn keep_arrivals(&mut self) {
        let arrived_at = |(receiver, slot): (usize, &Option<SlotIndex>)| {
            let arrival = slot.and_then(|slot| self.slot(slot).arrival.as_ref());
            arrival.map_or(LocalTime::ZERO, |arrival| arrival.at(receiver))
        };
        self.arrived_at = self.newest.iter().enumerate().map(arrived_at).collect();
    }

    /// Forgets what a receiver has received.
    pub(super) fn forget(&mut self, receiver: usize) {
        self.newest[receiver] = None;
    }

    /// Notes that a message reaches receivers. Returns whether none has received another one that is as new.
    pub(super) fn note_delivery(&mut self, slot: SlotIndex) -> bool {
        let order = self.slot(slot).order;
        let is_newer = self.delivered.is_none_or(|(delivered, _)| delivered < order);
        if is_newer {
            self.before = self.delivered.replace((order, slot)).map(|(_, slot)| slot);
        }
        self.delivered == Some((order, slot))
    }

    /// The receivers at which another message than this one is the newest.
    pub(super) fn with_others(&self, slot: SlotIndex) -> VehicleSet {
        const TOGETHER: usize = 32;
        // At most receivers it is the newest.
        let differ = |(_, newest): &(usize, &[Option<SlotIndex>])| newest.iter().any(|newest| *newest != Some(slot));
        let with_others = self.newest.chunks(TOGETHER).enumerate().filter(differ).flat_map(|(chunk, newest)| {
            let here = newest.iter().enumerate().filter(|(_, newest)| **newest != Some(slot));
            here.map(move |(nth, _)| TOGETHER * chunk + nth)
        });
        with_others.filter_map(|receiver| VehicleId::new(receiver as u8 + 1).ok()).collect()
    }

    /// Makes a message the newest one at these receivers, whose arrivals have been noted.
    pub(super) fn fill(&mut self, slot: SlotIndex, receivers: VehicleSet, arrival: &Arrival) {
        for run in receivers.runs() {
            self.newest[run.clone()].fill(Some(slot));
            let arrived_at = self.arrived_at.get_mut(run.clone()).unwrap_or_default();
            arrived_at.iter_mut().zip(run).for_each(|(at, receiver)| *at = arrival.at(receiver));
        }
    }
}

#[cfg(test)]
mod tests {
    use alloc::sync::Arc;

    use proptest::prelude::*;
    use skein_common::id::Incarnation;

    use super::super::arrival::Spread;
    use super::super::index;
    use super::*;

    fn message(number: u64) -> Slot<u64> {
        Slot::new(number, MessageOrder { incarnation: Incarnation(1), sequence: number }, LocalTime::ZERO, 0.0)
    }

    /// An arrival of a message at each receiver, at once or by random delays.
    fn arrival(number: u64, numbers: Option<Vec<u32>>) -> Arrival {
        let sent_at = LocalTime::from_nanoseconds(1000 * number);
        match numbers {
            None => Arrival::Alike(sent_at),
            Some(numbers) => Arrival::Spread(Arc::new(Spread { sent_at, delay_s: 0.0, jitter_s: 1e-6, numbers })),
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
                    reached.iter().for_each(|id| column.receive(index(id), slot, arrives(index(id))));
                } else {
                    column.note_arrival(slot, &arrival);
                    column.fill(slot, reached, &arrival);
                }
                reached.iter().for_each(|id| expected[index(id)] = Some((number, arrives(index(id)))));

                let newest = |receiver| column.newest(receiver).map(|(slot, at)| (slot.message, at));
                prop_assert_eq!((0..count).map(newest).collect::<Vec<_>>(), expected.clone());
                let is_other = |id: &VehicleId| expected[index(*id)].is_none_or(|(newest, _)| newest != number);
                prop_assert_eq!(column.with_others(slot), receivers.iter().filter(is_other).collect());
            }
        }
    }
}
