//! Parameters of single laws: `[formation.olfati_saber]` and so on.

use serde::{Deserialize, Serialize};

/// Parameters of the law of Olfati-Saber, `[formation.olfati_saber]`; symbols of the source in brackets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OlfatiSaber {
    /// Distance of neighbours (d), m; the source uses 7.
    pub distance_m: f64,
    /// Range of the interaction divided by the distance of neighbours (r/d).
    pub range_ratio: f64,
    /// Parameter of the sigma-norm (ε).
    pub epsilon: f64,
    /// Strength of repulsion in the action function (a).
    pub action_a: f64,
    /// Strength of attraction in the action function (b).
    pub action_b: f64,
    /// Share of the range at which the bump function begins to fall (h).
    pub bump_h: f64,
    /// Length of the source's unit of time, s.
    pub time_unit_s: f64,
    /// Gain towards the goal's position (c1), 1/s².
    pub c1_per_s2: f64,
    /// Gain towards the goal's velocity (c2), 1/s.
    pub c2_per_s: f64,
    /// Time for which the commanded acceleration is integrated to a velocity, s.
    pub horizon_s: f64,
    /// Largest commanded speed, m/s.
    pub max_speed_m_s: f64,
}

/// Parameters of the law of Vásárhelyi et al., `[formation.vasarhelyi]`; symbols of the source in brackets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Vasarhelyi {
    /// Largest homing speed (v_flock), m/s.
    pub flock_speed_m_s: f64,
    /// Largest commanded speed (v_max), m/s.
    pub max_speed_m_s: f64,
    /// Distance below which two vehicles repel each other (r0_rep), m.
    pub repulsion_range_m: f64,
    /// Gain of the repulsion (p_rep), 1/s.
    pub repulsion_per_s: f64,
    /// Distance at which the braking curve reaches zero speed (r0_frict), m.
    pub friction_offset_m: f64,
    /// Share of the excess velocity difference that is removed (C_frict).
    pub friction_gain: f64,
    /// Velocity difference that is always allowed (v_frict), m/s.
    pub friction_slack_m_s: f64,
    /// Slope of the braking curve near its end (p_frict), 1/s.
    pub friction_slope_per_s: f64,
    /// Deceleration of the braking curve (a_frict), m/s².
    pub friction_m_s2: f64,
    /// Gain of the homing beyond half of R*, 1/s.
    pub homing_per_s: f64,
}

/// Slots of the laws virtual structure and displacement consensus, `[formation.slots]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Slots {
    /// Arrangement of the slots.
    pub pattern: Pattern,
    /// Distance between neighbouring slots of a line, a V or a grid, m.
    pub spacing_m: f64,
    /// Offsets of the slots from the centre under [`Pattern::List`], north and east for heading 0, m.
    pub offsets_ne_m: Option<Vec<[f64; 2]>>,
}

/// Arrangement of the slots, `formation.slots.pattern`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pattern {
    /// Evenly on the ellipse.
    Circle,
    /// In a line abreast.
    Line,
    /// In a V with a right angle between its arms.
    V,
    /// In rows and columns, as many columns as rows or one more.
    Grid,
    /// As listed in `offsets_ne_m`.
    List,
}

/// Parameters of displacement consensus, `[formation.displacement_consensus]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DisplacementConsensus {
    /// Gain of the differences to the neighbours (k), 1/s.
    pub gain_per_s: f64,
    /// Gain towards the own slot about the centre (k_g), 1/s.
    pub goal_gain_per_s: f64,
}
