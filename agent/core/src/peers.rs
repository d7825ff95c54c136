//! The peers stage: the newest messages of each peer, and its state extrapolated to now.
//!
//! The age of a peer's state is judged by the own clock, the order of its messages by its sequence numbers and
//! incarnation. Messages that are late, duplicated, from an earlier incarnation or with a false sender id are counted
//! and otherwise ignored. This stage orders each message once, at its arrival, and is the only one that keeps its
//! contents: later stages read the newest state and the newest heartbeat of each peer.
//!
//! The age of a state is an upper bound: the time since its arrival plus its largest possible delay ([`crate::delay`]).
//! Before the first round trip it is only the time since the arrival, and the delay is marked as unknown. T_stale
//! counts only the silence, not the delay: a swarm can fly over a link with a delay above T_stale, on old states, and
//! its status reports that. A state is extrapolated from its most likely time of sending.
//!
//! ```text
//!        age above 0.5 s       no message for T_stale, or token gone        10 s later
//!   Fresh ----------------> Stale ------------------------------> Lost ----------------------> no obstacle
//!     ^                       |                                     |
//!     +------ a state --------+------ a message, token present -----+
//! ```
//!
//! Any message keeps a peer in contact; only a state younger than T_stale keeps it in the formation. Where
//! `network.graph` withholds a peer's states, that peer is out of sight as long as its heartbeats arrive: it is not an
//! obstacle, and both still agree on the mission. All durations are in [`crate::deadlines`].
//!
//! A step looks at the messages that have arrived and at the near peers, not at every peer. A message changes the
//! record of its sender. The status of a peer is judged again only after a message that can change it, or after the
//! earliest time at which a deadline can. What other stages ask often is kept as sets of vehicles, and states are
//! extrapolated only for the peers within the law's reach (`near.rs`). The tests hold this bookkeeping against one that
//! judges every peer at every step.

mod age;
mod message;
mod near;
mod peer;

use alloc::vec;
use alloc::vec::Vec;

use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::{Echo, Header, Heartbeat, Order};
use skein_common::scenario::{Graph, Network};
use skein_common::state::{Membership, PeerStatus};
use skein_common::time::{LocalTime, SenderStamp};

use crate::deadlines::Deadline;
use crate::delay::{Exchange, MessageDelay, since_stamp_s};
use age::AgeBasis;
pub use message::{Broadcast, PeerMessage, Received, ReceivedState};
use near::NearList;
use peer::{Agreed, Judgement, KeptHeartbeat, Motion, Peer, StateArrival, Status, standing};
pub use peer::{FRESH_S, MAX_OBSTACLE_RADIUS_M};

/// The estimated current state of a peer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeerEstimate {
    /// The peer's id.
    pub id: VehicleId,
    /// Its last position, extrapolated at constant velocity.
    pub position: PositionNed,
    /// Its velocity as last received.
    pub velocity: VelocityNed,
    /// Its heading as last received, clockwise from true north, rad.
    pub heading_rad: f64,
    /// Upper bound of the age of its last state, s, including the delay once it is known.
    pub age_s: f64,
    /// Upper bound of this state's delay, s; `None` until a round trip is known.
    pub delay_s: Option<f64>,
    /// Most likely age of this state, s, over which it was extrapolated.
    pub carried_s: f64,
    /// Status of the peer.
    pub standing: PeerStatus,
    /// Role of the peer in the own formation.
    pub role: Role,
}

/// The age of a peer's newest state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeerStateAge {
    /// The peer's id.
    pub id: VehicleId,
    /// Upper bound of its age, s, as in [`PeerEstimate::age_s`].
    pub age_s: f64,
    /// Upper bound of its delay, s, as in [`PeerEstimate::delay_s`].
    pub delay_s: Option<f64>,
}

impl PeerStateAge {
    /// Time since the arrival of the state, s.
    pub fn silent_s(&self) -> f64 {
        self.age_s - self.delay_s.unwrap_or_default()
    }
}

/// The peers as the formation needs them.
#[derive(Clone, Copy, Debug, Default)]
pub struct PeerSummary<Estimates> {
    /// Estimates of the peers within the law's reach, by id.
    pub near: Estimates,
    /// All live members of the formation, this vehicle excluded.
    pub members: VehicleSet,
    /// Whether a lost peer that may still be flying has a lower id than every peer in contact. Of two partitions
    /// without contact, this one then flies above.
    pub flies_above: bool,
}

/// The newest heartbeat of a peer that flies the same plan, as the mission needs it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeerProgress {
    /// The peer's id.
    pub id: VehicleId,
    /// Its membership.
    pub membership: Membership,
    /// The step at which it is.
    pub step: u32,
    /// The latest step it vouches for.
    pub vouched: u32,
    /// The highest step it reached itself.
    pub reached: Option<u32>,
    /// Its estimate of the centre's progress along the path of its step, m.
    pub progress_m: f64,
}

/// The role of a peer in the own formation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Role {
    /// A member of the formation.
    Member,
    /// An obstacle to avoid.
    Obstacle {
        /// Uncertainty of its position plus a clearance, m.
        radius_m: f64,
    },
    /// Ignored: on the ground, or lost long ago.
    Nothing,
}

/// A change that is reported as an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// The peer is in contact for the first time or again.
    Found(VehicleId),
    /// The peer is lost.
    Lost(VehicleId),
}

/// The part of a heartbeat that concerns only its arrival: an order, or a plan that differs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// The sender of the heartbeat.
    pub id: VehicleId,
    /// The plan that the sender flies.
    pub plan: u64,
    /// The order that the heartbeat repeats.
    pub order: Option<Order>,
}

/// The peers stage of one vehicle.
#[derive(Clone, Debug)]
pub struct Peers {
    own: VehicleId,
    plan: u64,
    stale_s: f64,
    /// Whether the network graph passes every peer's states.
    receives_all_states: bool,
    /// The vehicles of the whole swarm by id; the own record stays empty.
    peers: Vec<Peer>,
    /// What the age of each peer's state depends on.
    ages: Vec<AgeBasis>,
    /// The newest state of each peer.
    motions: Vec<Motion>,
    /// The vehicles with each kind of status.
    with: [VehicleSet; Status::KINDS],
    /// Peers of which anything was received.
    known: VehicleSet,
    /// Peers whose status has to be judged in this update.
    touched: VehicleSet,
    /// A time before which no status changes without a message.
    unchanged_until: LocalTime,
    /// A number that changes whenever the agreement's inputs may have changed.
    revision: u64,
    near: NearList,
    changes: Vec<Change>,
    reports: Vec<Report>,
    /// The largest order that has been reported.
    order: Option<Order>,
    now: LocalTime,
    /// End of the time in which peers may be silent for longer, because this computer was overloaded.
    lenient_until: LocalTime,
    /// Time of the first update.
    first_update: Option<LocalTime>,
    exchange: Exchange,
    /// Begin of the time without any peer in contact, after there was one.
    alone_since: Option<LocalTime>,
    forged: u64,
}

impl Peers {
    /// The peers of vehicle `own` before any message, in a swarm of vehicles 1 to `roster`. Only a vehicle that flies
    /// the plan with hash `plan` can be a member. States older than `network.peer_stale_s` do not count.
    pub fn new(own: VehicleId, roster: u8, plan: u64, network: &Network) -> Self {
        Self {
            own,
            plan,
            stale_s: network.peer_stale_s,
            receives_all_states: network.graph == Graph::All,
            peers: VehicleId::first(roster.into()).map(Peer::unknown).collect(),
            ages: vec![AgeBasis::default(); roster.into()],
            motions: vec![Motion::default(); roster.into()],
            with: [VehicleSet::default(); Status::KINDS],
            known: VehicleSet::default(),
            touched: VehicleSet::default(),
            unchanged_until: LocalTime::MAX,
            revision: 0,
            near: NearList::default(),
            changes: Vec::new(),
            reports: Vec::new(),
            order: None,
            now: LocalTime::ZERO,
            lenient_until: LocalTime::ZERO,
            first_update: None,
            exchange: Exchange::default(),
            alone_since: None,
            forged: 0,
        }
    }

    /// Reports before the next step that this agent did not run for `for_s`: this time does not count as silence of the
    /// peers, and for a while peers may be silent for longer.
    pub fn did_not_run(&mut self, for_s: f64) {
        for peer in &mut self.peers {
            peer.received_at = peer.received_at.map(|at| at.plus_seconds(for_s));
        }
        self.lenient_until = self.now.plus_seconds(for_s + Deadline::LeniencyOver.after_s());
        self.unchanged_until = LocalTime::ZERO;
    }

    /// Takes the messages received since the last update.
    pub fn update(&mut self, now: LocalTime, received: &[Received], broadcast: Broadcast<'_>) {
        let before = core::mem::replace(&mut self.now, now).min(now);
        self.changes.clear();
        self.reports.clear();
        self.touched = VehicleSet::default();
        for received in received {
            // Whatever the clock showed at its arrival, the message arrived between the two updates.
            self.receive(&received.message, received.at.clamp(before, now));
        }
        let at = broadcast.at.clamp(before, now);
        let own = Some(self.own);
        for message in broadcast.messages.iter().filter(|message| message.sender() != own) {
            self.receive(message, at);
        }
        self.reports.sort_by_key(|report| report.id);
        self.judge();
        self.first_update.get_or_insert(now);
        let alone = !self.all(Status::REMAINS).is_empty() && self.in_contact().is_empty();
        self.alone_since = if alone { self.alone_since.or(Some(now)) } else { None };
    }

    /// The estimated current states of all peers that are not out of sight, by id.
    pub fn estimates(&self) -> impl Iterator<Item = PeerEstimate> {
        self.estimates_of(self.all(Status::SEEN))
    }

    /// The ages of the newest states of those of these peers that are in contact and not out of sight, by id.
    pub fn ages(&self, of: VehicleSet) -> impl Iterator<Item = PeerStateAge> {
        let now = self.now;
        let received = of.both(self.all(Status::SEEN)).both(self.in_contact());
        received.iter().filter_map(move |id| Some(self.ages.get(index(id))?.age(id, now)))
    }

    /// The peers as the formation needs them: the estimates of those within `reach_m` of the own position, and of some
    /// beyond.
    pub fn near(&mut self, own: PositionNed, reach_m: f64) -> PeerSummary<impl Iterator<Item = PeerEstimate>> {
        let seen = self.all(Status::SEEN);
        let near = if reach_m.is_finite() {
            self.near.valid(own, self.now, reach_m).unwrap_or_else(|| self.list_near(own, reach_m))
        } else {
            seen
        };
        let lowest_lost = self.all(Status::MAY_FLY).first();
        PeerSummary {
            near: self.estimates_of(near.both(seen)),
            members: self.members(),
            flies_above: lowest_lost.is_some_and(|lost| lost < self.lowest()),
        }
    }

    /// All live members of the formation, this vehicle excluded.
    pub fn members(&self) -> VehicleSet {
        self.all(Status::MEMBER).either(self.all(Status::UNSEEN))
    }

    /// The changes of the last update, by id.
    pub fn changes(&self) -> &[Change] {
        &self.changes
    }

    /// The orders and the plans that differ in the heartbeats of the last update, by sender.
    pub fn reports(&self) -> &[Report] {
        &self.reports
    }

    /// A number that changes whenever the part of [`Self::heartbeats`] on which the agreement depends may have changed:
    /// everything but the centre's progress.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// The newest heartbeats of all peers in contact that fly the same plan, by id. No other stage keeps them.
    pub fn heartbeats(&self) -> impl Iterator<Item = PeerProgress> + Clone {
        self.of(self.all(Status::AGREES)).filter_map(|peer| {
            let KeptHeartbeat { progress_m, agreement, .. } = peer.heartbeat?;
            let Agreed { membership, step, vouched, reached, .. } = agreement;
            Some(PeerProgress { id: peer.id, membership, step, vouched, reached, progress_m })
        })
    }

    /// The peers in contact: their tokens are present and their last messages young.
    pub fn in_contact(&self) -> VehicleSet {
        self.all(Status::IN_CONTACT)
    }

    /// Whether a vehicle that is not in contact may be flying the mission: it was never in contact, or it was lost
    /// without having left, and neither for longer than a minute.
    pub fn absent_may_fly(&self) -> bool {
        let listened_s = self.first_update.map_or(0.0, |first| self.now.seconds_since(first));
        let is_complete = self.all(Status::FOUND).len() + 1 >= self.peers.len();
        let may_come = !is_complete && !Deadline::PeerGivenUp.is_past(listened_s);
        may_come || !self.all(Status::MAY_RETURN).is_empty()
    }

    /// Whether a peer was lost without having left and no peer is in contact, for less than a minute.
    pub fn all_lost(&self) -> bool {
        self.alone_since.is_some_and(|since| !Deadline::PeerGivenUp.is_past(self.now.seconds_since(since)))
    }

    /// The echo for a heartbeat with this stamp, which is about to be sent.
    pub fn echo(&mut self, stamp: SenderStamp) -> Option<Echo> {
        self.exchange.send(stamp);
        let of = self.exchange.next_partner(self.all(Status::CORRESPONDS))?;
        let KeptHeartbeat { stamp, at, .. } = self.peers.get(index(of))?.heartbeat?;
        let held_s = self.now.seconds_since(at).max(0.0);
        // A hold of more than an hour is useless for a measurement; limited to that, it fits the field.
        let held_us = (held_s * 1e6).round().min(3.6e9) as u32;
        Some(Echo { of, stamp, held_us })
    }

    /// Number of messages dropped because a newer one had been received.
    pub fn old(&self) -> u64 {
        self.old_messages().map(|(_, count)| count).sum()
    }

    /// The same per sender; only senders with any.
    pub fn old_messages(&self) -> impl Iterator<Item = (VehicleId, u64)> {
        self.peers.iter().filter(|peer| peer.old > 0).map(|peer| (peer.id, peer.old))
    }

    /// Number of messages dropped because their sender is not in this swarm or claims to be this vehicle.
    pub fn forged(&self) -> u64 {
        self.forged
    }

    fn judgement(&self) -> Judgement {
        let Self { now, receives_all_states, .. } = *self;
        let stale_s = if now < self.lenient_until { 2.0 * self.stale_s } else { self.stale_s };
        Judgement { now, stale_s, receives_all_states }
    }

    /// The vehicles with a kind of status.
    fn all(&self, status: Status) -> VehicleSet {
        self.with[status.index()]
    }

    /// The records of these vehicles, by id.
    fn of(&self, ids: VehicleSet) -> impl Iterator<Item = &Peer> + Clone {
        ids.iter().filter_map(|id| self.peers.get(index(id)))
    }

    /// The estimated current states of these peers, of which each has a state, by id.
    #[inline]
    fn estimates_of(&self, ids: VehicleSet) -> impl Iterator<Item = PeerEstimate> {
        let members = self.all(Status::MEMBER);
        ids.iter().filter_map(move |id| self.estimate(id, members.contains(id)))
    }

    #[inline]
    fn estimate(&self, id: VehicleId, is_member: bool) -> Option<PeerEstimate> {
        let now = self.now;
        let (basis, motion) = (self.ages.get(index(id))?, self.motions.get(index(id))?);
        let (silent_s, delay) = basis.silent_s_and_delay(now);
        let MessageDelay { most_s, likely_s } = delay.unwrap_or_default();
        let (age_s, carried_s) = (silent_s + most_s, silent_s + likely_s);
        let (standing, role) = if is_member {
            (standing(age_s), Role::Member)
        } else {
            self.peers.get(index(id))?.standing_and_role(now, age_s)
        };
        let Motion { position, velocity, heading_rad } = *motion;
        let position = position + velocity.0 * carried_s;
        let delay_s = delay.map(|delay| delay.most_s);
        Some(PeerEstimate { id, position, velocity, heading_rad, age_s, delay_s, carried_s, standing, role })
    }

    /// The lowest id of an active member in contact, this vehicle included.
    fn lowest(&self) -> VehicleId {
        self.all(Status::ACTIVE).first().map_or(self.own, |lowest| lowest.min(self.own))
    }

    /// Makes the list of near peers.
    fn list_near(&mut self, own: PositionNed, reach_m: f64) -> VehicleSet {
        let mut near = core::mem::take(&mut self.near);
        let estimates = self.estimates().map(|peer| (peer.id, peer.position, peer.velocity));
        let listed = near.make(own, self.now, reach_m, estimates);
        self.near = near;
        listed
    }

    /// Judges the peers that messages have touched, or all of them if a deadline may have passed.
    fn judge(&mut self) {
        let judgement = self.judgement();
        let is_due = self.now >= self.unchanged_until;
        if is_due {
            self.unchanged_until = if self.now < self.lenient_until { self.lenient_until } else { LocalTime::MAX };
            self.near.discard();
        }
        let judged = if is_due { self.known } else { self.touched };
        for id in judged.iter() {
            let Some(peer) = self.peers.get_mut(index(id)) else { continue };
            self.changes.extend(peer.age(&judgement));
            let status = peer.assess(&judgement);
            self.unchanged_until = self.unchanged_until.min(peer.unchanged_until(&judgement));
            if is_due {
                let until = peer.round_trips.choose(self.now);
                self.unchanged_until = self.unchanged_until.min(until.unwrap_or(LocalTime::MAX));
                self.ages[index(id)] = peer.age_basis().unwrap_or_default();
            }
            let differing = core::mem::replace(&mut peer.status, status).differing(status);
            self.revision += u64::from(differing.contains(Status::AGREES));
            if differing.contains(Status::SEEN) {
                self.near.discard();
            }
            for bit in differing.bits() {
                self.with[bit].set(id, status.has(bit));
            }
        }
    }

    #[inline]
    fn receive(&mut self, message: &PeerMessage, at: LocalTime) {
        match message {
            PeerMessage::State(message) => {
                let Some(peer) = self.sender(&message.header) else { return };
                let sequence = message.header.sequence;
                if peer.state.is_some_and(|last| last.sequence >= sequence) {
                    peer.old += 1;
                    return;
                }
                let transit_s = since_stamp_s(at, message.header.stamp);
                peer.state = Some(StateArrival { sequence, at, transit_s });
                let (id, was_young) = (peer.id, peer.status.contains(Status::YOUNG));
                let motion = &mut self.motions[index(id)];
                motion.position = message.position;
                motion.velocity = message.state.velocity;
                motion.heading_rad = message.state.heading_rad;
                self.moved(id);
                self.arrived(id, at, !was_young);
            }
            PeerMessage::Mission(message) => self.receive_heartbeat(message, at),
            PeerMessage::Appeared(id) | PeerMessage::Vanished(id) => {
                if let Some(index) = self.index(*id) {
                    self.peers[index].token = Some(matches!(message, PeerMessage::Appeared(_)));
                    self.known.insert(*id);
                    self.touched.insert(*id);
                }
            }
            // The mission stage handles orders.
            PeerMessage::Order(_) => {}
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
        let last = peer.heartbeat.replace(KeptHeartbeat { sequence, stamp, at, progress_m, agreement });
        let (id, is_changed) = (peer.id, last.map(|last| last.agreement) != Some(agreement));
        self.revision += u64::from(is_changed);
        if let Some(echo) = message.echo.filter(|echo| echo.of == self.own)
            && let Some(round_trip_s) = self.exchange.round_trip_s(at, &echo)
        {
            let until = self.peers[index(id)].round_trips.take(at, since_stamp_s(at, stamp), round_trip_s);
            self.unchanged_until = self.unchanged_until.min(until.unwrap_or(LocalTime::MAX));
            self.moved(id);
        }
        if message.plan != plan || message.order > self.order {
            self.reports.push(Report { id, plan: message.plan, order: message.order });
            self.order = self.order.max(message.order.filter(|_| message.plan == plan));
        }
        self.arrived(id, at, is_changed);
    }

    /// Keeps what follows from a message's arrival. `is_changed` if the message itself may change the peer's status.
    fn arrived(&mut self, id: VehicleId, at: LocalTime, is_changed: bool) {
        let peer = &mut self.peers[index(id)];
        // After this agent was late, the last arrival counts as later than it was, and a new one may be earlier.
        let is_earlier = peer.received_at.replace(at).is_some_and(|before| at < before);
        if is_changed || is_earlier || !peer.status.contains(Status::SETTLED) {
            self.known.insert(id);
            self.touched.insert(id);
        }
    }

    /// Keeps the age's basis of a peer whose state or delay has changed, and lists the peer if it is near.
    #[inline]
    fn moved(&mut self, id: VehicleId) {
        let Some(basis) = self.peers[index(id)].age_basis() else { return };
        self.ages[index(id)] = basis;
        if !self.near.is_right_for(id, self.motions[index(id)].velocity) {
            let estimate = self.estimate(id, true);
            estimate.into_iter().for_each(|peer| self.near.moved(id, peer.position, peer.velocity));
        }
    }

    /// The peer in whose current incarnation this message was sent; the caller compares the sequence numbers.
    #[inline]
    fn sender(&mut self, header: &Header) -> Option<&mut Peer> {
        let Some(index) = self.index(header.sender) else {
            self.forged += 1;
            return None;
        };
        let peer = &mut self.peers[index];
        if header.incarnation < peer.incarnation {
            peer.old += 1;
            return None;
        }
        if header.incarnation > peer.incarnation {
            // A new incarnation numbers its messages from one again.
            peer.begin(header.incarnation);
            self.revision += 1;
            self.touched.insert(peer.id);
            self.known.insert(peer.id);
        }
        Some(peer)
    }

    /// Index of the peer in the table, unless the id is the own one or not of this swarm.
    fn index(&self, id: VehicleId) -> Option<usize> {
        (id != self.own && index(id) < self.peers.len()).then(|| index(id))
    }
}

/// Index of the vehicle in tables in the order of ids.
fn index(id: VehicleId) -> usize {
    usize::from(id.get()) - 1
}

#[cfg(test)]
mod tests;
