//! Measures frame jitter and step duration. The measurement is always on.

use std::time::{Duration, Instant};

use skein_common::statistics::quantile;

/// Space for the samples of one second, so that pushing a sample never allocates.
const SAMPLES: usize = 256;
/// Time between two summaries.
const WINDOW: Duration = Duration::from_secs(1);

/// Collects samples over one second; its counters run from the start.
#[derive(Debug)]
pub(super) struct Timing {
    period: Duration,
    since: Instant,
    /// Arrival time of the newest frame.
    pub(super) last_frame: Option<Instant>,
    late_ms: Vec<f64>,
    step_us: Vec<f64>,
    frames: u32,
    /// Duration of the previous step: from the frame's arrival to the last control written, µs.
    pub(super) last_step_us: Option<f64>,
    last_overran: bool,
    skipped: u64,
    /// Number of steps that ended after the next frame's time.
    pub(super) overruns: u64,
}

/// Timing over one second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct TimingSummary {
    pub(super) frame_rate_hz: f64,
    /// Largest excess of the time between two frames over their period, ms.
    pub(super) jitter_ms: f64,
    pub(super) step_p50_us: f64,
    pub(super) step_p99_us: f64,
}

impl Timing {
    pub(super) fn new(period: Duration, now: Instant) -> Self {
        Self {
            period,
            since: now,
            last_frame: None,
            late_ms: Vec::with_capacity(SAMPLES),
            step_us: Vec::with_capacity(SAMPLES),
            frames: 0,
            last_step_us: None,
            last_overran: false,
            skipped: 0,
            overruns: 0,
        }
    }

    /// Records a frame that arrived at `at`; the plant has skipped `skipped` frames since the start.
    pub(super) fn frame(&mut self, at: Instant, skipped: u64) {
        if let Some(last) = self.last_frame.replace(at) {
            let late = at.saturating_duration_since(last).saturating_sub(self.period);
            self.late_ms.push(late.as_secs_f64() * 1e3);
        }
        self.frames += 1;
        // The agent missed a frame because the previous step, or the work after it, was still running.
        self.overruns += u64::from(skipped > self.skipped && !self.last_overran);
        self.skipped = skipped;
    }

    /// Records the step of the frame that arrived at `from` and had written its last control at `to`.
    pub(super) fn step(&mut self, from: Instant, to: Instant) {
        let took = to.saturating_duration_since(from);
        self.last_overran = took > self.period;
        self.overruns += u64::from(self.last_overran);
        let took_us = took.as_secs_f64() * 1e6;
        self.last_step_us = Some(took_us);
        self.step_us.push(took_us);
    }

    /// Once a second: the timing of that second.
    pub(super) fn summary(&mut self, now: Instant) -> Option<TimingSummary> {
        let window = now.saturating_duration_since(self.since);
        if window < WINDOW {
            return None;
        }
        let summary = TimingSummary {
            frame_rate_hz: f64::from(self.frames) / window.as_secs_f64(),
            jitter_ms: quantile(&mut self.late_ms, 1.0).unwrap_or(0.0),
            step_p50_us: quantile(&mut self.step_us, 0.5).unwrap_or(0.0),
            step_p99_us: quantile(&mut self.step_us, 0.99).unwrap_or(0.0),
        };
        self.since = now;
        self.frames = 0;
        self.late_ms.clear();
        self.step_us.clear();
        Some(summary)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use skein_host::clock::now;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn a_second_of_timing_is_summarised() {
        let start = now();
        let mut timing = Timing::new(20 * MS, start);
        for frame in 0..50 {
            // One frame of fifty is 7 ms late, one step of fifty takes 3 ms.
            let at = start + 20 * MS * frame + if frame == 30 { 7 * MS } else { Duration::ZERO };
            timing.frame(at, 0);
            timing.step(at, at + if frame == 10 { 3 * MS } else { MS / 10 });
            assert_eq!(timing.summary(at), None);
        }
        let summary = timing.summary(start + 1000 * MS).unwrap();
        assert!((summary.frame_rate_hz - 50.0).abs() < 1e-9, "{summary:?}");
        assert!((summary.jitter_ms - 7.0).abs() < 1e-9, "{summary:?}");
        assert!((summary.step_p50_us - 100.0).abs() < 1e-9, "{summary:?}");
        // Rank 0.99 * 49 = 48.51 of 0 to 49: between the last step of 100 µs and the one of 3 ms.
        assert!((summary.step_p99_us - (100.0 + 0.51 * 2900.0)).abs() < 1e-6, "{summary:?}");
        assert_eq!(timing.overruns, 0);
        assert_eq!(timing.summary(start + 2000 * MS).unwrap().step_p99_us, 0.0, "an empty second");
    }

    #[test]
    fn one_late_step_counts_as_one_overrun() {
        let start = now();
        let mut timing = Timing::new(20 * MS, start);
        timing.frame(start, 0);
        timing.step(start, start + 21 * MS);
        assert_eq!((timing.overruns, timing.last_step_us), (1, Some(21_000.0)));
        timing.frame(start + 60 * MS, 1);
        assert_eq!(timing.overruns, 1, "that step also made the plant skip a frame: one overrun, not two");
        timing.step(start + 60 * MS, start + 61 * MS);
        timing.frame(start + 120 * MS, 3);
        assert_eq!(timing.overruns, 2, "a frame skipped because of the work after the step");
    }
}
