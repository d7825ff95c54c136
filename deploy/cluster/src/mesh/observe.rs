//! Receives, decodes and verifies what the vehicles of a live swarm send. `fly`, `order`, `record`, `view` and `cluster`
//! use it. An observer is never in the control loop: the swarm flies the same with and without it.

mod rate;
mod teams;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Instant;

use skein_agent::link::presence::{Change, Presence};
use skein_agent::link::signature::messages::KeyRing;
use skein_agent::link::signature::orders::{self, Checker};
use skein_agent::link::{LinkError, Sessions};
use skein_common::id::VehicleId;
use skein_common::message::{
    self, Event, Health, Heartbeat, Message, Order, Reason, Severity, StandingOrders, Summary, Trace, VehicleFacts,
};
use skein_common::state::Membership;
use skein_common::topic::{self, Author, Branch, Topic};
use zenoh::Wait;
use zenoh::pubsub::Subscriber;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::{Locality, Sample};

use crate::mesh::reach::Reach;
pub use rate::Rate;
use skein_host::clock;
use skein_lab::error::Error;
pub use teams::Observers;

/// Capacity of the queue of received messages: two seconds of 250 vehicles. Further messages are dropped and counted.
const QUEUE: usize = 25_000;

/// A message from a vehicle, or a change of its presence.
#[derive(Clone, Debug, PartialEq)]
pub enum SwarmMessage {
    /// The trace of one control step.
    Trace(Trace),
    /// The vehicle's own view of itself, at most ten times a second.
    Summary(Summary),
    /// The vehicle's health report.
    Health(Health),
    /// The vehicle's heartbeat, which carries its agreement state.
    Mission(Heartbeat),
    /// An event that the vehicle reports.
    Event(Event),
    /// The vehicle's agent has appeared on the network.
    Appeared(VehicleId),
    /// The vehicle's agent has left the network.
    Vanished(VehicleId),
}

impl SwarmMessage {
    /// The note that a recording has of a change of a vehicle's presence: its severity, which vehicle, and what changed.
    pub fn note(&self) -> Option<(Severity, String, &'static str)> {
        match self {
            Self::Appeared(id) => Some((Severity::Info, format!("vehicle {id}"), "its agent has appeared")),
            Self::Vanished(id) => Some((Severity::Error, format!("vehicle {id}"), "its agent has disappeared")),
            _ => None,
        }
    }
}

/// A received message with its run and its time of arrival.
struct ReceivedMessage {
    received: SwarmMessage,
    /// The run that the sender signed the message for.
    run: Option<u64>,
    at: Instant,
}

/// The newest data received from one vehicle.
#[derive(Clone, Debug, Default)]
pub struct VehicleView {
    /// Whether the vehicle's agent is on the network: by its liveliness token, or by its link where links are secured.
    pub alive: bool,
    /// The run that the vehicle flies in, where messages are signed.
    pub run: Option<u64>,
    /// The newest trace.
    pub trace: Option<Trace>,
    /// Time of arrival of the newest trace.
    pub trace_at: Option<Instant>,
    /// The newest summary.
    pub summary: Option<Summary>,
    /// Time of arrival of the newest summary.
    pub summary_at: Option<Instant>,
    /// The newest health report.
    pub health: Option<Health>,
    /// Time of arrival of the newest health report.
    pub health_at: Option<Instant>,
    /// The run that the health report was signed for, where messages are signed.
    pub health_run: Option<u64>,
    /// The newest heartbeat, which carries the vehicle's agreement state.
    pub mission: Option<Heartbeat>,
    /// The orders that the vehicle has repeated in this incarnation and run, if an operator issued them: where orders are
    /// signed, the order's signature must be valid for the run that the vehicle flies in.
    pub orders: StandingOrders,
}

impl VehicleView {
    /// Whether the vehicle is an active member of the swarm, or was one, by its newest trace.
    pub fn is_active(&self) -> bool {
        self.trace.as_ref().is_some_and(|trace| trace.membership != Membership::Joining)
    }

    /// Forgets the summary of a vehicle in contact, which sends a new one. That of a vehicle that is gone is the last.
    fn forget_summary(&mut self) {
        if self.alive {
            (self.summary, self.summary_at) = (None, None);
        }
    }

    /// Notes that the vehicle vanished while no summaries were received: it was not silent before.
    fn vanish(&mut self, at: Instant) {
        self.summary_at = self.summary_at.map(|summary_at| summary_at.max(at));
    }

    /// The facts of the vehicle by its newest trace or summary, whichever arrived last, and the time of arrival.
    pub fn newest(&self) -> Option<(VehicleFacts, Instant)> {
        let traced = self.trace.as_ref().zip(self.trace_at);
        let summarised = self.summary.as_ref().zip(self.summary_at);
        match (traced, summarised) {
            (Some((trace, at)), summary) if summary.is_none_or(|(_, later)| later < at) => {
                Some((trace.facts(self.health.as_ref()), at))
            }
            // Before a vehicle has estimated its position there is nothing to show of it.
            (_, summary) => {
                let located = summary.filter(|(summary, _)| summary.facts.position.is_some());
                located.map(|(summary, at)| (summary.facts.clone(), at))
            }
        }
    }
}

/// Counts of the messages that were dropped.
#[derive(Debug, Default)]
struct Dropped {
    undecodable: AtomicU64,
    forged: AtomicU64,
    overflow: AtomicU64,
    /// Links that were refused.
    links: AtomicU64,
}

/// Receives the messages of one swarm and keeps the newest of each vehicle.
pub struct Observer {
    sessions: Sessions,
    inbox: Receiver<ReceivedMessage>,
    receiver: SwarmReceiver,
    _subscribers: Vec<Subscriber<()>>,
    /// The subscription to the vehicles' traces, if there is one.
    traces: Option<Subscriber<()>>,
    /// The subscription to the vehicles' summaries, if there is one.
    summaries: Option<Subscriber<()>>,
    vehicles: BTreeMap<VehicleId, VehicleView>,
    reach: Reach,
    /// Verifies that an order was signed by an operator, where orders are signed.
    orders: Option<Checker>,
}

/// The reason why a swarm cannot be observed.
#[derive(Debug, thiserror::Error)]
pub enum ObserveError {
    /// The session could not be opened.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// Zenoh refused a subscription or a publication.
    #[error("cannot listen to the swarm: {0}")]
    Zenoh(#[from] zenoh::Error),
}

impl From<ObserveError> for Error {
    fn from(error: ObserveError) -> Self {
        match &error {
            ObserveError::Link(fault) if fault.is_user_error() => Self::Refused(error.to_string()),
            _ => Self::Failed(error.to_string()),
        }
    }
}

impl Observer {
    /// Connects to this swarm, and subscribes to everything except traces and summaries. Agents that do not answer yet are dialled
    /// again and again.
    ///
    /// # Errors
    /// If a key or certificate is invalid, or Zenoh refuses.
    pub fn open(reach: &Reach) -> Result<Self, ObserveError> {
        let sessions = Sessions::open(&reach.swarm, &[], &reach.all(), &reach.security)?;
        let session = sessions.first();
        let (sender, inbox) = sync_channel(QUEUE);
        let key_ring = reach.security.key_ring(&reach.swarm);
        let (branch, presence) = (reach.branch, sessions.presence());
        let receiver = SwarmReceiver { sender, dropped: Arc::default(), branch, key_ring, presence };
        let subscribers = vec![
            receiver.subscribe(session, topic::all::HEALTH, SwarmMessage::Health)?,
            receiver.subscribe(session, topic::all::MISSIONS, SwarmMessage::Mission)?,
            receiver.subscribe(session, topic::all::EVENTS, SwarmMessage::Event)?,
        ];
        let of_presence = receiver.clone();
        let note = move |change| match change {
            Change::Appeared(id) => of_presence.enqueue(SwarmMessage::Appeared(id), None),
            Change::Vanished(id) => of_presence.enqueue(SwarmMessage::Vanished(id), None),
            Change::Refused(_) => count(&of_presence.dropped.links),
        };
        sessions.presence().watch(&sessions, branch, note)?;
        let orders = reach.orders_key.map(|key| Checker::new(key, reach.swarm.clone(), branch));
        Ok(Self {
            sessions,
            inbox,
            receiver,
            _subscribers: subscribers,
            traces: None,
            summaries: None,
            vehicles: BTreeMap::new(),
            reach: reach.clone(),
            orders,
        })
    }

    /// Subscribes to the vehicles' traces, which have one message for each control step, or ends that subscription. A vehicle
    /// computes, signs and sends its trace only while there is a subscriber.
    ///
    /// # Errors
    /// If Zenoh refuses.
    pub fn subscribe_to_traces(&mut self, wanted: bool) -> Result<(), ObserveError> {
        if wanted != self.traces.is_some() {
            let subscribe = || self.receiver.subscribe(self.sessions.first(), topic::all::TRACES, SwarmMessage::Trace);
            self.traces = wanted.then(subscribe).transpose()?;
        }
        Ok(())
    }

    /// Subscribes to the vehicles' summaries, or ends that subscription. A vehicle computes and sends its summary only while there
    /// is a subscriber. With a new subscription the summaries before an interruption are forgotten: they tell nothing about now, and
    /// their age is no silence of the vehicle.
    ///
    /// # Errors
    /// If Zenoh refuses.
    pub fn subscribe_to_summaries(&mut self, wanted: bool) -> Result<(), ObserveError> {
        if wanted != self.summaries.is_some() {
            let subscribe =
                || self.receiver.subscribe(self.sessions.first(), topic::all::SUMMARIES, SwarmMessage::Summary);
            self.summaries = wanted.then(subscribe).transpose()?;
            self.vehicles.values_mut().filter(|_| wanted).for_each(VehicleView::forget_summary);
        }
        Ok(())
    }

    /// Number of links that this observer or an agent refused, because it does not accept the other's certificate.
    pub fn refused_links(&self) -> u64 {
        self.receiver.dropped.links.load(Relaxed)
    }

    /// Returns the messages received since the last call, in order of arrival, and updates [`Self::vehicles`]. Never
    /// blocks.
    pub fn poll(&mut self) -> Vec<SwarmMessage> {
        self.poll_timed().into_iter().map(|(received, _)| received).collect()
    }

    /// Like [`Self::poll`], with the time of arrival of each message.
    pub fn poll_timed(&mut self) -> Vec<(SwarmMessage, Instant)> {
        let mut all = Vec::new();
        while let Ok(arrival) = self.inbox.try_recv() {
            if self.take(&arrival) {
                all.push((arrival.received, arrival.at));
            }
        }
        all
    }

    /// The newest data of every vehicle that has appeared or sent a message.
    pub fn vehicles(&self) -> &BTreeMap<VehicleId, VehicleView> {
        &self.vehicles
    }

    /// The part of the key space that belongs to the swarm: in a fleet, to one team.
    pub fn branch(&self) -> Branch {
        self.reach.branch
    }

    /// Number of messages dropped: undecodable, forged, or received faster than they were read.
    pub fn dropped(&self) -> u64 {
        let Dropped { undecodable, forged, overflow, links: _ } = &*self.receiver.dropped;
        undecodable.load(Relaxed) + forged.load(Relaxed) + overflow.load(Relaxed)
    }

    /// The run that the swarm flies in, where messages are signed: the run that more than half of the vehicles in
    /// contact report. Without a majority it is the run that this PC began last, if any vehicle reports it, else
    /// `None`.
    pub fn run(&self) -> Option<u64> {
        run_in_flight(self.vehicles.values(), self.reach.own_run)
    }

    /// The newest health report of a vehicle and its time of arrival. `None` unless the vehicle is in contact and sent
    /// the report in its present incarnation and in the run that the swarm flies in.
    pub fn health_of(&self, id: VehicleId) -> Option<(&Health, Instant)> {
        self.health_in(id, self.run())
    }

    fn health_in(&self, id: VehicleId, flown: Option<u64>) -> Option<(&Health, Instant)> {
        let view = self.vehicles.get(&id).filter(|view| view.alive)?;
        let (health, at) = view.health.as_ref().zip(view.health_at)?;
        let is_of_this_life =
            view.mission.is_none_or(|mission| mission.header.incarnation <= health.header.incarnation);
        let is_of_this_run = view.health_run.is_none_or(|run| flown == Some(run));
        (is_of_this_life && is_of_this_run).then_some((health, at))
    }

    /// Keeps what was received. Returns false if the message is older than the kept one.
    fn take(&mut self, arrival: &ReceivedMessage) -> bool {
        let is_news = update(&mut self.vehicles, arrival);
        if let (SwarmMessage::Vanished(id), None) = (&arrival.received, &self.summaries)
            && let Some(view) = self.vehicles.get_mut(id)
        {
            view.vanish(arrival.at);
        }
        if let (SwarmMessage::Mission(heartbeat), true) = (&arrival.received, is_news)
            && let Some(order) = heartbeat.order.filter(|order| self.is_issued(order, arrival.run))
            && let Some(view) = self.vehicles.get_mut(&heartbeat.header.sender)
        {
            view.orders.merge(order);
        }
        is_news
    }

    /// Whether an operator issued this order to a vehicle that flies in this run.
    fn is_issued(&self, order: &Order, run: Option<u64>) -> bool {
        self.orders.as_ref().is_none_or(|orders| orders.is_signed(run.unwrap_or(0), order))
    }

    /// One more than the largest epoch of any order that a vehicle repeats.
    pub fn next_epoch(&self) -> u64 {
        let orders = self.vehicles.values().flat_map(|view| view.orders.iter());
        orders.map(|order| order.epoch).max().unwrap_or(0).saturating_add(1)
    }

    /// The order in the form that vehicles accept: where orders are signed, on an operator's PC, one signed copy for
    /// each run that a vehicle in contact flies in. So a vehicle cannot decide for another one which run is ordered,
    /// and a vehicle in another run than most is not left in the air. A signature for a run that has ended is useless
    /// to an attacker: that run is never joined again.
    pub fn signed(&self, order: Order) -> Vec<Order> {
        let Reach { swarm, branch, signing_key: Some(signing_key), .. } = &self.reach else { return vec![order] };
        let there = self.vehicles.values().filter(|view| view.alive);
        let runs: BTreeSet<u64> = there.filter_map(|view| view.run).filter(|run| *run != 0).collect();
        runs.into_iter().map(|run| orders::sign(signing_key, swarm, *branch, run, order)).collect()
    }

    /// Publishes an order to every agent that can be reached now. An order is a register: publishing it again changes
    /// nothing.
    ///
    /// # Errors
    /// If Zenoh refuses.
    pub fn order(&self, order: &Order) -> Result<(), ObserveError> {
        let key = self.reach.branch.key(&Topic::Order(order.issuer));
        self.signed(*order).iter().try_for_each(|order| {
            let put = self.sessions.first().put(key.as_str(), message::encode(order));
            let put = put.congestion_control(CongestionControl::Drop).priority(Priority::RealTime);
            Ok(put.express(true).wait()?)
        })
    }
}

/// Runs in Zenoh's threads: decodes, verifies and queues each message. Never blocks.
#[derive(Clone)]
struct SwarmReceiver {
    sender: SyncSender<ReceivedMessage>,
    dropped: Arc<Dropped>,
    branch: Branch,
    key_ring: KeyRing,
    presence: Arc<Presence>,
}

impl SwarmReceiver {
    /// Receives these messages until the subscriber is dropped.
    fn subscribe<M: Message + 'static>(
        &self,
        session: &zenoh::Session,
        keys: &'static str,
        received: fn(M) -> SwarmMessage,
    ) -> zenoh::Result<Subscriber<()>> {
        let receiver = self.clone();
        let on_sample = move |sample: Sample| {
            let key = sample.key_expr().as_str();
            match receiver.branch.own(key).map(|topic| topic.author()) {
                // Replayed by another node, or in flight while the sender's link broke.
                Some(Author::Vehicle(id)) if !receiver.presence.may_send(receiver.branch.name(id)) => {
                    count(&receiver.dropped.forged)
                }
                _ => match receiver.key_ring.read(key, &sample.payload().to_bytes()) {
                    Ok(verified) => receiver.enqueue(received(verified.message), verified.run),
                    Err(error) => count(match error.reason() {
                        Reason::Undecodable | Reason::OtherVersion => &receiver.dropped.undecodable,
                        _ => &receiver.dropped.forged,
                    }),
                },
            }
        };
        session.declare_subscriber(self.branch.all(keys)).allowed_origin(Locality::Remote).callback(on_sample).wait()
    }

    fn enqueue(&self, received: SwarmMessage, run: Option<u64>) {
        if self.sender.try_send(ReceivedMessage { received, run, at: clock::now() }).is_err() {
            count(&self.dropped.overflow);
        }
    }
}

/// The run that these vehicles fly in; `own` is the run that this PC began last.
fn run_in_flight<'v>(views: impl Iterator<Item = &'v VehicleView>, own: Option<u64>) -> Option<u64> {
    let named: Vec<u64> = views.filter(|view| view.alive).filter_map(|view| view.run).collect();
    majority(&named, named.len()).or(own.filter(|own| named.contains(own)))
}

/// The run that more than half of `all` vehicles report. A reported run of 0 means an unknown run.
pub fn majority(named: &[u64], all: usize) -> Option<u64> {
    let has_majority = |run: &u64| *run != 0 && 2 * named.iter().filter(|other| *other == run).count() > all;
    named.iter().copied().find(has_majority)
}

fn count(counter: &AtomicU64) {
    counter.fetch_add(1, Relaxed);
}

/// Keeps the newest message of each kind and vehicle. Returns false if the message is older than the kept one.
fn update(
    vehicles: &mut BTreeMap<VehicleId, VehicleView>,
    ReceivedMessage { received, run, at }: &ReceivedMessage,
) -> bool {
    let is_older = |header: &message::Header, known: Option<&message::Header>| {
        known.is_some_and(|known| known.order() >= header.order())
    };
    match received {
        SwarmMessage::Trace(trace) => {
            let view = vehicles.entry(trace.header.sender).or_default();
            if is_older(&trace.header, view.trace.as_ref().map(|known| &known.header)) {
                return false;
            }
            (view.trace, view.trace_at) = (Some(trace.clone()), Some(*at));
        }
        SwarmMessage::Summary(summary) => {
            let view = vehicles.entry(summary.header.sender).or_default();
            if is_older(&summary.header, view.summary.as_ref().map(|known| &known.header)) {
                return false;
            }
            (view.summary, view.summary_at) = (Some(summary.clone()), Some(*at));
        }
        SwarmMessage::Health(health) => {
            let view = vehicles.entry(health.header.sender).or_default();
            if is_older(&health.header, view.health.as_ref().map(|known| &known.header)) {
                return false;
            }
            (view.health, view.health_at, view.health_run) = (Some(health.clone()), Some(*at), *run);
        }
        SwarmMessage::Mission(mission) => {
            let view = vehicles.entry(mission.header.sender).or_default();
            if is_older(&mission.header, view.mission.as_ref().map(|known| &known.header)) {
                return false;
            }
            let life = |mission: &Heartbeat| mission.header.incarnation;
            if view.mission.as_ref().map(life) != Some(life(mission)) || view.run != *run {
                view.orders = StandingOrders::default();
            }
            (view.mission, view.run) = (Some(*mission), *run);
        }
        SwarmMessage::Event(_) => {}
        SwarmMessage::Appeared(id) => vehicles.entry(*id).or_default().alive = true,
        SwarmMessage::Vanished(id) => vehicles.entry(*id).or_default().alive = false,
    }
    true
}

#[cfg(test)]
mod tests;
