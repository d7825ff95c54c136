//! The agent's network: Zenoh peers without a broker.
//!
//! Receiving: callbacks on Zenoh's threads decode and verify each message and store the newest one of each peer and
//! kind in a bounded `inbox`; they never wait. The control thread empties the inbox once a step. Sending: the control
//! thread hands over the messages of a step and never calls Zenoh; the publisher's thread sends them (`outgoing`). An
//! agent that starts late queries each peer whose liveliness token it sees for the peer's last heartbeat, and Zenoh's
//! threads reply.

mod clocks;
mod configuration;
mod error;
mod health;
mod inbox;
mod outgoing;
pub mod presence;
mod publisher;
mod queries;
mod receiver;
mod refusals;
pub mod security;
mod sessions;
pub mod signature;
pub(crate) mod simulated;
mod strangers;
mod trust;
mod tunnel;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;

use skein_common::id::VehicleId;
use skein_common::message::Drops;
use skein_common::topic::{Topic, all};
use zenoh::bytes::ZBytes;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority, Reliability};
use zenoh::query::{Query, Queryable};
use zenoh::sample::Locality;
use zenoh::{Session, Wait};

pub use clocks::CLOCK_QUERY_PERIOD;
pub(crate) use configuration::open_zenoh;
pub use error::LinkError;
use error::declaring;
pub use health::{HealthPublisher, Utc};
pub use outgoing::Messages;
use outgoing::Outgoing;
pub use publisher::MessagePublisher;
use receiver::{LinkReceiver, count, subscribe, watch_presence};
pub use security::Security;
pub use sessions::Sessions;
use skein_core::intent::ReceivedIntent;
use skein_core::peers::Received;
use skein_core::strangers::StrangerState;
use skein_host::clock::{LocalClock, now, sleep_until};
use strangers::SubscribedCells;
pub use trust::Trust;

/// Environment variable that sets Zenoh's threads. Zenoh reads it once, at the start of the process.
pub const ZENOH_RUNTIME: &str = "ZENOH_RUNTIME";

/// Value of [`ZENOH_RUNTIME`] in an agent: one runtime with two threads, whatever the size of the swarm. One runtime
/// delivers a third faster and needs half the CPU time. More threads add delay, because each message wakes several of
/// them. Two suffice because no Zenoh thread waits for a cut network: the network sockets belong to the tunnel.
pub const ZENOH_ON_TWO_THREADS: &str =
    "(rx:(handover:app),acc:(handover:app),net:(handover:app),tx:(handover:app),app:(worker_threads:2))";

/// Time for the last messages to arrive before the link closes.
const LINGER: Duration = Duration::from_millis(500);

/// The network link of one agent: receives the peers' messages and publishes its own.
pub struct Link {
    receiver: Arc<LinkReceiver>,
    outgoing: Outgoing,
    /// Whether the trace has a subscriber, for each session.
    trace_is_wanted: Vec<Arc<AtomicBool>>,
    /// Whether the summary has a subscriber, for each session.
    summary_is_wanted: Vec<Arc<AtomicBool>>,
    /// Liveliness tokens, dropped with the sessions; the peers then see that this agent has ended.
    _alive: Vec<LivelinessToken>,
    own: VehicleId,
    /// The sessions end when this, the tokens and the publisher's thread are dropped.
    sessions: Sessions,
}

impl Link {
    /// Starts publishing for vehicle `own` and receiving from the peers that `trust` accepts. Each received message
    /// gets its arrival time from `clock`.
    ///
    /// # Errors
    /// If a session is closed, or a thread cannot be started.
    pub fn new(
        sessions: impl Into<Sessions>,
        own: VehicleId,
        clock: LocalClock,
        trust: Trust,
    ) -> Result<Self, LinkError> {
        let sessions = sessions.into();
        let branch = trust.branch();
        let receiver = LinkReceiver::new(own, trust, sessions.presence());
        let answering = receiver.clone();
        let last_heartbeat = move |_: &Query| answering.last_heartbeat();
        let queryables = queries::answer_queries(&sessions, branch.key(&Topic::Mission(own)), last_heartbeat)?;
        watch_presence(&sessions, own, &receiver, clock)?;
        for session in &sessions.all {
            subscribe(session, &branch.all(all::STATES), &receiver, clock)?;
            subscribe(session, &branch.all(all::MISSIONS), &receiver, clock)?;
        }
        // An operator is linked to the feed. Orders are the only messages that an agent takes from there.
        for session in sessions.published() {
            subscribe(session, &branch.all(all::ORDERS), &receiver, clock)?;
        }
        let trace = MessagePublisher::open(&sessions, &receiver, &Topic::Trace(own), Priority::DataLow)?;
        let trace_is_wanted = trace.publishers.iter().map(watch_matching).collect::<Result<_, _>>()?;
        let summary = MessagePublisher::open(&sessions, &receiver, &Topic::Summary(own), Priority::Data)?;
        let summary_is_wanted = summary.publishers.iter().map(watch_matching).collect::<Result<_, _>>()?;
        let mission = MessagePublisher::open(&sessions, &receiver, &Topic::Mission(own), Priority::InteractiveHigh)?;
        let event = MessagePublisher::open(&sessions, &receiver, &Topic::Event(own), Priority::DataHigh)?;
        let mut network = ZenohNetwork {
            receiver: receiver.clone(),
            sessions: sessions.clone(),
            cells: SubscribedCells::default(),
            mission,
            _queryables: queryables,
            event,
            trace,
            summary,
        };
        let send = move |waiting: &mut Messages| {
            if let Some(cells) = waiting.cells.take() {
                network.cells.set(&cells, &network.sessions.all, &network.receiver, clock);
            }
            network.receiver.publish(waiting, |topic, key, bytes| network.put(topic, key, bytes));
        };
        let outgoing = Outgoing::start(send).map_err(LinkError::Thread)?;
        let alive = branch.key(&Topic::Alive(own));
        let token = |session: &Arc<Session>| {
            session.liveliness().declare_token(alive.clone()).wait().map_err(declaring(&alive))
        };
        // The token comes last: an agent whose token is visible must already be able to receive.
        let alive = sessions.published().map(token).collect::<Result<_, _>>()?;
        Ok(Self { receiver, outgoing, trace_is_wanted, summary_is_wanted, _alive: alive, own, sessions })
    }

    /// Moves all messages received since the last call to the end of `received`: the newest of each peer and kind.
    pub fn drain(&self, received: &mut Vec<Received>) {
        self.receiver.inbox.drain(received);
    }

    /// Moves all states and intents of other teams' vehicles received since the last call to the ends of these lists: the
    /// newest of each vehicle.
    pub fn drain_strangers(&self, states: &mut Vec<StrangerState>, intents: &mut Vec<ReceivedIntent>) {
        self.receiver.strangers.drain(states, intents);
    }

    /// Hands over the messages of one step. Never waits for the network.
    pub fn send(&self, messages: Messages) {
        self.outgoing.hand_over(messages);
    }

    /// Whether the trace has a subscriber.
    pub fn trace_is_wanted(&self) -> bool {
        self.trace_is_wanted.iter().any(|flag| flag.load(Relaxed))
    }

    /// Whether the summary has a subscriber.
    pub fn summary_is_wanted(&self) -> bool {
        self.summary_is_wanted.iter().any(|flag| flag.load(Relaxed))
    }

    /// Opens the health publisher, for use by another thread, and starts to answer clock queries with the time of
    /// `utc`.
    ///
    /// # Errors
    /// If a session is closed.
    pub fn health(&self, utc: Utc) -> Result<HealthPublisher, LinkError> {
        HealthPublisher::open(self, utc)
    }

    /// Number of messages dropped so far, by reason.
    pub fn drops(&self) -> Drops {
        self.receiver.inbox.refusals.drops()
    }

    /// Number of events and traces that were not sent because the network was too slow.
    pub fn unsent(&self) -> u64 {
        self.outgoing.dropped()
    }

    /// Sends the messages that still wait, then closes the sessions. Zenoh's own closing can take ten seconds on a bad
    /// network; this returns within two.
    pub fn close(self) {
        self.outgoing.end();
        // A receiver discards unread data after the link has ended, so the last event has to arrive before that.
        sleep_until(now() + LINGER);
        self.sessions.clone().close(self);
    }
}

/// Zenoh's sessions, as the publisher's thread uses them.
struct ZenohNetwork {
    receiver: Arc<LinkReceiver>,
    sessions: Sessions,
    cells: SubscribedCells,
    mission: MessagePublisher,
    /// Answer the queries of agents that start late with the last heartbeat.
    _queryables: Vec<Queryable<()>>,
    event: MessagePublisher,
    trace: MessagePublisher,
    summary: MessagePublisher,
}

impl ZenohNetwork {
    /// Publishes a message with the quality of service of its topic. Zenoh may block the thread for a slow peer.
    fn put(&self, topic: Topic, key: &str, bytes: Vec<u8>) {
        match topic {
            Topic::State(..) => self.put_in_cell(key, bytes, Priority::RealTime, true, Reliability::BestEffort),
            Topic::Intent(..) => {
                self.put_in_cell(key, bytes, Priority::InteractiveHigh, false, Reliability::default());
            }
            Topic::Event(_) => self.event.put(bytes),
            Topic::Trace(_) => self.trace.put(bytes),
            Topic::Summary(_) => self.summary.put(bytes),
            _ => self.mission.put(bytes),
        }
    }

    /// Publishes under the key of a cell. Cells change, so no publisher is declared.
    fn put_in_cell(&self, key: &str, bytes: Vec<u8>, priority: Priority, express: bool, reliability: Reliability) {
        count(&self.receiver.sent, bytes.len());
        let bytes = ZBytes::from(bytes);
        for session in self.sessions.published() {
            let put = session.put(key, bytes.clone()).congestion_control(CongestionControl::Drop).priority(priority);
            // As in `MessagePublisher`: it fails only on a closed session.
            let _ = put.express(express).reliability(reliability).allowed_destination(Locality::Remote).wait();
        }
    }
}

/// Follows whether this publisher has subscribers.
fn watch_matching(publisher: &Publisher<'static>) -> Result<Arc<AtomicBool>, LinkError> {
    let has_subscriber = Arc::new(AtomicBool::new(false));
    let flag = has_subscriber.clone();
    let listener = publisher.matching_listener().callback(move |status| flag.store(status.matching(), Relaxed));
    listener.background().wait().map_err(declaring(publisher.key_expr().as_str()))?;
    Ok(has_subscriber)
}

#[cfg(test)]
pub(crate) mod tests;
