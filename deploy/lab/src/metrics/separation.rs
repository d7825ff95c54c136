//! Measures the distances of pairs of vehicles in the air.
//!
//! Only two kinds of pairs change a figure: those nearer than [`COLLISION_M`], and one nearer than every pair before.
//! Both are found by a sweep along a line: the vehicles are kept in the order of their places along it, and each is
//! compared with those that follow within the distance that matters. So the time and memory of an instant are
//! proportional to the number of vehicles, and not to that of pairs.

use std::collections::BTreeSet;

use nalgebra::Vector3;
use skein_common::frame::PositionNed;
use skein_common::id::VehicleId;

use super::series::Mean;
use super::{AIRBORNE_ABOVE_M, COLLISION_M, VehicleNow};

/// Direction of the line, NED: a unit vector askew to north, east and down, so that the vehicles of a row, a column or a
/// stack are apart along it.
const ALONG: Vector3<f64> = Vector3::new(0.64, 0.60, 0.48);
/// Distance that is added to the one that matters, m: more than the rounding error of a place along the line.
const ROUNDING_M: f64 = 1e-3;

/// The separations of pairs of which both vehicles are in the air.
#[derive(Debug)]
pub(super) struct Separations {
    /// Number of vehicles of the swarm.
    vehicles: usize,
    /// The vehicles in the air at the last observation, in the order of ids.
    airborne: Vec<Placed>,
    /// Indices of `airborne`, in the order along the line.
    order: Vec<usize>,
    /// Square of the least distance so far, m²; infinite before there was a pair.
    least_square: f64,
    /// The pairs that have collided, lower id first.
    collided: BTreeSet<(VehicleId, VehicleId)>,
    /// Share of all pairs that are in a collision, averaged over time.
    pub(super) risk: Mean,
}

/// A vehicle in the air.
#[derive(Clone, Copy, Debug)]
struct Placed {
    id: VehicleId,
    position: PositionNed,
    /// Place along the line, m.
    along_m: f64,
}

impl Separations {
    /// A swarm of this many vehicles before it has flown.
    pub(super) fn new(vehicles: usize) -> Self {
        Self {
            vehicles,
            airborne: Vec::with_capacity(vehicles),
            order: Vec::with_capacity(vehicles),
            least_square: f64::INFINITY,
            collided: BTreeSet::new(),
            risk: Mean::default(),
        }
    }

    /// Observes all vehicles, in the order of ids. `counts` states whether least distance and collisions count now.
    pub(super) fn observe(&mut self, vehicles: &[VehicleNow], counts: bool) {
        self.airborne.clear();
        // A position that is not finite has no distance.
        let in_the_air = vehicles.iter().filter(|one| one.truth.height_m > AIRBORNE_ABOVE_M);
        self.airborne.extend(in_the_air.filter(|one| one.truth.position.is_finite()).map(|one| {
            let position = one.truth.position;
            Placed { id: one.id, position, along_m: position.0.dot(&ALONG) }
        }));
        if !counts {
            return;
        }
        if self.order.len() != self.airborne.len() {
            self.order.clear();
            self.order.extend(0..self.airborne.len());
        }
        self.sort();
        let colliding = self.sweep();
        if self.vehicles > 1 {
            self.risk.add(f64::from(colliding) / self.pairs());
        }
    }

    /// Sorts the order along the line by insertion: between two observations hardly any vehicle overtakes another.
    fn sort(&mut self) {
        let Self { airborne, order, .. } = self;
        for end in 1..order.len() {
            let (one, mut place) = (order[end], end);
            while place > 0 && airborne[order[place - 1]].along_m > airborne[one].along_m {
                order[place] = order[place - 1];
                place -= 1;
            }
            order[place] = one;
        }
    }

    /// Updates the least distance and the collided pairs; returns the number of pairs in a collision.
    fn sweep(&mut self) -> u32 {
        let Self { airborne, order, least_square, collided, .. } = self;
        let reach_m = |least_square: f64| least_square.sqrt().max(COLLISION_M) + ROUNDING_M;
        let (mut within_m, mut colliding) = (reach_m(*least_square), 0);
        for (nth, &one) in order.iter().enumerate() {
            let one = &airborne[one];
            for &other in &order[nth + 1..] {
                let other = &airborne[other];
                if other.along_m - one.along_m > within_m {
                    break;
                }
                let square = (one.position - other.position).norm_squared();
                colliding += u32::from(square < COLLISION_M * COLLISION_M);
                if square.sqrt() < COLLISION_M {
                    collided.insert((one.id.min(other.id), one.id.max(other.id)));
                }
                if square < *least_square {
                    *least_square = square;
                    within_m = reach_m(square);
                }
            }
        }
        colliding
    }

    /// Number of pairs of the swarm.
    pub(super) fn pairs(&self) -> f64 {
        (self.vehicles * self.vehicles.saturating_sub(1) / 2) as f64
    }

    /// Number of pairs that have collided.
    pub(super) fn collisions(&self) -> u64 {
        self.collided.len() as u64
    }

    /// Least distance of any pair so far, m.
    pub(super) fn least_m(&self) -> Option<f64> {
        Some(self.least_square.sqrt()).filter(|least_m| least_m.is_finite())
    }

    /// Distance of the nearest pair at the last observation, m.
    pub(super) fn nearest_now_m(&self) -> Option<f64> {
        let mut nearest_square = f64::INFINITY;
        for (nth, one) in self.airborne.iter().enumerate() {
            for other in &self.airborne[..nth] {
                nearest_square = nearest_square.min((one.position - other.position).norm_squared());
            }
        }
        Some(nearest_square.sqrt()).filter(|nearest_m| nearest_m.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use skein_core::random::{self, Purpose};

    use super::super::tests::vehicle;
    use super::*;

    /// The figures by a comparison of all pairs at each instant.
    #[derive(Default)]
    struct AllPairs {
        least_square: BTreeSet<(VehicleId, VehicleId, u64)>,
        colliding: Vec<u32>,
        nearest_m: Option<f64>,
    }

    impl AllPairs {
        fn observe(&mut self, vehicles: &[VehicleNow], counts: bool) {
            let (mut squares, mut colliding) = (Vec::new(), 0);
            for (nth, one) in vehicles.iter().enumerate() {
                for other in &vehicles[..nth] {
                    if one.truth.height_m > AIRBORNE_ABOVE_M && other.truth.height_m > AIRBORNE_ABOVE_M {
                        let square = (one.truth.position - other.truth.position).norm_squared();
                        squares.push(square);
                        colliding += u32::from(square < COLLISION_M * COLLISION_M);
                        if counts {
                            // Squares are positive: their bits are in the same order.
                            self.least_square.insert((other.id, one.id, square.to_bits()));
                        }
                    }
                }
            }
            self.nearest_m = squares.into_iter().reduce(f64::min).map(f64::sqrt);
            if counts {
                self.colliding.push(colliding);
            }
        }
    }

    #[test]
    fn the_sweep_gives_the_bits_of_a_comparison_of_all_pairs() {
        let mut rng = random::generator(3, None, Purpose::Study);
        for (count, spread_m) in [(1, 5.0), (2, 3.0), (5, 20.0), (40, 30.0), (60, 900.0)] {
            let (mut swept, mut all) = (Separations::new(count), AllPairs::default());
            let mut place = || Vector3::from_fn(|_, _| (random::uniform(&mut rng) - 0.5) * spread_m);
            let mut vehicles: Vec<VehicleNow> =
                (1..=count as u8).map(|number| vehicle(number, 0.0, 0.0, 30.0)).collect();
            vehicles.iter_mut().for_each(|vehicle| vehicle.truth.position = PositionNed(place()));
            for instant in 0..200 {
                for vehicle in &mut vehicles {
                    let step = place();
                    vehicle.truth.position = vehicle.truth.position + step * 0.02;
                    // Some take off and land, and a dead one stays where it is.
                    if step.x.abs() > 0.45 * spread_m {
                        vehicle.truth.height_m = 31.0 - vehicle.truth.height_m;
                    }
                }
                // Every second vehicle of a row comes to the same place along the line.
                if instant == 100 {
                    vehicles
                        .iter_mut()
                        .step_by(2)
                        .for_each(|vehicle| vehicle.truth.position = PositionNed(place() * 1e-3));
                }
                let counts = instant > 20;
                swept.observe(&vehicles, counts);
                all.observe(&vehicles, counts);
                assert_eq!(swept.nearest_now_m(), all.nearest_m, "{count} vehicles, instant {instant}");
            }
            let least_square = all.least_square.iter().map(|(.., square)| f64::from_bits(*square)).reduce(f64::min);
            assert_eq!(swept.least_m(), least_square.map(f64::sqrt));
            let near = all.least_square.iter().filter(|(.., square)| f64::from_bits(*square).sqrt() < COLLISION_M);
            let collided: BTreeSet<_> = near.map(|(one, other, _)| (*one, *other)).collect();
            assert_eq!(swept.collided, collided);
            let shares = all.colliding.iter().map(|&colliding| f64::from(colliding) / swept.pairs());
            let risk = shares.sum::<f64>() / all.colliding.len() as f64;
            assert_eq!(swept.risk.mean(), (count > 1).then_some(risk));
        }
    }
}
