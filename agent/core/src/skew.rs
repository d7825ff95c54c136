//! The error of a vehicle's clock that a scenario sets.

use core::ops::Range;

use skein_common::id::VehicleId;
use skein_common::scenario::Scenario;
use skein_common::time::LocalTime;

/// Error of a vehicle's clock: `clock_offset_s` and `clock_drift_ppm` of the scenario's `[vehicle.N]`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Skew {
    /// Reading of the clock at the begin.
    zero: LocalTime,
    /// Relative rate error, positive for a fast clock.
    drift: f64,
    /// Sum of all jumps, s, positive forward.
    ahead_s: f64,
    /// The last jump: its correct time, and the sum of the jumps before it, s.
    last_jump: Option<(LocalTime, f64)>,
}

impl Skew {
    /// The clock of vehicle `own`. A clock cannot read less than zero, so the clock with the lowest offset begins at
    /// zero and the others begin ahead of it.
    pub fn new(scenario: &Scenario, own: VehicleId) -> Self {
        let Some(vehicle) = scenario.vehicle(own) else { return Self::default() };
        let last_s = scenario.vehicle.iter().map(|vehicle| vehicle.clock_offset_s).fold(0.0, f64::min);
        Self {
            zero: LocalTime::from_seconds(vehicle.clock_offset_s - last_s),
            drift: vehicle.clock_drift_ppm * 1e-6,
            ahead_s: 0.0,
            last_jump: None,
        }
    }

    /// Reading of the vehicle's clock now, when a correct clock reads `right`.
    pub fn local_time(self, right: LocalTime) -> LocalTime {
        self.reading(right, self.ahead_s)
    }

    /// Reading of the vehicle's clock when a correct clock read `right`, before the last jump or after it. Jumps before the last
    /// one count as older than `right`.
    pub fn stamp(self, right: LocalTime) -> LocalTime {
        if self.is_zero() {
            return right;
        }
        let before = self.last_jump.filter(|(at, _)| right <= *at);
        self.reading(right, before.map_or(self.ahead_s, |(_, ahead_s)| ahead_s))
    }

    fn reading(self, right: LocalTime, ahead_s: f64) -> LocalTime {
        let drifted = right.plus_seconds(right.seconds() * self.drift);
        LocalTime::from_nanoseconds(drifted.nanoseconds() + self.zero.nanoseconds()).plus_seconds(ahead_s)
    }

    /// Makes the clock jump forward by `by_s` when a correct clock reads `right`, or back if it is negative.
    pub fn jump(&mut self, right: LocalTime, by_s: f64) {
        if by_s == 0.0 {
            return;
        }
        self.last_jump = Some((right, self.ahead_s));
        self.ahead_s += by_s;
    }

    /// Whether the clock is correct.
    pub fn is_zero(self) -> bool {
        self == Self::default()
    }
}

/// A vehicle's clock at the arrivals of messages that one step of its agent takes.
#[derive(Clone, Copy, Debug, Default)]
pub struct ArrivalClock {
    error: Skew,
    /// The last step and this one, by the clock without its jumps.
    from: LocalTime,
    until: LocalTime,
}

impl ArrivalClock {
    /// The clock with this error, for a step that takes what has arrived between these two times by the clock without its jumps.
    pub fn new(error: Skew, step: Range<LocalTime>) -> Self {
        Self { error, from: step.start.min(step.end), until: step.end }
    }

    /// Time of an arrival at this correct time. Whatever the clock shows after a jump, the message arrives between the two steps.
    #[inline]
    pub fn at(&self, right: LocalTime) -> LocalTime {
        self.error.local_time(right).clamp(self.from, self.until)
    }

    /// The most by which an arrival since the last step can be ahead of a correct clock that reads `right` in this one, s.
    pub fn ahead_at_most_s(&self, right: LocalTime) -> f64 {
        let has_jumped = self.error.local_time(right) != self.until;
        let since_last_s = if has_jumped { self.until.seconds_since(self.from) } else { 0.0 };
        self.until.seconds_since(right) + since_last_s
    }
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::{Source, load};

    use super::*;

    #[test]
    fn a_skewed_clock_has_its_own_offset_and_rate() {
        let text = "swarm.vehicles = 3\n[vehicle]\n1.clock_drift_ppm = 100\n\
                    2 = { clock_offset_s = -7200, clock_drift_ppm = -50 }\n3.clock_offset_s = 3600";
        let scenario = load(&Source { name: "test.toml", text }, &[]).unwrap().scenario;
        let hour = LocalTime::from_seconds(3600.0);
        let local_time = scenario.ids().map(|id| {
            let skew = Skew::new(&scenario, id);
            assert!(!skew.is_zero());
            (skew.local_time(LocalTime::ZERO).seconds(), skew.local_time(hour).nanoseconds())
        });
        let expected = [(7200.0, 10_800_360_000_000), (0.0, 3_599_820_000_000), (10_800.0, 14_400_000_000_000)];
        assert_eq!(local_time.collect::<Vec<_>>(), expected);
        let plain = load(&Source { name: "test.toml", text: "swarm.vehicles = 3" }, &[]).unwrap().scenario;
        assert!(
            plain.ids().all(|id| Skew::new(&plain, id).is_zero() && Skew::new(&plain, id).local_time(hour) == hour)
        );
    }
}
