//! Counts refused messages by reason, and keeps the latest kinds by key for the operator to look at.

use std::fmt::Display;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use parking_lot::Mutex;
use skein_common::message::{Drops, Reason, Refused};
use skein_common::topic::{Branch, Topic};

/// Number of reasons.
const REASONS: usize = Reason::Old as usize + 1;

/// Counts of refused messages, written by Zenoh's threads. Its size is bounded whatever arrives.
#[derive(Debug, Default)]
pub(super) struct Refusals {
    counts: [AtomicU64; REASONS],
    /// Refusals by reason and key, the latest last.
    latest: Mutex<Vec<Refused>>,
}

impl Refusals {
    /// Counts a refused message; logs the first, second, fourth, eighth and so on.
    pub(super) fn refuse(&self, reason: Reason, key: &str, what: &dyn Display) {
        let count = self.count(reason, key);
        if count.is_power_of_two() {
            tracing::warn!(count, key, "message refused: {what}");
        }
    }

    /// Counts one refusal, which is not logged; returns the number with this reason.
    pub(super) fn count(&self, reason: Reason, key: &str) -> u64 {
        let key = Refused::printable(&without_cell(key));
        let mut latest = self.latest.lock();
        let known = latest.iter().position(|kind| (kind.reason, &kind.key) == (reason, &key));
        let before = match known {
            Some(nth) => latest.remove(nth).count,
            None if latest.len() == Refused::MAX_COUNT => {
                latest.remove(0);
                0
            }
            None => 0,
        };
        latest.push(Refused { reason, key, count: before + 1 });
        self.counter(reason).fetch_add(1, Relaxed) + 1
    }

    /// The counts by reason.
    pub(super) fn drops(&self) -> Drops {
        let count = |reason| self.counter(reason).load(Relaxed);
        Drops {
            undecodable: count(Reason::Undecodable),
            other_version: count(Reason::OtherVersion),
            forged: [Reason::Forged, Reason::UnknownVehicle, Reason::OtherRun].into_iter().map(count).sum(),
            old: count(Reason::Old),
            unsigned: count(Reason::Unsealed),
            other_plan: count(Reason::OtherPlan),
            links: count(Reason::Link),
            ..Drops::default()
        }
    }

    /// The latest refusals by reason and key, the latest first.
    pub(super) fn latest(&self) -> Vec<Refused> {
        self.latest.lock().iter().rev().cloned().collect()
    }

    fn counter(&self, reason: Reason) -> &AtomicU64 {
        &self.counts[reason as usize]
    }
}

/// The key without the parts that vary: a vehicle's cell and an order's issuer.
fn without_cell(key: &str) -> String {
    match Branch::parse(key) {
        Some((branch, Topic::State(id, _))) => branch.all(&format!("vehicle/{id}/state")),
        Some((branch, Topic::Intent(id, _))) => branch.all(&format!("vehicle/{id}/intent")),
        Some((branch, Topic::Order(_))) => branch.all("order"),
        _ => key.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_are_listed_by_reason_and_key_the_latest_first() {
        let refusals = Refusals::default();
        for (reason, key) in [
            (Reason::Forged, "vehicle/3/cell/0/-1/state"),
            (Reason::Unsealed, "order/17"),
            (Reason::Forged, "vehicle/3/cell/5/0/state"),
            (Reason::UnknownVehicle, "vehicle/9/mission"),
            (Reason::Unsealed, "order/18"),
        ] {
            refusals.count(reason, key);
        }
        let latest: Vec<_> = refusals.latest().into_iter().map(|kind| (kind.reason, kind.key, kind.count)).collect();
        let expected = [
            (Reason::Unsealed, "order", 2),
            (Reason::UnknownVehicle, "vehicle/9/mission", 1),
            (Reason::Forged, "vehicle/3/state", 2),
        ];
        assert_eq!(latest, expected.map(|(reason, key, count)| (reason, key.to_owned(), count)));
        assert_eq!(refusals.drops(), Drops { forged: 3, unsigned: 2, ..Drops::default() });
        assert_eq!(refusals.drops().refused(), 5);
    }

    #[test]
    fn the_list_of_refusals_stays_short_and_printable_for_any_keys() {
        let refusals = Refusals::default();
        for nth in 0..1000 {
            refusals.count(Reason::Undecodable, &format!("vehicle/\u{1b}[2J{nth}/{}", "x".repeat(1000)));
        }
        let latest = refusals.latest();
        assert_eq!(latest.len(), Refused::MAX_COUNT);
        assert!(
            latest[0].key.starts_with("vehicle/?[2J999/x") && latest[0].key.len() == Refused::MAX_KEY,
            "{latest:?}"
        );
        assert_eq!(refusals.drops().undecodable, 1000);
    }
}
