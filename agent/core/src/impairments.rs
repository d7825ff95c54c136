//! Network impairments of one receiving agent: lost, delayed, duplicated or reordered messages, links that are narrow,
//! cut or out of range, and states that `network.graph` withholds.
//!
//! The impairments are applied at each receiver, so that the same [`Impairments`] provides a study's network and, between Zenoh
//! and the agent, the faults of a real one. All randomness comes from the scenario's seed. A study of a whole swarm draws the same for
//! all receivers at once ([`SwarmNetwork`]).
//!
//! * Each direction of a link has its own impairments (`channel`); those that depend on positions or on the graph are
//!   added per receiver (`channels`).
//! * States, heartbeats and orders suffer all of them. Liveliness tokens suffer only the link's `delay_s`: Zenoh
//!   repeats them in order. An operator has no position, so an operator's orders suffer the settings of `[network]` for
//!   every link.
//! * A cut silences directions of links and ends sessions, as described in `link.rs`.
//! * A delay added by an event applies last, on top of the link's.

mod channel;
mod channels;
mod cuts;
mod draw;
mod link;
mod numbers;
mod strangers;
mod swarm;

use alloc::boxed::Box;
use alloc::collections::VecDeque;
use alloc::vec::Vec;
use core::ops::Range;

use skein_common::frame::PositionNed;
use skein_common::id::VehicleId;
use skein_common::message::{MessageOrder, PeerAge};
use skein_common::scenario::Scenario;
use skein_common::time::LocalTime;

use crate::peers::{PeerMessage, Received, ReceivedState};
use channels::ReceiverChannels;
pub use cuts::{delays, lasting, silences, union};
use link::{Link, LinkEnd};
pub use strangers::StrangerNetwork;
pub use swarm::SwarmNetwork;

/// The network impairments of one receiving agent; by default there are none.
#[derive(Clone, Debug, Default)]
pub struct Impairments {
    delay_s: f64,
    /// Per-link impairments; `None` if all links have only the same delay.
    channels: Option<Box<ReceiverChannels>>,
    /// The links that a cut ever affects, by the other end's id.
    links: Vec<Link>,
    delays: AddedDelays,
    /// Time since the own take-off, s; `None` before it.
    flown_s: Option<f64>,
    /// Messages in flight, the earliest arrival first.
    in_flight: VecDeque<InFlight>,
    /// Latency of the newest state of each sender, by id.
    latencies: Vec<StateLatency>,
    delivery_counts: DeliveryCounts,
}

/// Delays that events add, by sender: when, in s after the own take-off, and how much, s.
#[derive(Clone, Debug, Default)]
struct AddedDelays(Vec<(VehicleId, (Range<f64>, f64))>);

/// The receiver's data on which impairments depend.
#[derive(Clone, Copy, Debug, Default)]
pub struct ReceiverPosition {
    /// Time since its take-off, s, the clock of the cuts; `None` before it.
    pub flown_s: Option<f64>,
    /// Its estimated position.
    pub position: Option<PositionNed>,
}

/// Counts of all messages by their delivery. A network without impairments counts nothing.
///
/// `offered + duplicated` always equals `outside_graph + queue_full + out_of_range + lost + cut + received` plus the
/// messages in flight.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeliveryCounts {
    /// Messages offered to the network, including those repeated by a link after a cut.
    pub offered: u64,
    /// Copies made by the network.
    pub duplicated: u64,
    /// States withheld from this vehicle by `network.graph`.
    pub outside_graph: u64,
    /// Messages dropped because they would have waited too long for the bandwidth.
    pub queue_full: u64,
    /// Messages lost by distance.
    pub out_of_range: u64,
    /// Messages lost at random.
    pub lost: u64,
    /// Messages stopped by a cut; the newest may be repeated later.
    pub cut: u64,
    /// Messages delivered, copies included.
    pub received: u64,
}

/// The delivery of one message.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Delivery {
    OutsideGraph,
    QueueFull,
    OutOfRange,
    Lost,
    Arrives {
        at: LocalTime,
        /// Arrival of the copy, if there is one.
        copy_at: Option<LocalTime>,
    },
}

/// A message in flight.
#[derive(Clone, Copy, Debug)]
struct InFlight {
    /// The message with its time of arrival.
    received: Received,
    sent_at: LocalTime,
}

/// Latency of a sender's newest state.
#[derive(Clone, Copy, Debug)]
struct StateLatency {
    sender: VehicleId,
    newest: MessageOrder,
    by_s: f64,
}

impl Impairments {
    /// The impairments of vehicle `own` at the start of its agent.
    pub fn new(scenario: &Scenario, own: VehicleId) -> Self {
        let peers = scenario.ids().filter(|&id| id != own);
        let delays = AddedDelays::new(scenario, own, peers.clone());
        Self {
            delay_s: scenario.network.delay_s,
            channels: ReceiverChannels::new(scenario, own).map(Box::new),
            delays,
            links: peers.filter_map(|peer| LinkEnd::new(scenario, own, peer)).map(Link::new).collect(),
            ..Self::default()
        }
    }

    /// Appends to `out` the messages received by `now`, in the order of their arrival. `arriving` contains what an
    /// ideal network delivers, with the times of arrival.
    pub fn receive(
        &mut self,
        now: LocalTime,
        own: ReceiverPosition,
        arriving: impl IntoIterator<Item = Received>,
        out: &mut Vec<Received>,
    ) {
        if self.is_perfect() {
            out.extend(arriving);
            return;
        }
        if let Some(channels) = &mut self.channels {
            channels.update(now, own.position);
        }
        self.flown_s = own.flown_s;
        self.pass_time(now, own.flown_s);
        for received in arriving {
            self.delivery_counts.offered += 1;
            match self.fate(&received) {
                Delivery::OutsideGraph => self.delivery_counts.outside_graph += 1,
                Delivery::QueueFull => self.delivery_counts.queue_full += 1,
                Delivery::OutOfRange => self.delivery_counts.out_of_range += 1,
                Delivery::Lost => self.delivery_counts.lost += 1,
                Delivery::Arrives { .. } if !self.gets_through(&received) => self.delivery_counts.cut += 1,
                Delivery::Arrives { at, copy_at } => {
                    let delay_s = received.message.sender().map_or(0.0, |sender| self.added_delay_s(sender));
                    send(&mut self.in_flight, received, at.plus_seconds(delay_s));
                    if let Some(copy_at) = copy_at {
                        self.delivery_counts.duplicated += 1;
                        send(&mut self.in_flight, received, copy_at.plus_seconds(delay_s));
                    }
                }
            }
        }
        self.deliver(now, out);
    }

    /// Counts of all messages by their delivery.
    pub fn delivery_counts(&self) -> DeliveryCounts {
        self.delivery_counts
    }

    /// Whether the scenario has no impairments for this vehicle.
    pub fn is_perfect(&self) -> bool {
        self.delay_s == 0.0 && self.links.is_empty() && self.delays.0.is_empty() && self.channels.is_none()
    }

    /// Writes the delivery latency of each peer's newest state to `peers`.
    pub fn report_latency(&self, peers: &mut [PeerAge]) {
        for peer in peers {
            if let Ok(index) = self.late(peer.id) {
                peer.delivered_age_s = self.latencies[index].by_s;
            }
        }
    }

    /// Sends the messages that links repeat after a cut.
    fn pass_time(&mut self, now: LocalTime, flown_s: Option<f64>) {
        let Self { links, delays, in_flight, channels, delivery_counts, .. } = self;
        let Some(flown_s) = flown_s else { return };
        for link in links {
            let delay_s = channels.as_ref().map_or(self.delay_s, |channels| channels.delay_s(link.peer()))
                + delays.s(Some(flown_s), link.peer());
            link.update(flown_s, now, |received| {
                delivery_counts.offered += 1;
                send(in_flight, received, now.plus_seconds(delay_s));
            });
        }
    }

    /// The delay that events add to messages from this sender now, s.
    fn added_delay_s(&self, sender: VehicleId) -> f64 {
        self.delays.s(self.flown_s, sender)
    }

    fn fate(&mut self, received: &Received) -> Delivery {
        let is_cut =
            self.channels.is_some() && self.link(&received.message).is_some_and(|index| self.links[index].is_dead());
        if let Some(channels) = &mut self.channels {
            return channels.fate(received, is_cut);
        }
        Delivery::Arrives { at: received.at.plus_seconds(self.delay_s), copy_at: None }
    }

    fn gets_through(&mut self, received: &Received) -> bool {
        self.link(&received.message).is_none_or(|index| self.links[index].lets_through(received))
    }

    /// The affected link that a message arrives on. An operator's messages have none.
    fn link(&self, message: &PeerMessage) -> Option<usize> {
        self.links.binary_search_by_key(&message.sender()?, Link::peer).ok()
    }

    fn deliver(&mut self, now: LocalTime, out: &mut Vec<Received>) {
        while let Some(InFlight { received, sent_at }) =
            self.in_flight.pop_front_if(|message| message.received.at <= now)
        {
            self.delivery_counts.received += 1;
            if let PeerMessage::State(state) = &received.message {
                self.note(state, received.at.seconds_since(sent_at));
            }
            out.push(received);
        }
    }

    /// Records the latency of a state if it is the newest of its sender.
    fn note(&mut self, state: &ReceivedState, by_s: f64) {
        let newest = state.header.order();
        let late = StateLatency { sender: state.header.sender, newest, by_s };
        match self.late(late.sender) {
            Ok(index) if self.latencies[index].newest < newest => self.latencies[index] = late,
            Ok(_) => {}
            Err(index) => self.latencies.insert(index, late),
        }
    }

    fn late(&self, sender: VehicleId) -> Result<usize, usize> {
        self.latencies.binary_search_by_key(&sender, |late| late.sender)
    }
}

impl AddedDelays {
    /// The added delays of messages from these senders to vehicle `own`.
    fn new(scenario: &Scenario, own: VehicleId, senders: impl Iterator<Item = VehicleId>) -> Self {
        let of = |sender| delays(&scenario.mission.events, sender, own).into_iter().map(move |delay| (sender, delay));
        Self(senders.flat_map(of).collect())
    }

    /// The senders whose messages are ever delayed.
    fn senders(&self) -> impl Iterator<Item = VehicleId> {
        self.0.iter().map(|(sender, _)| *sender)
    }

    /// The next time after `flown_s` at which a delay begins or ends, s after take-off; infinite if none does.
    fn next_change_s(&self, flown_s: f64) -> f64 {
        let changes = self.0.iter().flat_map(|(_, (lasting, _))| [lasting.start, lasting.end]);
        changes.filter(|at_s| *at_s > flown_s).fold(f64::INFINITY, f64::min)
    }

    /// The delay added to messages from this sender now, s.
    fn s(&self, flown_s: Option<f64>, sender: VehicleId) -> f64 {
        let lasts = |lasting: &Range<f64>| flown_s.is_some_and(|t_s| lasting.contains(&t_s));
        let first = self.0.partition_point(|(id, _)| *id < sender);
        let of_sender = self.0[first..].iter().take_while(|(id, _)| *id == sender);
        of_sender.filter(|(_, (lasting, _))| lasts(lasting)).map(|(_, (_, delay_s))| delay_s).sum()
    }
}

/// Puts a message in flight, behind those that arrive no later.
fn send(in_flight: &mut VecDeque<InFlight>, sent: Received, at: LocalTime) {
    let place = in_flight.partition_point(|earlier| earlier.received.at <= at);
    in_flight.insert(place, InFlight { received: Received { at, ..sent }, sent_at: sent.at });
}

#[cfg(test)]
mod tests;
