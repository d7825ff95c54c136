//! Whether the area of a flock has room for all vehicles.
//!
//! Under the flocking laws a vehicle has completed a place when it is within `formation.radius_m` of the centre and slow.
//! Vehicles that keep too large a distance for that area push each other out of it, and the mission never goes to its next
//! step.

use alloc::format;
use alloc::string::String;

use skein_common::scenario::{self, AvoidDistance, Formation, Law, Scenario, Target};

/// Radius that N vehicles at the distance d need, as a share of d √N. Measured with 4, 8 and 12 vehicles in calm air: from 0.41
/// to 0.48 on under the flock, from 0.45 to 0.53 on under Olfati-Saber's law, from 0.33 to 0.42 on under Vásárhelyi's.
const ROOM: f64 = 0.5;

/// The first step that may never be completed because its area has no room for all vehicles, as a sentence with the remedy.
pub fn crowded_step(scenario: &Scenario) -> Option<String> {
    let (steps, vehicles) = (&scenario.mission.steps, scenario.swarm.vehicles);
    let has_next = |nth: usize| nth + 1 < steps.len();
    steps.iter().enumerate().find_map(|(nth, scenario::Step { formation, target, .. })| {
        let ends_in_place = matches!(target, Target::Centre(_) | Target::Path(_));
        let (key, distance_m) = kept_distance(formation).filter(|_| ends_in_place && has_next(nth))?;
        let (radius_m, needed_m) = (formation.radius_m, ROOM * distance_m * (vehicles as f64).sqrt());
        (radius_m < needed_m).then(|| {
            format!(
                "mission.steps[{nth}] may never be completed: within formation.radius_m = {radius_m} m there may be no room \
                 for {vehicles} vehicles that keep {key} = {distance_m} m; make the radius {:.0} m or more, or the distance \
                 smaller",
                needed_m.ceil()
            )
        })
    })
}

/// The distance that a flocking law keeps between vehicles, m, with its key; `None` if the law has no such distance.
fn kept_distance(formation: &Formation) -> Option<(&'static str, f64)> {
    match formation.law {
        Law::Flock => match formation.avoid_distance_m {
            AvoidDistance::Fixed(distance_m) => Some(("formation.avoid_distance_m", distance_m)),
            AvoidDistance::Adaptive => None,
        },
        Law::OlfatiSaber => Some(("formation.olfati_saber.distance_m", formation.olfati_saber.distance_m)),
        Law::Vasarhelyi => Some(("formation.vasarhelyi.repulsion_range_m", formation.vasarhelyi.repulsion_range_m)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::{Source, load};

    use super::*;

    const TWO: &str = "{ centre_ne_m = [0, 0] }, { land = true }";

    fn of(law: &str, vehicles: usize, radius_m: f64, steps: &str) -> Option<String> {
        let text = format!(
            "swarm.vehicles = {vehicles}\nformation = {{ law = '{law}', radius_m = {radius_m}, outer_width_m = 5 }}\n\
             mission.steps = [{steps}]"
        );
        crowded_step(&load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario)
    }

    #[test]
    fn a_flock_without_room_is_named_with_the_radius_that_has_room() {
        let why = of("flock", 12, 30.0, TWO).unwrap();
        assert!(why.starts_with("mission.steps[0] may never be completed"), "{why}");
        assert!(why.contains("formation.avoid_distance_m = 20 m; make the radius 35 m or more"), "{why}");
        assert!(of("olfati-saber", 8, 40.0, TWO).unwrap().contains("make the radius 43 m or more"));
        assert!(of("vasarhelyi", 12, 30.0, TWO).is_some());
        for law in ["flock", "olfati-saber", "vasarhelyi"] {
            assert_eq!(of(law, 12, 55.0, TWO), None, "{law}");
        }
    }

    #[test]
    fn a_flock_that_has_nowhere_to_go_and_a_formation_with_places_need_no_room() {
        assert_eq!(of("flock", 12, 30.0, "{ centre_ne_m = [0, 0] }"), None, "the last step needs no end");
        assert_eq!(of("flock", 12, 30.0, "{ hold_s = 9 }, { land = true }"), None, "a hold ends by time");
        for law in ["ring", "virtual-structure", "displacement-consensus"] {
            assert_eq!(of(law, 12, 30.0, TWO), None, "{law}");
        }
    }
}
