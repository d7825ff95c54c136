//! The table of all figures of `metrics.json`: key, unit, meaning, and whether more or less is worse.
//!
//! [`Report`], comparisons, summaries and the documentation are made from this table.

use std::collections::BTreeMap;

use serde::Serialize;

use super::run::Run;
use Direction::{Less, More};

/// Whether more or less of a figure is worse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// More is worse.
    More,
    /// Less is worse.
    Less,
}

/// A figure of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Figure {
    /// Key in `metrics.json`.
    pub key: &'static str,
    /// Unit, or the things that are counted.
    pub unit: &'static str,
    /// Whether more or less is worse; `None` if the figure is neither good nor bad.
    pub worse: Option<Direction>,
    /// Short name, for tables and axes.
    pub name: &'static str,
    /// Definition of the figure, in sentences.
    pub meaning: &'static str,
}

impl Figure {
    /// The direction in which the figure gets worse, "more" or "less"; empty if it is neither good nor bad.
    pub fn worse_is(&self) -> &'static str {
        match self.worse {
            Some(More) => "more",
            Some(Less) => "less",
            None => "",
        }
    }
}

const fn figure(
    key: &'static str,
    unit: &'static str,
    worse: Option<Direction>,
    name: &'static str,
    meaning: &'static str,
) -> Figure {
    Figure { key, unit, worse, name, meaning }
}

/// Declares every figure once: its key and its type in `metrics.json`, then what [`Figure`] has of it.
macro_rules! figures {
    ($($key:ident: $kind:ty, $unit:literal, $worse:expr, $name:literal, $meaning:literal;)*) => {
        /// The contents of `metrics.json`.
        #[derive(Clone, Debug, Serialize)]
        pub struct Report {
            /// Identity of the run.
            #[serde(flatten)]
            pub run: Run,
            $(#[doc = $meaning] pub $key: $kind,)*
            /// Radial error and effort of each vehicle, by id.
            pub vehicle: BTreeMap<String, VehicleReport>,
        }

        /// All figures, in the order of `metrics.json`.
        pub const FIGURES: &[Figure] = &[$(figure(stringify!($key), $unit, $worse, $name, $meaning),)*];
    };
}

figures! {
    duration_s: f64, "s", None, "length of a run", "Length of the window of the figures.";
    at_altitude_s: Option<f64>, "s", Some(More), "all at their altitude from then on", "First time after which every vehicle stays within 10 % of its altitude to the end of the window, or until the first member is at the mission's landing. In a mission of several places each settling figure counts at the step of each vehicle, and none is in `never`.";
    in_band_s: Option<f64>, "s", Some(More), "all in the band from then on", "First time after which every vehicle stays in the band of its step (under a law of flocks inside the area). Slots in a line, V, grid or list have no band.";
    even_10deg_s: Option<f64>, "s", Some(More), "gaps within 10° of even from then on", "First time after which every gap of the ring stays within 10° of even.";
    even_5deg_s: Option<f64>, "s", Some(More), "gaps within 5° of even from then on", "First time after which every gap of the ring stays within 5° of even.";
    radial_rms_m: Option<f64>, "m", Some(More), "root mean square distance from the ring", "Root mean square of the distance from the centre about R*, over the last 100 s.";
    radial_mean_m: Option<f64>, "m", None, "mean distance from the centre", "Mean distance from the centre, over the last 100 s.";
    radial_min_m: Option<f64>, "m", Some(Less), "least distance from the centre", "Least distance from the centre, over the last 100 s.";
    radial_max_m: Option<f64>, "m", Some(More), "largest distance from the centre", "Largest distance from the centre, over the last 100 s.";
    spacing_error_deg: Option<f64>, "degrees", Some(More), "largest gap error, mean", "Largest deviation of a gap of the ring from even, averaged over the last 100 s.";
    nearest_pair_end_m: Option<f64>, "m", Some(Less), "nearest pair at the end", "Distance of the nearest airborne pair at the end.";
    min_separation_m: Option<f64>, "m", Some(Less), "least distance of a pair", "Least distance of any pair of vehicles that are both above 2 m; under a law of flocks (`flock`, `olfati-saber`, `vasarhelyi`) from the first movement on.";
    collisions: u64, "pairs", Some(More), "pairs nearer than 2 m", "Pairs of vehicles, both above 2 m, that came nearer than 2 m; under a law of flocks from the first movement on.";
    crashes: u64, "vehicles", Some(More), "vehicles that crashed", "Vehicles that touched the ground after flying at more than 3 m/s, at more than 45° from upright, or without an agent to land them.";
    safety_activations: Option<u64>, "times", None, "activations of the safety filter", "How often the safety filter changed a law's command.";
    oscillation_m: Option<f64>, "m", Some(More), "largest oscillation about the ring", "Half the peak-to-peak distance from the centre without its trend, of the vehicle where it is largest, over the last 100 s.";
    max_tilt_deg: f64, "degrees", Some(More), "largest tilt", "Largest tilt of any vehicle.";
    altitude_rms_m: Option<f64>, "m", Some(More), "altitude error", "Root mean square of the altitude error, over the last 100 s.";
    stick_rms: Option<f64>, "share of travel", Some(More), "root mean square of the controls", "Root mean square of the controls for roll, pitch and yaw.";
    heading_error_rms_deg: Option<f64>, "degrees", Some(More), "heading error", "Root mean square of the deviation from the heading that a vehicle's agent found at the start, of the vehicle where it is largest, in the air over the last 100 s, or over the second half of a flight shorter than 200 s; a law of your own may turn vehicles and has none.";
    max_turn_rate_deg_s: Option<f64>, "degrees/s", Some(More), "largest turn rate", "Largest turn rate of a member in the air over the last 100 s, or over the second half of a flight shorter than 200 s.";
    stick_saturation: Option<f64>, "share of time", Some(More), "share of time with a control at its stop", "Share of the time in which the roll, pitch, yaw or collective control of a member in the air is at an end of its travel, of the vehicle where it is largest, over the last 100 s, or over the second half of a flight shorter than 200 s.";
    energy_j: Option<f64>, "J", Some(More), "shaft energy of all vehicles", "Shaft energy of all vehicles, where the plant measures it.";
    band_occupancy: Option<f64>, "share of time", Some(Less), "share of time in the band", "Share of time that members spend in the band, over the last 100 s; under a law of flocks inside R* while the centre moves.";
    polarization: Option<f64>, "0 to 1", Some(Less), "length of the mean direction of flight", "Length of the mean direction of flight of members faster than 0.2 m/s, over the last 100 s.";
    order: Option<f64>, "-1 to 1", Some(Less), "alignment of velocities, 1 is best", "Mean cosine between a member's velocity and those of the members that it is in contact with (Soria, Schiano and Floreano 2020), over the last 100 s.";
    safety: Option<f64>, "share of pairs", Some(Less), "share of pairs without a collision", "Share of pairs without a collision (Soria, Schiano and Floreano 2020).";
    union: Option<f64>, "0 to 1", Some(Less), "unity of the communication graph", "(N - components) / (N - 1) of the communication graph: 1 if it is in one piece. Two members are joined if each received a state of the other less than 0.5 s ago, however long that state was on its way.";
    connectivity: Option<f64>, "0 to 1", Some(Less), "algebraic connectivity", "Second smallest eigenvalue of the Laplacian of the communication graph, divided by N.";
    connected_share: Option<f64>, "share of time", Some(Less), "share of time in one piece", "Share of time in which the communication graph is in one piece.";
    velocity_correlation: Option<f64>, "-1 to 1", Some(Less), "alignment within each component", "Mean cosine between a member's velocity and those of all members in the same component of the communication graph (Vásárhelyi et al. 2018), over the last 100 s.";
    collision_risk: Option<f64>, "share of pairs", Some(More), "share of pairs in a collision", "Share of pairs that are in a collision, averaged over time (Vásárhelyi et al. 2018).";
    mean_speed_m_s: Option<f64>, "m/s", None, "mean speed over the ground", "Mean speed over the ground of all members, over the last 100 s.";
    disconnected_vehicles: Option<f64>, "vehicles", Some(More), "vehicles joined to no other, mean", "Members that are joined to no other in the communication graph, averaged over time.";
    min_cluster_vehicles: Option<f64>, "vehicles", Some(Less), "smallest component, mean", "Size of the smallest component of the communication graph, averaged over time.";
    centroid_lag_m: Option<f64>, "m", Some(More), "centroid from the formation's centre", "Distance of the members' centroid from the formation's centre, over the last 100 s; under a law of flocks while the centre moves.";
    max_centre_distance_m: Option<f64>, "m", Some(More), "farthest from the moving centre", "Largest distance of a member from its centre while that moves along a path.";
    setpoints_reached: Option<u64>, "steps", Some(Less), "mission steps reached by all", "Steps of the mission that every live member has reached or passed at the end.";
    setpoint_skew: Option<u64>, "steps", Some(More), "largest difference of mission steps", "Largest difference between the steps of two live members.";
    advance_latency_s: Option<f64>, "s", Some(More), "slowest advance to the next step", "Longest time from when every live member has reached a step until the last member leaves it.";
    forced_advances: Option<u64>, "times", Some(More), "advances without an active member", "How often a vehicle left a step without waiting for an active member.";
    detection_s: Option<f64>, "s", Some(More), "slowest detection of a lost peer", "Longest time from a death or a cut until every vehicle has lost the peers that it cannot receive. More than 30 s count as never.";
    false_suspicions: Option<u64>, "times", Some(More), "losses of a peer that was there", "How often a vehicle lost a peer that lived, had not left, had no cut link with it and was nearer than where loss by distance begins.";
    rejoin_s: Option<f64>, "s", Some(More), "slowest rejoin of a peer", "Longest time from a restart or a healed cut until every vehicle counts the peer as active again. More than 30 s count as never.";
    response_s: Option<f64>, "s", Some(More), "slowest report of an own failure", "Longest time from a failure of a vehicle until that vehicle reports one.";
    transient_s: Option<f64>, "s", Some(More), "slowest return into formation", "Longest time from a change of the live members, or from a healed cut, until all are in formation: at their altitude, in the band and even to 10°. More than 120 s count as never.";
    state_messages: u64, "messages", Some(More), "state messages sent", "State messages that the swarm has sent; under a central controller states and controls.";
    state_bytes: u64, "bytes", Some(More), "payload of the state messages", "Payload of the state messages.";
    peer_age_p50_ms: Option<f64>, "ms", Some(More), "median age of peer states", "Median age of the peers' states, each sampled at every seventh step in virtual time (less often in a swarm of more than 28), an upper bound that includes the delay; a central controller has none.";
    peer_age_p99_ms: Option<f64>, "ms", Some(More), "99th percentile age of peer states", "99th percentile of the age of the peers' states.";
    step_p50_us: Option<f64>, "us", Some(More), "median duration of a step", "Median time from a frame's arrival to its last control, in real time.";
    step_p99_us: Option<f64>, "us", Some(More), "99th percentile duration of a step", "99th percentile of the time from a frame's arrival to its last control, in real time.";
    frame_overruns: Option<u64>, "frames", Some(More), "steps that ended too late", "Steps that ended after the next frame was due; under a central controller, in a study too, frames that it skipped.";
    law_misses: Option<u64>, "asks", Some(More), "requests that the external law missed", "Asks that an external law did not answer in time, or answered with what is no answer.";
    fallback_share: Option<f64>, "share of time", Some(More), "flown by the fallback, not by the external law", "Share of the time in which the fallback flew in the place of an external law, of the vehicle where it is largest. A run with more than 0.1 has failed.";
    wall_s: f64, "s", None, "duration by the wall clock", "Time that the run took by the wall clock.";
    real_time_factor: f64, "s/s", None, "seconds flown for each second", "Time flown, joining included, for each second of wall clock.";
    never: Vec<&'static str>, "keys", None, "events that never happened", "Figures whose event could have happened but never did.";
}

/// One vehicle's own figures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[expect(missing_docs, reason = "the same keys as the swarm's")]
pub struct VehicleReport {
    pub radial_rms_m: Option<f64>,
    pub radial_mean_m: Option<f64>,
    pub oscillation_m: Option<f64>,
    pub stick_rms: Option<f64>,
    pub heading_error_rms_deg: Option<f64>,
    pub max_turn_rate_deg_s: Option<f64>,
    pub stick_saturation: Option<f64>,
    pub fallback_share: Option<f64>,
    pub energy_j: Option<f64>,
}

/// The figures of a fleet alone, besides [`FIGURES`] over all of its teams.
#[rustfmt::skip]
pub const FLEET_FIGURES: [Figure; 6] = [
    figure("teams", "teams", None, "number of teams", "Number of teams."),
    figure("across_separation_m", "m", Some(Less), "least distance of two teams' vehicles", "Least distance of two vehicles of different teams that are both above 2 m. `nearest_across` names them."),
    figure("across_collisions", "pairs", Some(More), "pairs of two teams nearer than 2 m", "Pairs of vehicles of different teams, both above 2 m, that came nearer than 2 m; `collisions` counts them too."),
    figure("stranger_states", "messages", Some(More), "states sent from other teams", "States of other teams that were sent to vehicles of the fleet, before loss, delay and range."),
    figure("surrounded_messages_per_s", "messages/s", Some(More), "messages received in a crowd", "Messages that are sent to a vehicle in a second, states and heartbeats of its team and states of others, before loss, as a mean over the vehicles with a vehicle in each of their nine cells."),
    figure("surrounded_bytes_per_s", "bytes/s", Some(More), "payload received in a crowd", "Payload of the messages of `surrounded_messages_per_s` in a second."),
];

/// The only figures that may differ between two runs of the same scenario and seed in virtual time.
pub const WALL_CLOCK_KEYS: [&str; 5] = ["wall_s", "real_time_factor", "step_p50_us", "step_p99_us", "frame_overruns"];

/// Finds the figure with this key.
pub fn of(key: &str) -> Option<&'static Figure> {
    FIGURES.iter().chain(&FLEET_FIGURES).find(|figure| figure.key == key)
}

/// The figures that can be better or worse, each with the direction in which it gets worse.
pub fn judged() -> impl Iterator<Item = (&'static str, Direction)> {
    FIGURES.iter().filter_map(|figure| Some((figure.key, figure.worse?)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_that_ends_in_a_unit_has_that_unit() {
        for (ending, unit) in [("_s", "s"), ("_m", "m"), ("_deg", "degrees"), ("_j", "J"), ("_ms", "ms"), ("_us", "us")]
        {
            let figures: Vec<_> = FIGURES.iter().filter(|figure| figure.key.ends_with(ending)).collect();
            let is_rate = |key: &str| ["_m_s", "_deg_s"].iter().any(|rate| key.ends_with(rate));
            assert!(figures.iter().all(|figure| figure.unit == unit || is_rate(figure.key)), "{figures:?}");
        }
    }
}
