//! The ground: contact forces on the skids, and ground effect on the main rotor.

use super::body::Wrench;
use super::parameters::{Parameters, Skids};
use super::vector::{Rotation, Vector};
use crate::lanes::{Mask, Real, numbers};

/// Below this speed over the ground (m/s) friction fades to zero, so that a standing helicopter does not chatter.
const FRICTION_SPEED_M_S: f64 = 0.05;

numbers! {
    /// The constants of the ground contact.
    #[derive(Clone, Debug, Default)]
    pub(super) struct Contact<R> {
        points: [Vector<R>; 4],
        /// Largest distance of a contact point from the centre of gravity, m.
        pub(super) reach_m: R,
        stiffness: R,
        damping: R,
        friction: R,
    }
}

impl Contact<f64> {
    pub(super) fn new(parameters: &Parameters) -> Self {
        let Skids { forward_m, right_m, down_m, stiffness_n_m, damping_n_s_m, friction } = parameters.skids;
        let at = |forward: f64, right: f64| Vector::new(forward * forward_m, right * right_m, down_m);
        let points = [at(1.0, 1.0), at(1.0, -1.0), at(-1.0, 1.0), at(-1.0, -1.0)];
        Self { reach_m: points[0].norm(), points, stiffness: stiffness_n_m, damping: damping_n_s_m, friction }
    }
}

impl<R: Real> Contact<R> {
    /// Force and moment of the four contact points where the centre of gravity is `near` the ground, `height_m` above
    /// it; velocity and rates in body axes. `near` means within `reach_m`.
    #[inline(always)]
    pub(super) fn wrench(
        &self,
        near: R::Mask,
        height_m: R,
        velocity: Vector<R>,
        rates: Vector<R>,
        ned_from_body: &Rotation<R>,
    ) -> Wrench<R> {
        let none = Vector::default();
        let mut sum = Wrench { force: none, moment: none };
        for point in self.points {
            let depth_m = ned_from_body.down.dot(point) - height_m;
            let touches = near & R::splat(0.0).lt(depth_m);
            if touches.any() {
                let force = self.force(depth_m, ned_from_body.to_ned(velocity + rates.cross(point)));
                let force = Vector::select(touches, ned_from_body.to_body(force), none);
                sum += Wrench { force, moment: Vector::select(touches, point.cross(force), none) };
            }
        }
        sum
    }

    /// Force at one point, N, NED: F_n = max(0, kδ + c v_z) up, friction −μ F_n v_h/(|v_h| + 0.05).
    #[inline(always)]
    fn force(&self, depth_m: R, velocity: Vector<R>) -> Vector<R> {
        let normal_n = (self.stiffness * depth_m + self.damping * velocity.z).max(R::splat(0.0));
        let speed_m_s = (velocity.x * velocity.x + velocity.y * velocity.y).sqrt();
        let drag = -self.friction * normal_n / (speed_m_s + FRICTION_SPEED_M_S);
        Vector::new(drag * velocity.x, drag * velocity.y, -normal_n)
    }
}

/// Ratio of the thrust in ground effect to the thrust without: 1/(1 − (R/4z)²) for a hub z above the ground, after
/// Cheeseman and Bennett (1955). It is 1 from two radii up, and constant below half a radius.
#[inline(always)]
pub(super) fn thrust_factor<R: Real>(radius_m: R, hub_height_m: R) -> R {
    let one = R::splat(1.0);
    let above = (radius_m * 2.0).le(hub_height_m);
    if above.all() {
        return one;
    }
    let ratio = radius_m / (hub_height_m.max(radius_m * 0.5) * 4.0);
    R::select(above, one, one / (one - ratio * ratio))
}
