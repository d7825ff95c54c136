//! The receivers of a swarm by their distance from a sender.

use alloc::vec::Vec;

use skein_common::frame::PositionNed;
use skein_common::id::VehicleSet;
use skein_common::math;

use super::super::channels::Range;

/// The positions of all receivers, and their components; NaN where it is unknown.
#[derive(Clone, Debug, Default)]
pub(super) struct Places {
    all: Vec<Option<PositionNed>>,
    north_m: Vec<f64>,
    east_m: Vec<f64>,
    down_m: Vec<f64>,
}

impl Places {
    /// Sets the positions, by id.
    pub(super) fn set(&mut self, positions: impl Iterator<Item = Option<PositionNed>>) {
        let Self { all, north_m, east_m, down_m } = self;
        all.clear();
        all.extend(positions);
        [&mut *north_m, east_m, down_m].into_iter().for_each(Vec::clear);
        for position in all {
            let [north, east, down] = position.map_or([f64::NAN; 3], |position| position.0.into());
            north_m.push(north);
            east_m.push(east);
            down_m.push(down);
        }
    }

    /// The positions, by id.
    pub(super) fn all(&self) -> impl Iterator<Item = Option<PositionNed>> {
        self.all.iter().copied()
    }

    /// The position of the receiver with this index.
    pub(super) fn of(&self, nth: usize) -> Option<PositionNed> {
        self.all.get(nth).copied().flatten()
    }

    /// The receivers to which surely nothing is lost by distance, and those to which surely all is. The distances of the others are
    /// close to a limit, or unknown.
    pub(super) fn near_and_far(&self, from: PositionNed, range: Range) -> (VehicleSet, VehicleSet) {
        /// More than the rounding error of a squared distance.
        const ROUNDING: f64 = 1e-9;
        let near = math::square(range.fade_m) * (1.0 - ROUNDING);
        let far = math::square(range.range_m) * (1.0 + ROUNDING);
        let [north, east, down] = from.0.into();
        let mut sets = [[0; 4]; 2];
        let columns = self.north_m.chunks(64).zip(self.east_m.chunks(64)).zip(self.down_m.chunks(64));
        for (block, ((norths, easts), downs)) in columns.enumerate().take(4) {
            let mut squared = [f64::NAN; 64];
            for (((squared, x), y), z) in squared.iter_mut().zip(norths).zip(easts).zip(downs) {
                *squared = math::square(x - north) + math::square(y - east) + math::square(z - down);
            }
            for (nth, squared) in squared.into_iter().enumerate() {
                sets[0][block] |= u64::from(squared < near) << nth;
                sets[1][block] |= u64::from(squared > far) << nth;
            }
        }
        let [near, far] = sets.map(|blocks| VehicleSet::try_from(blocks).unwrap_or_default());
        (near, far)
    }
}
