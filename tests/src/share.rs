//! Shares of this PC's processors, for tests in real time that run side by side.
//!
//! Such a test waits most of its time, so that far more of them fit than there are processors. With too many at once, agents miss
//! their frames. Each test therefore takes a [`Share`], as much as it computes, and waits while the others leave too little.

use std::num::NonZeroUsize;
use std::sync::{Condvar, Mutex, PoisonError};
use std::thread::available_parallelism;

/// The tests that wait and run.
struct Queue {
    /// The percents of a processor that the running tests have taken.
    taken: u32,
    /// The number of the next test that comes.
    next: u64,
    /// The number of the test that is the first to wait.
    first: u64,
}

static QUEUE: Mutex<Queue> = Mutex::new(Queue { taken: 0, next: 0, first: 0 });
static CHANGED: Condvar = Condvar::new();

/// A share of the processors, given back at the end of the test.
#[derive(Debug)]
#[must_use]
pub struct Share(u32);

impl Share {
    /// Waits until this PC has so many percents of a processor left for a test. A test that wants more than there is runs alone.
    ///
    /// First come, first served: a test that wants much would otherwise wait until all that want little have ended.
    pub fn of(percent: u32) -> Self {
        // A fifth remains for the rest of the PC.
        let all = 80 * available_parallelism().map_or(1, NonZeroUsize::get) as u32;
        let wanted = percent.min(all);
        let mut queue = QUEUE.lock().unwrap_or_else(PoisonError::into_inner);
        let own = queue.next;
        queue.next += 1;
        let waits = |queue: &mut Queue| queue.first != own || queue.taken + wanted > all;
        let mut queue = CHANGED.wait_while(queue, waits).unwrap_or_else(PoisonError::into_inner);
        queue.first += 1;
        queue.taken += wanted;
        CHANGED.notify_all();
        Self(wanted)
    }

    /// The share of a flight with this many vehicles on the built-in model: each agent computes for 2 % of a processor, its start
    /// and the observer take more.
    pub fn of_flight(vehicles: u32) -> Self {
        Self::of(10 + 3 * vehicles)
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        QUEUE.lock().unwrap_or_else(PoisonError::into_inner).taken -= self.0;
        CHANGED.notify_all();
    }
}
