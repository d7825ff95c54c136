//! The vehicles of a swarm as receivers.

use alloc::vec::Vec;

use skein_common::id::VehicleId;
use skein_common::scenario::Scenario;
use skein_common::time::LocalTime;

use super::super::AddedDelays;
use super::super::channel::Channel;
use super::super::link::Link;
use crate::peers::{PeerMessage, Received};

/// A vehicle as a receiver.
#[derive(Clone, Debug)]
pub(super) struct SwarmReceiver {
    /// The channel for orders from operators, and their number so far.
    pub(super) operator: Channel,
    pub(super) orders: u64,
    /// Time since its take-off, s; `None` before it.
    pub(super) flown_s: Option<f64>,
    /// The links that a cut ever affects, by the sender's id, and the delays that events add.
    links: Vec<Link>,
    delays: AddedDelays,
    /// Time since take-off before which no event changes what they do, s.
    unchanged_until_s: f64,
}

/// The present effect of events on the messages of one sender to a vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum EventEffect {
    Nothing,
    /// Each message has to be looked at.
    OnEach,
    /// The session is closed: no state arrives, and none is kept for later.
    Closed,
}

impl SwarmReceiver {
    /// The vehicle when its agent begins. `has_events` is whether any event affects a link.
    pub(super) fn new(scenario: &Scenario, own: VehicleId, has_events: bool) -> Self {
        let peers = scenario.ids().filter(|&id| has_events && id != own);
        Self {
            operator: Channel::default(),
            orders: 0,
            flown_s: None,
            links: peers.clone().filter_map(|peer| Link::new(scenario, own, peer)).collect(),
            delays: AddedDelays::new(scenario, own, peers),
            unchanged_until_s: f64::NEG_INFINITY,
        }
    }

    /// The senders whose messages an event ever affects.
    pub(super) fn senders_with_events(&self) -> impl Iterator<Item = VehicleId> {
        self.links.iter().map(Link::peer).chain(self.delays.senders())
    }

    /// Whether no message from this sender arrives now.
    pub(super) fn is_dead(&self, from: VehicleId) -> bool {
        let link = self.links.binary_search_by_key(&from, Link::peer).ok();
        link.is_some_and(|nth| self.links[nth].is_dead())
    }

    /// The delay that events add to a message that arrives now, s; `None` if its link is cut.
    pub(super) fn take(&mut self, from: VehicleId, message: &PeerMessage, now: LocalTime) -> Option<f64> {
        let link = self.links.binary_search_by_key(&from, Link::peer).ok();
        let lets_through =
            link.is_none_or(|nth| self.links[nth].lets_through(&Received { message: *message, at: now }));
        lets_through.then(|| self.delays.s(self.flown_s, from))
    }

    /// The messages that its links have held back and deliver now, each with its sender and the delay that events add, s. `None` if
    /// no event has begun or ended.
    pub(super) fn pass_time(&mut self, now: LocalTime) -> Option<Vec<(VehicleId, Received, f64)>> {
        let Self { links, delays, unchanged_until_s, .. } = self;
        let flown_s = self.flown_s.filter(|flown_s| flown_s >= unchanged_until_s)?;
        let mut held = Vec::new();
        *unchanged_until_s = delays.next_change_s(flown_s);
        for link in links {
            let (from, added_s) = (link.peer(), delays.s(Some(flown_s), link.peer()));
            link.update(flown_s, now, |received| held.push((from, received, added_s)));
            *unchanged_until_s = unchanged_until_s.min(link.next_change_s(flown_s));
        }
        Some(held)
    }

    /// The present effect of events on the messages of each sender that they ever affect.
    pub(super) fn effects(&self) -> impl Iterator<Item = (VehicleId, EventEffect)> {
        self.senders_with_events().map(|from| {
            let link = self.links.binary_search_by_key(&from, Link::peer).ok().and_then(|nth| self.links.get(nth));
            let effect = match link {
                Some(link) if link.is_closed() => EventEffect::Closed,
                Some(link) if !link.is_open() => EventEffect::OnEach,
                _ if self.delays.s(self.flown_s, from) != 0.0 => EventEffect::OnEach,
                _ => EventEffect::Nothing,
            };
            (from, effect)
        })
    }
}
