//! From where everybody is to where this vehicle should go.
//!
//! A law gives a dimensionless field, [`conversion`] makes metres of it. A law sees its own place, the live members as last
//! heard, and the goal: nothing else, so that it can be moved to any vehicle and any swarm.

pub mod conversion;
pub mod ring;
pub mod safety;

use nalgebra::Vector2;
use skein_common::id::VehicleId;
use skein_common::scenario::{self, Scenario};

use crate::control::{Setpoint, VELOCITY_PER_ERROR};
use crate::estimate::Estimate;
use crate::mission::{Goal, Task};
use crate::peers::{Role, Seen};
use conversion::Conversion;
use ring::{AvoidDistance, Avoidance, COINCIDENT_M, Ring};
use safety::{Constraint, SafetyFilter};

/// Beyond this error the vehicle controller flies no faster, m.
const FASTEST_M: f64 = 15.0;
/// Farther above or below than this an obstacle is nobody's concern, m.
const OBSTACLE_REACH_M: f64 = 15.0;

/// Another live member.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// Who.
    pub id: VehicleId,
    /// Its place now, north and east, m.
    pub position_ne_m: Vector2<f64>,
}

/// Something to keep away from that is no member.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Obstacle {
    /// Whose place it is.
    pub id: VehicleId,
    /// Where it is thought to be, north and east, m.
    pub position_ne_m: Vector2<f64>,
    /// How far around that it may be, m.
    pub radius_m: f64,
}

/// What the formation wants of this vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wish {
    /// The field V, north and east, dimensionless; zero where no law is asked.
    pub field_ne: Vector2<f64>,
    /// What the vehicle controller is to fly.
    pub setpoint: Setpoint,
    /// The vehicle is where the law wants it, at height and slow: after a while of this it has "reached".
    pub in_place: bool,
}

/// This close to an altitude is at it, m.
const AT_ALTITUDE_M: f64 = 1.0;
/// In place, a vehicle is slower than this relative to the centre, m/s, and its field is weaker than this.
const IN_PLACE_M_S: f64 = 0.5;
const IN_PLACE_FIELD: f64 = 0.15;

impl Wish {
    /// Whether the vehicle is at the altitude that it is asked to be at.
    pub fn is_at_altitude(&self, estimate: &Estimate) -> bool {
        (estimate.position.altitude_m() - self.setpoint.altitude_m).abs() < AT_ALTITUDE_M
    }
}

/// The formation stage of one vehicle.
#[derive(Clone, Debug)]
pub struct Formation {
    own: VehicleId,
    /// One for each step of the mission.
    shapes: Vec<Shape>,
    filter: Option<SafetyFilter>,
    neighbours: Vec<Neighbour>,
    obstacles: Vec<Obstacle>,
    constraints: Vec<Constraint>,
    is_restrained: bool,
    activations: u64,
}

/// What the formation is during one step of the mission.
#[derive(Clone, Debug)]
struct Shape {
    ring: Ring,
    conversion: Conversion,
    filter: Option<SafetyFilter>,
    altitude_m: f64,
    feedforward: bool,
}

impl Shape {
    fn new(wanted: &scenario::Formation) -> Self {
        let conversion = match wanted.conversion {
            scenario::Conversion::Linear => Conversion::Linear { gain_m: wanted.gain_m },
            scenario::Conversion::Nonlinear => {
                Conversion::Nonlinear { gain_m: wanted.gain_m, far_gain_m: wanted.far_gain_m, knee: wanted.gain_knee }
            }
        };
        let filter = match wanted.safety_filter {
            scenario::SafetyFilter::None => None,
            scenario::SafetyFilter::Cbf => {
                Some(SafetyFilter { distance_m: wanted.safety_distance_m, rate_per_s: wanted.safety_rate_per_s })
            }
        };
        let (ring, altitude_m, feedforward) = (ring(wanted), wanted.altitude_m, wanted.feedforward);
        Self { ring, conversion, filter, altitude_m, feedforward }
    }
}

impl Formation {
    /// The formations of a scenario's mission, as vehicle `own` flies them.
    pub fn new(own: VehicleId, scenario: &Scenario) -> Self {
        let shapes: Vec<_> = scenario.mission.steps.iter().map(|step| Shape::new(&step.formation)).collect();
        Self {
            own,
            filter: shapes.first().and_then(|shape| shape.filter),
            shapes,
            neighbours: Vec::new(),
            obstacles: Vec::new(),
            constraints: Vec::new(),
            is_restrained: false,
            activations: 0,
        }
    }

    /// Other members counted in the last step.
    pub fn neighbours(&self) -> &[Neighbour] {
        &self.neighbours
    }

    /// How often the safety filter has stepped in; `None` without one.
    pub fn safety_activations(&self) -> Option<u64> {
        self.filter.map(|_| self.activations)
    }

    /// What to fly now, `dt_s` after the last step. `None` when the task leaves the controls alone.
    pub fn step(&mut self, dt_s: f64, estimate: &Estimate, peers: &[Seen], task: &Task) -> Option<Wish> {
        self.sort_out(estimate, peers);
        match task {
            Task::Wait | Task::Park | Task::ComeDown { .. } => None,
            Task::Formation(goal) => self.fly(dt_s, estimate, goal),
            Task::Stay { at_ne_m, altitude_m, heading_rad } => {
                let own_ne_m = estimate.position.horizontal();
                let error_ne_m = self.restrain(own_ne_m, at_ne_m - own_ne_m);
                let setpoint = Setpoint {
                    error_ne_m,
                    feedforward_ne_m_s: Vector2::zeros(),
                    altitude_m: *altitude_m,
                    heading_rad: *heading_rad,
                };
                Some(Wish { field_ne: Vector2::zeros(), setpoint, in_place: false })
            }
        }
    }

    /// The law of the goal's step.
    fn fly(&mut self, _dt_s: f64, estimate: &Estimate, goal: &Goal) -> Option<Wish> {
        let own_ne_m = estimate.position.horizontal();
        let shape = self.shapes.get(goal.step)?;
        let Shape { ring, altitude_m, .. } = shape;
        let field_ne = ring.field_ne(self.own, own_ne_m, goal.centre_ne_m, &self.neighbours, &self.obstacles);
        let feedforward_ne_m_s =
            if shape.feedforward { goal.centre_velocity_ne_m_s } else { Vector2::zeros() };
        let wanted_m = shape.conversion.error_ne_m(field_ne);
        let relative_m_s = (estimate.velocity.horizontal() - goal.centre_velocity_ne_m_s).norm();
        let is_in_band = ring.is_in_band(own_ne_m - goal.centre_ne_m);
        let settled = is_in_band && relative_m_s < IN_PLACE_M_S && field_ne.norm() < IN_PLACE_FIELD;
        let altitude_m = *altitude_m;
        self.filter = shape.filter;
        let error_ne_m = self.restrain(own_ne_m, wanted_m);
        let setpoint = Setpoint { error_ne_m, feedforward_ne_m_s, altitude_m, heading_rad: goal.heading_rad };
        let wish = Wish { field_ne, setpoint, in_place: false };
        Some(Wish { in_place: settled && wish.is_at_altitude(estimate), ..wish })
    }

    /// The error with which nobody is come too near; the wanted one, if that does it.
    fn restrain(&mut self, own_ne_m: Vector2<f64>, wanted_m: Vector2<f64>) -> Vector2<f64> {
        let Some(filter) = self.filter else { return wanted_m };
        let members = self.neighbours.iter().map(|member| (member.position_ne_m, 0.0));
        let obstacles = self.obstacles.iter().map(|obstacle| (obstacle.position_ne_m, obstacle.radius_m));
        let near = members.chain(obstacles).map(|(place_ne_m, clear_m)| (own_ne_m - place_ne_m, clear_m));
        // Two at the very same place are parted by the law.
        let parted = near.filter(|(from_other_m, _)| from_other_m.norm_squared() > COINCIDENT_M * COINCIDENT_M);
        self.constraints.clear();
        self.constraints.extend(parted.map(|(from_other_m, clear_m)| filter.constraint(from_other_m, clear_m)));
        let wanted_m_s = wanted_m.cap_magnitude(FASTEST_M) * VELOCITY_PER_ERROR;
        let restrained = filter.restrain(wanted_m_s, &self.constraints);
        self.activations += u64::from(restrained.is_some() && !self.is_restrained);
        self.is_restrained = restrained.is_some();
        restrained.map_or(wanted_m, |velocity_m_s| velocity_m_s / VELOCITY_PER_ERROR)
    }

    /// Tells members from obstacles.
    fn sort_out(&mut self, estimate: &Estimate, peers: &[Seen]) {
        self.neighbours.clear();
        self.obstacles.clear();
        for peer in peers {
            let (id, position_ne_m) = (peer.id, peer.position.horizontal());
            match peer.role {
                Role::Member => self.neighbours.push(Neighbour { id, position_ne_m }),
                Role::Obstacle { radius_m } => {
                    if (peer.position.altitude_m() - estimate.position.altitude_m()).abs() < OBSTACLE_REACH_M {
                        self.obstacles.push(Obstacle { id, position_ne_m, radius_m });
                    }
                }
                Role::Nothing => {}
            }
        }
    }
}

/// The ring of a scenario.
pub fn ring(wanted: &scenario::Formation) -> Ring {
    let edge_exponent = ring::edge_exponent(wanted.edge_share);
    let steepness = |width_m: f64| wanted.edge_steepness_per_m.unwrap_or(edge_exponent / width_m);
    Ring {
        radius_m: wanted.radius_m,
        gamma: wanted.gamma,
        heading_rad: wanted.heading_rad(),
        inner_width_m: wanted.inner_width_m,
        outer_width_m: wanted.outer_width_m,
        edge_steepness_per_m: [steepness(wanted.inner_width_m), steepness(wanted.outer_width_m)],
        edge_exponent,
        avoidance: match wanted.avoidance {
            scenario::Avoidance::Tangential => Avoidance::Tangential,
            scenario::Avoidance::Full => Avoidance::Full,
        },
        avoid_distance: match wanted.avoid_distance_m {
            scenario::AvoidDistance::Adaptive => AvoidDistance::Adaptive,
            scenario::AvoidDistance::Fixed(distance_m) => AvoidDistance::Fixed(distance_m),
        },
        circulation: wanted.circulation,
    }
}
