//! From where everybody is to where this vehicle should go.
//!
//! A law sees its own place, the live members as last heard, and the goal: nothing else, so that it can be moved to any
//! vehicle and any swarm. Ring and flock give a dimensionless field, of which [`mod@conversion`] makes metres; the virtual
//! structure gives the way to a slot. What comes out of either passes the safety filter.

pub mod conversion;
pub mod ring;
pub mod safety;
pub mod structure;
pub mod vertical;

use nalgebra::{Vector2, Vector3};
use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::VehicleId;
use skein_common::scenario::{self, Scenario};

use crate::control::{Setpoint, VELOCITY_PER_ERROR};
use crate::estimate::Estimate;
use crate::mission::{Goal, Task};
use crate::peers::{Role, Seen};
use conversion::Conversion;
use ring::{AvoidDistance, Avoidance, COINCIDENT_M, Region, Ring};
use safety::{Constraint, SafetyFilter};
use structure::Structure;
use vertical::Heights;

/// Beyond this error the vehicle controller flies no faster, m.
const FASTEST_M: f64 = 15.0;
/// Farther above or below than this an obstacle is nobody's concern, m.
const OBSTACLE_REACH_M: f64 = 15.0;

/// Another live member.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// Who.
    pub id: VehicleId,
    /// Its place now.
    pub position: PositionNed,
    /// As last heard.
    pub velocity: VelocityNed,
}

/// Something to keep away from that is no member.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Obstacle {
    /// Whose place it is.
    pub id: VehicleId,
    /// Where it is thought to be.
    pub position: PositionNed,
    /// How far around that it may be, m.
    pub radius_m: f64,
}

/// What the formation wants of this vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wish {
    /// The field V, north and east, dimensionless; zero where no law is asked, or one that has none.
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
    heights: Heights,
    neighbours: Vec<Neighbour>,
    obstacles: Vec<Obstacle>,
    constraints: Vec<Constraint>,
    is_restrained: bool,
    activations: u64,
}

/// What the formation is during one step of the mission.
#[derive(Clone, Copy, Debug)]
struct Shape {
    law: Law,
    filter: Option<SafetyFilter>,
    altitude_m: f64,
    vertical: Vertical,
    feedforward: bool,
}

#[derive(Clone, Copy, Debug)]
enum Law {
    Field(Ring, Conversion),
    Slots(Structure),
}

#[derive(Clone, Copy, Debug)]
enum Vertical {
    Bands { step_m: f64 },
    Ellipsoid,
}

/// What a law wants of a vehicle.
struct Wanted {
    /// NED.
    field: Vector3<f64>,
    error_ne_m: Vector2<f64>,
    /// Where the law wants it.
    is_there: bool,
}

impl Shape {
    fn new(wanted: &scenario::Formation) -> Self {
        let filter = match wanted.safety_filter {
            scenario::SafetyFilter::None => None,
            scenario::SafetyFilter::Cbf => {
                Some(SafetyFilter { distance_m: wanted.safety_distance_m, rate_per_s: wanted.safety_rate_per_s })
            }
        };
        let law = match wanted.law {
            scenario::Law::VirtualStructure => Law::Slots(Structure {
                radius_m: wanted.radius_m,
                gamma: wanted.gamma,
                heading_rad: wanted.heading_rad(),
            }),
            _ => Law::Field(ring(wanted), conversion(wanted)),
        };
        let vertical = match wanted.vertical {
            scenario::Vertical::Bands => Vertical::Bands { step_m: wanted.band_step_m },
            scenario::Vertical::Ellipsoid => Vertical::Ellipsoid,
        };
        Self { law, filter, altitude_m: wanted.altitude_m, vertical, feedforward: wanted.feedforward }
    }
}

impl Law {
    /// For vehicle `own` at `place`, with the formation's centre at `centre`.
    fn ask(
        &self,
        own: VehicleId,
        place: PositionNed,
        centre: PositionNed,
        neighbours: &[Neighbour],
        obstacles: &[Obstacle],
    ) -> Wanted {
        match self {
            Self::Field(ring, conversion) => {
                let field = ring.field(own, place, centre, neighbours, obstacles);
                let is_calm = ring.region == Region::Inside || field.norm() < IN_PLACE_FIELD;
                let is_there = is_calm && ring.holds(place - centre);
                Wanted { field, error_ne_m: conversion.error_ne_m(field.xy()), is_there }
            }
            Self::Slots(structure) => {
                let slot_ne_m = structure.slot_ne_m(rank(own, neighbours), neighbours.len() + 1);
                // v = 0.5 (slot − p) + the centre's velocity; the vehicle controller asks for half its error, plus that.
                let way_ne_m = centre.horizontal() + slot_ne_m - place.horizontal();
                let is_there = structure.is_in_slot(way_ne_m);
                Wanted { field: Vector3::zeros(), error_ne_m: way_ne_m.cap_magnitude(FASTEST_M), is_there }
            }
        }
    }
}

/// Place in the order of all live ids, from 0.
fn rank(own: VehicleId, neighbours: &[Neighbour]) -> usize {
    neighbours.iter().filter(|neighbour| neighbour.id < own).count()
}

impl Formation {
    /// The formations of a scenario's mission, as vehicle `own` flies them.
    pub fn new(own: VehicleId, scenario: &Scenario) -> Self {
        let shapes: Vec<_> = scenario.mission.steps.iter().map(|step| Shape::new(&step.formation)).collect();
        Self {
            own,
            filter: shapes.first().and_then(|shape| shape.filter),
            shapes,
            heights: Heights::default(),
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
        let lowest = self.neighbours.iter().map(|neighbour| neighbour.id).fold(self.own, VehicleId::min);
        let is_above = peers.iter().any(|peer| peer.is_missed && peer.id < lowest);
        let above_missed_m = self.heights.above_missed(dt_s, is_above);
        match task {
            Task::Wait | Task::Park | Task::ComeDown { .. } => None,
            Task::Formation(goal) => self.fly(dt_s, estimate, goal, above_missed_m),
            Task::Stay { at_ne_m, altitude_m, heading_rad, lands } => {
                let wanted_m = at_ne_m - estimate.position.horizontal();
                let feedforward_ne_m_s = Vector2::zeros();
                let error_ne_m = self.restrain(estimate, wanted_m, feedforward_ne_m_s);
                let altitude_m = altitude_m + if *lands { 0.0 } else { above_missed_m };
                let heading_rad = *heading_rad;
                let setpoint = Setpoint { error_ne_m, feedforward_ne_m_s, altitude_m, heading_rad };
                Some(Wish { field_ne: Vector2::zeros(), setpoint, in_place: false })
            }
        }
    }

    /// The law of the goal's step.
    fn fly(&mut self, dt_s: f64, estimate: &Estimate, goal: &Goal, above_missed_m: f64) -> Option<Wish> {
        let shape = *self.shapes.get(goal.step)?;
        let level_m = shape.altitude_m + above_missed_m;
        let Goal { centre_ne_m, centre_velocity_ne_m_s, heading_rad, .. } = *goal;
        let centre = PositionNed::new(centre_ne_m.x, centre_ne_m.y, -level_m);
        let wanted = shape.law.ask(self.own, estimate.position, centre, &self.neighbours, &self.obstacles);
        let altitude_m = match shape.vertical {
            Vertical::Bands { step_m } => {
                let (rank, live) = (rank(self.own, &self.neighbours), self.neighbours.len() + 1);
                self.heights.in_band(dt_s, level_m, step_m, rank, live)
            }
            Vertical::Ellipsoid => self.heights.on_surface(dt_s, level_m, -wanted.field.z, estimate),
        };
        self.filter = shape.filter;
        let feedforward_ne_m_s = if shape.feedforward { centre_velocity_ne_m_s } else { Vector2::zeros() };
        let error_ne_m = self.restrain(estimate, wanted.error_ne_m, feedforward_ne_m_s);
        let setpoint = Setpoint { error_ne_m, feedforward_ne_m_s, altitude_m, heading_rad };
        let is_slow = (estimate.velocity.horizontal() - centre_velocity_ne_m_s).norm() < IN_PLACE_M_S;
        let wish = Wish { field_ne: wanted.field.xy(), setpoint, in_place: false };
        Some(Wish { in_place: wanted.is_there && is_slow && wish.is_at_altitude(estimate), ..wish })
    }

    /// The error with which nobody is come too near, for what it and the feed-forward together make the vehicle fly; the
    /// wanted error, if that does it.
    fn restrain(
        &mut self,
        estimate: &Estimate,
        wanted_m: Vector2<f64>,
        feedforward_ne_m_s: Vector2<f64>,
    ) -> Vector2<f64> {
        let Some(filter) = self.filter else { return wanted_m };
        let beside = |position: PositionNed| (estimate.position - position).z.abs() < filter.distance_m;
        let members = self.neighbours.iter().filter(|member| beside(member.position));
        let members = members.map(|member| (member.position, member.velocity.horizontal(), 0.0));
        // Nobody counts on an obstacle to move away.
        let obstacles = self.obstacles.iter().map(|it| (it.position, Vector2::zeros(), it.radius_m));
        self.constraints.clear();
        for (position, velocity_ne_m_s, clear_m) in members.chain(obstacles) {
            let from_other_m = estimate.position - position;
            // Two at the very same place are parted by the law.
            if from_other_m.xy().norm_squared() > COINCIDENT_M * COINCIDENT_M {
                let constraint = filter.constraint(from_other_m, clear_m);
                self.constraints.push(constraint.relative(feedforward_ne_m_s, velocity_ne_m_s));
            }
        }
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
        for &Seen { id, position, velocity, role, .. } in peers {
            match role {
                Role::Member => self.neighbours.push(Neighbour { id, position, velocity }),
                Role::Obstacle { radius_m } => {
                    if (position - estimate.position).z.abs() < OBSTACLE_REACH_M {
                        self.obstacles.push(Obstacle { id, position, radius_m });
                    }
                }
                Role::Nothing => {}
            }
        }
    }
}

/// The conversion of a scenario.
fn conversion(wanted: &scenario::Formation) -> Conversion {
    match wanted.conversion {
        scenario::Conversion::Linear => Conversion::Linear { gain_m: wanted.gain_m },
        scenario::Conversion::Nonlinear => {
            Conversion::Nonlinear { gain_m: wanted.gain_m, far_gain_m: wanted.far_gain_m, knee: wanted.gain_knee }
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
        gamma_z: (wanted.vertical == scenario::Vertical::Ellipsoid).then_some(wanted.gamma_z),
        heading_rad: wanted.heading_rad(),
        region: if wanted.law == scenario::Law::Flock { Region::Inside } else { Region::Band },
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

#[cfg(test)]
mod tests;
