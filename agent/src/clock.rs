//! The clocks of a running process. The core has none: it is told the time.

use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use skein_common::id::Incarnation;
use skein_common::time::LocalTime;

/// This process's monotonic clock.
#[derive(Clone, Copy, Debug)]
pub struct LocalClock {
    zero: Instant,
}

impl LocalClock {
    /// A clock that shows zero now.
    pub fn start() -> Self {
        Self { zero: now() }
    }

    /// What it shows now.
    pub fn now(&self) -> LocalTime {
        self.at(now())
    }

    /// What it showed at an instant.
    pub fn at(&self, instant: Instant) -> LocalTime {
        LocalTime::from_nanoseconds(nanoseconds(instant.saturating_duration_since(self.zero)))
    }
}

/// The monotonic clock as the system has it.
#[expect(clippy::disallowed_methods, reason = "an edge: deadlines and arrival times")]
pub fn now() -> Instant {
    Instant::now()
}

/// Blocks this thread until the instant.
#[expect(clippy::disallowed_methods, reason = "an edge: a thread of its own that waits for its time")]
pub fn sleep_until(instant: Instant) {
    thread::sleep(instant.saturating_duration_since(now()));
}

/// A life that begins now.
#[expect(clippy::disallowed_methods, reason = "an edge: a restarted agent has a larger incarnation")]
pub fn new_incarnation() -> Incarnation {
    Incarnation(nanoseconds(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()))
}

fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}
