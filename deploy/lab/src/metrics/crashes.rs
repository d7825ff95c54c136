//! Detects the vehicles that reach the ground otherwise than by a landing.

use super::{AIRBORNE_ABOVE_M, VehicleNow};
use skein_common::frame::Attitude;
use skein_common::math;
use skein_common::state::Membership;

/// Touchdown speed above which a vehicle has crashed, in any direction, m/s. A landing here touches down at less than
/// 1 m/s.
const CRASH_M_S: f64 = 3.0;
/// Tilt above which a touchdown is a crash at any speed, degrees.
const CRASH_TILT_DEG: f64 = 45.0;
/// Height of the centre of gravity of a vehicle on the ground, m, if it was never observed there.
const STANDING_M: f64 = 0.5;
/// Height above that on the ground below which a vehicle touches the ground, m.
const TOUCH_M: f64 = 0.3;

/// Detects the crash of one vehicle between take-off and touchdown.
#[derive(Clone, Debug, Default)]
pub(crate) struct CrashDetector {
    /// The least height observed before the vehicle was in the air, m.
    standing_m: Option<f64>,
    is_in_the_air: bool,
    /// Speed at the last observation, m/s.
    speed_m_s: f64,
    pub(super) has_crashed: bool,
}

impl CrashDetector {
    /// Observes the vehicle in the order of time.
    pub(super) fn look_at(&mut self, vehicle: &VehicleNow) {
        let (truth, lands) = (&vehicle.truth, vehicle.runs && vehicle.membership != Membership::Active);
        self.observe(truth.height_m, truth.velocity.0.norm(), &truth.attitude, lands);
    }

    /// Observes the vehicle at a height above the ground, m, with its speed, m/s, its attitude, and whether its agent lands
    /// it. Returns whether it crashes now for the first time.
    pub(crate) fn observe(&mut self, height_m: f64, speed_m_s: f64, attitude: &Attitude, lands: bool) -> bool {
        // The ground has already braked a vehicle that is observed touching it: the speed before counts too.
        let fastest_m_s = std::mem::replace(&mut self.speed_m_s, speed_m_s).max(speed_m_s);
        let had_crashed = self.has_crashed;
        if height_m > AIRBORNE_ABOVE_M {
            self.is_in_the_air = true;
        } else if !self.is_in_the_air {
            self.standing_m = Some(self.standing_m.map_or(height_m, |least_m| least_m.min(height_m)));
        } else if height_m <= self.standing_m.unwrap_or(STANDING_M) + TOUCH_M {
            self.is_in_the_air = false;
            let up = math::cos(attitude.roll_rad) * math::cos(attitude.pitch_rad);
            self.has_crashed |= !lands || fastest_m_s > CRASH_M_S || up < math::cos(CRASH_TILT_DEG.to_radians());
        }
        self.has_crashed && !had_crashed
    }
}

#[cfg(test)]
mod tests {
    use skein_common::frame::VelocityNed;

    use super::super::tests::vehicle;
    use super::*;

    /// Vehicle 1 at a height, sinking, landing or not.
    fn at(height_m: f64, sinks_m_s: f64, lands: bool) -> VehicleNow {
        let mut seen = vehicle(1, 0.0, 0.0, height_m);
        seen.truth.velocity = VelocityNed::new(0.0, 0.0, sinks_m_s);
        VehicleNow { membership: if lands { Membership::Left } else { Membership::Active }, ..seen }
    }

    fn crashes(history: &[VehicleNow]) -> u64 {
        let mut detector = CrashDetector::default();
        history.iter().for_each(|seen| detector.look_at(seen));
        u64::from(detector.has_crashed)
    }

    #[test]
    fn a_landing_is_not_a_crash() {
        let down = [at(0.25, 0.0, false), at(30.0, 1.0, true), at(1.0, 0.8, true), at(0.3, 0.4, true)];
        assert_eq!(crashes(&down), 0);
        assert_eq!(crashes(&[at(0.25, 0.0, false), at(1.0, 9.0, false), at(0.25, 9.0, false)]), 0, "it never flew");
    }

    #[test]
    fn the_speed_before_touchdown_counts() {
        let down = [at(0.25, 0.0, false), at(30.0, 1.0, true), at(0.6, 4.0, true), at(0.4, 1.0, true)];
        assert_eq!(crashes(&down), 1);
    }

    #[test]
    fn a_touchdown_without_a_landing_is_a_crash_at_any_speed() {
        let dead = VehicleNow { runs: false, ..at(0.3, 0.2, true) };
        assert_eq!(crashes(&[at(30.0, 0.2, false), dead, dead]), 1);
        assert_eq!(crashes(&[at(30.0, 0.2, false), at(0.3, 0.2, false), at(3.0, 0.0, false), at(0.3, 0.2, false)]), 1);
    }

    #[test]
    fn a_touchdown_on_the_side_is_a_crash() {
        let mut down = at(0.3, 0.2, true);
        down.truth.attitude.roll_rad = 1.5;
        assert_eq!(crashes(&[at(30.0, 1.0, true), down]), 1);
    }
}
