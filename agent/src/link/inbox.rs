//! Received messages that the control thread has not yet read: the newest of each peer and kind, with its arrival time.
//!
//! A newer message replaces an older one (a later state, a larger order, a token that is up or gone), so the inbox
//! needs no queue, never overflows, and is bounded by the number of vehicle ids.

use std::sync::{Mutex, MutexGuard, PoisonError};

use skein_common::id::VehicleId;
use skein_common::message::{Drops, Reason, Refused};

use super::refusals::Refusals;
use skein_core::peers::{PeerMessage, Received};

/// State, heartbeat and token of each vehicle, and the largest order.
const CAPACITY: usize = 3 * VehicleId::MAX as usize + 1;

/// Filled by Zenoh's threads, emptied by the control thread.
#[derive(Debug)]
pub(super) struct Inbox {
    received: Mutex<Vec<Received>>,
    refusals: Refusals,
}

impl Inbox {
    pub(super) fn new() -> Self {
        Self { received: Mutex::new(Vec::with_capacity(CAPACITY)), refusals: Refusals::default() }
    }

    /// Stores a message that came under this key, in place of an older one of the same peer and kind.
    pub(super) fn store(&self, key: &str, new: Received) {
        let mut received = self.lock();
        match received.iter_mut().find(|kept| is_same_kind(&kept.message, &new.message)) {
            Some(kept) if is_later(&new.message, &kept.message) => *kept = new,
            // A late joiner's query delivers a heartbeat twice.
            Some(kept) if matches!(new.message, PeerMessage::Mission(_)) && kept.message == new.message => {}
            Some(_) => {
                drop(received);
                self.refusals.count(Reason::Old, key);
            }
            None => received.push(new),
        }
    }

    /// Moves all messages to the end of `received`.
    pub(super) fn drain(&self, received: &mut Vec<Received>) {
        received.append(&mut self.lock());
    }

    /// Counts a refused message that was logged already.
    pub(super) fn count(&self, reason: Reason, key: &str) {
        self.refusals.count(reason, key);
    }

    /// Counts a refused message; logs the first, second, fourth, eighth and so on.
    pub(super) fn refuse(&self, reason: Reason, key: &str, what: &dyn std::fmt::Display) {
        let count = self.refusals.count(reason, key);
        if count.is_power_of_two() {
            tracing::warn!(count, key, "message refused: {what}");
        }
    }

    /// Number of messages that wait.
    pub(super) fn len(&self) -> usize {
        self.lock().len()
    }

    pub(super) fn drops(&self) -> Drops {
        self.refusals.drops()
    }

    /// The refused messages by reason and key, the latest first.
    pub(super) fn refused(&self) -> Vec<Refused> {
        self.refusals.latest()
    }

    /// Locks the messages. No holder can panic, so poisoning is ignored.
    fn lock(&self) -> MutexGuard<'_, Vec<Received>> {
        self.received.lock().unwrap_or_else(PoisonError::into_inner)
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
        (PeerMessage::Order(_), PeerMessage::Order(_)) => true,
        _ => false,
    }
}

fn is_later(new: &PeerMessage, kept: &PeerMessage) -> bool {
    match (new, kept) {
        (PeerMessage::State(new), PeerMessage::State(kept)) => new.header.order() > kept.header.order(),
        (PeerMessage::Mission(new), PeerMessage::Mission(kept)) => new.header.order() > kept.header.order(),
        (PeerMessage::Order(new), PeerMessage::Order(kept)) => new > kept,
        _ => true,
    }
}

#[cfg(test)]
impl Inbox {
    pub(super) fn capacity(&self) -> usize {
        self.lock().capacity()
    }
}
