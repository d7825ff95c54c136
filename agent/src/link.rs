//! The agent's network: Zenoh peers without a broker.
//!
//! Receiving: callbacks on Zenoh's threads decode and verify each message and store the newest one of each peer and
//! kind in a bounded `inbox`; they never wait. The control thread empties the inbox once a step. Sending: the control
//! thread hands over the messages of a step and never calls Zenoh; the publisher's thread sends them (`outgoing`). An
//! agent that starts late queries each peer whose liveliness token it sees for the peer's last heartbeat, and Zenoh's
//! threads reply.

mod clocks;
mod health;
mod inbox;
mod outgoing;
pub mod presence;
mod publisher;
mod queries;
mod refusals;
pub mod security;
mod sessions;
pub mod signature;
pub(crate) mod simulated;
mod strangers;
mod trust;
mod tunnel;

use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;

use parking_lot::Mutex;
use serde_json::{Value, json};
use skein_common::id::{SwarmName, VehicleId, VehicleName};
use skein_common::message::{Drops, Heartbeat, Message, Order, Reason, Traffic};
use skein_common::time::LocalTime;
use skein_common::topic::{Author, Branch, Topic, all};
use zenoh::bytes::ZBytes;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority, Reliability};
use zenoh::query::{Query, Queryable};
use zenoh::sample::{Locality, Sample, SampleKind};
use zenoh::{Config, Session, Wait};

pub use clocks::CLOCK_QUERY_PERIOD;
pub use health::{HealthPublisher, Utc};
use inbox::Inbox;
pub use outgoing::Messages;
use outgoing::Outgoing;
use presence::{Change, Presence, watch_tokens};
pub use publisher::MessagePublisher;
pub use security::Security;
pub use sessions::Sessions;
use signature::messages::Verified;
use signature::orders::Checker;
use skein_core::intent::ReceivedIntent;
use skein_core::peers::{PeerMessage, Received, ReceivedState};
use skein_core::strangers::StrangerState;
use skein_host::clock::{LocalClock, now, sleep_until};
use strangers::{StrangerInbox, SubscribedCells};
pub use trust::Trust;

/// Environment variable that sets Zenoh's threads. Zenoh reads it once, at the start of the process.
pub const ZENOH_RUNTIME: &str = "ZENOH_RUNTIME";

/// Value of [`ZENOH_RUNTIME`] in an agent: one runtime with two threads, whatever the size of the swarm. One runtime
/// delivers a third faster and needs half the CPU time. More threads add delay, because each message wakes several of
/// them. Two suffice because no Zenoh thread waits for a cut network: the network sockets belong to the tunnel.
pub const ZENOH_ON_TWO_THREADS: &str =
    "(rx:(handover:app),acc:(handover:app),net:(handover:app),tx:(handover:app),app:(worker_threads:2))";

/// Time for a dialled peer to reply. The tunnel gives up earlier on a host that cannot be reached.
const OPEN_TIMEOUT: Duration = Duration::from_secs(10);
/// Zenoh's lease: a session that has sent nothing for this long ends. The lease is long so that agents on a slow PC
/// stay linked; a lost agent is detected earlier, by the age of its messages.
const LEASE: Duration = Duration::from_secs(4);

/// Longest time that a thread waits for a peer to accept a message that must not be dropped; then that link is closed.
const BLOCK_TIMEOUT: Duration = Duration::from_millis(20);

/// Time for the last messages to arrive before the link closes.
const LINGER: Duration = Duration::from_millis(500);

/// Largest message accepted from the network, bytes.
const MAX_MESSAGE_BYTES: usize = 1 << 20;

/// The reason why the network cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// Zenoh rejects our configuration.
    #[error("the network cannot be configured: {}", plain(.0))]
    Configuration(#[source] zenoh::Error),
    /// A text that is not an endpoint.
    #[error("{0:?} is not an endpoint; write it like tcp/127.0.0.1:7447")]
    Endpoint(String),
    /// A plain endpoint where links are secured, or a secured endpoint without keys.
    #[error(
        "{endpoint:?}: {}",
        if *expected == "tls" { "links are secured here; write the endpoint like tls/10.0.0.11:7447" }
        else { "there are no keys for secured links; write a plain endpoint like tcp/127.0.0.1:7447" }
    )]
    Protocol {
        /// The endpoint.
        endpoint: String,
        /// Protocol that the endpoint must start with.
        expected: &'static str,
    },
    /// A key or certificate file that cannot be used, and the fault found in it.
    #[error("{}: {}", .0.display(), .1)]
    File(PathBuf, #[source] io::Error),
    /// A certificate name that is empty or used twice.
    #[error("the certificate name {0:?} must name exactly one of the vehicles, the observer and the operator")]
    Name(String),
    /// The node's own key differs from the key that the swarm has for this vehicle.
    #[error("this node's key is not the key that the swarm has for vehicle {0}")]
    Key(VehicleName),
    /// A session that listens on these endpoints cannot be opened, most often because the address is in use or belongs to another
    /// host.
    #[error("cannot listen on {}: {}", .0.join(", "), plain(.1))]
    Open(Vec<String>, #[source] zenoh::Error),
    /// The session rejects a publisher, subscriber, queryable or token with this key expression.
    #[error("cannot declare {}: {}", .0, plain(.1))]
    Declare(String, #[source] zenoh::Error),
    /// A sending thread cannot be started.
    #[error("a thread cannot be started: {0}")]
    Thread(io::Error),
}

impl LinkError {
    /// Whether the cause is an argument or a file, not the network.
    pub fn is_user_error(&self) -> bool {
        !matches!(self, Self::Configuration(_) | Self::Open(..) | Self::Declare(..) | Self::Thread(_))
    }
}

/// Opens a Zenoh session of this swarm: a peer without discovery. The settings in `more` override ours.
pub(crate) fn open_zenoh(
    swarm: &SwarmName,
    listen: &[String],
    dial: &[String],
    more: &[(&str, Value)],
) -> Result<Session, LinkError> {
    let configuration = configuration(swarm, listen, dial, more).map_err(LinkError::Configuration)?;
    zenoh::open(configuration).wait().map_err(|source| LinkError::Open(listen.to_vec(), source))
}

fn configuration(
    swarm: &SwarmName,
    listen: &[String],
    dial: &[String],
    more: &[(&str, Value)],
) -> zenoh::Result<Config> {
    let mut configuration = Config::default();
    let values = [
        ("mode", json!("peer")),
        ("namespace", json!(swarm.as_str())),
        ("listen/endpoints", json!(listen)),
        ("connect/endpoints", json!(dial)),
        // A short retry period: a peer is back within a second after the network is restored.
        ("connect/retry", json!({ "period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5 })),
        // A peer that replies slowly is not dialled a second time.
        ("transport/unicast/open_timeout", json!(OPEN_TIMEOUT.as_millis())),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        ("adminspace/enabled", json!(false)),
        ("transport/link/tx/lease", json!(LEASE.as_millis())),
        ("transport/link/tx/keep_alive", json!(4)),
        // Sending never waits: a message whose queue is full is dropped at once, because the next one is newer.
        ("transport/link/tx/queue/congestion_control/drop/wait_before_drop", json!(0)),
        // Zenoh must not drop its own declarations. A peer that does not accept them in time loses its link.
        ("transport/link/tx/queue/congestion_control/block/wait_before_close", json!(BLOCK_TIMEOUT.as_micros())),
        // A reply gets the quality of service of its query. The querying peer must not choose it: a reply is dropped
        // rather than waited for, and has a queue of its own.
        (
            "qos/network",
            json!([{
                "messages": ["query"],
                "flows": ["ingress"],
                "overwrite": { "congestion_control": "drop", "priority": "interactive_low", "express": true },
            }]),
        ),
        // Limits the memory for fragmented messages before they are decoded: many times the largest message.
        ("transport/link/rx/max_message_size", json!(MAX_MESSAGE_BYTES)),
    ];
    for (key, value) in values.iter().chain(more) {
        configuration.insert_json5(key, &value.to_string())?;
    }
    Ok(configuration)
}

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

/// Processing of received messages on Zenoh's threads, which never waits, and the encoding of the own messages. It reads
/// no clock and calls no network.
struct LinkReceiver {
    own: VehicleId,
    /// The part of the key space that belongs to the own swarm.
    branch: Branch,
    trust: Trust,
    /// Verifies orders, if they have to be signed.
    orders: Option<Checker>,
    inbox: Inbox,
    strangers: StrangerInbox,
    /// Messages that were sent, and their bytes without Zenoh's framing. A message on several links counts once.
    sent: Mutex<Traffic>,
    /// Messages that were received, those that were refused included.
    received: Mutex<Traffic>,
    presence: Arc<Presence>,
    /// The last own heartbeat, with which an agent answers the queries of agents that start late.
    last_heartbeat: Mutex<Vec<u8>>,
}

impl LinkReceiver {
    fn new(own: VehicleId, trust: Trust, presence: Arc<Presence>) -> Arc<Self> {
        let branch = trust.branch();
        Arc::new(Self {
            own,
            branch,
            orders: trust.orders.map(|key| Checker::new(key, trust.swarm.clone(), branch)),
            trust,
            inbox: Inbox::new(),
            strangers: StrangerInbox::default(),
            sent: Mutex::default(),
            received: Mutex::default(),
            presence,
            last_heartbeat: Mutex::default(),
        })
    }

    /// Verifies a message that arrived at this time, and stores it if its sender was allowed to publish it under this key.
    /// The link subscribes to states, heartbeats and orders only.
    fn receive(&self, key: &str, bytes: &[u8], at: LocalTime) {
        match self.branch.own(key) {
            Some(Topic::State(..)) => self
                .receive_as(key, bytes, at, |state| PeerMessage::State(ReceivedState::new(state, &self.trust.origin))),
            Some(Topic::Order(_)) => self.receive_as::<Order>(key, bytes, at, PeerMessage::Order),
            _ => self.receive_as::<Heartbeat>(key, bytes, at, PeerMessage::Mission),
        }
    }

    fn receive_as<M: Message>(&self, key: &str, bytes: &[u8], at: LocalTime, message: impl Fn(M) -> PeerMessage) {
        let sender = match self.branch.own(key).map(|topic| topic.author()) {
            Some(Author::Vehicle(id)) => Some(self.branch.name(id)),
            _ => None,
        };
        if let Some(verified) = self.verified(key, bytes, sender) {
            self.store(key, message(verified.message), verified.run, at);
        }
    }

    /// Decodes a message and verifies its sender; a message that is refused is counted. `sender` is the vehicle of the
    /// key, if the key has one.
    fn verified<M: Message>(&self, key: &str, bytes: &[u8], sender: Option<VehicleName>) -> Option<Verified<M>> {
        count(&self.received, bytes.len());
        let refusals = &self.inbox.refusals;
        // Replayed by another node, or delivered while the sender's link broke.
        if sender.is_some_and(|name| !self.presence.may_send(name)) {
            refusals.refuse(Reason::Old, key, &"its sender has no link");
            return None;
        }
        let read = self.trust.key_ring.read(key, bytes);
        read.map_err(|error| refusals.refuse(error.reason(), key, &error)).ok()
    }

    /// Stores a message if the trust rules accept it. `run` is the run of the swarm in its signature, if it has one.
    fn store(&self, key: &str, message: PeerMessage, run: Option<u64>, at: LocalTime) {
        if let Some(message) = self.accept(key, message, run) {
            self.inbox.store(key, Received { message, at });
        }
    }

    /// The reply to a peer that queries the last heartbeat; `None` before the first heartbeat.
    fn last_heartbeat(&self) -> Option<Vec<u8>> {
        Some(self.last_heartbeat.lock().clone()).filter(|bytes| !bytes.is_empty())
    }

    /// Takes a change of the vehicles that are up.
    fn presence_changed(&self, change: Change, at: LocalTime) {
        let (id, message) = match change {
            Change::Appeared(id) => (id, PeerMessage::Appeared(id)),
            Change::Vanished(id) => (id, PeerMessage::Vanished(id)),
            Change::Refused(address) => {
                self.inbox.refusals.count(Reason::Link, &address);
                return;
            }
        };
        // The own token is reported like any other.
        if id != self.own {
            self.store(&self.branch.key(&Topic::Alive(id)), message, None, at);
        }
    }

    /// Encodes one of the own messages, with a signature where messages are signed.
    fn write(&self, key: &str, message: &impl Message) -> Vec<u8> {
        self.trust.key_ring.write(self.trust.signing_key.as_deref(), self.trust.run, key, message)
    }
}

/// Counts a message of this size.
fn count(traffic: &Mutex<Traffic>, bytes: usize) {
    let mut traffic = traffic.lock();
    traffic.messages += 1;
    traffic.bytes += bytes as u64;
}

/// Follows whether this publisher has subscribers.
fn watch_matching(publisher: &Publisher<'static>) -> Result<Arc<AtomicBool>, LinkError> {
    let has_subscriber = Arc::new(AtomicBool::new(false));
    let flag = has_subscriber.clone();
    let listener = publisher.matching_listener().callback(move |status| flag.store(status.matching(), Relaxed));
    listener.background().wait().map_err(declaring(publisher.key_expr().as_str()))?;
    Ok(has_subscriber)
}

/// Stores every message of this kind.
fn subscribe(session: &Session, key: &str, receiver: &Arc<LinkReceiver>, clock: LocalClock) -> Result<(), LinkError> {
    let receiver = receiver.clone();
    session
        .declare_subscriber(key)
        .allowed_origin(Locality::Remote)
        .callback(move |sample| receive(&receiver, &sample, clock))
        .background()
        .wait()
        .map_err(declaring(key))
}

/// Hands a message from Zenoh to the receiver.
fn receive(receiver: &LinkReceiver, sample: &Sample, clock: LocalClock) {
    receiver.receive(sample.key_expr().as_str(), &sample.payload().to_bytes(), clock.now());
}

/// Stores which peers appear and vanish, those already up included, and queries each new peer for its last heartbeat.
fn watch_presence(
    sessions: &Sessions,
    own: VehicleId,
    receiver: &Arc<LinkReceiver>,
    clock: LocalClock,
) -> Result<(), LinkError> {
    let branch = receiver.branch;
    receiver.presence.watch(sessions, branch, notify(receiver, move || clock.now()))?;
    for session in &sessions.all {
        let (receiver, asking) = (receiver.clone(), Arc::downgrade(session));
        let ask = move |id: VehicleId, kind| {
            if let (true, SampleKind::Put, Some(session)) = (id != own, kind, asking.upgrade()) {
                let receiver = receiver.clone();
                queries::send_query(&session, branch.key(&Topic::Mission(id)), &[], move |sample| {
                    receive(&receiver, sample, clock);
                });
            }
        };
        watch_tokens(session, branch, ask)?;
    }
    Ok(())
}

/// Passes the changes of the vehicles that are up to the receiver.
fn notify(
    receiver: &Arc<LinkReceiver>,
    now: impl Fn() -> LocalTime + Send + Sync + 'static,
) -> impl Fn(Change) + Send + Sync + 'static {
    // A weak reference: the receiver owns the presence that calls this.
    let weak = Arc::downgrade(receiver);
    move |change| {
        if let Some(receiver) = weak.upgrade() {
            receiver.presence_changed(change, now());
        }
    }
}

/// Zenoh's error text without the places in its source code, such as `at .../tcp.rs:61.`.
fn plain(error: &zenoh::Error) -> String {
    let mut text = error.to_string();
    while let Some(place) = text.find(".rs:") {
        let begin = text[..place].rfind(" at ").unwrap_or(place);
        let number = place + ".rs:".len();
        let after = text[number..].find(|c: char| !c.is_ascii_digit() && c != '.');
        text.replace_range(begin..after.map_or(text.len(), |after| number + after), "");
    }
    text
}

fn declaring(key: &str) -> impl FnOnce(zenoh::Error) -> LinkError {
    let key = key.to_owned();
    move |source| LinkError::Declare(key, source)
}

#[cfg(test)]
mod tests;
