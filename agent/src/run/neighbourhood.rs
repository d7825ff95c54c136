//! The cells of the map from which a vehicle wants the states of strangers.

use skein_common::frame::PositionNed;
use skein_common::topic::Cell;

/// A vehicle leaves its home cell when it is this far beyond the border, m: one that flies along a border does not
/// change its subscriptions all the time.
const HYSTERESIS_M: f64 = 0.1 * Cell::SIDE_M;
/// How far ahead along its planned path a vehicle subscribes, m.
const AHEAD_M: f64 = Cell::SIDE_M;

/// The own cell with the eight around it, and the same about the place that lies ahead.
#[derive(Clone, Debug, Default)]
pub(super) struct Neighbourhood {
    homes: Option<[Cell; 2]>,
}

impl Neighbourhood {
    /// The cells to subscribe to, if they have changed. Positions are north and east of the fleet's origin; `towards` is
    /// where the mission leads.
    pub(super) fn changed(&mut self, position: PositionNed, towards: PositionNed) -> Option<Vec<Cell>> {
        let way = (towards - position).xy();
        let length_m = way.norm();
        let step = if length_m > 0.0 { way * (AHEAD_M.min(length_m) / length_m) } else { way };
        let ahead = PositionNed::new(position.north_m() + step.x, position.east_m() + step.y, 0.0);
        let before = self.homes;
        let homes = [
            home(before.map(|[here, _]| here), position),
            // A place ahead that is about here needs no cells of its own.
            home(before.map(|[_, ahead]| ahead), ahead),
        ];
        self.homes = Some(homes);
        (before != Some(homes)).then(|| {
            let mut cells: Vec<_> = homes.into_iter().flat_map(Cell::with_neighbours).collect();
            cells.sort_unstable();
            cells.dedup();
            cells
        })
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
        let mut changed = |north_m| neighbourhood.changed(at(north_m, 500.0), at(north_m, 500.0));
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
        let cells = neighbourhood.changed(at(500.0, 500.0), at(500.0, 5000.0)).unwrap();
        assert_eq!(cells.len(), 12);
        assert!(cells.contains(&Cell { x: 1, y: 2 }) && !cells.contains(&Cell { x: 0, y: 3 }), "{cells:?}");
        assert_eq!(neighbourhood.changed(at(500.0, 500.0), at(500.0, 600.0)).unwrap().len(), 9);
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
                cells = neighbourhood.changed(own, at(0.0, 0.0)).unwrap_or(cells);
                let other = Cell::of(at(north_m + from.0, east_m + from.1));
                prop_assert_eq!(cells.iter().filter(|cell| **cell == other).count(), 1);
            }
        }
    }
}
