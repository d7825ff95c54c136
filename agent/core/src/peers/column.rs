//! The messages of one kind from one sender, and which of them is the newest at each receiver.

use alloc::vec;
use alloc::vec::Vec;

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
    delivered: Option<(MessageOrder, NonZeroSlot)>,
}

/// The index of a slot.
pub(super) type SlotIndex = u16;
/// The index of a slot and one.
pub(super) type NonZeroSlot = core::num::NonZeroU16;

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
    arrived_at: [LocalTime; NewestAtSix::COUNT],
    newest: [Option<NonZeroSlot>; NewestAtSix::COUNT],
}

impl NewestAtSix {
    const COUNT: usize = 6;
    const EMPTY: Self = Self { arrived_at: [LocalTime::ZERO; Self::COUNT], newest: [None; Self::COUNT] };
}

/// The index of the slot with this number.
#[inline]
fn slot_index(slot: NonZeroSlot) -> usize {
    usize::from(slot.get() - 1)
}

impl<M: Copy> Column<M> {
    /// The column of a swarm with so many receivers, before any message.
    pub(super) fn new(count: usize) -> Self {
        let places = vec![NewestAtSix::EMPTY; count.div_ceil(NewestAtSix::COUNT)];
        Self { slots: Vec::new(), free: Vec::new(), count, places, delivered: None }
    }

    /// Puts a message into a slot.
    pub(super) fn put(&mut self, slot: Slot<M>) -> SlotIndex {
        if self.free.is_empty() {
            self.sweep();
        }
        if let Some(index) = self.free.pop() {
            self.slots[usize::from(index)] = slot;
            index
        } else {
            self.slots.push(slot);
            (self.slots.len() - 1) as SlotIndex
        }
    }

    /// Frees the slots of messages that are the newest at no receiver and will not be delivered. If they are few, more room is
    /// made, so that the next sweep is some messages away.
    fn sweep(&mut self) {
        let mut is_needed: Vec<bool> = self.slots.iter().map(|slot| slot.in_flight > 0).collect();
        let newest = (0..self.count).filter_map(|receiver| self.newest_slot(receiver));
        newest.for_each(|slot| is_needed[slot_index(slot)] = true);
        let unneeded = is_needed.iter().enumerate().filter(|(_, is_needed)| !**is_needed);
        self.free.extend(unneeded.map(|(index, _)| index as SlotIndex));
        const ROOM: usize = 3;
        let more = ROOM.saturating_sub(self.free.len());
        if let (Some(&any), true) = (self.slots.last(), more > 0) {
            let begin = self.slots.len();
            self.slots.reserve_exact(more);
            self.slots.resize(begin + more, any);
            self.slots[begin..].iter_mut().for_each(|slot| slot.in_flight = 0);
            self.free.extend((begin..self.slots.len()).map(|index| index as SlotIndex));
        }
    }

    /// The message in a slot.
    #[inline]
    pub(super) fn slot(&self, index: SlotIndex) -> &Slot<M> {
        &self.slots[usize::from(index)]
    }

    /// The message in a slot, to be changed.
    pub(super) fn slot_mut(&mut self, index: SlotIndex) -> &mut Slot<M> {
        &mut self.slots[usize::from(index)]
    }

    /// The newest message at a receiver, and its arrival.
    #[inline]
    pub(super) fn newest(&self, receiver: usize) -> Option<(&Slot<M>, LocalTime)> {
        let (places, nth) = (self.places.get(receiver / NewestAtSix::COUNT)?, receiver % NewestAtSix::COUNT);
        Some((&self.slots[slot_index(places.newest[nth]?)], places.arrived_at[nth]))
    }

    /// The slot of the newest message at a receiver, plus one.
    #[inline]
    pub(super) fn newest_slot(&self, receiver: usize) -> Option<NonZeroSlot> {
        self.places[receiver / NewestAtSix::COUNT].newest[receiver % NewestAtSix::COUNT]
    }

    /// The message with this number.
    pub(super) fn numbered(&self, slot: NonZeroSlot) -> &Slot<M> {
        &self.slots[slot_index(slot)]
    }

    /// Makes a message the newest one at a receiver.
    #[inline]
    pub(super) fn receive(&mut self, receiver: usize, slot: SlotIndex, at: LocalTime) {
        let (places, nth) = (&mut self.places[receiver / NewestAtSix::COUNT], receiver % NewestAtSix::COUNT);
        (places.newest[nth], places.arrived_at[nth]) = (NonZeroSlot::new(slot + 1), at);
    }

    /// Forgets what a receiver has received.
    pub(super) fn forget(&mut self, receiver: usize) {
        self.places[receiver / NewestAtSix::COUNT].newest[receiver % NewestAtSix::COUNT] = None;
    }

    /// The slot, plus one, of the newest message that any receiver has received so far.
    pub(super) fn delivered(&self) -> Option<NonZeroSlot> {
        self.delivered.map(|(_, slot)| slot)
    }

    /// Notes that a message reaches receivers. Returns whether it is newer than all that any of them has received.
    pub(super) fn note_delivery(&mut self, slot: SlotIndex) -> bool {
        let order = self.slot(slot).order;
        let is_newest = self.delivered.is_none_or(|(delivered, _)| delivered < order);
        if is_newest {
            self.delivered = NonZeroSlot::new(slot + 1).map(|slot| (order, slot));
        }
        is_newest
    }

    /// The receivers at which another message than this one is the newest.
    pub(super) fn with_others(&self, slot: NonZeroSlot) -> VehicleSet {
        let alike = [Some(slot); NewestAtSix::COUNT];
        let mut others = VehicleSet::default();
        // At most receivers it is the newest.
        for (first, places) in
            (0..).step_by(NewestAtSix::COUNT).zip(&self.places).filter(|(_, places)| places.newest != alike)
        {
            let receivers = VehicleId::first(self.count).skip(first).zip(places.newest);
            receivers.filter(|(_, newest)| *newest != Some(slot)).for_each(|(id, _)| others.insert(id));
        }
        others
    }

    /// Makes a message the newest one at all receivers but these.
    pub(super) fn fill(&mut self, slot: SlotIndex, left_out: VehicleSet, at: LocalTime) {
        let slot = NonZeroSlot::new(slot + 1);
        let all = NewestAtSix { arrived_at: [at; NewestAtSix::COUNT], newest: [slot; NewestAtSix::COUNT] };
        let mut left_out = left_out.iter().map(index).peekable();
        for (end, places) in (NewestAtSix::COUNT..).step_by(NewestAtSix::COUNT).zip(&mut self.places) {
            let before = *places;
            *places = all;
            while let Some(receiver) = left_out.next_if(|receiver| *receiver < end) {
                let nth = receiver % NewestAtSix::COUNT;
                (places.newest[nth], places.arrived_at[nth]) = (before.newest[nth], before.arrived_at[nth]);
            }
        }
    }
}
