//! The elliptical ring: every vehicle goes to the ring around the centre and spreads along it.
//!
//! After R. Garcia & L. Barnes, "Multi-UAV Simulator Utilizing X-Plane", J. Intelligent & Robotic Systems 57 (2010),
//! section 4.1, equations 2 to 9. The limiting functions are sigmoids, after L. Barnes, M. Fields & K. Valavanis, "Swarm
//! Formation Control Utilizing Elliptical Surfaces and Limiting Functions", IEEE Trans. SMC-B 39(6) (2009); their numbers
//! here are ours.
//!
//! Level function of the ellipse: ρ² = x² + γ y², x and y along the ellipse's own axes from its centre. The ring is ρ = R*,
//! so its semi-axes are R* and R*/√γ. The band is R* − inner width ≤ ρ ≤ R* + outer width.

use std::f64::consts::{PI, SQRT_2};

use nalgebra::{Rotation2, Vector2};
use skein_common::id::VehicleId;

use super::{Neighbour, Obstacle};

/// The pushes of all neighbours together are never stronger than this: a crowd must not expel its members.
const MAX_AVOIDANCE: f64 = 2.0;
/// Nearer than this two vehicles have no direction between them, m.
pub(super) const COINCIDENT_M: f64 = 1e-3;

/// The ring's parameters; symbols of the paper in brackets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ring {
    /// Semi-axis along the ellipse's heading, m (R*).
    pub radius_m: f64,
    /// Squared ratio of the semi-axes (γ).
    pub gamma: f64,
    /// Direction of the first axis, clockwise from north, rad.
    pub heading_rad: f64,
    /// Width of the band inside the ring, m (ΔR_in).
    pub inner_width_m: f64,
    /// Width of the band outside the ring, m (ΔR_out).
    pub outer_width_m: f64,
    /// Steepness of the inner and the outer edge, 1/m (α_in, α_out).
    pub edge_steepness_per_m: [f64; 2],
    /// ln((1 − ε)/ε), for the share ε that a limiting function leaves one width beyond its edge (K).
    pub edge_exponent: f64,
    /// What of the neighbours' push is flown.
    pub avoidance: Avoidance,
    /// Distance at which a neighbour pushes with half its strength.
    pub avoid_distance: AvoidDistance,
    /// Constant circulation along the ring, clockwise seen from above if positive (w_circ).
    pub circulation: f64,
}

/// What of the neighbours' push is flown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Avoidance {
    /// In the band only its component along the ring, so that the ring keeps its size.
    Tangential,
    /// All of it, the literal reading of the paper: the ring settles wider.
    Full,
}

/// Distance at which a neighbour pushes with half its strength (ΔR_avoid).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AvoidDistance {
    /// The same for any number of members, m.
    Fixed(f64),
    /// R* √2 sin(π/N): the same share of the distance between neighbours for any number of members N.
    Adaptive,
}

/// ln((1 − ε)/ε): the exponent at which a sigmoid has fallen to ε.
pub fn edge_exponent(edge_share: f64) -> f64 {
    ((1.0 - edge_share) / edge_share).ln()
}

/// σ(z) = 1 / (1 + e^z), falling from 1 to 0.
#[inline]
fn limiting(z: f64) -> f64 {
    1.0 / (1.0 + z.exp())
}

/// Unit vector from a neighbour to the own place; ±north where they coincide, so that the two disagree.
#[inline]
fn away(own: VehicleId, own_ne_m: Vector2<f64>, other: VehicleId, other_ne_m: Vector2<f64>) -> (f64, Vector2<f64>) {
    let difference = own_ne_m - other_ne_m;
    let distance_m = difference.norm();
    if distance_m < COINCIDENT_M {
        (distance_m, Vector2::new(if own < other { 1.0 } else { -1.0 }, 0.0))
    } else {
        (distance_m, difference / distance_m)
    }
}

impl Ring {
    /// Vector from the centre in the ellipse's own axes.
    #[inline]
    fn to_axes(self, from_centre_ne_m: Vector2<f64>) -> Vector2<f64> {
        if self.heading_rad == 0.0 { from_centre_ne_m } else { Rotation2::new(-self.heading_rad) * from_centre_ne_m }
    }

    /// ρ: distance from the centre measured so that the ring is ρ = R*; m.
    pub fn level_m(&self, from_centre_ne_m: Vector2<f64>) -> f64 {
        let axes = self.to_axes(from_centre_ne_m);
        (axes.x * axes.x + self.gamma * axes.y * axes.y).sqrt()
    }

    /// Distance at which a neighbour pushes with half its strength among `live` members, m.
    pub fn avoid_distance_m(&self, live: usize) -> f64 {
        match self.avoid_distance {
            AvoidDistance::Fixed(distance_m) => distance_m,
            AvoidDistance::Adaptive => self.radius_m * SQRT_2 * (PI / live.max(2) as f64).sin(),
        }
    }

    /// The field V at the own place, north and east, dimensionless. `neighbours` are the other live members; `obstacles`
    /// are to be kept away from, and are no part of the formation.
    ///
    /// V = (w_in S_in − w_out S_out) g + A − S_perp (A·g) g + w_circ S_perp t, all weights but w_circ one.
    pub fn field_ne(
        &self,
        own: VehicleId,
        own_ne_m: Vector2<f64>,
        centre_ne_m: Vector2<f64>,
        neighbours: &[Neighbour],
        obstacles: &[Obstacle],
    ) -> Vector2<f64> {
        let axes = self.to_axes(own_ne_m - centre_ne_m);
        let (gx, gy) = (axes.x, self.gamma * axes.y);
        let rho_m = (axes.x * gx + axes.y * gy).sqrt();
        let length = (gx * gx + gy * gy).sqrt();
        // At the very centre no direction leads outward.
        let outward = if length < 1e-6 { Vector2::zeros() } else { Vector2::new(gx, gy) / length };
        let outward = if self.heading_rad == 0.0 { outward } else { Rotation2::new(self.heading_rad) * outward };

        let [alpha_in, alpha_out] = self.edge_steepness_per_m;
        let s_in = limiting(alpha_in * (rho_m - (self.radius_m - self.inner_width_m)));
        let s_out = 1.0 - limiting(alpha_out * (rho_m - (self.radius_m + self.outer_width_m)));
        let s_perp = (1.0 - s_in) * (1.0 - s_out);

        let push = self.push(own, own_ne_m, neighbours);
        let push = match self.avoidance {
            Avoidance::Tangential => push - outward * (s_perp * push.dot(&outward)),
            Avoidance::Full => push,
        };
        let tangent = Vector2::new(-outward.y, outward.x);
        outward * (s_in - s_out)
            + push
            + tangent * (self.circulation * s_perp)
            + self.keep_clear(own, own_ne_m, obstacles)
    }

    /// A = Σ S_avoid(d_j) n_j over the neighbours, cut to a length of [`MAX_AVOIDANCE`].
    fn push(&self, own: VehicleId, own_ne_m: Vector2<f64>, neighbours: &[Neighbour]) -> Vector2<f64> {
        let half_m = self.avoid_distance_m(neighbours.len() + 1);
        let alpha_av = self.edge_exponent / half_m;
        let mut sum = Vector2::zeros();
        for neighbour in neighbours {
            let (distance_m, direction) = away(own, own_ne_m, neighbour.id, neighbour.position_ne_m);
            sum += direction * limiting(alpha_av * (distance_m - half_m));
        }
        let length = sum.norm();
        if length > MAX_AVOIDANCE { sum * (MAX_AVOIDANCE / length) } else { sum }
    }

    /// The same law for obstacles, each with its own radius in place of the avoidance distance and never weakened by the
    /// band: an obstacle is passed, not spaced.
    fn keep_clear(&self, own: VehicleId, own_ne_m: Vector2<f64>, obstacles: &[Obstacle]) -> Vector2<f64> {
        let mut sum = Vector2::zeros();
        for obstacle in obstacles {
            let (distance_m, direction) = away(own, own_ne_m, obstacle.id, obstacle.position_ne_m);
            sum += direction
                * limiting(self.edge_exponent / obstacle.radius_m * (distance_m - obstacle.radius_m))
                * MAX_AVOIDANCE;
        }
        sum
    }
}

#[cfg(test)]
mod tests;
