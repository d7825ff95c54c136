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

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::Echo;
use skein_common::time::{LocalTime, SenderStamp};

use crate::deadlines::Deadline;

/// Number of round trips kept.
const ROUND_TRIPS_KEPT: usize = 4;
/// Upper bound of the drift between two quartz clocks, s/s.
const DRIFT: f64 = 2e-4;
/// Time for which a round trip is used, s.
const ROUND_TRIP_VALID_S: f64 = Deadline::RoundTripOld.after_s();
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
#[derive(Clone, Debug, Default)]
pub struct Delay {
    /// In the order of arrival.
    trips: Vec<RoundTrip>,
}

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

    #[inline]
    fn is_old(&self, now: LocalTime) -> bool {
        Deadline::RoundTripOld.is_past(now.seconds_since(self.at))
    }

    /// The upper bound of the delay of a message with this transit, s; below zero it contradicts the message. It grows
    /// with time.
    #[inline]
    fn bound_s(&self, now: LocalTime, transit_s: f64) -> f64 {
        self.s + transit_s - self.transit_s + DRIFT * now.seconds_since(self.at).max(0.0)
    }

    /// The bound without the parts that are the same for all round trips, s. All bounds grow alike with time, so that
    /// the order of round trips by their bounds does not change.
    fn rank_s(&self) -> f64 {
        self.s - self.transit_s - DRIFT * self.at.seconds()
    }
}

/// The round trips that determine the delays of messages until one of them is too old or another one is measured.
#[derive(Clone, Copy, Debug)]
pub struct TripsInUse {
    /// The trip with the smallest bound.
    tightest: RoundTrip,
    shortest: RoundTrip,
}

impl TripsInUse {
    /// No round trip is known, and so no delay.
    pub const NONE: Self = Self { tightest: RoundTrip::NONE, shortest: RoundTrip::NONE };

    /// The delay of a message with this transit now; `None` without a round trip, or if it contradicts the message.
    #[inline]
    pub fn delay(&self, now: LocalTime, transit_s: f64) -> Option<MessageDelay> {
        let most_s = self.most_s(now, transit_s)?;
        let likely_s = self.shortest.bound_s(now, transit_s) - self.shortest.s / 2.0;
        Some(MessageDelay { most_s, likely_s: likely_s.min(most_s).max(0.0) })
    }

    /// The upper bound of a message's delay, s, as in [`Self::delay`].
    #[inline]
    pub fn most_s(&self, now: LocalTime, transit_s: f64) -> Option<f64> {
        let most_s = self.tightest.bound_s(now, transit_s);
        (most_s >= -TOLERANCE_S).then(|| most_s.max(0.0))
    }

    /// Arrival of the older of the two trips; `None` if no round trip is known.
    pub fn since(&self) -> Option<LocalTime> {
        (!self.tightest.s.is_nan()).then(|| self.tightest.at.min(self.shortest.at))
    }
}

impl Delay {
    /// Adds the round trip measured by a heartbeat with this transit. An impossible round trip is ignored.
    pub fn take(&mut self, at: LocalTime, transit_s: f64, round_trip_s: f64) {
        if !(-TOLERANCE_S..ROUND_TRIP_VALID_S).contains(&round_trip_s) {
            return;
        }
        // A contradiction means that a clock was set in between.
        self.trips.retain(|old| !old.is_old(at) && old.bound_s(at, transit_s) >= -TOLERANCE_S);
        if self.trips.len() == ROUND_TRIPS_KEPT {
            self.trips.remove(0);
        }
        // A large swarm has a record for each pair of vehicles, and room to spare in each would be most of its memory.
        self.trips.reserve_exact(1);
        self.trips.push(RoundTrip { at, s: round_trip_s.max(0.0), transit_s });
    }

    /// The round trips that determine delays now: of those that are not too old, the one with the smallest bound, and
    /// the shortest.
    pub fn in_use(&self, now: LocalTime) -> TripsInUse {
        let valid = || self.trips.iter().filter(|trip| !trip.is_old(now));
        let tightest = valid().min_by(|one, other| one.rank_s().total_cmp(&other.rank_s()));
        let shortest = valid().min_by(|one, other| one.s.total_cmp(&other.s));
        let both = tightest.zip(shortest);
        both.map_or(TripsInUse::NONE, |(&tightest, &shortest)| TripsInUse { tightest, shortest })
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
