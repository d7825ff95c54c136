//! Estimates the simulator's time from what it sends.
//!
//! A position carries no time stamp, and `sim/time/total_running_time_sec` comes as an f32, whose step grows to 8 ms
//! within a day: too coarse for a 20 ms frame. Plant time is therefore the local time between two positions, multiplied
//! by the rate of the simulator's time against local time. A paused simulator keeps sending positions while its time
//! stops.

use std::time::{Duration, Instant};

use skein_common::time::PlantTime;

/// Shortest time over which the rate is measured.
const WINDOW: Duration = Duration::from_secs(1);
/// Largest share of the measured time that one f32 step of the simulator's time may be.
const MAX_STEP_SHARE: f64 = 0.005;
/// Largest rate that X-Plane offers: 16 times real time.
const MAX_RATE: f64 = 16.0;
/// A simulator that was silent for longer was loading or gone; that time is not simulated time.
const MAX_SILENCE: Duration = Duration::from_secs(1);

/// Computes plant time from arrival times and from the simulator's reports of its own time.
#[derive(Debug)]
pub(super) struct Clock {
    time: PlantTime,
    last_frame: Option<Instant>,
    /// Last measured rate, simulated seconds per local second; 1 until measured.
    pub(super) rate: f64,
    paused: bool,
    /// Start of the current measurement of the rate: local time and the simulator's time, s.
    mark: Option<(Instant, f32)>,
    /// The time at which the simulator last reported its time.
    received: Option<Instant>,
}

impl Clock {
    pub(super) fn new() -> Self {
        Self { time: PlantTime::ZERO, last_frame: None, rate: 1.0, paused: false, mark: None, received: None }
    }

    /// Plant time of the frame that arrived at `at`, or `None` if no simulated time has passed since the last one. A
    /// silence counts as at most one second; the first frame is at zero.
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

    /// Reports that the simulator's time stands still, or that it runs.
    pub(super) fn set_paused(&mut self, paused: bool) {
        if paused != self.paused {
            self.paused = paused;
            self.mark = None;
        }
    }

    /// Takes a value of `sim/time/total_running_time_sec`, which arrived at `at`. A value below the previous one comes
    /// from a restarted simulator. The rate is never measured across a silence or a pause.
    pub(super) fn running_time(&mut self, at: Instant, running_s: f32) {
        let received = self.received.replace(at);
        let is_steady = !self.paused && received.is_some_and(|received| at <= received + MAX_SILENCE);
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
}

/// Time over which the rate must be measured so that the f32 step at this value matters little.
fn step_window(running_s: f32) -> Duration {
    let step_s = f64::from(running_s.next_up() - running_s);
    Duration::try_from_secs_f64(step_s / MAX_STEP_SHARE).unwrap_or(WINDOW)
}

#[cfg(test)]
mod tests;
