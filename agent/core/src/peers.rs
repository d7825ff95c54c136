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

use alloc::vec::Vec;

use skein_common::frame::{Origin, PositionNed, VelocityNed};
use skein_common::id::{Incarnation, VehicleId, VehicleSet};
use skein_common::message::{Echo, Header, Heartbeat, Order, State};
use skein_common::scenario::{Graph, Network};
use skein_common::state::{Membership, PeerStatus, VehicleState};
use skein_common::time::{LocalTime, SenderStamp};

use crate::deadlines::Deadline;
use crate::delay::{Delay, Exchange, MessageDelay, since_stamp_s};

/// A state younger than this is fresh, s.
pub const FRESH_S: f64 = Deadline::StateOld.after_s();
/// Radius of an obstacle at a known position, m.
const OBSTACLE_RADIUS_M: f64 = 8.0;
/// Growth of a silent vehicle's position uncertainty, m/s, and its limit, m.
const OBSTACLE_GROWTH_M_S: f64 = 1.0;
const OBSTACLE_GROWTH_M: f64 = 12.0;

/// A received message with its time of arrival.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Received {
    /// The message.
    pub message: PeerMessage,
    /// Time of arrival by the own clock.
    pub at: LocalTime,
}

/// A message from a peer, the network or an operator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PeerMessage {
    /// A peer's state.
    State(State),
    /// A peer's heartbeat with its agreement state.
    Mission(Heartbeat),
    /// A peer's liveliness token appeared.
    Appeared(VehicleId),
    /// A peer's liveliness token vanished.
    Vanished(VehicleId),
    /// An operator's order, sent by the operator.
    Order(Order),
}

impl PeerMessage {
    /// The sender; `None` for an operator.
    pub fn sender(&self) -> Option<VehicleId> {
        match self {
            Self::State(message) => Some(message.header.sender),
            Self::Mission(message) => Some(message.header.sender),
            Self::Appeared(id) | Self::Vanished(id) => Some(*id),
            Self::Order(_) => None,
        }
    }
}

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

impl PeerEstimate {
    /// Time since the arrival of its last state, s.
    pub fn silent_s(&self) -> f64 {
        self.age_s - self.delay_s.unwrap_or_default()
    }
}

/// The peers as the formation needs them.
#[derive(Clone, Copy, Debug, Default)]
pub struct PeerSummary<'a> {
    /// The peers with a known state that are not out of sight, by id.
    pub estimates: &'a [PeerEstimate],
    /// The active members in contact that are out of sight.
    pub unseen: VehicleSet,
    /// Whether a lost peer that may still be flying has a lower id than every peer in contact. Of two partitions
    /// without contact, this one then flies above.
    pub flies_above: bool,
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

/// The peers stage of one vehicle.
#[derive(Clone, Debug)]
pub struct Peers {
    own: VehicleId,
    roster: u8,
    plan: u64,
    stale_s: f64,
    /// Whether the network graph passes every peer's states.
    receives_all_states: bool,
    known: Vec<Peer>,
    estimates: Vec<PeerEstimate>,
    unseen: VehicleSet,
    flies_above: bool,
    changes: Vec<Change>,
    now: LocalTime,
    /// End of the time in which peers may be silent for longer, because this computer was overloaded.
    lenient_until: LocalTime,
    /// Time of the first update.
    first_update: Option<LocalTime>,
    absent_may_fly: bool,
    exchange: Exchange,
    /// Begin of the time without any peer in contact, after there was one.
    alone_since: Option<LocalTime>,
    forged: u64,
}

#[derive(Clone, Debug)]
struct Peer {
    id: VehicleId,
    incarnation: Incarnation,
    state: Option<ReportedState>,
    mission: Option<Heartbeat>,
    /// Arrival of the newest heartbeat.
    heartbeat_at: LocalTime,
    delay: Delay,
    token: Option<bool>,
    /// Arrival of the newest message of this incarnation.
    received_at: Option<LocalTime>,
    found: bool,
    lost_at: Option<LocalTime>,
    /// Number of its messages that were dropped because a newer one had been received.
    old: u64,
}

/// A state as received.
#[derive(Clone, Copy, Debug)]
struct ReportedState {
    sequence: u64,
    position: PositionNed,
    velocity: VelocityNed,
    heading_rad: f64,
    at: LocalTime,
    /// Arrival by the own clock minus the stamp by the peer's, s.
    transit_s: f64,
}

impl Peers {
    /// The peers of vehicle `own` before any message, in a swarm of vehicles 1 to `roster`. Only a vehicle that flies
    /// the plan with hash `plan` can be a member. States older than `network.peer_stale_s` do not count.
    pub fn new(own: VehicleId, roster: u8, plan: u64, network: &Network) -> Self {
        let (known, estimates, changes) = (Vec::new(), Vec::new(), Vec::new());
        let (stale_s, receives_all_states) = (network.peer_stale_s, network.graph == Graph::All);
        let (unseen, now, lenient_until) = (VehicleSet::default(), LocalTime::ZERO, LocalTime::ZERO);
        let (flies_above, alone_since, forged) = (false, None, 0);
        Self {
            own,
            roster,
            plan,
            stale_s,
            receives_all_states,
            known,
            estimates,
            unseen,
            flies_above,
            changes,
            now,
            lenient_until,
            first_update: None,
            absent_may_fly: true,
            exchange: Exchange::default(),
            alone_since,
            forged,
        }
    }

    /// Reports before the next step that this agent did not run for `for_s`: this time does not count as silence of the
    /// peers, and for a while peers may be silent for longer.
    pub fn did_not_run(&mut self, for_s: f64) {
        for peer in &mut self.known {
            peer.received_at = peer.received_at.map(|at| at.plus_seconds(for_s));
        }
        self.lenient_until = self.now.plus_seconds(for_s + Deadline::LeniencyOver.after_s());
    }

    /// Takes the messages received since the last update and extrapolates all peers to `now`.
    pub fn update(&mut self, now: LocalTime, origin: &Origin, received: &[Received]) {
        let before = core::mem::replace(&mut self.now, now).min(now);
        for received in received {
            // Whatever the clock showed at its arrival, the message arrived between the two updates.
            self.receive(origin, received, received.at.clamp(before, now));
        }
        self.changes.clear();
        self.estimates.clear();
        self.unseen = VehicleSet::default();
        let stale_s = if now < self.lenient_until { 2.0 * self.stale_s } else { self.stale_s };
        for peer in &mut self.known {
            if let Some(change) = peer.age(now, stale_s) {
                self.changes.push(change);
            }
            if self.receives_all_states || peer.is_in_sight(now, stale_s) {
                self.estimates.extend(peer.estimate(now, self.plan, stale_s));
            } else if peer.is_active_member(self.plan) {
                self.unseen.insert(peer.id);
            }
        }
        let members = self.known.iter().filter(|peer| peer.is_active_member(self.plan)).map(|peer| peer.id);
        let lowest = members.fold(self.own, VehicleId::min);
        self.flies_above = self.known.iter().any(|peer| peer.id < lowest && peer.may_still_fly(now));
        let listened_s = now.seconds_since(*self.first_update.get_or_insert(now));
        let found = self.known.iter().filter(|peer| peer.found).count();
        let may_come = found + 1 < usize::from(self.roster) && !Deadline::PeerGivenUp.is_past(listened_s);
        self.absent_may_fly = may_come || self.known.iter().any(|peer| peer.may_return(now));
        let mut met = self.known.iter().filter(|peer| peer.found);
        let any_not_left = met.clone().any(|peer| peer.membership() != Membership::Left);
        let alone = any_not_left && met.all(|peer| peer.lost_at.is_some());
        self.alone_since = if alone { self.alone_since.or(Some(now)) } else { None };
    }

    /// The peers with a known state that are not out of sight, by id.
    pub fn estimates(&self) -> &[PeerEstimate] {
        &self.estimates
    }

    /// The peers as the formation needs them.
    pub fn others(&self) -> PeerSummary<'_> {
        PeerSummary { estimates: &self.estimates, unseen: self.unseen, flies_above: self.flies_above }
    }

    /// The changes of the last update.
    pub fn changes(&self) -> &[Change] {
        &self.changes
    }

    /// The newest heartbeats of all peers in contact, of any plan, by id. No other stage keeps them.
    pub fn heartbeats(&self) -> impl Iterator<Item = &Heartbeat> + Clone {
        self.known.iter().filter(|peer| peer.lost_at.is_none()).filter_map(|peer| peer.mission.as_ref())
    }

    /// The peers in contact: their tokens are present and their last messages young.
    pub fn in_contact(&self) -> VehicleSet {
        self.known.iter().filter(|peer| peer.found && peer.lost_at.is_none()).map(|peer| peer.id).collect()
    }

    /// Whether a vehicle that is not in contact may be flying the mission: it was never in contact, or it was lost
    /// without having left, and neither for longer than a minute.
    pub fn absent_may_fly(&self) -> bool {
        self.absent_may_fly
    }

    /// Whether a peer was lost without having left and no peer is in contact, for less than a minute.
    pub fn all_lost(&self) -> bool {
        self.alone_since.is_some_and(|since| !Deadline::PeerGivenUp.is_past(self.now.seconds_since(since)))
    }

    /// The echo for a heartbeat with this stamp, which is about to be sent.
    pub fn echo(&mut self, stamp: SenderStamp) -> Option<Echo> {
        self.exchange.send(stamp);
        let partners = self.known.iter().filter(|peer| peer.lost_at.is_none() && peer.mission.is_some());
        let of = self.exchange.next_partner(partners.map(|peer| peer.id))?;
        let peer = self.known.iter().find(|peer| peer.id == of)?;
        let held_s = self.now.seconds_since(peer.heartbeat_at).max(0.0);
        // A hold of more than an hour is useless for a measurement; limited to that, it fits the field.
        let held_us = (held_s * 1e6).round().min(3.6e9) as u32;
        Some(Echo { of, stamp: peer.mission?.header.stamp, held_us })
    }

    /// Number of messages dropped because a newer one had been received.
    pub fn old(&self) -> u64 {
        self.old_messages().map(|(_, count)| count).sum()
    }

    /// The same per sender; only senders with any.
    pub fn old_messages(&self) -> impl Iterator<Item = (VehicleId, u64)> {
        self.known.iter().filter(|peer| peer.old > 0).map(|peer| (peer.id, peer.old))
    }

    /// Number of messages dropped because their sender is not in this swarm or claims to be this vehicle.
    pub fn forged(&self) -> u64 {
        self.forged
    }

    fn receive(&mut self, origin: &Origin, received: &Received, at: LocalTime) {
        match received.message {
            PeerMessage::State(message) => {
                let Some(peer) = self.sender(&message.header) else { return };
                let sequence = message.header.sequence;
                if peer.state.is_some_and(|last| last.sequence >= sequence) {
                    peer.old += 1;
                    return;
                }
                let position = origin.ned_from_geodetic(&message.state.position);
                let VehicleState { velocity, heading_rad, .. } = message.state;
                let transit_s = since_stamp_s(at, message.header.stamp);
                peer.state = Some(ReportedState { sequence, position, velocity, heading_rad, at, transit_s });
                peer.received_at = Some(at);
            }
            PeerMessage::Mission(message) => {
                let Some(peer) = self.sender(&message.header) else { return };
                // A heartbeat is repeated to every agent that asks for it.
                if peer.mission == Some(message) {
                    return;
                }
                if peer.mission.is_some_and(|last| last.header.sequence >= message.header.sequence) {
                    peer.old += 1;
                    return;
                }
                (peer.mission, peer.heartbeat_at) = (Some(message), at);
                peer.received_at = Some(at);
                let id = peer.id;
                if let Some(echo) = message.echo.filter(|echo| echo.of == self.own)
                    && let Some(round_trip_s) = self.exchange.round_trip_s(at, &echo)
                    && let Some(peer) = self.member(id)
                {
                    peer.delay.take(at, since_stamp_s(at, message.header.stamp), round_trip_s);
                }
            }
            PeerMessage::Appeared(id) | PeerMessage::Vanished(id) => {
                if let Some(peer) = self.member(id) {
                    peer.token = Some(matches!(received.message, PeerMessage::Appeared(_)));
                }
            }
            // The mission stage handles orders.
            PeerMessage::Order(_) => {}
        }
    }

    /// The peer in whose current incarnation this message was sent; the caller compares the sequence numbers.
    fn sender(&mut self, header: &Header) -> Option<&mut Peer> {
        let Some(index) = self.index(header.sender) else {
            self.forged += 1;
            return None;
        };
        let peer = &mut self.known[index];
        if header.incarnation < peer.incarnation {
            peer.old += 1;
            return None;
        }
        if header.incarnation > peer.incarnation {
            // A new incarnation numbers its messages from one again.
            peer.incarnation = header.incarnation;
            peer.state = None;
            peer.mission = None;
            peer.delay = Delay::default();
        }
        Some(peer)
    }

    fn member(&mut self, id: VehicleId) -> Option<&mut Peer> {
        self.index(id).map(|index| &mut self.known[index])
    }

    /// Index of the peer in the table; a new peer is added.
    fn index(&mut self, id: VehicleId) -> Option<usize> {
        if id == self.own || id.get() > self.roster {
            return None;
        }
        match self.known.binary_search_by_key(&id, |peer| peer.id) {
            Ok(index) => Some(index),
            Err(index) => {
                self.known.insert(index, Peer::unknown(id));
                Some(index)
            }
        }
    }
}

impl Peer {
    fn unknown(id: VehicleId) -> Self {
        Self {
            id,
            incarnation: Incarnation::default(),
            state: None,
            mission: None,
            heartbeat_at: LocalTime::ZERO,
            delay: Delay::default(),
            token: None,
            received_at: None,
            found: false,
            lost_at: None,
            old: 0,
        }
    }

    fn membership(&self) -> Membership {
        self.mission.map_or(Membership::Joining, |message| message.membership)
    }

    /// Updates whether the peer is lost; returns a change to be reported.
    fn age(&mut self, now: LocalTime, stale_s: f64) -> Option<Change> {
        let received_at = self.received_at?;
        let gone = self.token == Some(false) || Deadline::PeerLost(stale_s).is_past(now.seconds_since(received_at));
        if gone && self.lost_at.is_none() {
            self.lost_at = Some(now);
            // A peer that left the swarm on purpose is not reported as lost.
            (self.membership() != Membership::Left).then_some(Change::Lost(self.id))
        } else if !gone && (self.lost_at.is_some() || !self.found) {
            self.lost_at = None;
            self.found = true;
            Some(Change::Found(self.id))
        } else {
            None
        }
    }

    /// Whether the peer is in contact and an active member that flies this plan.
    fn is_active_member(&self, plan: u64) -> bool {
        let is_received = self.found && self.lost_at.is_none();
        is_received
            && self.mission.is_some_and(|message| message.plan == plan && message.membership == Membership::Active)
    }

    /// Whether its state is young, or was until the peer was lost.
    fn is_in_sight(&self, now: LocalTime, stale_s: f64) -> bool {
        let Some(last) = self.state else { return false };
        match self.lost_at {
            None => !Deadline::NeighbourSilent(stale_s).is_past(now.seconds_since(last.at)),
            // The last message may be a little younger than the last state.
            Some(lost_at) => lost_at.seconds_since(last.at) <= stale_s + FRESH_S,
        }
    }

    fn estimate(&self, now: LocalTime, plan: u64, stale_s: f64) -> Option<PeerEstimate> {
        let last = self.state?;
        let silent_s = now.seconds_since(last.at).max(0.0);
        let message_delay = self.delay.of(now, last.transit_s);
        let delay_s = message_delay.map(|message_delay| message_delay.most_s);
        let MessageDelay { most_s, likely_s } = message_delay.unwrap_or_default();
        let (age_s, carried_s) = (silent_s + most_s, silent_s + likely_s);
        let standing = match self.lost_at {
            Some(_) => PeerStatus::Lost,
            None if Deadline::StateOld.is_past(age_s) => PeerStatus::Stale,
            None => PeerStatus::Fresh,
        };
        let flies_along = !Deadline::NeighbourSilent(stale_s).is_past(silent_s)
            && self.mission.is_some_and(|message| message.plan == plan);
        let role = match (self.membership(), self.lost_at) {
            (Membership::Active, None) if flies_along => Role::Member,
            (_, Some(lost_at)) if Deadline::ObstacleGone.is_past(now.seconds_since(lost_at)) => Role::Nothing,
            _ => {
                let unknown_m = (OBSTACLE_GROWTH_M_S * age_s).min(OBSTACLE_GROWTH_M);
                Role::Obstacle { radius_m: OBSTACLE_RADIUS_M + unknown_m }
            }
        };
        let position = last.position + last.velocity.0 * carried_s;
        let ReportedState { velocity, heading_rad, .. } = last;
        Some(PeerEstimate { id: self.id, position, velocity, heading_rad, age_s, delay_s, carried_s, standing, role })
    }

    /// Whether the peer was lost as an active member and may still be flying the mission.
    fn may_still_fly(&self, now: LocalTime) -> bool {
        self.membership() == Membership::Active && self.may_return(now)
    }

    /// Whether the peer was lost without having left, less than a minute ago.
    fn may_return(&self, now: LocalTime) -> bool {
        let is_recent = |lost_at: LocalTime| !Deadline::PeerGivenUp.is_past(now.seconds_since(lost_at));
        self.membership() != Membership::Left && self.lost_at.is_some_and(is_recent)
    }
}

#[cfg(test)]
mod tests;
