//! The link of one agent without Zenoh, threads and a clock: a test carries its messages over a simulated network, in
//! virtual time. Everything else is the code of the real link.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};

use skein_common::id::{VehicleId, VehicleName};
use skein_common::message::Drops;
use skein_common::time::LocalTime;
use skein_common::topic::Cell;

use super::outgoing::{Messages, Outgoing};
use super::presence::{LinkGuard, Presence};
use super::publishing::{Network, Published, Publishing};
use super::queries::LastHeartbeat;
use super::{Link, LinkReceiver, Sessions, Trust};

/// A message that an agent publishes.
#[derive(Clone, Debug, PartialEq)]
pub struct Put {
    /// The Zenoh key.
    pub key: String,
    /// The encoded and signed message.
    pub bytes: Vec<u8>,
    /// Whether the network may lose, repeat and reorder it, as it may a state.
    pub is_best_effort: bool,
}

/// Numbers of entries in the memory of a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct LinkSizes {
    /// Messages that wait for the control thread.
    pub inbox: usize,
    /// Vehicles with a link.
    pub linked: usize,
    /// Events that wait for the publisher's thread.
    pub events: usize,
    /// Traces that wait for the publisher's thread.
    pub traces: usize,
    /// Kinds of refused messages.
    pub refusals: usize,
    /// Orders of which it is known whether the operator signed them.
    pub checked_orders: usize,
}

/// The network's end of the link of one agent.
pub(crate) struct SimulatedEnd {
    receiver: Arc<LinkReceiver>,
    presence: Arc<Presence>,
    links: BTreeMap<u64, LinkGuard>,
    /// Time of the last change of the links by the agent's clock, ns.
    changed: Arc<AtomicU64>,
    /// Whether the trace has a subscriber.
    is_traced: Arc<AtomicBool>,
    publishing: Publishing,
    last_heartbeat: LastHeartbeat,
    waiting: Messages,
    puts: Puts,
}

#[derive(Default)]
struct Puts(Vec<Put>);

impl Network for Puts {
    fn put(&mut self, what: Published, key: &str, bytes: Vec<u8>) {
        self.0.push(Put { key: key.to_owned(), bytes, is_best_effort: what == Published::State });
    }

    /// The test has one team.
    fn subscribe(&mut self, _cells: &[Cell]) {}
}

impl SimulatedEnd {
    /// The link of vehicle `own` and the network's end of it.
    pub(crate) fn new(own: VehicleId, trust: Trust) -> (Link, Self) {
        let (presence, last_heartbeat, branch) = (Presence::by_links(), LastHeartbeat::default(), trust.branch());
        let receiver = LinkReceiver::new(own, trust, presence.clone());
        let changed = Arc::<AtomicU64>::default();
        let of_notify = changed.clone();
        let now = move || LocalTime::from_nanoseconds(of_notify.load(Relaxed));
        presence.watch_links(branch, super::notify(&receiver, now));
        let publishing = Publishing::new(receiver.clone(), own, last_heartbeat.clone());
        let is_traced = Arc::<AtomicBool>::default();
        let link = Link {
            receiver: receiver.clone(),
            outgoing: Outgoing::without_thread(),
            trace_is_wanted: vec![is_traced.clone()],
            summary_is_wanted: Vec::new(),
            _alive: Vec::new(),
            own,
            sessions: Sessions::default(),
        };
        let (links, waiting, puts) = Default::default();
        (link, Self { receiver, presence, links, changed, is_traced, publishing, last_heartbeat, waiting, puts })
    }

    /// Registers a link with a peer under the peer's certificate, until [`Self::link_ends`] with the same number.
    pub(crate) fn link_forms(&mut self, number: u64, with: VehicleName, at: LocalTime) {
        self.changed.store(at.nanoseconds(), Relaxed);
        self.links.insert(number, self.presence.link(Some(with)));
    }

    pub(crate) fn link_ends(&mut self, number: u64, at: LocalTime) {
        self.changed.store(at.nanoseconds(), Relaxed);
        self.links.remove(&number);
    }

    pub(crate) fn set_traced(&self, is_traced: bool) {
        self.is_traced.store(is_traced, Relaxed);
    }

    /// Takes a message that arrived at this time.
    pub(crate) fn receive(&self, key: &str, bytes: &[u8], at: LocalTime) {
        self.receiver.receive(key, bytes, at);
    }

    /// The reply to a peer that queries the last heartbeat.
    pub(crate) fn last_heartbeat(&self) -> Option<Vec<u8>> {
        self.last_heartbeat.reply()
    }

    /// Publishes what waits in the link, as the publisher's thread does.
    pub(crate) fn publish(&mut self, link: &Link) -> Vec<Put> {
        if link.outgoing.take_due(&mut self.waiting) {
            self.publishing.send(&mut self.waiting, &mut self.puts);
        }
        std::mem::take(&mut self.puts.0)
    }

    pub(crate) fn sizes(&self, link: &Link) -> LinkSizes {
        let (events, traces) = link.outgoing.queued();
        LinkSizes {
            inbox: self.receiver.inbox.len(),
            linked: self.presence.linked(),
            events,
            traces,
            refusals: self.receiver.inbox.refusals.latest().len(),
            checked_orders: self.receiver.verifier.checked_orders(),
        }
    }

    pub(crate) fn drops(&self) -> Drops {
        self.receiver.inbox.refusals.drops()
    }

    pub(crate) fn may_send(&self, name: VehicleName) -> bool {
        self.presence.may_send(name)
    }
}
