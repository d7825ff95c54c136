//! Measures how far the peers' clocks differ from the own: each agent answers queries with its UTC and queries its
//! peers in turn, as NTP does (RFC 5905). Operators use the offsets to compare logs and recordings; the flight does
//! not depend on them.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use skein_common::id::VehicleId;
use skein_common::message::{ClockOffset, PeerHealth};

/// Time between two clock queries; each goes to one peer.
pub const CLOCK_QUERY_PERIOD: Duration = Duration::from_millis(500);
/// Number of exchanges kept; the one with the smallest bound is used.
const KEPT: usize = 8;
/// A measurement expires after this time, or after three rounds of all peers if that is longer.
const VALID_FOR: Duration = Duration::from_secs(60);
/// Growth of a measurement's bound with its age, s/s: NTP's frequency tolerance (RFC 5905, PHI).
const DRIFT: f64 = 15e-6;
/// Clock offset above which a warning is logged, s.
const TOLERATED_S: f64 = 0.020;

/// Measurements of one peer's clock.
#[derive(Debug, Default)]
pub(super) struct Measurements {
    last: VecDeque<(Instant, ClockOffset)>,
    /// Whether the clock was last logged as off.
    is_off: bool,
}

/// Writes each peer's clock offset into its health entry; logs a clock whose offset has become large or small again.
pub(super) fn report(measurements: &mut BTreeMap<VehicleId, Measurements>, peers: &mut [PeerHealth], now: Instant) {
    let valid_for = VALID_FOR.max(CLOCK_QUERY_PERIOD * 3 * u32::try_from(measurements.len()).unwrap_or(u32::MAX));
    measurements.values_mut().for_each(|known| known.expire(now, valid_for));
    for peer in peers {
        let Some(known) = measurements.get_mut(&peer.id) else { continue };
        peer.clock = known.best(now);
        if let Some(ClockOffset { offset_s, bound_s }) = known.change(now) {
            let (id, offset_ms, bound_ms) = (peer.id, offset_s * 1e3, bound_s * 1e3);
            if known.is_off {
                tracing::warn!(
                    "the clock of vehicle {id} is off by {offset_ms:+.1} ms (known to {bound_ms:.1} ms) against this \
                     host's; flight is not affected, but logs and recordings will not match"
                );
            } else {
                tracing::info!(
                    "the clock of vehicle {id} is right again: off by {offset_ms:+.1} ms (known to {bound_ms:.1} ms)"
                );
            }
        }
    }
}

impl Measurements {
    pub(super) fn add(&mut self, now: Instant, new: ClockOffset) {
        // Measurements that contradict the new one are obsolete: the clock was set in between.
        self.last.retain(|old| aged(old, now).agrees_with(&new));
        if self.last.len() == KEPT {
            self.last.pop_front();
        }
        self.last.push_back((now, new));
    }

    /// Drops measurements older than `valid_for`.
    fn expire(&mut self, now: Instant, valid_for: Duration) {
        self.last.retain(|(at, _)| now.saturating_duration_since(*at) <= valid_for);
    }

    fn best(&self, now: Instant) -> Option<ClockOffset> {
        self.last.iter().map(|old| aged(old, now)).min_by(|one, other| one.bound_s.total_cmp(&other.bound_s))
    }

    /// The best offset, if it has just become large or small again.
    fn change(&mut self, now: Instant) -> Option<ClockOffset> {
        let best = self.best(now)?;
        let is_off = best.offset_s.abs() - best.bound_s > TOLERATED_S;
        (std::mem::replace(&mut self.is_off, is_off) != is_off).then_some(best)
    }
}

/// An earlier measurement with its bound as of `now`.
fn aged((at, measured): &(Instant, ClockOffset), now: Instant) -> ClockOffset {
    let age_s = now.saturating_duration_since(*at).as_secs_f64();
    ClockOffset { bound_s: measured.bound_s + DRIFT * age_s, ..*measured }
}

#[cfg(test)]
mod tests {
    use super::*;
    use skein_host::clock::now;

    fn offset(offset_s: f64, bound_s: f64) -> ClockOffset {
        ClockOffset { offset_s, bound_s }
    }

    #[test]
    fn of_the_last_eight_exchanges_the_one_with_the_smallest_bound_counts() {
        let (mut measurements, at) = (Measurements::default(), now());
        assert_eq!(measurements.best(at), None);
        measurements.add(at, offset(0.0, 0.001));
        for _ in 1..KEPT {
            measurements.add(at, offset(0.002, 0.005));
            assert_eq!(measurements.best(at), Some(offset(0.0, 0.001)));
        }
        measurements.add(at, offset(0.002, 0.005));
        assert_eq!(measurements.best(at), Some(offset(0.002, 0.005)), "the surest has been dropped");
        assert_eq!(measurements.last.len(), KEPT);
    }

    #[test]
    fn a_clock_that_was_set_is_measured_anew() {
        let (mut measurements, at) = (Measurements::default(), now());
        measurements.add(at, offset(0.0, 0.000_1));
        measurements.add(at, offset(0.3, 0.005));
        assert_eq!(measurements.best(at), Some(offset(0.3, 0.005)), "the two measurements contradict each other");
    }

    #[test]
    fn a_clock_offset_is_reported_once_when_it_becomes_large_and_once_when_small() {
        let (mut measurements, at) = (Measurements::default(), now());
        let mut change = |offset_s, bound_s| {
            measurements.add(at, offset(offset_s, bound_s));
            measurements.change(at).map(|_| measurements.is_off)
        };
        assert_eq!(change(0.021, 0.002), None, "the offset may be only 19 ms");
        assert_eq!(change(-0.5, 0.002), Some(true));
        assert_eq!(change(-0.5, 0.002), None);
        assert_eq!(change(0.001, 0.002), Some(false));
        assert_eq!(change(0.001, 0.002), None);
    }

    #[test]
    fn a_clock_measurement_ages_and_expires() {
        let (mut measurements, at) = (Measurements::default(), now());
        measurements.add(at, offset(0.3, 0.001));
        let later = at + Duration::from_secs(50);
        measurements.expire(later, VALID_FOR);
        assert!((measurements.best(later).unwrap().bound_s - 0.00175).abs() < 1e-9, "clocks drift apart");
        let later = at + Duration::from_secs(61);
        measurements.expire(later, VALID_FOR);
        assert_eq!(measurements.best(later), None, "the clock of a vehicle that no longer replies is unknown");
    }
}
