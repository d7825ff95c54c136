//! How far the others' clocks are apart from the own: each agent tells whoever asks what its UTC is, and asks the others in
//! turn, as NTP does (RFC 5905). For people who compare logs and recordings of several hosts; nothing in flight relies on it.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

use skein_common::id::VehicleId;
use skein_common::message::{ClockAnswer, ClockOffset, PeerHealth};
use skein_common::state::Standing;
use skein_common::topic::Topic;
use zenoh::Session;
use zenoh::query::{Query, Queryable};
use zenoh::sample::Sample;

use super::{Ear, LinkError, Sessions, register};
use skein_host::clock::now;

/// One of the others is asked this often.
pub const ASK_EVERY: Duration = Duration::from_millis(500);
/// Of so many exchanges the one with the smallest bound counts.
const KEPT: usize = 8;
/// A comparison is dropped after this time, or after three turns of all peers if that is longer.
const VALID_FOR: Duration = Duration::from_secs(60);
/// The bound of a comparison grows by this with its age, s/s: NTP's frequency tolerance (RFC 5905, PHI).
const DRIFT: f64 = 15e-6;
/// Clocks that are farther apart are worth a line in the log, s.
const TOLERATED_S: f64 = 0.020;

/// A clock of UTC, ns since 1970.
pub type Utc = fn() -> u64;

/// Answers for the own clock and asks for the others'.
pub(super) struct Clocks {
    sessions: Vec<Weak<Session>>,
    ear: Arc<Ear>,
    utc: Utc,
    measured: Arc<Mutex<BTreeMap<VehicleId, Measured>>>,
    /// Who was asked last.
    asked: Option<VehicleId>,
    _answering: Vec<Queryable<()>>,
}

/// What is known of one of the others' clocks.
#[derive(Debug, Default)]
struct Measured {
    last: VecDeque<(Instant, ClockOffset)>,
    /// It was told to be off.
    is_off: bool,
}

impl Clocks {
    pub(super) fn open(sessions: &Sessions, ear: &Arc<Ear>, own: VehicleId, utc: Utc) -> Result<Self, LinkError> {
        let answering = ear.clone();
        let answer = move |query: &Query| {
            let received_ns = utc();
            let question = u64::from_le_bytes(query.payload()?.to_bytes().as_ref().try_into().ok()?);
            let answer = ClockAnswer { sender: own, question, received_ns, answered_ns: utc().max(received_ns) };
            Some(answering.write(&Topic::Clock(own).key(), &answer))
        };
        let answering = register::answer(sessions, Topic::Clock(own), answer)?;
        let sessions = sessions.all.iter().map(Arc::downgrade).collect();
        let (ear, measured) = (ear.clone(), Arc::default());
        Ok(Self { sessions, ear, utc, measured, asked: None, _answering: answering })
    }

    /// Asks the next of those who are heard. Never waits for the answer.
    pub(super) fn ask_next(&mut self, live: &[VehicleId]) {
        let after = live.iter().find(|id| Some(**id) > self.asked).or(live.first());
        let Some(&id) = after else { return };
        self.asked = Some(id);
        let (measured, ear, answered) = (self.measured.clone(), self.ear.clone(), Arc::new(AtomicBool::new(false)));
        // Over the way the monotonic clock counts: the own UTC may be set meanwhile.
        let (asked_ns, asked) = ((self.utc)(), now());
        let take = move |said: &Sample| {
            let round_trip = now().saturating_duration_since(asked);
            let answer = ear.voices.read::<ClockAnswer>(said.key_expr().as_str(), &said.payload().to_bytes()).ok();
            let answer = answer.map(|said| said.message);
            // To this question, by its number: what somebody has kept of an earlier answer is none.
            let answer = answer.filter(|answer| (answer.sender, answer.question) == (id, asked_ns));
            let round_trip_ns = u64::try_from(round_trip.as_nanos()).unwrap_or(u64::MAX);
            let offset = answer.and_then(|answer| ClockOffset::of_exchange(asked_ns, &answer, round_trip_ns));
            // Who is asked once counts once.
            if let Some(offset) = offset.filter(|_| !answered.swap(true, Relaxed)) {
                lock(&measured).entry(id).or_default().take_up(now(), offset);
            }
        };
        // It is linked to one of them.
        for session in self.sessions.iter().filter_map(Weak::upgrade) {
            register::ask(&session, Topic::Clock(id), &asked_ns.to_le_bytes(), take.clone());
        }
    }

    /// Writes to each of the others what is known of its clock; logs which clocks are off, and when they no longer are.
    pub(super) fn tell(&self, peers: &mut [PeerHealth]) {
        let mut measured = lock(&self.measured);
        let valid_for = VALID_FOR.max(ASK_EVERY * 3 * u32::try_from(measured.len()).unwrap_or(u32::MAX));
        let now = now();
        measured.values_mut().for_each(|known| known.forget(now, valid_for));
        for peer in peers {
            let Some(known) = measured.get_mut(&peer.id) else { continue };
            peer.clock = known.best(now);
            if let Some(ClockOffset { offset_s, bound_s }) = known.news(now) {
                let (id, offset_ms, bound_ms) = (peer.id, offset_s * 1e3, bound_s * 1e3);
                if known.is_off {
                    tracing::warn!(
                        "vehicle {id}'s clock is off from this one's by {offset_ms:+.1} ms, known to {bound_ms:.1} ms; \
                         no flight relies on it, but logs and recordings will not match"
                    );
                } else {
                    tracing::info!(
                        "vehicle {id}'s clock is no longer off: {offset_ms:+.1} ms, known to {bound_ms:.1} ms"
                    );
                }
            }
        }
    }
}

impl Measured {
    fn take_up(&mut self, now: Instant, new: ClockOffset) {
        // A clock that was set since: what was measured before says nothing any more.
        self.last.retain(|old| aged(old, now).agrees_with(&new));
        if self.last.len() == KEPT {
            self.last.pop_front();
        }
        self.last.push_back((now, new));
    }

    /// Drops comparisons that are older than `valid_for`.
    fn forget(&mut self, now: Instant, valid_for: Duration) {
        self.last.retain(|(at, _)| now.saturating_duration_since(*at) <= valid_for);
    }

    fn best(&self, now: Instant) -> Option<ClockOffset> {
        self.last.iter().map(|old| aged(old, now)).min_by(|one, other| one.bound_s.total_cmp(&other.bound_s))
    }

    /// What it is, if whether it is off has changed.
    fn news(&mut self, now: Instant) -> Option<ClockOffset> {
        let best = self.best(now)?;
        let is_off = best.offset_s.abs() - best.bound_s > TOLERATED_S;
        (std::mem::replace(&mut self.is_off, is_off) != is_off).then_some(best)
    }
}

/// An earlier comparison with its bound as of now.
fn aged((at, measured): &(Instant, ClockOffset), now: Instant) -> ClockOffset {
    let age_s = now.saturating_duration_since(*at).as_secs_f64();
    ClockOffset { bound_s: measured.bound_s + DRIFT * age_s, ..*measured }
}

/// Whom to ask: those who are heard.
pub(super) fn live(peers: &[PeerHealth]) -> Vec<VehicleId> {
    peers.iter().filter(|peer| peer.standing != Standing::Lost).map(|peer| peer.id).collect()
}

/// Nothing that holds the lock can panic half way.
fn lock(measured: &Mutex<BTreeMap<VehicleId, Measured>>) -> MutexGuard<'_, BTreeMap<VehicleId, Measured>> {
    measured.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn offset(offset_s: f64, bound_s: f64) -> ClockOffset {
        ClockOffset { offset_s, bound_s }
    }

    #[test]
    fn of_the_last_eight_exchanges_the_surest_counts() {
        let (mut measured, at) = (Measured::default(), now());
        assert_eq!(measured.best(at), None);
        measured.take_up(at, offset(0.0, 0.001));
        for _ in 1..KEPT {
            measured.take_up(at, offset(0.002, 0.005));
            assert_eq!(measured.best(at), Some(offset(0.0, 0.001)));
        }
        measured.take_up(at, offset(0.002, 0.005));
        assert_eq!(measured.best(at), Some(offset(0.002, 0.005)), "the surest is too old");
        assert_eq!(measured.last.len(), KEPT);
    }

    #[test]
    fn a_clock_that_is_set_is_measured_anew() {
        let (mut measured, at) = (Measured::default(), now());
        measured.take_up(at, offset(0.0, 0.000_1));
        measured.take_up(at, offset(0.3, 0.005));
        assert_eq!(measured.best(at), Some(offset(0.3, 0.005)), "not both can be true");
    }

    #[test]
    fn a_clock_that_is_off_is_news_once_and_once_when_it_no_longer_is() {
        let (mut measured, at) = (Measured::default(), now());
        let mut news = |offset_s, bound_s| {
            measured.take_up(at, offset(offset_s, bound_s));
            measured.news(at).map(|_| measured.is_off)
        };
        assert_eq!(news(0.021, 0.002), None, "it may be 19 ms");
        assert_eq!(news(-0.5, 0.002), Some(true));
        assert_eq!(news(-0.5, 0.002), None);
        assert_eq!(news(0.001, 0.002), Some(false));
        assert_eq!(news(0.001, 0.002), None);
    }

    #[test]
    fn a_comparison_ages_and_is_forgotten() {
        let (mut measured, at) = (Measured::default(), now());
        measured.take_up(at, offset(0.3, 0.001));
        let later = at + Duration::from_secs(50);
        measured.forget(later, VALID_FOR);
        assert!((measured.best(later).unwrap().bound_s - 0.00175).abs() < 1e-9, "clocks run apart");
        let later = at + Duration::from_secs(61);
        measured.forget(later, VALID_FOR);
        assert_eq!(measured.best(later), None, "a vehicle that no longer answers has no known clock");
    }
}
