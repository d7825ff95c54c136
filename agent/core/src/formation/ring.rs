//! The elliptical surface: every vehicle flies to the ring around the centre and spreads along it, or stays inside.
//!
//! After R. Garcia & L. Barnes, "Multi-UAV Simulator Utilizing X-Plane", J. Intelligent & Robotic Systems 57 (2010),
//! section 4.1, equations 2 to 9. The limiting functions are sigmoids, after L. Barnes, M. Fields & K. Valavanis,
//! "Swarm Formation Control Utilizing Elliptical Surfaces and Limiting Functions", IEEE Trans. SMC-B 39(6) (2009);
//! their numbers here are ours.
//!
//! Level function of the ellipse: ρ² = x² + γ y², with x and y along the ellipse's own axes from its centre. The ring
//! is ρ = R*, so its semi-axes are R* and R*/√γ. The band is R* − inner width ≤ ρ ≤ R* + outer width.
//!
//! Two variants of the same field besides the ring (the numbers of both are ours):
//!
//! * **Flock** (section 4.1, "weights turned off"): only the outer attraction and the avoidance remain, so that
//!   vehicles stay together inside ρ ≤ R* without fixed positions. The outer edge is one width inside R*: at R* it
//!   pulls in full.
//! * **Ellipsoid**, the three-dimensional form that the paper leaves to the future: ρ² = x² + γ y² + γ_z z², with z
//!   from the centre's altitude. Gradient and avoidance have one more component. In the band only the avoidance's
//!   component along the normal is removed, so that vehicles spread over the whole surface. Flat laws ignore altitude.

use alloc::boxed::Box;
use alloc::string::String;
use core::f64::consts::{FRAC_PI_6, PI, SQRT_2};

use nalgebra::{Rotation2, Vector2, Vector3};
use skein_common::frame::PositionNed;
use skein_common::id::VehicleId;
use skein_common::math;
use skein_common::scenario::{self, AvoidDistance, Avoidance};

use super::COINCIDENT_M;
use super::law::{Law, LawCommand, LawOutput, Neighbour, Observation, Obstacle, Setup};
use crate::lanes::{LANES, Lanes, Real};
use crate::peers::MAX_OBSTACLE_RADIUS_M;

/// Limit of the summed avoidance of all neighbours: a crowd must not expel its members.
const MAX_AVOIDANCE: f64 = 2.0;
/// Share of the avoidance's strength below which a neighbour is ignored.
const NEGLIGIBLE_SHARE: f64 = 1e-12;
/// Field length below which a vehicle can be in place.
const IN_PLACE_FIELD: f64 = 0.15;

/// The ring's parameters; symbols of the paper in brackets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ring {
    /// Semi-axis along the ellipse's heading, m (R*).
    pub radius_m: f64,
    /// Squared ratio of the semi-axes (γ).
    pub gamma: f64,
    /// Squared ratio γ_z of the first and the vertical semi-axis of an ellipsoid; `None` for a flat law.
    pub gamma_z: Option<f64>,
    /// Direction of the first axis, clockwise from north, rad.
    pub heading_rad: f64,
    /// Region on or in the surface where vehicles belong.
    pub region: Region,
    /// Width of the band inside the ring, m (ΔR_in).
    pub inner_width_m: f64,
    /// Width of the band outside the ring, or of a flock's soft edge inside it, m (ΔR_out).
    pub outer_width_m: f64,
    /// Steepness of the inner and the outer edge, 1/m (α_in, α_out).
    pub edge_steepness_per_m: [f64; 2],
    /// Exponent K = ln((1 − ε)/ε) for the share ε that a limiting function leaves one width beyond its edge.
    pub edge_exponent: f64,
    /// The part of the neighbours' avoidance that is flown in the band. With all of it, the literal reading of the paper, the ring
    /// settles wider.
    pub avoidance: Avoidance,
    /// Distance at which a neighbour's avoidance has half its strength.
    pub avoid_distance: AvoidDistance,
    /// Constant circulation w_circ along the ring, positive clockwise seen from above.
    pub circulation: f64,
}

/// Region on or in the surface where vehicles belong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Region {
    /// In the band around the surface, evenly spread.
    Band,
    /// Anywhere inside the surface.
    Inside,
}

/// Exponent ln((1 − ε)/ε) at which a sigmoid has fallen to ε.
pub fn edge_exponent(edge_share: f64) -> f64 {
    math::ln((1.0 - edge_share) / edge_share)
}

/// Limiting function σ(z) = 1 / (1 + e^z), falling from 1 to 0.
#[inline]
fn limiting(z: f64) -> f64 {
    1.0 / (1.0 + math::exp(z))
}

/// The ring configured by a scenario.
pub fn of(settings: &scenario::Formation) -> Ring {
    let edge_exponent = edge_exponent(settings.edge_share);
    let steepness = |width_m: f64| settings.edge_steepness_per_m.unwrap_or(edge_exponent / width_m);
    Ring {
        radius_m: settings.radius_m,
        gamma: settings.gamma,
        gamma_z: (settings.vertical == scenario::Vertical::Ellipsoid).then_some(settings.gamma_z),
        heading_rad: settings.heading_rad(),
        region: if settings.law.is_flock() { Region::Inside } else { Region::Band },
        inner_width_m: settings.inner_width_m,
        outer_width_m: settings.outer_width_m,
        edge_steepness_per_m: [steepness(settings.inner_width_m), steepness(settings.outer_width_m)],
        edge_exponent,
        avoidance: settings.avoidance,
        avoid_distance: settings.avoid_distance_m,
        circulation: settings.circulation,
    }
}

/// Builds the law for a scenario.
pub(super) fn make(setup: &Setup<'_>) -> Result<Box<dyn Law>, String> {
    Ok(Box::new(of(setup.formation)))
}

impl Law for Ring {
    fn update(&mut self, observation: &Observation<'_>) -> LawOutput {
        let centre = observation.goal.centre;
        // The spacing also leaves room for members whose states are not received.
        let ring = Self { avoid_distance: AvoidDistance::Fixed(self.avoid_distance_m(observation.live())), ..*self };
        let (own, place) = (observation.own, observation.position);
        let level = self.level_and_normal(place - centre);
        let field = ring.field_at(level, own, place, observation.neighbours, observation.obstacles);
        let is_calm = self.region == Region::Inside || field.norm() < IN_PLACE_FIELD;
        let reached = is_calm && self.holds_level(level.0) && observation.is_slow();
        LawOutput { command: LawCommand::Field(field), reached }
    }

    /// The distance at which the limiting functions of neighbours and obstacles have fallen to 1e-12, m.
    fn reach_m(&self, live: usize) -> f64 {
        let widths = 1.0 + edge_exponent(NEGLIGIBLE_SHARE) / self.edge_exponent;
        widths * self.avoid_distance_m(live).max(MAX_OBSTACLE_RADIUS_M)
    }
}

impl Ring {
    /// Level ρ at the centre's altitude, m: distance from the centre, scaled so that the ring is ρ = R*.
    pub fn level_m(&self, from_centre_ne_m: Vector2<f64>) -> f64 {
        self.level_and_normal(flat(from_centre_ne_m)).0
    }

    /// Whether the level ρ, m, is one of the region where vehicles belong: the band or the inside.
    pub fn holds_level(&self, rho_m: f64) -> bool {
        match self.region {
            Region::Band => (self.radius_m - self.inner_width_m..=self.radius_m + self.outer_width_m).contains(&rho_m),
            Region::Inside => rho_m <= self.radius_m,
        }
    }

    /// Distance ΔR_avoid at which a neighbour's avoidance has half its strength among `live` members, m. If it is adaptive, it is
    /// 1/√2 of the distance between evenly spread neighbours, for any number of members N: R* √2 sin(π/N) on a ring. On a sphere
    /// it is L. Fejes Tóth's bound on that distance, R* √(4 − 1/sin²(πN/(6(N − 2)))), which N = 3, 4, 6 and 12 attain.
    pub fn avoid_distance_m(&self, live: usize) -> f64 {
        let n = live.max(2) as f64;
        match (self.avoid_distance, self.gamma_z) {
            (AvoidDistance::Fixed(distance_m), _) => distance_m,
            (AvoidDistance::Adaptive, Some(_)) if live > 2 => {
                let apart = (4.0 - 1.0 / math::square(math::sin(FRAC_PI_6 * n / (n - 2.0)))).sqrt();
                self.radius_m * apart / SQRT_2
            }
            (AvoidDistance::Adaptive, _) => self.radius_m * SQRT_2 * math::sin(PI / n),
        }
    }

    /// The field V at this vehicle's position, NED, dimensionless; zero vertical component in a flat law. `neighbours`
    /// are the other live members; `obstacles` are avoided and are not part of the formation.
    ///
    /// V = (w_in S_in − w_out S_out) g + A − S_perp (A·g) g + w_circ S_perp t; all weights except w_circ are one. In a
    /// flock w_in and S_perp are zero.
    pub fn field(
        &self,
        own: VehicleId,
        place: PositionNed,
        centre: PositionNed,
        neighbours: &[Neighbour],
        obstacles: &[Obstacle],
    ) -> Vector3<f64> {
        self.field_at(self.level_and_normal(place - centre), own, place, neighbours, obstacles)
    }

    /// The field at a position with this level, m, and this normal.
    fn field_at(
        &self,
        (rho_m, outward): (f64, Vector3<f64>),
        own: VehicleId,
        place: PositionNed,
        neighbours: &[Neighbour],
        obstacles: &[Obstacle],
    ) -> Vector3<f64> {
        let [alpha_in, alpha_out] = self.edge_steepness_per_m;
        let (inward, s_perp) = match self.region {
            Region::Band => {
                let s_in = limiting(alpha_in * (rho_m - (self.radius_m - self.inner_width_m)));
                let s_out = 1.0 - limiting(alpha_out * (rho_m - (self.radius_m + self.outer_width_m)));
                (s_out - s_in, (1.0 - s_in) * (1.0 - s_out))
            }
            Region::Inside => (1.0 - limiting(alpha_out * (rho_m - (self.radius_m - self.outer_width_m))), 0.0),
        };
        let push = self.push(own, place, neighbours);
        let push = match self.avoidance {
            Avoidance::Tangential => push - outward * (s_perp * push.dot(&outward)),
            Avoidance::Full => push,
        };
        let tangent = Vector3::new(-outward.y, outward.x, 0.0);
        push - outward * inward + tangent * (self.circulation * s_perp) + keep_clear(self, own, place, obstacles)
    }

    /// Level ρ and the unit vector of its gradient, NED; the vector is zero at the centre, where it is undefined.
    fn level_and_normal(&self, from_centre_m: Vector3<f64>) -> (f64, Vector3<f64>) {
        let turn = Rotation2::new(self.heading_rad);
        let (rho_m, gradient) = self.level_and_gradient(&turn, from_centre_m);
        let length = gradient.norm();
        if length < 1e-6 {
            return (rho_m, Vector3::zeros());
        }
        let level = turn * gradient.xy();
        (rho_m, Vector3::new(level.x, level.y, gradient.z) / length)
    }

    /// Level ρ, m, and half the gradient of its square along the ellipse's own axes. `turn` is the rotation by the
    /// ellipse's heading, for callers that ask often.
    pub fn level_and_gradient(&self, turn: &Rotation2<f64>, from_centre_m: Vector3<f64>) -> (f64, Vector3<f64>) {
        let axes = turn.inverse() * from_centre_m.xy();
        let gamma_z = self.gamma_z.unwrap_or(0.0);
        let gradient = Vector3::new(axes.x, self.gamma * axes.y, gamma_z * from_centre_m.z);
        let rho_m = (axes.x * gradient.x + axes.y * gradient.y + from_centre_m.z * gradient.z).sqrt();
        (rho_m, gradient)
    }

    /// Avoidance A = Σ S_avoid(d_j) n_j over the neighbours, limited to a length of [`MAX_AVOIDANCE`].
    fn push(&self, own: VehicleId, place: PositionNed, neighbours: &[Neighbour]) -> Vector3<f64> {
        let half_m = self.avoid_distance_m(neighbours.len() + 1);
        let alpha_av = self.edge_exponent / half_m;
        let mut sums = [Lanes::splat(0.0); 3];
        for block in neighbours.chunks(LANES) {
            // A lane without a neighbour has weight 0.
            let (mut weight, mut from_m) = (Lanes::splat(0.0), [Lanes::splat(1.0); 3]);
            for (lane, neighbour) in block.iter().enumerate() {
                let apart_m = place - neighbour.position;
                let apart_m = if self.gamma_z.is_some() { apart_m } else { flat(apart_m.xy()) };
                let apart_m = distinct(own < neighbour.id, apart_m);
                weight.0[lane] = 1.0;
                from_m.iter_mut().zip(apart_m.iter()).for_each(|(lanes, one)| lanes.0[lane] = *one);
            }
            let [x, y, z] = from_m;
            let distance_m = (x * x + y * y + z * z).sqrt();
            // S/d: the limiting function, and the division that makes the displacement a direction.
            let share = weight / ((((distance_m - half_m) * alpha_av).exp() + 1.0) * distance_m);
            sums.iter_mut().zip(from_m).for_each(|(sum, from_m)| *sum = *sum + from_m * share);
        }
        let sum = Vector3::from(sums.map(Lanes::sum));
        sum.cap_magnitude(MAX_AVOIDANCE)
    }
}

/// Avoidance of obstacles, each with its own radius as avoidance distance. The band does not weaken it: the vehicle
/// passes an obstacle, it does not space itself from it. Always horizontal: no vehicle dives under an obstacle.
fn keep_clear(ring: &Ring, own: VehicleId, place: PositionNed, obstacles: &[Obstacle]) -> Vector3<f64> {
    let mut sum = Vector3::zeros();
    for obstacle in obstacles {
        let from_m = distinct(own < obstacle.id, flat((place - obstacle.position).xy()));
        let (distance_m, alpha) = (from_m.norm(), ring.edge_exponent / obstacle.radius_m);
        sum += from_m * (limiting(alpha * (distance_m - obstacle.radius_m)) * MAX_AVOIDANCE / distance_m);
    }
    sum
}

/// The displacement from another vehicle, m; a short one to the north or south at coincident positions, opposite for the
/// two vehicles.
#[inline]
fn distinct(is_first: bool, apart_m: Vector3<f64>) -> Vector3<f64> {
    if apart_m.norm_squared() < COINCIDENT_M * COINCIDENT_M {
        Vector3::new(if is_first { COINCIDENT_M } else { -COINCIDENT_M }, 0.0, 0.0)
    } else {
        apart_m
    }
}

/// The vector at the centre's altitude.
fn flat(ne_m: Vector2<f64>) -> Vector3<f64> {
    Vector3::new(ne_m.x, ne_m.y, 0.0)
}

#[cfg(test)]
mod tests;
