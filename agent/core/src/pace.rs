//! The rate of the simulator's frames as the agent receives them. Garcia & Barnes 2010 fly at 50 and refuse fewer than 20
//! frames a second.

use skein_common::message::EventKind;
use skein_common::time::LocalTime;

/// Time over which frames are counted to find that they are too few, s.
const SHORT_S: f64 = 2.0;
/// Number of such windows in a row that decide: one may have been cut by a stall.
const SHORT_RUN: u32 = 2;
/// Time over which frames are counted to compare their mean rate with 50 a second, s.
const LONG_S: f64 = 4.0;
/// Number of such windows in a row that decide, so that no stall shorter than a window does.
const LONG_RUN: u32 = 3;
/// Time without a frame after which the count begins anew, s.
const GAP_S: f64 = 1.0;
/// Mean rate below which it is low, and from which it no longer is, frames a second. Both are below 50, because a window
/// of irregular frames may contain one more or one less than a mean of 50 gives: 0.25 a second. They differ, so that a rate
/// between them does not alternate.
const LOW_HZ: f64 = 49.5;
const FULL_HZ: f64 = 49.7;

/// Counts frames and judges their rate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    min_hz: f64,
    last_frame: Option<LocalTime>,
    short: Window,
    long: Window,
    is_low: Settled,
    is_too_low: Settled,
    level: Level,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Level {
    Full,
    Low,
    TooLow,
}

impl Pace {
    /// A rate that nothing is known of yet; below `min_hz` it is too low.
    pub(crate) fn new(min_hz: f64) -> Self {
        Self {
            min_hz,
            last_frame: None,
            short: Window::new(SHORT_S),
            long: Window::new(LONG_S),
            is_low: Settled::after(LONG_RUN),
            is_too_low: Settled::after(SHORT_RUN),
            level: Level::Full,
        }
    }

    /// Counts a step; `has_frame` if it has a new frame. Returns the event of a change. A second without any frame says
    /// nothing of the rate: the simulator stands still or is lost, which is reported otherwise.
    pub(crate) fn update(&mut self, now: LocalTime, has_frame: bool) -> Option<EventKind> {
        if !has_frame {
            return None;
        }
        if self.last_frame.replace(now).is_none_or(|last| now.seconds_since(last) > GAP_S) {
            self.short.begin();
            self.long.begin();
        }
        let (short_hz, long_hz) = (self.short.count(now), self.long.count(now));
        if let Some(rate_hz) = long_hz {
            self.is_low.take(rate_hz < if self.is_low.value { FULL_HZ } else { LOW_HZ });
        }
        if let Some(rate_hz) = short_hz
            && self.is_too_low.take(rate_hz < self.min_hz)
        {
            // After a rate that was too low this window decides whether it is still low; later the longer ones do.
            self.is_low.settle(self.is_too_low.value || rate_hz < FULL_HZ);
        }
        let level = match (self.is_too_low.value, self.is_low.value) {
            (true, _) => Level::TooLow,
            (false, true) => Level::Low,
            (false, false) => Level::Full,
        };
        let rate_hz = short_hz.filter(|_| Level::TooLow == level || Level::TooLow == self.level).or(long_hz)?;
        let has_changed = core::mem::replace(&mut self.level, level) != level;
        has_changed.then(|| EventKind::FrameRate(whole(rate_hz, level)))
    }

    /// Whether a vehicle on the ground must not take off: the last window had too few frames.
    pub(crate) fn is_too_slow(&self) -> bool {
        self.is_too_low.last
    }
}

/// The rate to report: a low one is not rounded up to 50.
fn whole(rate_hz: f64, level: Level) -> u32 {
    if level == Level::Full { (rate_hz + 0.5) as u32 } else { (rate_hz + 0.5).min(49.0) as u32 }
}

/// Counts the frames of one time after the other.
#[derive(Clone, Copy, Debug)]
struct Window {
    length_s: f64,
    since: Option<LocalTime>,
    frames: u32,
}

impl Window {
    fn new(length_s: f64) -> Self {
        Self { length_s, since: None, frames: 0 }
    }

    /// Begins with the next frame.
    fn begin(&mut self) {
        self.since = None;
    }

    /// Counts a frame; the rate at the end of a window, Hz.
    fn count(&mut self, now: LocalTime) -> Option<f64> {
        let Some(since) = self.since else {
            (self.since, self.frames) = (Some(now), 0);
            return None;
        };
        self.frames += 1;
        let window_s = now.seconds_since(since);
        if window_s < self.length_s {
            return None;
        }
        let rate_hz = f64::from(self.frames) / window_s;
        (self.since, self.frames) = (Some(now), 0);
        Some(rate_hz)
    }
}

/// A finding that changes after a number of equal ones in a row.
#[derive(Clone, Copy, Debug)]
struct Settled {
    needed: u32,
    value: bool,
    last: bool,
    /// Number of findings in a row that contradict the value.
    against: u32,
}

impl Settled {
    fn after(needed: u32) -> Self {
        Self { needed, value: false, last: false, against: 0 }
    }

    /// Takes a finding. Returns whether the value has changed.
    fn take(&mut self, finding: bool) -> bool {
        self.last = finding;
        self.against = if finding == self.value { 0 } else { self.against + 1 };
        let is_over = self.against >= self.needed;
        if is_over {
            self.settle(finding);
        }
        is_over
    }

    fn settle(&mut self, value: bool) {
        (self.value, self.against) = (value, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steps at 50 Hz, of which the first `frames` of each second have a frame. Returns the events.
    fn run(pace: &mut Pace, from_s: u32, for_s: u32, frames: u32) -> Vec<EventKind> {
        let steps = (from_s * 50)..((from_s + for_s) * 50);
        steps
            .filter_map(|step| pace.update(LocalTime::from_seconds(f64::from(step) * 0.02), step % 50 < frames))
            .collect()
    }

    #[test]
    fn a_change_of_the_rate_is_reported_once_and_too_few_frames_keep_the_vehicle_on_the_ground() {
        let mut pace = Pace::new(20.0);
        assert_eq!(run(&mut pace, 0, 20, 50), []);
        assert_eq!(run(&mut pace, 20, 20, 30), [EventKind::FrameRate(30)]);
        assert!(!pace.is_too_slow());
        assert_eq!(run(&mut pace, 40, 10, 15), [EventKind::FrameRate(15)]);
        assert!(pace.is_too_slow());
        assert_eq!(run(&mut pace, 50, 20, 30), [EventKind::FrameRate(30)]);
        assert!(!pace.is_too_slow());
        assert_eq!(run(&mut pace, 70, 20, 50), [EventKind::FrameRate(50)]);
        assert_eq!(run(&mut pace, 90, 10, 15), [EventKind::FrameRate(15)]);
        assert_eq!(run(&mut pace, 100, 20, 50), [EventKind::FrameRate(50)]);
        assert!(!pace.is_too_slow());
    }

    #[test]
    fn a_short_stall_or_no_frame_at_all_is_no_change_of_the_rate() {
        for begin_s in 20..24 {
            let mut pace = Pace::new(20.0);
            assert_eq!(run(&mut pace, 0, begin_s, 50), []);
            assert_eq!(run(&mut pace, begin_s, 3, 30), []);
            assert_eq!(run(&mut pace, begin_s + 3, 17, 50), []);
            assert_eq!(run(&mut pace, begin_s + 20, 20, 0), []);
            assert!(!pace.is_too_slow());
        }
    }

    /// Frames of this mean rate for five minutes, each up to `jitter` of a period early or late. Returns the events.
    fn irregular(pace: &mut Pace, from_s: f64, rate_hz: f64, jitter: f64) -> Vec<EventKind> {
        let mut state = 1_u32;
        let frames = 0..(300.0 * rate_hz) as u32;
        let times_s = frames.map(|nth| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let late = jitter * (f64::from(state >> 8) / f64::from(1 << 23) - 1.0);
            from_s + (f64::from(nth) + 1.0 + late) / rate_hz
        });
        times_s.filter_map(|at_s| pace.update(LocalTime::from_seconds(at_s), true)).collect()
    }

    #[test]
    fn an_irregular_50_hz_is_not_low_and_a_little_less_is_low_once() {
        for jitter in [0.0, 0.2, 0.45] {
            let mut pace = Pace::new(20.0);
            assert_eq!(irregular(&mut pace, 0.0, 50.0, jitter), [], "{jitter}");
            assert_eq!(irregular(&mut pace, 300.0, 49.0, jitter), [EventKind::FrameRate(49)], "{jitter}");
            assert_eq!(irregular(&mut pace, 600.0, 49.5, jitter), [], "between the two limits: {jitter}");
            assert_eq!(irregular(&mut pace, 900.0, 50.0, jitter), [EventKind::FrameRate(50)], "{jitter}");
            assert_eq!(irregular(&mut pace, 1200.0, 60.0, jitter), [], "{jitter}");
        }
    }
}
