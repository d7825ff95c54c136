//! The delay of a peer's messages, measured without synchronised clocks.
//!
//! Every heartbeat echoes the stamp of one peer's last heartbeat and says how long it was held, each peer in turn. The time since
//! the stamp by the own clock, less the hold, is the *round trip*: the delays of both directions together. Two clocks cannot tell
//! the two directions apart, so the whole round trip is the bound of either.
//!
//! A message's *transit* is its arrival by the own clock less its stamp by the sender's clock: its delay plus the unknown, constant
//! difference of the two clocks. A change of the transit is therefore a change of the delay, seen in the first message that has
//! it, and one round trip k bounds the delay of every message m before and after it:
//!
//! delay(m) ≤ round trip(k) + transit(m) − transit(k).     If both directions are alike, it is half a round trip less.
//!
//! The smallest bound of the last round trips counts. The likely delay is that of the shortest round trip, as in NTP's clock
//! filter (RFC 5905, section 10), and is wrong by at most half of it. Clocks run apart by 2·10⁻⁴ s/s, so a bound grows with the age
//! of its round trip; after a minute it is dropped. After a clock was set, old round trips give a negative delay or one
//! larger than the new ones give: the former are dropped, the latter are not the smallest.
//!
//! A peer can lie about the hold, as about everything that it says of itself. Then its own messages look younger than they are;
//! the ages of other vehicles' messages do not depend on it.

use alloc::collections::VecDeque;

use skein_common::id::VehicleId;
use skein_common::message::Echo;
use skein_common::time::{LocalTime, SenderStamp};

use crate::deadlines::Deadline;

/// The number of round trips that are kept.
const KEPT: usize = 4;
/// An upper bound for the drift between two quartz clocks, s/s.
const DRIFT: f64 = 2e-4;
/// A round trip is used for this long, s.
const VALID_FOR_S: f64 = Deadline::RoundTripOld.after_s();
/// A delay that seems more negative than this contradicts the round trip it was computed from, s.
const TOLERANCE_S: f64 = 0.005;
/// The number of own stamps that are remembered: 25 s of heartbeats.
const SENT: usize = 128;

/// The delay of one message.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Way {
    /// Upper bound, s.
    pub most_s: f64,
    /// The delay if both directions are alike, s.
    pub likely_s: f64,
}

/// The last round trips to one peer.
#[derive(Clone, Debug, Default)]
pub struct Delay {
    trips: VecDeque<RoundTrip>,
}

#[derive(Clone, Copy, Debug)]
struct RoundTrip {
    /// Arrival of its echo.
    at: LocalTime,
    s: f64,
    /// The transit of the heartbeat that brought the echo, s.
    transit_s: f64,
}

impl RoundTrip {
    fn way(&self, now: LocalTime, transit_s: f64) -> Way {
        let most_s = self.s + transit_s - self.transit_s + DRIFT * now.seconds_since(self.at).max(0.0);
        Way { most_s, likely_s: most_s - self.s / 2.0 }
    }
}

impl Delay {
    /// Takes up the round trip that a heartbeat with this transit has shown. An impossible round trip is ignored.
    pub fn take(&mut self, at: LocalTime, transit_s: f64, round_trip_s: f64) {
        if !(-TOLERANCE_S..VALID_FOR_S).contains(&round_trip_s) {
            return;
        }
        let new = RoundTrip { at, s: round_trip_s.max(0.0), transit_s };
        // A contradiction shows that a clock was set in between.
        self.trips.retain(|old| old.way(at, transit_s).most_s >= -TOLERANCE_S);
        if self.trips.len() == KEPT {
            self.trips.pop_front();
        }
        self.trips.push_back(new);
    }

    /// The delay of a message with this transit; `None` until a round trip is known.
    pub fn of(&self, now: LocalTime, transit_s: f64) -> Option<Way> {
        let valid = || self.trips.iter().filter(|trip| !Deadline::RoundTripOld.is_past(now.seconds_since(trip.at)));
        let shortest = valid().min_by(|one, other| one.s.total_cmp(&other.s))?;
        let most_s = valid().map(|trip| trip.way(now, transit_s).most_s).fold(f64::INFINITY, f64::min);
        let likely_s = shortest.way(now, transit_s).likely_s.min(most_s).max(0.0);
        (most_s >= -TOLERANCE_S).then(|| Way { most_s: most_s.max(0.0), likely_s })
    }
}

/// The stamps that this vehicle has sent, and the peer whose stamp it echoes next.
#[derive(Clone, Debug, Default)]
pub struct Exchange {
    sent: VecDeque<SenderStamp>,
    /// The peer whose stamp was echoed last.
    last: Option<VehicleId>,
}

impl Exchange {
    /// Remembers the stamp of a heartbeat that is sent now.
    pub fn send(&mut self, stamp: SenderStamp) {
        if self.sent.len() == SENT {
            self.sent.pop_front();
        }
        self.sent.push_back(stamp);
    }

    /// The round trip of an echo that arrived at `at`, s; `None` for a stamp that this vehicle has not sent lately.
    pub fn round_trip_s(&self, at: LocalTime, echo: &Echo) -> Option<f64> {
        self.sent.contains(&echo.stamp).then(|| since_stamp_s(at, echo.stamp) - echo.held_s())
    }

    /// The peer whose turn it is, of these in ascending order.
    pub fn turn(&mut self, partners: impl Iterator<Item = VehicleId> + Clone) -> Option<VehicleId> {
        let after = partners.clone().find(|&id| Some(id) > self.last);
        self.last = after.or_else(|| partners.clone().next());
        self.last
    }
}

/// The own clock less a stamp, s. For a peer's stamp on arrival this is the transit.
pub fn since_stamp_s(at: LocalTime, stamp: SenderStamp) -> f64 {
    at.nanoseconds().wrapping_sub(stamp.nanoseconds()) as i64 as f64 * 1e-9
}

#[cfg(test)]
mod tests;
