//! The simulator's time, as far as it can be told from outside.
//!
//! A position carries no time stamp, and `sim/time/total_running_time_sec` comes as an f32, whose step grows to 8 ms
//! within a day: too coarse for a 20 ms frame. So plant time is the local time between two positions, multiplied by
//! the rate at which the simulator's time passes beside the local one. A paused simulator goes on sending positions; its
//! time stands still.

use std::time::{Duration, Instant};

use skein_common::time::PlantTime;

/// The rate is measured over at least this long.
const WINDOW: Duration = Duration::from_secs(1);
/// And so long that one f32 step of the simulator's time is no more than this share of it.
const MAX_STEP_SHARE: f64 = 0.005;
/// X-Plane offers at most 16 times real time.
const MAX_RATE: f64 = 16.0;
/// A simulator that was silent for longer was loading or gone, and no time passed in it that matters.
const MAX_SILENCE: Duration = Duration::from_secs(1);

/// Plant time out of arrival times and what the simulator says of its own time.
#[derive(Debug)]
pub(super) struct Clock {
    time: PlantTime,
    last_frame: Option<Instant>,
    /// Simulated seconds in a local one.
    rate: f64,
    paused: bool,
    /// Where the present measurement of the rate began: local time and the simulator's.
    mark: Option<(Instant, f32)>,
    /// When the simulator last told its time.
    heard: Option<Instant>,
}

impl Clock {
    pub(super) fn new() -> Self {
        Self { time: PlantTime::ZERO, last_frame: None, rate: 1.0, paused: false, mark: None, heard: None }
    }

    /// The frame that arrived at `at` has this plant time, or none if no simulated time passed since the last one. A
    /// silence counts for at most a second, and the first frame is at zero.
    pub(super) fn frame(&mut self, at: Instant) -> Option<PlantTime> {
        let Some(last) = self.last_frame.replace(at) else {
            return (!self.paused).then_some(self.time);
        };
        let passed_s = at.saturating_duration_since(last).min(MAX_SILENCE).as_secs_f64();
        let rate = if self.paused { 0.0 } else { self.rate };
        let time = self.time.plus_seconds(passed_s * rate);
        let moved = time > self.time;
        self.time = time;
        moved.then_some(time)
    }

    /// `sim/time/paused`.
    pub(super) fn set_paused(&mut self, paused: bool) {
        if paused != self.paused {
            self.paused = paused;
            self.mark = None;
        }
    }

    pub(super) fn is_paused(&self) -> bool {
        self.paused
    }

    /// `sim/time/total_running_time_sec`, as it arrived at `at`. A clock that goes back is a restarted simulator's; nothing
    /// is measured across a silence or in a pause.
    pub(super) fn running_time(&mut self, at: Instant, running_s: f32) {
        let heard = self.heard.replace(at);
        let is_steady = !self.paused && heard.is_some_and(|heard| at <= heard + MAX_SILENCE);
        let Some((since, from_s)) = self.mark.filter(|&(_, from_s)| is_steady && running_s >= from_s) else {
            self.mark = Some((at, running_s));
            return;
        };
        let local = at.saturating_duration_since(since);
        if local >= WINDOW.max(step_window(running_s)) {
            self.rate = ((f64::from(running_s) - f64::from(from_s)) / local.as_secs_f64()).min(MAX_RATE);
            self.mark = Some((at, running_s));
        }
    }

    /// Simulated seconds in a local one, as last measured.
    pub(super) fn rate(&self) -> f64 {
        self.rate
    }
}

/// How long the rate must be measured for the f32 step at this value to matter little.
fn step_window(running_s: f32) -> Duration {
    let step_s = f64::from(running_s.next_up() - running_s);
    Duration::try_from_secs_f64(step_s / MAX_STEP_SHARE).unwrap_or(WINDOW)
}

#[cfg(test)]
mod tests;
