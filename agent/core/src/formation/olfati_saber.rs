//! Lattice flocking: neighbours keep one distance, all take the goal's velocity, without a leader.
//!
//! R. Olfati-Saber, "Flocking for Multi-Agent Dynamic Systems: Algorithms and Theory", IEEE Trans. Automatic Control
//! 51(3) (2006), algorithm 2 (equations 23 and 24), for double integrators:
//!
//! ```text
//! u_i = Σ φ_α(‖q_j − q_i‖σ) n_ij + Σ a_ij (p_j − p_i) − c1 (q_i − q_r) − c2 (p_i − p_r)
//! ‖z‖σ = (√(1 + ε|z|²) − 1)/ε,   n_ij = (q_j − q_i)/√(1 + ε|q_j − q_i|²)
//! φ_α(z) = ρ_h(z/‖r‖σ) φ(z − ‖d‖σ),   φ(z) = ½((a + b) σ1(z + c) + a − b),   σ1(z) = z/√(1 + z²),   c = |a − b|/√(4ab)
//! a_ij = ρ_h(‖q_j − q_i‖σ/‖r‖σ),   ρ_h(z): 1 up to h, then ½(1 + cos(π(z − h)/(1 − h))), 0 from 1 on
//! ```
//!
//! **Units.** The source's agents are points with d = 7 and ‖u‖ up to 15; in metres and seconds a helicopter cannot
//! follow that. So the interaction is computed in the source's units: the unit of length is d/7, the unit of time is a
//! parameter. The law's own constants are the source's. A helicopter takes velocities, so the command is p_i + u_i ·
//! horizon.

use alloc::boxed::Box;
use alloc::format;
use alloc::string::String;
use core::f64::consts::PI;

use nalgebra::Vector2;
use skein_common::{math, scenario};

use super::law::{Law, LawCommand, LawOutput, Observation, Setup};

/// Distance d in the source's units.
const SOURCE_DISTANCE: f64 = 7.0;

/// The law's parameters, and what follows from them; those of the interaction are in the source's units.
#[derive(Clone, Debug, PartialEq)]
struct OlfatiSaber {
    its: scenario::OlfatiSaber,
    unit_m: f64,
    /// Shift c that makes φ(0) zero.
    c: f64,
    /// Sigma-norm ‖d‖σ of the distance.
    distance_sigma: f64,
    /// Sigma-norm ‖r‖σ of the range.
    range_sigma: f64,
    range_m: f64,
}

/// Builds the law for a scenario.
pub(super) fn make(setup: &Setup<'_>) -> Result<Box<dyn Law>, String> {
    Ok(Box::new(OlfatiSaber::new(&setup.formation.olfati_saber)?))
}

impl OlfatiSaber {
    fn new(settings: &scenario::OlfatiSaber) -> Result<Self, String> {
        let (a, b, epsilon) = (settings.action_a, settings.action_b, settings.epsilon);
        if a > b {
            return Err(format!("`formation.olfati_saber.action_a` is {a}, but may not be above `action_b`, {b}"));
        }
        let range = settings.range_ratio * SOURCE_DISTANCE;
        Ok(Self {
            its: settings.clone(),
            unit_m: settings.distance_m / SOURCE_DISTANCE,
            c: (a - b).abs() / (4.0 * a * b).sqrt(),
            distance_sigma: sigma_norm(epsilon, SOURCE_DISTANCE * SOURCE_DISTANCE),
            range_sigma: sigma_norm(epsilon, range * range),
            range_m: settings.range_ratio * settings.distance_m,
        })
    }

    /// The bump function ρ_h: 1 near zero, 0 from 1 on, smooth.
    fn bump(&self, z: f64) -> f64 {
        let h = self.its.bump_h;
        if z < h {
            1.0
        } else if z < 1.0 {
            0.5 * (1.0 + math::cos(PI * (z - h) / (1.0 - h)))
        } else {
            0.0
        }
    }

    /// The action function φ_α of a sigma-norm.
    fn action(&self, sigma: f64) -> f64 {
        let (a, b) = (self.its.action_a, self.its.action_b);
        let shifted = sigma - self.distance_sigma + self.c;
        let uneven = 0.5 * ((a + b) * shifted / (1.0 + shifted * shifted).sqrt() + a - b);
        self.bump(sigma / self.range_sigma) * uneven
    }

    /// Acceleration u_i, north and east, m/s².
    fn acceleration(&self, observation: &Observation<'_>) -> Vector2<f64> {
        let (epsilon, unit_s) = (self.its.epsilon, self.its.time_unit_s);
        let (place, velocity) = (observation.position.horizontal(), observation.velocity.horizontal());
        let (mut gradient, mut consensus) = (Vector2::zeros(), Vector2::zeros());
        for neighbour in observation.neighbours {
            let offset = (neighbour.position.horizontal() - place) / self.unit_m;
            let squared = offset.norm_squared();
            let sigma = sigma_norm(epsilon, squared);
            if sigma < self.range_sigma {
                gradient += offset * (self.action(sigma) / (1.0 + epsilon * squared).sqrt());
                consensus += (neighbour.velocity.horizontal() - velocity) * self.bump(sigma / self.range_sigma);
            }
        }
        let relative = velocity - observation.goal.centre_velocity.horizontal();
        gradient * (self.unit_m / (unit_s * unit_s)) + consensus / unit_s
            - observation.from_centre_ne_m() * self.its.c1_per_s2
            - relative * self.its.c2_per_s
    }
}

impl Law for OlfatiSaber {
    fn update(&mut self, observation: &Observation<'_>) -> LawOutput {
        let velocity = observation.velocity.horizontal() + self.acceleration(observation) * self.its.horizon_s;
        let reached = observation.from_centre_ne_m().norm() <= observation.goal.radius_m && observation.is_slow();
        LawOutput { command: LawCommand::level(velocity.cap_magnitude(self.its.max_speed_m_s)), reached }
    }

    /// The bump function is zero beyond the range.
    fn reach_m(&self, _: usize) -> f64 {
        self.range_m
    }
}

/// Sigma-norm ‖z‖σ for |z|².
fn sigma_norm(epsilon: f64, squared: f64) -> f64 {
    ((1.0 + epsilon * squared).sqrt() - 1.0) / epsilon
}

#[cfg(test)]
mod tests;
