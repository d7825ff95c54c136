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
    /// Places of the trip with the smallest bound and of the shortest one, when the last trip arrived. All bounds grow
    /// alike with time: until one of the two is too old, they stay the smallest and the shortest.
    tightest: u8,
    shortest: u8,
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
    #[inline]
    fn is_old(&self, now: LocalTime) -> bool {
        Deadline::RoundTripOld.is_past(now.seconds_since(self.at))
    }

    #[inline]
    fn bound(&self, transit_s: f64) -> DelayBound {
        DelayBound { at: self.at, s: self.s + transit_s - self.transit_s }
    }

    #[inline]
    fn message_delay(&self, now: LocalTime, transit_s: f64) -> MessageDelay {
        let most_s = self.bound(transit_s).growing_s(now);
        MessageDelay { most_s, likely_s: most_s - self.s / 2.0 }
    }
}

/// The bound that one round trip gives for one message. It grows with time.
#[derive(Clone, Copy, Debug)]
pub struct DelayBound {
    /// Arrival time of the round trip's echo.
    at: LocalTime,
    /// The bound at that time, s.
    s: f64,
}

impl DelayBound {
    /// The bound now, s; below zero it contradicts the message.
    #[inline]
    fn growing_s(self, now: LocalTime) -> f64 {
        self.s + DRIFT * now.seconds_since(self.at).max(0.0)
    }

    /// The upper bound of the message's delay now, s, as in [`MessageDelay`]; `None` if it contradicts the message.
    #[inline]
    pub fn most_s(self, now: LocalTime) -> Option<f64> {
        let most_s = self.growing_s(now);
        (most_s >= -TOLERANCE_S).then(|| most_s.max(0.0))
    }
}

impl Delay {
    /// Adds the round trip measured by a heartbeat with this transit. An impossible round trip is ignored.
    pub fn take(&mut self, at: LocalTime, transit_s: f64, round_trip_s: f64) {
        if !(-TOLERANCE_S..ROUND_TRIP_VALID_S).contains(&round_trip_s) {
            return;
        }
        let new = RoundTrip { at, s: round_trip_s.max(0.0), transit_s };
        // A contradiction means that a clock was set in between.
        self.trips.retain(|old| old.message_delay(at, transit_s).most_s >= -TOLERANCE_S);
        if self.trips.len() == ROUND_TRIPS_KEPT {
            self.trips.remove(0);
        }
        // A large swarm has a record for each pair of vehicles, and room to spare in each would be most of its memory.
        self.trips.reserve_exact(1);
        self.trips.push(new);
        self.tightest = self.place(at, |trip| trip.message_delay(at, transit_s).most_s);
        self.shortest = self.place(at, |trip| trip.s);
    }

    /// The delay of a message with this transit; `None` until a round trip is known.
    #[inline]
    pub fn of(&self, now: LocalTime, transit_s: f64) -> Option<MessageDelay> {
        let most_s = self.bound(now, transit_s)?.growing_s(now);
        let shortest = self.valid(now, self.shortest).or_else(|| self.valid(now, self.place(now, |trip| trip.s)))?;
        let likely_s = shortest.message_delay(now, transit_s).likely_s.min(most_s).max(0.0);
        (most_s >= -TOLERANCE_S).then(|| MessageDelay { most_s: most_s.max(0.0), likely_s })
    }

    /// The smallest bound that a valid round trip gives for a message with this transit. It stays the smallest until
    /// another trip arrives or its own trip is too old.
    #[inline]
    pub fn bound(&self, now: LocalTime, transit_s: f64) -> Option<DelayBound> {
        let bound_s = |trip: &RoundTrip| trip.bound(transit_s).growing_s(now);
        let tightest = self.valid(now, self.tightest).or_else(|| self.valid(now, self.place(now, bound_s)))?;
        Some(tightest.bound(transit_s))
    }

    /// Arrival of the older of the two trips that [`Self::of`] uses now: until it is too old, both stay the same.
    pub fn in_use_since(&self, now: LocalTime) -> Option<LocalTime> {
        let used = [self.tightest, self.shortest].map(|place| self.valid(now, place).map(|trip| trip.at));
        // Without one of them, the next valid one is chosen anew at every use.
        let oldest_valid = || self.trips.iter().filter(|trip| !trip.is_old(now)).map(|trip| trip.at).min();
        used[0].zip(used[1]).map_or_else(oldest_valid, |(tightest, shortest)| Some(tightest.min(shortest)))
    }

    /// The trip at this place, if it is not too old.
    #[inline]
    fn valid(&self, now: LocalTime, place: u8) -> Option<&RoundTrip> {
        self.trips.get(usize::from(place)).filter(|trip| !trip.is_old(now))
    }

    /// Place of the first valid trip for which this is the smallest; without a valid one a place behind all.
    #[cold]
    fn place(&self, now: LocalTime, of: impl Fn(&RoundTrip) -> f64) -> u8 {
        let valid = self.trips.iter().zip(0_u8..).filter(|(trip, _)| !trip.is_old(now));
        valid.min_by(|(one, _), (other, _)| of(one).total_cmp(&of(other))).map_or(u8::MAX, |(_, place)| place)
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
