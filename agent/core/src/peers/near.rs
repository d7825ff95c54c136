//! The peers near the own vehicle, in a list with a skin (L. Verlet, "Computer Experiments on Classical Fluids", Physical
//! Review 159, 1967): it contains every peer within the interaction distance for as long as neither the own vehicle nor
//! any peer can have crossed the skin since the list was made. Until then a step looks only at the peers of the list.

use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::time::LocalTime;

/// Width of the skin: a length, m, and a share of the interaction distance. A wider skin lists more peers, a narrower
/// one is crossed sooner.
const SKIN_M: f64 = 10.0;
const SKIN_SHARE: f64 = 0.1;

/// A peer counts as too far off to be listed from this much farther on, m: more than the rounding error of a distance.
const ROUNDING_M: f64 = 1e-3;

/// Number of distances beyond that of the list from which far peers are known, evenly spaced up to twice that of the list.
const SHELLS: usize = 8;

/// The list of near peers, horizontally.
#[derive(Clone, Debug, Default)]
pub(super) struct NearList {
    made: Option<Made>,
    near: VehicleSet,
    /// Peers that were farther off than those listed by so many parts of that distance when the list was made.
    far: [VehicleSet; SHELLS],
    /// Largest speed of a peer since the list was made, m/s.
    fastest_m_s: f64,
}

/// The conditions under which the list was made.
#[derive(Clone, Copy, Debug)]
struct Made {
    own: PositionNed,
    at: LocalTime,
    /// The interaction distance, and the distance up to which peers are on the list, m.
    reach_m: f64,
    listed_m: f64,
    /// [`Travel::travelled_m`] at that time.
    travelled_m: f64,
}

/// Bounds of the horizontal way, the speed and the delay of the newest states of all peers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Travel {
    /// A length that no peer's reported position has exceeded on its way, m.
    pub(super) travelled_m: f64,
    /// Largest speed that a peer has reported, m/s.
    pub(super) fastest_m_s: f64,
    /// Largest delay by which a state is carried forward, s.
    pub(super) delay_s: f64,
}

impl Travel {
    /// Largest distance of a peer, m, from its place when `before_m` had been travelled, `since_s` ago.
    fn come_m(&self, before_m: f64, since_s: f64) -> f64 {
        self.travelled_m - before_m + self.fastest_m_s * (since_s + self.delay_s) + ROUNDING_M
    }
}

/// A peer whose newest state was carried forward to now.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extrapolated {
    pub(super) id: VehicleId,
    pub(super) position: PositionNed,
    pub(super) velocity: VelocityNed,
    /// Time over which the state was carried forward, s.
    pub(super) carried_s: f64,
    /// [`Travel::travelled_m`] when the state was taken.
    pub(super) travelled_m: f64,
}

impl NearList {
    /// Makes the next use of the list make it anew.
    pub(super) fn discard(&mut self) {
        self.made = None;
    }

    /// The list, if it contains every peer within `reach_m` of the own position now.
    pub(super) fn valid(&self, own: PositionNed, now: LocalTime, reach_m: f64) -> Option<VehicleSet> {
        let made = self.made?;
        let own_moved_m = (own - made.own).xy().norm();
        // Ages grow a little faster than time, because a delay's bound grows with the drift of clocks.
        let peers_moved_m = 1.001 * self.fastest_m_s * now.seconds_since(made.at).max(0.0);
        // A list made for a much larger distance is too long.
        let fits = reach_m + own_moved_m + peers_moved_m <= made.listed_m && 2.0 * reach_m >= made.reach_m;
        fits.then_some(self.near)
    }

    /// Makes the list of these peers.
    pub(super) fn make(
        &mut self,
        own: PositionNed,
        at: LocalTime,
        reach_m: f64,
        travel: Travel,
        peers: impl Iterator<Item = Extrapolated>,
    ) -> VehicleSet {
        let listed_m = reach_m + SKIN_M + SKIN_SHARE * reach_m;
        (self.near, self.far, self.fastest_m_s) = Default::default();
        self.made = Some(Made { own, at, reach_m, listed_m, travelled_m: travel.travelled_m });
        for Extrapolated { id, position, velocity, carried_s, travelled_m } in peers {
            self.moved(id, position, velocity);
            // The position now, the reported one and those of states that have not arrived yet are at least this much farther off.
            let may_differ_m = velocity.horizontal().norm() * carried_s + travel.travelled_m - travelled_m + ROUNDING_M;
            let farther_m = (position - own).xy().norm() - listed_m - may_differ_m;
            let shells = (farther_m * SHELLS as f64 / listed_m).floor() as usize;
            self.far.iter_mut().take(shells).for_each(|far| far.insert(id));
        }
        self.near
    }

    /// The peers that are still too far away to be listed, whatever their newest states. Discards the list once even the farthest
    /// may have come near enough.
    ///
    /// A state is at most the travelled length from the last one before the list, and is carried forward at most over the
    /// time since then and its delay.
    pub(super) fn far(&mut self, now: LocalTime, travel: Travel) -> VehicleSet {
        let Some(made) = self.made else { return VehicleSet::default() };
        let come_m = travel.come_m(made.travelled_m, now.seconds_since(made.at).max(0.0));
        let shells = (come_m * SHELLS as f64 / made.listed_m).ceil() as usize;
        if shells > SHELLS && !self.far[SHELLS - 1].is_empty() {
            self.discard();
        }
        // Those of the shell before the one that they may have crossed by now.
        shells.checked_sub(1).and_then(|nth| self.far.get(nth)).copied().unwrap_or_default()
    }

    /// Whether the list stays right when this peer has a new state with these values, which is carried forward over
    /// `carried_s`: the peer is not the fastest, and it is listed or farther off than it could have come in that time. Or
    /// no list has been made.
    #[inline]
    pub(super) fn is_right_for(
        &self,
        id: VehicleId,
        (position, velocity): (PositionNed, VelocityNed),
        carried_s: impl FnOnce() -> f64,
    ) -> bool {
        let Some(made) = &self.made else { return true };
        if velocity.horizontal().norm_squared() > self.fastest_m_s * self.fastest_m_s {
            return false;
        }
        let is_far = || {
            let beyond_m = made.listed_m + self.fastest_m_s * carried_s() + ROUNDING_M;
            (position - made.own).xy().norm_squared() > beyond_m * beyond_m
        };
        self.near.contains(id) || is_far()
    }

    /// Lists a peer whose state has changed, if it is near.
    pub(super) fn moved(&mut self, id: VehicleId, position: PositionNed, velocity: VelocityNed) {
        let Some(made) = self.made else { return };
        self.fastest_m_s = self.fastest_m_s.max(velocity.horizontal().norm());
        if (position - made.own).xy().norm_squared() <= made.listed_m * made.listed_m {
            self.near.insert(id);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::id;

    #[test]
    fn a_peer_that_was_silent_for_long_is_far_only_if_it_cannot_have_come() {
        let travel = Travel { travelled_m: 500.0, fastest_m_s: 5.0, delay_s: 0.1 };
        let silent = |number: u8, north_m: f64| Extrapolated {
            id: id(number),
            position: PositionNed::new(north_m, 0.0, -30.0),
            velocity: VelocityNed::default(),
            carried_s: 0.0,
            travelled_m: 100.0,
        };
        let (own, made_at, reach_m) = (PositionNed::default(), LocalTime::from_seconds(100.0), 100.0);
        let mut list = NearList::default();
        // Those on the list are within 120 m, and either can have come 400 m.
        let peers = [silent(1, 3000.0), silent(2, 530.0)];
        assert!(list.make(own, made_at, reach_m, travel, peers.into_iter()).is_empty());
        let next = made_at.plus_seconds(0.02);
        assert_eq!(list.far(next, travel), [id(1)].into_iter().collect());
        assert!(list.valid(own, next, reach_m).is_some(), "it need not be made anew");
    }
}
