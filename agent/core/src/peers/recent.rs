//! The senders of recent messages, as sets of vehicles for short times that follow each other.

use skein_common::id::VehicleSet;
use skein_common::time::LocalTime;

use super::peer::FRESH_S;

/// The vehicles of which messages have arrived lately: within [`Self::WITHIN`] of the longest silence that is allowed, which
/// changes at most to its half or its double at a time.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RecentSenders {
    /// The begin of each of the last times with its vehicles, the present one first.
    times: [(LocalTime, VehicleSet); Self::TIMES],
}

impl RecentSenders {
    const TIMES: usize = 4;
    /// Share of the longest silence after which the next time begins.
    const PERIOD: f64 = 0.16;
    /// Share of the longest silence that may be between two updates. Messages of a longer time are not noted.
    const LONGEST_STEP: f64 = 0.03;
    /// Share of the longest silence since the begin of a time up to which that time counts.
    const BEGUN_WITHIN: f64 = Self::TIMES as f64 * (Self::PERIOD + Self::LONGEST_STEP);
    /// A message of a time may have arrived one step before the time began, and then the longest silence may have been halved.
    pub(super) const WITHIN: f64 = Self::BEGUN_WITHIN + 2.0 * Self::LONGEST_STEP;

    /// Notes the senders of the messages between the update at `before` and this one. `longest_s` is the longest silence, s.
    pub(super) fn insert(&mut self, senders: VehicleSet, (before, now): (LocalTime, LocalTime), longest_s: f64) {
        if now.seconds_since(self.times[0].0) >= Self::PERIOD * longest_s {
            self.times.rotate_right(1);
            self.times[0] = (now, VehicleSet::default());
        }
        if now.seconds_since(before) <= Self::LONGEST_STEP * longest_s {
            self.times[0].1.extend(senders);
        }
    }

    /// All of them.
    pub(super) fn all(&self, now: LocalTime, longest_s: f64) -> VehicleSet {
        let counts = |begin: LocalTime| now.seconds_since(begin) <= Self::BEGUN_WITHIN * longest_s;
        let counting = self.times.iter().filter(|(begin, _)| counts(*begin));
        counting.fold(VehicleSet::default(), |all, (_, one)| all.either(*one))
    }
}

/// The vehicles of which states have arrived in each of the last short times.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FreshStates {
    /// The begin of each time with its vehicles; the times follow each other round and round.
    times: [(LocalTime, VehicleSet); Self::TIMES],
    newest: usize,
}

impl FreshStates {
    const SHORTEST_S: f64 = FRESH_S / 10.0;
    /// Together they are longer than [`FRESH_S`].
    const TIMES: usize = 12;

    /// Notes the vehicles of which states have arrived since the update at `before`.
    pub(super) fn insert(&mut self, moved: VehicleSet, before: LocalTime) {
        if before.seconds_since(self.times[self.newest].0) >= Self::SHORTEST_S {
            self.newest = (self.newest + 1) % Self::TIMES;
            self.times[self.newest] = (before, VehicleSet::default());
        }
        self.times[self.newest].1.extend(moved);
    }

    /// The vehicles of which a state is younger than [`FRESH_S`] now, and those of which one may be.
    pub(super) fn at(&self, now: LocalTime) -> (VehicleSet, VehicleSet) {
        let mut fresh = VehicleSet::default();
        for age in 0..Self::TIMES {
            let (begin, moved) = self.times[(self.newest + Self::TIMES - age) % Self::TIMES];
            if now >= begin.plus_seconds(FRESH_S) {
                return (fresh, moved);
            }
            fresh.extend(moved);
        }
        (fresh, VehicleSet::default())
    }
}
