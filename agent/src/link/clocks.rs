//! Measures how far the peers' clocks differ from the own: each agent answers queries with its UTC and queries its
//! peers in turn, as NTP does (RFC 5905). Operators use the offsets to compare logs and recordings; the flight does
//! not depend on them.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use skein_common::id::VehicleId;
use skein_common::message::{ClockAnswer, ClockOffset, PeerHealth};
use skein_common::state::PeerStatus;
use skein_common::topic::Topic;
use zenoh::Session;
use zenoh::query::{Query, Queryable};
use zenoh::sample::Sample;

use super::{LinkError, LinkReceiver, Sessions, queries};
use skein_host::clock::now;

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

/// Reads UTC, ns since 1970.
pub type Utc = fn() -> u64;

/// Answers queries for the own clock and queries the peers' clocks.
pub(super) struct Clocks {
    /// Weak, so that the sessions end with the link.
    pub(super) sessions: Vec<Weak<Session>>,
    pub(super) receiver: Arc<LinkReceiver>,
    utc: Utc,
    measurements: Arc<Mutex<BTreeMap<VehicleId, Measurements>>>,
    /// Peer of the last query.
    asked: Option<VehicleId>,
    _queryables: Vec<Queryable<()>>,
}

/// Measurements of one peer's clock.
#[derive(Debug, Default)]
struct Measurements {
    last: VecDeque<(Instant, ClockOffset)>,
    /// Whether the clock was last logged as off.
    is_off: bool,
}

impl Clocks {
    pub(super) fn open(
        sessions: &Sessions,
        receiver: &Arc<LinkReceiver>,
        own: VehicleId,
        utc: Utc,
    ) -> Result<Self, LinkError> {
        let for_queries = receiver.clone();
        let key = receiver.branch.key(&Topic::Clock(own));
        let answer_key = key.clone();
        let answer = move |query: &Query| {
            let received_ns = utc();
            let question = u64::from_le_bytes(query.payload()?.to_bytes().as_ref().try_into().ok()?);
            let answer = ClockAnswer { sender: own, question, received_ns, answered_ns: utc().max(received_ns) };
            Some(for_queries.write(&answer_key, &answer))
        };
        let queryables = queries::answer_queries(sessions, key, answer)?;
        let sessions = sessions.all.iter().map(Arc::downgrade).collect();
        let (receiver, measurements) = (receiver.clone(), Arc::default());
        Ok(Self { sessions, receiver, utc, measurements, asked: None, _queryables: queryables })
    }

    /// Queries the next peer in contact. Never waits for the reply.
    pub(super) fn query_next(&mut self, live: &[VehicleId]) {
        let after = live.iter().find(|id| Some(**id) > self.asked).or(live.first());
        let Some(&id) = after else { return };
        self.asked = Some(id);
        let (measurements, receiver, answered) =
            (self.measurements.clone(), self.receiver.clone(), Arc::new(AtomicBool::new(false)));
        // The round trip is measured on the monotonic clock, because the own UTC may be set meanwhile.
        let (asked_ns, asked) = ((self.utc)(), now());
        let take = move |sample: &Sample| {
            let round_trip = now().saturating_duration_since(asked);
            let answer =
                receiver.key_ring.read::<ClockAnswer>(sample.key_expr().as_str(), &sample.payload().to_bytes()).ok();
            let answer = answer.map(|verified| verified.message);
            // The number must be that of this query: a replayed reply to an earlier one is ignored.
            let answer = answer.filter(|answer| (answer.sender, answer.question) == (id, asked_ns));
            let round_trip_ns = u64::try_from(round_trip.as_nanos()).unwrap_or(u64::MAX);
            let offset = answer.and_then(|answer| ClockOffset::of_exchange(asked_ns, &answer, round_trip_ns));
            // One query counts at most once.
            if let Some(offset) = offset.filter(|_| !answered.swap(true, Relaxed)) {
                measurements.lock().entry(id).or_default().add(now(), offset);
            }
        };
        // The peer is linked to one of the sessions.
        for session in self.sessions.iter().filter_map(Weak::upgrade) {
            queries::send_query(
                &session,
                self.receiver.branch.key(&Topic::Clock(id)),
                &asked_ns.to_le_bytes(),
                take.clone(),
            );
        }
    }

    /// Writes each peer's clock offset into its health entry; logs a clock whose offset has become large or small
    /// again.
    pub(super) fn report(&self, peers: &mut [PeerHealth]) {
        let mut measurements = self.measurements.lock();
        let valid_for = VALID_FOR.max(CLOCK_QUERY_PERIOD * 3 * u32::try_from(measurements.len()).unwrap_or(u32::MAX));
        let now = now();
        measurements.values_mut().for_each(|known| known.expire(now, valid_for));
        for peer in peers {
            let Some(known) = measurements.get_mut(&peer.id) else { continue };
            peer.clock = known.best(now);
            if let Some(ClockOffset { offset_s, bound_s }) = known.change(now) {
                let (id, offset_ms, bound_ms) = (peer.id, offset_s * 1e3, bound_s * 1e3);
                if known.is_off {
                    tracing::warn!(
                        "the clock of vehicle {id} is off by {offset_ms:+.1} ms (known to {bound_ms:.1} ms) against \
                         this host's; flight is not affected, but logs and recordings will not match"
                    );
                } else {
                    tracing::info!(
                        "the clock of vehicle {id} is right again: off by {offset_ms:+.1} ms (known to {bound_ms:.1} ms)"
                    );
                }
            }
        }
    }
}

impl Measurements {
    fn add(&mut self, now: Instant, new: ClockOffset) {
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

/// The peers in contact, which can be queried.
pub(super) fn live(peers: &[PeerHealth]) -> Vec<VehicleId> {
    peers.iter().filter(|peer| peer.standing != PeerStatus::Lost).map(|peer| peer.id).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

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
