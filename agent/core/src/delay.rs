//! Measures the delay of a peer's messages without synchronised clocks.
//!
//! Every heartbeat echoes the stamp of one peer's last heartbeat, each peer in turn, with the time for which the stamp
//! was held. The time since the stamp by the own clock, minus the hold, is the *round trip*: the delays of both
//! directions together. Two clocks cannot separate the two directions, so the whole round trip bounds the delay of
//! either.
//!
//! The *transit* of a message is its arrival by the own clock minus its stamp by the sender's clock: its delay plus the
//! unknown, constant difference of the two clocks. A change of the transit is therefore a change of the delay, visible
//! in the first message it affects, and one round trip k bounds the delay of every earlier or later message m:
//!
//! delay(m) ≤ round trip(k) + transit(m) − transit(k).
//!
//! If both directions are alike, it is less by half a round trip.
//!
//! The smallest bound of the last round trips is used. The likely delay is that of the shortest round trip, as in NTP's
//! clock filter (RFC 5905, section 10); its error is at most half of that round trip. Clocks drift apart by 2·10⁻⁴ s/s,
//! so a bound grows with the age of its round trip; after a minute it is dropped. After a clock was set, an old round
//! trip gives either a negative delay, and is dropped, or a larger delay than the new ones, and has no effect.
//!
//! A peer can report a false hold, like any other false figure about itself. Then its own messages look younger than
//! they are; the ages of other vehicles' messages are not affected.

use alloc::collections::VecDeque;
use alloc::vec::Vec;
use core::ops::Range;

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::Echo;
use skein_common::time::{LocalTime, SenderStamp};

use crate::deadlines::Deadline;

/// Number of round trips kept.
const ROUND_TRIPS_KEPT: usize = 4;
/// Upper bound of the drift between two quartz clocks, s/s.
const DRIFT: f64 = 2e-4;
/// Largest negative delay that does not contradict its round trip, s.
const TOLERANCE_S: f64 = 0.005;
/// Number of own stamps remembered: 25 s of heartbeats.
const STAMPS_KEPT: usize = 128;

/// The delay of one message.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MessageDelay {
    /// Upper bound of the delay, s.
    pub most_s: f64,
    /// Delay if both directions are alike, s.
    pub likely_s: f64,
}

/// The last round trips to one peer.
#[derive(Clone, Debug)]
pub struct RoundTrips([RoundTrip; ROUND_TRIPS_KEPT]);

#[derive(Clone, Copy, Debug)]
struct RoundTrip {
    /// Arrival time of the echo.
    at: LocalTime,
    s: f64,
    /// Transit of the heartbeat that carried the echo, s.
    transit_s: f64,
}

impl RoundTrip {
    /// In place of a round trip that is not known: it bounds no delay.
    const NONE: Self = Self { at: LocalTime::ZERO, s: f64::NAN, transit_s: 0.0 };

    fn is_valid(&self, now: LocalTime) -> bool {
        !self.s.is_nan() && !Deadline::RoundTripOld.is_past(now.seconds_since(self.at))
    }

    /// The upper bound of the delay of a message with this transit, s; below zero it contradicts the message.
    fn bound_s(&self, now: LocalTime, transit_s: f64) -> f64 {
        self.s + transit_s - self.transit_s + DRIFT * now.seconds_since(self.at)
    }

    /// The bound for a message with no transit at the zero of the own clock, s. All bounds grow alike with the transit and
    /// with time.
    fn base_s(&self) -> f64 {
        self.s - self.transit_s - DRIFT * self.at.seconds()
    }
}

/// The delay of a message as its round trips give it for the instant of its arrival; from then on it grows with the
/// drift of clocks.
#[derive(Clone, Copy, Debug)]
pub struct DelayAtArrival {
    most_s: f64,
    likely_s: f64,
}

impl DelayAtArrival {
    /// The delay as known this time after the arrival, s; `None` without a round trip, or if it contradicts the message.
    #[inline]
    pub fn after(&self, since_s: f64) -> Option<MessageDelay> {
        let grown_s = DRIFT * since_s;
        let most_s = self.most_s + grown_s;
        (most_s >= -TOLERANCE_S)
            .then(|| MessageDelay { most_s: most_s.max(0.0), likely_s: (self.likely_s + grown_s).min(most_s).max(0.0) })
    }

    /// An upper bound of the likely delay until this time after the arrival, s, for bases and excesses up to those of this
    /// delay; zero without a round trip.
    pub fn likely_at_most_s(&self, since_s: f64) -> f64 {
        (self.likely_s + DRIFT * since_s).max(0.0)
    }

    /// The upper bound of the delay, s, as in [`Self::after`].
    #[inline]
    pub fn most_s(&self, since_s: f64) -> Option<f64> {
        let most_s = self.most_s + DRIFT * since_s;
        (most_s >= -TOLERANCE_S).then(|| most_s.max(0.0))
    }
}

/// By how much the delay of a message exceeds that of one with no transit that arrives at the zero of the own clock, s.
#[derive(Clone, Copy, Debug, Default)]
pub struct Excess(f64);

impl Excess {
    /// The excess of the same message by a clock that is ahead by this, s.
    #[must_use]
    pub fn by_clock_ahead(self, ahead_s: f64) -> Self {
        Self(self.0 + (1.0 + DRIFT) * ahead_s)
    }

    /// The excess of a message that arrived at `at` with this transit, s.
    pub fn new(at: LocalTime, transit_s: f64) -> Self {
        Self(transit_s + DRIFT * at.seconds())
    }

    /// The larger of the two.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self(self.0.max(other.0))
    }
}

/// The delay of a message with no transit that arrives at the zero of the own clock: all other delays follow from it.
#[derive(Clone, Copy, Debug)]
pub struct DelayBase {
    most_s: f64,
    likely_s: f64,
}

impl DelayBase {
    /// Without a round trip no delay is known.
    pub const UNKNOWN: Self = Self { most_s: f64::NAN, likely_s: f64::NAN };

    /// Takes the larger one of each of the two delays.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self { most_s: self.most_s.max(other.most_s), likely_s: self.likely_s.max(other.likely_s) }
    }

    /// The delay of a message by its excess at its arrival.
    #[inline]
    pub fn at_arrival(&self, excess: Excess) -> DelayAtArrival {
        DelayAtArrival { most_s: self.most_s + excess.0, likely_s: self.likely_s + excess.0 }
    }
}

impl Default for RoundTrips {
    fn default() -> Self {
        Self([RoundTrip::NONE; ROUND_TRIPS_KEPT])
    }
}

impl RoundTrips {
    /// Adds the round trip measured by a heartbeat with this transit. An impossible round trip is ignored.
    pub fn take(&mut self, at: LocalTime, transit_s: f64, round_trip_s: f64) {
        if !(-TOLERANCE_S..Deadline::RoundTripOld.after_s()).contains(&round_trip_s) {
            return;
        }
        for old in &mut self.0 {
            // A contradiction means that a clock was set in between.
            if !old.is_valid(at) || old.bound_s(at, transit_s) < -TOLERANCE_S {
                *old = RoundTrip::NONE;
            }
        }
        // The absent ones are as old as the clock.
        if let Some(oldest) = self.0.iter_mut().min_by_key(|trip| trip.at) {
            *oldest = RoundTrip { at, s: round_trip_s.max(0.0), transit_s };
        }
    }

    /// The delays by the round trips that determine them from now on: of those that are not too old, the one with the
    /// smallest bound, and the shortest. All bounds grow alike, so that the choice is right until another trip is taken,
    /// or until the time that is returned besides: then one of the two is too old.
    pub fn choose(&self, now: LocalTime) -> (DelayBase, LocalTime) {
        let least = |of: fn(&RoundTrip) -> f64| {
            let valid = self.0.iter().filter(|trip| trip.is_valid(now));
            valid.min_by(|one, other| of(one).total_cmp(&of(other)))
        };
        let chosen = least(RoundTrip::base_s).zip(least(|trip| trip.s));
        let Some((tightest, shortest)) = chosen else { return (DelayBase::UNKNOWN, LocalTime::MAX) };
        let base = DelayBase { most_s: tightest.base_s(), likely_s: shortest.base_s() - shortest.s / 2.0 };
        (base, tightest.at.min(shortest.at).plus_seconds(Deadline::RoundTripOld.after_s()))
    }
}

/// The last round trips to all peers, in the memory that those need which are known and not too old: in a large swarm a
/// peer's turn comes about once a minute.
#[derive(Clone, Debug, Default)]
pub struct RoundTripTable {
    /// For each round trip its peer and its place among those to this peer, in ascending order.
    keys: Vec<(VehicleId, u8)>,
    trips: Vec<RoundTrip>,
}

impl RoundTripTable {
    /// The last round trips to a peer.
    pub fn to(&self, peer: VehicleId) -> RoundTrips {
        let mut trips = RoundTrips::default();
        for nth in self.range(peer) {
            trips.0[usize::from(self.keys[nth].1)] = self.trips[nth];
        }
        trips
    }

    /// Replaces the round trips to a peer. Those that are too old by now are left out.
    pub fn set(&mut self, peer: VehicleId, trips: &RoundTrips, now: LocalTime) {
        let range = self.range(peer);
        let kept = || (0..).zip(&trips.0).filter(|(_, trip)| trip.is_valid(now));
        if self.keys.len() + ROUND_TRIPS_KEPT > self.keys.capacity() {
            // A little more than what is needed, and not twice as much.
            let more = ROUND_TRIPS_KEPT + self.keys.len() / 32;
            self.keys.reserve_exact(more);
            self.trips.reserve_exact(more);
        }
        self.keys.splice(range.clone(), kept().map(|(place, _)| (peer, place)));
        self.trips.splice(range, kept().map(|(_, trip)| *trip));
    }

    /// Forgets the round trips to a peer.
    pub fn forget(&mut self, peer: VehicleId) {
        let range = self.range(peer);
        self.keys.drain(range.clone());
        self.trips.drain(range);
    }

    fn range(&self, peer: VehicleId) -> Range<usize> {
        let begin = self.keys.partition_point(|(of, _)| *of < peer);
        let count = self.keys[begin..].iter().take_while(|(of, _)| *of == peer).count();
        begin..begin + count
    }
}

/// The stamps this vehicle has sent, and the peer whose stamp it echoes next.
#[derive(Clone, Debug, Default)]
pub struct Exchange {
    sent: VecDeque<SenderStamp>,
    /// The peer whose stamp was echoed last.
    last: Option<VehicleId>,
}

impl Exchange {
    /// Remembers the stamp of a heartbeat that is being sent.
    pub fn send(&mut self, stamp: SenderStamp) {
        if self.sent.len() == STAMPS_KEPT {
            self.sent.pop_front();
        }
        self.sent.push_back(stamp);
    }

    /// The round trip of an echo that arrived at `at`, s; `None` if this vehicle has not sent the stamp recently.
    pub fn round_trip_s(&self, at: LocalTime, echo: &Echo) -> Option<f64> {
        self.sent.contains(&echo.stamp).then(|| since_stamp_s(at, echo.stamp) - echo.held_s())
    }

    /// The peer whose stamp is echoed next, of these peers in ascending order.
    pub fn next_partner(&mut self, partners: VehicleSet) -> Option<VehicleId> {
        let after = self.last.and_then(|last| partners.first_above(last));
        self.last = after.or_else(|| partners.first());
        self.last
    }
}

/// The own clock minus a stamp, s. For a peer's stamp at its arrival this is the transit.
pub fn since_stamp_s(at: LocalTime, stamp: SenderStamp) -> f64 {
    at.nanoseconds().wrapping_sub(stamp.nanoseconds()) as i64 as f64 * 1e-9
}

#[cfg(test)]
mod tests;
