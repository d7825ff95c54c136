//! From where everybody is to where this vehicle should go.
//!
//! A [`law`](law::Law) sees its own place, the live members as last heard, and the goal. It answers a dimensionless field, a
//! way to go, or a velocity. Each becomes a velocity, the field's by [`mod@conversion`]; that passes the safety filter, and is the
//! setpoint's relative velocity.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`law`], [`laws`] | what a law is; which there are |
//! | [`mod@ring`], `olfati_saber`, `vasarhelyi`, `virtual_structure`, `displacement_consensus` | the laws |
//! | [`slots`] | patterns of places |
//! | [`external`] | the law that is another program |
//! | [`mod@conversion`], [`vertical`], [`safety`] | what they share: from a wish to a setpoint |

pub mod conversion;
pub mod external;
pub mod law;
pub mod laws;
pub mod ring;
pub mod safety;
pub mod slots;
pub mod vertical;

mod displacement_consensus;
mod olfati_saber;
mod vasarhelyi;
mod virtual_structure;

use alloc::boxed::Box;
use alloc::string::String;
use alloc::vec::Vec;

use nalgebra::{Vector2, Vector3};
use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::{Happening, LawNumber};
use skein_common::scenario::{self, Scenario};
use skein_common::state::Standing;
use skein_common::time::PlantTime;

use crate::control::{Setpoint, VELOCITY_PER_ERROR_PER_S};
use crate::estimate::Estimate;
use crate::mission::{self, Task};
use crate::peers::{Others, Role, Seen};
use conversion::Conversion;
use external::{Ask, External};
use law::{Answer, Goal, Law, Neighbour, Obstacle, Sight, Wanted};
use safety::{Constraint, SafetyFilter};
use vertical::Heights;

pub use ring::of as ring;

/// The fastest that a place is flown to, relative to the centre, m/s: from 15 m away on.
const FASTEST_M_S: f64 = 7.5;
/// Farther above or below than this an obstacle is nobody's concern, m.
const OBSTACLE_REACH_M: f64 = 15.0;
/// Nearer than this two vehicles have no direction between them, m.
const COINCIDENT_M: f64 = 1e-3;

/// Why this program cannot fly a scenario, in one sentence.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct NotFlown(pub String);

/// Refuses a scenario in which a vehicle's formation cannot be made: to fly another one in its place would be worse than not
/// to fly.
///
/// # Errors
/// A law that this program does not know, or that refuses its parameters.
pub fn check(scenario: &Scenario) -> Result<(), NotFlown> {
    scenario.ids().try_for_each(|id| Formation::new(id, scenario).map(drop))
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

impl Wish {
    /// The altitude that the vehicle is asked to be at less its own, m.
    pub fn altitude_error_m(&self, estimate: &Estimate) -> f64 {
        self.setpoint.altitude_m - estimate.position.altitude_m()
    }
}

/// The formation stage of one vehicle.
#[derive(Clone, Debug)]
pub struct Formation {
    own: VehicleId,
    /// One for each different formation of the mission: steps with the same share the law and what it remembers.
    shapes: Vec<Shape>,
    /// Which of them each step of the mission flies.
    steps: Vec<usize>,
    /// If a step's law is another program.
    external: Option<External>,
    filter: Option<SafetyFilter>,
    heights: Heights,
    neighbours: Vec<Neighbour>,
    unseen: VehicleSet,
    obstacles: Vec<Obstacle>,
    constraints: Vec<Constraint>,
    is_restrained: bool,
    activations: u64,
}

/// What the formation is during steps of the mission.
#[derive(Clone, Debug)]
struct Shape {
    /// Or the fallback.
    law: Box<dyn Law>,
    is_external: bool,
    conversion: Conversion,
    filter: Option<SafetyFilter>,
    altitude_m: f64,
    vertical: Vertical,
    feedforward: bool,
    heading_rad: f64,
    radius_m: f64,
    gamma: f64,
}

#[derive(Clone, Copy, Debug)]
enum Vertical {
    Bands { step_m: f64 },
    Ellipsoid,
}

impl Shape {
    fn new(law: Box<dyn Law>, wanted: &scenario::Formation) -> Self {
        let filter = match wanted.safety_filter {
            scenario::SafetyFilter::None => None,
            scenario::SafetyFilter::Cbf => {
                Some(SafetyFilter { distance_m: wanted.safety_distance_m, rate_per_s: wanted.safety_rate_per_s })
            }
        };
        let vertical = match wanted.vertical {
            scenario::Vertical::Bands => Vertical::Bands { step_m: wanted.band_step_m },
            scenario::Vertical::Ellipsoid => Vertical::Ellipsoid,
        };
        Self {
            law,
            is_external: wanted.law == scenario::Law::External,
            conversion: conversion(wanted),
            filter,
            altitude_m: wanted.altitude_m,
            vertical,
            feedforward: wanted.feedforward,
            heading_rad: wanted.heading_rad(),
            radius_m: wanted.radius_m,
            gamma: wanted.gamma,
        }
    }
}

impl Formation {
    /// The formations of a scenario's mission, as vehicle `own` flies them.
    ///
    /// # Errors
    /// A law that this program does not fly, or not with these parameters.
    pub fn new(own: VehicleId, scenario: &Scenario) -> Result<Self, NotFlown> {
        let mut different: Vec<&scenario::Formation> = Vec::new();
        let (mut shapes, mut steps) = (Vec::new(), Vec::new());
        for scenario::Step { formation, .. } in &scenario.mission.steps {
            let known = different.iter().position(|known| *known == formation);
            steps.push(known.unwrap_or(shapes.len()));
            if known.is_none() {
                different.push(formation);
                let law = match formation.law {
                    scenario::Law::External => formation.external.fallback,
                    law => law,
                };
                let law = laws::make(scenario, &scenario::Formation { law, ..formation.clone() }, own)?;
                shapes.push(Shape::new(law, formation));
            }
        }
        Ok(Self {
            own,
            filter: shapes.first().and_then(|shape| shape.filter),
            external: shapes.iter().any(|shape| shape.is_external).then(|| External::new(&scenario.formation.external)),
            shapes,
            steps,
            heights: Heights::default(),
            neighbours: Vec::new(),
            unseen: VehicleSet::default(),
            obstacles: Vec::new(),
            constraints: Vec::new(),
            is_restrained: false,
            activations: 0,
        })
    }

    /// Members counted in the last step, the own vehicle included.
    pub fn live(&self) -> usize {
        self.neighbours.len() + self.unseen.len() + 1
    }

    /// How often the safety filter has stepped in; `None` without one.
    pub fn safety_activations(&self) -> Option<u64> {
        self.filter.map(|_| self.activations)
    }

    /// The time of the step that follows, and what an external law has answered.
    pub fn hear(&mut self, now: PlantTime, answer: Option<&external::Answer>) {
        if let Some(external) = &mut self.external {
            external.hear(now, answer);
        }
    }

    /// What the last step has to ask of an external law, and to tell of it.
    pub fn asked(&mut self, happened: &mut Vec<Happening>) -> Option<Ask> {
        self.external.as_mut().and_then(|external| external.asked(happened))
    }

    /// Asks that an external law has not answered; `None` without one.
    pub fn law_misses(&self) -> Option<u64> {
        self.external.as_ref().map(External::misses)
    }

    /// What an external law wants recorded.
    pub fn law_log(&self) -> &[LawNumber] {
        self.external.as_ref().map_or(&[], External::log)
    }

    /// What to fly now, `dt_s` after the last step. `None` when the task leaves the controls alone.
    pub fn step(&mut self, dt_s: f64, estimate: &Estimate, others: &Others<'_>, task: &Task) -> Option<Wish> {
        self.sort_out(estimate, others.seen);
        self.unseen = others.unseen;
        let above_missed_m = self.heights.above_missed(dt_s, others.flies_above);
        if let (Some(external), false) = (&mut self.external, matches!(task, Task::Formation(_))) {
            external.rest();
        }
        match task {
            Task::Wait | Task::Park | Task::Autorotate { .. } => None,
            Task::Formation(goal) => self.fly(dt_s, estimate, goal, above_missed_m),
            Task::Stay { at_ne_m, altitude_m, heading_rad, lands } => {
                let wanted_ne_m_s = (at_ne_m - estimate.position.horizontal()) * VELOCITY_PER_ERROR_PER_S;
                let feedforward_ne_m_s = Vector2::zeros();
                let relative_velocity_ne_m_s = self.restrain(estimate, wanted_ne_m_s, feedforward_ne_m_s);
                let risen_m = self.heights.risen_since_stay(above_missed_m, *lands);
                let altitude_m = altitude_m + risen_m;
                let heading_rad = *heading_rad;
                let setpoint = Setpoint { relative_velocity_ne_m_s, feedforward_ne_m_s, altitude_m, heading_rad };
                Some(Wish { field_ne: Vector2::zeros(), setpoint, in_place: false })
            }
        }
    }

    /// The law of the goal's step.
    fn fly(&mut self, dt_s: f64, estimate: &Estimate, goal: &mission::Goal, above_missed_m: f64) -> Option<Wish> {
        let shape = self.shapes.get_mut(*self.steps.get(goal.step)?)?;
        self.heights.end_stay();
        let level_m = shape.altitude_m + above_missed_m;
        let mission::Goal { step, centre_ne_m, centre_velocity_ne_m_s, heading_rad } = *goal;
        let sight = Sight {
            own: self.own,
            position: estimate.position,
            velocity: estimate.velocity,
            heading_rad: estimate.attitude.heading_rad,
            neighbours: &self.neighbours,
            unseen: self.unseen,
            obstacles: &self.obstacles,
            goal: Goal {
                step,
                centre: PositionNed::new(centre_ne_m.x, centre_ne_m.y, -level_m),
                centre_velocity: VelocityNed::new(centre_velocity_ne_m_s.x, centre_velocity_ne_m_s.y, 0.0),
                heading_rad: shape.heading_rad,
                radius_m: shape.radius_m,
                gamma: shape.gamma,
            },
            dt_s,
        };
        let consulted = match &mut self.external {
            Some(external) if shape.is_external => external.consult(&sight),
            Some(external) => {
                external.rest();
                None
            }
            None => None,
        };
        let Answer { wanted, is_there } = consulted.map_or_else(|| shape.law.ask(&sight), |consulted| consulted.answer);
        let heading_rad = consulted.and_then(|consulted| consulted.heading_rad).unwrap_or(heading_rad);
        let (rank, live) = (sight.rank(), sight.live());
        let feedforward_ne_m_s = if shape.feedforward { centre_velocity_ne_m_s } else { Vector2::zeros() };
        let mut field = Vector3::zeros();
        let mut climb_m_s = None;
        let wanted_ne_m_s = match wanted.sane() {
            Wanted::Field(wanted) => {
                field = wanted;
                shape.conversion.velocity_ne_m_s(field.xy())
            }
            Wanted::Way(way_ne_m) => (way_ne_m * VELOCITY_PER_ERROR_PER_S).cap_magnitude(FASTEST_M_S),
            Wanted::Velocity { ne_m_s, down_m_s } => {
                climb_m_s = down_m_s.map(|down_m_s| -down_m_s);
                (ne_m_s - feedforward_ne_m_s).cap_magnitude(FASTEST_M_S)
            }
        };
        let altitude_m = match (climb_m_s, shape.vertical) {
            (Some(climb_m_s), _) => self.heights.climbing(dt_s, level_m, climb_m_s, estimate),
            (None, Vertical::Bands { step_m }) => self.heights.in_band(dt_s, level_m, step_m, rank, live),
            (None, Vertical::Ellipsoid) => self.heights.on_surface(dt_s, level_m, -field.z, estimate),
        };
        self.filter = shape.filter;
        let relative_velocity_ne_m_s = self.restrain(estimate, wanted_ne_m_s, feedforward_ne_m_s);
        let setpoint = Setpoint { relative_velocity_ne_m_s, feedforward_ne_m_s, altitude_m, heading_rad };
        let wish = Wish { field_ne: field.xy(), setpoint, in_place: false };
        Some(Wish { in_place: is_there && wish.altitude_error_m(estimate).abs() < mission::AT_ALTITUDE_M, ..wish })
    }

    /// The relative velocity after the safety filter, feed-forward included; the wanted one, if that keeps all distances.
    fn restrain(
        &mut self,
        estimate: &Estimate,
        wanted_ne_m_s: Vector2<f64>,
        feedforward_ne_m_s: Vector2<f64>,
    ) -> Vector2<f64> {
        let Some(filter) = self.filter else { return wanted_ne_m_s };
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
        let restrained = filter.restrain(wanted_ne_m_s.cap_magnitude(FASTEST_M_S), &self.constraints);
        self.activations += u64::from(restrained.is_some() && !self.is_restrained);
        self.is_restrained = restrained.is_some();
        restrained.unwrap_or(wanted_ne_m_s)
    }

    /// Tells members from obstacles.
    fn sort_out(&mut self, estimate: &Estimate, peers: &[Seen]) {
        self.neighbours.clear();
        self.obstacles.clear();
        for &Seen { id, position, velocity, heading_rad, carried_s, standing, role, .. } in peers {
            match role {
                Role::Member => {
                    let is_fresh = standing == Standing::Fresh;
                    let age_s = carried_s;
                    self.neighbours.push(Neighbour { id, position, velocity, heading_rad, age_s, is_fresh });
                }
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

#[cfg(test)]
mod point_mass;
#[cfg(test)]
mod tests;
