//! Queries between agents, answered on Zenoh's threads. An agent that starts late queries its peers for their last
//! heartbeats; clock comparison uses queries too ([`super::clocks`]).

use std::sync::Arc;
use std::time::Duration;

use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, Query, QueryTarget, Queryable};
use zenoh::sample::{Locality, Sample};
use zenoh::{Session, Wait};

use super::{LinkError, Sessions, declaring};

/// Longest wait for a reply. By then the peer has sent its next heartbeat anyway.
const REPLY_TIMEOUT: Duration = Duration::from_secs(1);

/// Answers queries for this key on one of Zenoh's threads, with the bytes that `reply` returns.
pub(super) fn answer_queries(
    sessions: &Sessions,
    key: String,
    reply: impl Fn(&Query) -> Option<Vec<u8>> + Clone + Send + Sync + 'static,
) -> Result<Vec<Queryable<()>>, LinkError> {
    let declare = |session: &Arc<Session>| {
        let (own_key, reply) = (key.clone(), reply.clone());
        let answer = move |query: Query| {
            if let Some(bytes) = reply(&query) {
                // It fails only on a closed session. Zenoh gives a reply the quality of service of its query, which our
                // configuration sets when the query comes in: the reply is dropped rather than waited for.
                let _ = query.reply(&own_key, bytes).wait();
            }
        };
        let queryable = session.declare_queryable(&key).allowed_origin(Locality::Remote).callback(answer);
        queryable.wait().map_err(declaring(&key))
    };
    sessions.published().map(declare).collect()
}

/// Queries a peer for its heartbeat or clock; `question` is the payload. Never waits: `on_reply` gets the replies on
/// one of Zenoh's threads.
pub(super) fn send_query(
    session: &Session,
    key: String,
    question: &[u8],
    on_reply: impl Fn(&Sample) + Send + Sync + 'static,
) {
    let query = session
        .get(key)
        .payload(question)
        // A node that declares itself complete for all keys must not be the only one queried.
        .target(QueryTarget::All)
        .congestion_control(CongestionControl::Drop)
        .priority(Priority::InteractiveHigh)
        .express(true)
        // Otherwise Zenoh holds back a reply until the last one has come.
        .consolidation(ConsolidationMode::None)
        .allowed_destination(Locality::Remote)
        .timeout(REPLY_TIMEOUT)
        .callback(move |reply| {
            if let Ok(sample) = reply.result() {
                on_reply(sample);
            }
        });
    // It fails only on a closed session.
    let _ = query.wait();
}
