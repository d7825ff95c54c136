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
//! Any message keeps a peer in contact; only a state younger than T_stale keeps it in the formation. A peer that reports this
//! vehicle as lost does not receive it, and plans without it: it is an obstacle that this vehicle alone avoids. Where
//! `network.graph` withholds a peer's states, that peer is out of sight as long as its heartbeats arrive: it is not an
//! obstacle, and both still agree on the mission. All durations are in [`crate::deadlines`].
//!
//! A step looks at the messages that have arrived and at the near peers, not at every peer. A message changes the
//! record of its sender. The status of a peer is judged again only after a message that can change it, or after the
//! earliest time at which a deadline can. What other stages ask often is kept as sets of vehicles, and states are
//! extrapolated only for the peers within the law's reach (`near.rs`). The tests hold this bookkeeping against one that
//! judges every peer at every step.
//!
//! What follows from the messages alone, whichever vehicle has received them, is in the records (`records.rs`): agents of
//! one process that have received the same can share them ([`SharedRecords`]). What depends on this vehicle is here: its
//! round trips, the peers near it, and that it is not a peer of its own.

mod arrival;
mod column;
mod inbox;
mod message;
mod messages;
mod near;
mod news;
mod peer;
mod recent;
mod records;
mod shared;
mod timeout;

use alloc::sync::Arc;
use alloc::vec;
use alloc::vec::Vec;

use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::{Echo, Order};
use skein_common::scenario::Network;
use skein_common::state::{Membership, PeerStatus};
use skein_common::time::{LocalTime, SenderStamp};

use crate::deadlines::Deadline;
use crate::delay::{DelayBase, Exchange, MessageDelay, RoundTripTable};
pub use arrival::{Arrival, Spread};
pub use column::Parcel;
pub use inbox::SwarmInbox;
pub use message::{PeerMessage, Received, ReceivedState};
use near::{Extrapolated, NearList};
use peer::{Agreed, KeptHeartbeat, Motion, Status, standing};
pub use peer::{FRESH_S, MAX_OBSTACLE_RADIUS_M};
use records::{Records, TripChange};
pub use shared::{Broadcast, SharedRecords};

/// The estimated current state of a peer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeerEstimate {
    /// The peer's id.
    pub id: VehicleId,
    /// Its last position, extrapolated at constant velocity.
    pub position: PositionNed,
    /// Its velocity as last received.
    pub velocity: VelocityNed,
    /// Its heading as last received, in the swarm's frame, rad.
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

/// The peers as the formation needs them.
#[derive(Clone, Copy, Debug, Default)]
pub struct PeerSummary<Estimates> {
    /// Estimates of the peers within the law's reach, by id.
    pub near: Estimates,
    /// All live members of the formation, this vehicle excluded.
    pub members: VehicleSet,
    /// Whether the own partition flies above another one ([`Peers::flies_above`]).
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

impl Change {
    /// The peer.
    fn id(&self) -> VehicleId {
        match *self {
            Self::Found(id) | Self::Lost(id) => id,
        }
    }
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
    /// The records of all vehicles from which a message was received. Records that other agents share contain the own messages too.
    records: Arc<Records>,
    /// The round trips to each peer, and the delays that they give.
    trips: RoundTripTable,
    delays: Vec<DelayBase>,
    /// The largest of all delays so far.
    largest_delay: DelayBase,
    /// A time before which no round trip becomes too old.
    trips_valid_until: LocalTime,
    near: NearList,
    /// [`Records::sightings`] when the list of near peers was last right.
    sightings: u64,
    exchange: Exchange,
    /// Begin of the time without any peer in contact, after there was one.
    alone_since: Option<LocalTime>,
    /// Number of messages with the own id as their sender.
    forged: u64,
}

impl Peers {
    /// The peers of vehicle `own` before any message, in a swarm of vehicles 1 to `roster`. Only a vehicle that flies
    /// the plan with hash `plan` can be a member. States older than `network.peer_stale_s` do not count.
    pub fn new(own: VehicleId, roster: u8, plan: u64, network: &Network) -> Self {
        Self {
            own,
            records: Arc::new(Records::new(roster, plan, network)),
            trips: RoundTripTable::default(),
            delays: vec![DelayBase::UNKNOWN; roster.into()],
            largest_delay: DelayBase::UNKNOWN,
            trips_valid_until: LocalTime::MAX,
            near: NearList::default(),
            sightings: 0,
            exchange: Exchange::default(),
            alone_since: None,
            forged: 0,
        }
    }

    /// Reports before the next step that this agent did not run for `for_s`: this time does not count as silence of the
    /// peers, and for a while peers may be silent for longer (`timeout.rs`).
    pub fn did_not_run(&mut self, for_s: f64) {
        Arc::make_mut(&mut self.records).did_not_run(for_s);
    }

    /// Reads the messages from the inbox of the whole swarm, which [`Broadcast::inbox`] has in each step from the first on.
    pub fn share_inbox(&mut self) {
        Arc::make_mut(&mut self.records).share_inbox(self.own);
    }

    /// Lets go of the inbox after a step, so that the next frame's messages can be put into it.
    pub fn release_inbox(&mut self) {
        Arc::make_mut(&mut self.records).release_inbox();
    }

    /// Takes the messages received since the last update.
    pub fn update(&mut self, now: LocalTime, received: &[Received], broadcast: Broadcast<'_>) {
        if let Some(inbox) = broadcast.inbox {
            Arc::make_mut(&mut self.records).update_from(now, inbox);
            self.end_update(now);
            return;
        }
        let shared = broadcast.records.filter(|_| received.is_empty());
        let following = shared.and_then(|shared| shared.following(&self.records, now));
        if let Some(records) = following.filter(|records| !records.differ_for(self.own)) {
            self.records = Arc::clone(records);
        } else {
            let is_own = |message: &PeerMessage| message.sender() == Some(self.own);
            let forged = received.iter().filter(|received| is_own(&received.message) && received.message.is_numbered());
            self.forged += forged.count() as u64;
            let received = received.iter().map(|received| (&received.message, received.at));
            let broadcast = broadcast.messages.iter().map(|message| (message, now));
            let of_others = received.chain(broadcast).filter(|(message, _)| !is_own(message));
            let records = Arc::make_mut(&mut self.records);
            records.leave_out(self.own);
            records.update(now, of_others);
        }
        self.end_update(now);
    }

    fn end_update(&mut self, now: LocalTime) {
        let timed = self.update_trips(now);
        self.update_near(timed);
        let alone = !self.all(Status::REMAINS).is_empty() && self.in_contact().is_empty();
        self.alone_since = if alone { self.alone_since.or(Some(now)) } else { None };
    }

    /// The estimated current states of all peers that are not out of sight, by id.
    pub fn estimates(&self) -> impl Iterator<Item = PeerEstimate> {
        self.estimates_of(self.all(Status::SEEN))
    }

    /// The peers in contact whose newest state arrived less than [`FRESH_S`] ago, however long it was in flight.
    pub fn fresh(&self) -> VehicleSet {
        self.records.fresh().both(self.all(Status::SEEN)).both(self.in_contact())
    }

    /// The ages of the newest states of those of these peers that are in contact and not out of sight, by id.
    pub fn ages(&self, of: VehicleSet) -> impl Iterator<Item = PeerStateAge> {
        let now = self.records.now;
        let received = of.both(self.all(Status::SEEN)).both(self.in_contact());
        received.iter().filter_map(move |id| {
            let Motion { at, excess, .. } = self.records.messages.motion(id)?;
            let silent_s = now.seconds_since(at).max(0.0);
            let delay_s = self.delays.get(index(id))?.at_arrival(excess).most_s(silent_s);
            Some(PeerStateAge { id, age_s: silent_s + delay_s.unwrap_or_default(), delay_s })
        })
    }

    /// The peers as the formation needs them: the estimates of those within `reach_m` of the own position, horizontally.
    pub fn near(&mut self, own: PositionNed, reach_m: f64) -> PeerSummary<impl Iterator<Item = PeerEstimate>> {
        let seen = self.all(Status::SEEN);
        let near = if reach_m.is_finite() {
            self.near.valid(own, self.records.now, reach_m).unwrap_or_else(|| self.list_near(own, reach_m))
        } else {
            seen
        };
        PeerSummary {
            // Without the filter the output would depend on when the list was made, in its last digits.
            near: self.estimates_of(near.both(seen)).filter(move |peer| {
                let from_own_ne_m = (peer.position - own).xy();
                from_own_ne_m.norm_squared() <= reach_m * reach_m
            }),
            members: self.members(),
            flies_above: self.flies_above(),
        }
    }

    /// All live members of the formation, this vehicle excluded.
    pub fn members(&self) -> VehicleSet {
        self.all(Status::MEMBER).either(self.all(Status::UNSEEN)).without(self.received_one_way())
    }

    /// The peers lost as active members less than a minute ago: they may still be flying the mission.
    pub fn lost(&self) -> VehicleSet {
        self.all(Status::MAY_FLY)
    }

    /// Whether the own partition flies above another one of which a vehicle may be flying. Contact is mutual: a partition is
    /// this vehicle and the peers that receive it and that it receives. Partitions fly the mission each for itself, and the
    /// one with the lowest id keeps its altitude. The ids of vehicles that have landed count on both sides: a vehicle may land
    /// before or after the partitions lose each other, and both have to come to the same result.
    pub fn flies_above(&self) -> bool {
        let one_way = self.received_one_way();
        let may_fly = self.lost().either(self.all(Status::ACTIVE).both(one_way));
        let together = self.all(Status::AGREES).without(one_way);
        let lowest = together.first().map_or(self.own, |lowest| lowest.min(self.own));
        let apart = self.all(Status::LOST_LATELY).either(one_way);
        !may_fly.is_empty() && apart.first().is_some_and(|apart| apart < lowest)
    }

    /// The changes of the last update, by id.
    pub fn changes(&self) -> impl Iterator<Item = Change> {
        let own = self.own;
        self.records.changes.iter().copied().filter(move |change| change.id() != own)
    }

    /// The orders and the plans that differ in the heartbeats of the last update, by sender.
    pub fn reports(&self) -> impl Iterator<Item = &Report> {
        self.records.reports.iter().filter(|report| report.id != self.own)
    }

    /// The orders that operators have sent, of the last update.
    pub fn orders(&self) -> &[Order] {
        &self.records.orders
    }

    /// Whether every member in contact has repeated this setting or a later one of its key.
    pub fn all_know(&self, setting: &Order) -> bool {
        self.members().without(self.records.know(setting)).is_empty()
    }

    /// A number that changes whenever the part of [`Self::heartbeats`] on which the agreement depends may have changed:
    /// everything but the centre's progress.
    pub fn revision(&self) -> u64 {
        self.records.revision
    }

    /// The newest heartbeats of all peers in contact that fly the same plan, by id. No other stage keeps them.
    pub fn heartbeats(&self) -> impl Iterator<Item = PeerProgress> + Clone {
        self.all(Status::AGREES).iter().filter_map(|id| {
            let KeptHeartbeat { progress_m, agreement, .. } = self.records.messages.heartbeat(id)?;
            let Agreed { membership, step, vouched, reached, .. } = agreement;
            Some(PeerProgress { id, membership, step, vouched, reached, progress_m })
        })
    }

    /// The peers in contact: their tokens are present and their last messages young.
    pub fn in_contact(&self) -> VehicleSet {
        self.all(Status::IN_CONTACT)
    }

    /// Whether a vehicle that is not in contact may be flying the mission: it was never in contact, or it was lost
    /// without having left, and neither for longer than a minute.
    pub fn absent_may_fly(&self) -> bool {
        let listened_s = self.records.first_update.map_or(0.0, |first| self.records.now.seconds_since(first));
        let is_complete = self.all(Status::FOUND).len() + 1 >= self.records.roster();
        let may_come = !is_complete && !Deadline::PeerGivenUp.is_past(listened_s);
        may_come || !self.all(Status::MAY_RETURN).is_empty()
    }

    /// Whether a peer was lost without having left and no peer is in contact, for less than a minute.
    pub fn all_lost(&self) -> bool {
        let now = self.records.now;
        self.alone_since.is_some_and(|since| !Deadline::PeerGivenUp.is_past(now.seconds_since(since)))
    }

    /// The echo for a heartbeat with this stamp, which is about to be sent.
    pub fn echo(&mut self, stamp: SenderStamp) -> Option<Echo> {
        self.exchange.send(stamp);
        let of = self.exchange.next_partner(self.all(Status::CORRESPONDS))?;
        let KeptHeartbeat { stamp, at, .. } = self.records.messages.heartbeat(of)?;
        let held_s = self.records.now.seconds_since(at).max(0.0);
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
        self.records
            .peers()
            .filter(|(id, peer)| peer.old > 0 && *id != self.own)
            .map(|(id, peer)| (id, peer.old.into()))
    }

    /// Number of messages dropped because their sender is not in this swarm or claims to be this vehicle.
    pub fn forged(&self) -> u64 {
        self.records.forged + self.forged
    }

    /// Time from the sending to the arrival of a peer's newest state, s, where the inbox of the swarm knows it.
    pub fn latency_s(&self, peer: VehicleId) -> Option<f64> {
        self.records.messages.latency_s(peer)
    }

    /// The peers with a kind of status.
    fn all(&self, status: Status) -> VehicleSet {
        let mut peers = self.records.all(status);
        peers.remove(self.own);
        peers
    }

    /// The estimated current states of these peers, of which each has a state, by id.
    #[inline]
    fn estimates_of(&self, ids: VehicleSet) -> impl Iterator<Item = PeerEstimate> {
        let members = self.all(Status::MEMBER).without(self.received_one_way());
        ids.iter().filter_map(move |id| self.estimate(id, members.contains(id)))
    }

    #[inline]
    fn estimate(&self, id: VehicleId, is_member: bool) -> Option<PeerEstimate> {
        let motion = self.records.messages.motion(id)?;
        let Motion { position, velocity, heading_rad, .. } = motion;
        let (silent_s, delay) = self.silent_s_and_delay(id, &motion);
        let MessageDelay { most_s, likely_s } = delay.unwrap_or_default();
        let (age_s, carried_s) = (silent_s + most_s, silent_s + likely_s);
        let (standing, role) = if is_member {
            (standing(age_s), Role::Member)
        } else {
            self.records.peer(id)?.standing_and_role(self.records.now, age_s)
        };
        let position = position + velocity.0 * carried_s;
        let delay_s = delay.map(|delay| delay.most_s);
        Some(PeerEstimate { id, position, velocity, heading_rad, age_s, delay_s, carried_s, standing, role })
    }

    /// Time since the arrival of a peer's newest state, s, and the state's delay; `None` until a round trip is known.
    #[inline]
    fn silent_s_and_delay(&self, id: VehicleId, motion: &Motion) -> (f64, Option<MessageDelay>) {
        let silent_s = self.records.now.seconds_since(motion.at).max(0.0);
        let base = self.delays.get(index(id));
        (silent_s, base.and_then(|base| base.at_arrival(motion.excess).after(silent_s)))
    }

    /// The peers in contact that report this vehicle as lost: it receives them, and they do not receive it.
    fn received_one_way(&self) -> VehicleSet {
        self.records.that_lost(self.own)
    }

    /// Makes the list of near peers.
    fn list_near(&mut self, own: PositionNed, reach_m: f64) -> VehicleSet {
        let mut near = core::mem::take(&mut self.near);
        let extrapolated = |peer: PeerEstimate| {
            let PeerEstimate { id, position, velocity, carried_s, .. } = peer;
            Extrapolated { id, position, velocity, carried_s, travelled_m: self.records.travelled_m(id) }
        };
        let estimates = self.estimates().map(extrapolated);
        let listed = near.make(own, self.records.now, reach_m, self.records.travel(self.largest_delay), estimates);
        self.near = near;
        listed
    }

    /// Takes the round trips that the last update has ended. Returns the peers whose delay has changed by them.
    fn update_trips(&mut self, now: LocalTime) -> VehicleSet {
        let mut timed = VehicleSet::default();
        for change in self.records.trip_changes(self.own) {
            match *change {
                TripChange::Restarted(id) => {
                    self.trips.forget(id);
                    self.delays[index(id)] = DelayBase::UNKNOWN;
                }
                TripChange::Echoed { sender, at, transit_s, echo } if echo.of == self.own => {
                    let Some(round_trip_s) = self.exchange.round_trip_s(at, &echo) else { continue };
                    let mut trips = self.trips.to(sender);
                    trips.take(at, transit_s, round_trip_s);
                    self.trips.set(sender, &trips, at);
                    let (base, until) = trips.choose(at);
                    self.delays[index(sender)] = base;
                    self.largest_delay = self.largest_delay.max(base);
                    self.trips_valid_until = self.trips_valid_until.min(until);
                    timed.insert(sender);
                }
                TripChange::Echoed { .. } => {}
            }
        }
        if now >= self.trips_valid_until {
            self.trips_valid_until = LocalTime::MAX;
            for (peer, delay) in VehicleId::first(self.delays.len()).zip(&mut self.delays) {
                let (base, until) = self.trips.to(peer).choose(now);
                *delay = base;
                self.largest_delay = self.largest_delay.max(base);
                self.trips_valid_until = self.trips_valid_until.min(until);
            }
            self.near.discard();
        }
        timed
    }

    /// Keeps the list of near peers right after an update in which the delays of these vehicles have changed.
    fn update_near(&mut self, timed: VehicleSet) {
        let Records { sightings, sighted, .. } = *self.records;
        let since = sightings.wrapping_sub(core::mem::replace(&mut self.sightings, sightings));
        // Only those of the last update are known.
        if since > u64::from(!sighted.is_empty()) {
            self.near.discard();
        }
        let far = self.near.far(self.records.now, self.records.travel(self.largest_delay));
        for id in self.records.moved.either(sighted).without(far).either(timed).iter().filter(|id| *id != self.own) {
            let Some(reported) = self.records.messages.reported(id) else { continue };
            let carried_s = || {
                let motion = self.records.messages.motion(id).unwrap_or_default();
                let (silent_s, delay) = self.silent_s_and_delay(id, &motion);
                silent_s + delay.unwrap_or_default().likely_s
            };
            if !self.near.is_right_for(id, reported, carried_s) {
                let estimate = self.estimate(id, true);
                estimate.into_iter().for_each(|peer| self.near.moved(id, peer.position, peer.velocity));
            }
        }
    }
}

/// Index of the vehicle in tables in the order of ids.
fn index(id: VehicleId) -> usize {
    usize::from(id.get()) - 1
}

#[cfg(test)]
mod tests;
