//! What was heard and not yet taken up: the newest word of each peer and kind, each with the time of its arrival.
//!
//! Every word is a register (a later state replaces an earlier one, the larger order stands, a token is there or not), so
//! nothing is queued, nothing overflows, and the size is bounded by the number of vehicle ids.

use std::sync::{Mutex, MutexGuard, PoisonError};

use skein_common::id::VehicleId;
use skein_common::message::{Drops, Reason, Refused};

use super::refusals::Refusals;
use skein_core::peers::{Heard, Word};

/// State, agreement and token of each vehicle, and the largest order.
const CAPACITY: usize = 3 * VehicleId::MAX as usize + 1;

/// Filled by Zenoh's threads, emptied by the control thread.
#[derive(Debug)]
pub(super) struct Inbox {
    heard: Mutex<Vec<Heard>>,
    refusals: Refusals,
}

impl Inbox {
    pub(super) fn new() -> Self {
        Self { heard: Mutex::new(Vec::with_capacity(CAPACITY)), refusals: Refusals::default() }
    }

    /// Files a word, which came under this key, in place of an earlier one of the same peer and kind.
    pub(super) fn file(&self, key: &str, new: Heard) {
        let mut heard = self.lock();
        match heard.iter_mut().find(|kept| is_same_register(&kept.word, &new.word)) {
            Some(kept) if is_later(&new.word, &kept.word) => *kept = new,
            // A register is told again to whoever asks for it.
            Some(kept) if matches!(new.word, Word::Mission(_)) && kept.word == new.word => {}
            Some(_) => {
                drop(heard);
                self.refusals.count(Reason::Old, key);
            }
            None => heard.push(new),
        }
    }

    /// Moves everything to the end of `heard`.
    pub(super) fn drain(&self, heard: &mut Vec<Heard>) {
        heard.append(&mut self.lock());
    }

    /// Counts something that is not believed, and that the log knows already.
    pub(super) fn count(&self, reason: Reason, key: &str) {
        self.refusals.count(reason, key);
    }

    /// Counts something that is not believed; the first, second, fourth, eighth time with a line in the log.
    pub(super) fn refuse(&self, reason: Reason, key: &str, what: &dyn std::fmt::Display) {
        let count = self.refusals.count(reason, key);
        if count.is_power_of_two() {
            tracing::warn!(count, key, "not believed: {what}");
        }
    }

    pub(super) fn drops(&self) -> Drops {
        self.refusals.drops()
    }

    /// What was refused, the latest kinds first.
    pub(super) fn refused(&self) -> Vec<Refused> {
        self.refusals.named()
    }

    /// Nothing that holds the lock can panic half way.
    fn lock(&self) -> MutexGuard<'_, Vec<Heard>> {
        self.heard.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn is_same_register(one: &Word, other: &Word) -> bool {
    match (one, other) {
        (Word::State(one), Word::State(other)) => one.header.sender == other.header.sender,
        (Word::Mission(one), Word::Mission(other)) => one.header.sender == other.header.sender,
        (Word::Appeared(one) | Word::Vanished(one), Word::Appeared(other) | Word::Vanished(other)) => one == other,
        (Word::Order(_), Word::Order(_)) => true,
        _ => false,
    }
}

fn is_later(new: &Word, kept: &Word) -> bool {
    match (new, kept) {
        (Word::State(new), Word::State(kept)) => new.header.order() > kept.header.order(),
        (Word::Mission(new), Word::Mission(kept)) => new.header.order() > kept.header.order(),
        (Word::Order(new), Word::Order(kept)) => new > kept,
        _ => true,
    }
}

#[cfg(test)]
impl Inbox {
    pub(super) fn capacity(&self) -> usize {
        self.lock().capacity()
    }
}
