//! Queries between agents, answered on Zenoh's threads. An agent that starts late queries its peers for their last
//! heartbeats; clock comparison uses queries too ([`super::clocks`]).

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use skein_common::topic::Topic;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, Query, QueryTarget, Queryable};
use zenoh::sample::{Locality, Sample};
use zenoh::{Session, Wait};

use super::{LinkError, Sessions, declaring};

/// Longest wait for a reply. By then the peer has sent its next heartbeat anyway.
const ANSWER_WITHIN: Duration = Duration::from_secs(1);

/// Answers queries with the last heartbeat.
pub(super) struct Register {
    last: Arc<Mutex<Vec<u8>>>,
    _answering: Vec<Queryable<()>>,
}

impl Register {
    /// Starts to answer queries for this topic; the first reply needs a [`Register::keep`].
    pub(super) fn open(sessions: &Sessions, topic: Topic) -> Result<Self, LinkError> {
        let last = Arc::<Mutex<Vec<u8>>>::default();
        let kept = last.clone();
        let said = move |_: &Query| Some(lock(&kept).clone()).filter(|said| !said.is_empty());
        let answering = answer(sessions, topic, said)?;
        Ok(Self { last, _answering: answering })
    }

    /// Makes these bytes the reply from now on.
    pub(super) fn keep(&self, said: Vec<u8>) {
        *lock(&self.last) = said;
    }
}

/// Locks the bytes. No holder can panic: the lock is held only for a copy.
fn lock(kept: &Mutex<Vec<u8>>) -> MutexGuard<'_, Vec<u8>> {
    kept.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Answers queries for this topic on one of Zenoh's threads, with the bytes that `said` returns.
pub(super) fn answer(
    sessions: &Sessions,
    topic: Topic,
    said: impl Fn(&Query) -> Option<Vec<u8>> + Clone + Send + Sync + 'static,
) -> Result<Vec<Queryable<()>>, LinkError> {
    let key = topic.key();
    let declare = |session: &Arc<Session>| {
        let (own_key, said) = (key.clone(), said.clone());
        let answer = move |query: Query| {
            if let Some(said) = said(&query) {
                // It fails only on a closed session. Zenoh gives a reply the quality of service of its query, which our
                // configuration sets when the query comes in: the reply is dropped rather than waited for.
                let _ = query.reply(&own_key, said).wait();
            }
        };
        let answering = session.declare_queryable(&key).allowed_origin(Locality::Remote).callback(answer);
        answering.wait().map_err(declaring(&key))
    };
    sessions.all.iter().map(declare).collect()
}

/// Queries a peer for its heartbeat or clock; `question` is the payload. Never waits: `take` gets the replies on one of
/// Zenoh's threads.
pub(super) fn ask(session: &Session, topic: Topic, question: &[u8], take: impl Fn(&Sample) + Send + Sync + 'static) {
    let asked = session
        .get(topic.key())
        .payload(question)
        // A node that declares itself complete for all keys must not be the only one queried.
        .target(QueryTarget::All)
        .congestion_control(CongestionControl::Drop)
        .priority(Priority::InteractiveHigh)
        .express(true)
        // Otherwise Zenoh holds back a reply until the last one has come.
        .consolidation(ConsolidationMode::None)
        .allowed_destination(Locality::Remote)
        .timeout(ANSWER_WITHIN)
        .callback(move |reply| {
            if let Ok(said) = reply.result() {
                take(said);
            }
        });
    // It fails only on a closed session.
    let _ = asked.wait();
}
