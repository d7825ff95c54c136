//! Parameters of single laws: `[formation.olfati_saber]` and so on.

use serde::{Deserialize, Serialize};

use super::super::key::keys;

keys! {
    /// Parameters of the law of Olfati-Saber, `[formation.olfati_saber]`; symbols of the source in brackets.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct OlfatiSaber at "formation.olfati_saber." {
        distance_m: f64 = above_zero(1e4), number(30.0),
            "distance d of neighbours in the lattice, 7 in Olfati-Saber 2006; 30 m suit a helicopter";
        range_ratio: f64 = from(1.0, 10.0), number(1.2),
            "range of the interaction over the distance, r/d; Olfati-Saber 2006, section IX", unit_is("1");
        epsilon: f64 = from(1e-3, 10.0), number(0.1),
            "epsilon of the sigma-norm; Olfati-Saber 2006", unit_is("1");
        action_a: f64 = above_zero(1e3), number(5.0),
            "a of the action function: the strength of repulsion; Olfati-Saber 2006", unit_is("1");
        action_b: f64 = above_zero(1e3), number(5.0),
            "b of the action function: the strength of attraction, at least action_a; Olfati-Saber 2006", unit_is("1");
        bump_h: f64 = from(0.0, 0.99), number(0.2),
            "h: share of the range at which the bump function begins to fall; Olfati-Saber 2006", unit_is("1");
        time_unit_s: f64 = above_zero(1e3), number(8.0),
            "length of the source's unit of time; 8 s slow the law down to what a helicopter can follow";
        c1_per_s2: f64 = from(0.0, 10.0), number(0.004),
            "gain c1 towards the goal's position; 0.02 would press sixteen vehicles together until the lattice breaks";
        c2_per_s: f64 = from(0.0, 10.0), number(0.13),
            "gain c2 towards the goal's velocity; 2 sqrt(c1) is critical damping";
        horizon_s: f64 = above_zero(10.0), number(1.0),
            "time for which the law's acceleration is integrated to the velocity that is flown; 1 s is the helicopter's lag";
        max_speed_m_s: f64 = above_zero(50.0), number(5.0),
            "largest commanded speed: a faster velocity is cut to it; 5 m/s suit the helicopter";
    }

    /// Parameters of the law of Vásárhelyi et al., `[formation.vasarhelyi]`; symbols of the source in brackets.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct Vasarhelyi at "formation.vasarhelyi." {
        flock_speed_m_s: f64 = above_zero(20.0), number(4.0),
            "v_flock: fastest homing speed; Vasarhelyi et al. 2018, the set evolved for 4 m/s";
        max_speed_m_s: f64 = above_zero(50.0), number(6.0),
            "v_max: largest commanded speed, a faster velocity is cut to it; Vasarhelyi et al. 2018";
        repulsion_range_m: f64 = above_zero(1e4), number(25.6),
            "r0_rep: nearer than this two vehicles repel each other; Vasarhelyi et al. 2018";
        repulsion_per_s: f64 = from(0.0, 10.0), number(0.13),
            "p_rep: gain of the repulsion; Vasarhelyi et al. 2018";
        friction_offset_m: f64 = from(0.0, 1e4), number(85.3),
            "r0_frict: distance at which the braking curve reaches zero speed; Vasarhelyi et al. 2018";
        friction_gain: f64 = from(0.0, 10.0), number(0.05),
            "C_frict: share of the excess velocity difference that is removed; Vasarhelyi et al. 2018", unit_is("1");
        friction_slack_m_s: f64 = from(0.0, 50.0), number(0.63),
            "v_frict: velocity difference that is always allowed; Vasarhelyi et al. 2018";
        friction_slope_per_s: f64 = above_zero(100.0), number(3.2),
            "p_frict: slope of the braking curve near its end; Vasarhelyi et al. 2018";
        friction_m_s2: f64 = above_zero(100.0), number(4.16),
            "a_frict: deceleration of the braking curve; Vasarhelyi et al. 2018";
        homing_per_s: f64 = from(0.0, 10.0), number(0.05),
            "gain towards the centre from half of R* on; it replaces the walls of the source";
    }

    /// Slots of the laws virtual structure and displacement consensus, `[formation.slots]`.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct Slots at "formation.slots." {
        pattern: Pattern = OneOf(&["circle", "line", "v", "grid", "list"]), text("circle"),
            "slots of the laws virtual-structure and displacement-consensus: on the ellipse, in a line abreast, in a V, in rows and columns, or as listed";
        spacing_m: f64 = above_zero(1e4), number(20.0),
            "distance between neighbouring slots of a line, v or grid; more than twice safety_distance_m";
        offsets_ne_m: Option<Vec<[f64; 2]>> = Points, Nothing,
            "slots under pattern = \"list\", one for each vehicle: offsets from the centre, turned with heading_deg";
    }

    /// Parameters of displacement consensus, `[formation.displacement_consensus]`.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct DisplacementConsensus at "formation.displacement_consensus." {
        gain_per_s: f64 = from(0.0, 10.0), number(0.05),
            "gain k of the differences to the neighbours; with 0.05 sixteen vehicles that all receive each other's state are as fast as a helicopter \
             can follow";
        goal_gain_per_s: f64 = from(0.0, 10.0), number(0.1),
            "gain k_g towards the own slot about the centre; at 0 the formation keeps its shape and does not follow the centre";
    }
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
    /// The slots that `offsets_ne_m` lists.
    List,
}
