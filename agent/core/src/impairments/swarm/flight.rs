//! Messages of a swarm on their way, each with its receivers and their times.

use alloc::sync::Arc;
use alloc::vec;
use alloc::vec::Vec;

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::Order;
use skein_common::time::LocalTime;

use super::nth;
use crate::peers::{Arrival, Parcel, SwarmInbox};

/// A message on its way to these receivers, of which it reaches each at its time.
#[derive(Clone, Debug)]
pub(super) struct OnItsWay {
    pub(super) serial: u64,
    pub(super) what: Content,
    pub(super) receivers: VehicleSet,
    pub(super) at: Arrivals,
}

#[derive(Clone, Debug)]
pub(super) enum Content {
    Parcel(Parcel),
    Token(VehicleId, bool),
    /// Shared, because it is much larger than the others and seldom sent.
    Order(Arc<Order>),
}

#[derive(Clone, Debug)]
pub(super) enum Arrivals {
    Together(Arrival),
    /// In the order of the receivers' ids.
    Each(Vec<LocalTime>),
}

impl OnItsWay {
    pub(super) fn at(&self, receiver: VehicleId) -> LocalTime {
        match &self.at {
            Arrivals::Together(arrival) => arrival.at(nth(receiver)),
            Arrivals::Each(all) => all[self.receivers.count_below(receiver)],
        }
    }

    /// A time by which it has reached all of its receivers.
    pub(super) fn last_at(&self) -> LocalTime {
        match &self.at {
            Arrivals::Together(arrival) => arrival.last_at(),
            Arrivals::Each(all) => all.iter().copied().max().unwrap_or(LocalTime::ZERO),
        }
    }

    pub(super) fn remove(&mut self, receiver: VehicleId) {
        if !self.receivers.contains(receiver) {
            return;
        }
        if let Arrivals::Each(all) = &mut self.at {
            all.remove(self.receivers.count_below(receiver));
        }
        self.receivers.remove(receiver);
    }
}

/// The deliveries of one message to single receivers, each with the end of the frame in which it is due, ns.
#[derive(Clone, Debug)]
pub(super) struct Batch {
    frame_ns: u64,
    pub(super) due: Vec<(OnItsWay, u64)>,
    /// Memory of messages that have arrived.
    spare: Vec<Vec<LocalTime>>,
}

impl Batch {
    /// An empty batch for frames of this length, ns.
    pub(super) fn new(frame_ns: u64) -> Self {
        Self { frame_ns, due: Vec::new(), spare: Vec::new() }
    }

    /// Adds a receiver of the delivery with this number; the receivers of one delivery follow each other in the order of ids.
    pub(super) fn add(&mut self, (serial, what): (u64, &Content), receiver: VehicleId, at: LocalTime) {
        let (frame_ns, at_ns) = (self.frame_ns, at.nanoseconds());
        let is_due = |end_ns: u64| at_ns <= end_ns && end_ns < at_ns + frame_ns;
        let begun = self.due.iter_mut().find(|(message, end_ns)| message.serial == serial && is_due(*end_ns));
        match begun {
            Some((OnItsWay { receivers, at: Arrivals::Each(all), .. }, _)) => {
                receivers.insert(receiver);
                all.push(at);
            }
            _ => {
                let mut all = self.spare.pop().unwrap_or_default();
                all.push(at);
                let (receivers, at) = ([receiver].into_iter().collect(), Arrivals::Each(all));
                self.due.push((
                    OnItsWay { serial, what: what.clone(), receivers, at },
                    at_ns.div_ceil(frame_ns) * frame_ns,
                ));
            }
        }
    }

    /// Takes the memory of messages that have arrived.
    pub(super) fn recycle(&mut self, arrived: Vec<OnItsWay>) {
        for message in arrived {
            if let Arrivals::Each(mut each) = message.at {
                each.clear();
                self.spare.push(each);
            }
        }
    }
}

/// By [`SwarmInbox::place`], the receivers that receive two messages of a place in one frame: to them the order of arrival matters.
pub(super) fn received_twice(due: &[OnItsWay], inbox: &SwarmInbox, count: usize) -> Vec<VehicleSet> {
    let mut once = vec![VehicleSet::default(); SwarmInbox::PLACES * count];
    let mut twice = once.clone();
    for OnItsWay { what, receivers, .. } in due {
        let Content::Parcel(parcel) = what else { continue };
        let place = inbox.place(*parcel);
        let (once, twice) = (&mut once[place], &mut twice[place]);
        twice.extend(once.both(*receivers));
        once.extend(*receivers);
    }
    twice
}
