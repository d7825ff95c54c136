//! The ground: contact forces on the skids, and ground effect on the main rotor.

use nalgebra::{Matrix3, Vector3};

use super::body::Wrench;
use super::parameters::{Parameters, Skids};

/// Below this speed over the ground (m/s) friction fades to zero, so that a standing helicopter does not chatter.
const FRICTION_SPEED_M_S: f64 = 0.05;

/// The constants of the ground contact.
#[derive(Clone, Debug)]
pub(super) struct Contact {
    points: [Vector3<f64>; 4],
    /// Largest distance of a contact point from the centre of gravity, m.
    pub(super) reach_m: f64,
    stiffness: f64,
    damping: f64,
    friction: f64,
}

impl Contact {
    pub(super) fn new(parameters: &Parameters) -> Self {
        let Skids { forward_m, right_m, down_m, stiffness_n_m, damping_n_s_m, friction } = parameters.skids;
        let at = |forward: f64, right: f64| Vector3::new(forward * forward_m, right * right_m, down_m);
        let points = [at(1.0, 1.0), at(1.0, -1.0), at(-1.0, 1.0), at(-1.0, -1.0)];
        Self { reach_m: points[0].norm(), points, stiffness: stiffness_n_m, damping: damping_n_s_m, friction }
    }

    /// Force and moment of the four contact points for a centre of gravity `height_m` above the ground; velocity and
    /// rates in body axes. Called only within `reach_m` of the ground.
    pub(super) fn wrench(
        &self,
        height_m: f64,
        velocity: &Vector3<f64>,
        rates: &Vector3<f64>,
        ned_from_body: &Matrix3<f64>,
    ) -> Wrench {
        let mut sum = Wrench { force: Vector3::zeros(), moment: Vector3::zeros() };
        for point in &self.points {
            let depth_m = ned_from_body.row(2).transpose().dot(point) - height_m;
            if depth_m > 0.0 {
                let force = self.force(depth_m, &(ned_from_body * (velocity + rates.cross(point))));
                let force = ned_from_body.tr_mul(&force);
                sum += Wrench { force, moment: point.cross(&force) };
            }
        }
        sum
    }

    /// Force at one point, N, NED: F_n = max(0, kδ + c v_z) up, friction −μ F_n v_h/(|v_h| + 0.05).
    fn force(&self, depth_m: f64, velocity: &Vector3<f64>) -> Vector3<f64> {
        let normal_n = (self.stiffness * depth_m + self.damping * velocity.z).max(0.0);
        let drag = -self.friction * normal_n / (velocity.xy().norm() + FRICTION_SPEED_M_S);
        Vector3::new(drag * velocity.x, drag * velocity.y, -normal_n)
    }
}

/// Ratio of the thrust in ground effect to the thrust without: 1/(1 − (R/4z)²) for a hub z above the ground, after
/// Cheeseman and Bennett (1955). It is 1 from two radii up, and constant below half a radius.
#[inline]
pub(super) fn thrust_factor(radius_m: f64, hub_height_m: f64) -> f64 {
    if hub_height_m >= 2.0 * radius_m {
        return 1.0;
    }
    let ratio = radius_m / (4.0 * hub_height_m.max(0.5 * radius_m));
    1.0 / (1.0 - ratio * ratio)
}
