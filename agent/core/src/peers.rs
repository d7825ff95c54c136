//! The last word of each peer, carried forward to now.
//!
//! A peer's age is judged by the own clock alone, the order of its words by its own sequence numbers and incarnation. What
//! arrives late, twice, from an earlier life or in somebody else's name is counted and changes nothing. Messages are ordered
//! here, once, when they arrive, and only here their contents are kept: the later stages read the newest state and the newest
//! heartbeat of each peer.
//!
//! The age of a state is an upper bound: the time since it came and the longest time that it can have been on its way
//! ([`crate::delay`]). Until the first round trip the age is the time since it came alone, and the delay is marked as unknown.
//! T_stale counts only the silence, not the delay: a swarm flies over a link that takes longer than T_stale, on old states, and
//! its status says so. A state is carried forward from when it was most likely sent.
//!
//! ```text
//!        age above 0.5 s        no word for T_stale, or token gone          10 s later
//!   Fresh ----------------> Stale ------------------------------> Lost ----------------------> no obstacle
//!     ^                       |                                     |
//!     +------ a state --------+----------- a word, token there -----+
//! ```
//!
//! Any word keeps a peer from being lost; only a state younger than T_stale keeps it in the formation. Where the scenario
//! keeps states from a vehicle (`network.graph`), a peer that it still hears otherwise is no obstacle then: it is out of
//! sight, and the two agree on the mission all the same. All durations stand in [`crate::deadlines`].

use alloc::vec::Vec;

use skein_common::frame::{Origin, PositionNed, VelocityNed};
use skein_common::id::{Incarnation, VehicleId, VehicleSet};
use skein_common::message::{Echo, Header, Mission, Order, State};
use skein_common::scenario::{Graph, Network};
use skein_common::state::{Membership, Standing, VehicleState};
use skein_common::time::{LocalTime, SenderStamp};

use crate::deadlines::Deadline;
use crate::delay::{Delay, Exchange, Way, since_stamp_s};

/// A state younger than this is fresh, s.
pub const FRESH_S: f64 = Deadline::StateOld.after_s();
/// Radius of an obstacle whose place is known, m.
const OBSTACLE_RADIUS_M: f64 = 8.0;
/// How fast what is not known of a silent vehicle's place grows, m/s, and how far.
const OBSTACLE_GROWTH_M_S: f64 = 1.0;
const OBSTACLE_GROWTH_M: f64 = 12.0;

/// Something heard, and when.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heard {
    /// What.
    pub word: Word,
    /// When it arrived here.
    pub at: LocalTime,
}

/// What can be heard.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Word {
    /// A peer's state.
    State(State),
    /// A peer's part in the agreement.
    Mission(Mission),
    /// A peer's liveliness token appeared.
    Appeared(VehicleId),
    /// It vanished.
    Vanished(VehicleId),
    /// An operator's order, from the operator.
    Order(Order),
}

impl Word {
    /// Who says it; `None` for an operator.
    pub fn speaker(&self) -> Option<VehicleId> {
        match self {
            Self::State(said) => Some(said.header.sender),
            Self::Mission(said) => Some(said.header.sender),
            Self::Appeared(id) | Self::Vanished(id) => Some(*id),
            Self::Order(_) => None,
        }
    }
}

/// A peer as it is thought to be now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Who.
    pub id: VehicleId,
    /// Its last word carried forward at constant velocity.
    pub position: PositionNed,
    /// As last heard.
    pub velocity: VelocityNed,
    /// As last heard, clockwise from true north, rad.
    pub heading_rad: f64,
    /// Upper bound of the age of its last state, s: the delay is included once it is known.
    pub age_s: f64,
    /// Upper bound of the time that this state was on its way, s; `None` until a round trip is known.
    pub delay_s: Option<f64>,
    /// The most likely age of this state, s: it is carried forward for so long.
    pub carried_s: f64,
    /// How that word stands.
    pub standing: Standing,
    /// What it is to the own formation.
    pub role: Role,
}

impl Seen {
    /// The time since its last state came, s.
    pub fn silent_s(&self) -> f64 {
        self.age_s - self.delay_s.unwrap_or_default()
    }
}

/// What the formation has to know of the others.
#[derive(Clone, Copy, Debug, Default)]
pub struct Others<'a> {
    /// Everybody whose state was ever heard and who is not out of sight, by id.
    pub seen: &'a [Seen],
    /// Those who are heard, take part and are out of sight.
    pub unseen: VehicleSet,
    /// Somebody is missed who may go on with the mission, unheard, and whose id is smaller than that of anybody who is not:
    /// of two parts that do not hear each other, this one flies above.
    pub flies_above: bool,
}

/// What a peer is to the own formation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Role {
    /// Part of it.
    Member,
    /// To be kept away from.
    Obstacle {
        /// How far around its place it may be, m.
        radius_m: f64,
    },
    /// On the ground or long gone.
    Nothing,
}

/// A change worth telling.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// Heard for the first time, or again.
    Found(VehicleId),
    /// Lost.
    Lost(VehicleId),
}

/// Everything known of the others.
#[derive(Clone, Debug)]
pub struct Peers {
    own: VehicleId,
    roster: u8,
    plan: u64,
    stale_s: f64,
    /// Every peer's states are meant to be heard.
    sees_all: bool,
    known: Vec<Peer>,
    seen: Vec<Seen>,
    unseen: VehicleSet,
    flies_above: bool,
    changes: Vec<Change>,
    now: LocalTime,
    /// Until then this computer is taken for one that does not keep up.
    lenient_until: LocalTime,
    /// The first update.
    began: Option<LocalTime>,
    misses_any: bool,
    exchange: Exchange,
    /// Since when nobody is heard who was.
    alone_since: Option<LocalTime>,
    forged: u64,
}

#[derive(Clone, Debug)]
struct Peer {
    id: VehicleId,
    incarnation: Incarnation,
    state: Option<Told>,
    mission: Option<Mission>,
    /// When the last register came.
    mission_at: LocalTime,
    delay: Delay,
    token: Option<bool>,
    /// When any word of this life was heard last.
    heard_at: Option<LocalTime>,
    found: bool,
    lost_at: Option<LocalTime>,
    /// Of its words, those that were dropped because a later one was already heard.
    old: u64,
}

/// A state as it was told.
#[derive(Clone, Copy, Debug)]
struct Told {
    sequence: u64,
    position: PositionNed,
    velocity: VelocityNed,
    heading_rad: f64,
    at: LocalTime,
    /// Arrival by the own clock less the stamp by the peer's, s.
    transit_s: f64,
}

impl Peers {
    /// Nobody heard yet in a swarm of vehicles 1 to `roster`. Only who flies the plan with hash `plan` can be a member. A
    /// word older than `network.peer_stale_s` counts for nothing.
    pub fn new(own: VehicleId, roster: u8, plan: u64, network: &Network) -> Self {
        let (known, seen, changes) = (Vec::new(), Vec::new(), Vec::new());
        let (stale_s, sees_all) = (network.peer_stale_s, network.graph == Graph::All);
        let (unseen, now, lenient_until) = (VehicleSet::default(), LocalTime::ZERO, LocalTime::ZERO);
        let (flies_above, alone_since, forged) = (false, None, 0);
        Self {
            own,
            roster,
            plan,
            stale_s,
            sees_all,
            known,
            seen,
            unseen,
            flies_above,
            changes,
            now,
            lenient_until,
            began: None,
            misses_any: true,
            exchange: Exchange::default(),
            alone_since,
            forged,
        }
    }

    /// This agent itself did not run for so long before its next step: no peer counts as silent for that time, and for a while
    /// a peer may be silent for longer.
    pub fn did_not_run(&mut self, for_s: f64) {
        for peer in &mut self.known {
            peer.heard_at = peer.heard_at.map(|at| at.plus_seconds(for_s));
        }
        self.lenient_until = self.now.plus_seconds(for_s + Deadline::LeniencyOver.after_s());
    }

    /// Takes up what was heard since the last update and carries everybody forward to `now`.
    pub fn update(&mut self, now: LocalTime, origin: &Origin, heard: &[Heard]) {
        let before = core::mem::replace(&mut self.now, now).min(now);
        for heard in heard {
            // Whatever the clock said when it came: it came between the two updates.
            self.hear(origin, heard, heard.at.clamp(before, now));
        }
        self.changes.clear();
        self.seen.clear();
        self.unseen = VehicleSet::default();
        let stale_s = if now < self.lenient_until { 2.0 * self.stale_s } else { self.stale_s };
        for peer in &mut self.known {
            if let Some(change) = peer.age(now, stale_s) {
                self.changes.push(change);
            }
            if self.sees_all || peer.is_in_sight(now, stale_s) {
                self.seen.extend(peer.seen(now, self.plan, stale_s));
            } else if peer.takes_part(self.plan) {
                self.unseen.insert(peer.id);
            }
        }
        let members = self.known.iter().filter(|peer| peer.takes_part(self.plan)).map(|peer| peer.id);
        let lowest = members.fold(self.own, VehicleId::min);
        self.flies_above = self.known.iter().any(|peer| peer.id < lowest && peer.is_missed(now));
        let listened_s = now.seconds_since(*self.began.get_or_insert(now));
        let found = self.known.iter().filter(|peer| peer.found).count();
        let may_come = found + 1 < usize::from(self.roster) && !Deadline::PeerGivenUp.is_past(listened_s);
        self.misses_any = may_come || self.known.iter().any(|peer| peer.may_come_back(now));
        let mut met = self.known.iter().filter(|peer| peer.found);
        let missed = met.clone().any(|peer| peer.membership() != Membership::Left);
        let alone = missed && met.all(|peer| peer.lost_at.is_some());
        self.alone_since = if alone { self.alone_since.or(Some(now)) } else { None };
    }

    /// Everybody whose state was ever heard and who is not out of sight, by id.
    pub fn seen(&self) -> &[Seen] {
        &self.seen
    }

    /// The same and what else the formation has to know.
    pub fn others(&self) -> Others<'_> {
        Others { seen: &self.seen, unseen: self.unseen, flies_above: self.flies_above }
    }

    /// What the last update changed.
    pub fn changes(&self) -> &[Change] {
        &self.changes
    }

    /// The newest heartbeats of all peers in contact, whatever plan they fly, by id. No other stage keeps them.
    pub fn missions(&self) -> impl Iterator<Item = &Mission> + Clone {
        self.known.iter().filter(|peer| peer.lost_at.is_none()).filter_map(|peer| peer.mission.as_ref())
    }

    /// Those who count as heard: their tokens are there and their last words young.
    pub fn heard(&self) -> VehicleSet {
        self.known.iter().filter(|peer| peer.found && peer.lost_at.is_none()).map(|peer| peer.id).collect()
    }

    /// A vehicle that is not heard may be flying the mission: it was never heard, or lost and had not left, and that no longer
    /// than a minute ago.
    pub fn misses_any(&self) -> bool {
        self.misses_any
    }

    /// Somebody was lost who had not left of its own will, nobody is heard any more, and that is news.
    pub fn all_lost(&self) -> bool {
        self.alone_since.is_some_and(|since| !Deadline::PeerGivenUp.is_past(self.now.seconds_since(since)))
    }

    /// A heartbeat with this stamp goes out: the echo that belongs into it.
    pub fn echo(&mut self, stamp: SenderStamp) -> Option<Echo> {
        self.exchange.send(stamp);
        let partners = self.known.iter().filter(|peer| peer.lost_at.is_none() && peer.mission.is_some());
        let of = self.exchange.next_partner(partners.map(|peer| peer.id))?;
        let peer = self.known.iter().find(|peer| peer.id == of)?;
        let held_s = self.now.seconds_since(peer.mission_at).max(0.0);
        // A hold of more than an hour measures nothing; cut there, it fits the field.
        let held_us = (held_s * 1e6).round().min(3.6e9) as u32;
        Some(Echo { of, stamp: peer.mission?.header.stamp, held_us })
    }

    /// Words dropped because a later one was already heard.
    pub fn old(&self) -> u64 {
        self.old_words().map(|(_, count)| count).sum()
    }

    /// The same by who had said them, where there are any.
    pub fn old_words(&self) -> impl Iterator<Item = (VehicleId, u64)> {
        self.known.iter().filter(|peer| peer.old > 0).map(|peer| (peer.id, peer.old))
    }

    /// Words dropped because their speaker is not of this swarm, or is said to be this very vehicle.
    pub fn forged(&self) -> u64 {
        self.forged
    }

    fn hear(&mut self, origin: &Origin, heard: &Heard, at: LocalTime) {
        match heard.word {
            Word::State(said) => {
                let Some(peer) = self.speaker(&said.header) else { return };
                let sequence = said.header.sequence;
                if peer.state.is_some_and(|told| told.sequence >= sequence) {
                    peer.old += 1;
                    return;
                }
                let position = origin.ned_from_geodetic(&said.state.position);
                let VehicleState { velocity, heading_rad, .. } = said.state;
                let transit_s = since_stamp_s(at, said.header.stamp);
                peer.state = Some(Told { sequence, position, velocity, heading_rad, at, transit_s });
                peer.heard_at = Some(at);
            }
            Word::Mission(said) => {
                let Some(peer) = self.speaker(&said.header) else { return };
                // A register is told again to whoever asks for it.
                if peer.mission == Some(said) {
                    return;
                }
                if peer.mission.is_some_and(|told| told.header.sequence >= said.header.sequence) {
                    peer.old += 1;
                    return;
                }
                (peer.mission, peer.mission_at) = (Some(said), at);
                peer.heard_at = Some(at);
                let id = peer.id;
                if let Some(echo) = said.echo.filter(|echo| echo.of == self.own)
                    && let Some(round_trip_s) = self.exchange.round_trip_s(at, &echo)
                    && let Some(peer) = self.member(id)
                {
                    peer.delay.take(at, since_stamp_s(at, said.header.stamp), round_trip_s);
                }
            }
            Word::Appeared(id) | Word::Vanished(id) => {
                if let Some(peer) = self.member(id) {
                    peer.token = Some(matches!(heard.word, Word::Appeared(_)));
                }
            }
            // The mission takes it up.
            Word::Order(_) => {}
        }
    }

    /// The peer in whose present life this message was sent; within that life [`Self::hear`] compares the sequences.
    fn speaker(&mut self, header: &Header) -> Option<&mut Peer> {
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
            // A new life: its words count from one again.
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

    /// Where the peer stands in the table, entered there if it is new.
    fn index(&mut self, id: VehicleId) -> Option<usize> {
        if id == self.own || id.get() > self.roster {
            return None;
        }
        match self.known.binary_search_by_key(&id, |peer| peer.id) {
            Ok(index) => Some(index),
            Err(index) => {
                self.known.insert(index, Peer::unheard(id));
                Some(index)
            }
        }
    }
}

impl Peer {
    fn unheard(id: VehicleId) -> Self {
        Self {
            id,
            incarnation: Incarnation::default(),
            state: None,
            mission: None,
            mission_at: LocalTime::ZERO,
            delay: Delay::default(),
            token: None,
            heard_at: None,
            found: false,
            lost_at: None,
            old: 0,
        }
    }

    fn membership(&self) -> Membership {
        self.mission.map_or(Membership::Joining, |said| said.membership)
    }

    /// Moves between lost and not lost.
    fn age(&mut self, now: LocalTime, stale_s: f64) -> Option<Change> {
        let heard_at = self.heard_at?;
        let gone = self.token == Some(false) || Deadline::PeerLost(stale_s).is_past(now.seconds_since(heard_at));
        if gone && self.lost_at.is_none() {
            self.lost_at = Some(now);
            // Who left of its own will is not missed.
            (self.membership() != Membership::Left).then_some(Change::Lost(self.id))
        } else if !gone && (self.lost_at.is_some() || !self.found) {
            self.lost_at = None;
            self.found = true;
            Some(Change::Found(self.id))
        } else {
            None
        }
    }

    /// It is heard, and a member that flies this plan.
    fn takes_part(&self, plan: u64) -> bool {
        let is_heard = self.found && self.lost_at.is_none();
        is_heard && self.mission.is_some_and(|said| said.plan == plan && said.membership == Membership::Active)
    }

    /// Its state is young, or was until the peer was lost.
    fn is_in_sight(&self, now: LocalTime, stale_s: f64) -> bool {
        let Some(told) = self.state else { return false };
        match self.lost_at {
            None => !Deadline::NeighbourSilent(stale_s).is_past(now.seconds_since(told.at)),
            // The last word of all may be a little younger than the last state.
            Some(lost_at) => lost_at.seconds_since(told.at) <= stale_s + FRESH_S,
        }
    }

    fn seen(&self, now: LocalTime, plan: u64, stale_s: f64) -> Option<Seen> {
        let told = self.state?;
        let silent_s = now.seconds_since(told.at).max(0.0);
        let way = self.delay.of(now, told.transit_s);
        let delay_s = way.map(|way| way.most_s);
        let Way { most_s, likely_s } = way.unwrap_or_default();
        let (age_s, carried_s) = (silent_s + most_s, silent_s + likely_s);
        let standing = match self.lost_at {
            Some(_) => Standing::Lost,
            None if Deadline::StateOld.is_past(age_s) => Standing::Stale,
            None => Standing::Fresh,
        };
        let flies_along =
            !Deadline::NeighbourSilent(stale_s).is_past(silent_s) && self.mission.is_some_and(|said| said.plan == plan);
        let role = match (self.membership(), self.lost_at) {
            (Membership::Active, None) if flies_along => Role::Member,
            (_, Some(lost_at)) if Deadline::ObstacleGone.is_past(now.seconds_since(lost_at)) => Role::Nothing,
            _ => {
                let unknown_m = (OBSTACLE_GROWTH_M_S * age_s).min(OBSTACLE_GROWTH_M);
                Role::Obstacle { radius_m: OBSTACLE_RADIUS_M + unknown_m }
            }
        };
        let position = told.position + told.velocity.0 * carried_s;
        let Told { velocity, heading_rad, .. } = told;
        Some(Seen { id: self.id, position, velocity, heading_rad, age_s, delay_s, carried_s, standing, role })
    }

    /// Lost while it took part: it may go on with the mission, unheard.
    fn is_missed(&self, now: LocalTime) -> bool {
        self.membership() == Membership::Active && self.may_come_back(now)
    }

    /// Lost before it had left, and not long ago.
    fn may_come_back(&self, now: LocalTime) -> bool {
        let is_recent = |lost_at: LocalTime| !Deadline::PeerGivenUp.is_past(now.seconds_since(lost_at));
        self.membership() != Membership::Left && self.lost_at.is_some_and(is_recent)
    }
}

#[cfg(test)]
mod tests;
