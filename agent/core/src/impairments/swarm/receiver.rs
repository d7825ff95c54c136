//! The vehicles of a swarm as receivers.

use alloc::vec::Vec;
use core::ops::Range;

use skein_common::id::VehicleId;
use skein_common::scenario::Scenario;

use super::super::AddedDelays;
use super::super::channel::Channel;
use super::super::link::{LinkEnd, NEVER, SessionChange};

/// A vehicle as a receiver.
#[derive(Clone, Debug)]
pub(super) struct SwarmReceiver {
    /// The channel for orders from operators, and their number so far.
    pub(super) operator: Channel,
    pub(super) orders: u64,
    /// Time since its take-off, s; `None` before it.
    pub(super) flown_s: Option<f64>,
    /// The links that a cut ever affects, by the sender's id, and the delays that events add.
    links: Vec<LinkEnd>,
    delays: AddedDelays,
    /// The time in which no event begins or ends, s after its take-off.
    unchanged_s: Range<f64>,
}

/// The present effect of events on the messages of one sender to a vehicle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct EventEffect {
    /// No position of the sender becomes known.
    pub(super) is_dead: bool,
    /// States and heartbeats are held back.
    pub(super) is_cut: bool,
    /// The session is closed: no state is kept for later.
    pub(super) is_closed: bool,
    /// They arrive later.
    pub(super) is_delayed: bool,
}

impl SwarmReceiver {
    /// The vehicle when its agent begins. `has_events` is whether any event affects a link.
    pub(super) fn new(scenario: &Scenario, own: VehicleId, has_events: bool) -> Self {
        let peers = scenario.ids().filter(|&id| has_events && id != own);
        Self {
            operator: Channel::default(),
            orders: 0,
            flown_s: None,
            links: peers.clone().filter_map(|peer| LinkEnd::new(scenario, own, peer)).collect(),
            delays: AddedDelays::new(scenario, own, peers),
            unchanged_s: NEVER,
        }
    }

    /// Begins again, with its agent.
    pub(super) fn begin_again(&mut self) {
        (self.operator, self.orders, self.flown_s) = (Channel::default(), 0, None);
        self.links.iter_mut().for_each(LinkEnd::begin_again);
        self.unchanged_s = NEVER;
    }

    /// The senders whose messages an event ever affects.
    pub(super) fn senders_with_events(&self) -> impl Iterator<Item = VehicleId> {
        self.links.iter().map(LinkEnd::peer).chain(self.senders_with_delays())
    }

    /// The senders whose messages an event ever delays.
    pub(super) fn senders_with_delays(&self) -> impl Iterator<Item = VehicleId> {
        self.delays.senders()
    }

    /// Notes that the token of a sender appeared or vanished. Returns whether its agent learns of it.
    pub(super) fn note_token(&mut self, from: VehicleId, is_there: bool) -> bool {
        let link = self.links.binary_search_by_key(&from, LinkEnd::peer).ok();
        link.is_none_or(|nth| self.links[nth].note_token(is_there))
    }

    /// The delay that events add to a message that is sent now, s.
    pub(super) fn added_s(&self, from: VehicleId) -> f64 {
        self.delays.s(self.flown_s, from)
    }

    /// Whether an event has begun or ended.
    pub(super) fn has_changes(&self) -> bool {
        self.flown_s.is_some_and(|flown_s| !self.unchanged_s.contains(&flown_s))
    }

    /// Passes the time to now; calls `on_change` with each sender whose session has changed.
    pub(super) fn pass_time(&mut self, mut on_change: impl FnMut(VehicleId, SessionChange)) {
        let Some(flown_s) = self.flown_s else { return };
        let mut until_s = self.delays.next_change_s(flown_s);
        for link in &mut self.links {
            if let Some(change) = link.update(flown_s) {
                on_change(link.peer(), change);
            }
            until_s = until_s.min(link.next_change_s());
        }
        self.unchanged_s = flown_s..until_s;
    }

    /// The present effect of events on the messages of a sender.
    pub(super) fn effect(&self, from: VehicleId) -> EventEffect {
        let link = self.links.binary_search_by_key(&from, LinkEnd::peer).ok().and_then(|nth| self.links.get(nth));
        EventEffect {
            is_dead: link.is_some_and(LinkEnd::is_dead),
            is_cut: link.is_some_and(|link| !link.lets_through()),
            is_closed: link.is_some_and(LinkEnd::is_closed),
            is_delayed: self.added_s(from) != 0.0,
        }
    }
}
