//! The limits that the hover formation of four keeps: the acceptance figures of this program.
//!
//! They hold for the shipped scenario `hover` with the default preset and with the paper's, over any seed and on any plant. A
//! scenario that differs in any other key, such as one with wind or with faults, has no limits of its own.

use skein_common::scenario::{Preset, Scenario, load};

use super::{Measured, Outcome};
use crate::shipped;

/// The bound of a figure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bound {
    /// The figure is at most this.
    AtMost(f64),
    /// The figure is at least this.
    AtLeast(f64),
}

/// A limit of one figure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// Key of the figure.
    pub key: &'static str,
    /// Its bound.
    pub bound: Bound,
}

const fn at_most(key: &'static str, limit: f64) -> Limit {
    Limit { key, bound: Bound::AtMost(limit) }
}

const fn at_least(key: &'static str, limit: f64) -> Limit {
    Limit { key, bound: Bound::AtLeast(limit) }
}

/// The limits of the hover formation with the default preset.
pub const HOVER: [Limit; 13] = [
    at_most("collisions", 0.0),
    at_most("at_altitude_s", 20.0),
    at_most("in_band_s", 30.0),
    at_most("even_10deg_s", 120.0),
    at_most("even_5deg_s", 180.0),
    at_most("radial_rms_m", 2.0),
    at_least("radial_mean_m", 98.0),
    at_most("radial_mean_m", 103.0),
    at_most("spacing_error_deg", 3.0),
    at_least("nearest_pair_end_m", 135.0),
    at_most("oscillation_m", 0.3),
    at_least("min_separation_m", 10.0),
    at_most("max_tilt_deg", 25.0),
];

/// The limits of the hover formation with the paper's preset.
pub const PAPER_HOVER: [Limit; 12] = [
    at_most("collisions", 0.0),
    at_most("at_altitude_s", 20.0),
    at_most("in_band_s", 60.0),
    at_most("even_10deg_s", 240.0),
    at_most("radial_rms_m", 6.0),
    at_least("radial_mean_m", 96.0),
    at_most("radial_mean_m", 105.0),
    at_most("spacing_error_deg", 8.0),
    at_least("nearest_pair_end_m", 130.0),
    at_most("oscillation_m", 0.3),
    at_least("min_separation_m", 10.0),
    at_most("max_tilt_deg", 25.0),
];

impl Limit {
    /// Whether the run keeps this limit. A figure that it does not have, or whose event never happened, keeps none.
    pub fn is_kept(&self, run: &Measured) -> bool {
        match (run.outcome(self.key), self.bound) {
            (Some(Outcome::Value(value)), Bound::AtMost(limit)) => value <= limit,
            (Some(Outcome::Value(value)), Bound::AtLeast(limit)) => value >= limit,
            (Some(Outcome::Never) | None, _) => false,
        }
    }
}

/// The largest value of a figure that a run of any scenario may have: beyond it, a vehicle is not under control, or is
/// not flown by its law. `None` for other figures.
pub fn of_every_run(key: &str) -> Option<f64> {
    OF_EVERY_RUN.iter().find(|(known, _)| *known == key).map(|(_, limit)| *limit)
}

/// The figures that decide whether a vehicle is under control and flown by its law, each with its largest value. In gusts of
/// 8 m/s the shipped rules keep the heading within a few degrees, and reach no stop. Of a study on a law, a tenth flown by
/// another one says little.
pub const OF_EVERY_RUN: [(&str, f64); 3] =
    [("heading_error_rms_deg", 30.0), ("stick_saturation", 0.5), ("fallback_share", 0.1)];

/// The limits of a scenario; `None` if it has none.
pub fn of(scenario: &Scenario) -> Option<&'static [Limit]> {
    let (limits, preset): (&[Limit], _) = match scenario.preset {
        Preset::Default => (&HOVER, "preset=default"),
        Preset::Paper => (&PAPER_HOVER, "preset=paper"),
    };
    let mut hover = load(&shipped::HOVER, &[preset.to_owned()]).ok()?.scenario;
    // The limits hold for every seed, plant and recording, and for a longer flight.
    hover.seed = scenario.seed;
    hover.name.clone_from(&scenario.name);
    hover.record = scenario.record.clone();
    hover.swarm.name.clone_from(&scenario.swarm.name);
    hover.swarm.plant = scenario.swarm.plant;
    let is_long_enough = scenario.duration_s >= hover.duration_s;
    hover.duration_s = scenario.duration_s;
    (is_long_enough && hover == *scenario).then_some(limits)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hover(sets: &[&str]) -> Scenario {
        let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
        load(&shipped::HOVER, &sets).unwrap().scenario
    }

    #[test]
    fn the_hover_formation_has_limits_and_a_scenario_that_differs_has_none() {
        assert_eq!(of(&hover(&["seed=7", "swarm.plant=standin", "record.runs=none"])), Some(&HOVER[..]));
        assert_eq!(of(&hover(&["preset=paper"])), Some(&PAPER_HOVER[..]));
        for other in ["world.wind_m_s=5", "swarm.vehicles=5", "duration_s=100", "network.loss=0.1"] {
            assert_eq!(of(&hover(&[other])), None, "{other}");
        }
    }

    #[test]
    fn a_figure_beyond_its_bound_or_without_a_value_breaks_the_limit() {
        let run = Measured::read(r#"{"seed":1,"radial_mean_m":97.5,"in_band_s":null,"never":["in_band_s"]}"#).unwrap();
        let kept = |limit: Limit| limit.is_kept(&run);
        assert!(!kept(at_least("radial_mean_m", 98.0)) && kept(at_most("radial_mean_m", 103.0)));
        assert!(!kept(at_most("in_band_s", 60.0)) && !kept(at_most("max_tilt_deg", 25.0)));
    }
}
