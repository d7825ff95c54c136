//! Time limits of landings.

use std::time::Duration;

use skein_common::scenario::Scenario;

/// Added to the duration of a descent at [`SLOW_DESCENT_M_S`].
const LANDING: Duration = Duration::from_secs(60);
/// A quarter of the usual rate of descent, m/s.
const SLOW_DESCENT_M_S: f64 = 0.5;

/// Time limit for the landing of a vehicle at this height, m.
pub fn limit(height_m: f64) -> Duration {
    LANDING + Duration::from_secs_f64(height_m.clamp(0.0, 1e5) / SLOW_DESCENT_M_S)
}

/// Time limit for the landing of any vehicle of this scenario.
pub fn limit_of(scenario: &Scenario) -> Duration {
    let steps = scenario.mission.steps.iter().map(|step| &step.formation);
    let highest_m = steps.map(|flown| flown.altitude_m + flown.half_height_m(scenario.swarm.vehicles));
    limit(highest_m.fold(0.0, f64::max))
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::{Source, load};

    use super::*;

    #[test]
    fn a_higher_formation_has_more_time_to_land() {
        let limit_s = |text: &str| {
            let text = format!("swarm.vehicles = 5\nformation.radius_m = 60\nformation.altitude_m = {text}\n");
            limit_of(&load(&Source { name: "a.toml", text: &text }, &[]).unwrap().scenario).as_secs_f64()
        };
        assert_eq!(limit_s("300"), 660.0);
        assert_eq!(limit_s("300\nformation.band_step_m = 10"), 700.0, "two bands above the middle");
        assert_eq!(limit_s("300\nformation.vertical = 'ellipsoid'\nformation.gamma_z = 4"), 720.0);
        let steps =
            "mission.steps = [{ hold_s = 1 }, { hold_s = 1, formation = { altitude_m = 100 } }, { land = true }]";
        assert_eq!(limit_s(&format!("30\n{steps}")), 260.0, "the highest of all steps");
    }
}
