//! Measures how the swarm flies together: whether all vehicles fly in the same direction, and how they follow a moving
//! centre.

use nalgebra::Vector3;
use skein_common::frame::VelocityNed;

use super::VehicleNow;
use super::series::{Mean, Window};

/// Speed below which a vehicle has no direction of flight, m/s.
const MOVING_M_S: f64 = 0.2;

/// Measures how well the members' directions of flight agree.
#[derive(Debug, Default)]
pub(super) struct Alignment {
    /// Polarization Φ, 0 to 1.
    pub(super) polarization: Window,
    /// Mean over the members of the mean cosine between their own velocity and those of the members in contact.
    pub(super) order: Window,
    /// Mean speed of the members, m/s: Vásárhelyi's φ^vel.
    pub(super) speed_m_s: Window,
    /// Direction of flight of each vehicle; `None` if it is not a live member or does not move.
    directions: Vec<Option<Vector3<f64>>>,
}

impl Alignment {
    pub(super) fn observe(&mut self, t_s: f64, vehicles: &[VehicleNow]) {
        self.directions.clear();
        let mut speeds_m_s = Mean::default();
        for vehicle in vehicles {
            let moving = vehicle.is_live_member().then(|| speed_and_direction(&vehicle.truth.velocity));
            if let Some((speed_m_s, _)) = moving {
                speeds_m_s.add(speed_m_s);
            }
            self.directions.push(moving.and_then(|(_, direction)| direction));
        }
        if let Some(speed_m_s) = speeds_m_s.mean() {
            self.speed_m_s.add(t_s, speed_m_s);
        }
        // A single vehicle always agrees with itself.
        if self.directions.iter().flatten().count() < 2 {
            return;
        }
        if let Some(polarization) = polarization(&self.directions) {
            self.polarization.add(t_s, polarization);
        }
        if let Some(order) = order(vehicles, &self.directions) {
            self.order.add(t_s, order);
        }
    }

    /// Direction of flight of each vehicle at the last observation; `None` if it is not a live member or does not move.
    pub(super) fn directions(&self) -> &[Option<Vector3<f64>>] {
        &self.directions
    }
}

/// Speed, m/s, and the direction of flight, if the vehicle moves.
fn speed_and_direction(velocity: &VelocityNed) -> (f64, Option<Vector3<f64>>) {
    let speed_m_s = velocity.0.norm();
    (speed_m_s, (speed_m_s > MOVING_M_S).then(|| velocity.0 / speed_m_s))
}

/// Length of the mean direction, 0 to 1.
fn polarization(directions: &[Option<Vector3<f64>>]) -> Option<f64> {
    let (count, sum) =
        directions.iter().flatten().fold((0_u32, Vector3::zeros()), |(count, sum), one| (count + 1, sum + one));
    (count > 0).then(|| sum.norm() / f64::from(count))
}

/// Mean of the mean cosines over the vehicles that move and are in contact with one that moves.
fn order(vehicles: &[VehicleNow], directions: &[Option<Vector3<f64>>]) -> Option<f64> {
    let mut all = Mean::default();
    for (vehicle, own) in vehicles.iter().zip(directions) {
        let Some(own) = own else { continue };
        let mut cosines = Mean::default();
        for (other, theirs) in vehicles.iter().zip(directions) {
            if let Some(theirs) = theirs
                && vehicle.in_contact.contains(other.id)
            {
                cosines.add(own.dot(theirs));
            }
        }
        if let Some(cosine) = cosines.mean() {
            all.add(cosine);
        }
    }
    all.mean()
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
        self.inside.add(if inside { 1.0 } else { 0.0 });
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
    use super::super::tests::{set, vehicle};
    use super::*;

    fn moving(number: u8, in_contact: &[u8], velocity: [f64; 3]) -> VehicleNow {
        let mut vehicle = vehicle(number, 0.0, 100.0, 30.0);
        vehicle.in_contact = set(in_contact);
        vehicle.truth.velocity = VelocityNed::from(velocity);
        vehicle
    }

    fn observed(vehicles: &[VehicleNow]) -> (Option<f64>, Option<f64>) {
        let mut alignment = Alignment::default();
        alignment.observe(0.0, vehicles);
        (alignment.polarization.mean(0.0), alignment.order.mean(0.0))
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
    fn mean_speed_includes_hovering_members() {
        let mut all =
            [moving(1, &[], [3.0, 0.0, 4.0]), moving(2, &[], [0.0, 0.1, 0.0]), moving(3, &[], [9.0, 0.0, 0.0])];
        all[2].is_member = false;
        let mut alignment = Alignment::default();
        alignment.observe(0.0, &all);
        assert!((alignment.speed_m_s.mean(0.0).unwrap() - 2.55).abs() < 1e-12);
        assert_eq!(alignment.directions().iter().flatten().count(), 1);
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
