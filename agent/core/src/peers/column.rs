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
    /// Number of receivers.
    count: usize,
    places: Vec<NewestAtSix>,
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
}

/// The newest message at each of a few receivers, and its arrival by the receiver's clock. Both are read together, and these fit
/// into the 64 bytes that a processor reads from memory at once.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
struct NewestAtSix {
    arrived_at: [LocalTime; TOGETHER],
    newest: [Option<SlotIndex>; TOGETHER],
}

/// Number of receivers that are kept together.
const TOGETHER: usize = 6;

/// The place of a receiver: those that it is kept together with, and its index among them.
#[inline]
fn place(receiver: usize) -> (usize, usize) {
    (receiver / TOGETHER, receiver % TOGETHER)
}

impl<M: Copy> Column<M> {
    /// The column of a swarm with so many receivers, before any message.
    pub(super) fn new(count: usize) -> Self {
        let nothing = NewestAtSix { arrived_at: [LocalTime::ZERO; TOGETHER], newest: [None; TOGETHER] };
        let places = vec![nothing; count.div_ceil(TOGETHER)];
        Self { slots: Vec::new(), free: Vec::new(), count, places, delivered: None }
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
        let newest = (0..self.count).filter_map(|receiver| self.newest_slot(receiver));
        newest.for_each(|slot| is_needed[slot.get()] = true);
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
        let (together, nth) = place(receiver);
        let places = self.places.get(together)?;
        Some((self.slot(places.newest[nth]?), places.arrived_at[nth]))
    }

    /// The slot of the newest message at a receiver.
    #[inline]
    pub(super) fn newest_slot(&self, receiver: usize) -> Option<SlotIndex> {
        let (together, nth) = place(receiver);
        self.places[together].newest[nth]
    }

    /// Makes a message the newest one at a receiver.
    #[inline]
    pub(super) fn receive(&mut self, receiver: usize, slot: SlotIndex, at: LocalTime) {
        let (together, nth) = place(receiver);
        let places = &mut self.places[together];
        (places.newest[nth], places.arrived_at[nth]) = (Some(slot), at);
    }

    /// Forgets what a receiver has received.
    pub(super) fn forget(&mut self, receiver: usize) {
        let (together, nth) = place(receiver);
        self.places[together].newest[nth] = None;
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
        // At most receivers it is the newest.
        let differ = |places: &&NewestAtSix| places.newest != [Some(slot); TOGETHER];
        let others =
            self.places.iter().enumerate().filter(|(_, places)| differ(places)).flat_map(|(together, places)| {
                let here = places.newest.iter().enumerate().filter(|(_, newest)| **newest != Some(slot));
                here.map(move |(nth, _)| TOGETHER * together + nth)
            });
        others
            .filter(|receiver| *receiver < self.count)
            .filter_map(|receiver| VehicleId::new(receiver as u8 + 1).ok())
            .collect()
    }

    /// Makes a message the newest one at all receivers but these.
    pub(super) fn fill(&mut self, slot: SlotIndex, left_out: VehicleSet, at: LocalTime) {
        let all = NewestAtSix { arrived_at: [at; TOGETHER], newest: [Some(slot); TOGETHER] };
        let mut left_out = left_out.iter().map(|id| place(index(id))).peekable();
        for (together, places) in self.places.iter_mut().enumerate() {
            let before = core::mem::replace(places, all);
            while let Some((_, nth)) = left_out.next_if(|(of, _)| *of == together) {
                (places.newest[nth], places.arrived_at[nth]) = (before.newest[nth], before.arrived_at[nth]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use skein_common::id::Incarnation;

    use super::*;

    fn message(number: u64) -> Slot<u64> {
        let order = MessageOrder { incarnation: Incarnation(1), sequence: number };
        Slot { message: number, order, sent_at: LocalTime::ZERO, in_flight: 0, travelled_m: 0.0 }
    }

    fn at(number: u64) -> LocalTime {
        LocalTime::from_nanoseconds(number)
    }

    proptest! {
        #[test]
        fn a_filled_column_is_one_that_each_receiver_has_received(
            count in 1_usize..=250,
            messages in prop::collection::vec((any::<[u64; 4]>(), any::<bool>()), 1..20),
        ) {
            let receivers: VehicleSet = VehicleId::first(count).collect();
            let [mut filled, mut one_by_one] = [0; 2].map(|_| Column::new(count));
            for (number, (bits, reaches_most)) in (1..).zip(messages) {
                let drawn = receivers.iter().filter(|id| bits[index(*id) / 64] >> (index(*id) % 64) & 1 == 1).collect();
                let left_out = if reaches_most { VehicleSet::default() } else { drawn };
                let slot = filled.put(message(number));
                prop_assert!(filled.note_delivery(slot) && !filled.note_delivery(slot));
                filled.fill(slot, left_out, at(number));
                let slot = one_by_one.put(message(number));
                receivers.without(left_out).iter().for_each(|id| one_by_one.receive(index(id), slot, at(number)));

                let newest = |column: &Column<u64>, receiver| column.newest(receiver).map(|(slot, at)| (slot.message, at));
                let all = |column| (0..count).map(|receiver| newest(column, receiver)).collect::<Vec<_>>();
                prop_assert_eq!(all(&filled), all(&one_by_one));
                let others = receivers.iter().filter(|id| newest(&filled, index(*id)).is_none_or(|(last, _)| last != number));
                let found = filled.with_others(filled.delivered().unwrap());
                prop_assert_eq!(found, others.collect::<VehicleSet>());
            }
        }
    }
}
