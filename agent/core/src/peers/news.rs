//! The news of a frame: all that the receivers of a swarm's messages have to look at.

use alloc::vec;
use alloc::vec::Vec;

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::time::LocalTime;

use super::column::Parcel;
use super::peer::AgreementChange;

/// The correct time of an arrival, and the number of the delivery, which orders those of the same time.
pub(super) type Turn = (LocalTime, u64);

/// An arrival at a receiver, which has this index, at this time by its own clock.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arriving {
    pub(super) receiver: VehicleId,
    pub(super) nth: usize,
    pub(super) turn: Turn,
    pub(super) at: LocalTime,
}

/// All that one receiver has received in a frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct News<'a> {
    /// The senders of states and of heartbeats that were accepted.
    pub(super) states: VehicleSet,
    pub(super) heartbeats: VehicleSet,
    /// All that needs more, in the order of arrival.
    pub(super) items: &'a [NewsItem],
}

/// An item of news, with its arrival. When a swarm begins, each vehicle has one of every other: none may be large.
#[derive(Clone, Copy, Debug)]
pub(super) struct NewsItem {
    pub(super) turn: Turn,
    pub(super) receiver: u8,
    pub(super) item: Item,
}

/// The content of an item.
#[derive(Clone, Copy, Debug)]
pub(super) enum Item {
    /// The sender has begun a new incarnation.
    Restarted(VehicleId),
    /// A heartbeat that was accepted ([`super::SwarmInbox::heartbeat_of`]), and what of its sender's agreement state it changes.
    Heartbeat(Parcel, AgreementChange),
    /// A message that was dropped because a newer one had been received.
    Old(VehicleId),
    /// The liveliness token of a vehicle appeared or vanished.
    Token(VehicleId, bool),
    /// An operator's order, by its number in the frame ([`super::SwarmInbox::order`]).
    Order(u16),
}

/// The news of all receivers in a frame.
#[derive(Clone, Debug, Default)]
pub(super) struct AllNews {
    /// The senders of accepted states and heartbeats, for each receiver.
    pub(super) states: Vec<VehicleSet>,
    pub(super) heartbeats: Vec<VehicleSet>,
    /// By receiver once they are sorted.
    items: Vec<NewsItem>,
}

impl AllNews {
    /// No news for so many receivers.
    pub(super) fn new(receivers: usize) -> Self {
        let sets = vec![VehicleSet::default(); receivers];
        Self { states: sets.clone(), heartbeats: sets, items: Vec::new() }
    }

    /// Forgets the news of the last frame.
    pub(super) fn begin_frame(&mut self) {
        let Self { states, heartbeats, items } = self;
        items.clear();
        // The first frames have much more news than all others.
        items.shrink_to(4 * states.len());
        [states, heartbeats].into_iter().for_each(|sets| sets.fill(VehicleSet::default()));
    }

    /// Adds an item for a receiver.
    pub(super) fn add(&mut self, Arriving { nth, turn, .. }: Arriving, item: Item) {
        self.items.push(NewsItem { turn, receiver: nth as u8, item });
    }

    /// Notes a sender in the sets of these receivers.
    pub(super) fn note_all(sets: &mut [VehicleSet], sender: VehicleId, receivers: VehicleSet) {
        receivers.runs().for_each(|run| sets[run].iter_mut().for_each(|senders| senders.insert(sender)));
    }

    /// Orders the items by receiver and arrival.
    pub(super) fn sort(&mut self) {
        // A new incarnation begins before the message that shows it.
        let order = |news: &NewsItem| (news.receiver, news.turn, !matches!(news.item, Item::Restarted(_)));
        self.items.sort_unstable_by_key(order);
    }

    /// Forgets the news of a receiver.
    pub(super) fn forget(&mut self, nth: usize) {
        (self.states[nth], self.heartbeats[nth]) = Default::default();
        self.items.retain(|item| usize::from(item.receiver) != nth);
    }

    /// The news of a receiver, once they are sorted.
    pub(super) fn of(&self, nth: usize) -> News<'_> {
        let begin = self.items.partition_point(|item| usize::from(item.receiver) < nth);
        let count = self.items[begin..].partition_point(|item| usize::from(item.receiver) == nth);
        let items = &self.items[begin..begin + count];
        News { states: self.states[nth], heartbeats: self.heartbeats[nth], items }
    }
}
