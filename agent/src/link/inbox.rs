//! Received messages that the control thread has not yet read: the newest of each peer and kind, with its arrival time.
//!
//! A newer message replaces an older one (a later state, a token that is up or gone). An order replaces those of which it
//! takes the place: two orders that are both in force both wait. The inbox therefore needs no queue, never overflows, and is
//! bounded by the number of vehicle ids and of keys that can change in flight.

use parking_lot::Mutex;
use skein_common::id::VehicleId;
use skein_common::message::{Order, Reason, StandingOrders};
use skein_common::scenario::TunableKey;

use super::refusals::Refusals;
use skein_core::peers::{PeerMessage, Received};

/// State, heartbeat and token of each vehicle, and the orders: of each vehicle, of the swarm, and of each key.
const CAPACITY: usize = 4 * VehicleId::MAX as usize + 1 + TunableKey::ALL.len();

/// Filled by Zenoh's threads, emptied by the control thread.
#[derive(Debug)]
pub(super) struct Inbox {
    waiting: Mutex<Waiting>,
    /// The messages that were refused.
    pub(super) refusals: Refusals,
}

#[derive(Debug)]
struct Waiting {
    received: Vec<Received>,
    /// The orders among them.
    orders: StandingOrders,
}

impl Inbox {
    pub(super) fn new() -> Self {
        let waiting = Waiting { received: Vec::with_capacity(CAPACITY), orders: StandingOrders::default() };
        Self { waiting: Mutex::new(waiting), refusals: Refusals::default() }
    }

    /// Stores a message that came under this key, in place of an older one of the same peer and kind.
    pub(super) fn store(&self, key: &str, new: Received) {
        if !self.waiting.lock().add(new) {
            self.refusals.count(Reason::Old, key);
        }
    }

    /// Moves all messages to the end of `received`.
    pub(super) fn drain(&self, received: &mut Vec<Received>) {
        let mut waiting = self.waiting.lock();
        received.append(&mut waiting.received);
        waiting.orders = StandingOrders::default();
    }

    /// Number of messages that wait.
    pub(super) fn len(&self) -> usize {
        self.waiting.lock().received.len()
    }
}

impl Waiting {
    /// Adds a message, in place of those that it replaces; false if it is old.
    fn add(&mut self, new: Received) -> bool {
        if let PeerMessage::Order(order) = new.message {
            return self.add_order(order, new);
        }
        match self.received.iter_mut().find(|kept| is_same_kind(&kept.message, &new.message)) {
            Some(kept) if is_later(&new.message, &kept.message) => *kept = new,
            // A late joiner's query delivers a heartbeat twice.
            Some(kept) => return matches!(new.message, PeerMessage::Mission(_)) && kept.message == new.message,
            None => self.received.push(new),
        }
        true
    }

    fn add_order(&mut self, order: Order, new: Received) -> bool {
        let Self { received, orders } = self;
        let is_new = orders.merge(order);
        if is_new {
            received.retain(|kept| match kept.message {
                PeerMessage::Order(order) => orders.iter().any(|standing| standing == order),
                _ => true,
            });
            received.push(new);
        }
        is_new
    }
}

fn is_same_kind(one: &PeerMessage, other: &PeerMessage) -> bool {
    match (one, other) {
        (PeerMessage::State(one), PeerMessage::State(other)) => one.header.sender == other.header.sender,
        (PeerMessage::Mission(one), PeerMessage::Mission(other)) => one.header.sender == other.header.sender,
        (
            PeerMessage::Appeared(one) | PeerMessage::Vanished(one),
            PeerMessage::Appeared(other) | PeerMessage::Vanished(other),
        ) => one == other,
        _ => false,
    }
}

fn is_later(new: &PeerMessage, kept: &PeerMessage) -> bool {
    match (new, kept) {
        (PeerMessage::State(new), PeerMessage::State(kept)) => new.header.order() > kept.header.order(),
        (PeerMessage::Mission(new), PeerMessage::Mission(kept)) => new.header.order() > kept.header.order(),
        _ => true,
    }
}

#[cfg(test)]
impl Inbox {
    pub(super) fn capacity(&self) -> usize {
        self.waiting.lock().received.capacity()
    }
}
