//! The knowledge of one peer: its newest messages, the judgement of it that follows from them, and the deadlines that they start.

use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::{Incarnation, VehicleId, VehicleSet};
use skein_common::message::Heartbeat;
use skein_common::state::{Membership, PeerStatus};
use skein_common::time::{LocalTime, SenderStamp};

use super::timeout::SilenceTimeout;
use super::{Change, Role};
use crate::deadlines::Deadline;
use crate::delay::Excess;

/// A state younger than this is fresh, s.
pub const FRESH_S: f64 = Deadline::StateOld.after_s();
/// Radius of an obstacle at a known position, m.
const OBSTACLE_RADIUS_M: f64 = 8.0;
/// Growth of a silent vehicle's position uncertainty, m/s, and its limit, m.
const OBSTACLE_GROWTH_M_S: f64 = 1.0;
const OBSTACLE_GROWTH_M: f64 = 12.0;
/// Largest radius of an obstacle, m.
pub const MAX_OBSTACLE_RADIUS_M: f64 = OBSTACLE_RADIUS_M + OBSTACLE_GROWTH_M;
/// A deadline is expected this much earlier than it passes, s: the instant is rounded to nanoseconds, and the deadline
/// itself is judged by [`Deadline::is_past`].
const ROUNDING_S: f64 = 1e-6;

/// The judgement of one peer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Peer {
    pub(super) token: Option<bool>,
    /// The status after the last assessment.
    pub(super) status: Status,
    lost_at: MaybeTime,
    /// Whether it was lost by its silence alone: its token was there, and nothing was reported of the token since.
    lost_by_silence: bool,
    /// The time at which contact with it last began; no time before the first contact.
    found_at: MaybeTime,
    /// Number of its messages that were dropped because a newer one had been received.
    pub(super) old: u32,
}

/// A time, or none, in the room of a time: a swarm of n vehicles has n² of these.
#[derive(Clone, Copy, Debug)]
struct MaybeTime(LocalTime);

impl MaybeTime {
    const NONE: Self = Self(LocalTime::MAX);

    fn get(self) -> Option<LocalTime> {
        (self.0 != LocalTime::MAX).then_some(self.0)
    }
}

/// The newest messages of the current incarnation of one peer.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Newest {
    pub(super) incarnation: Incarnation,
    pub(super) state: Option<StateArrival>,
    pub(super) heartbeat: Option<KeptHeartbeat>,
    /// Arrival of the newest message.
    pub(super) received_at: Option<LocalTime>,
    /// The time at which a gap in the numbers of its heartbeats was last seen, if ever.
    pub(super) gap_at: Option<LocalTime>,
}

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

/// Number and arrival of the newest state.
#[derive(Clone, Copy, Debug)]
pub(super) struct StateArrival {
    pub(super) sequence: u64,
    pub(super) at: LocalTime,
}

/// The contents of a heartbeat that are used after its arrival.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct KeptHeartbeat {
    pub(super) sequence: u64,
    pub(super) stamp: SenderStamp,
    pub(super) at: LocalTime,
    pub(super) progress_m: f64,
    pub(super) agreement: Agreed,
}

/// The contents of a heartbeat on which the agreement and the status of its sender depend.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Agreed {
    pub(super) same_plan: bool,
    pub(super) membership: Membership,
    pub(super) step: u32,
    pub(super) vouched: u32,
    pub(super) reached: Option<u32>,
    /// The vehicles that the sender has lost.
    pub(super) lost: VehicleSet,
}

impl Agreed {
    pub(super) fn new(heartbeat: &Heartbeat, plan: u64) -> Self {
        let &Heartbeat { membership, step, vouched, reached, lost, .. } = heartbeat;
        Self { same_plan: heartbeat.plan == plan, membership, step, vouched, reached, lost }
    }

    /// The change from this agreement state to a later one.
    pub(super) fn change_to(&self, later: &Self) -> AgreementChange {
        if self == later {
            AgreementChange::Nothing
        } else if (Self { lost: later.lost, ..*self }) == *later {
            AgreementChange::Lost
        } else {
            AgreementChange::Steps
        }
    }
}

/// The part of an agreement state that a heartbeat changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum AgreementChange {
    Nothing,
    /// The vehicles that the sender has lost.
    Lost,
    /// The part on which the agreement on the step depends.
    Steps,
}

/// The conditions that hold for a peer at an instant; one bit each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Status(u16);

impl Status {
    /// It has been in contact.
    pub(super) const FOUND: Self = Self(1);
    /// It is in contact: its token is present and its last message young.
    pub(super) const IN_CONTACT: Self = Self(1 << 1);
    /// It is not lost and has sent a heartbeat.
    pub(super) const CORRESPONDS: Self = Self(1 << 2);
    /// The mission takes its newest heartbeat into account: not lost, the same plan.
    pub(super) const AGREES: Self = Self(1 << 3);
    /// It is in contact and an active member that flies the same plan.
    pub(super) const ACTIVE: Self = Self(1 << 4);
    /// It has an estimate: its state is known and it is not out of sight.
    pub(super) const SEEN: Self = Self(1 << 5);
    /// It is a live member of the formation whose state is received.
    pub(super) const MEMBER: Self = Self(1 << 6);
    /// It is an active member that is out of sight.
    pub(super) const UNSEEN: Self = Self(1 << 7);
    /// It was in contact and has not left the swarm.
    pub(super) const REMAINS: Self = Self(1 << 8);
    /// It was lost without having left, less than a minute ago.
    pub(super) const MAY_RETURN: Self = Self(1 << 9);
    /// It was lost as an active member, less than a minute ago.
    pub(super) const MAY_FLY: Self = Self(1 << 10);
    /// Its state is young.
    pub(super) const YOUNG: Self = Self(1 << 11);
    /// A message that repeats what is known changes nothing of the status.
    pub(super) const SETTLED: Self = Self(1 << 12);
    /// It is in contact, flies the same plan and reports that it has lost vehicles.
    pub(super) const REPORTS_LOST: Self = Self(1 << 13);
    /// It was lost less than a minute ago, whatever it was doing.
    pub(super) const LOST_LATELY: Self = Self(1 << 14);
    /// Number of kinds of status.
    pub(super) const KINDS: usize = 15;

    pub(super) fn contains(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    /// The bits in which two statuses differ.
    pub(super) fn differing(self, other: Self) -> Self {
        Self(self.0 ^ other.0)
    }

    /// The indices of its bits.
    pub(super) fn bits(self) -> impl Iterator<Item = usize> {
        let mut bits = self.0;
        core::iter::from_fn(move || {
            let lowest = bits.trailing_zeros() as usize;
            bits &= bits.wrapping_sub(1);
            (lowest < u16::BITS as usize).then_some(lowest)
        })
    }

    pub(super) fn has(self, bit: usize) -> bool {
        self.0 >> bit & 1 == 1
    }

    /// The index of the only bit of a kind.
    pub(super) const fn index(self) -> usize {
        self.0.trailing_zeros() as usize
    }

    fn with(self, other: Self, holds: bool) -> Self {
        if holds { Self(self.0 | other.0) } else { self }
    }
}

/// The rules by which peers are judged.
#[derive(Clone, Copy, Debug)]
pub(super) struct Judgement {
    pub(super) now: LocalTime,
    /// The time for which peers may be silent.
    pub(super) timeout: SilenceTimeout,
    /// Whether the network graph passes every peer's states.
    pub(super) receives_all_states: bool,
}

impl Newest {
    #[inline]
    fn membership(&self) -> Membership {
        self.heartbeat.map_or(Membership::Joining, |heartbeat| heartbeat.agreement.membership)
    }

    /// The vehicles that the peer has lost.
    pub(super) fn lost(&self) -> VehicleSet {
        self.heartbeat.map_or_else(VehicleSet::default, |heartbeat| heartbeat.agreement.lost)
    }

    #[inline]
    fn flies_same_plan(&self) -> bool {
        self.heartbeat.is_some_and(|heartbeat| heartbeat.agreement.same_plan)
    }

    /// Forgets the messages of an earlier incarnation. A new one numbers its messages from one again.
    pub(super) fn begin(&mut self, incarnation: Incarnation) {
        (self.incarnation, self.state, self.heartbeat) = (incarnation, None, None);
    }
}

impl Peer {
    /// The judgement of a peer before any message of it.
    pub(super) const UNKNOWN: Self = Self {
        token: None,
        lost_at: MaybeTime::NONE,
        lost_by_silence: false,
        found_at: MaybeTime::NONE,
        old: 0,
        status: Status(0),
    };

    /// Whether it has been in contact.
    fn was_found(&self) -> bool {
        self.found_at.get().is_some()
    }

    fn lost_at(&self) -> Option<LocalTime> {
        self.lost_at.get()
    }

    /// Takes whether its liveliness token is there.
    pub(super) fn set_token(&mut self, is_there: bool) {
        (self.token, self.lost_by_silence) = (Some(is_there), false);
    }

    /// Counts a message that was dropped because a newer one had been received.
    pub(super) fn note_old(&mut self) {
        self.old = self.old.saturating_add(1);
    }

    /// Updates whether the peer with this id is lost; returns a change to be reported.
    pub(super) fn age(&mut self, id: VehicleId, newest: &Newest, judgement: &Judgement) -> Option<Change> {
        let received_at = newest.received_at?;
        let now = judgement.now;
        let silent = Deadline::PeerLost(self.silent_s(newest, judgement)).is_past(now.seconds_since(received_at));
        let gone = self.token == Some(false) || silent;
        if gone && self.lost_at().is_none() {
            self.lost_at = MaybeTime(now);
            self.lost_by_silence = self.token != Some(false);
            // A peer that left the swarm on purpose is not reported as lost.
            (newest.membership() != Membership::Left).then_some(Change::Lost(id))
        } else if !gone && (self.lost_at().is_some() || !self.was_found()) {
            self.lost_at = MaybeTime::NONE;
            self.found_at = MaybeTime(received_at);
            Some(Change::Found(id))
        } else {
            None
        }
    }

    /// Whether it was suspected so lately, by its silence alone, that a message of it shows that this was too early.
    pub(super) fn is_doubtful(&self, judgement: &Judgement) -> bool {
        let lost_s = self.lost_at().filter(|_| self.lost_by_silence).map(|at| judgement.now.seconds_since(at));
        lost_s.is_some_and(|lost_s| judgement.timeout.is_soon(lost_s))
    }

    /// From when on its link counts as one that loses nothing, if no heartbeat is lost until then.
    fn proven_at(&self, newest: &Newest) -> LocalTime {
        let since = self.found_at.get().max(newest.gap_at);
        since.map_or(LocalTime::ZERO, |since| since.plus_seconds(Deadline::LinkProven.after_s()))
    }

    /// The time for which it may send nothing, s.
    fn silent_s(&self, newest: &Newest, judgement: &Judgement) -> f64 {
        judgement.timeout.silent_s(judgement.now >= self.proven_at(newest))
    }

    /// The conditions that hold for the peer now.
    pub(super) fn assess(&self, newest: &Newest, judgement: &Judgement) -> Status {
        let Judgement { now, timeout, receives_all_states } = *judgement;
        let is_lost = self.lost_at().is_some();
        let was_found = self.was_found();
        let in_contact = was_found && !is_lost;
        let active = newest.membership() == Membership::Active;
        let is_active_member = in_contact && active && newest.flies_same_plan();
        let in_sight = receives_all_states || self.is_in_sight(newest, judgement);
        let is_silent = newest.state.is_none_or(|last| is_silent(last.at, now, timeout.without_state_s()));
        let is_recent = |lost_at: LocalTime| !Deadline::PeerGivenUp.is_past(now.seconds_since(lost_at));
        let has_left = newest.membership() == Membership::Left;
        let lost_lately = self.lost_at().is_some_and(is_recent);
        let may_return = !has_left && lost_lately;
        Status::default()
            .with(Status::FOUND, was_found)
            .with(Status::IN_CONTACT, in_contact)
            .with(Status::CORRESPONDS, !is_lost && newest.heartbeat.is_some())
            .with(Status::AGREES, !is_lost && newest.flies_same_plan())
            .with(Status::ACTIVE, is_active_member)
            .with(Status::SEEN, in_sight && newest.state.is_some())
            .with(Status::MEMBER, in_sight && !is_silent && !is_lost && active && newest.flies_same_plan())
            .with(Status::UNSEEN, !in_sight && is_active_member)
            .with(Status::REMAINS, was_found && !has_left)
            .with(Status::MAY_RETURN, may_return)
            .with(Status::MAY_FLY, may_return && active)
            .with(Status::YOUNG, !is_silent)
            .with(Status::REPORTS_LOST, in_contact && newest.flies_same_plan() && !newest.lost().is_empty())
            .with(Status::LOST_LATELY, lost_lately)
            .with(Status::SETTLED, in_contact && self.token != Some(false))
    }

    /// A time before which nothing of the status changes without a message.
    pub(super) fn unchanged_until(&self, newest: &Newest, judgement: &Judgement) -> LocalTime {
        let Judgement { now, timeout, .. } = *judgement;
        let mut until = LocalTime::MAX;
        let mut pending = |start: Option<LocalTime>, deadline: Deadline| {
            if let Some(start) = start.filter(|start| !deadline.is_past(now.seconds_since(*start))) {
                until = until.min(start.plus_seconds(deadline.after_s() - ROUNDING_S));
            }
        };
        let received_at = newest.received_at.filter(|_| self.lost_at().is_none());
        pending(received_at, Deadline::PeerLost(self.silent_s(newest, judgement)));
        pending(newest.state.map(|last| last.at), Deadline::NeighbourSilent(timeout.without_state_s()));
        pending(self.lost_at(), Deadline::PeerGivenUp);
        let proven_at = self.proven_at(newest);
        if let Some(received_at) = received_at.filter(|_| now < proven_at) {
            until = until.min(proven_at.max(received_at.plus_seconds(timeout.silent_s(true) - ROUNDING_S)));
        }
        until
    }

    /// Whether its state is young, or was until the peer was lost.
    fn is_in_sight(&self, newest: &Newest, judgement: &Judgement) -> bool {
        let Judgement { now, timeout, .. } = *judgement;
        let Some(last) = newest.state else { return false };
        match self.lost_at() {
            None => !is_silent(last.at, now, timeout.without_state_s()),
            // The last message may be a little younger than the last state.
            Some(lost_at) => lost_at.seconds_since(last.at) <= timeout.without_state_s() + FRESH_S,
        }
    }

    /// Returns the standing and the role of a peer that is not a live member of the formation. `age_s` is the age of its
    /// newest state, s.
    #[cold]
    pub(super) fn standing_and_role(&self, now: LocalTime, age_s: f64) -> (PeerStatus, Role) {
        let standing = if self.lost_at().is_some() { PeerStatus::Lost } else { standing(age_s) };
        let is_gone = |lost_at| Deadline::ObstacleGone.is_past(now.seconds_since(lost_at));
        if self.lost_at().is_some_and(is_gone) {
            return (standing, Role::Nothing);
        }
        let unknown_m = (OBSTACLE_GROWTH_M_S * age_s).min(OBSTACLE_GROWTH_M);
        (standing, Role::Obstacle { radius_m: OBSTACLE_RADIUS_M + unknown_m })
    }
}

/// Whether the state of a peer in contact is fresh or stale at this age, s.
#[inline]
pub(super) fn standing(age_s: f64) -> PeerStatus {
    if Deadline::StateOld.is_past(age_s) { PeerStatus::Stale } else { PeerStatus::Fresh }
}

/// Whether a state that arrived at `at` is too old for a neighbour.
fn is_silent(at: LocalTime, now: LocalTime, limit_s: f64) -> bool {
    Deadline::NeighbourSilent(limit_s).is_past(now.seconds_since(at).max(0.0))
}
