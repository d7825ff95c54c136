//! The formation stage: computes this vehicle's setpoint from its own estimate, the peers' states and the mission's
//! goal.
//!
//! A [`law`](law::Law) observes the vehicle's own position, the live members as last received, and the goal. It returns
//! a dimensionless field, a displacement or a velocity. The stage converts each to a velocity (a field by
//! [`mod@conversion`]); after the safety filter this is the setpoint's relative velocity.
//!
//! | module | contents |
//! | --- | --- |
//! | [`law`], [`laws`] | the interface of a law, and the known laws |
//! | [`mod@ring`], `olfati_saber`, `vasarhelyi`, `virtual_structure`, `displacement_consensus` | the laws |
//! | [`slots`] | patterns of slots |
//! | [`external`] | a law that runs in another program |
//! | [`mod@conversion`], [`vertical`], [`safety`], [`airspace`] | shared steps from a law's output to the setpoint |
//! | [`room`] | whether the area of a flock has room for all vehicles |

pub mod airspace;
pub mod conversion;
pub mod external;
pub mod law;
pub mod laws;
pub mod ring;
pub mod room;
pub mod safety;
pub mod slots;
pub mod vertical;

mod displacement_consensus;
mod olfati_saber;
mod output;
mod vasarhelyi;
mod virtual_structure;

use alloc::boxed::Box;
use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;
use core::ops::RangeInclusive;

use nalgebra::{Vector2, Vector3};
use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::EventKind;
use skein_common::scenario::{self, Scenario, Vertical};
use skein_common::state::PeerStatus;
use skein_common::time::PlantTime;

use crate::estimate::Estimate;
use crate::mission::{self, Task};
use crate::peers::{FRESH_S, MAX_OBSTACLE_RADIUS_M, PeerEstimate, PeerSummary, Role};
use crate::setpoint::{Setpoint, VELOCITY_PER_ERROR_PER_S};
use crate::strangers::{self, MovingObstacle};
use airspace::Airspace;
use conversion::Conversion;
use external::{External, LawQuery};
use law::{Goal, Law, LawCommand, LawOutput, Neighbour, Observation, Obstacle};
use safety::{Constraint, SafetyFilter};
use vertical::Heights;

pub use output::FormationOutput;
pub use ring::of as ring;

/// Largest commanded speed relative to the centre, m/s: the speed for a displacement of 15 m or more.
const FASTEST_M_S: f64 = 7.5;
/// Speed above which an obstacle of known velocity counts as moving, m/s: one that hovers or lands does not.
const MOVES_ABOVE_M_S: f64 = 1.0;
/// Vertical distance beyond which an obstacle is ignored, m.
const OBSTACLE_REACH_M: f64 = 15.0;
/// Two vehicles nearer than this have no defined direction between them, m.
const COINCIDENT_M: f64 = 1e-3;

/// The reason why this program cannot fly a scenario, as one sentence.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct UnsupportedScenario(pub String);

/// Checks that every vehicle's formation can be built. A scenario that fails is refused: flying another formation
/// instead would be worse than not flying.
///
/// # Errors
/// A law that this program does not know, or that refuses its parameters.
pub fn check(scenario: &Scenario) -> Result<(), UnsupportedScenario> {
    scenario.ids().try_for_each(|id| Formation::new(id, scenario).map(drop))
}

/// Checks that the mission stays in the airspace of the scenario.
///
/// # Errors
/// The first step that leaves it, and the remedy.
pub fn check_airspace(scenario: &Scenario) -> Result<(), UnsupportedScenario> {
    let extent_m = |formation: &scenario::Formation| extent_m(formation, scenario.swarm.vehicles);
    airspace::check(scenario, extent_m).map_err(UnsupportedScenario)
}

/// Checks that a team of a fleet does not need more room than before: the teams keep their areas apart as they were written.
///
/// # Errors
/// The first step that needs more room.
pub fn check_area_of_team(written: &Scenario, tuned: &Scenario) -> Result<(), UnsupportedScenario> {
    if written.team.is_none() {
        return Ok(());
    }
    let room = |scenario: &Scenario, step: &scenario::Step| {
        (
            extent_m(&step.formation, scenario.swarm.vehicles),
            step.formation.half_height_m(scenario.swarm.vehicles),
            step.formation.altitude_m,
        )
    };
    for (nth, (before, after)) in written.mission.steps.iter().zip(&tuned.mission.steps).enumerate() {
        let ((before_m, before_half_m, before_altitude_m), (after_m, after_half_m, after_altitude_m)) =
            (room(written, before), room(tuned, after));
        if after_m > before_m || after_half_m > before_half_m || after_altitude_m != before_altitude_m {
            return Err(UnsupportedScenario(format!(
                "step {nth} would leave the area of {before_m} m around its centre that the other teams know"
            )));
        }
    }
    Ok(())
}

/// The formation stage of one vehicle.
#[derive(Clone, Debug)]
pub struct Formation {
    own: VehicleId,
    /// One entry per distinct formation of the mission: steps with the same formation share the law and its memory.
    shapes: Vec<Shape>,
    /// Index into `shapes` for each step of the mission.
    steps: Vec<usize>,
    /// The external law, if a step uses one.
    pub(crate) external: Option<External>,
    filter: Option<SafetyFilter>,
    /// `None` if nothing limits it.
    airspace: Option<Airspace>,
    /// Largest speed of a centre on its path in the mission, m/s.
    fastest_centre_m_s: f64,
    heights: Heights,
    /// The mission step that was last flown, counted from 0.
    step: usize,
    /// The position at which the vehicle waits until it has climbed above another partition, north and east of the centre, m;
    /// `None` while it does not wait.
    waits_at_ne_m: Option<Vector2<f64>>,
    /// All other live members.
    members: VehicleSet,
    is_restrained: bool,
    activations: u64,
}

/// Memory in which a step works and from which the next one takes nothing: agents that step one after the other share it.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    neighbours: Vec<Neighbour>,
    obstacles: Vec<Obstacle>,
    /// The strangers, and those of the obstacles that move: position, velocity, uncertainty of the position, m.
    moving: Vec<(PositionNed, VelocityNed, f64)>,
    constraints: Vec<Constraint>,
}

/// The formation of one or more steps of the mission.
#[derive(Clone, Debug)]
struct Shape {
    /// The law, or the fallback of an external law.
    law: Box<dyn Law>,
    /// The number of live members when the law's reach was last asked, and that reach, m.
    reach: Option<(usize, f64)>,
    conversion: Conversion,
    filter: Option<SafetyFilter>,
    settings: scenario::Formation,
}

impl Shape {
    fn new(law: Box<dyn Law>, settings: &scenario::Formation) -> Self {
        let filter = match settings.safety_filter {
            scenario::SafetyFilter::None => None,
            scenario::SafetyFilter::Cbf => {
                Some(SafetyFilter { distance_m: settings.safety_distance_m, rate_per_s: settings.safety_rate_per_s })
            }
        };
        Self { law, reach: None, conversion: Conversion::of(settings), filter, settings: settings.clone() }
    }

    fn is_external(&self) -> bool {
        self.settings.law == scenario::Law::External
    }
}

impl Formation {
    /// The formations of a scenario's mission for vehicle `own`.
    ///
    /// # Errors
    ///
    /// A law that this program does not know, or that refuses its parameters.
    pub fn new(own: VehicleId, scenario: &Scenario) -> Result<Self, UnsupportedScenario> {
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
            external: shapes.iter().any(Shape::is_external).then(|| External::new(&scenario.formation.external)),
            airspace: (!scenario.airspace.is_unlimited()).then(|| Airspace::new(&scenario.airspace)),
            shapes,
            steps,
            fastest_centre_m_s: scenario.mission.steps.iter().map(|step| step.speed_m_s).fold(0.0, f64::max),
            heights: Heights::default(),
            step: 0,
            waits_at_ne_m: None,
            members: VehicleSet::default(),
            is_restrained: false,
            activations: 0,
        })
    }

    /// Flies the formations of this scenario from now on, which differs from the present one in values that can change in
    /// flight. A law with a memory begins anew. Values that a law refuses on the way to those that it accepts are left out.
    pub fn change(&mut self, scenario: &Scenario) {
        if let Ok(Self { shapes, steps, .. }) = Self::new(self.own, scenario) {
            (self.shapes, self.steps) = (shapes, steps);
        }
    }

    /// Number of live members in the last step, including this vehicle.
    pub fn live(&self) -> usize {
        self.members.len() + 1
    }

    /// Number of times the safety filter changed the velocity; `None` without a filter.
    pub fn safety_activations(&self) -> Option<u64> {
        self.filter.map(|_| self.activations)
    }

    /// Sets the time of the next step and takes the reply of an external law, if there is one.
    pub fn receive_reply(&mut self, now: PlantTime, answer: Option<&external::LawReply>) {
        if let Some(external) = &mut self.external {
            external.receive_reply(now, answer);
        }
    }

    /// Takes the query to an external law after a step, and adds the stage's events to `happened`.
    pub fn take_query(&mut self, happened: &mut Vec<EventKind>) -> Option<Box<LawQuery>> {
        self.external.as_mut().and_then(|external| external.take_query(happened)).map(Box::new)
    }

    /// Distance beyond which no peer affects the output for this task among `live` members, m.
    pub fn reach_m(&mut self, task: &Task, live: usize) -> f64 {
        let filter_m = |filter: Option<SafetyFilter>, feedforward_m_s: f64| {
            filter.map_or(0.0, |filter| filter.reach_m(FASTEST_M_S + feedforward_m_s, MAX_OBSTACLE_RADIUS_M))
        };
        match task {
            Task::Wait | Task::Release | Task::Park | Task::Autorotate { .. } => 0.0,
            Task::Stay { .. } => filter_m(self.filter, 0.0),
            Task::Formation(goal) => {
                let shape = self.steps.get(goal.step).and_then(|&nth| self.shapes.get_mut(nth));
                let Some(shape) = shape else { return 0.0 };
                let feedforward_m_s = if shape.settings.feedforward { goal.centre_velocity_ne_m_s.norm() } else { 0.0 };
                let law_m = match shape.reach {
                    Some((members, reach_m)) if members == live => reach_m,
                    // Another program gets all members.
                    _ if shape.is_external() => f64::INFINITY,
                    _ => shape.law.reach_m(live),
                };
                shape.reach = Some((live, law_m));
                law_m.max(filter_m(shape.filter, feedforward_m_s))
            }
        }
    }

    /// Distance beyond which no stranger affects the output for this task, m; zero without a safety filter.
    pub fn strangers_reach_m(&self, task: &Task) -> f64 {
        let feedforward_m_s = match task {
            Task::Wait | Task::Release | Task::Park | Task::Autorotate { .. } => return 0.0,
            Task::Stay { .. } => 0.0,
            Task::Formation(goal) => goal.centre_velocity_ne_m_s.norm(),
        };
        // A vehicle that ensures the whole rate alone has twice the rate: half the speed at the same distance.
        let closing_m_s = FASTEST_M_S + feedforward_m_s + strangers::FASTEST_M_S;
        self.filter.map_or(0.0, |filter| filter.reach_m(closing_m_s / 2.0, filter.distance_m))
    }

    /// Distance beyond which no stranger affects the output in any step of the mission, m.
    pub fn longest_strangers_reach_m(&self) -> f64 {
        let closing_m_s = FASTEST_M_S + self.fastest_centre_m_s + strangers::FASTEST_M_S;
        let filters = self.shapes.iter().filter_map(|shape| shape.filter).chain(self.filter);
        filters.map(|filter| filter.reach_m(closing_m_s / 2.0, filter.distance_m)).fold(0.0, f64::max)
    }

    /// The formation's output `dt_s` after the last step, with these peers and strangers near this vehicle; `None` if the task
    /// does not use the vehicle controller's setpoint.
    pub fn step(
        &mut self,
        dt_s: f64,
        estimate: &Estimate,
        (others, strangers): (PeerSummary<impl Iterator<Item = PeerEstimate>>, impl Iterator<Item = MovingObstacle>),
        task: &Task,
        workspace: &mut Workspace,
    ) -> Option<FormationOutput> {
        workspace.moving.clear();
        workspace.moving.extend(strangers.map(|it| (it.position, it.velocity, it.uncertainty_m)));
        workspace.split_peers(estimate, others.near);
        self.members = others.members;
        if let Task::Formation(goal) = task {
            self.step = goal.step;
        }
        let own_m = match task {
            Task::Formation(_) => self.altitude_m(self.step).inspect(|altitude_m| self.heights.begin_step(*altitude_m)),
            Task::Stay { altitude_m, lands: false, .. } => Some(self.heights.stay_without_rise_m(*altitude_m)),
            _ => None,
        };
        // All steps are looked at only while there is another partition.
        let altitudes_m = if others.flies_above { own_m.zip(self.possible_m()) } else { None };
        let partition_rise_m = self.heights.partition_rise(dt_s, others.flies_above, altitudes_m);
        if let (Some(external), false) = (&mut self.external, matches!(task, Task::Formation(_))) {
            external.suspend();
        }
        match task {
            Task::Wait | Task::Release | Task::Park | Task::Autorotate { .. } => None,
            Task::Formation(goal) => self.fly(dt_s, estimate, goal, partition_rise_m, workspace),
            Task::Stay { at_ne_m, altitude_m, heading_rad, lands } => {
                self.waits_at_ne_m = None;
                let command_ne_m_s = (at_ne_m - estimate.position.horizontal()) * VELOCITY_PER_ERROR_PER_S;
                let feedforward_ne_m_s = Vector2::zeros();
                let relative_velocity_ne_m_s = self.restrain(estimate, command_ne_m_s, feedforward_ne_m_s, workspace);
                let risen_m = self.heights.risen_since_stay(partition_rise_m, *lands);
                let altitude_m = altitude_m + risen_m;
                let altitude_m = if *lands { altitude_m } else { self.in_airspace_m(altitude_m, estimate) };
                let heading_rad = *heading_rad;
                let setpoint = Setpoint { relative_velocity_ne_m_s, feedforward_ne_m_s, altitude_m, heading_rad };
                Some(FormationOutput { field_ne: Vector2::zeros(), command_ne_m_s, setpoint, in_place: false })
            }
        }
    }

    /// The output of the law of the goal's step.
    fn fly(
        &mut self,
        dt_s: f64,
        estimate: &Estimate,
        goal: &mission::MissionGoal,
        partition_rise_m: f64,
        workspace: &mut Workspace,
    ) -> Option<FormationOutput> {
        let shape = self.shapes.get_mut(*self.steps.get(goal.step)?)?;
        self.heights.end_stay();
        let level_m = shape.settings.altitude_m + partition_rise_m;
        let mission::MissionGoal { step, centre_ne_m, centre_velocity_ne_m_s, heading_rad } = *goal;
        let observation = Observation {
            own: self.own,
            position: estimate.position,
            velocity: estimate.velocity,
            heading_rad: estimate.attitude.heading_rad,
            neighbours: &workspace.neighbours,
            members: self.members,
            obstacles: &workspace.obstacles,
            goal: Goal {
                step,
                centre: PositionNed::new(centre_ne_m.x, centre_ne_m.y, -level_m),
                centre_velocity: VelocityNed::new(centre_velocity_ne_m_s.x, centre_velocity_ne_m_s.y, 0.0),
                heading_rad: shape.settings.heading_rad(),
                radius_m: shape.settings.radius_m,
                gamma: shape.settings.gamma,
            },
            dt_s,
        };
        let external_output = match &mut self.external {
            Some(external) if shape.is_external() => external.output(&observation),
            Some(external) => {
                external.suspend();
                None
            }
            None => None,
        };
        let (LawOutput { command, reached }, law_heading_rad) =
            external_output.unwrap_or_else(|| (shape.law.update(&observation), None));
        let heading_rad = law_heading_rad.unwrap_or(heading_rad);
        let (rank, live) = (observation.rank(), observation.live());
        let feedforward_ne_m_s = if shape.settings.feedforward { centre_velocity_ne_m_s } else { Vector2::zeros() };
        let mut field = Vector3::zeros();
        let mut climb_m_s = None;
        let command_ne_m_s = match command.sane() {
            LawCommand::Field(command) => {
                field = command;
                shape.conversion.velocity_ne_m_s(field.xy())
            }
            LawCommand::Displacement(displacement_ne_m) => {
                (displacement_ne_m * VELOCITY_PER_ERROR_PER_S).cap_magnitude(FASTEST_M_S)
            }
            LawCommand::Velocity { ne_m_s, down_m_s } => {
                climb_m_s = down_m_s.map(|down_m_s| -down_m_s);
                (ne_m_s - feedforward_ne_m_s).cap_magnitude(FASTEST_M_S)
            }
        };
        let altitude_m = match (climb_m_s, shape.settings.vertical) {
            (Some(climb_m_s), _) => self.heights.climbing(dt_s, level_m, climb_m_s, estimate),
            (None, Vertical::Bands) => self.heights.in_band(dt_s, level_m, shape.settings.band_step_m, rank, live),
            (None, Vertical::Ellipsoid) => self.heights.on_surface(dt_s, level_m, -field.z, estimate),
        };
        self.filter = shape.filter;
        let altitude_m = self.in_airspace_m(altitude_m, estimate);
        let from_centre_ne_m = estimate.position.horizontal() - centre_ne_m;
        let waits = self.heights.is_climbing_above(altitude_m, estimate);
        self.waits_at_ne_m = waits.then(|| self.waits_at_ne_m.unwrap_or(from_centre_ne_m));
        let command_ne_m_s = self.waits_at_ne_m.map_or(command_ne_m_s, |waits_at_ne_m| {
            ((waits_at_ne_m - from_centre_ne_m) * VELOCITY_PER_ERROR_PER_S).cap_magnitude(FASTEST_M_S)
        });
        let relative_velocity_ne_m_s = self.restrain(estimate, command_ne_m_s, feedforward_ne_m_s, workspace);
        let setpoint = Setpoint { relative_velocity_ne_m_s, feedforward_ne_m_s, altitude_m, heading_rad };
        let output = FormationOutput { field_ne: field.xy(), command_ne_m_s, setpoint, in_place: false };
        Some(FormationOutput {
            in_place: reached && !waits && output.altitude_error_m(estimate).abs() < mission::AT_ALTITUDE_M,
            ..output
        })
    }

    /// The altitude of the formation in this step, m.
    fn altitude_m(&self, step: usize) -> Option<f64> {
        self.shapes.get(*self.steps.get(step)?).map(|shape| shape.settings.altitude_m)
    }

    /// The altitudes at which another partition may be, m: it may be a step behind, and any number ahead.
    fn possible_m(&self) -> Option<RangeInclusive<f64>> {
        let all = || (self.step.saturating_sub(1)..self.steps.len()).filter_map(|step| self.altitude_m(step));
        Some(all().reduce(f64::min)?..=all().reduce(f64::max)?)
    }

    /// The altitude nearest to this one between the floors and the ceiling of the airspace, m.
    fn in_airspace_m(&self, altitude_m: f64, estimate: &Estimate) -> f64 {
        let Some(airspace) = &self.airspace else { return altitude_m };
        // No vehicle is below the ground: a wrong height raises it by the floor at most.
        let ground_m = estimate.position.altitude_m() - estimate.height_m.max(0.0);
        airspace.altitude_m(altitude_m, ground_m)
    }

    /// The relative velocity after the safety filter, feed-forward included; the commanded velocity if it keeps all
    /// distances.
    fn restrain(
        &mut self,
        estimate: &Estimate,
        command_ne_m_s: Vector2<f64>,
        feedforward_ne_m_s: Vector2<f64>,
        workspace: &mut Workspace,
    ) -> Vector2<f64> {
        let Some(filter) = self.filter else { return command_ne_m_s };
        let beside = |position: PositionNed| (estimate.position - position).z.abs() < filter.distance_m;
        let Workspace { neighbours, obstacles, moving, constraints } = workspace;
        let members = neighbours.iter().filter(|member| beside(member.position));
        let members = members.map(|member| (member.position, member.velocity.horizontal(), 0.0));
        // An obstacle is assumed to stay, so the vehicle keeps the distance alone. A moving one has another constraint below.
        let obstacles = obstacles.iter().map(|it| (it.position, Vector2::zeros(), it.radius_m));
        constraints.clear();
        for (position, velocity_ne_m_s, clear_m) in members.chain(obstacles) {
            let from_other_m = estimate.position - position;
            // Two vehicles at the same position are separated by the law.
            if from_other_m.xy().norm_squared() > COINCIDENT_M * COINCIDENT_M {
                let constraint = filter.constraint(from_other_m, clear_m);
                constraints.push(constraint.relative(feedforward_ne_m_s, velocity_ne_m_s));
            }
        }
        for (position, velocity, uncertainty_m) in moving.iter().copied() {
            let from_other_m = estimate.position - position;
            let clear_m = filter.distance_m + uncertainty_m;
            let is_apart = from_other_m.xy().norm_squared() > COINCIDENT_M * COINCIDENT_M;
            if is_apart && from_other_m.z.abs() < clear_m {
                let theirs_ne_m_s = velocity.horizontal();
                constraints.push(filter.constraint_alone(from_other_m, clear_m, theirs_ne_m_s, feedforward_ne_m_s));
            }
        }
        if let Some(airspace) = &self.airspace {
            constraints.extend(airspace.constraints(estimate.position, feedforward_ne_m_s));
        }
        let restrained = filter.restrain(command_ne_m_s.cap_magnitude(FASTEST_M_S), constraints);
        self.activations += u64::from(restrained.is_some() && !self.is_restrained);
        self.is_restrained = restrained.is_some();
        restrained.unwrap_or(command_ne_m_s)
    }
}

impl Workspace {
    /// Splits the peers into members and obstacles, and adds those of the obstacles that move to the strangers.
    fn split_peers(&mut self, estimate: &Estimate, peers: impl Iterator<Item = PeerEstimate>) {
        self.neighbours.clear();
        self.obstacles.clear();
        for PeerEstimate { id, position, velocity, heading_rad, carried_s, standing, role, .. } in peers {
            match role {
                Role::Member => {
                    let is_fresh = standing == PeerStatus::Fresh;
                    let age_s = carried_s;
                    self.neighbours.push(Neighbour { id, position, velocity, heading_rad, age_s, is_fresh });
                }
                Role::Obstacle { radius_m } => {
                    if (position - estimate.position).z.abs() < OBSTACLE_REACH_M {
                        self.obstacles.push(Obstacle { id, position, radius_m });
                        if standing == PeerStatus::Fresh && velocity.horizontal().norm() > MOVES_ABOVE_M_S {
                            let uncertainty_m = velocity.horizontal().norm() * carried_s.min(FRESH_S);
                            self.moving.push((position, velocity, uncertainty_m));
                        }
                    }
                }
                Role::Nothing => {}
            }
        }
    }
}

/// Distance from the formation's centre within which all vehicles of a swarm of this size fly, m.
pub fn extent_m(formation: &scenario::Formation, vehicles: usize) -> f64 {
    let is_circle = !formation.law.has_slots() || formation.slots.pattern == scenario::Pattern::Circle;
    if is_circle {
        let longest_m = formation.radius_m * (1.0 / formation.gamma.sqrt()).max(1.0);
        return longest_m + formation.outer_width_m;
    }
    let slots = slots::Slots::of(formation);
    (0..vehicles).map(|rank| slots.slot_ne_m(rank, vehicles).norm()).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests;
