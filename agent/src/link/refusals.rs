//! What of others was not believed: counted by reason, and the latest kinds by name, so that somebody can go and look.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Mutex, MutexGuard, PoisonError};

use skein_common::message::{Drops, Reason, Refused};
use skein_common::topic::Topic;

/// How many kinds of reason there are.
const REASONS: usize = Reason::Old as usize + 1;

/// Counted by Zenoh's threads; bounded, whatever comes.
#[derive(Debug, Default)]
pub(super) struct Refusals {
    counts: [AtomicU64; REASONS],
    /// The latest kind last.
    named: Mutex<Vec<Refused>>,
}

impl Refusals {
    /// One more; gives how many there were for this reason.
    pub(super) fn count(&self, reason: Reason, key: &str) -> u64 {
        let key = Refused::printable(&without_cell(key));
        let mut named = self.lock();
        let known = named.iter().position(|kind| (kind.reason, &kind.key) == (reason, &key));
        let before = match known {
            Some(nth) => named.remove(nth).count,
            None if named.len() == Refused::MAX_COUNT => {
                named.remove(0);
                0
            }
            None => 0,
        };
        named.push(Refused { reason, key, count: before + 1 });
        self.counter(reason).fetch_add(1, Relaxed) + 1
    }

    /// By reason.
    pub(super) fn drops(&self) -> Drops {
        let count = |reason| self.counter(reason).load(Relaxed);
        Drops {
            undecodable: count(Reason::Undecodable),
            other_version: count(Reason::OtherVersion),
            forged: [Reason::Forged, Reason::Stranger, Reason::OtherRun].into_iter().map(count).sum(),
            old: count(Reason::Old),
            unsealed: count(Reason::Unsealed),
            other_plan: count(Reason::OtherPlan),
            links: count(Reason::Link),
            ..Drops::default()
        }
    }

    /// The latest kinds, the latest first.
    pub(super) fn named(&self) -> Vec<Refused> {
        self.lock().iter().rev().cloned().collect()
    }

    fn counter(&self, reason: Reason) -> &AtomicU64 {
        &self.counts[reason as usize]
    }

    /// Nothing that holds the lock can panic half way.
    fn lock(&self) -> MutexGuard<'_, Vec<Refused>> {
        self.named.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// One kind of word of one vehicle has one name, wherever the vehicle is; one kind of order, whoever gives it.
fn without_cell(key: &str) -> String {
    match Topic::parse(key) {
        Some(Topic::State(id, _)) => format!("vehicle/{id}/state"),
        Some(Topic::Order(_)) => "order".to_owned(),
        _ => key.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_are_named_by_reason_and_key_the_latest_first() {
        let refusals = Refusals::default();
        for (reason, key) in [
            (Reason::Forged, "vehicle/3/cell/0/-1/state"),
            (Reason::Unsealed, "order/17"),
            (Reason::Forged, "vehicle/3/cell/5/0/state"),
            (Reason::Stranger, "vehicle/9/mission"),
            (Reason::Unsealed, "order/18"),
        ] {
            refusals.count(reason, key);
        }
        let named: Vec<_> = refusals.named().into_iter().map(|kind| (kind.reason, kind.key, kind.count)).collect();
        let expected = [
            (Reason::Unsealed, "order", 2),
            (Reason::Stranger, "vehicle/9/mission", 1),
            (Reason::Forged, "vehicle/3/state", 2),
        ];
        assert_eq!(named, expected.map(|(reason, key, count)| (reason, key.to_owned(), count)));
        assert_eq!(refusals.drops(), Drops { forged: 3, unsealed: 2, ..Drops::default() });
        assert_eq!(refusals.drops().refused(), 5);
    }

    #[test]
    fn whatever_keys_somebody_thinks_up_the_list_stays_short_and_printable() {
        let refusals = Refusals::default();
        for nth in 0..1000 {
            refusals.count(Reason::Undecodable, &format!("vehicle/\u{1b}[2J{nth}/{}", "x".repeat(1000)));
        }
        let named = refusals.named();
        assert_eq!(named.len(), Refused::MAX_COUNT);
        assert!(named[0].key.starts_with("vehicle/?[2J999/x") && named[0].key.len() == Refused::MAX_KEY, "{named:?}");
        assert_eq!(refusals.drops().undecodable, 1000);
    }
}
