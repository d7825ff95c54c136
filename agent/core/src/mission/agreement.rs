//! The agreement on the swarm's current step of the mission, without a leader.
//!
//! Every agent publishes its agreement state ([`AgreementState`]) in its heartbeats. The peers stage ([`crate::peers`])
//! keeps the newest heartbeat of every peer. The agreement keeps only this vehicle's own state, and decides from it and
//! the newest states of the peers in contact. The steps a peer has reached and vouches for only grow during its
//! incarnation, so a newer state contains everything in the older ones: loss, duplication and reordering of messages
//! only delay the agreement. A vehicle leaves a step for a later one
//!
//! * (a) when it has reached the step itself and every active member in contact reports the same
//!   ([`Agreement::advance`]);
//! * (b) when two other vehicles in contact vouch for a later step;
//! * (b') when only one other vehicle is in contact, no further one may still be flying, and that one vouches for a
//!   later step;
//! * (c) by an operator's order.
//!
//! An order that names vehicles only sends these ahead: they do not vouch for the step, so that the others do not follow.
//!
//! # Effects of one false agreement state
//!
//! A vehicle *vouches* for the steps to which it came by (a), (b) or (c), not for those to which only (b') or an order to it
//! alone brought it.
//! Of two vehicles that vouch for a step one is honest, so such a step was earned: some honest vehicle reached the step
//! before it. A single false vehicle, with a stolen key for example, therefore cannot move an honest vehicle that is in
//! contact with a third. It can
//!
//! * keep all others at their step while it is in contact and reports to be active without having reached the step: an
//!   order to a later step overrides it, and so does revoking its key;
//! * confirm an honest vehicle that ran ahead alone, so that the others skip the steps in between;
//! * mislead a vehicle that is in contact with it alone: at once in a swarm of two; in a larger one only after all
//!   others have left or were silent for a minute. That vehicle is then at the false step, but no further one follows:
//!   it does not vouch for that step, and in a swarm of more than two neither does a vehicle that follows it by (b').
//!
//! # Vehicles ahead and behind
//!
//! A vehicle never goes back. One that ran ahead alone waits at its step, because the vehicles behind are members that
//! have not reached it. They follow step by step by (a), because it has reached all of their steps. If it ran ahead to
//! the landing, it lands and leaves, and the swarm does not wait for it. Two vehicles that ran ahead move the others
//! forward by (b).
//!
//! This module uses no clock: the caller passes the peers in contact.

use skein_common::scenario::Partition;
use skein_common::state::Membership;

use crate::peers::PeerProgress;

/// The agreement state of one vehicle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AgreementState {
    /// The vehicle's membership: whether the other vehicles wait for it.
    pub membership: Membership,
    /// The step at which it is.
    pub step: u32,
    /// The latest step it vouches for, at most its current one.
    pub vouched: u32,
    /// The highest step it reached itself in this incarnation.
    pub reached: Option<u32>,
}

impl AgreementState {
    /// Whether vehicles at this step need not wait for it.
    pub fn has_reached(&self, step: u32) -> bool {
        self.step > step || self.reached >= Some(step)
    }

    /// Whether it is an active member, for which the others wait.
    pub fn is_active(&self) -> bool {
        self.membership == Membership::Active
    }
}

impl From<PeerProgress> for AgreementState {
    fn from(heartbeat: PeerProgress) -> Self {
        let PeerProgress { membership, step, vouched, reached, .. } = heartbeat;
        Self { membership, step, vouched, reached }
    }
}

/// The other vehicles as known now.
#[derive(Clone, Copy, Debug)]
pub struct OtherStates<States> {
    /// The newest agreement states of the peers in contact: their tokens are present and their messages young.
    pub states: States,
    /// Whether a further vehicle is not in contact and may be flying the mission.
    pub absent_may_fly: bool,
}

impl<States: Iterator<Item = AgreementState> + Clone> OtherStates<States> {
    /// Number of active members, this vehicle included.
    pub fn live(&self) -> usize {
        self.members().count() + 1
    }

    /// The agreement states of the other active members.
    fn members(&self) -> impl Iterator<Item = AgreementState> {
        self.states.clone().filter(AgreementState::is_active)
    }
}

/// The reason for a change of the step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// All active members in contact had reached the previous step.
    Advanced,
    /// Other vehicles or an operator moved this one forward.
    Carried {
        /// The step that was left.
        from: u32,
        /// Whether that step had been reached.
        reached: bool,
    },
}

/// The agreement of one agent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Agreement {
    roster: u8,
    last_step: u32,
    partition: Partition,
    own: AgreementState,
}

impl Agreement {
    /// A new agent in a swarm of vehicles 1 to `roster`, whose mission has the steps 0 to `last_step`.
    pub fn new(roster: u8, last_step: u32, partition: Partition) -> Self {
        Self { roster, last_step, partition, own: AgreementState::default() }
    }

    /// The own agreement state, as sent to the peers.
    pub fn own(&self) -> AgreementState {
        self.own
    }

    /// Sets the own membership.
    pub fn set_membership(&mut self, membership: Membership) {
        self.own.membership = membership;
    }

    /// Records that the own vehicle has reached its current step.
    pub fn reach(&mut self) {
        self.own.reached = self.own.reached.max(Some(self.own.step));
    }

    /// Executes an operator's order that no vehicle be at an earlier step.
    pub fn order(&mut self, step: u32) -> Option<Progress> {
        self.own.vouched = self.own.vouched.max(step.min(self.last_step));
        self.carry(step)
    }

    /// Moves to the step the others vouch for, if it is later.
    pub fn follow(&mut self, others: &OtherStates<impl Iterator<Item = AgreementState> + Clone>) -> Option<Progress> {
        let vouched = others.states.clone().map(|part| part.vouched);
        let step = self.reliable(others, vouched)?.min(self.last_step);
        // In a swarm of two no third vehicle can be misled.
        if !self.is_pair(others) || self.roster <= 2 {
            self.own.vouched = self.own.vouched.max(step);
        }
        self.carry(step)
    }

    /// Moves to the next step if this vehicle and all active members in contact have reached the current one. The last
    /// step is never left.
    pub fn advance(&mut self, others: &OtherStates<impl Iterator<Item = AgreementState> + Clone>) -> Option<Progress> {
        let step = self.own.step;
        let may = self.own.is_active() && self.own.reached >= Some(step) && step < self.last_step;
        let all = || others.members().all(|part| part.has_reached(step));
        (may && self.has_quorum(others) && all()).then(|| {
            self.own.vouched += u32::from(self.own.vouched == step);
            self.own.step += 1;
            Progress::Advanced
        })
    }

    /// Whether enough members are in contact to advance: always, or with [`Partition::Quorum`] more than half of the
    /// roster.
    pub fn has_quorum(&self, others: &OtherStates<impl Iterator<Item = AgreementState> + Clone>) -> bool {
        self.partition == Partition::Continue || 2 * others.live() > usize::from(self.roster)
    }

    /// The largest of the others' reports on which this agent may rely: the second largest, so that an honest vehicle
    /// reports as much or more; with only one other vehicle its report.
    pub fn reliable<T: PartialOrd + Copy>(
        &self,
        others: &OtherStates<impl Iterator<Item = AgreementState> + Clone>,
        reports: impl Iterator<Item = T>,
    ) -> Option<T> {
        let (mut largest, mut second) = (None, None);
        for report in reports {
            if largest.is_none_or(|largest| report > largest) {
                (largest, second) = (Some(report), largest);
            } else if second.is_none_or(|second| report > second) {
                second = Some(report);
            }
        }
        if self.is_pair(others) { largest } else { second }
    }

    /// Whether there is exactly one other vehicle, as far as this one can know.
    fn is_pair(&self, others: &OtherStates<impl Iterator<Item = AgreementState> + Clone>) -> bool {
        others.states.clone().count() == 1 && !others.absent_may_fly && self.has_quorum(others)
    }

    /// Moves to this step if it is later: alone, it executes an operator's order that this vehicle be at no earlier step,
    /// whatever the others do.
    pub fn carry(&mut self, step: u32) -> Option<Progress> {
        let step = step.min(self.last_step);
        (step > self.own.step).then(|| {
            let from = core::mem::replace(&mut self.own.step, step);
            Progress::Carried { from, reached: self.own.reached >= Some(from) }
        })
    }
}

#[cfg(test)]
mod tests;
