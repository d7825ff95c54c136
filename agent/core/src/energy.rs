//! The energy that a vehicle has left, for displays: no decision depends on it.

use skein_common::time::PlantTime;

/// Joules in a watt-hour.
const J_PER_WH: f64 = 3600.0;
/// Longest time between two frames that counts, s: the power in a longer gap is unknown.
const LONGEST_STEP_S: f64 = 1.0;

/// Adds up the shaft power that the plant reports, from a full store at the start of the agent.
#[derive(Clone, Copy, Debug)]
pub struct Energy {
    capacity_j: Option<f64>,
    used_j: f64,
    last: Option<PlantTime>,
    is_known: bool,
}

impl Energy {
    /// The energy of a vehicle with this capacity at the rotor's shaft, Wh; `None` if it is not known.
    pub fn new(capacity_wh: Option<f64>) -> Self {
        Self {
            capacity_j: capacity_wh.map(|capacity_wh| capacity_wh * J_PER_WH),
            used_j: 0.0,
            last: None,
            is_known: false,
        }
    }

    /// Takes the power of a new frame with this time.
    pub fn take(&mut self, time: PlantTime, power_w: Option<f64>) {
        let since_s = self.last.map_or(0.0, |last| time.seconds_since(last)).clamp(0.0, LONGEST_STEP_S);
        self.last = Some(time);
        self.is_known = power_w.is_some();
        self.used_j += power_w.unwrap_or(0.0).max(0.0) * since_s;
    }

    /// Share of the capacity that is left, 0 to 1; `None` without a capacity, and while the plant reports no power.
    pub fn left(&self) -> Option<f64> {
        let capacity_j = self.capacity_j.filter(|_| self.is_known)?;
        Some((1.0 - self.used_j / capacity_j).clamp(0.0, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::aircraft::Aircraft;

    fn at(seconds: f64) -> PlantTime {
        PlantTime::from_seconds(seconds)
    }

    #[test]
    fn the_power_is_added_up_from_a_full_store() {
        let mut energy = Energy::new(Some(1.0));
        assert_eq!(energy.left(), None, "before the first frame");
        energy.take(at(100.0), Some(1800.0));
        assert_eq!(energy.left(), Some(1.0));
        for tenth in 1..=10 {
            energy.take(at(100.0 + 0.1 * f64::from(tenth)), Some(1800.0));
        }
        assert!(energy.left().is_some_and(|left| (left - 0.5).abs() < 1e-6), "{energy:?}");
        // Simulator time that stands still or goes back uses nothing, and a gap counts as one second.
        for at_s in [101.0, 50.0] {
            energy.take(at(at_s), Some(1800.0));
        }
        assert!(energy.left().is_some_and(|left| (left - 0.5).abs() < 1e-6), "{energy:?}");
        energy.take(at(500.0), Some(7200.0));
        assert_eq!(energy.left(), Some(0.0));
    }

    #[test]
    fn without_a_capacity_or_a_power_nothing_is_known() {
        let mut energy = Energy::new(None);
        energy.take(at(0.0), Some(1000.0));
        assert_eq!(energy.left(), None);
        let mut energy = Energy::new(Some(1.0));
        energy.take(at(0.0), None);
        assert_eq!(energy.left(), None);
    }

    #[test]
    fn the_shipped_helicopter_hovers_for_half_an_hour() {
        let aircraft = Aircraft::shipped("xcell60").unwrap().unwrap();
        // Its hover takes 1182 W.
        let minutes = aircraft.battery.unwrap().capacity_wh / 1182.0 * 60.0;
        assert!((29.0..32.0).contains(&minutes), "{minutes} min");
    }
}
