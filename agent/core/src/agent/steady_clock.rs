//! The clock of one agent.

use skein_common::time::{LocalTime, Now};

use crate::deadlines::Deadline;

/// The own clock without its jumps: time in which this process cannot have run is not counted.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SteadyClock {
    /// Last reading of the clock, and the steady time at that reading.
    last: Option<(LocalTime, LocalTime)>,
}

impl SteadyClock {
    /// The steady time, and whether the clock jumped: a step back, or one longer than [`Deadline::ClockJumped`].
    pub(super) fn read(&mut self, now: Now) -> (Now, bool) {
        let (reading, steady) = self.last.unwrap_or((now.local, now.local));
        let since_s = now.local.seconds_since(reading);
        let jumped = since_s < 0.0 || Deadline::ClockJumped.is_past(since_s);
        let since = if jumped { 0 } else { now.local.nanoseconds() - reading.nanoseconds() };
        let local = LocalTime::from_nanoseconds(steady.nanoseconds().saturating_add(since));
        self.last = Some((now.local, local));
        (Now { local, ..now }, jumped)
    }
}
