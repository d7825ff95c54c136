//! The virtual structure: every vehicle has a slot of its own on the ellipse and flies there.
//!
//! After M. A. Lewis & K.-H. Tan, "High Precision Formation Control of Mobile Robots Using Virtual Structures", Autonomous
//! Robots 4 (1997), in its simplest form: nobody forms the structure by consensus, because slots follow from the centre and
//! the ranks among the live ids, which all agree on as soon as they hear the same vehicles. It is what even spacing can be at
//! best, and the one law here that says who is where.

use nalgebra::{Rotation2, Vector2};
use std::f64::consts::TAU;

/// As near to its slot as this a vehicle is in it, m.
const IN_SLOT_M: f64 = 3.0;

/// Slots on an ellipse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Structure {
    /// Semi-axis along the heading, m (R*).
    pub radius_m: f64,
    /// Squared ratio of the semi-axes (γ).
    pub gamma: f64,
    /// Direction of the first slot, which lies on the first axis, clockwise from north, rad.
    pub heading_rad: f64,
}

impl Structure {
    /// The slot of the member with this rank, from 0, among `live` members, from the centre, north and east, m: at the angle
    /// 2π·rank/N of the ellipse, clockwise from its first axis.
    pub fn slot_ne_m(&self, rank: usize, live: usize) -> Vector2<f64> {
        let (sin, cos) = (TAU * rank as f64 / live.max(1) as f64).sin_cos();
        let on_axes_m = Vector2::new(self.radius_m * cos, self.radius_m / self.gamma.sqrt() * sin);
        Rotation2::new(self.heading_rad) * on_axes_m
    }

    /// Whether a vehicle with this way to its slot is in it.
    pub fn is_in_slot(&self, way_ne_m: Vector2<f64>) -> bool {
        way_ne_m.norm() < IN_SLOT_M
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn slots_stand_clockwise_from_the_heading() {
        let structure = Structure { radius_m: 60.0, gamma: 1.0, heading_rad: 0.0 };
        let near = |one: Vector2<f64>, north, east| (one - Vector2::new(north, east)).norm() < 1e-9;
        assert!(near(structure.slot_ne_m(0, 4), 60.0, 0.0));
        assert!(near(structure.slot_ne_m(1, 4), 0.0, 60.0), "the second in the east");
        let turned = Structure { heading_rad: TAU / 2.0, ..structure };
        assert!(near(turned.slot_ne_m(1, 4), 0.0, -60.0), "half a turn on: opposite");
        let long = Structure { gamma: 4.0, heading_rad: TAU / 4.0, ..structure };
        assert!(near(long.slot_ne_m(0, 4), 0.0, 60.0) && near(long.slot_ne_m(1, 4), -30.0, 0.0));
        assert!(near(structure.slot_ne_m(0, 1), 60.0, 0.0), "alone");
    }

    proptest! {
        #[test]
        fn all_slots_lie_on_the_ellipse_and_no_two_together(
            live in 2_usize..20, gamma in 0.2..5.0, heading_rad in -3.0..3.0, radius_m in 10.0..200.0,
        ) {
            let structure = Structure { radius_m, gamma, heading_rad };
            let slots: Vec<_> = (0..live).map(|rank| structure.slot_ne_m(rank, live)).collect();
            for (rank, slot) in slots.iter().enumerate() {
                let axes = Rotation2::new(-heading_rad) * slot;
                prop_assert!(((axes.x * axes.x + gamma * axes.y * axes.y).sqrt() - radius_m).abs() < 1e-6);
                prop_assert!(slots[..rank].iter().all(|other| (other - slot).norm() > 0.01 * radius_m));
            }
            prop_assert!(slots.iter().sum::<Vector2<f64>>().norm() < 1e-6, "around the centre");
        }
    }
}
