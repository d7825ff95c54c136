//! The vehicles of a swarm as senders.

use alloc::vec;
use alloc::vec::Vec;

use skein_common::frame::PositionNed;
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::scenario::Quality;
use skein_common::time::LocalTime;

use super::super::channel::Channel;
use super::receiver::EventEffect;

/// A vehicle as a sender.
#[derive(Clone, Debug, Default)]
pub(super) struct SwarmSender {
    /// Its place as last reported.
    pub(super) place: Option<Place>,
    /// The receivers that know a place of it, and those among them that know an older one than the last, each with that: their
    /// link was dead when the later ones were reported.
    pub(super) placed: VehicleSet,
    pub(super) with_older_place: VehicleSet,
    older_places: Vec<(VehicleId, Place)>,
    /// The receivers to which its links have settings of their own.
    pub(super) particular: Vec<(VehicleId, Quality)>,
    pub(super) with_particular: VehicleSet,
    /// The receivers to which events ever cut or delay its messages, and those with each present effect ([`EventEffect`]).
    pub(super) with_events: VehicleSet,
    pub(super) dead: VehicleSet,
    pub(super) cut: VehicleSet,
    pub(super) closed: VehicleSet,
    pub(super) delayed: VehicleSet,
    /// The state of the links to all receivers, by id; empty if they have none.
    pub(super) channels: Vec<Channel>,
    in_burst: InBurst,
}

/// A reported position, and the time of the report.
pub(super) type Place = (PositionNed, LocalTime);

/// The links in a burst of losses, among those that have the settings of all links.
#[derive(Clone, Debug, Default)]
struct InBurst {
    receivers: VehicleSet,
    /// For each [`Self::BLOCK`] of links, a time before which no burst begins or ends.
    unchanged_until: Vec<LocalTime>,
}

impl InBurst {
    /// Number of links that are looked at together.
    const BLOCK: usize = 16;
}

impl SwarmSender {
    /// A sender of which nothing is known, whose links to these receivers have settings of their own, by id.
    pub(super) fn new(particular: Vec<(VehicleId, Quality)>) -> Self {
        let with_particular = particular.iter().map(|(id, _)| *id).collect();
        Self { particular, with_particular, ..Self::default() }
    }

    /// The place that a receiver knows.
    pub(super) fn place_known_to(&self, receiver: VehicleId) -> Option<Place> {
        if self.with_older_place.contains(receiver) {
            return self.older_places.iter().find(|(id, _)| *id == receiver).map(|(_, place)| *place);
        }
        self.place.filter(|_| self.placed.contains(receiver))
    }

    /// Reports a place to these receivers, but not over dead links. Returns whether any of them learns of a place otherwise than by
    /// the way from the last one.
    pub(super) fn report_place(&mut self, place: Place, receivers: VehicleSet, over_dead_links: VehicleSet) -> bool {
        for id in over_dead_links.both(self.placed).without(self.with_older_place).iter() {
            self.older_places.extend(self.place.map(|place| (id, place)));
            self.with_older_place.insert(id);
        }
        let learning = receivers.without(over_dead_links);
        let had_older = learning.both(self.with_older_place);
        let is_new = !learning.without(self.placed).is_empty() || !had_older.is_empty();
        self.forget_place(had_older);
        self.placed.extend(learning);
        self.place = Some(place);
        is_new
    }

    /// Makes these receivers know no place of it.
    pub(super) fn forget_place(&mut self, receivers: VehicleSet) {
        self.placed = self.placed.without(receivers);
        self.with_older_place = self.with_older_place.without(receivers);
        self.older_places.retain(|(id, _)| !receivers.contains(*id));
    }

    /// Notes what events do now to its messages to a receiver.
    pub(super) fn note_effect(&mut self, receiver: VehicleId, effect: EventEffect) {
        let EventEffect { is_dead, is_cut, is_closed, is_delayed } = effect;
        self.dead.set(receiver, is_dead);
        self.cut.set(receiver, is_cut);
        self.closed.set(receiver, is_closed);
        self.delayed.set(receiver, is_delayed);
    }

    /// Makes room for the state of the links to vehicles 1 to `count`.
    pub(super) fn remember_links(&mut self, count: usize) {
        self.channels = vec![Channel::default(); count + 1];
        self.in_burst.unchanged_until = vec![LocalTime::ZERO; count.div_ceil(InBurst::BLOCK)];
    }

    /// Forgets the state of the link to a receiver.
    pub(super) fn forget_link(&mut self, receiver: VehicleId) {
        let nth = usize::from(receiver.get());
        if let Some(channel) = self.channels.get_mut(nth) {
            *channel = Channel::default();
            self.in_burst.unchanged_until[(nth - 1) / InBurst::BLOCK] = LocalTime::ZERO;
        }
    }

    /// The receivers to which links with these settings, which are those of all links, are in a burst now. `chance` gives the
    /// numbers of the link to a receiver by their place.
    pub(super) fn in_burst(
        &mut self,
        quality: &Quality,
        now: LocalTime,
        chance: impl Fn(VehicleId, u64) -> f64,
    ) -> VehicleSet {
        let Self { channels, in_burst: InBurst { receivers, unchanged_until }, with_particular, .. } = self;
        let mut ids = VehicleId::first(channels.len().saturating_sub(1));
        let blocks = channels.get_mut(1..).unwrap_or_default().chunks_mut(InBurst::BLOCK);
        for (links, unchanged_until) in blocks.zip(unchanged_until) {
            let ids = ids.by_ref().take(links.len());
            if now < *unchanged_until {
                ids.for_each(drop);
                continue;
            }
            *unchanged_until = LocalTime::MAX;
            for (link, id) in links.iter_mut().zip(ids) {
                if !with_particular.contains(id) {
                    receivers.set(id, link.is_in_burst(quality, now, |nth| chance(id, nth)) == Some(true));
                    *unchanged_until = link.burst_until().min(*unchanged_until);
                }
            }
        }
        *receivers
    }
}
