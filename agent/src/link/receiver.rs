//! Processing of received messages on Zenoh's threads.

use std::sync::Arc;

use parking_lot::Mutex;
use skein_common::id::{VehicleId, VehicleName};
use skein_common::message::{Heartbeat, Message, Order, Reason, Traffic};
use skein_common::time::LocalTime;
use skein_common::topic::{Author, Branch, Topic};
use skein_core::peers::{PeerMessage, Received, ReceivedState};
use skein_host::clock::LocalClock;
use zenoh::sample::{Locality, Sample, SampleKind};
use zenoh::{Session, Wait};

use super::error::declaring;
use super::inbox::Inbox;
use super::presence::{Change, Presence, watch_tokens};
use super::signature::messages::Verified;
use super::signature::orders::Checker;
use super::strangers::StrangerInbox;
use super::{LinkError, Sessions, Trust, queries};

/// Processing of received messages on Zenoh's threads, which never waits, and the encoding of the own messages. It reads
/// no clock and calls no network.
pub(super) struct LinkReceiver {
    pub(super) own: VehicleId,
    /// The part of the key space that belongs to the own swarm.
    pub(super) branch: Branch,
    pub(super) trust: Trust,
    /// Verifies orders, if they have to be signed.
    pub(super) orders: Option<Checker>,
    pub(super) inbox: Inbox,
    pub(super) strangers: StrangerInbox,
    /// Messages that were sent, and their bytes without Zenoh's framing. A message on several links counts once.
    pub(super) sent: Mutex<Traffic>,
    /// Messages that were received, those that were refused included.
    pub(super) received: Mutex<Traffic>,
    pub(super) presence: Arc<Presence>,
    /// The last own heartbeat, with which an agent answers the queries of agents that start late.
    pub(super) last_heartbeat: Mutex<Vec<u8>>,
}

impl LinkReceiver {
    pub(super) fn new(own: VehicleId, trust: Trust, presence: Arc<Presence>) -> Arc<Self> {
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
    pub(super) fn receive(&self, key: &str, bytes: &[u8], at: LocalTime) {
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
    pub(super) fn verified<M: Message>(
        &self,
        key: &str,
        bytes: &[u8],
        sender: Option<VehicleName>,
    ) -> Option<Verified<M>> {
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
    pub(super) fn store(&self, key: &str, message: PeerMessage, run: Option<u64>, at: LocalTime) {
        if let Some(message) = self.accept(key, message, run) {
            self.inbox.store(key, Received { message, at });
        }
    }

    /// The reply to a peer that queries the last heartbeat; `None` before the first heartbeat.
    pub(super) fn last_heartbeat(&self) -> Option<Vec<u8>> {
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
    pub(super) fn write(&self, key: &str, message: &impl Message) -> Vec<u8> {
        self.trust.key_ring.write(self.trust.signing_key.as_deref(), self.trust.run, key, message)
    }
}

/// Counts a message of this size.
pub(super) fn count(traffic: &Mutex<Traffic>, bytes: usize) {
    let mut traffic = traffic.lock();
    traffic.messages += 1;
    traffic.bytes += bytes as u64;
}

/// Stores every message of this kind.
pub(super) fn subscribe(
    session: &Session,
    key: &str,
    receiver: &Arc<LinkReceiver>,
    clock: LocalClock,
) -> Result<(), LinkError> {
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
pub(super) fn receive(receiver: &LinkReceiver, sample: &Sample, clock: LocalClock) {
    receiver.receive(sample.key_expr().as_str(), &sample.payload().to_bytes(), clock.now());
}

/// Stores which peers appear and vanish, those already up included, and queries each new peer for its last heartbeat.
pub(super) fn watch_presence(
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
pub(super) fn notify(
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
