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
        }
    }

    /// Reading of the vehicle's clock now, when a correct clock reads `right`.
    pub fn local_time(self, right: LocalTime) -> LocalTime {
        let drifted = drifted(right, self.drift);
        LocalTime::from_nanoseconds(drifted.nanoseconds() + self.zero.nanoseconds()).plus_seconds(self.ahead_s)
    }

    /// Makes the clock jump forward by `by_s`, or back if it is negative.
    pub fn jump(&mut self, by_s: f64) {
        self.ahead_s += by_s;
    }

    /// Whether the clock is correct.
    pub fn is_zero(self) -> bool {
        self == Self::default()
    }
}

/// The reading, at this correct time, of a clock that began with the correct one and has this relative rate error.
#[inline]
fn drifted(right: LocalTime, drift: f64) -> LocalTime {
    right.plus_seconds(right.seconds() * drift)
}

/// The steady clock of a vehicle's agent in one step: the vehicle's clock without its jumps, by which all ages are measured.
#[derive(Clone, Copy, Debug, Default)]
pub struct StepClock {
    /// Relative rate error.
    drift: f64,
    /// Difference to a correct clock with the same rate error, ns.
    ahead_ns: i64,
    /// Its readings in the last step and in this one.
    from: LocalTime,
    until: LocalTime,
}

impl StepClock {
    /// The clock in the step at this correct time, of a vehicle whose clock has this error. `step` begins with the reading in the
    /// step before, and ends with the one in this step.
    pub fn new(error: Skew, right: LocalTime, step: Range<LocalTime>) -> Self {
        let drift = error.drift;
        let ahead_ns = step.end.nanoseconds().wrapping_sub(drifted(right, drift).nanoseconds()) as i64;
        Self { drift, ahead_ns, from: step.start.min(step.end), until: step.end }
    }

    /// The time at this correct time, as if the clock had run steadily since then.
    #[inline]
    pub fn at(&self, right: LocalTime) -> LocalTime {
        let drifted = drifted(right, self.drift).nanoseconds();
        LocalTime::from_nanoseconds(drifted.saturating_add_signed(self.ahead_ns))
    }

    /// The time of an arrival at this correct time. In the step of a jump, too, a message arrives between the two steps.
    #[inline]
    pub fn at_arrival(&self, right: LocalTime) -> LocalTime {
        self.at(right).clamp(self.from, self.until)
    }

    /// The most by which an arrival in this step is ahead of a correct clock, if none arrives before this correct time, s.
    pub fn ahead_at_most_s(&self, earliest: LocalTime) -> f64 {
        self.until.seconds_since(earliest)
    }
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::{Source, load};

    use super::*;

    #[test]
    fn a_steady_clock_runs_on_through_a_jump() {
        let text = "swarm.vehicles = 1\nvehicle.1.clock_drift_ppm = 100";
        let scenario = load(&Source { name: "test.toml", text }, &[]).unwrap().scenario;
        let mut error = Skew::new(&scenario, VehicleId::new(1).unwrap());
        let at = |seconds: f64| LocalTime::from_seconds(seconds);
        let local = |error: Skew, right_s: f64| error.local_time(at(right_s));
        let before = StepClock::new(error, at(10_000.0), local(error, 9_999.9)..local(error, 10_000.0));
        assert_eq!(
            [10_000.0, 9_999.95, 9_000.0].map(|right_s| before.at(at(right_s)).nanoseconds()),
            [10_001_000_000_000, 10_000_949_995_000, 9_000_900_000_000]
        );
        assert_eq!(before.at_arrival(at(9_999.95)), before.at(at(9_999.95)));
        error.jump(-500.0);
        // In the step of the jump no time passes.
        let jumped = StepClock::new(error, at(10_000.1), at(10_001.0)..at(10_001.0));
        assert_eq!([9_000.0, 10_000.05].map(|right_s| jumped.at_arrival(at(right_s)).seconds()), [10_001.0; 2]);
        let after = StepClock::new(error, at(10_000.2), at(10_001.0)..at(10_001.1));
        assert_eq!(
            [10_000.2, 10_000.1].map(|right_s| after.at_arrival(at(right_s)).nanoseconds()),
            [10_001_100_000_000, 10_001_000_000_000]
        );
        let lost_s = before.at(at(9_000.0)).seconds_since(after.at(at(9_000.0)));
        assert!((0.09..0.11).contains(&lost_s), "the step of the jump is not counted: {lost_s} s");
    }

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
