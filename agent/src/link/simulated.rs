//! The link of one agent without Zenoh, threads and a clock: a test carries its messages over a simulated network, in
//! virtual time. Everything else is the code of the real link.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::time::Instant;

use skein_common::id::VehicleId;
use skein_common::message::Drops;
use skein_common::time::LocalTime;
use skein_common::topic::Topic;
use skein_host::clock::LocalClock;

use super::outgoing::{Handover, Messages, Outgoing};
use super::presence::{LinkGuard, Presence};
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

/// The network's end of the link of one agent. All instants are those of the agent's computer.
pub struct SimulatedEnd {
    receiver: Arc<LinkReceiver>,
    handover: Arc<Handover>,
    clock: LocalClock,
    links: BTreeMap<u64, LinkGuard>,
    /// Time of the last change of the links by the agent's clock, ns.
    changed: Arc<AtomicU64>,
    /// Whether the trace has a subscriber.
    is_traced: Arc<AtomicBool>,
    waiting: Messages,
}

impl SimulatedEnd {
    /// The link of vehicle `own` and the network's end of it.
    pub(crate) fn new(own: VehicleId, clock: LocalClock, trust: Trust) -> (Link, Self) {
        let (presence, branch) = (Presence::by_links(), trust.branch());
        let receiver = LinkReceiver::new(own, trust, presence.clone());
        let (changed, is_traced) = (Arc::<AtomicU64>::default(), Arc::<AtomicBool>::default());
        let of_notify = changed.clone();
        let now = move || LocalTime::from_nanoseconds(of_notify.load(Relaxed));
        presence.watch_links(branch, super::receiver::notify(&receiver, now));
        let outgoing = Outgoing::without_thread();
        let handover = outgoing.shared.clone();
        let link = Link {
            receiver: receiver.clone(),
            outgoing,
            trace_is_wanted: vec![is_traced.clone()],
            summary_is_wanted: Vec::new(),
            _alive: Vec::new(),
            own,
            sessions: Sessions::default(),
        };
        let (links, waiting) = Default::default();
        (link, Self { receiver, handover, clock, links, changed, is_traced, waiting })
    }

    /// Registers a link with a peer under the peer's certificate. It lasts until [`Self::link_ends`] with the same number.
    pub fn link_forms(&mut self, number: u64, with: VehicleId, now: Instant) {
        self.changed.store(self.clock.at(now).nanoseconds(), Relaxed);
        self.links.insert(number, self.receiver.presence.link(Some(with.into())));
    }

    /// Ends the link with this number.
    pub fn link_ends(&mut self, number: u64, now: Instant) {
        self.changed.store(self.clock.at(now).nanoseconds(), Relaxed);
        self.links.remove(&number);
    }

    /// Makes an observer of the trace appear or vanish.
    pub fn set_traced(&self, is_traced: bool) {
        self.is_traced.store(is_traced, Relaxed);
    }

    /// Takes a message that arrived on a link.
    pub fn receive(&self, key: &str, bytes: &[u8], now: Instant) {
        self.receiver.receive(key, bytes, self.clock.at(now));
    }

    /// The reply to a peer that queries the last heartbeat; `None` before the first heartbeat.
    pub fn last_heartbeat(&self) -> Option<Vec<u8>> {
        self.receiver.last_heartbeat()
    }

    /// Publishes the messages that wait, as the publisher's thread does.
    pub fn publish(&mut self) -> Vec<Put> {
        let mut puts = Vec::new();
        if self.handover.take_due(&mut self.waiting) {
            self.receiver.publish(&mut self.waiting, |topic, key, bytes| {
                puts.push(Put { key: key.to_owned(), bytes, is_best_effort: matches!(topic, Topic::State(..)) });
            });
        }
        puts
    }

    /// Numbers of entries in the memory of the link.
    pub fn sizes(&self) -> LinkSizes {
        let (events, traces) = self.handover.queued();
        LinkSizes {
            inbox: self.receiver.inbox.len(),
            linked: self.receiver.presence.linked(),
            events,
            traces,
            refusals: self.receiver.inbox.refusals.latest().len(),
            checked_orders: self.receiver.checked_orders(),
        }
    }

    /// Number of messages that the link refused, by reason.
    pub fn drops(&self) -> Drops {
        self.receiver.inbox.refusals.drops()
    }

    /// Whether the agent takes messages of this vehicle.
    pub fn is_linked(&self, with: VehicleId) -> bool {
        self.receiver.presence.may_send(with.into())
    }
}
