//! Finds out whether another program flies the aircraft: it writes the same datarefs.
//!
//! The roll control is read back. While this program does not write it, a value that changes under an override is
//! another's; a program that has died leaves a constant value behind. While this program writes it, a value that it has
//! not written lately is another's: two programs fly the aircraft. Each that reads foreign values waits for a random time and
//! then leaves the aircraft to the other one, so that one remains. A value counts as written if it is nearly the same,
//! because a simulator may round it.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Time for which the value is watched before the first write.
const WATCH: Duration = Duration::from_millis(200);
/// Time without a foreign change after which the other program counts as gone.
const GONE: Duration = Duration::from_secs(2);
/// Time over which own and foreign values are counted.
const WINDOW: Duration = Duration::from_secs(1);
/// A window in which at least one value in this many is foreign is contested.
const FOREIGN_ONE_IN: u32 = 5;
/// Number of written values that may still be read back: those of more than a second.
const MEMORY: usize = 64;
/// Largest difference that a simulator's rounding may make.
const ROUNDING: f32 = 1e-3;
/// Number of contested windows after which a program yields at the earliest, and number of choices.
const LEAST_WINDOWS: u32 = 2;
const CHOICES: u32 = 6;

/// Watches the roll control.
#[derive(Debug, Default)]
pub(super) struct Holder {
    is_overridden: bool,
    /// The time at which the first value was read.
    since: Option<Instant>,
    last: Option<f32>,
    foreign_change: Option<Instant>,
    written: VecDeque<f32>,
    /// Start of the current window, with the numbers of own and of foreign values in it.
    window: Option<(Instant, u32, u32)>,
    /// Number of contested windows in a row.
    contested: u32,
    yields_after: u32,
    has_yielded: bool,
    /// The controls were given back, and no override has been read as off since then.
    is_left_over: bool,
}

impl Holder {
    /// A holder that yields after a number of windows that this random number decides.
    pub(super) fn new(random: u32) -> Self {
        Self { yields_after: LEAST_WINDOWS + random % CHOICES, ..Self::default() }
    }

    /// Takes a value of the override.
    pub(super) fn overridden(&mut self, is_on: bool) {
        self.is_overridden = is_on;
        self.is_left_over &= is_on;
    }

    /// Notes that this program has given the controls back: what changes from now on is not its own.
    pub(super) fn gave_back(&mut self) {
        self.written.clear();
        (self.window, self.contested, self.has_yielded) = (None, 0, false);
        (self.foreign_change, self.is_left_over) = (None, true);
    }

    /// Whether the controls were given back and are still overridden, because the datagrams were lost.
    pub(super) fn is_left_over(&self) -> bool {
        self.is_left_over && self.is_overridden
    }

    /// Takes a value of the roll control.
    pub(super) fn read(&mut self, value: f32, now: Instant) {
        self.since.get_or_insert(now);
        let is_own = self.written.iter().any(|written| (written - value).abs() < ROUNDING);
        let is_changed = self.last.replace(value).is_some_and(|last| last != value);
        if !is_own && is_changed && self.is_overridden && !self.is_left_over {
            self.foreign_change = Some(now);
        }
        let (begin, own, foreign) = self.window.unwrap_or((now, 0, 0));
        let (own, foreign) = (own + u32::from(is_own), foreign + u32::from(!is_own));
        self.window = Some((begin, own, foreign));
        if now.saturating_duration_since(begin) < WINDOW {
            return;
        }
        let is_contested = foreign * FOREIGN_ONE_IN >= own + foreign;
        self.window = None;
        self.contested = if is_contested && self.is_overridden { self.contested + 1 } else { 0 };
        if self.contested >= self.yields_after {
            self.has_yielded = true;
            self.written.clear();
        }
    }

    /// Takes a value that this program writes.
    pub(super) fn wrote(&mut self, value: f32) {
        if self.written.len() == MEMORY {
            self.written.pop_front();
        }
        self.written.push_back(value);
    }

    /// Whether another program flies the aircraft, so that this one must not.
    pub(super) fn is_other(&mut self, now: Instant) -> bool {
        let is_changing = self.foreign_change.is_some_and(|at| now.saturating_duration_since(at) < GONE);
        if !is_changing {
            self.has_yielded = false;
        }
        is_changing && (self.written.is_empty() || self.has_yielded)
    }

    /// Whether it is too early to know: the value has not been watched long enough before the first write.
    pub(super) fn is_unknown(&self, now: Instant) -> bool {
        self.written.is_empty() && self.since.is_some_and(|since| now.saturating_duration_since(since) < WATCH)
    }
}
