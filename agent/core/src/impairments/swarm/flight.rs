//! Messages of a swarm on their way, each with its receivers and their times.

use alloc::sync::Arc;
use alloc::vec;
use alloc::vec::Vec;

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::Order;
use skein_common::time::LocalTime;

use crate::impairments::draw::share;
use crate::peers::{Parcel, SwarmInbox};

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
    Alike(LocalTime),
    /// In the order of the receivers' ids.
    Each(Vec<LocalTime>),
    Spread(Arc<Spread>),
}

/// The times at which a message reaches receivers that differ in its random delay alone.
#[derive(Clone, Debug)]
pub(super) struct Spread {
    pub(super) sent_at: LocalTime,
    pub(super) delay_s: f64,
    pub(super) jitter_s: f64,
    /// The random numbers of the delay, each at the place of its receiver's id.
    pub(super) numbers: Vec<u32>,
}

impl Spread {
    /// The time at which the message reaches a receiver with this random number: the larger the number, the later.
    #[inline]
    fn at_number(&self, number: u32) -> LocalTime {
        self.sent_at.plus_seconds(self.delay_s + share(number) * self.jitter_s)
    }

    #[inline]
    pub(super) fn at(&self, receiver: VehicleId) -> LocalTime {
        self.at_number(self.numbers[usize::from(receiver.get())])
    }

    /// The earliest and the latest time at which it can reach a receiver.
    pub(super) fn limits(&self) -> [LocalTime; 2] {
        [0, u32::MAX].map(|number| self.at_number(number))
    }

    /// The least random number with which it reaches a receiver after this time, or 2³².
    pub(super) fn numbers_until(&self, time: LocalTime) -> u64 {
        let (mut least, mut most) = (0_u64, 1 << 32);
        while least < most {
            let middle = least.midpoint(most);
            if self.at_number(middle as u32) <= time {
                least = middle + 1;
            } else {
                most = middle;
            }
        }
        least
    }
}

impl OnItsWay {
    pub(super) fn at(&self, receiver: VehicleId) -> LocalTime {
        match &self.at {
            Arrivals::Alike(at) => *at,
            Arrivals::Each(all) => all[self.receivers.count_below(receiver)],
            Arrivals::Spread(spread) => spread.at(receiver),
        }
    }

    /// A time by which it has reached all of its receivers.
    pub(super) fn last_at(&self) -> LocalTime {
        match &self.at {
            Arrivals::Alike(at) => *at,
            Arrivals::Each(all) => all.iter().copied().max().unwrap_or(LocalTime::ZERO),
            Arrivals::Spread(spread) => spread.limits()[1],
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
