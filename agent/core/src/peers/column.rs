//! The messages of one kind from one sender, and which of them is the newest at each receiver.

use alloc::vec;
use alloc::vec::Vec;
use core::num::NonZeroU16;

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::MessageOrder;
use skein_common::time::LocalTime;

use super::index;

/// The messages of one kind from one sender that may still be needed, and the newest one at each receiver.
#[derive(Clone, Debug)]
pub(super) struct Column<M> {
    slots: Vec<Slot<M>>,
    free: Vec<SlotIndex>,
    /// The newest message at each receiver.
    newest: Vec<Option<SlotIndex>>,
    /// Its arrival at each receiver, by the receiver's clock; empty until any message has reached two receivers at different times.
    arrived_at: Vec<LocalTime>,
    /// The newest message that any receiver has received so far: its order, and its slot then.
    delivered: Option<(MessageOrder, SlotIndex)>,
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
#[derive(Clone, Copy, Debug)]
pub(super) struct Slot<M> {
    pub(super) message: M,
    pub(super) order: MessageOrder,
    pub(super) sent_at: LocalTime,
    /// Number of the deliveries that are still to come.
    pub(super) in_flight: u16,
    /// The length that all vehicles had travelled at most in the frame in which it was sent, m.
    pub(super) travelled_m: f64,
    /// Its first arrival, by the receiver's clock.
    arrived_at: Option<LocalTime>,
}

impl<M> Slot<M> {
    /// A message that is sent now.
    pub(super) fn new(message: M, order: MessageOrder, sent_at: LocalTime, travelled_m: f64) -> Self {
        Self { message, order, sent_at, in_flight: 0, travelled_m, arrived_at: None }
    }
}

impl<M: Copy> Column<M> {
    /// The column of a swarm with so many receivers, before any message.
    pub(super) fn new(count: usize) -> Self {
        Self { slots: Vec::new(), free: Vec::new(), newest: vec![None; count], arrived_at: Vec::new(), delivered: None }
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
        if let (Some(&any), true) = (self.slots.last(), more > 0) {
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
        Some((slot, self.arrived_at.get(receiver).copied().or(slot.arrived_at)?))
    }

    /// The slot of the newest message at a receiver.
    #[inline]
    pub(super) fn newest_slot(&self, receiver: usize) -> Option<SlotIndex> {
        *self.newest.get(receiver)?
    }

    /// Makes a message the newest one at a receiver.
    #[inline]
    pub(super) fn receive(&mut self, receiver: usize, slot: SlotIndex, at: LocalTime) {
        self.note_arrival(slot, at);
        self.newest[receiver] = Some(slot);
        if let Some(arrived_at) = self.arrived_at.get_mut(receiver) {
            *arrived_at = at;
        }
    }

    /// Notes that a message arrives at this time. Over most networks it reaches all of its receivers at once, and lies here with
    /// its arrival; the first one that does not makes the column keep the arrivals of each receiver from then on.
    #[inline]
    fn note_arrival(&mut self, slot: SlotIndex, at: LocalTime) {
        if self.arrived_at.is_empty() && *self.slot_mut(slot).arrived_at.get_or_insert(at) != at {
            self.keep_arrivals();
        }
    }

    fn keep_arrivals(&mut self) {
        let arrived_at = |slot: &Option<SlotIndex>| slot.and_then(|slot| self.slot(slot).arrived_at);
        self.arrived_at = self.newest.iter().map(|slot| arrived_at(slot).unwrap_or_default()).collect();
    }

    /// Forgets what a receiver has received.
    pub(super) fn forget(&mut self, receiver: usize) {
        self.newest[receiver] = None;
    }

    /// The slot of the newest message that any receiver has received so far.
    pub(super) fn delivered(&self) -> Option<SlotIndex> {
        self.delivered.map(|(_, slot)| slot)
    }

    /// Notes that a message reaches receivers. Returns whether it is newer than all that any of them has received.
    pub(super) fn note_delivery(&mut self, slot: SlotIndex) -> bool {
        let order = self.slot(slot).order;
        let is_newest = self.delivered.is_none_or(|(delivered, _)| delivered < order);
        if is_newest {
            self.delivered = Some((order, slot));
        }
        is_newest
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

    /// Makes a message the newest one at all receivers but these.
    pub(super) fn fill(&mut self, slot: SlotIndex, left_out: VehicleSet, at: LocalTime) {
        self.note_arrival(slot, at);
        let mut begin = 0;
        for end in left_out.iter().map(index).chain([self.newest.len()]) {
            self.newest[begin..end].fill(Some(slot));
            if let Some(arrived_at) = self.arrived_at.get_mut(begin..end) {
                arrived_at.fill(at);
            }
            begin = end + 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use skein_common::id::Incarnation;

    use super::*;

    fn message(number: u64) -> Slot<u64> {
        Slot::new(number, MessageOrder { incarnation: Incarnation(1), sequence: number }, LocalTime::ZERO, 0.0)
    }

    fn at(number: u64) -> LocalTime {
        LocalTime::from_nanoseconds(number)
    }

    proptest! {
        #[test]
        fn each_receiver_has_the_newest_message_and_its_arrival(
            count in 1_usize..=250,
            messages in prop::collection::vec((any::<[u64; 4]>(), any::<bool>(), 0..10_u64), 1..20),
        ) {
            let receivers: VehicleSet = VehicleId::first(count).collect();
            let mut column = Column::new(count);
            let mut expected = vec![None; count];
            for (number, (bits, reaches_most, late)) in (1..).zip(messages) {
                let drawn = receivers.iter().filter(|id| bits[index(*id) / 64] >> (index(*id) % 64) & 1 == 1).collect();
                let left_out = if reaches_most { VehicleSet::default() } else { drawn };
                let slot = column.put(message(number));
                prop_assert!(column.note_delivery(slot) && !column.note_delivery(slot));
                let arrives = |receiver: usize| at(1000 * number + if late == 0 { receiver as u64 } else { 0 });
                if late < 5 {
                    receivers.without(left_out).iter().for_each(|id| column.receive(index(id), slot, arrives(index(id))));
                } else {
                    column.fill(slot, left_out, arrives(0));
                }
                receivers.without(left_out).iter().for_each(|id| expected[index(id)] = Some((number, arrives(index(id)))));

                let newest = |receiver| column.newest(receiver).map(|(slot, at)| (slot.message, at));
                prop_assert_eq!((0..count).map(newest).collect::<Vec<_>>(), expected.clone());
                let is_other = |id: &VehicleId| expected[index(*id)].is_none_or(|(newest, _)| newest != number);
                prop_assert_eq!(column.with_others(slot), receivers.iter().filter(is_other).collect());
            }
        }
    }
}
