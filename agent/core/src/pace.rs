//! The rate of the simulator's frames as the agent receives them. Garcia & Barnes 2010 fly at 50 and refuse fewer than 20
//! frames a second.

use skein_common::message::EventKind;
use skein_common::time::LocalTime;

/// Time over which frames are counted, s.
const WINDOW_S: f64 = 2.0;
/// Time without a frame after which the count begins anew, s.
const GAP_S: f64 = 1.0;
/// Frames a second below which the rate counts as low: a tenth below 50, because arrivals are irregular.
const LOW_HZ: f64 = 45.0;

/// Counts frames and judges their rate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    min_hz: f64,
    /// Start of the window.
    since: Option<LocalTime>,
    last_frame: Option<LocalTime>,
    frames: u32,
    level: Level,
    /// The level of the last window: a level counts after two windows in a row, because one may have been cut by a stall.
    seen: Level,
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
        Self { min_hz, since: None, last_frame: None, frames: 0, level: Level::Full, seen: Level::Full }
    }

    /// Counts a step; `has_frame` if it has a new frame. Returns the event of a change. A second without any frame says
    /// nothing of the rate: the simulator stands still or is lost, which is reported otherwise.
    pub(crate) fn update(&mut self, now: LocalTime, has_frame: bool) -> Option<EventKind> {
        if !has_frame {
            return None;
        }
        if self.last_frame.replace(now).is_none_or(|last| now.seconds_since(last) > GAP_S) {
            (self.since, self.frames) = (None, 0);
        }
        let since = *self.since.get_or_insert(now);
        self.frames += 1;
        let window_s = now.seconds_since(since);
        if window_s < WINDOW_S {
            return None;
        }
        let rate_hz = f64::from(self.frames) / window_s;
        (self.since, self.frames) = (Some(now), 0);
        let level = match rate_hz {
            _ if rate_hz < self.min_hz => Level::TooLow,
            _ if rate_hz < LOW_HZ => Level::Low,
            _ => Level::Full,
        };
        let is_settled = core::mem::replace(&mut self.seen, level) == level;
        let has_changed = is_settled && core::mem::replace(&mut self.level, level) != level;
        has_changed.then_some(EventKind::FrameRate((rate_hz + 0.5) as u32))
    }

    /// Whether a vehicle on the ground must not take off: the last window had too few frames.
    pub(crate) fn is_too_slow(&self) -> bool {
        self.seen == Level::TooLow
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
        assert_eq!(run(&mut pace, 0, 10, 50), []);
        assert_eq!(run(&mut pace, 10, 10, 30), [EventKind::FrameRate(30)]);
        assert!(!pace.is_too_slow());
        assert_eq!(run(&mut pace, 20, 10, 15), [EventKind::FrameRate(15)]);
        assert!(pace.is_too_slow());
        assert_eq!(run(&mut pace, 30, 10, 50), [EventKind::FrameRate(50)]);
        assert!(!pace.is_too_slow());
    }

    #[test]
    fn a_short_stall_or_no_frame_at_all_is_no_change_of_the_rate() {
        let mut pace = Pace::new(20.0);
        assert_eq!(run(&mut pace, 0, 10, 50), []);
        assert_eq!(run(&mut pace, 10, 2, 30), []);
        assert_eq!(run(&mut pace, 12, 8, 50), []);
        assert_eq!(run(&mut pace, 20, 20, 0), []);
        assert!(!pace.is_too_slow());
    }
}
