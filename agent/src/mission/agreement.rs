//! Which step of the mission the swarm is at, without anybody who decides it.
//!
//! Every agent keeps the same small record for every agent, itself included, and tells its own. Records merge by taking
//! the larger: a join semilattice, so loss, repetition and order of the messages change nothing but the time it takes. A
//! step is left when everybody who counts has reached it; whoever hears of a later step goes there.
//!
//! Everything here is a pure function of what was said and seen. There is no clock: who is heard is told by the caller.

use skein_common::id::{Incarnation, VehicleId, VehicleSet};
use skein_common::scenario::Partition;
use skein_common::state::Membership;

/// What is known of one agent's part in the agreement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Part {
    /// Its life.
    pub incarnation: Incarnation,
    /// Of its word in this life: the later one says whether it takes part.
    pub sequence: u64,
    /// Whether the others count on it.
    pub membership: Membership,
    /// The step that it is at.
    pub step: u32,
    /// The highest step that it reached itself in this life.
    pub reached: Option<u32>,
}

impl Part {
    /// The least part that says all that both say: the later life; in one life the later word about taking part, and the
    /// larger of everything else. Idempotent, commutative, associative.
    pub fn merge(self, other: Self) -> Self {
        if self.incarnation != other.incarnation {
            return if self.incarnation > other.incarnation { self } else { other };
        }
        let later = if (self.sequence, self.membership) >= (other.sequence, other.membership) { self } else { other };
        Self { step: self.step.max(other.step), reached: self.reached.max(other.reached), ..later }
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
    /// These others are heard now: their tokens are there and their words young.
    Sees(VehicleSet),
    /// Nothing keeps the own vehicle from going on.
    Free,
}

/// How an agreement moved on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// Everybody who counts had reached the step before.
    Advanced,
    /// Somebody else, or an operator, was farther.
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
    reached: Option<u32>,
    /// The others, by id.
    parts: Vec<(VehicleId, Part)>,
    heard: VehicleSet,
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
            reached: None,
            parts: Vec::new(),
            heard: VehicleSet::default(),
        }
    }

    /// Takes up one event.
    pub fn step(&mut self, event: Event) -> Option<Progress> {
        match event {
            Event::Heard(id, part) => {
                self.merge(id, part);
                self.carry(part.step)
            }
            Event::Reached => {
                self.reached = self.reached.max(Some(self.step));
                None
            }
            Event::Ordered(step) => self.carry(step),
            Event::Became(membership) => {
                self.membership = membership;
                None
            }
            Event::Sees(heard) => {
                self.heard = heard;
                None
            }
            Event::Free => self.advance(),
        }
    }

    /// The step that this agent is at.
    pub fn at(&self) -> u32 {
        self.step
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

    /// To a step that somebody else is at, if that is later.
    fn carry(&mut self, step: u32) -> Option<Progress> {
        let step = step.min(self.last_step);
        (step > self.step).then(|| {
            let from = std::mem::replace(&mut self.step, step);
            Progress::Carried { from, reached: self.reached >= Some(from) }
        })
    }

    /// To the next step, if everybody who counts has reached this one. The last step is never left.
    fn advance(&mut self) -> Option<Progress> {
        let step = self.step;
        let may = self.membership == Membership::Active && self.reached >= Some(step) && step < self.last_step;
        let all = || self.others().all(|(_, part)| part.has_reached(step));
        (may && self.has_quorum() && all()).then(|| {
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
