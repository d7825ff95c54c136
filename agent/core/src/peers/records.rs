//! What was received of all vehicles of a swarm, and what follows from it whichever vehicle has received it.
//!
//! Agents of one process that have received the same can share them (`shared.rs`).

use alloc::vec::Vec;

use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::{Echo, Header, Heartbeat, Order, StandingOrders, Verb};
use skein_common::scenario::{Graph, Network, Scenario};
use skein_common::time::LocalTime;

use super::message::{PeerMessage, ReceivedState};
use super::near::Travel;
use super::peer::{Agreed, FRESH_S, Judgement, KeptHeartbeat, Peer, StateArrival, Status};
use super::timeout::SilenceTimeout;
use super::{Change, Report, index};
use crate::delay::{DelayBase, Excess, since_stamp_s};

/// The newest state of a vehicle, in the swarm's frame.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Motion {
    pub(super) position: PositionNed,
    pub(super) velocity: VelocityNed,
    pub(super) heading_rad: f64,
    /// Arrival of the state.
    pub(super) at: LocalTime,
    /// The part of the state's delay that does not depend on the round trips.
    pub(super) excess: Excess,
}

/// A change by a message of the round trips between its sender and one receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum TripChange {
    /// The sender has begun a new incarnation: earlier round trips are those of another agent.
    Restarted(VehicleId),
    /// A heartbeat with this transit, s, echoed a stamp.
    Echoed { sender: VehicleId, at: LocalTime, transit_s: f64, echo: Echo },
}

/// The records of all vehicles.
#[derive(Clone, Debug)]
pub(super) struct Records {
    roster: u8,
    plan: u64,
    /// Whether the network graph passes every peer's states.
    receives_all_states: bool,
    /// The vehicles of the whole swarm by id; empty before the first update.
    peers: Vec<Peer>,
    /// The newest state of each vehicle.
    motions: Vec<Motion>,
    /// The vehicles with each kind of status.
    with: [VehicleSet; Status::KINDS],
    /// Vehicles of which anything was received.
    known: VehicleSet,
    /// Vehicles whose status has to be judged in this update.
    touched: VehicleSet,
    /// A time before which no status changes without a message.
    unchanged_until: LocalTime,
    revision: u64,
    /// Number of updates after which every list of near peers has to be made anew.
    relistings: u64,
    /// Vehicles of which the last update has taken a state.
    moved: VehicleSet,
    /// A length that no vehicle's reported position has exceeded on its way since the begin, horizontally, m: the sum over
    /// the updates of the longest way in each.
    travelled_m: f64,
    longest_way_m: f64,
    /// Largest reported horizontal speed so far, m/s, and largest excess of a state's delay.
    fastest_m_s: f64,
    largest_excess: Option<Excess>,
    /// Vehicles of which a state arrived less than [`FRESH_S`] ago, and a time before which all of them remain so.
    fresh: VehicleSet,
    fresh_until: LocalTime,
    changes: Vec<Change>,
    reports: Vec<Report>,
    orders: Vec<Order>,
    trip_changes: Vec<TripChange>,
    /// Vehicles whose round trips the last update changes.
    echoed: VehicleSet,
    /// The orders that have been reported.
    known_orders: StandingOrders,
    /// The newest order of each key that an operator has set, with the vehicles whose heartbeats have repeated it.
    settings: Vec<(Order, VehicleSet)>,
    now: LocalTime,
    timeout: SilenceTimeout,
    /// Vehicles that the last update has found to be suspected too early.
    suspected_too_early: VehicleSet,
    /// Time of the first update.
    first_update: Option<LocalTime>,
    forged: u64,
}

impl Records {
    /// The records before any message, in a swarm of vehicles 1 to `roster`.
    pub(super) fn new(roster: u8, plan: u64, network: &Network) -> Self {
        Self {
            roster,
            plan,
            receives_all_states: network.graph == Graph::All,
            peers: Vec::new(),
            motions: Vec::new(),
            with: [VehicleSet::default(); Status::KINDS],
            known: VehicleSet::default(),
            touched: VehicleSet::default(),
            unchanged_until: LocalTime::MAX,
            revision: 0,
            relistings: 0,
            moved: VehicleSet::default(),
            travelled_m: 0.0,
            longest_way_m: 0.0,
            fastest_m_s: 0.0,
            largest_excess: None,
            fresh: VehicleSet::default(),
            fresh_until: LocalTime::MAX,
            changes: Vec::new(),
            reports: Vec::new(),
            orders: Vec::new(),
            trip_changes: Vec::new(),
            echoed: VehicleSet::default(),
            known_orders: StandingOrders::default(),
            settings: Vec::new(),
            now: LocalTime::ZERO,
            timeout: SilenceTimeout::new(network.peer_stale_s),
            suspected_too_early: VehicleSet::default(),
            first_update: None,
            forged: 0,
        }
    }

    /// The records of a scenario's swarm before any message.
    pub(super) fn of(scenario: &Scenario) -> Self {
        let roster = scenario.swarm.vehicles.min(VehicleId::MAX.into()) as u8;
        Self::new(roster, scenario.plan_hash(), &scenario.network)
    }

    /// Becomes equal to other records except for what an update begins anew, in the memory of these.
    pub(super) fn copy_from(&mut self, other: &Self) {
        let mut peers = core::mem::take(&mut self.peers);
        let mut motions = core::mem::take(&mut self.motions);
        peers.clone_from(&other.peers);
        motions.clone_from(&other.motions);
        *self = Self {
            peers,
            motions,
            changes: core::mem::take(&mut self.changes),
            reports: core::mem::take(&mut self.reports),
            orders: core::mem::take(&mut self.orders),
            trip_changes: core::mem::take(&mut self.trip_changes),
            known_orders: other.known_orders.clone(),
            settings: other.settings.clone(),
            ..*other
        };
    }

    /// Whether these records and others hold nothing yet, and will hold the same after the same messages.
    pub(super) fn begins_like(&self, other: &Self) -> bool {
        let settings = |records: &Self| {
            let &Self { roster, plan, receives_all_states, first_update, timeout, .. } = records;
            (roster, plan, receives_all_states, first_update, timeout)
        };
        self.first_update.is_none() && settings(self) == settings(other)
    }

    /// Takes the messages received since the last update, each with its time of arrival.
    pub(super) fn update<'a>(&mut self, now: LocalTime, messages: impl Iterator<Item = (&'a PeerMessage, LocalTime)>) {
        let before = core::mem::replace(&mut self.now, now).min(now);
        if self.first_update.is_none() {
            self.first_update = Some(now);
            self.peers = VehicleId::first(self.roster.into()).map(Peer::unknown).collect();
            self.motions.resize(self.peers.len(), Motion::default());
        }
        self.changes.clear();
        self.reports.clear();
        self.orders.clear();
        self.trip_changes.clear();
        (self.touched, self.moved, self.echoed, self.suspected_too_early) = Default::default();
        for (message, at) in messages {
            // Whatever the clock showed at its arrival, the message arrived between the two updates.
            self.receive(message, at.clamp(before, now));
        }
        self.travelled_m += core::mem::take(&mut self.longest_way_m);
        self.reports.sort_by_key(|report| report.id);
        self.judge();
        self.update_fresh();
    }

    /// Counts no silence of the vehicles in the time `for_s` in which this agent did not run.
    pub(super) fn did_not_run(&mut self, for_s: f64) {
        for peer in &mut self.peers {
            peer.received_at = peer.received_at.map(|at| at.plus_seconds(for_s));
        }
        self.timeout.was_late(self.now.plus_seconds(for_s));
        self.unchanged_until = LocalTime::ZERO;
    }

    /// Time of the last update.
    pub(super) fn now(&self) -> LocalTime {
        self.now
    }

    /// Time of the first update.
    pub(super) fn first_update(&self) -> Option<LocalTime> {
        self.first_update
    }

    /// Number of vehicles of the swarm.
    pub(super) fn roster(&self) -> usize {
        self.roster.into()
    }

    /// The vehicles with a kind of status.
    pub(super) fn all(&self, status: Status) -> VehicleSet {
        self.with[status.index()]
    }

    /// The record of a vehicle.
    pub(super) fn peer(&self, id: VehicleId) -> Option<&Peer> {
        self.peers.get(index(id))
    }

    /// The records of all vehicles, by id.
    pub(super) fn peers(&self) -> impl Iterator<Item = &Peer> {
        self.peers.iter()
    }

    /// The newest state of a vehicle.
    #[inline]
    pub(super) fn motion(&self, id: VehicleId) -> Option<&Motion> {
        self.motions.get(index(id))
    }

    /// A number that changes whenever the agreement's inputs may have changed.
    pub(super) fn revision(&self) -> u64 {
        self.revision
    }

    /// A number that changes whenever lists of near peers have to be made anew.
    pub(super) fn relistings(&self) -> u64 {
        self.relistings
    }

    /// Vehicles of which the last update has taken a state.
    pub(super) fn moved(&self) -> VehicleSet {
        self.moved
    }

    /// How far the states have come for a receiver with this largest delay of messages without an excess.
    pub(super) fn travel(&self, largest: DelayBase) -> Travel {
        let delay = self.largest_excess.map(|excess| largest.at_arrival(excess));
        let delay_s = delay.map_or(0.0, |delay| delay.likely_at_most_s(self.now.seconds()));
        Travel { travelled_m: self.travelled_m, fastest_m_s: self.fastest_m_s, delay_s }
    }

    /// Vehicles of which a state arrived less than [`FRESH_S`] ago.
    pub(super) fn fresh(&self) -> VehicleSet {
        self.fresh
    }

    /// Whether the last update has found vehicle `own` to be suspected too early. No agent suspects itself, so the records of
    /// that vehicle's agent are others from then on.
    pub(super) fn differ_for(&self, own: VehicleId) -> bool {
        self.suspected_too_early.contains(own)
    }

    /// The changes of the last update, by id.
    pub(super) fn changes(&self) -> &[Change] {
        &self.changes
    }

    /// The orders and the plans that differ in the heartbeats of the last update, by sender.
    pub(super) fn reports(&self) -> &[Report] {
        &self.reports
    }

    /// The orders that operators have sent, of the last update.
    pub(super) fn orders(&self) -> &[Order] {
        &self.orders
    }

    /// The vehicles whose heartbeats have repeated this setting or a later one of its key.
    pub(super) fn know(&self, setting: &Order) -> VehicleSet {
        let later = self.settings.iter().find(|(known, _)| sets_same_key(known, setting) && known >= setting);
        later.map(|(_, by)| *by).unwrap_or_default()
    }

    /// The changes by the last update of the round trips of vehicle `own`, in the order of arrival, among changes of others'.
    pub(super) fn trip_changes(&self, own: VehicleId) -> &[TripChange] {
        if self.echoed.contains(own) { &self.trip_changes } else { &[] }
    }

    /// Number of messages dropped because their sender is not in this swarm.
    pub(super) fn forged(&self) -> u64 {
        self.forged
    }

    /// Judges the vehicles that messages have touched, or all of them if a deadline may have passed.
    fn judge(&mut self) {
        let is_due = self.timeout.pass(self.now) || self.now >= self.unchanged_until;
        let Self { now, timeout, receives_all_states, .. } = *self;
        let judgement = Judgement { now, timeout, receives_all_states };
        if is_due {
            self.unchanged_until = LocalTime::MAX;
        }
        let mut is_relisted = is_due;
        let judged = if is_due { self.known } else { self.touched };
        for id in judged.iter() {
            let Some(peer) = self.peers.get_mut(index(id)) else { continue };
            let is_doubtful = peer.is_doubtful(&judgement);
            let change = peer.age(&judgement);
            if is_doubtful && matches!(change, Some(Change::Found(_))) {
                self.timeout.suspected_too_early(now);
                self.suspected_too_early.insert(id);
            }
            self.changes.extend(change);
            let status = peer.assess(&judgement);
            self.unchanged_until = self.unchanged_until.min(peer.unchanged_until(&judgement));
            let differing = core::mem::replace(&mut peer.status, status).differing(status);
            self.revision += u64::from(differing.contains(Status::AGREES));
            is_relisted |= differing.contains(Status::SEEN);
            for bit in differing.bits() {
                self.with[bit].set(id, status.has(bit));
            }
        }
        self.relistings += u64::from(is_relisted);
        if !self.suspected_too_early.is_empty() {
            // Other peers may have been suspected too early as well.
            self.unchanged_until = LocalTime::ZERO;
        }
    }

    fn update_fresh(&mut self) {
        let ends = |motion: &Motion| motion.at.plus_seconds(FRESH_S);
        if !self.moved.is_empty() {
            self.fresh.extend(self.moved);
            self.fresh_until = self.fresh_until.min(self.now.plus_seconds(FRESH_S));
        }
        if self.now < self.fresh_until {
            return;
        }
        let before = core::mem::take(&mut self.fresh);
        self.fresh_until = LocalTime::MAX;
        for id in before.iter() {
            let ends = ends(&self.motions[index(id)]);
            if self.now < ends {
                self.fresh.insert(id);
                self.fresh_until = self.fresh_until.min(ends);
            }
        }
    }

    fn receive(&mut self, message: &PeerMessage, at: LocalTime) {
        match message {
            PeerMessage::State(message) => {
                let Some(peer) = self.sender(&message.header) else { return };
                let sequence = message.header.sequence;
                if peer.state.is_some_and(|last| last.sequence >= sequence) {
                    peer.old += 1;
                    return;
                }
                peer.state = Some(StateArrival { sequence, at });
                let (id, was_young) = (peer.id, peer.status.contains(Status::YOUNG));
                let excess = Excess::new(at, since_stamp_s(at, message.header.stamp));
                let ReceivedState { position, velocity, heading_rad, .. } = *message;
                let motion = Motion { position, velocity, heading_rad, at, excess };
                let before = core::mem::replace(&mut self.motions[index(id)], motion);
                self.note_way((motion.position - before.position).xy().norm(), id);
                self.fastest_m_s = self.fastest_m_s.max(velocity.horizontal().norm());
                self.largest_excess = Some(self.largest_excess.map_or(excess, |largest| largest.max(excess)));
                self.moved.insert(id);
                self.arrived(id, at, !was_young);
            }
            PeerMessage::Mission(message) => self.receive_heartbeat(message, at),
            PeerMessage::Appeared(id) | PeerMessage::Vanished(id) => {
                if let Some(peer) = self.peers.get_mut(index(*id)) {
                    peer.set_token(matches!(message, PeerMessage::Appeared(_)));
                    self.known.insert(*id);
                    self.touched.insert(*id);
                }
            }
            PeerMessage::Order(order) => self.orders.push(*order),
        }
    }

    /// Notes that this vehicle knows a setting.
    fn note_setting(&mut self, order: Order, by: VehicleId) {
        match self.settings.iter_mut().find(|(known, _)| sets_same_key(known, &order)) {
            Some((known, all)) if *known == order => all.insert(by),
            Some(older) if older.0 < order => *older = (order, [by].into_iter().collect()),
            Some(_) => {}
            None => self.settings.push((order, [by].into_iter().collect())),
        }
    }

    /// Adds the way of a vehicle between two states, m. A second one in an update counts in full.
    fn note_way(&mut self, way_m: f64, id: VehicleId) {
        if self.moved.contains(id) {
            self.travelled_m += way_m;
        } else {
            self.longest_way_m = self.longest_way_m.max(way_m);
        }
    }

    fn receive_heartbeat(&mut self, message: &Heartbeat, at: LocalTime) {
        let plan = self.plan;
        let Some(peer) = self.sender(&message.header) else { return };
        let Header { sequence, stamp, .. } = message.header;
        let agreement = Agreed::new(message, plan);
        if let Some(last) = peer.heartbeat.filter(|last| last.sequence >= sequence) {
            // A heartbeat is repeated to every agent that asks for it.
            let is_repeated = (last.sequence, last.stamp, last.agreement) == (sequence, stamp, agreement);
            peer.old += u64::from(!is_repeated);
            return;
        }
        let progress_m = message.progress_m;
        if peer.heartbeat.is_some_and(|last| last.sequence + 1 < sequence) {
            peer.prove_link_from(at);
        }
        let last = peer.heartbeat.replace(KeptHeartbeat { sequence, stamp, at, progress_m, agreement });
        let (id, is_changed) = (peer.id, last.map(|last| last.agreement) != Some(agreement));
        self.revision += u64::from(is_changed);
        let transit_s = since_stamp_s(at, stamp);
        if let Some(echo) = message.echo {
            self.trip_changes.push(TripChange::Echoed { sender: id, at, transit_s, echo });
            self.echoed.insert(echo.of);
        }
        let order = message.order.filter(|_| message.plan == plan);
        if let Some(order) = order.filter(|order| matches!(order.verb, Verb::Set(_))) {
            self.note_setting(order, id);
        }
        if message.plan != plan || order.is_some_and(|order| self.known_orders.merge(order)) {
            self.reports.push(Report { id, plan: message.plan, order: message.order });
        }
        self.arrived(id, at, is_changed);
    }

    /// Keeps what follows from a message's arrival. `is_changed` if the message itself may change the sender's status.
    fn arrived(&mut self, id: VehicleId, at: LocalTime, is_changed: bool) {
        let peer = &mut self.peers[index(id)];
        // After this agent was late, the last arrival counts as later than it was, and a new one may be earlier.
        let is_earlier = peer.received_at.replace(at).is_some_and(|before| at < before);
        if is_changed || is_earlier || !peer.status.contains(Status::SETTLED) {
            self.known.insert(id);
            self.touched.insert(id);
        }
    }

    /// The vehicle in whose current incarnation this message was sent; the caller compares the sequence numbers.
    fn sender(&mut self, header: &Header) -> Option<&mut Peer> {
        let Some(peer) = self.peers.get_mut(index(header.sender)) else {
            self.forged += 1;
            return None;
        };
        if header.incarnation < peer.incarnation {
            peer.old += 1;
            return None;
        }
        if header.incarnation > peer.incarnation {
            // A new incarnation numbers its messages from one again.
            peer.begin(header.incarnation);
            self.revision += 1;
            self.trip_changes.push(TripChange::Restarted(peer.id));
            self.echoed = VehicleId::first(self.roster.into()).collect();
            self.touched.insert(peer.id);
            self.known.insert(peer.id);
        }
        Some(peer)
    }
}

/// Whether two orders set the same key.
fn sets_same_key(one: &Order, other: &Order) -> bool {
    matches!((one.verb, other.verb), (Verb::Set(one), Verb::Set(other)) if one.key == other.key)
}
