//! The last register that an agent said, kept for whoever comes late: Zenoh's threads answer with it, whatever the agent
//! does.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use skein_common::topic::Topic;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, Query, QueryTarget, Queryable};
use zenoh::sample::{Locality, Sample};
use zenoh::{Session, Wait};

use super::{LinkError, Sessions, declaring};

/// An answer that takes longer is not waited for: the next register is said by then.
const ANSWER_WITHIN: Duration = Duration::from_secs(1);

/// What is answered to those who ask.
pub(super) struct Register {
    last: Arc<Mutex<Vec<u8>>>,
    _answering: Vec<Queryable<()>>,
}

impl Register {
    /// Answers whoever asks for this topic; nobody before the first [`Register::keep`].
    pub(super) fn open(sessions: &Sessions, topic: Topic) -> Result<Self, LinkError> {
        let last = Arc::<Mutex<Vec<u8>>>::default();
        let kept = last.clone();
        let said = move |_: &Query| Some(lock(&kept).clone()).filter(|said| !said.is_empty());
        let answering = answer(sessions, topic, said)?;
        Ok(Self { last, _answering: answering })
    }

    /// From now on this is the answer.
    pub(super) fn keep(&self, said: Vec<u8>) {
        *lock(&self.last) = said;
    }
}

/// Held for a copy of some bytes, in which nothing can panic.
fn lock(kept: &Mutex<Vec<u8>>) -> MutexGuard<'_, Vec<u8>> {
    kept.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Answers whoever asks for this topic with what `said` gives, on one of Zenoh's threads.
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
                // It fails only on a closed session. Zenoh gives an answer the quality of service of its question, and that is
                // set by our configuration when the question comes in: the answer is dropped rather than waited for.
                let _ = query.reply(&own_key, said).wait();
            }
        };
        let answering = session.declare_queryable(&key).allowed_origin(Locality::Remote).callback(answer);
        answering.wait().map_err(declaring(&key))
    };
    sessions.all.iter().map(declare).collect()
}

/// Asks for somebody's register, or clock, with these bytes of a question; `take` gets the answers on one of Zenoh's threads.
/// Never waits for them.
pub(super) fn ask(session: &Session, topic: Topic, question: &[u8], take: impl Fn(&Sample) + Send + Sync + 'static) {
    let asked = session
        .get(topic.key())
        .payload(question)
        // Whoever says that it answers for all must not be the only one who is asked.
        .target(QueryTarget::All)
        .congestion_control(CongestionControl::Drop)
        .priority(Priority::InteractiveHigh)
        .express(true)
        // Otherwise Zenoh keeps the answer until the last one has come.
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
