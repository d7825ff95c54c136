//! Planned events in virtual time, for the simulators of the tests.

use std::collections::BTreeMap;

/// Planned events in the order of their times, those of one instant in the order in which they were planned, and the present time.
#[derive(Debug)]
pub struct Schedule<Event> {
    /// The present time, ns after the beginning.
    pub now_ns: u64,
    planned: u64,
    events: BTreeMap<(u64, u64), Event>,
}

impl<Event> Default for Schedule<Event> {
    fn default() -> Self {
        Self { now_ns: 0, planned: 0, events: BTreeMap::new() }
    }
}

impl<Event> Schedule<Event> {
    /// Plans an event for this time.
    pub fn at(&mut self, at_ns: u64, event: Event) {
        self.planned += 1;
        self.events.insert((at_ns, self.planned), event);
    }

    /// Plans an event for this time, behind all that [`Self::at`] has planned for it. Of those, a larger `rank` comes first.
    pub fn last_at(&mut self, at_ns: u64, rank: u64, event: Event) {
        self.events.insert((at_ns, u64::MAX - rank), event);
    }

    /// Plans an event for so much later than now.
    pub fn after(&mut self, in_ns: u64, event: Event) {
        self.at(self.now_ns + in_ns, event);
    }

    /// Advances to the next event, if it happens no later than this.
    pub fn next_until(&mut self, until_ns: u64) -> Option<Event> {
        let next = self.events.first_entry().filter(|next| next.key().0 <= until_ns)?;
        self.now_ns = next.key().0;
        Some(next.remove())
    }
}
