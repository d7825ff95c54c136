//! The clock of one agent.

use core::ops::Range;

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
        let (local, jumped) = self.steady(now.local);
        self.last = Some((now.local, local));
        (Now { local, ..now }, jumped)
    }

    /// The steady times of the last step and of one in which the clock shows `reading`: what this step takes arrives between them.
    pub(super) fn step_at(&self, reading: LocalTime) -> Range<LocalTime> {
        let (now, _) = self.steady(reading);
        self.last.map_or(LocalTime::ZERO, |(_, steady)| steady)..now
    }

    /// The steady time when the clock shows `reading`, and whether the clock has jumped.
    fn steady(&self, reading: LocalTime) -> (LocalTime, bool) {
        let (last, steady) = self.last.unwrap_or((reading, reading));
        let since_s = reading.seconds_since(last);
        let jumped = since_s < 0.0 || Deadline::ClockJumped.is_past(since_s);
        let since = if jumped { 0 } else { reading.nanoseconds() - last.nanoseconds() };
        (LocalTime::from_nanoseconds(steady.nanoseconds().saturating_add(since)), jumped)
    }
}
