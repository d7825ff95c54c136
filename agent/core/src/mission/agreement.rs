//! Which step of the mission the swarm is at, without a vehicle that decides it.
//!
//! Every agent keeps the same small record for every agent, itself included, and publishes its own. Records merge by taking
//! the larger: a join semilattice, so loss, repetition and order of the messages change nothing but the time it takes. A
//! vehicle leaves a step for a later one
//!
//! * (a) when it has reached the step itself and every active member that it hears reports the same ([`Event::Free`]);
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
//! Everything here is a pure function of what was received. There is no clock: the caller tells which vehicles are heard.

use alloc::vec::Vec;

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::MessageOrder;
use skein_common::scenario::Partition;
use skein_common::state::Membership;

/// What is known of one agent's part in the agreement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Part {
    /// The order of its newest message, which says whether it is an active member.
    pub order: MessageOrder,
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
    /// The least part that says all that both say: the later life; in one life the later word about taking part, and the
    /// larger of everything else. Idempotent, commutative, associative.
    pub fn merge(self, other: Self) -> Self {
        let later = if (self.order, self.membership) >= (other.order, other.membership) { self } else { other };
        if self.order.incarnation != other.order.incarnation {
            return later;
        }
        Self {
            step: self.step.max(other.step),
            vouched: self.vouched.max(other.vouched),
            reached: self.reached.max(other.reached),
            ..later
        }
    }

    /// Nobody who is at this step needs to wait for it.
    pub fn has_reached(&self, step: u32) -> bool {
        self.step > step || self.reached >= Some(step)
    }
}

/// Something that happens to an agreement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// A word about somebody's part.
    Heard(VehicleId, Part),
    /// The own vehicle has reached the step that it is at.
    Reached,
    /// An operator wants nobody to be at an earlier step.
    Ordered(u32),
    /// The own part in the swarm has changed.
    Became(Membership),
    /// Which of the others are there now.
    Sees {
        /// They are heard: their tokens are there and their messages young.
        heard: VehicleSet,
        /// A further vehicle is not heard and may be flying the mission.
        misses_any: bool,
    },
    /// Nothing keeps the own vehicle from going on.
    Free,
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
    own: VehicleId,
    roster: u8,
    last_step: u32,
    partition: Partition,
    membership: Membership,
    step: u32,
    vouched: u32,
    reached: Option<u32>,
    /// The others, by id.
    parts: Vec<(VehicleId, Part)>,
    heard: VehicleSet,
    misses_any: bool,
}

impl Agreement {
    /// The beginning of a life in a swarm of vehicles 1 to `roster`, whose mission has the steps 0 to `last_step`.
    pub fn new(own: VehicleId, roster: u8, last_step: u32, partition: Partition) -> Self {
        Self {
            own,
            roster,
            last_step,
            partition,
            membership: Membership::Joining,
            step: 0,
            vouched: 0,
            reached: None,
            parts: Vec::new(),
            heard: VehicleSet::default(),
            misses_any: true,
        }
    }

    /// Takes up one event.
    pub fn step(&mut self, event: Event) -> Option<Progress> {
        match event {
            Event::Heard(id, part) => {
                self.merge(id, part);
                None
            }
            Event::Reached => {
                self.reached = self.reached.max(Some(self.step));
                None
            }
            Event::Ordered(step) => {
                self.vouched = self.vouched.max(step.min(self.last_step));
                self.carry(step)
            }
            Event::Became(membership) => {
                self.membership = membership;
                None
            }
            Event::Sees { heard, misses_any } => {
                (self.heard, self.misses_any) = (heard, misses_any);
                self.follow()
            }
            Event::Free => self.advance(),
        }
    }

    /// The step that this agent is at.
    pub fn at(&self) -> u32 {
        self.step
    }

    /// The latest step that this agent vouches for.
    pub fn vouched(&self) -> u32 {
        self.vouched
    }

    /// The highest step that it reached in this life.
    pub fn reached(&self) -> Option<u32> {
        self.reached
    }

    /// Whether the others count on it.
    pub fn membership(&self) -> Membership {
        self.membership
    }

    /// The other members: those who are heard and take part.
    pub fn members(&self) -> VehicleSet {
        self.others().map(|(id, _)| id).collect()
    }

    /// What is known of another agent.
    pub fn part(&self, id: VehicleId) -> Option<&Part> {
        let index = self.parts.binary_search_by_key(&id, |(known, _)| *known).ok()?;
        Some(&self.parts[index].1)
    }

    /// Whether enough are heard to go on: always, or under [`Partition::Quorum`] more than half of the roster.
    pub fn has_quorum(&self) -> bool {
        let live = self.others().count() + 1;
        self.partition == Partition::Continue || 2 * live > usize::from(self.roster)
    }

    fn merge(&mut self, id: VehicleId, part: Part) {
        if id == self.own {
            return;
        }
        match self.parts.binary_search_by_key(&id, |(known, _)| *known) {
            Ok(index) => self.parts[index].1 = self.parts[index].1.merge(part),
            Err(index) => self.parts.insert(index, (id, part)),
        }
    }

    /// The largest of the others' reports that this agent may rely on: the second largest, so that an honest vehicle reports as
    /// much or more; the only one, if there is only one other vehicle.
    pub fn reliable<T: PartialOrd + Copy>(&self, reports: impl Iterator<Item = (VehicleId, T)>) -> Option<T> {
        let (mut largest, mut second) = (None, None);
        for (_, report) in reports.filter(|(id, _)| self.heard.contains(*id)) {
            if largest.is_none_or(|largest| report > largest) {
                (largest, second) = (Some(report), largest);
            } else if second.is_none_or(|second| report > second) {
                second = Some(report);
            }
        }
        if self.is_pair() { largest } else { second }
    }

    /// Whether exactly one other vehicle is there, as far as this one can know.
    fn is_pair(&self) -> bool {
        self.heard.len() == 1 && !self.misses_any && self.has_quorum()
    }

    /// To the step that the others vouch for, if that is later.
    fn follow(&mut self) -> Option<Progress> {
        let vouched = self.parts.iter().map(|(id, part)| (*id, part.vouched));
        let step = self.reliable(vouched)?.min(self.last_step);
        // In a swarm of two there is no third to be misled.
        if !self.is_pair() || self.roster <= 2 {
            self.vouched = self.vouched.max(step);
        }
        self.carry(step)
    }

    /// To this step, if it is later.
    fn carry(&mut self, step: u32) -> Option<Progress> {
        let step = step.min(self.last_step);
        (step > self.step).then(|| {
            let from = core::mem::replace(&mut self.step, step);
            Progress::Carried { from, reached: self.reached >= Some(from) }
        })
    }

    /// To the next step, if everybody who counts has reached this one. The last step is never left.
    fn advance(&mut self) -> Option<Progress> {
        let step = self.step;
        let may = self.membership == Membership::Active && self.reached >= Some(step) && step < self.last_step;
        let all = || self.others().all(|(_, part)| part.has_reached(step));
        (may && self.has_quorum() && all()).then(|| {
            self.vouched += u32::from(self.vouched == step);
            self.step += 1;
            Progress::Advanced
        })
    }

    /// The other members and their parts.
    fn others(&self) -> impl Iterator<Item = (VehicleId, &Part)> {
        let counts =
            |(id, part): &&(VehicleId, Part)| part.membership == Membership::Active && self.heard.contains(*id);
        self.parts.iter().filter(counts).map(|(id, part)| (*id, part))
    }
}

#[cfg(test)]
mod tests;
