//! Publishes health once a second, on a thread that may block: the control thread's report, completed by the link's own
//! counts and clock comparison. Answers clock queries and queries the peers' clocks.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Weak};

use parking_lot::Mutex;
use skein_common::id::VehicleId;
use skein_common::message::{ClockAnswer, ClockOffset, Health, Refused};
use skein_common::state::PeerStatus;
use skein_common::topic::Topic;
use zenoh::qos::Priority;
use zenoh::query::{Query, Queryable};
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

use super::clocks::{self, Measurements};
use super::{Link, LinkError, LinkReceiver, MessagePublisher, queries};
use skein_host::clock::now;

/// Reads UTC, ns since 1970.
pub type Utc = fn() -> u64;

/// Publisher of health messages.
pub struct HealthPublisher {
    pub(super) publisher: MessagePublisher,
    /// Weak, so that the sessions end with the link.
    sessions: Vec<Weak<Session>>,
    receiver: Arc<LinkReceiver>,
    utc: Utc,
    pub(super) measurements: Arc<Mutex<BTreeMap<VehicleId, Measurements>>>,
    /// Peers in contact at the last health message.
    pub(super) live: Vec<VehicleId>,
    /// Peer of the last clock query.
    asked: Option<VehicleId>,
    _queryables: Vec<Queryable<()>>,
}

impl HealthPublisher {
    pub(super) fn open(link: &Link, utc: Utc) -> Result<Self, LinkError> {
        let Link { sessions, receiver, own, .. } = link;
        let (own, for_queries) = (*own, receiver.clone());
        let publisher = MessagePublisher::open(sessions, receiver, &Topic::Health(own), Priority::DataHigh)?;
        let key = receiver.branch.key(&Topic::Clock(own));
        let answer_key = key.clone();
        let answer = move |query: &Query| {
            let received_ns = utc();
            let question = u64::from_le_bytes(query.payload()?.to_bytes().as_ref().try_into().ok()?);
            let answer = ClockAnswer { sender: own, question, received_ns, answered_ns: utc().max(received_ns) };
            Some(for_queries.write(&answer_key, &answer))
        };
        Ok(Self {
            publisher,
            sessions: sessions.all.iter().map(Arc::downgrade).collect(),
            receiver: receiver.clone(),
            utc,
            measurements: Arc::default(),
            live: Vec::new(),
            asked: None,
            _queryables: queries::answer_queries(sessions, key, answer)?,
        })
    }

    /// Publishes a health message after adding the refused messages, the traffic and the peers' clock offsets.
    pub fn publish(&mut self, mut health: Health) {
        health.links = self.links();
        let receiver = &self.receiver;
        (health.sent, health.received) = (*receiver.sent.lock(), *receiver.received.lock());
        let of_core = std::mem::take(&mut health.refused);
        health.refused = receiver.inbox.refusals.latest();
        health.refused.extend(of_core);
        health.refused.truncate(Refused::MAX_COUNT);
        let live = health.peers.iter().filter(|peer| peer.standing != PeerStatus::Lost);
        self.live = live.map(|peer| peer.id).collect();
        clocks::report(&mut self.measurements.lock(), &mut health.peers, now());
        self.publisher.publish(&health);
    }

    /// Number of links of all sessions.
    fn links(&self) -> u32 {
        let sessions = self.sessions.iter().filter_map(Weak::upgrade);
        let links: usize = sessions.map(|session| session.info().peers_zid().wait().count()).sum();
        u32::try_from(links).unwrap_or(u32::MAX)
    }

    /// Queries the next peer in contact for its time. Call it every [`CLOCK_QUERY_PERIOD`](super::CLOCK_QUERY_PERIOD). Never
    /// waits for the reply.
    pub fn query_next_clock(&mut self) {
        let after = self.live.iter().find(|id| Some(**id) > self.asked).or(self.live.first());
        let Some(&id) = after else { return };
        self.asked = Some(id);
        let (measurements, receiver, answered) =
            (self.measurements.clone(), self.receiver.clone(), Arc::new(AtomicBool::new(false)));
        // The round trip is measured on the monotonic clock, because the own UTC may be set meanwhile.
        let (asked_ns, asked) = ((self.utc)(), now());
        let take = move |sample: &Sample| {
            let round_trip = now().saturating_duration_since(asked);
            let (key, bytes) = (sample.key_expr().as_str(), sample.payload().to_bytes());
            let answer = receiver.trust.key_ring.read::<ClockAnswer>(key, &bytes).ok().map(|verified| verified.message);
            // The number must be that of this query: a replayed reply to an earlier one is ignored.
            let answer = answer.filter(|answer| (answer.sender, answer.question) == (id, asked_ns));
            let round_trip_ns = u64::try_from(round_trip.as_nanos()).unwrap_or(u64::MAX);
            let offset = answer.and_then(|answer| ClockOffset::of_exchange(asked_ns, &answer, round_trip_ns));
            // One query counts at most once.
            if let Some(offset) = offset.filter(|_| !answered.swap(true, Relaxed)) {
                measurements.lock().entry(id).or_default().add(now(), offset);
            }
        };
        let key = self.receiver.branch.key(&Topic::Clock(id));
        // The peer is linked to one of the sessions.
        for session in self.sessions.iter().filter_map(Weak::upgrade) {
            queries::send_query(&session, key.clone(), &asked_ns.to_le_bytes(), take.clone());
        }
    }
}
