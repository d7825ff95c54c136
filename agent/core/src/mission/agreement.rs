//! Which step of the mission the swarm is at, without a vehicle that decides it.
//!
//! Every agent publishes a small record of its own part ([`Part`]) in its heartbeats. The peers stage ([`crate::peers`]) keeps the
//! newest heartbeat of every peer, and this stage keeps none of them: it decides from the own record and the newest records of
//! the peers in contact. What a peer has reached and vouches for only grows during its life, so a newer record says all that the
//! older ones said: loss, repetition and order of the messages change nothing but the time it takes. A vehicle leaves a step
//! for a later one
//!
//! * (a) when it has reached the step itself and every active member that it hears reports the same ([`Agreement::advance`]);
//! * (b) when two other vehicles that it hears vouch for a later step;
//! * (b') when it hears one other vehicle only, no further one may still be flying, and that one vouches for a later step;
//! * (c) by an operator's order.
//!
//! # What one false register can do
//!
//! A vehicle *vouches* for the steps that it came to by (a), (b) or (c), not for those that (b') alone brought it to. Of two
//! that vouch for a step one is honest, so a step that is vouched for was earned: some honest vehicle reached the one before it.
//! A single vehicle that lies, its key stolen say, therefore takes no honest one forward that hears a third. It can
//!
//! * keep all others at their step, as long as it is heard and says that it takes part and has not reached it: an order to go
//!   on passes it, and so does the mission when its key is revoked;
//! * second an honest vehicle that ran ahead alone, so that the others skip the steps in between;
//! * mislead a vehicle that hears it alone: at once in a swarm of two; in a larger one only when all others have left or
//!   were silent for a minute. That vehicle then is where the liar wants it, and no further one follows: it does not vouch for
//!   that step, and neither in a swarm of more than two does a vehicle that follows it by (b').
//!
//! # Who is ahead and who is behind
//!
//! A vehicle never goes back. One that ran ahead alone waits at its step, because those that are behind are members that have
//! not reached it; they come after it step by step by (a), for it has reached all of theirs. If it ran ahead to the landing it
//! lands and leaves, and no vehicle waits for it. Two that ran ahead take the others along by (b).
//!
//! There is no clock here: the caller says which peers are in contact.

use skein_common::message;
use skein_common::scenario::Partition;
use skein_common::state::Membership;

/// One vehicle's part in the agreement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Part {
    /// Whether the others count on it.
    pub membership: Membership,
    /// The step that it is at.
    pub step: u32,
    /// The latest step that it vouches for; at most the one that it is at.
    pub vouched: u32,
    /// The highest step that it reached itself in this life.
    pub reached: Option<u32>,
}

impl Part {
    /// Nobody who is at this step needs to wait for it.
    pub fn has_reached(&self, step: u32) -> bool {
        self.step > step || self.reached >= Some(step)
    }

    /// Whether it is a member: the others wait for it.
    pub fn is_active(&self) -> bool {
        self.membership == Membership::Active
    }
}

impl From<&message::Mission> for Part {
    fn from(heartbeat: &message::Mission) -> Self {
        let &message::Mission { membership, step, vouched, reached, .. } = heartbeat;
        Self { membership, step, vouched, reached }
    }
}

/// What one vehicle knows of the others now.
#[derive(Clone, Copy, Debug)]
pub struct Others<Parts> {
    /// The newest records of the peers in contact: their tokens are there and their messages young.
    pub parts: Parts,
    /// A further vehicle is not in contact and may be flying the mission.
    pub misses_any: bool,
}

impl<Parts: Iterator<Item = Part> + Clone> Others<Parts> {
    /// The other members.
    fn members(&self) -> impl Iterator<Item = Part> {
        self.parts.clone().filter(Part::is_active)
    }
}

/// How an agreement moved on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// Everybody who counts had reached the step before.
    Advanced,
    /// Others, or an operator, were farther.
    Carried {
        /// The step that was left.
        from: u32,
        /// Whether it had been reached.
        reached: bool,
    },
}

/// One agent's side of the agreement.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Agreement {
    roster: u8,
    last_step: u32,
    partition: Partition,
    own: Part,
}

impl Agreement {
    /// The beginning of a life in a swarm of vehicles 1 to `roster`, whose mission has the steps 0 to `last_step`.
    pub fn new(roster: u8, last_step: u32, partition: Partition) -> Self {
        Self { roster, last_step, partition, own: Part::default() }
    }

    /// The own part, as the others are to know it.
    pub fn own(&self) -> Part {
        self.own
    }

    /// The own part in the swarm has changed.
    pub fn turn(&mut self, membership: Membership) {
        self.own.membership = membership;
    }

    /// The own vehicle has reached the step that it is at.
    pub fn reach(&mut self) {
        self.own.reached = self.own.reached.max(Some(self.own.step));
    }

    /// An operator wants no vehicle to be at an earlier step.
    pub fn order(&mut self, step: u32) -> Option<Progress> {
        self.own.vouched = self.own.vouched.max(step.min(self.last_step));
        self.carry(step)
    }

    /// To the step that the others vouch for, if that is later.
    pub fn follow(&mut self, others: &Others<impl Iterator<Item = Part> + Clone>) -> Option<Progress> {
        let vouched = others.parts.clone().map(|part| part.vouched);
        let step = self.reliable(others, vouched)?.min(self.last_step);
        // In a swarm of two there is no third to be misled.
        if !self.is_pair(others) || self.roster <= 2 {
            self.own.vouched = self.own.vouched.max(step);
        }
        self.carry(step)
    }

    /// Nothing keeps the own vehicle from going on: to the next step, if everybody who counts has reached this one. The last
    /// step is never left.
    pub fn advance(&mut self, others: &Others<impl Iterator<Item = Part> + Clone>) -> Option<Progress> {
        let step = self.own.step;
        let may = self.own.is_active() && self.own.reached >= Some(step) && step < self.last_step;
        let all = || others.members().all(|part| part.has_reached(step));
        (may && self.has_quorum(others) && all()).then(|| {
            self.own.vouched += u32::from(self.own.vouched == step);
            self.own.step += 1;
            Progress::Advanced
        })
    }

    /// Whether enough are in contact to go on: always, or under [`Partition::Quorum`] more than half of the roster.
    pub fn has_quorum(&self, others: &Others<impl Iterator<Item = Part> + Clone>) -> bool {
        let live = others.members().count() + 1;
        self.partition == Partition::Continue || 2 * live > usize::from(self.roster)
    }

    /// The largest of these reports by some of the others that this agent may rely on: the second largest, so that an honest
    /// vehicle reports as much or more; the only one, if there is only one other vehicle.
    pub fn reliable<T: PartialOrd + Copy>(
        &self,
        others: &Others<impl Iterator<Item = Part> + Clone>,
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

    /// Whether exactly one other vehicle is there, as far as this one can know.
    fn is_pair(&self, others: &Others<impl Iterator<Item = Part> + Clone>) -> bool {
        others.parts.clone().count() == 1 && !others.misses_any && self.has_quorum(others)
    }

    /// To this step, if it is later.
    fn carry(&mut self, step: u32) -> Option<Progress> {
        let step = step.min(self.last_step);
        (step > self.own.step).then(|| {
            let from = core::mem::replace(&mut self.own.step, step);
            Progress::Carried { from, reached: self.own.reached >= Some(from) }
        })
    }
}

#[cfg(test)]
mod tests;
