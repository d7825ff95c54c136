//! Separations of vehicles of different teams.
//!
//! Each team has a box around its vehicles in the air. Only teams whose boxes are nearer than the least separation so
//! far, or than a collision, are compared vehicle by vehicle. So the least separation is exact, and costs little where
//! teams are far apart.

use std::collections::BTreeSet;

use nalgebra::Vector3;
use skein_common::frame::{Origin, PositionNed};
use skein_common::id::{FleetVehicle, TeamId, VehicleId};

use super::COLLISION_M;

/// Slack of a box around a team, m and as a share of its extent: more than the rounding, and than the different scales of two
/// frames up to 200 km apart.
const SLACK_M: f64 = 2.0;
const SLACK: f64 = 2e-3;

/// The vehicles of one team in the air, at a number of instants.
#[derive(Debug)]
pub struct Airborne {
    team: TeamId,
    /// Origin of the team's frame.
    origin: Origin,
    /// Each instant, s, with the vehicles in the air and their positions in the team's frame.
    instants: Vec<(f64, Vec<(VehicleId, PositionNed)>)>,
    /// Least and largest coordinates of all instants in the team's frame; `None` with no vehicle in the air.
    bounds: Option<(Vector3<f64>, Vector3<f64>)>,
}

impl Airborne {
    /// No instant yet. `origin` is that of the team's frame.
    pub fn new(team: TeamId, origin: Origin) -> Self {
        Self { team, origin, instants: Vec::new(), bounds: None }
    }

    /// Forgets all instants.
    pub fn clear(&mut self) {
        self.instants.clear();
        self.bounds = None;
    }

    /// Adds the next instant, s, with the vehicles in the air and their positions in the team's frame.
    pub fn add(&mut self, t_s: f64, vehicles: impl Iterator<Item = (VehicleId, PositionNed)>) {
        // A position that is not finite has no distance.
        let instant: Vec<_> = vehicles.filter(|(_, position)| position.is_finite()).collect();
        for (_, position) in &instant {
            let (least, largest) = self.bounds.get_or_insert((position.0, position.0));
            (*least, *largest) = (least.inf(&position.0), largest.sup(&position.0));
        }
        self.instants.push((t_s, instant));
    }

    /// The box of all instants in the fleet's frame.
    fn bounds(&self, fleet: &Origin) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let (least, largest) = self.bounds?;
        let corners = (0..8).map(|nth| {
            let pick = |axis: usize| if nth >> axis & 1 == 0 { least[axis] } else { largest[axis] };
            in_fleet(fleet, &self.origin, PositionNed(Vector3::new(pick(0), pick(1), pick(2))))
        });
        let around = |(least, largest): (Vector3<f64>, Vector3<f64>), corner: Vector3<f64>| {
            (least.inf(&corner), largest.sup(&corner))
        };
        let nothing = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
        let (least, largest) = corners.fold(nothing, around);
        let slack_m = SLACK_M + SLACK * (largest - least).norm();
        Some((least.add_scalar(-slack_m), largest.add_scalar(slack_m)))
    }
}

fn in_fleet(fleet: &Origin, team: &Origin, position: PositionNed) -> Vector3<f64> {
    fleet.ned_from_geodetic(&team.geodetic_from_ned(position)).0
}

/// The separations of all pairs of vehicles of different teams, both in the air.
#[derive(Debug)]
pub struct Across {
    /// Origin of the fleet's frame.
    fleet: Origin,
    /// Square of the least distance so far, m²; infinite before there was a pair.
    least_square: f64,
    /// The nearest pair so far, and when it was nearest, s.
    nearest: Option<(FleetVehicle, FleetVehicle, f64)>,
    collided: BTreeSet<(FleetVehicle, FleetVehicle)>,
}

impl Across {
    /// No separation yet. `fleet` is the origin of the fleet's frame.
    pub fn new(fleet: Origin) -> Self {
        Self { fleet, least_square: f64::INFINITY, nearest: None, collided: BTreeSet::new() }
    }

    /// Observes all teams, in order. All have the same instants.
    pub fn observe(&mut self, teams: &[&Airborne]) {
        let boxed = |(nth, team): (usize, &&Airborne)| Some((nth, team.bounds(&self.fleet)?));
        let mut boxes: Vec<_> = teams.iter().enumerate().filter_map(boxed).collect();
        boxes.sort_by(|(_, (one, _)), (_, (other, _))| one.x.total_cmp(&other.x));
        // The nearest boxes first: then the first comparisons find a small distance, and most others are not needed.
        let mut near = Vec::new();
        let within_m = self.within_m();
        for (place, (one, (one_least, one_largest))) in boxes.iter().enumerate() {
            for (other, (other_least, other_largest)) in &boxes[place + 1..] {
                if other_least.x - one_largest.x > within_m {
                    break;
                }
                let gap = (other_least - one_largest).sup(&(one_least - other_largest)).sup(&Vector3::zeros());
                if gap.norm() <= within_m {
                    near.push((gap.norm(), *one.min(other), *one.max(other)));
                }
            }
        }
        near.sort_by(|one, other| one.0.total_cmp(&other.0).then((one.1, one.2).cmp(&(other.1, other.2))));
        for (gap_m, one, other) in near {
            if gap_m <= self.within_m() {
                self.compare(teams[one], teams[other]);
            }
        }
    }

    /// Distance beyond which a pair changes nothing, m.
    fn within_m(&self) -> f64 {
        self.least_square.sqrt().max(COLLISION_M)
    }

    /// Compares all vehicles of two teams at each instant.
    fn compare(&mut self, one: &Airborne, other: &Airborne) {
        for ((t_s, ones), (_, others)) in one.instants.iter().zip(&other.instants) {
            let in_ones = |(id, position): &(VehicleId, PositionNed)| {
                let position = one.origin.ned_from_geodetic(&other.origin.geodetic_from_ned(*position));
                (*id, position)
            };
            let others: Vec<_> = others.iter().map(in_ones).collect();
            for (id, position) in ones {
                for (other_id, other_position) in &others {
                    let square = (*position - *other_position).norm_squared();
                    let pair = || {
                        let one = FleetVehicle { team: one.team, vehicle: *id };
                        (one, FleetVehicle { team: other.team, vehicle: *other_id })
                    };
                    if square < COLLISION_M * COLLISION_M {
                        self.collided.insert(pair());
                    }
                    if square < self.least_square {
                        let (one, other) = pair();
                        self.least_square = square;
                        self.nearest = Some((one, other, *t_s));
                    }
                }
            }
        }
    }

    /// Least distance of two vehicles of different teams so far, m, with the two and the time, s.
    pub fn least(&self) -> Option<(f64, (FleetVehicle, FleetVehicle, f64))> {
        Some((self.least_square.sqrt(), self.nearest?))
    }

    /// Number of pairs that have collided.
    pub fn collisions(&self) -> u64 {
        self.collided.len() as u64
    }
}

#[cfg(test)]
mod tests {
    use skein_common::frame::Geodetic;
    use skein_core::random::{self, Purpose};

    use super::*;

    #[test]
    fn the_boxes_give_the_least_separation_of_a_comparison_of_all() {
        let fleet = Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0));
        let mut rng = random::generator(5, None, Purpose::Study);
        for spread_m in [30.0, 300.0, 30_000.0] {
            let mut uniform = |width_m: f64| (random::uniform(&mut rng) - 0.5) * width_m;
            let mut teams: Vec<Airborne> = TeamId::first(12)
                .map(|team| {
                    let place = PositionNed::new(uniform(spread_m), uniform(spread_m), 0.0);
                    Airborne::new(team, Origin::new(fleet.geodetic_from_ned(place)))
                })
                .collect();
            let (mut across, mut least_m) = (Across::new(fleet), f64::INFINITY);
            for _ in 0..20 {
                for team in &mut teams {
                    team.clear();
                    for instant in 0..3 {
                        let mut place = || PositionNed::new(uniform(100.0), uniform(100.0), -30.0 + uniform(10.0));
                        team.add(f64::from(instant), VehicleId::first(4).map(|id| (id, place())));
                    }
                }
                across.observe(&teams.iter().collect::<Vec<_>>());
                let at = |team: &Airborne, instant: usize, nth: usize| {
                    in_fleet(&fleet, &team.origin, team.instants[instant].1[nth].1)
                };
                for instant in 0..3 {
                    for (nth, one) in teams.iter().enumerate() {
                        for other in &teams[..nth] {
                            for pair in 0..16 {
                                let apart = at(one, instant, pair / 4) - at(other, instant, pair % 4);
                                least_m = least_m.min(apart.norm());
                            }
                        }
                    }
                }
                let (found_m, _) = across.least().unwrap();
                // The map of another origin shows a distance 30 km away as up to three millionths shorter.
                assert!((found_m - least_m).abs() < 1e-6 + 3e-6 * least_m, "{found_m} {least_m}");
            }
            assert_eq!(across.collisions() > 0, least_m < COLLISION_M);
        }
    }

    #[test]
    fn teams_on_the_ground_have_no_separation() {
        let fleet = Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0));
        let mut across = Across::new(fleet);
        let mut teams: Vec<_> = TeamId::first(2).map(|team| Airborne::new(team, fleet)).collect();
        teams.iter_mut().for_each(|team| team.add(0.0, [].into_iter()));
        across.observe(&teams.iter().collect::<Vec<_>>());
        assert_eq!(across.least(), None);
    }
}
