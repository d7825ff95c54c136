//! The ages of all peers' states, in one row: a study asks for all of them in every frame, and this much of each peer is
//! all that they need.

use skein_common::id::VehicleId;
use skein_common::time::LocalTime;

use super::PeerStateAge;
use crate::delay::{MessageDelay, TripsInUse};

/// What the age of a peer's newest state depends on, besides the time.
#[derive(Clone, Copy, Debug)]
pub(super) struct AgeBasis {
    /// Arrival of the state.
    pub(super) at: LocalTime,
    /// Arrival by the own clock minus the stamp by the peer's, s.
    pub(super) transit_s: f64,
    /// The round trips that bound the state's delay.
    pub(super) trips: TripsInUse,
}

impl Default for AgeBasis {
    fn default() -> Self {
        Self { at: LocalTime::ZERO, transit_s: 0.0, trips: TripsInUse::NONE }
    }
}

impl AgeBasis {
    /// Time since the state's arrival, s.
    #[inline]
    pub(super) fn silent_s(&self, now: LocalTime) -> f64 {
        now.seconds_since(self.at).max(0.0)
    }

    /// The delay of the state; `None` until a round trip is known.
    #[inline]
    pub(super) fn delay(&self, now: LocalTime) -> Option<MessageDelay> {
        self.trips.delay(now, self.transit_s)
    }

    /// The age of the peer's newest state now.
    #[inline]
    pub(super) fn age(&self, id: VehicleId, now: LocalTime) -> PeerStateAge {
        let delay_s = self.trips.most_s(now, self.transit_s);
        PeerStateAge { id, age_s: self.silent_s(now) + delay_s.unwrap_or_default(), delay_s }
    }
}
