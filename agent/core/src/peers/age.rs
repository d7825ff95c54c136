//! The ages of all peers' states, in one row: a study asks for all of them in every frame, and this much of each peer is
//! all that they need.

use skein_common::id::VehicleId;
use skein_common::time::LocalTime;

use super::PeerStateAge;
use super::peer::Peer;
use crate::delay::DelayBound;

/// What the age of a peer's newest state depends on, besides the time.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct AgeBasis {
    /// Arrival of the state.
    at: LocalTime,
    bound: Option<DelayBound>,
}

impl AgeBasis {
    /// The basis of a peer whose state or round trips have changed, or whose bound is too old.
    pub(super) fn of(peer: &Peer, now: LocalTime) -> Self {
        let basis = |(at, transit_s)| Self { at, bound: peer.delay.bound(now, transit_s) };
        peer.state.map(|last| basis((last.at, last.transit_s))).unwrap_or_default()
    }

    /// The age of the peer's newest state now.
    #[inline]
    pub(super) fn age(&self, id: VehicleId, now: LocalTime) -> PeerStateAge {
        let silent_s = now.seconds_since(self.at).max(0.0);
        let delay_s = self.bound.and_then(|bound| bound.most_s(now));
        PeerStateAge { id, age_s: silent_s + delay_s.unwrap_or_default(), delay_s }
    }
}
