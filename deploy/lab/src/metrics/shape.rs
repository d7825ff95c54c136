//! The formation of each step of the mission, as the figures need it.

use nalgebra::{Rotation2, Vector2, Vector3};
use skein_common::math;
use skein_common::scenario::{Formation, Step, Target};
use skein_core::formation::{self, ring::Ring};

/// The formation during one step of the mission.
#[derive(Debug)]
pub(crate) struct StepShape {
    pub(super) ring: Ring,
    /// Rotation by the heading of the ring's first axis.
    turn: Rotation2<f64>,
    pub(super) altitude_m: f64,
    /// Difference in altitude between neighbouring ranks, m.
    band_step_m: f64,
    /// Beginning and end of the centre's path, north and east, m.
    pub(super) path_ends: Option<[Vector2<f64>; 2]>,
}

impl StepShape {
    pub(crate) fn new(step: &Step) -> Self {
        let path_ends = match &step.target {
            Target::Path(corners) => corners.first().zip(corners.last()),
            _ => None,
        };
        let path_ends = path_ends.map(|(first, last)| [Vector2::from(*first), Vector2::from(*last)]);
        Self { path_ends, ..Self::of_formation(&step.formation) }
    }

    /// The formation, whose centre rests.
    pub(crate) fn of_formation(formation: &Formation) -> Self {
        let ring = formation::ring(formation);
        Self {
            turn: Rotation2::new(ring.heading_rad),
            ring,
            altitude_m: formation.altitude_m,
            band_step_m: formation.band_step_m,
            path_ends: None,
        }
    }

    /// The level ρ of a position relative to the centre, NED, m.
    pub(crate) fn level_m(&self, from_centre_m: Vector3<f64>) -> f64 {
        self.level_and_inside(from_centre_m).0
    }

    /// The level ρ of a position relative to the centre, NED, m, and whether it is in the region of the formation.
    pub(super) fn level_and_inside(&self, from_centre_m: Vector3<f64>) -> (f64, bool) {
        let level_m = |from_centre_m| self.ring.level_and_gradient(&self.turn, from_centre_m).0;
        let flat_m = level_m(Vector3::new(from_centre_m.x, from_centre_m.y, 0.0));
        match self.ring.gamma_z {
            None => (flat_m, self.ring.holds_level(flat_m)),
            Some(gamma_z) => {
                let rho_m = (math::square(flat_m) + gamma_z * math::square(from_centre_m.z)).sqrt();
                (rho_m, self.ring.holds_level(level_m(from_centre_m)))
            }
        }
    }

    /// Altitude of a rank counted from the middle rank, m; `None` on an ellipsoid, where any altitude is possible.
    pub(super) fn altitude_m(&self, rank: f64) -> Option<f64> {
        self.ring.gamma_z.is_none().then_some(self.altitude_m + rank * self.band_step_m)
    }

    /// Whether a centre at this place is moving along the path: between its two ends.
    pub(super) fn is_moving(&self, centre_ne_m: Vector2<f64>) -> bool {
        self.path_ends.is_some_and(|ends| !ends.contains(&centre_ne_m))
    }
}
