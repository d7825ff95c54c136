//! From where everybody is to where this vehicle should go.
//!
//! A law gives a dimensionless field, [`conversion`] makes metres of it. A law sees its own place, the live members as last
//! heard, and the goal: nothing else, so that it can be moved to any vehicle and any swarm.

pub mod conversion;
pub mod ring;
pub mod safety;

use nalgebra::Vector2;
use skein_common::id::VehicleId;
use skein_common::scenario;

use crate::control::{Setpoint, VELOCITY_PER_ERROR};
use crate::estimate::Estimate;
use crate::mission::Task;
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
}

/// The formation stage of one vehicle.
#[derive(Clone, Debug)]
pub struct Formation {
    own: VehicleId,
    ring: Ring,
    conversion: Conversion,
    filter: Option<SafetyFilter>,
    neighbours: Vec<Neighbour>,
    obstacles: Vec<Obstacle>,
    constraints: Vec<Constraint>,
    is_restrained: bool,
    activations: u64,
}

impl Formation {
    /// The formation of a scenario, as vehicle `own` flies it.
    pub fn new(own: VehicleId, wanted: &scenario::Formation) -> Self {
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
        Self {
            own,
            ring: ring(wanted),
            conversion,
            filter,
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

    /// What to fly now. `None` when the task leaves the controls alone.
    pub fn step(&mut self, estimate: &Estimate, peers: &[Seen], task: &Task) -> Option<Wish> {
        self.sort_out(estimate, peers);
        let own_ne_m = estimate.position.horizontal();
        let feedforward_ne_m_s = Vector2::zeros();
        match *task {
            Task::Wait | Task::Park => None,
            Task::Formation { centre_ne_m, altitude_m, heading_rad } => {
                let field_ne = self.ring.field_ne(self.own, own_ne_m, centre_ne_m, &self.neighbours, &self.obstacles);
                let error_ne_m = self.restrain(own_ne_m, self.conversion.error_ne_m(field_ne));
                Some(Wish { field_ne, setpoint: Setpoint { error_ne_m, feedforward_ne_m_s, altitude_m, heading_rad } })
            }
            Task::Stay { at_ne_m, altitude_m, heading_rad } => {
                let error_ne_m = self.restrain(own_ne_m, at_ne_m - own_ne_m);
                let setpoint = Setpoint { error_ne_m, feedforward_ne_m_s, altitude_m, heading_rad };
                Some(Wish { field_ne: Vector2::zeros(), setpoint })
            }
        }
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
