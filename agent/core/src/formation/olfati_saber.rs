//! Flocking as a lattice: neighbours keep one distance, all take the goal's velocity, nobody leads.
//!
//! R. Olfati-Saber, "Flocking for Multi-Agent Dynamic Systems: Algorithms and Theory", IEEE Trans. Automatic Control 51(3)
//! (2006), algorithm 2 (equations 23 and 24), for double integrators:
//!
//! ```text
//! u_i = Σ φ_α(‖q_j − q_i‖σ) n_ij + Σ a_ij (p_j − p_i) − c1 (q_i − q_r) − c2 (p_i − p_r)
//! ‖z‖σ = (√(1 + ε|z|²) − 1)/ε,   n_ij = (q_j − q_i)/√(1 + ε|q_j − q_i|²)
//! φ_α(z) = ρ_h(z/‖r‖σ) φ(z − ‖d‖σ),   φ(z) = ½((a + b) σ1(z + c) + a − b),   σ1(z) = z/√(1 + z²),   c = |a − b|/√(4ab)
//! a_ij = ρ_h(‖q_j − q_i‖σ/‖r‖σ),   ρ_h(z): 1 up to h, then ½(1 + cos(π(z − h)/(1 − h))), 0 from 1 on
//! ```
//!
//! **Units.** The source's agents are points with d = 7 and ‖u‖ up to 15: taken in metres and seconds no helicopter follows
//! that. So the interaction is computed in the source's own units: a unit of length is d/7, a unit of time is a parameter.
//! The law's own constants stay the source's. A helicopter takes velocities: it is asked for p_i + u_i · horizon.

use alloc::boxed::Box;
use alloc::format;
use alloc::string::String;
use core::f64::consts::PI;
use skein_common::math;

use nalgebra::Vector2;

use super::law::{Answer, Law, Setup, Sight, Wanted};

/// d in the source's units.
const SOURCE_DISTANCE: f64 = 7.0;

/// The law's parameters, the interaction's in the source's units.
#[derive(Clone, Copy, Debug, PartialEq)]
struct OlfatiSaber {
    unit_m: f64,
    unit_s: f64,
    epsilon: f64,
    a: f64,
    b: f64,
    h: f64,
    /// Half of what makes φ(0) zero: c.
    c: f64,
    /// ‖d‖σ.
    distance_sigma: f64,
    /// ‖r‖σ.
    range_sigma: f64,
    c1_per_s2: f64,
    c2_per_s: f64,
    horizon_s: f64,
    max_speed_m_s: f64,
}

/// The law of a scenario.
pub(super) fn make(setup: &Setup<'_>) -> Result<Box<dyn Law>, String> {
    Ok(Box::new(OlfatiSaber::new(&setup.formation.olfati_saber)?))
}

impl OlfatiSaber {
    fn new(wanted: &skein_common::scenario::OlfatiSaber) -> Result<Self, String> {
        let (a, b, epsilon) = (wanted.action_a, wanted.action_b, wanted.epsilon);
        if a > b {
            return Err(format!("`formation.olfati_saber.action_a` is {a}, but may not be above `action_b`, {b}"));
        }
        let range = wanted.range_ratio * SOURCE_DISTANCE;
        Ok(Self {
            unit_m: wanted.distance_m / SOURCE_DISTANCE,
            unit_s: wanted.time_unit_s,
            epsilon,
            a,
            b,
            h: wanted.bump_h,
            c: (a - b).abs() / (4.0 * a * b).sqrt(),
            distance_sigma: sigma_norm(epsilon, SOURCE_DISTANCE * SOURCE_DISTANCE),
            range_sigma: sigma_norm(epsilon, range * range),
            c1_per_s2: wanted.c1_per_s2,
            c2_per_s: wanted.c2_per_s,
            horizon_s: wanted.horizon_s,
            max_speed_m_s: wanted.max_speed_m_s,
        })
    }

    /// ρ_h: 1 near zero, 0 from 1 on, smooth.
    fn bump(&self, z: f64) -> f64 {
        if z < self.h {
            1.0
        } else if z < 1.0 {
            0.5 * (1.0 + math::cos(PI * (z - self.h) / (1.0 - self.h)))
        } else {
            0.0
        }
    }

    /// φ_α of a sigma-norm.
    fn action(&self, sigma: f64) -> f64 {
        let shifted = sigma - self.distance_sigma + self.c;
        let uneven = 0.5 * ((self.a + self.b) * shifted / (1.0 + shifted * shifted).sqrt() + self.a - self.b);
        self.bump(sigma / self.range_sigma) * uneven
    }

    /// u_i, north and east, m/s².
    fn acceleration(&self, sight: &Sight<'_>) -> Vector2<f64> {
        let (place, velocity) = (sight.position.horizontal(), sight.velocity.horizontal());
        let (mut gradient, mut consensus) = (Vector2::zeros(), Vector2::zeros());
        for neighbour in sight.neighbours {
            let way = (neighbour.position.horizontal() - place) / self.unit_m;
            let squared = way.norm_squared();
            let sigma = sigma_norm(self.epsilon, squared);
            if sigma < self.range_sigma {
                gradient += way * (self.action(sigma) / (1.0 + self.epsilon * squared).sqrt());
                consensus += (neighbour.velocity.horizontal() - velocity) * self.bump(sigma / self.range_sigma);
            }
        }
        let relative = velocity - sight.goal.centre_velocity.horizontal();
        gradient * (self.unit_m / (self.unit_s * self.unit_s)) + consensus / self.unit_s
            - sight.from_centre_ne_m() * self.c1_per_s2
            - relative * self.c2_per_s
    }
}

impl Law for OlfatiSaber {
    fn ask(&mut self, sight: &Sight<'_>) -> Answer {
        let velocity = sight.velocity.horizontal() + self.acceleration(sight) * self.horizon_s;
        let is_there = sight.from_centre_ne_m().norm() <= sight.goal.radius_m && sight.is_slow();
        Answer { wanted: Wanted::level(velocity.cap_magnitude(self.max_speed_m_s)), is_there }
    }
}

/// ‖z‖σ for |z|².
fn sigma_norm(epsilon: f64, squared: f64) -> f64 {
    ((1.0 + epsilon * squared).sqrt() - 1.0) / epsilon
}

#[cfg(test)]
mod tests;
