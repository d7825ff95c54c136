//! The messages received of all vehicles of a swarm, and the conclusions from them that are the same for every receiver.
//!
//! Agents of one process that have received the same can share them (`shared.rs`).

use alloc::sync::Arc;
use alloc::vec;
use alloc::vec::Vec;

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::{Echo, Header, Heartbeat, Order, StandingOrders, Verb};
use skein_common::scenario::{Graph, Network, Scenario};
use skein_common::time::LocalTime;

use super::inbox::SwarmInbox;
use super::message::{PeerMessage, ReceivedState};
use super::messages::Messages;
use super::near::Travel;
use super::news::{Item, News};
use super::peer::{
    Agreed, AgreementChange, FRESH_S, Judgement, KeptHeartbeat, Motion, Newest, Peer, StateArrival, Status,
};
use super::recent::{FreshStates, RecentSenders};
use super::timeout::SilenceTimeout;
use super::{Change, Report, index};
use crate::delay::{DelayBase, Excess, since_stamp_s};

/// A change by a message of the round trips between its sender and one receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum TripChange {
    /// The sender has begun a new incarnation: earlier round trips are those of another agent.
    Restarted(VehicleId),
    /// A heartbeat with this transit, s, echoed a stamp.
    Echoed { sender: VehicleId, at: LocalTime, transit_s: f64, echo: Echo },
}

/// The records of all vehicles.
#[derive(Clone, Debug, Default)]
pub(super) struct Records {
    roster: u8,
    plan: u64,
    /// Whether the network graph passes every peer's states.
    receives_all_states: bool,
    /// The vehicles of the whole swarm by id; empty before the first update.
    peers: Vec<Peer>,
    /// The newest messages of each.
    pub(super) messages: Messages,
    /// The vehicles with each kind of status.
    with: [VehicleSet; Status::KINDS],
    /// Those in contact that report the only receiver of these records as lost.
    have_lost_own: VehicleSet,
    /// Vehicles of which anything was received.
    known: VehicleSet,
    /// Vehicles whose status has to be judged in this update.
    touched: VehicleSet,
    /// For each vehicle a time before which its status does not change without a message, and the earliest of them.
    peer_unchanged_until: Vec<LocalTime>,
    unchanged_until: LocalTime,
    /// A number that changes whenever the agreement's inputs may have changed.
    pub(super) revision: u64,
    /// Number of updates that have brought any vehicle back into sight, and the vehicles that the last one has.
    pub(super) sightings: u64,
    pub(super) sighted: VehicleSet,
    /// Vehicles of which the last update has taken a state.
    pub(super) moved: VehicleSet,
    /// Vehicles of which the last update has taken any message.
    arrived: VehicleSet,
    /// A length that no vehicle's reported position has exceeded on its way since the begin, horizontally, m: the sum over
    /// the updates of the longest way in each.
    travelled_m: f64,
    longest_way_m: f64,
    /// Largest reported horizontal speed so far, m/s, and largest excess of a state's delay.
    fastest_m_s: f64,
    largest_excess: Option<Excess>,
    recent: RecentSenders,
    recent_states: RecentSenders,
    fresh: FreshStates,
    /// The changes of the last update, by id.
    pub(super) changes: Vec<Change>,
    /// The orders and the plans that differ in the heartbeats of the last update, by sender.
    pub(super) reports: Vec<Report>,
    /// The orders that operators have sent, of the last update.
    pub(super) orders: Vec<Order>,
    trip_changes: Vec<TripChange>,
    /// Vehicles whose round trips the last update changes.
    echoed: VehicleSet,
    /// The orders that have been reported.
    known_orders: StandingOrders,
    /// The newest order of each key that an operator has set, with the vehicles whose heartbeats have repeated it.
    settings: Vec<(Order, VehicleSet)>,
    /// Time of the last update.
    pub(super) now: LocalTime,
    timeout: SilenceTimeout,
    /// Vehicles that the last update has found to be suspected too early.
    suspected_too_early: VehicleSet,
    /// Time of the first update.
    pub(super) first_update: Option<LocalTime>,
    /// Number of messages dropped because their sender is not in this swarm.
    pub(super) forged: u64,
}

impl Records {
    /// The records before any message, in a swarm of vehicles 1 to `roster`.
    pub(super) fn new(roster: u8, plan: u64, network: &Network) -> Self {
        Self {
            roster,
            plan,
            receives_all_states: network.graph == Graph::All,
            unchanged_until: LocalTime::MAX,
            timeout: SilenceTimeout::new(network.peer_stale_s),
            ..Self::default()
        }
    }

    /// The records of a scenario's swarm before any message.
    pub(super) fn of(scenario: &Scenario) -> Self {
        Self::new(scenario.roster(), scenario.plan_hash(), &scenario.network)
    }

    /// Becomes equal to other records except for what an update begins anew, in the memory of these.
    pub(super) fn copy_from(&mut self, other: &Self) {
        let mut peers = core::mem::take(&mut self.peers);
        peers.clone_from(&other.peers);
        let mut peer_unchanged_until = core::mem::take(&mut self.peer_unchanged_until);
        peer_unchanged_until.clone_from(&other.peer_unchanged_until);
        let mut messages = core::mem::take(&mut self.messages);
        messages.copy_from(&other.messages);
        *self = Self {
            peers,
            peer_unchanged_until,
            messages,
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

    /// Reads what vehicle `own` receives from the inbox of its swarm, from the begin on.
    pub(super) fn share_inbox(&mut self, own: VehicleId) {
        self.messages = Messages::Swarm { inbox: None, receiver: own };
    }

    /// Lets go of the inbox, so that the next frame's messages can be put into it.
    pub(super) fn release_inbox(&mut self) {
        if let Messages::Swarm { inbox, .. } = &mut self.messages {
            *inbox = None;
        }
    }

    /// Judges vehicle `own` no more. Records that several agents share judge every vehicle; once they are those of its own
    /// agent alone, a late judgement of it would count as a sign of overload.
    pub(super) fn leave_out(&mut self, own: VehicleId) {
        self.known.set(own, false);
    }

    /// Takes the messages received since the last update, each with its time of arrival.
    pub(super) fn update<'a>(&mut self, now: LocalTime, messages: impl Iterator<Item = (&'a PeerMessage, LocalTime)>) {
        let before = self.begin_update(now);
        for (message, at) in messages {
            // Whatever the clock showed at its arrival, the message arrived between the two updates.
            self.receive(message, at.clamp(before, now));
        }
        self.end_update(before);
    }

    /// Takes what the inbox has received since the last update.
    pub(super) fn update_from(&mut self, now: LocalTime, inbox: &Arc<SwarmInbox>) {
        let before = self.begin_update(now);
        let Messages::Swarm { inbox: own, receiver } = &mut self.messages else { return };
        *own = Some(Arc::clone(inbox));
        let News { states, heartbeats, items } = inbox.news(index(*receiver));
        // Most messages only repeat what is known, and change nothing of their sender's status.
        let (young, settled) = (self.all(Status::YOUNG), self.all(Status::SETTLED));
        let arrived = states.either(heartbeats);
        let judged = states.without(young).either(arrived.without(settled));
        self.touched.extend(judged);
        (self.moved, self.arrived) = (states, arrived);
        for news in items {
            self.take(inbox, &news.item, inbox.arrival(news));
        }
        self.known.extend(self.touched);
        self.end_update(before);
    }

    fn begin_update(&mut self, now: LocalTime) -> LocalTime {
        let before = core::mem::replace(&mut self.now, now).min(now);
        if self.first_update.is_none() {
            self.first_update = Some(now);
            self.peers = vec![Peer::UNKNOWN; self.roster.into()];
            self.peer_unchanged_until = vec![LocalTime::MAX; self.peers.len()];
            self.messages.prepare(self.peers.len());
        }
        self.changes.clear();
        self.reports.clear();
        self.orders.clear();
        self.trip_changes.clear();
        // The first frames have much more of them than all others.
        self.trip_changes.shrink_to(4);
        (self.touched, self.moved, self.arrived, self.echoed) = Default::default();
        (self.sighted, self.suspected_too_early) = Default::default();
        before
    }

    fn end_update(&mut self, before: LocalTime) {
        let step = (before, self.now);
        self.recent.insert(self.arrived, step, self.timeout.silent_s(true));
        self.recent_states.insert(self.moved, step, self.timeout.without_state_s());
        self.fresh.insert(self.moved, before);
        self.travelled_m += core::mem::take(&mut self.longest_way_m);
        self.reports.sort_by_key(|report| report.id);
        self.judge();
    }

    /// Counts no silence of the vehicles in the time `for_s` in which this agent did not run.
    pub(super) fn did_not_run(&mut self, for_s: f64) {
        // In virtual time no agent is late.
        if let Messages::Own { newest, .. } = &mut self.messages {
            for peer in newest {
                peer.received_at = peer.received_at.map(|at| at.plus_seconds(for_s));
            }
        }
        self.timeout.was_late(self.now.plus_seconds(for_s));
        self.unchanged_until = LocalTime::ZERO;
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
    pub(super) fn peers(&self) -> impl Iterator<Item = (VehicleId, &Peer)> {
        VehicleId::first(self.peers.len()).zip(&self.peers)
    }

    /// The vehicles in contact that fly the same plan and report vehicle `own` as lost.
    pub(super) fn that_lost(&self, own: VehicleId) -> VehicleSet {
        if let Messages::Swarm { .. } = self.messages {
            return self.have_lost_own;
        }
        let has_lost =
            |id: &VehicleId| self.messages.heartbeat(*id).is_some_and(|last| last.agreement.lost.contains(own));
        self.all(Status::REPORTS_LOST).iter().filter(has_lost).collect()
    }

    /// Bounds of the way, the speed and the delay of the states for a receiver with this largest delay of messages without an
    /// excess.
    pub(super) fn travel(&self, largest: DelayBase) -> Travel {
        let (travelled_m, fastest_m_s, largest_excess) = match &self.messages {
            Messages::Swarm { inbox: Some(inbox), receiver } => inbox.travel(index(*receiver)),
            _ => (self.travelled_m, self.fastest_m_s, self.largest_excess),
        };
        let delay = largest_excess.map(|excess| largest.at_arrival(excess));
        let delay_s = delay.map_or(0.0, |delay| delay.likely_at_most_s(self.now.seconds()));
        Travel { travelled_m, fastest_m_s, delay_s }
    }

    /// [`Travel::travelled_m`] when the newest state of a vehicle was taken, or less, m.
    pub(super) fn travelled_m(&self, id: VehicleId) -> f64 {
        match &self.messages {
            Messages::Swarm { inbox: Some(inbox), receiver } => inbox.travelled_m(index(id), *receiver),
            _ => self.travelled_m,
        }
    }

    /// Vehicles of which a state arrived less than [`FRESH_S`] ago.
    pub(super) fn fresh(&self) -> VehicleSet {
        let (mut fresh, perhaps) = self.fresh.at(self.now);
        for id in perhaps.without(fresh).iter() {
            if self.messages.motion(id).is_some_and(|motion| self.now < motion.at.plus_seconds(FRESH_S)) {
                fresh.insert(id);
            }
        }
        fresh
    }

    /// Whether the last update has found vehicle `own` to be suspected too early. No agent suspects itself, so the records of
    /// that vehicle's agent are others from then on.
    pub(super) fn differ_for(&self, own: VehicleId) -> bool {
        self.suspected_too_early.contains(own)
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

    /// Judges the vehicles that messages have touched, and those of which a deadline may have passed.
    fn judge(&mut self) {
        let is_shorter = self.timeout.pass(self.now);
        let is_longer = self.unchanged_until == LocalTime::ZERO;
        let is_due = is_shorter || self.now >= self.unchanged_until;
        let Self { now, timeout, receives_all_states, .. } = *self;
        let judgement = Judgement { now, timeout, receives_all_states };
        let mut judged = self.touched;
        // Those whose status other limits may have changed.
        let mut affected = VehicleSet::default();
        if is_due {
            let spared = self.spared();
            let limits_s = [timeout.silent_s(true), timeout.without_state_s()];
            let soonest_s = limits_s.into_iter().fold(f64::INFINITY, f64::min);
            let spared_until = now.plus_seconds((1.0 - RecentSenders::WITHIN) * soonest_s);
            self.unchanged_until = if spared.is_empty() { LocalTime::MAX } else { spared_until };
            judged.extend(self.known.without(spared));
            if is_shorter {
                affected = self.known.without(spared);
                for id in spared.iter() {
                    let until = &mut self.peer_unchanged_until[index(id)];
                    *until = spared_until.min(*until);
                }
            }
            if is_longer {
                // A peer in contact whose state is young may be silent for longer than before.
                affected.extend(self.known.without(self.all(Status::IN_CONTACT).both(self.all(Status::YOUNG))));
                judged.extend(affected);
            }
        }
        for id in judged.iter() {
            let (Some(peer), Some(until)) =
                (self.peers.get_mut(index(id)), self.peer_unchanged_until.get_mut(index(id)))
            else {
                continue;
            };
            if is_due && now < *until && !self.touched.contains(id) && !affected.contains(id) {
                self.unchanged_until = self.unchanged_until.min(*until);
                continue;
            }
            let Some(newest) = &self.messages.newest(id) else { continue };
            let is_doubtful = peer.is_doubtful(&judgement);
            let change = peer.age(id, newest, &judgement);
            if is_doubtful && matches!(change, Some(Change::Found(_))) {
                self.timeout.suspected_too_early(now);
                self.suspected_too_early.insert(id);
            }
            self.changes.extend(change);
            let status = peer.assess(newest, &judgement);
            if let Messages::Swarm { receiver, .. } = self.messages {
                let has_lost_own = newest.lost().contains(receiver) && status.contains(Status::REPORTS_LOST);
                self.have_lost_own.set(id, has_lost_own);
            }
            *until = peer.unchanged_until(newest, &judgement);
            self.unchanged_until = self.unchanged_until.min(*until);
            let differing = core::mem::replace(&mut peer.status, status).differing(status);
            self.revision += u64::from(differing.contains(Status::AGREES));
            self.sighted.set(id, differing.contains(Status::SEEN) && status.contains(Status::SEEN));
            for bit in differing.bits() {
                self.with[bit].set(id, status.has(bit));
            }
        }
        self.sightings += u64::from(!self.sighted.is_empty());
        if !self.suspected_too_early.is_empty() {
            // Other peers may have been suspected too early as well.
            self.unchanged_until = LocalTime::ZERO;
        }
    }

    /// The vehicles of which no deadline can pass soon: messages of them have arrived lately, and a state too if theirs is young.
    fn spared(&self) -> VehicleSet {
        let recent = self.recent.all(self.now, self.timeout.silent_s(true));
        let recent_states = self.recent_states.all(self.now, self.timeout.without_state_s());
        let with_states = recent_states.either(recent.without(self.all(Status::YOUNG)));
        recent.both(with_states).both(self.all(Status::IN_CONTACT))
    }

    /// Takes an item of news from the inbox.
    fn take(&mut self, inbox: &SwarmInbox, item: &Item, at: LocalTime) {
        match item {
            Item::Restarted(id) => self.restarted(*id),
            Item::Heartbeat(parcel, change) => {
                let heartbeat = inbox.heartbeat_of(*parcel);
                self.revision += u64::from(*change == AgreementChange::Steps);
                if *change != AgreementChange::Nothing {
                    self.touched.insert(heartbeat.header.sender);
                }
                self.note_contents(heartbeat, at);
            }
            Item::Old(id) => self.peers[index(*id)].note_old(),
            Item::Token(id, is_there) => self.set_token(*id, *is_there),
            Item::Order(nth) => self.orders.extend(inbox.order(*nth)),
        }
    }

    fn receive(&mut self, message: &PeerMessage, at: LocalTime) {
        match message {
            PeerMessage::State(message) => {
                let Some((peer, newest, moved)) = self.sender(&message.header) else { return };
                let sequence = message.header.sequence;
                if newest.state.is_some_and(|last| last.sequence >= sequence) {
                    peer.note_old();
                    return;
                }
                newest.state = Some(StateArrival { sequence, at });
                let (id, was_young) = (message.header.sender, peer.status.contains(Status::YOUNG));
                let excess = Excess::new(at, since_stamp_s(at, message.header.stamp));
                let ReceivedState { position, velocity, heading_rad, .. } = *message;
                let motion = Motion { position, velocity, heading_rad, at, excess };
                let before = core::mem::replace(moved, motion);
                self.note_way((motion.position - before.position).xy().norm(), id);
                self.fastest_m_s = self.fastest_m_s.max(velocity.horizontal().norm());
                self.largest_excess = Some(self.largest_excess.map_or(excess, |largest| largest.max(excess)));
                self.moved.insert(id);
                self.arrived(id, at, !was_young);
            }
            PeerMessage::Mission(message) => self.receive_heartbeat(message, at),
            PeerMessage::Appeared(id) => self.set_token(*id, true),
            PeerMessage::Vanished(id) => self.set_token(*id, false),
            PeerMessage::Order(order) => self.orders.push(*order),
        }
    }

    fn set_token(&mut self, id: VehicleId, is_there: bool) {
        if let Some(peer) = self.peers.get_mut(index(id)) {
            peer.set_token(is_there);
            self.known.insert(id);
            self.touched.insert(id);
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
        let Some((peer, newest, _)) = self.sender(&message.header) else { return };
        let Header { sequence, stamp, .. } = message.header;
        let agreement = Agreed::new(message, plan);
        if let Some(last) = newest.heartbeat.filter(|last| last.sequence >= sequence) {
            // A heartbeat is repeated to every agent that asks for it.
            let is_repeated = (last.sequence, last.stamp, last.agreement) == (sequence, stamp, agreement);
            if !is_repeated {
                peer.note_old();
            }
            return;
        }
        let progress_m = message.progress_m;
        if newest.heartbeat.is_some_and(|last| last.sequence + 1 < sequence) {
            newest.gap_at = Some(at);
        }
        let last = newest.heartbeat.replace(KeptHeartbeat { sequence, stamp, at, progress_m, agreement });
        let change = last.map_or(AgreementChange::Steps, |last| last.agreement.change_to(&agreement));
        self.revision += u64::from(change == AgreementChange::Steps);
        self.note_contents(message, at);
        self.arrived(message.header.sender, at, change != AgreementChange::Nothing);
    }

    /// Keeps what a heartbeat contains beside the agreement state: an echo, an order, a plan that differs.
    fn note_contents(&mut self, message: &Heartbeat, at: LocalTime) {
        let (plan, Header { sender: id, stamp, .. }) = (self.plan, message.header);
        let is_for_other = |of| matches!(self.messages, Messages::Swarm { receiver, .. } if receiver != of);
        if let Some(echo) = message.echo.filter(|echo| !is_for_other(echo.of)) {
            let transit_s = since_stamp_s(at, stamp);
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
    }

    /// Keeps what follows from a message's arrival. `is_changed` if the message itself may change the sender's status.
    fn arrived(&mut self, id: VehicleId, at: LocalTime, is_changed: bool) {
        let Messages::Own { newest, .. } = &mut self.messages else { return };
        self.arrived.insert(id);
        // After this agent was late, the last arrival counts as later than it was, and a new one may be earlier.
        let is_earlier = newest[index(id)].received_at.replace(at).is_some_and(|before| at < before);
        if is_changed || is_earlier || !self.peers[index(id)].status.contains(Status::SETTLED) {
            self.known.insert(id);
            self.touched.insert(id);
        }
    }

    /// The vehicle in whose current incarnation this message was sent, with its newest messages; the caller compares the
    /// sequence numbers.
    fn sender(&mut self, header: &Header) -> Option<(&mut Peer, &mut Newest, &mut Motion)> {
        let nth = index(header.sender);
        let Some(peer) = self.peers.get_mut(nth) else {
            self.forged += 1;
            return None;
        };
        let Messages::Own { newest, .. } = &mut self.messages else { return None };
        let newest = newest.get_mut(nth)?;
        if header.incarnation < newest.incarnation {
            peer.note_old();
            return None;
        }
        if header.incarnation > newest.incarnation {
            newest.begin(header.incarnation);
            self.restarted(header.sender);
        }
        match &mut self.messages {
            Messages::Own { newest, motions } => {
                Some((self.peers.get_mut(nth)?, newest.get_mut(nth)?, motions.get_mut(nth)?))
            }
            Messages::Swarm { .. } => None,
        }
    }

    /// Keeps that a vehicle has begun a new incarnation.
    fn restarted(&mut self, id: VehicleId) {
        self.revision += 1;
        self.trip_changes.push(TripChange::Restarted(id));
        self.echoed = VehicleId::first(self.roster.into()).collect();
        self.touched.insert(id);
        self.known.insert(id);
    }
}

/// Whether two orders set the same key.
fn sets_same_key(one: &Order, other: &Order) -> bool {
    matches!((one.verb, other.verb), (Verb::Set(one), Verb::Set(other)) if one.key == other.key)
}
