//! How far a scenario sets a vehicle's clock wrong.

use skein_common::id::VehicleId;
use skein_common::scenario::Scenario;
use skein_common::time::LocalTime;

/// How far a vehicle's clock is wrong by the scenario: `clock_offset_s` and `clock_drift_ppm` of `[vehicle.N]`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Skew {
    /// Where the clock begins.
    zero: LocalTime,
    /// How much too fast it runs.
    drift: f64,
    /// How far it has jumped ahead, s.
    ahead_s: f64,
}

impl Skew {
    /// The clock of vehicle `own`. No clock shows less than its zero, so the last of the swarm begins there and the others ahead
    /// of it.
    pub fn new(scenario: &Scenario, own: VehicleId) -> Self {
        let Some(vehicle) = scenario.vehicle(own) else { return Self::default() };
        let last_s = scenario.vehicle.iter().map(|vehicle| vehicle.clock_offset_s).fold(0.0, f64::min);
        Self {
            zero: LocalTime::from_seconds(vehicle.clock_offset_s - last_s),
            drift: vehicle.clock_drift_ppm * 1e-6,
            ahead_s: 0.0,
        }
    }

    /// What the clock shows when one that is right shows `right`.
    pub fn shown(self, right: LocalTime) -> LocalTime {
        let drifted = right.plus_seconds(right.seconds() * self.drift);
        LocalTime::from_nanoseconds(drifted.nanoseconds() + self.zero.nanoseconds()).plus_seconds(self.ahead_s)
    }

    /// The clock jumps forward, or back if negative, s.
    pub fn jump(&mut self, by_s: f64) {
        self.ahead_s += by_s;
    }

    /// Whether the clock is right.
    pub fn is_none(self) -> bool {
        self == Self::default()
    }
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::{Source, load};

    use super::*;

    #[test]
    fn a_skewed_clock_begins_elsewhere_and_runs_at_its_own_rate() {
        let text = "swarm.vehicles = 3\n[vehicle]\n1.clock_drift_ppm = 100\n\
                    2 = { clock_offset_s = -7200, clock_drift_ppm = -50 }\n3.clock_offset_s = 3600";
        let scenario = load(&Source { name: "test.toml", text }, &[]).unwrap().scenario;
        let hour = LocalTime::from_seconds(3600.0);
        let shown = scenario.ids().map(|id| {
            let skew = Skew::new(&scenario, id);
            assert!(!skew.is_none());
            (skew.shown(LocalTime::ZERO).seconds(), skew.shown(hour).nanoseconds())
        });
        let expected = [(7200.0, 10_800_360_000_000), (0.0, 3_599_820_000_000), (10_800.0, 14_400_000_000_000)];
        assert_eq!(shown.collect::<Vec<_>>(), expected);
        let plain = load(&Source { name: "test.toml", text: "swarm.vehicles = 3" }, &[]).unwrap().scenario;
        assert!(plain.ids().all(|id| Skew::new(&plain, id).is_none() && Skew::new(&plain, id).shown(hour) == hour));
    }
}
