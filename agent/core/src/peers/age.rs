//! The ages of all peers' states, in one row: a study asks for all of them in every frame, and this much of each peer is
//! all that they need.

use skein_common::id::VehicleId;
use skein_common::time::LocalTime;

use super::PeerStateAge;
use crate::delay::{DelayAtArrival, MessageDelay};

/// What the age of a peer's newest state depends on, besides the time.
#[derive(Clone, Copy, Debug)]
pub(super) struct AgeBasis {
    /// Arrival of the state.
    pub(super) at: LocalTime,
    pub(super) delay: DelayAtArrival,
}

impl Default for AgeBasis {
    fn default() -> Self {
        Self { at: LocalTime::ZERO, delay: DelayAtArrival::UNKNOWN }
    }
}

impl AgeBasis {
    /// Time since the state's arrival, s, and the state's delay; `None` until a round trip is known.
    #[inline]
    pub(super) fn silent_s_and_delay(&self, now: LocalTime) -> (f64, Option<MessageDelay>) {
        let silent_s = now.seconds_since(self.at).max(0.0);
        (silent_s, self.delay.after(silent_s))
    }

    /// The age of the peer's newest state now.
    #[inline]
    pub(super) fn age(&self, id: VehicleId, now: LocalTime) -> PeerStateAge {
        let silent_s = now.seconds_since(self.at).max(0.0);
        let delay_s = self.delay.most_s(silent_s);
        PeerStateAge { id, age_s: silent_s + delay_s.unwrap_or_default(), delay_s }
    }
}
