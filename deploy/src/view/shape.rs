//! What the page draws of a formation: as the scenario has it, or as an operator has changed it in flight.

use serde_json::{Value, json};
use skein_common::scenario::{Formation, SafetyFilter};

/// What the page draws of a formation.
pub(super) fn formation(formation: &Formation) -> Value {
    json!({
        "law": formation.law.name(),
        "radius_m": formation.radius_m,
        "gamma": formation.gamma,
        "heading_deg": formation.heading_deg,
        "inner_width_m": formation.inner_width_m,
        "outer_width_m": formation.outer_width_m,
        "altitude_m": formation.altitude_m,
        "safety_distance_m": safety_distance_m(formation),
    })
}

/// The distance that the safety filter keeps, m; `None` without a filter.
pub(super) fn safety_distance_m(formation: &Formation) -> Option<f64> {
    (formation.safety_filter == SafetyFilter::Cbf).then_some(formation.safety_distance_m)
}
