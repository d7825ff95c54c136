//! Flocking for real delays and accelerations: short-range repulsion, and velocities similar enough to stop in time.
//!
//! G. Vásárhelyi, C. Virágh, G. Somorjai, T. Nepusz, A. E. Eiben & T. Vicsek, "Optimized flocking of autonomous drones
//! in confined environments", Science Robotics 3 (2018), with the parameters evolved there for 4 m/s:
//!
//! ```text
//! v_i = v_goal + Σ p_rep (r0_rep − r_ij) (r_i − r_j)/r_ij                                     for r_ij < r0_rep
//!              + Σ C_frict (v_ij − v_max,ij) (v_j − v_i)/v_ij                                 for v_ij > v_max,ij
//! v_max,ij = max(v_frict, D(r_ij − r0_frict, a_frict, p_frict)),   all cut to v_max
//! D(r, a, p) = 0 up to r = 0;  r p while r p < a/p;  √(2 a r − a²/p²) from there on
//! ```
//!
//! The source's drones fly on at v_flock between walls. Here they have a goal: the centre's velocity replaces v_flock
//! v̂_i, and a homing velocity beyond half of R*, which grows to v_flock, replaces the walls. Both are ours.

use alloc::boxed::Box;
use alloc::string::String;

use nalgebra::Vector2;
use skein_common::scenario;

use super::COINCIDENT_M;
use super::law::{Law, LawCommand, LawOutput, Neighbour, Observation, Setup};

/// The law's parameters.
#[derive(Clone, Debug, PartialEq)]
struct Vasarhelyi(scenario::Vasarhelyi);

/// Builds the law for a scenario.
pub(super) fn make(setup: &Setup<'_>) -> Result<Box<dyn Law>, String> {
    Ok(Box::new(Vasarhelyi(setup.formation.vasarhelyi.clone())))
}

impl Vasarhelyi {
    /// Velocity away from a neighbour that is too near, m/s.
    fn repulsion_m_s(&self, observation: &Observation<'_>, neighbour: &Neighbour) -> Vector2<f64> {
        let Self(its) = self;
        let from_it_m = (observation.position - neighbour.position).xy();
        let distance_m = from_it_m.norm();
        if distance_m >= its.repulsion_range_m {
            return Vector2::zeros();
        }
        // ±north at coincident positions, with opposite signs for the two vehicles.
        let away = if distance_m > COINCIDENT_M {
            from_it_m / distance_m
        } else {
            Vector2::new(if observation.own < neighbour.id { 1.0 } else { -1.0 }, 0.0)
        };
        away * (its.repulsion_per_s * (its.repulsion_range_m - distance_m))
    }

    /// Velocity change towards a relative velocity at which this vehicle can still stop beside the other, m/s.
    fn friction_m_s(&self, observation: &Observation<'_>, neighbour: &Neighbour) -> Vector2<f64> {
        let Self(its) = self;
        let difference_m_s = neighbour.velocity.horizontal() - observation.velocity.horizontal();
        let speed_m_s = difference_m_s.norm();
        let distance_m = (observation.position - neighbour.position).xy().norm();
        let stoppable_m_s =
            braking_m_s(distance_m - its.friction_offset_m, its.friction_m_s2, its.friction_slope_per_s);
        let allowed_m_s = its.friction_slack_m_s.max(stoppable_m_s);
        if speed_m_s <= allowed_m_s {
            return Vector2::zeros();
        }
        difference_m_s * (its.friction_gain * (speed_m_s - allowed_m_s) / speed_m_s)
    }

    /// Velocity towards the centre beyond half of R*, m/s.
    fn homing_m_s(&self, observation: &Observation<'_>) -> Vector2<f64> {
        let Self(its) = self;
        let out_ne_m = observation.from_centre_ne_m();
        let distance_m = out_ne_m.norm();
        let beyond_m = distance_m - observation.goal.radius_m / 2.0;
        if beyond_m <= 0.0 {
            return Vector2::zeros();
        }
        out_ne_m * (-(its.homing_per_s * beyond_m).min(its.flock_speed_m_s) / distance_m)
    }
}

impl Law for Vasarhelyi {
    fn update(&mut self, observation: &Observation<'_>) -> LawOutput {
        let interaction: Vector2<f64> = observation
            .neighbours
            .iter()
            .map(|it| self.repulsion_m_s(observation, it) + self.friction_m_s(observation, it))
            .sum();
        let velocity = observation.goal.centre_velocity.horizontal() + self.homing_m_s(observation) + interaction;
        let reached = observation.from_centre_ne_m().norm() <= observation.goal.radius_m && observation.is_slow();
        LawOutput { command: LawCommand::level(velocity.cap_magnitude(self.0.max_speed_m_s)), reached }
    }
}

/// Braking curve D(r, a, p): the speed from which a vehicle can stop within r, m/s, at constant deceleration a and
/// finally exponentially at rate p.
fn braking_m_s(distance_m: f64, deceleration_m_s2: f64, slope_per_s: f64) -> f64 {
    let knee_m_s = deceleration_m_s2 / slope_per_s;
    if distance_m <= 0.0 {
        0.0
    } else if distance_m * slope_per_s < knee_m_s {
        distance_m * slope_per_s
    } else {
        (2.0 * deceleration_m_s2 * distance_m - knee_m_s * knee_m_s).sqrt()
    }
}

#[cfg(test)]
mod tests;
