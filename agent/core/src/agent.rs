//! The agent of one vehicle: [`Agent::step`] runs the control loop once, through the stages in the diagram of [`crate`].
//!
//! A step without a new measurement receives and sends messages but decides nothing: the mission gives no task, and
//! without a task there is neither a setpoint nor a new command.

mod records;
mod steady_clock;

use alloc::boxed::Box;
use alloc::vec::Vec;
use core::ops::Range;

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};
use skein_common::frame::{Attitude, Origin, PositionNed, VelocityNed};
use skein_common::id::{Incarnation, VehicleId, VehicleSet};
use skein_common::message::{Drops, EventKind, Failure, Order, StandingOrders};
use skein_common::scenario::{Scenario, Setting};
use skein_common::state::{Activity, Membership};
use skein_common::time::{LocalTime, Now};

use crate::aircraft::Aircraft;
use crate::control::{Controller, Rules, Trim};
use crate::diagnosis::Diagnosis;
use crate::estimate::{Estimate, Estimator};
use crate::failsafe::{Condition, Conditions, Response};
use crate::formation::external::{LawQuery, LawReply};
use crate::formation::{self, Formation, FormationOutput, UnsupportedScenario, Workspace};
use crate::intent::{Intents, ReceivedIntent};
use crate::mission::{Mission, Task, View};
use crate::outbox::{Outbox, SendSchedule};
use crate::pace::Pace;
use crate::peers::{Broadcast, Change, PeerEstimate, PeerStateAge, Peers, Received};
use crate::plant::{Command, Measurement, PeerPose, PlantStatus};
use crate::random::{self, Purpose};
use crate::strangers::{KnownStrangers, Strangers};
use crate::tuning::Tuning;
use records::LastStep;
use steady_clock::SteadyClock;

/// The inputs since the last step.
#[derive(Clone, Copy, Debug)]
pub struct Inputs<'a> {
    /// Time for which this agent did not run before this step because its computer is overloaded, s, if it was late.
    pub did_not_run_s: Option<f64>,
    /// The plant's report beside its frames.
    pub status: &'a PlantStatus,
    /// Measurement of the plant's new frame; `None` if none arrived in time.
    pub measurement: Option<&'a Measurement>,
    /// Messages received from peers and operators, in any order.
    pub received: &'a [Received],
    /// Messages that all vehicles of the swarm received alike.
    pub broadcast: Broadcast<'a>,
    /// The strangers known; `None` without a fleet.
    pub strangers: Option<KnownStrangers<'a>>,
    /// Intents received from vehicles of other teams, each with its time of arrival by the own clock without its jumps.
    pub intents: &'a [ReceivedIntent],
    /// Makes this vehicle land and leave the swarm, because its agent is about to end.
    pub leave: bool,
    /// Reply of an external law to the last query.
    pub answer: Option<&'a LawReply>,
}

/// The outputs of a step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outputs {
    /// The command to the plant; `None` leaves the last one unchanged.
    pub command: Option<Command>,
    /// The messages to send.
    pub outbox: Outbox,
    /// The query to an external law; its reply belongs to a later step.
    pub ask: Option<Box<LawQuery>>,
}

/// The core of one vehicle, without a clock, input, output or randomness other than its seed's. The same inputs give
/// bit-identical outputs.
#[derive(Clone, Debug)]
pub struct Agent {
    estimator: Estimator,
    diagnosis: Diagnosis,
    pub(crate) peers: Peers,
    strangers: Strangers,
    /// `None` if the swarm is not a team of a fleet.
    intents: Option<Box<Intents>>,
    mission: Mission,
    tuning: Tuning,
    formation: Formation,
    controller: Controller,
    schedule: SendSchedule,
    clock: SteadyClock,
    pace: Pace,
    last: LastStep,
}

/// The output of the estimate stage.
#[derive(Clone, Copy, Debug)]
struct OwnEstimate {
    /// Time of this step, with the clock's jumps removed.
    now: Now,
    clock_jumped: bool,
    /// The newest estimate, whatever its age.
    estimate: Option<Estimate>,
    /// The condition of the own data.
    condition: Option<Condition>,
    /// The estimate, if this step has a new measurement.
    new: Option<Estimate>,
    /// Plant time between the last two measurements, s; 0 before there are two.
    dt_s: f64,
}

impl Agent {
    /// The agent of vehicle `own` of a scenario.
    ///
    /// # Errors
    ///
    /// A scenario with a formation that this program cannot fly.
    pub fn new(
        scenario: &Scenario,
        own: VehicleId,
        incarnation: Incarnation,
        aircraft: &Aircraft,
        rules: Rules,
    ) -> Result<Self, UnsupportedScenario> {
        formation::check(scenario)?;
        let origin = Origin::new(scenario.origin.geodetic());
        let trim = with_hidden_error(aircraft.trim, scenario, own);
        let plan = scenario.plan_hash();
        Ok(Self {
            estimator: Estimator::new(origin, &scenario.sensing),
            diagnosis: Diagnosis::new(scenario, aircraft),
            peers: Peers::new(own, scenario.roster(), plan, &scenario.network),
            strangers: Strangers::new(own),
            intents: Intents::new(scenario).map(Box::new),
            mission: Mission::new(scenario, own, aircraft.take_off_rotor_rad_s()),
            tuning: Tuning::new(scenario),
            formation: Formation::new(own, scenario)?,
            controller: Controller::new(scenario, rules, trim, aircraft.gains),
            schedule: SendSchedule::new(own, incarnation, &origin, &scenario.network),
            clock: SteadyClock::default(),
            pace: Pace::new(scenario.plant.min_frame_rate_hz),
            last: LastStep { missing: Some(Condition::SimulatorLost), ..LastStep::default() },
        })
    }

    /// Runs the loop once: every stage, in the order of the diagram.
    pub fn step(&mut self, now: Now, inputs: &Inputs<'_>, workspace: &mut Workspace) -> Outputs {
        let own = self.estimate(now, inputs);
        let failure = self.diagnose(&own, inputs);
        let conditions = self.update_peers(&own, inputs);
        let (task, mut events) = self.decide(&own, failure, conditions, inputs);
        self.tune(&own, &mut events);
        let output = self.compute_formation(&own, task.as_ref(), inputs, workspace);
        let command = self.control(&own, (conditions, inputs), task.as_ref(), output.as_ref(), &mut events);
        let ask = self.formation.take_query(&mut events);
        let outbox = self.send(&own, inputs.status, conditions, events);
        Outputs { command, outbox, ask }
    }

    /// The times, by the own clock without its jumps, of the last step and of one in which the clock shows `reading`: what this step
    /// takes arrives between them.
    pub fn step_at(&self, reading: LocalTime) -> Range<LocalTime> {
        self.clock.step_at(reading)
    }

    /// The vehicle's estimated position; `None` before the first estimate.
    pub fn position(&self) -> Option<PositionNed> {
        self.last.estimate.map(|estimate| estimate.position)
    }

    /// Distance beyond which no vehicle of another team affects this one in any step of its mission, m.
    pub fn strangers_reach_m(&self) -> f64 {
        self.formation.longest_strangers_reach_m()
    }

    /// The peers' estimated current states.
    pub fn peers(&self) -> impl Iterator<Item = PeerEstimate> {
        self.peers.estimates()
    }

    /// The peers' current poses, for a simulator that draws them; `origin` is that of the swarm's frame.
    pub fn peer_poses(&self, origin: &Origin) -> impl Iterator<Item = PeerPose> {
        let own = self.position().unwrap_or_default();
        self.peers().map(move |peer| {
            let (position, convergence) = origin.place(peer.position);
            let heading_rad = convergence.heading_to_local(peer.heading_rad);
            PeerPose {
                id: peer.id,
                position,
                attitude: Attitude { heading_rad, ..Attitude::default() },
                distance_m: (peer.position - own).norm(),
            }
        })
    }

    /// The peers in contact whose newest state arrived less than 0.5 s ago, however long it was in flight.
    pub fn fresh_peers(&self) -> VehicleSet {
        self.peers.fresh()
    }

    /// The ages of the newest states of those of these peers that are in contact and not out of sight, by id.
    pub fn peer_ages(&self, of: VehicleSet) -> impl Iterator<Item = PeerStateAge> {
        self.peers.ages(of)
    }

    /// The vehicle's membership: whether the other vehicles wait for it.
    pub fn membership(&self) -> Membership {
        self.last.membership
    }

    /// The vehicle's present activity.
    pub fn activity(&self) -> Activity {
        self.last.activity
    }

    /// Time for which the vehicle has been in formation without interruption, s; `None` while it is not.
    ///
    /// In formation is a vehicle in the phase [`Activity::Formation`] that is in place ([`FormationOutput::in_place`]): where its
    /// law wants it, at its altitude and slow. This is the one definition for all displays.
    pub fn in_place_s(&self) -> Option<f64> {
        self.last.in_place_s
    }

    /// The present values of the keys that operators have set in flight.
    pub fn settings(&self) -> &[Setting] {
        self.tuning.present()
    }

    /// The current step of the mission, counted from 0.
    pub fn at_step(&self) -> u32 {
        self.mission.at()
    }

    /// The highest step this agent has reached.
    pub fn reached(&self) -> Option<u32> {
        self.mission.reached()
    }

    /// Whether the vehicle has only its landing left, or has left the swarm.
    pub fn has_finished(&self) -> bool {
        self.mission.is_at_landing() || self.membership() == Membership::Left
    }

    /// The formation's centre according to this vehicle, north and east, m.
    pub fn centre_ne_m(&self) -> Vector2<f64> {
        self.mission.centre().0
    }

    /// Velocity of the centre of its formation, north and east, m/s.
    pub fn centre_velocity_ne_m_s(&self) -> Vector2<f64> {
        self.mission.centre().1
    }

    /// The peers in contact.
    pub fn peers_in_contact(&self) -> VehicleSet {
        self.peers.in_contact()
    }

    /// Centre of the area for which this vehicle's team waits, if it does.
    pub fn wanted_area(&self) -> Option<PositionNed> {
        self.intents.as_ref()?.wanted(self.mission.at())
    }

    /// Number of states sent so far, and their payload, bytes.
    pub fn states_sent(&self) -> (u64, u64) {
        (self.schedule.states.messages, self.schedule.states.bytes)
    }

    /// Number of heartbeats sent so far, and their payload, bytes.
    pub fn heartbeats_sent(&self) -> (u64, u64) {
        (self.schedule.heartbeats.messages, self.schedule.heartbeats.bytes)
    }

    /// Number of interventions of the safety filter so far; `None` without a filter.
    pub fn safety_activations(&self) -> Option<u64> {
        self.formation.safety_activations()
    }

    /// Number of queries without a reply from an external law so far; `None` without such a law.
    pub fn law_misses(&self) -> Option<u64> {
        self.formation.external.as_ref().map(|law| law.misses)
    }

    /// Whether the fallback flies in the place of an external law; `None` where the vehicle flies by no external law.
    pub fn fallback_flies(&self) -> Option<bool> {
        self.formation.external.as_ref()?.fallback_flies
    }

    /// The failures found in the own vehicle, from the least to the most severe.
    pub fn failures(&self) -> Vec<Failure> {
        let stuck = self.mission.is_stuck().then_some(Failure::Altitude);
        let place = self.mission.gave_up.then_some(Failure::Place);
        let mut failures: Vec<Failure> = self.diagnosis.found().chain(stuck).chain(place).collect();
        failures.sort_unstable();
        failures
    }

    /// The orders that this agent knows.
    pub fn orders(&self) -> &StandingOrders {
        &self.mission.orders
    }

    /// Messages and measurements dropped so far. The caller adds those dropped outside the core.
    pub fn drops(&self) -> Drops {
        Drops {
            old: self.peers.old(),
            forged: self.peers.forged(),
            measurement: self.estimator.refused,
            ..Drops::default()
        }
    }

    /// Per sender the number of messages that were dropped because a newer one had been received; only senders with
    /// any.
    pub fn old_messages(&self) -> impl Iterator<Item = (VehicleId, u64)> {
        self.peers.old_messages()
    }

    /// The estimate stage: the own state and its age.
    fn estimate(&mut self, now: Now, inputs: &Inputs<'_>) -> OwnEstimate {
        let (now, clock_jumped) = self.clock.read(now);
        if self.diagnosis.is_position_frozen() {
            self.estimator.dead_reckon();
        }
        // What a simulator shows that does not simulate the flight is not the vehicle's state.
        let measurement = inputs.measurement.filter(|_| inputs.status.standstill.is_none());
        let estimate = self.estimator.update(now, measurement);
        let new = estimate.filter(|_| self.estimator.is_new);
        let before = if new.is_some() { self.last.plant_time.replace(now.plant) } else { None };
        let dt_s = before.map_or(0.0, |before| now.plant.seconds_since(before));
        let condition = match inputs.status.standstill {
            Some(_) => Some(Condition::SimulatorStopped),
            None => Condition::of_own_data(self.estimator.age_s(now.local), new.is_some()),
        };
        OwnEstimate { now, clock_jumped, estimate, condition, new, dt_s }
    }

    /// The diagnosis stage: a failure newly found in the own vehicle.
    fn diagnose(&mut self, own: &OwnEstimate, inputs: &Inputs<'_>) -> Option<Failure> {
        let is_released = self.last.command == Some(Command::Release);
        if is_released || matches!(own.condition, Some(Condition::SimulatorLost | Condition::SimulatorStopped)) {
            // The next measurement may come from a restarted simulator with the rotor at rest, and a pilot's manoeuvres are
            // no failures.
            self.diagnosis.restart();
        }
        let (Some(_), Some(measurement)) = (own.new, inputs.measurement) else { return None };
        self.diagnosis.update(own.dt_s, measurement, self.last.command.and_then(Command::controls))
    }

    /// The peers stage: updates the peers and returns all conditions so far.
    fn update_peers(&mut self, own: &OwnEstimate, inputs: &Inputs<'_>) -> Conditions {
        if let Some(for_s) = inputs.did_not_run_s {
            self.peers.did_not_run(for_s);
        }
        self.peers.update(own.now.local, inputs.received, inputs.broadcast);
        if let Some(intents) = &mut self.intents {
            intents.receive(inputs.intents);
        }
        let mut conditions = self.diagnosis.conditions();
        conditions.extend(own.condition);
        conditions.extend(self.peers.all_lost().then_some(Condition::AllPeersLost));
        conditions
    }

    /// The mission stage: the task of this step, `None` without a new measurement, and the events so far.
    fn decide(
        &mut self,
        own: &OwnEstimate,
        failure: Option<Failure>,
        conditions: Conditions,
        inputs: &Inputs<'_>,
    ) -> (Option<Task>, Vec<EventKind>) {
        let mut events = self.take_orders(inputs);
        events.extend(own.clock_jumped.then_some(EventKind::ClockJumped));
        events.extend(failure.map(EventKind::Failed));
        events.extend(self.pace.update(own.now.local, own.new.is_some()));
        if conditions.response() == Response::LetGo {
            self.mission.withdraw();
        }
        let Some(estimate) = &own.new else { return (None, events) };
        let output = self.last.output.as_ref();
        let (at, is_complete) = (self.mission.at(), self.mission.is_complete);
        let is_next_taken = |intents: &mut Box<Intents>| intents.is_next_taken(own.now.local, at, is_complete);
        let view = View {
            is_next_taken: self.intents.as_mut().is_some_and(is_next_taken),
            revision: self.peers.revision(),
            absent_may_fly: self.peers.absent_may_fly(),
            altitude_error_m: output.map(|output| output.altitude_error_m(estimate)),
            error_m: output.map(|output| output.setpoint.error_ne_m().norm()),
            follows_law: output.is_some_and(|output| output.is_followed(estimate.velocity.horizontal())),
            position_is_stuck: self.diagnosis.is_position_stuck(),
            collective_limit: self.controller.collective_limit(),
            in_place: output.is_some_and(|output| output.in_place),
            frames_are_too_few: self.pace.is_too_slow(),
            pilot_takes_over: inputs.status.pilot_takes_over,
            flies_above: self.peers.flies_above(),
            conditions,
        };
        let task = self.mission.step(own.now, estimate, &view, self.peers.heartbeats(), &mut events);
        (Some(task), events)
    }

    /// Takes the orders of operators and of the peers' heartbeats; returns the events of these orders and of the peers
    /// stage.
    fn take_orders(&mut self, inputs: &Inputs<'_>) -> Vec<EventKind> {
        if inputs.leave {
            self.mission.leave();
        }
        let event = |change: Change| match change {
            Change::Found(id) => EventKind::PeerFound(id),
            Change::Lost(id) => EventKind::PeerLost(id),
        };
        let mut events: Vec<_> = self.peers.changes().map(event).collect();
        for order in self.peers.orders() {
            self.mission.merge(*order, &mut events);
        }
        for report in self.peers.reports() {
            self.mission.take_report(report, &mut events);
        }
        events
    }

    /// Changes the formation by what an operator has set in flight.
    fn tune(&mut self, own: &OwnEstimate, events: &mut Vec<EventKind>) {
        let all_know = |setting: &Order| self.peers.all_know(setting);
        if let Some(scenario) = self.tuning.step(own.dt_s, &self.mission.orders, all_know, events) {
            self.formation.change(&scenario);
        }
    }

    /// The formation stage: the formation's output; `None` without a task that needs one.
    fn compute_formation(
        &mut self,
        own: &OwnEstimate,
        task: Option<&Task>,
        inputs: &Inputs<'_>,
        workspace: &mut Workspace,
    ) -> Option<FormationOutput> {
        self.formation.receive_reply(own.now.plant, inputs.answer);
        let (estimate, task) = own.new.as_ref().zip(task)?;
        let was_in_place_s = self.last.in_place_s.take();
        let strangers_reach_m = self.formation.strangers_reach_m(task);
        let strangers = self.strangers.near(own.now.local, inputs.strangers, (estimate.position, strangers_reach_m));
        let reach_m = self.formation.reach_m(task, self.peers.members().len() + 1);
        let others = self.peers.near(estimate.position, reach_m);
        self.last.output = self.formation.step(own.dt_s, estimate, (others, strangers), task, workspace);
        let flies = self.mission.activity == Activity::Formation;
        let is_in_place = flies && self.last.output.is_some_and(|output| output.in_place);
        self.last.in_place_s = is_in_place.then(|| was_in_place_s.map_or(0.0, |before_s| before_s + own.dt_s));
        self.last.output
    }

    /// The control stage: the command of this step; `None` leaves the last one unchanged.
    fn control(
        &mut self,
        own: &OwnEstimate,
        (conditions, inputs): (Conditions, &Inputs<'_>),
        task: Option<&Task>,
        output: Option<&FormationOutput>,
        events: &mut Vec<EventKind>,
    ) -> Option<Command> {
        let response = conditions.response();
        let was_released = self.last.command == Some(Command::Release);
        let Some((estimate, task)) = own.new.as_ref().zip(task) else {
            let is_neutral = response == Response::Neutral && self.last.command.is_some() && !was_released;
            return is_neutral.then(|| self.controller.neutral());
        };
        if was_released && *task != Task::Release {
            self.controller.take_over(inputs.status.controls);
        }
        let commanded = match (task, output) {
            (Task::Release, _) => Some((Command::Release, None)),
            (Task::Park, _) => Some((self.controller.park(own.dt_s), None)),
            (Task::Autorotate { heading_rad }, _) => Some(self.controller.autorotate(own.dt_s, estimate, *heading_rad)),
            (_, Some(output)) if response == Response::LandTurning => {
                Some(self.controller.turn(own.dt_s, estimate, &output.setpoint))
            }
            (_, Some(output)) => Some(self.controller.step(own.dt_s, estimate, &output.setpoint)),
            (_, None) => None,
        };
        let (command, fault) = commanded.unzip();
        events.extend(fault.flatten().map(|_| EventKind::ControlFault));
        self.last.command = command;
        self.last.command
    }

    /// The outbox stage: the messages of this step.
    fn send(
        &mut self,
        own: &OwnEstimate,
        status: &PlantStatus,
        conditions: Conditions,
        mut events: Vec<EventKind>,
    ) -> Outbox {
        self.report_changes(own, status, conditions, &mut events);
        let estimate = match conditions.response() {
            Response::Neutral => None,
            // A stopped simulator has left its vehicle where it was.
            Response::LetGo => own.estimate.map(|last| Estimate { velocity: VelocityNed::default(), ..last }),
            _ => own.estimate,
        };
        let peers = |stamp| (self.peers.echo(stamp), self.peers.lost());
        let outbox = self.schedule.outbox(own.now.local, estimate.as_ref(), &self.mission, events, peers);
        let at = self.mission.at();
        let due = |intents: &mut Box<Intents>| intents.due(own.now.local, at);
        let flies = self.mission.membership() != Membership::Left;
        let intent = self.intents.as_mut().filter(|_| flies).and_then(due);
        let header = intent.map(|_| self.schedule.header_of_intent(own.now.local));
        let intent =
            header.zip(intent).map(|(header, intent)| Box::new(intent.message(header, &self.estimator.origin)));
        Outbox { intent, ..outbox }
    }
}

/// The trim with this vehicle's hidden error, which the scenario's seed determines.
fn with_hidden_error(trim: Trim, scenario: &Scenario, own: VehicleId) -> Trim {
    let mut generator = random::generator(scenario.seed, Some(own), Purpose::Trim);
    let mut error_rad = || scenario.swarm.trim_error_rms_deg.to_radians() * random::standard_normal(&mut generator);
    let (roll_error_rad, pitch_error_rad) = (error_rad(), error_rad());
    Trim { roll_rad: trim.roll_rad + roll_error_rad, pitch_rad: trim.pitch_rad + pitch_error_rad, ..trim }
}

#[cfg(test)]
mod tests;
