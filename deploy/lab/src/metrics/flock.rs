//! Measures how the swarm flies together: whether all vehicles fly in the same direction, and how they follow a moving
//! centre.

use nalgebra::Vector3;
use skein_common::id::VehicleSet;

use super::VehicleNow;
use super::series::Mean;
use super::steady::{Column, SwarmSeries};

/// Speed below which a vehicle has no direction of flight, m/s.
const MOVING_M_S: f64 = 0.2;

/// Measures how well the members' directions of flight agree.
#[derive(Debug, Default)]
pub(super) struct Alignment {
    /// The live members that moved at the last observation, as indices of the vehicles in ascending order, each with
    /// its direction of flight.
    pub(super) moving: Vec<(usize, Vector3<f64>)>,
}

impl Alignment {
    /// Observes all vehicles, of which those with the indices `members` are the live members.
    pub(super) fn observe(&mut self, series: &mut SwarmSeries, vehicles: &[VehicleNow], members: &[usize]) {
        self.moving.clear();
        let mut speeds_m_s = Mean::default();
        for &nth in members {
            let velocity = vehicles[nth].truth.velocity.0;
            let speed_m_s = velocity.norm();
            speeds_m_s.add(speed_m_s);
            self.moving.extend((speed_m_s > MOVING_M_S).then(|| (nth, velocity / speed_m_s)));
        }
        series.set(Column::Speed, speeds_m_s.mean());
        // A single vehicle always agrees with itself.
        if self.moving.len() < 2 {
            return;
        }
        series.set(Column::Polarization, self.polarization());
        series.set(Column::Order, self.order(vehicles));
    }

    /// Length of the mean direction, 0 to 1.
    fn polarization(&self) -> f64 {
        let sum = self.moving.iter().fold(Vector3::zeros(), |sum, (_, one)| sum + one);
        sum.norm() / self.moving.len() as f64
    }

    /// Mean of the mean cosines over the vehicles that move and are in contact with one that moves. The cosines of a
    /// vehicle add up to that with the sum of the others' directions.
    fn order(&self, vehicles: &[VehicleNow]) -> Option<f64> {
        let moving: VehicleSet = self.moving.iter().map(|(nth, _)| vehicles[*nth].id).collect();
        let of_all: Vector3<f64> = self.moving.iter().map(|(_, direction)| direction).sum();
        let mut orders = Mean::default();
        for (nth, own) in &self.moving {
            let VehicleNow { id, in_contact, .. } = vehicles[*nth];
            let mut others = moving.both(in_contact);
            others.remove(id);
            let is_one = |(other, _): &&(usize, Vector3<f64>)| others.contains(vehicles[*other].id);
            let of_others = if others.len() + 1 == moving.len() {
                of_all - own
            } else {
                self.moving.iter().filter(is_one).map(|(_, direction)| direction).sum()
            };
            if !others.is_empty() {
                orders.add(own.dot(&of_others) / others.len() as f64);
            }
        }
        orders.mean()
    }
}

/// Measures how the members follow their moving centres.
#[derive(Debug, Default)]
pub(super) struct Following {
    /// Whether a centre has ever moved.
    pub(super) has_begun: bool,
    /// Largest horizontal distance of a member from its centre, m.
    pub(super) farthest_m: Option<f64>,
    /// Share of members inside their ellipse.
    pub(super) inside: Mean,
    /// Distance of the centroid from the centre, from the first movement on, m.
    pub(super) lag_m: Mean,
}

impl Following {
    /// Adds a member whose centre moves.
    pub(super) fn follow(&mut self, distance_m: f64, inside: bool) {
        self.has_begun = true;
        self.farthest_m = Some(self.farthest_m.map_or(distance_m, |farthest_m| farthest_m.max(distance_m)));
        self.inside.add(f64::from(inside));
    }

    /// Adds the distance of the members' centroid from the centre, m.
    pub(super) fn trail(&mut self, lag_m: f64) {
        if self.has_begun {
            self.lag_m.add(lag_m);
        }
    }
}

#[cfg(test)]
mod tests {
    use skein_common::frame::VelocityNed;
    use skein_common::state::Membership;
    use skein_core::random::{self, Purpose};

    use super::super::tests::{set, vehicle};
    use super::*;

    fn moving(number: u8, in_contact: &[u8], velocity: [f64; 3]) -> VehicleNow {
        let mut vehicle = vehicle(number, 0.0, 100.0, 30.0);
        vehicle.in_contact = set(in_contact);
        vehicle.truth.velocity = VelocityNed::from(velocity);
        vehicle
    }

    fn live_members(vehicles: &[VehicleNow]) -> Vec<usize> {
        (0..vehicles.len()).filter(|&nth| vehicles[nth].is_live_member()).collect()
    }

    fn observed(vehicles: &[VehicleNow]) -> (Option<f64>, Option<f64>) {
        let mut series = SwarmSeries::default();
        series.begin(0.0);
        Alignment::default().observe(&mut series, vehicles, &live_members(vehicles));
        (series.mean(Column::Polarization, 0.0), series.mean(Column::Order, 0.0))
    }

    #[test]
    fn polarization_is_the_length_of_the_mean_direction() {
        let all = [moving(1, &[2, 3], [3.0, 0.0, 0.0]), moving(2, &[1, 3], [0.0, 0.5, 0.0])];
        let (polarization, order) = observed(&all);
        assert!((polarization.unwrap() - 0.5_f64.sqrt()).abs() < 1e-12, "north and east: {polarization:?}");
        assert!(order.unwrap().abs() < 1e-12, "at right angles: {order:?}");
        let slow = moving(3, &[1, 2], [-0.1, -0.1, 0.1]);
        assert_eq!(observed(&[all[0], all[1], slow]), (polarization, order), "a hovering vehicle has no direction");
        assert_eq!(observed(&[all[0], slow]), (None, None), "a single moving vehicle gives no value");
    }

    #[test]
    fn order_compares_only_vehicles_in_contact() {
        // 1 is in contact with 2, which flies in its direction; 2 with 3, which flies in the opposite direction; 3
        // with no vehicle.
        let all =
            [moving(1, &[2], [2.0, 0.0, 0.0]), moving(2, &[3], [4.0, 0.0, 0.0]), moving(3, &[], [-1.0, 0.0, 0.0])];
        let (polarization, order) = observed(&all);
        assert!((polarization.unwrap() - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!(order, Some(0.0), "the mean of 1 and -1");
        let mut dead = all;
        dead[2].runs = false;
        assert_eq!(observed(&dead), (Some(1.0), Some(1.0)), "a vehicle without an agent does not count as a neighbour");
    }

    #[test]
    fn order_equals_a_comparison_one_by_one() {
        let mut rng = random::generator(1, None, Purpose::Study);
        for gaps in [0.0, 0.02, 0.5] {
            let all: Vec<VehicleNow> = (1..=13)
                .map(|number| {
                    let others: Vec<u8> =
                        (1..=13).filter(|&other| other != number && random::uniform(&mut rng) >= gaps).collect();
                    moving(number, &others, [(); 3].map(|()| 9.0 * random::standard_normal(&mut rng)))
                })
                .collect();
            let directions = all.iter().map(|one| one.truth.velocity.0 / one.truth.velocity.0.norm());
            let mut expected = Mean::default();
            for (own, direction) in all.iter().zip(directions.clone()) {
                let mut cosines = Mean::default();
                for (_, theirs) in
                    all.iter().zip(directions.clone()).filter(|(other, _)| own.in_contact.contains(other.id))
                {
                    cosines.add(direction.dot(&theirs));
                }
                cosines.mean().into_iter().for_each(|cosine| expected.add(cosine));
            }
            let (order, expected) = (observed(&all).1.unwrap(), expected.mean().unwrap());
            assert!((order - expected).abs() < 1e-14, "{gaps}: {order} instead of {expected}");
        }
    }

    #[test]
    fn mean_speed_includes_hovering_members() {
        let mut all =
            [moving(1, &[], [3.0, 0.0, 4.0]), moving(2, &[], [0.0, 0.1, 0.0]), moving(3, &[], [9.0, 0.0, 0.0])];
        all[2].membership = Membership::Joining;
        let (mut alignment, mut series) = (Alignment::default(), SwarmSeries::default());
        series.begin(0.0);
        alignment.observe(&mut series, &all, &live_members(&all));
        assert!((series.mean(Column::Speed, 0.0).unwrap() - 2.55).abs() < 1e-12);
        assert_eq!(alignment.moving.len(), 1);
    }

    #[test]
    fn the_centroid_lag_counts_from_the_first_movement_on() {
        let mut following = Following::default();
        following.trail(100.0);
        following.follow(30.0, true);
        following.trail(10.0);
        following.follow(60.0, false);
        following.trail(20.0);
        assert_eq!((following.farthest_m, following.inside.mean()), (Some(60.0), Some(0.5)));
        assert_eq!(following.lag_m.mean(), Some(15.0));
    }
}
