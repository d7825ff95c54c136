//! One vehicle, deciding alone: [`Agent::step`] runs the loop once.
//!
//! ```text
//!                        Agent::step(now, inputs) -> outputs
//!   +----------------------------------------------------------------------------------------------+
//!   |  estimate -> diagnosis -> peers -> mission -> formation -> control -> outbox                  |
//!   +----^-----------------------^--------------------------------------|-------------------|-------+
//!        | measurement           | messages                             | controls          | messages
//!      plant                  peer agents                             plant             peer agents
//! ```
//!
//! A step without a new measurement takes in messages and sends its own, but decides nothing: the mission gives no task, and
//! without a task there is neither a setpoint nor a new command.

use alloc::vec::Vec;

use nalgebra::Vector2;
use skein_common::frame::{Origin, PositionNed, VelocityNed};
use skein_common::id::{Incarnation, VehicleId, VehicleSet};
use skein_common::message::{Drops, Failure, Happening, PeerAge, Trace};
use skein_common::scenario::Scenario;
use skein_common::state::{Activity, Membership};
use skein_common::time::{LocalTime, Now, PlantTime};

use crate::aircraft::Aircraft;
use crate::control::{Controls, Rules, Setpoint, Trim, VehicleController};
use crate::deadlines::Deadline;
use crate::diagnosis::Diagnosis;
use crate::estimate::{Estimate, Estimator};
use crate::failsafe::{Condition, Conditions, Response};
use crate::formation::external::{Answer, Ask};
use crate::formation::{self, Formation, NotFlown, Wish};
use crate::mission::{Mission, Task, View};
use crate::outbox::{Outbox, SendSchedule};
use crate::peers::{Change, Heard, Peers, Seen, Word};
use crate::plant::{Measurement, Sticks, Truth};
use crate::random::{self, Purpose};

/// What came in since the last step.
#[derive(Clone, Copy, Debug)]
pub struct Inputs<'a> {
    /// What the plant's new frame measured; `None` if none came in time.
    pub measurement: Option<&'a Measurement>,
    /// What was heard of others, in any order.
    pub heard: &'a [Heard],
    /// This vehicle alone is to land and leave, because its agent is about to end.
    pub leave: bool,
    /// What an external law has answered to the last ask.
    pub answer: Option<&'a Answer>,
}

/// What goes out.
#[derive(Clone, Debug, PartialEq)]
pub struct Outputs {
    /// The controls to write; `None` leaves them as they are.
    pub command: Option<Sticks>,
    /// The messages to send.
    pub outbox: Outbox,
    /// What to ask an external law: its answer is for a later step.
    pub ask: Option<Ask>,
}

/// One vehicle's core: no clock, no input or output, no randomness but its seed's. Same inputs, same outputs, bit for bit.
#[derive(Clone, Debug)]
pub struct Agent {
    origin: Origin,
    estimator: Estimator,
    diagnosis: Diagnosis,
    peers: Peers,
    mission: Mission,
    formation: Formation,
    controller: VehicleController,
    schedule: SendSchedule,
    clock: SteadyClock,
    last: LastStep,
}

/// What the estimate stage hands on.
#[derive(Clone, Copy, Debug)]
struct Own {
    /// This step's time, by clocks without jumps.
    now: Now,
    clock_jumped: bool,
    /// The newest estimate, however old.
    estimate: Option<Estimate>,
    /// What is wrong with it.
    condition: Option<Condition>,
    /// The estimate, if this step has measured it.
    new: Option<Estimate>,
    /// Plant time between the last two measurements, s; 0 before there are two.
    dt_s: f64,
}

/// What the last step found and did: the only way by which a later stage reaches an earlier one.
#[derive(Clone, Debug)]
struct LastStep {
    /// What was missing.
    missing: Option<Condition>,
    membership: Membership,
    activity: Activity,
    plant_time: Option<PlantTime>,
    estimate: Option<Estimate>,
    wish: Option<Wish>,
    command: Option<Sticks>,
}

impl Agent {
    /// Vehicle `own` of a scenario, in a new life. Refuses a scenario that asks for what is not flown yet.
    pub fn new(
        scenario: &Scenario,
        own: VehicleId,
        incarnation: Incarnation,
        aircraft: &Aircraft,
        rules: Rules,
    ) -> Result<Self, NotFlown> {
        formation::check(scenario)?;
        let origin = Origin::new(scenario.origin.geodetic());
        let trim = with_hidden_error(aircraft.trim, scenario, own);
        let plan = scenario.plan_hash();
        let roster = scenario.swarm.vehicles.min(VehicleId::MAX.into()) as u8;
        Ok(Self {
            origin,
            estimator: Estimator::new(origin, &scenario.sensing),
            diagnosis: Diagnosis::new(aircraft),
            peers: Peers::new(own, roster, plan, &scenario.network),
            mission: Mission::new(scenario, aircraft.take_off_rotor_rad_s()),
            formation: Formation::new(own, scenario)?,
            controller: VehicleController::new(rules, trim, scenario.control.auto_trim),
            schedule: SendSchedule::new(own, incarnation, &scenario.network),
            clock: SteadyClock::default(),
            last: LastStep {
                missing: Some(Condition::SimulatorLost),
                membership: Membership::Joining,
                activity: Activity::Joining,
                plant_time: None,
                estimate: None,
                wish: None,
                command: None,
            },
        })
    }

    /// Runs the loop once: every stage, in the order of the picture.
    pub fn step(&mut self, now: Now, inputs: &Inputs<'_>) -> Outputs {
        let own = self.estimate(now, inputs);
        let failure = self.diagnose(&own, inputs);
        let conditions = self.hear(&own, inputs);
        let (task, mut events) = self.decide(&own, failure, conditions, inputs);
        let wish = self.form(&own, task.as_ref(), inputs);
        let command = self.control(&own, conditions, task.as_ref(), wish.as_ref(), &mut events);
        let ask = self.formation.asked(&mut events);
        let outbox = self.send(&own, conditions, events);
        Outputs { command, outbox, ask }
    }

    /// This step for those who measure and watch; `truth` is the plant's, which the agent itself never looks at.
    pub fn trace(&mut self, now: Now, truth: &Truth) -> Trace {
        let LastStep { membership, activity, estimate, wish, command, .. } = &self.last;
        let wish = wish.as_ref();
        let setpoint: Option<&Setpoint> = wish.map(|wish| &wish.setpoint);
        Trace {
            header: self.schedule.header_of_trace(now.local),
            plant_time: now.plant,
            membership: *membership,
            activity: *activity,
            live: self.formation.live().min(usize::from(VehicleId::MAX)) as u8,
            step: self.mission.at(),
            reached: self.mission.reached(),
            centre_ne_m: self.centre_ne_m().into(),
            estimate: estimate.map(|estimate| estimate.position).unwrap_or_default(),
            position: truth.position,
            height_m: truth.height_m,
            velocity: truth.velocity,
            attitude: truth.attitude,
            power_w: truth.power_w,
            field_ne: wish.map(|wish| wish.field_ne.into()).unwrap_or_default(),
            error_ne_m: setpoint.map(|setpoint| setpoint.error_ne_m().into()).unwrap_or_default(),
            altitude_setpoint_m: setpoint.map(|setpoint| setpoint.altitude_m).unwrap_or_default(),
            sticks: command.map(|sticks| [sticks.roll, sticks.pitch, sticks.yaw, sticks.collective]),
            peers: self
                .peers()
                .iter()
                .map(|&Seen { id, standing, age_s, delay_s, .. }| PeerAge {
                    id,
                    standing,
                    age_s,
                    delay_s,
                    delivered_age_s: 0.0,
                })
                .collect(),
            step_us: None,
            safety_activations: self.formation.safety_activations(),
            law_misses: self.law_misses(),
            law_log: self.formation.law_log().to_vec(),
            frame_overruns: 0,
            state_messages: self.schedule.state_messages(),
            state_bytes: self.schedule.state_bytes(),
        }
    }

    /// Where the vehicle takes itself to be; `None` without data of its own.
    pub fn position(&self) -> Option<PositionNed> {
        self.last.estimate.map(|estimate| estimate.position)
    }

    /// The others as they are thought to be now.
    pub fn peers(&self) -> &[Seen] {
        self.peers.seen()
    }

    /// Whether the others count on this vehicle.
    pub fn membership(&self) -> Membership {
        self.last.membership
    }

    /// What the vehicle is doing.
    pub fn activity(&self) -> Activity {
        self.last.activity
    }

    /// The step of the mission that it is at, counted from 0.
    pub fn at_step(&self) -> u32 {
        self.mission.at()
    }

    /// The highest step that it reached in this life.
    pub fn reached(&self) -> Option<u32> {
        self.mission.reached()
    }

    /// Whether nothing of the mission is left to it but to land, or not even that.
    pub fn has_finished(&self) -> bool {
        self.mission.is_at_landing() || self.membership() == Membership::Left
    }

    /// Where it takes the formation's centre to be, north and east, m.
    pub fn centre_ne_m(&self) -> Vector2<f64> {
        self.mission.centre().0
    }

    /// The others that it hears.
    pub fn hears(&self) -> VehicleSet {
        self.peers.heard()
    }

    /// Words about state said so far, and their payload in bytes.
    pub fn spoken(&self) -> (u64, u64) {
        (self.schedule.state_messages(), self.schedule.state_bytes())
    }

    /// Words about the agreement said so far, and their payload in bytes.
    pub fn agreed(&self) -> (u64, u64) {
        self.schedule.missions()
    }

    /// How often the safety filter has stepped in so far; `None` without one.
    pub fn safety_activations(&self) -> Option<u64> {
        self.formation.safety_activations()
    }

    /// Asks that an external law has not answered so far; `None` without one.
    pub fn law_misses(&self) -> Option<u64> {
        self.formation.law_misses()
    }

    /// What it finds failed of its own vehicle, from the mildest to the most severe.
    pub fn failures(&self) -> Vec<Failure> {
        let stuck = self.mission.is_stuck().then_some(Failure::Altitude);
        let mut failures: Vec<Failure> = self.diagnosis.found().chain(stuck).collect();
        failures.sort_unstable();
        failures
    }

    /// The edge tells, before the next step, that this agent did not run for so long: its computer does not keep up.
    pub fn did_not_run(&mut self, for_s: f64) {
        self.peers.did_not_run(for_s);
    }

    /// What was dropped so far; what the edges drop is theirs to add.
    pub fn drops(&self) -> Drops {
        Drops {
            old: self.peers.old(),
            forged: self.peers.forged(),
            measurement: self.estimator.refused(),
            ..Drops::default()
        }
    }

    /// Of whom so many words were dropped because a later one was already heard.
    pub fn old_words(&self) -> impl Iterator<Item = (VehicleId, u64)> {
        self.peers.old_words()
    }

    /// The estimate stage: what the vehicle believes of itself, and how old that is.
    fn estimate(&mut self, now: Now, inputs: &Inputs<'_>) -> Own {
        let (now, clock_jumped) = self.clock.read(now);
        if self.diagnosis.is_position_frozen() {
            self.estimator.dead_reckon();
        }
        let estimate = self.estimator.update(now, inputs.measurement);
        let new = estimate.filter(|_| self.estimator.is_new());
        let before = if new.is_some() { self.last.plant_time.replace(now.plant) } else { None };
        let dt_s = before.map_or(0.0, |before| now.plant.seconds_since(before));
        let condition = Condition::of_own_data(self.estimator.age_s(now.local), new.is_some());
        Own { now, clock_jumped, estimate, condition, new, dt_s }
    }

    /// The diagnosis stage: what is newly found failed of the own vehicle.
    fn diagnose(&mut self, own: &Own, inputs: &Inputs<'_>) -> Option<Failure> {
        if own.condition == Some(Condition::SimulatorLost) {
            // The next measurement may come from another life of the simulator, with the rotor at rest.
            self.diagnosis.restart();
        }
        let (Some(_), Some(measurement)) = (own.new, inputs.measurement) else { return None };
        self.diagnosis.update(own.dt_s, measurement, self.last.command)
    }

    /// The peers stage: where the peers are now; and all conditions so far.
    fn hear(&mut self, own: &Own, inputs: &Inputs<'_>) -> Conditions {
        self.peers.update(own.now.local, &self.origin, inputs.heard);
        let mut conditions = self.diagnosis.conditions();
        conditions.extend(own.condition);
        conditions.extend(self.peers.all_lost().then_some(Condition::AllPeersLost));
        conditions
    }

    /// The mission stage: the task of this step, `None` without a new measurement; and the events so far.
    fn decide(
        &mut self,
        own: &Own,
        failure: Option<Failure>,
        conditions: Conditions,
        inputs: &Inputs<'_>,
    ) -> (Option<Task>, Vec<Happening>) {
        let mut events = self.listen(inputs);
        events.extend(own.clock_jumped.then_some(Happening::ClockJumped));
        events.extend(failure.map(Happening::Failed));
        if conditions.response() == Response::LetGo {
            self.mission.withdraw();
        }
        let Some(estimate) = &own.new else { return (None, events) };
        let wish = self.last.wish.as_ref();
        let view = View {
            misses_any: self.peers.misses_any(),
            altitude_error_m: wish.map(|wish| wish.altitude_error_m(estimate)),
            collective_limit: self.controller.collective_limit(),
            in_place: wish.is_some_and(|wish| wish.in_place),
            conditions,
        };
        let task = self.mission.step(own.now, estimate, &view, self.peers.missions(), &mut events);
        (Some(task), events)
    }

    /// Takes in the orders, from operators and in the peers' heartbeats, and lists what they and the peers stage changed.
    fn listen(&mut self, inputs: &Inputs<'_>) -> Vec<Happening> {
        if inputs.leave {
            self.mission.leave();
        }
        let event = |change: &Change| match *change {
            Change::Found(id) => Happening::PeerFound(id),
            Change::Lost(id) => Happening::PeerLost(id),
        };
        let mut events: Vec<_> = self.peers.changes().iter().map(event).collect();
        for heard in inputs.heard {
            if let Word::Order(order) = heard.word {
                self.mission.merge(order, &mut events);
            }
        }
        for message in self.peers.missions() {
            self.mission.listen(message, &mut events);
        }
        events
    }

    /// The formation stage: where the vehicle is to go; `None` where the task leaves the controls alone, or there is none.
    fn form(&mut self, own: &Own, task: Option<&Task>, inputs: &Inputs<'_>) -> Option<Wish> {
        self.formation.hear(own.now.plant, inputs.answer);
        let (estimate, task) = own.new.as_ref().zip(task)?;
        self.last.wish = self.formation.step(own.dt_s, estimate, &self.peers.others(), task);
        self.last.wish
    }

    /// The control stage: the command of this step; `None` leaves the controls as they are.
    fn control(
        &mut self,
        own: &Own,
        conditions: Conditions,
        task: Option<&Task>,
        wish: Option<&Wish>,
        events: &mut Vec<Happening>,
    ) -> Option<Sticks> {
        let response = conditions.response();
        let Some((estimate, task)) = own.new.as_ref().zip(task) else {
            let is_neutral = response == Response::Neutral && self.last.command.is_some();
            return is_neutral.then(|| self.controller.neutral());
        };
        let controls = match (task, wish) {
            (Task::Park, _) => Some(Controls { sticks: self.controller.unload(own.dt_s), fault: None }),
            (Task::Autorotate { heading_rad }, _) => Some(self.controller.autorotate(own.dt_s, estimate, *heading_rad)),
            (_, Some(wish)) if response == Response::LandTurning => {
                Some(self.controller.turn(own.dt_s, estimate, &wish.setpoint))
            }
            (_, Some(wish)) => Some(self.controller.step(own.dt_s, estimate, &wish.setpoint)),
            (_, None) => None,
        };
        let fault = controls.and_then(|controls| controls.fault);
        events.extend(fault.map(|_| Happening::ControlFault));
        self.last.command = controls.map(|controls| controls.sticks);
        self.last.command
    }

    /// The outbox stage: the messages of this step.
    fn send(&mut self, own: &Own, conditions: Conditions, mut events: Vec<Happening>) -> Outbox {
        self.tell_changes(conditions, own.estimate, &mut events);
        let estimate = match conditions.response() {
            Response::Neutral => None,
            // A simulator that stands still has left its vehicle where it was.
            Response::LetGo => own.estimate.map(|last| Estimate { velocity: VelocityNed::default(), ..last }),
            _ => own.estimate,
        };
        let echo = |stamp| self.peers.echo(stamp);
        self.schedule.outbox(own.now.local, estimate.as_ref(), &self.mission, events, echo)
    }

    /// Compares with the last step and lists what has changed.
    fn tell_changes(&mut self, conditions: Conditions, estimate: Option<Estimate>, events: &mut Vec<Happening>) {
        const MISSING: [Condition; 3] = [Condition::SimulatorLost, Condition::OwnDataStale, Condition::AllPeersLost];
        let is_blind = |missing| matches!(missing, Some(Condition::SimulatorLost | Condition::OwnDataStale));
        let missing = MISSING.into_iter().find(|&condition| conditions.contains(condition));
        let was_blind = is_blind(self.last.missing);
        if missing != self.last.missing {
            match missing {
                Some(Condition::SimulatorLost) => events.push(Happening::SimulatorLost),
                Some(Condition::OwnDataStale) => events.push(Happening::OwnDataStale),
                Some(Condition::AllPeersLost) if !was_blind => events.push(Happening::AllPeersLost),
                _ if was_blind && self.last.estimate.is_some() => events.push(Happening::OwnDataBack),
                _ => {}
            }
        }
        let (membership, activity) = (self.mission.membership(), self.mission.activity());
        if membership == Membership::Active && self.last.membership == Membership::Joining {
            events.push(Happening::BecameActive);
        }
        if activity != self.last.activity {
            match (self.last.activity, activity) {
                (Activity::TakingOff, Activity::Formation) => events.push(Happening::AtAltitude),
                (_, Activity::Landed) => events.push(Happening::Landed),
                _ => {}
            }
        }
        // Until here the last step's: data that come for the first time are not back.
        self.last.estimate = estimate;
        self.last.missing = missing;
        self.last.membership = membership;
        self.last.activity = if is_blind(missing) && self.last.estimate.is_some() { Activity::Blind } else { activity };
    }
}

/// The own clock without its jumps: time that this process cannot have lived through never passed.
#[derive(Clone, Copy, Debug, Default)]
struct SteadyClock {
    /// What the clock showed last, and what that was taken for.
    last: Option<(LocalTime, LocalTime)>,
}

impl SteadyClock {
    /// The time since the last reading, which may not be negative nor longer than [`Deadline::ClockJumped`] says; and whether it was.
    fn read(&mut self, now: Now) -> (Now, bool) {
        let (shown, taken) = self.last.unwrap_or((now.local, now.local));
        let since_s = now.local.seconds_since(shown);
        let jumped = since_s < 0.0 || Deadline::ClockJumped.is_past(since_s);
        let since = if jumped { 0 } else { now.local.nanoseconds() - shown.nanoseconds() };
        let local = LocalTime::from_nanoseconds(taken.nanoseconds().saturating_add(since));
        self.last = Some((now.local, local));
        (Now { local, ..now }, jumped)
    }
}

/// The trim as this vehicle's controller believes it: off by a draw that the scenario hides from it.
fn with_hidden_error(trim: Trim, scenario: &Scenario, own: VehicleId) -> Trim {
    let mut generator = random::generator(scenario.seed, Some(own), Purpose::Trim);
    let mut error_rad = || scenario.swarm.trim_error_rms_rad() * random::standard_normal(&mut generator);
    let (roll_error_rad, pitch_error_rad) = (error_rad(), error_rad());
    Trim { roll_rad: trim.roll_rad + roll_error_rad, pitch_rad: trim.pitch_rad + pitch_error_rad, ..trim }
}

#[cfg(test)]
mod tests;
