//! Slots: the assigned positions of the members around the formation's centre.

use alloc::vec::Vec;
use core::f64::consts::{FRAC_1_SQRT_2, TAU};

use nalgebra::{Rotation2, Vector2};
use skein_common::math;
use skein_common::scenario::{Formation, Pattern};

/// Largest distance at which a vehicle is in its slot, m.
const IN_SLOT_M: f64 = 3.0;

/// A pattern of slots. Its axes point forward and to the right of the formation's heading.
#[derive(Clone, Debug, PartialEq)]
pub struct Slots {
    /// Shape of the pattern.
    pub pattern: Pattern,
    /// Circle: semi-axis along the heading, m (R*).
    pub radius_m: f64,
    /// Circle: squared ratio of the semi-axes (γ).
    pub gamma: f64,
    /// Line, V or grid: distance between neighbours, m.
    pub spacing_m: f64,
    /// List: offsets from the centre, north and east for heading 0, m.
    pub listed_ne_m: Vec<Vector2<f64>>,
    /// Heading of the pattern, clockwise from north, rad.
    pub heading_rad: f64,
}

impl Slots {
    /// The slots configured by a scenario.
    pub fn of(formation: &Formation) -> Self {
        let listed = formation.slots.offsets_ne_m.iter().flatten();
        Self {
            pattern: formation.slots.pattern,
            radius_m: formation.radius_m,
            gamma: formation.gamma,
            spacing_m: formation.slots.spacing_m,
            listed_ne_m: listed.copied().map(Vector2::from).collect(),
            heading_rad: formation.heading_rad(),
        }
    }

    /// Slot number `rank`, from 0, of `count`, relative to the centre, north and east, m. All patterns except lists are
    /// centred on the formation's centre.
    pub fn slot_ne_m(&self, rank: usize, count: usize) -> Vector2<f64> {
        let count = count.max(1);
        let on_axes_m = match self.pattern {
            Pattern::Circle => {
                let (sin, cos) = math::sin_cos(TAU * rank as f64 / count as f64);
                Vector2::new(self.radius_m * cos, self.radius_m / self.gamma.sqrt() * sin)
            }
            Pattern::List => self.listed_ne_m.get(rank).copied().unwrap_or_default(),
            Pattern::Line | Pattern::V | Pattern::Grid => {
                let sum: Vector2<f64> = (0..count).map(|rank| self.place(rank, count)).sum();
                (self.place(rank, count) - sum / count as f64) * self.spacing_m
            }
        };
        Rotation2::new(self.heading_rad) * on_axes_m
    }

    /// Position of a rank relative to the first, in units of the spacing between nearest neighbours.
    fn place(&self, rank: usize, count: usize) -> Vector2<f64> {
        match self.pattern {
            Pattern::Line => Vector2::new(0.0, rank as f64),
            // The first flies ahead, then one on each side.
            Pattern::V => {
                let behind = rank.div_ceil(2) as f64 * FRAC_1_SQRT_2;
                Vector2::new(-behind, if rank % 2 == 1 { -behind } else { behind })
            }
            _ => {
                let columns = (count as f64).sqrt().ceil() as usize;
                Vector2::new(-((rank / columns) as f64), (rank % columns) as f64)
            }
        }
    }
}

/// Whether a vehicle at this distance from its slot is in it.
pub fn is_in_slot(offset_m: f64) -> bool {
    offset_m < IN_SLOT_M
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use proptest::sample::select;

    use super::*;

    fn slots(pattern: Pattern) -> Slots {
        Slots { pattern, radius_m: 60.0, gamma: 1.0, spacing_m: 20.0, listed_ne_m: Vec::new(), heading_rad: 0.0 }
    }

    fn near(one: Vector2<f64>, north: f64, east: f64) -> bool {
        (one - Vector2::new(north, east)).norm() < 1e-9
    }

    #[test]
    fn slots_on_a_circle_run_clockwise_from_the_heading() {
        let circle = slots(Pattern::Circle);
        assert!(near(circle.slot_ne_m(0, 4), 60.0, 0.0));
        assert!(near(circle.slot_ne_m(1, 4), 0.0, 60.0), "the second is in the east");
        let turned = Slots { heading_rad: TAU / 2.0, ..circle.clone() };
        assert!(near(turned.slot_ne_m(1, 4), 0.0, -60.0), "turned by half a circle: opposite");
        let long = Slots { gamma: 4.0, heading_rad: TAU / 4.0, ..circle.clone() };
        assert!(near(long.slot_ne_m(0, 4), 0.0, 60.0) && near(long.slot_ne_m(1, 4), -30.0, 0.0));
        assert!(near(circle.slot_ne_m(0, 1), 60.0, 0.0), "a single vehicle");
    }

    #[test]
    fn lines_vs_and_grids_are_across_the_heading() {
        let line = slots(Pattern::Line);
        assert!(near(line.slot_ne_m(0, 3), 0.0, -20.0) && near(line.slot_ne_m(2, 3), 0.0, 20.0), "from left to right");
        let east = Slots { heading_rad: TAU / 4.0, ..line };
        assert!(near(east.slot_ne_m(0, 3), 20.0, 0.0), "heading east, left is north");
        let v = slots(Pattern::V);
        let [tip, left, right] = [0, 1, 2].map(|rank| v.slot_ne_m(rank, 3));
        assert!(tip.x > left.x && near(left, right.x, -right.y) && left.y < 0.0);
        assert!(((tip - left).norm() - 20.0).abs() < 1e-9 && (tip - left).dot(&(tip - right)).abs() < 1e-9);
        let grid = slots(Pattern::Grid);
        assert!(near(grid.slot_ne_m(0, 4), 10.0, -10.0) && near(grid.slot_ne_m(3, 4), -10.0, 10.0));
        let rows = (0..7).map(|rank| grid.slot_ne_m(rank, 7).x).fold(0.0_f64, |sum, x| sum.max(x));
        assert!(rows < 40.0, "seven vehicles fill three rows of three");
    }

    #[test]
    fn listed_slots_are_turned_with_the_heading() {
        let listed_ne_m = vec![Vector2::new(5.0, 0.0), Vector2::new(0.0, 30.0)];
        let list = Slots { listed_ne_m, heading_rad: TAU / 4.0, ..slots(Pattern::List) };
        assert!(near(list.slot_ne_m(0, 2), 0.0, 5.0) && near(list.slot_ne_m(1, 2), -30.0, 0.0));
        assert!(near(list.slot_ne_m(7, 2), 0.0, 0.0), "the centre, if the list is too short");
    }

    proptest! {
        #[test]
        fn slots_are_centred_and_keep_their_spacing(
            pattern in select(vec![Pattern::Line, Pattern::V, Pattern::Grid]),
            count in 1_usize..30, spacing_m in 5.0..50.0, heading_rad in -3.0..3.0,
        ) {
            let slots = Slots { spacing_m, heading_rad, ..slots(pattern) };
            let places: Vec<_> = (0..count).map(|rank| slots.slot_ne_m(rank, count)).collect();
            prop_assert!(places.iter().sum::<Vector2<f64>>().norm() < 1e-6);
            for (rank, place) in places.iter().enumerate() {
                let nearest = places[..rank].iter().map(|other| (other - place).norm()).fold(f64::INFINITY, f64::min);
                prop_assert!(rank == 0 || (nearest - spacing_m).abs() < 1e-6, "{nearest}");
            }
        }

        #[test]
        fn all_slots_of_a_circle_are_distinct_and_on_the_ellipse(
            count in 2_usize..20, gamma in 0.2..5.0, heading_rad in -3.0..3.0, radius_m in 10.0..200.0,
        ) {
            let slots = Slots { radius_m, gamma, heading_rad, ..slots(Pattern::Circle) };
            let places: Vec<_> = (0..count).map(|rank| slots.slot_ne_m(rank, count)).collect();
            for (rank, place) in places.iter().enumerate() {
                let axes = Rotation2::new(-heading_rad) * place;
                prop_assert!(((axes.x * axes.x + gamma * axes.y * axes.y).sqrt() - radius_m).abs() < 1e-6);
                prop_assert!(places[..rank].iter().all(|other| (other - place).norm() > 0.01 * radius_m));
            }
            prop_assert!(places.iter().sum::<Vector2<f64>>().norm() < 1e-6, "around the centre");
        }
    }
}
