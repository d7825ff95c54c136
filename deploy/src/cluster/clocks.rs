//! A node's clock against the whole swarm's.

use skein_common::message::{ClockOffset, PeerHealth};
use skein_common::statistics::median;

/// How far a node's clock is ahead of the swarm's, from what it has measured of its peers: the swarm's is the median of all
/// that the node knows of, its own among them. So one that is wrong is seen by everybody, and makes nobody else seem wrong
/// as soon as there are three. `None` before anything was measured.
pub fn ahead_of_swarm(peers: &[PeerHealth]) -> Option<ClockOffset> {
    let measured: Vec<ClockOffset> = peers.iter().filter_map(|peer| peer.clock).collect();
    if measured.is_empty() {
        return None;
    }
    // Each peer's clock is somewhere between two ends: so is the median between the medians of either.
    let end = |sign: f64| {
        let mut ends: Vec<f64> =
            measured.iter().map(|clock| clock.offset_s + sign * clock.bound_s).chain([0.0]).collect();
        median(&mut ends).unwrap_or_default()
    };
    let (low_s, high_s) = (end(-1.0), end(1.0));
    // What the swarm is ahead of the node, the node is behind; and never minus zero.
    Some(ClockOffset { offset_s: 0.0 - (low_s + high_s) / 2.0, bound_s: (high_s - low_s) / 2.0 })
}

#[cfg(test)]
mod tests {
    use skein_common::id::VehicleId;
    use skein_common::state::Standing;

    use super::*;

    /// Of a node whose peers' clocks are ahead of its own by so much, each known to 1 ms.
    fn ahead(peers_s: &[f64]) -> Option<f64> {
        let peer = |(id, offset_s)| PeerHealth {
            id,
            standing: Standing::Fresh,
            age_s: 0.0,
            delay_s: None,
            clock: Some(ClockOffset { offset_s, bound_s: 0.001 }),
        };
        let peers: Vec<_> = VehicleId::first(peers_s.len()).zip(peers_s.iter().copied()).map(peer).collect();
        ahead_of_swarm(&peers).map(|clock| {
            assert!((0.0..0.001_001).contains(&clock.bound_s), "{clock:?}");
            // To the millisecond that the measurements are good for.
            (clock.offset_s * 500.0).round() / 500.0 + 0.0
        })
    }

    #[test]
    fn the_one_that_is_wrong_is_seen_and_the_others_are_not() {
        assert_eq!(ahead(&[]), None);
        // Of three, the third is half a second ahead: as each of them measures it.
        assert_eq!([ahead(&[0.0, 0.5]), ahead(&[-0.5, -0.5])], [Some(0.0), Some(0.5)]);
        // Of eight.
        let (mut right, wrong) = ([0.0; 7], [0.25; 7]);
        right[3] = -0.25;
        assert_eq!([ahead(&right), ahead(&wrong)], [Some(0.0), Some(-0.25)]);
        // Of two nobody can tell.
        assert_eq!([ahead(&[0.5]), ahead(&[-0.5])], [Some(-0.25), Some(0.25)]);
    }

    #[test]
    fn who_has_measured_nothing_says_nothing() {
        let peer = PeerHealth {
            id: VehicleId::new(1).unwrap(),
            standing: Standing::Fresh,
            age_s: 0.0,
            delay_s: None,
            clock: None,
        };
        assert_eq!(ahead_of_swarm(&[peer]), None);
    }
}
