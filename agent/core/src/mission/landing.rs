//! The landing: descend on the spot, detect the ground, unload the rotor.

use skein_common::time::PlantTime;

use crate::deadlines::Deadline;
use crate::estimate::Estimate;

/// Descent rate of a landing, m/s, and the gentler one below [`GENTLE_BELOW_M`].
const DESCENT_M_S: f64 = 2.0;
const GENTLE_DESCENT_M_S: f64 = 0.7;
const GENTLE_BELOW_M: f64 = 6.0;
/// Largest lead of the altitude setpoint below the altitude the vehicle would keep, m: this error holds the commanded
/// sink rate.
const DESCENT_LEAD_M: f64 = 3.0;
/// Conditions of a touchdown, to be met for a while ([`Deadline::TouchedDown`]): height below the first value, m,
/// setpoint lower by more than the second, m, and vertical speed below the third, m/s.
const TOUCHDOWN_BELOW_M: f64 = 3.0;
const TOUCHDOWN_LEAD_M: f64 = 1.0;
const TOUCHDOWN_SINK_M_S: f64 = 0.15;
/// Signs that an unloaded vehicle was not on the ground, but kept in a low hover by a gust: it sinks by more than the first
/// value, m, at more than the second, m/s. On the ground only its skids give way.
const FALLS_BY_M: f64 = 0.1;
const FALLS_AT_M_S: f64 = 0.5;
/// Time constant of the filter for that vertical speed, s. Without it, the noise of a velocity sensor hides that the
/// vehicle rests.
const SINK_SMOOTHING_S: f64 = 0.2;

/// Descent rate of the shipped controllers above [`DESCENT_LEAD_M`], m/s: measured, and less than [`DESCENT_M_S`].
const USUAL_DESCENT_M_S: f64 = 1.1;

/// Usual duration of a landing from this height until the vehicle has landed, s: the descent at both rates, the time at rest
/// and the unloading of the rotor.
pub fn usual_s(height_m: f64) -> f64 {
    let gentle_m = height_m.clamp(0.0, GENTLE_BELOW_M);
    let fast_m = (height_m - GENTLE_BELOW_M).max(0.0);
    let descent_s = fast_m / USUAL_DESCENT_M_S + gentle_m / GENTLE_DESCENT_M_S;
    descent_s + Deadline::TouchedDown.after_s() + Deadline::Unloaded.after_s()
}

/// A landing in progress.
#[derive(Clone, Copy, Debug)]
pub struct Landing {
    last: PlantTime,
    /// Smoothed sink rate, m/s.
    sink_m_s: f64,
    /// Time for which the vehicle near the ground has not sunk, s.
    resting_s: f64,
    /// Time for which the rotor has been unloaded, s, and the height at which that began, m.
    unloading: Option<(f64, f64)>,
}

/// The stage of a landing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Descent {
    /// In the air: the altitude setpoint above the origin, m.
    To(f64),
    /// On the ground; the rotor is being unloaded.
    Unloading,
    /// The vehicle has landed.
    Down,
}

impl Landing {
    /// Begins a landing; a vehicle `on_ground` has no descent.
    pub fn begin(now: PlantTime, on_ground: bool) -> Self {
        Self { last: now, sink_m_s: 0.0, resting_s: 0.0, unloading: on_ground.then_some((0.0, 0.0)) }
    }

    /// Whether the vehicle has touched down.
    pub fn is_on_ground(&self) -> bool {
        self.unloading.is_some()
    }

    /// Continues from `altitude_m`, the last altitude setpoint. A healthy vehicle may hover `off_m` above its setpoint.
    pub fn step(&mut self, now: PlantTime, estimate: &Estimate, altitude_m: f64, off_m: f64) -> Descent {
        let dt_s = now.seconds_since(self.last).max(0.0);
        self.last = now;
        let at_m = estimate.position.altitude_m();
        // A vehicle in a low hover does not sink at once after the command; this is not a touchdown.
        let is_asked_down = altitude_m < at_m - TOUCHDOWN_LEAD_M;
        self.sink_m_s += (estimate.velocity.down_m_s() - self.sink_m_s) * (dt_s / SINK_SMOOTHING_S).min(1.0);
        let is_still = self.sink_m_s.abs() < TOUCHDOWN_SINK_M_S;
        let resting = estimate.height_m < TOUCHDOWN_BELOW_M && is_asked_down && is_still;
        self.resting_s = if resting { self.resting_s + dt_s } else { 0.0 };
        if Deadline::TouchedDown.is_past(self.resting_s) {
            self.unloading.get_or_insert((0.0, estimate.height_m));
        }
        let falls_from = |from_m: f64| estimate.height_m < from_m - FALLS_BY_M && self.sink_m_s > FALLS_AT_M_S;
        self.unloading = self.unloading.filter(|(_, from_m)| !falls_from(*from_m));
        if let Some((unloading_s, _)) = &mut self.unloading {
            *unloading_s += dt_s;
            return if Deadline::Unloaded.is_past(*unloading_s) { Descent::Down } else { Descent::Unloading };
        }
        let sink_m_s = if estimate.height_m > GENTLE_BELOW_M { DESCENT_M_S } else { GENTLE_DESCENT_M_S };
        Descent::To((altitude_m.min(at_m) - sink_m_s * dt_s).max(at_m - DESCENT_LEAD_M - off_m))
    }
}

#[cfg(test)]
mod tests {
    use skein_common::frame::{Attitude, BodyRates, Geodetic, PositionNed, VelocityNed};

    use super::*;

    #[test]
    fn the_announced_time_of_a_landing_is_near_the_flown_one() {
        // Flown with the built-in helicopter.
        for (height_m, flown_s) in [(5.0, 12.5), (30.0, 32.0), (60.0, 60.3)] {
            assert!((usual_s(height_m) - flown_s).abs() < 3.0, "from {height_m} m: {} s", usual_s(height_m));
        }
        assert!(usual_s(0.0) == 3.0 && usual_s(-1.0) == 3.0);
    }

    /// Steps of 20 ms at a height with a sink rate; the answer to the last one.
    fn steps(landing: &mut Landing, count: u64, height_m: f64, sink_m_s: f64) -> Descent {
        let estimate = Estimate {
            position: PositionNed::new(0.0, 0.0, -height_m),
            geodetic: Geodetic::from_degrees(28.0, -82.0, height_m),
            height_m,
            velocity: VelocityNed::new(0.0, 0.0, sink_m_s),
            attitude: Attitude::default(),
            rates: BodyRates::default(),
            rotor_speed_rad_s: None,
        };
        let mut step = || {
            let now = PlantTime::from_nanoseconds(landing.last.nanoseconds() + 20_000_000);
            landing.step(now, &estimate, height_m - 2.0, 0.0)
        };
        (1..count).for_each(|_| _ = step());
        step()
    }

    #[test]
    fn a_vehicle_that_a_gust_keeps_in_a_low_hover_continues_its_descent_when_it_falls() {
        let mut landing = Landing::begin(PlantTime::default(), false);
        assert_eq!(steps(&mut landing, 60, 1.7, 0.0), Descent::Unloading);
        // On the ground the skids give way a little.
        assert_eq!(steps(&mut landing, 5, 1.65, 0.6), Descent::Unloading);
        assert!(matches!(steps(&mut landing, 10, 1.5, 1.5), Descent::To(_)));
        assert!(!landing.is_on_ground());
        assert_eq!(steps(&mut landing, 150, 0.24, 0.0), Descent::Unloading);
        assert_eq!(steps(&mut landing, 100, 0.22, 0.0), Descent::Down);
    }
}
