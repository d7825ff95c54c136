//! What belongs to one law alone: `[formation.olfati_saber]` and so on.

use serde::{Deserialize, Serialize};

/// `[formation.olfati_saber]`; symbols of the source in brackets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OlfatiSaber {
    /// Distance of neighbours (d), which the source calls 7.
    pub distance_m: f64,
    /// Range of the interaction over that distance (r/d).
    pub range_ratio: f64,
    /// Of the sigma-norm (ε).
    pub epsilon: f64,
    /// Of the action function (a).
    pub action_a: f64,
    /// Of the action function (b).
    pub action_b: f64,
    /// Where the bump function begins to fall (h).
    pub bump_h: f64,
    /// What the source's unit of time is here.
    pub time_unit_s: f64,
    /// Towards the goal (c1).
    pub c1_per_s2: f64,
    /// Towards its velocity (c2).
    pub c2_per_s: f64,
    /// How long the wanted acceleration is flown ahead.
    pub horizon_s: f64,
    /// A faster velocity is cut to this.
    pub max_speed_m_s: f64,
}

/// `[formation.vasarhelyi]`; symbols of the source in brackets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Vasarhelyi {
    /// Fastest homing (v_flock).
    pub flock_speed_m_s: f64,
    /// A faster velocity is cut to this (v_max).
    pub max_speed_m_s: f64,
    /// Nearer than this two push each other away (r0_rep).
    pub repulsion_range_m: f64,
    /// How strongly (p_rep).
    pub repulsion_per_s: f64,
    /// Distance at which no difference of velocity is needed any more to stop in time (r0_frict).
    pub friction_offset_m: f64,
    /// Share of the excess difference of velocities that is taken out (C_frict).
    pub friction_gain: f64,
    /// Difference of velocities that is always allowed (v_frict).
    pub friction_slack_m_s: f64,
    /// Slope of the braking curve near its end (p_frict).
    pub friction_slope_per_s: f64,
    /// Deceleration of the braking curve (a_frict).
    pub friction_m_s2: f64,
    /// Homing beyond half of R*.
    pub homing_per_s: f64,
}

/// `[formation.slots]`, of the virtual structure and displacement consensus.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Slots {
    /// How they lie.
    pub pattern: Pattern,
    /// Between neighbours on a line, in a V, in a grid.
    pub spacing_m: f64,
    /// From the centre, north and east under heading 0; under [`Pattern::List`].
    pub offsets_ne_m: Option<Vec<[f64; 2]>>,
}

/// `formation.slots.pattern`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pattern {
    /// Evenly on the ellipse.
    Circle,
    /// Side by side.
    Line,
    /// Like geese, a right angle between the wings.
    V,
    /// In rows, as many columns as rows or one more.
    Grid,
    /// As listed.
    List,
}

/// `[formation.displacement_consensus]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DisplacementConsensus {
    /// Of the differences to the neighbours (k).
    pub gain_per_s: f64,
    /// Of the difference to the own slot about the centre (k_g).
    pub goal_gain_per_s: f64,
}
