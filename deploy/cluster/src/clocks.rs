//! Compares a node's clock with the clock of the whole swarm.

use skein_common::message::{ClockOffset, PeerHealth};
use skein_common::statistics::median;

/// Largest clock offset that is not reported, s. Nothing in flight depends on the clocks.
pub(crate) const CLOCK_S: f64 = 0.020;

/// The time by which a node's clock is ahead of the swarm's, from the node's measurements of its peers' clocks. The swarm's clock
/// is the median of all clocks that the node knows, including its own. With three or more nodes, a wrong clock is noticed by every
/// node and makes no other clock look wrong. `None` before anything was measured.
pub fn ahead_of_swarm(peers: &[PeerHealth]) -> Option<ClockOffset> {
    let measured: Vec<ClockOffset> = peers.iter().filter_map(|peer| peer.clock).collect();
    if measured.is_empty() {
        return None;
    }
    // Each peer's clock lies between two bounds, so the median lies between the medians of the lower and of the upper
    // bounds.
    let end = |sign: f64| {
        let mut ends: Vec<f64> =
            measured.iter().map(|clock| clock.offset_s + sign * clock.bound_s).chain([0.0]).collect();
        median(&mut ends).unwrap_or_default()
    };
    let (low_s, high_s) = (end(-1.0), end(1.0));
    // The node is behind by as much as the swarm is ahead. Avoids minus zero.
    Some(ClockOffset { offset_s: 0.0 - (low_s + high_s) / 2.0, bound_s: (high_s - low_s) / 2.0 })
}

#[cfg(test)]
mod tests {
    use skein_common::id::VehicleId;
    use skein_common::state::PeerStatus;

    use super::*;

    /// The time by which the clock of a node is ahead whose peers' clocks are ahead of it by `peers_s`, each known to 1 ms, s.
    fn ahead(peers_s: &[f64]) -> Option<f64> {
        let peer = |(id, offset_s)| PeerHealth {
            id,
            standing: PeerStatus::Fresh,
            age_s: 0.0,
            delay_s: None,
            clock: Some(ClockOffset { offset_s, bound_s: 0.001 }),
        };
        let peers: Vec<_> = VehicleId::first(peers_s.len()).zip(peers_s.iter().copied()).map(peer).collect();
        ahead_of_swarm(&peers).map(|clock| {
            assert!((0.0..0.001_001).contains(&clock.bound_s), "{clock:?}");
            // Rounded to the accuracy of the measurements.
            (clock.offset_s * 500.0).round() / 500.0 + 0.0
        })
    }

    #[test]
    fn a_wrong_clock_is_found_and_right_clocks_are_not_blamed() {
        assert_eq!(ahead(&[]), None);
        // Three nodes, the third half a second ahead, as measured by the first and the third.
        assert_eq!([ahead(&[0.0, 0.5]), ahead(&[-0.5, -0.5])], [Some(0.0), Some(0.5)]);
        // Eight nodes.
        let (mut right, wrong) = ([0.0; 7], [0.25; 7]);
        right[3] = -0.25;
        assert_eq!([ahead(&right), ahead(&wrong)], [Some(0.0), Some(-0.25)]);
        // With two nodes the wrong clock cannot be identified.
        assert_eq!([ahead(&[0.5]), ahead(&[-0.5])], [Some(-0.25), Some(0.25)]);
    }

    #[test]
    fn a_node_without_measurements_has_no_offset() {
        let peer = PeerHealth {
            id: VehicleId::new(1).unwrap(),
            standing: PeerStatus::Fresh,
            age_s: 0.0,
            delay_s: None,
            clock: None,
        };
        assert_eq!(ahead_of_swarm(&[peer]), None);
    }
}
