//! The cells of the map from which a vehicle wants the messages of other teams.

use alloc::vec::Vec;

use skein_common::frame::PositionNed;
use skein_common::topic::Cell;

/// A vehicle leaves its home cell when it is this far beyond the border, m: one that flies along a border does not
/// change its subscriptions all the time.
const HYSTERESIS_M: f64 = 0.1 * Cell::SIDE_M;
/// Largest distance ahead along its planned path at which a vehicle subscribes to cells, m.
const AHEAD_M: f64 = Cell::SIDE_M;

/// Follows the cells in which a vehicle is, will be and wants to be.
#[derive(Clone, Debug, Default)]
pub struct Neighbourhood {
    homes: Option<Homes>,
}

/// The cells in which a vehicle is, will be and wants to be. It receives what is sent in them and in the eight around each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Homes {
    /// The cell of the vehicle.
    pub here: Cell,
    /// The cell of the place that lies ahead on its way.
    pub ahead: Cell,
    /// The cell of the area for which its team waits.
    pub wanted: Option<Cell>,
}

impl Homes {
    /// The cells to receive from, each once.
    pub fn cells(&self) -> Vec<Cell> {
        let homes = [Some(self.here), Some(self.ahead), self.wanted];
        let mut cells: Vec<_> = homes.into_iter().flatten().flat_map(Cell::with_neighbours).collect();
        cells.sort_unstable();
        cells.dedup();
        cells
    }
}

impl Neighbourhood {
    /// The cells, if they have changed. Positions are north and east of the fleet's origin; `towards` is where the mission
    /// leads, `wanted` the centre of the area for which the team waits.
    pub fn changed(
        &mut self,
        position: PositionNed,
        towards: PositionNed,
        wanted: Option<PositionNed>,
    ) -> Option<Homes> {
        let way = (towards - position).xy();
        let length_m = way.norm();
        let step = if length_m > 0.0 { way * (AHEAD_M.min(length_m) / length_m) } else { way };
        let ahead = PositionNed::new(position.north_m() + step.x, position.east_m() + step.y, 0.0);
        let before = self.homes;
        let homes = Homes {
            here: home(before.map(|homes| homes.here), position),
            // A place ahead that is about here needs no cells of its own.
            ahead: home(before.map(|homes| homes.ahead), ahead),
            wanted: wanted.map(Cell::of),
        };
        self.homes = Some(homes);
        (before != Some(homes)).then_some(homes)
    }

    /// The cells at the last look.
    pub fn homes(&self) -> Option<Homes> {
        self.homes
    }
}

/// The cell that contains the position, or still the one before if the position is hardly beyond its border.
fn home(before: Option<Cell>, position: PositionNed) -> Cell {
    let is_near = |cell: &Cell| {
        let beyond_m = |metres: f64, cell: i32| {
            let from_corner_m = metres - f64::from(cell) * Cell::SIDE_M;
            (-from_corner_m).max(from_corner_m - Cell::SIDE_M)
        };
        beyond_m(position.north_m(), cell.x).max(beyond_m(position.east_m(), cell.y)) <= HYSTERESIS_M
    };
    before.filter(is_near).unwrap_or_else(|| Cell::of(position))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn at(north_m: f64, east_m: f64) -> PositionNed {
        PositionNed::new(north_m, east_m, -30.0)
    }

    #[test]
    fn a_vehicle_along_a_border_keeps_its_cells() {
        let mut neighbourhood = Neighbourhood::default();
        let mut changed = |north_m| {
            let homes = neighbourhood.changed(at(north_m, 500.0), at(north_m, 500.0), None);
            homes.map(|homes| homes.cells())
        };
        let first = changed(990.0).unwrap();
        assert_eq!(first.len(), 9);
        assert!(first.contains(&Cell { x: -1, y: -1 }) && first.contains(&Cell { x: 1, y: 1 }), "{first:?}");
        for north_m in [1010.0, 1099.0, 990.0, 1050.0] {
            assert_eq!(changed(north_m), None, "{north_m}");
        }
        let second = changed(1101.0).unwrap();
        assert!(second.contains(&Cell { x: 2, y: 0 }) && !second.contains(&Cell { x: -1, y: 0 }), "{second:?}");
        assert_eq!(changed(950.0), None);
        assert_eq!(changed(899.0), Some(first));
    }

    #[test]
    fn the_cells_ahead_on_the_way_are_subscribed_before_the_border() {
        let mut neighbourhood = Neighbourhood::default();
        let mut cells = |towards, wanted| neighbourhood.changed(at(500.0, 500.0), towards, wanted).unwrap().cells();
        let to_east = cells(at(500.0, 5000.0), None);
        assert_eq!(to_east.len(), 12);
        assert!(to_east.contains(&Cell { x: 1, y: 2 }) && !to_east.contains(&Cell { x: 0, y: 3 }), "{to_east:?}");
        assert_eq!(cells(at(500.0, 600.0), None).len(), 9);
        let wanted = cells(at(500.0, 600.0), Some(at(7500.0, 500.0)));
        assert!(wanted.len() == 18 && wanted.contains(&Cell { x: 8, y: -1 }), "{wanted:?}");
    }

    proptest! {
        /// Two vehicles within reach of each other are subscribed to each other's cells, however they have come there.
        #[test]
        fn a_vehicle_that_crosses_borders_is_always_in_sight(
            way in prop::collection::vec((-4000.0..4000.0_f64, -4000.0..4000.0_f64), 1..20),
            from in (-700.0..700.0_f64, -700.0..700.0_f64),
        ) {
            let mut neighbourhood = Neighbourhood::default();
            let mut cells = Vec::new();
            for (north_m, east_m) in way {
                let own = at(north_m, east_m);
                cells = neighbourhood.changed(own, at(0.0, 0.0), None).map_or(cells, |homes| homes.cells());
                let other = Cell::of(at(north_m + from.0, east_m + from.1));
                prop_assert_eq!(cells.iter().filter(|cell| **cell == other).count(), 1);
            }
        }
    }
}
