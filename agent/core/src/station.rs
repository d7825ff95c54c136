//! The vehicle station: the agent of one vehicle with its impairments and clocks. The control thread and the study
//! drive it in the same way: [`Station::receive`], [`Station::step`], [`Station::trace`].
//!
//! ```text
//!   messages --> impairments --> clock of this vehicle --> Agent::step --> outputs, trace
//!   measurement --> sensors ----------------------------------^
//! ```
//!
//! In a study over an imperfect network the network of the whole swarm has the impairments, and the stations have none.
//!
//! Callers pass the correct time. The station applies the clock error that the scenario sets for this vehicle after the
//! impairments, because the network is independent of a vehicle's clock.

use alloc::boxed::Box;
use alloc::vec::Vec;

use serde::{Deserialize, Serialize};
use skein_common::id::{Incarnation, VehicleId, VehicleSet};
use skein_common::message::{Trace, VehicleFacts};
use skein_common::scenario::Scenario;
use skein_common::state::Membership;
use skein_common::time::{LocalTime, Now, PlantTime};

use crate::agent::{Agent, Inputs, Outputs};
use crate::aircraft::Aircraft;
use crate::control::Rules;
use crate::formation::external::LawReply;
use crate::formation::{UnsupportedScenario, Workspace};
use crate::impairments::{DeliveryCounts, Impairments, ReceiverPosition, StrangerNetwork};
use crate::intent::ReceivedIntent;
use crate::peers::{Broadcast, Received};
use crate::plant::{GroundTruth, Measurement, PlantStatus};
use crate::sensors::Sensors;
use crate::skew::{Skew, StepClock};
use crate::strangers::{KnownStrangers, StrangerState};

/// Clock data that survive a restart of the agent: the clock's error and the time of take-off.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Clocks {
    skew: Skew,
    /// Time at which the vehicle first became an active member, by the correct clock.
    took_off: Option<LocalTime>,
    /// Flight time under an earlier agent when the correct clock began, s.
    flown_before_s: Option<f64>,
}

impl Clocks {
    /// The clocks of vehicle `own` on the ground.
    pub fn new(scenario: &Scenario, own: VehicleId) -> Self {
        Self { skew: Skew::new(scenario, own), ..Self::default() }
    }

    /// The same clocks for a vehicle that an earlier agent had flown for this time, s, when the correct clock began;
    /// `None` if there was no earlier agent.
    #[must_use]
    pub fn after(self, flown_before_s: Option<f64>) -> Self {
        Self { flown_before_s, ..self }
    }

    /// Makes the vehicle's clock jump forward by `by_s`, or back if it is negative.
    pub fn jump(&mut self, by_s: f64) {
        self.skew.jump(by_s);
    }

    /// Reading of the vehicle's clock when the correct clock reads `right`.
    pub fn local_time(&self, right: LocalTime) -> LocalTime {
        self.skew.local_time(right)
    }

    /// Time since the vehicle's take-off, including earlier agents, s: the time base of scripted events. `None` before
    /// take-off.
    pub fn flown_s(&self, right: LocalTime) -> Option<f64> {
        // Divided, not multiplied: this gives the number nearest to the scenario's decimals.
        let since = |took_off: LocalTime| (right.nanoseconds().saturating_sub(took_off.nanoseconds())) as f64 / 1e9;
        self.flown_before_s.map(|before_s| before_s + right.seconds()).or(self.took_off.map(since))
    }
}

/// The inputs of a station in one step beside what [`Station::receive`] has taken. What they refer to is not copied for each
/// vehicle.
#[derive(Clone, Copy, Debug)]
pub struct Entering<'a> {
    /// The correct time.
    pub right: LocalTime,
    /// Time for which the PC did not run this agent before this step, s, if it was late.
    pub did_not_run_s: Option<f64>,
    /// The plant's report beside its frames.
    pub status: &'a PlantStatus,
    /// Time of the newest frame.
    pub plant_time: PlantTime,
    /// The exact measurement of a new frame, `None` if none arrived in time: the scenario's sensors decide what the agent gets
    /// of it.
    pub measurement: Option<&'a Measurement>,
    /// Whether this vehicle has to land and to leave the swarm.
    pub leave: bool,
    /// Messages to all vehicles of the swarm.
    pub broadcast: Broadcast<'a>,
    /// The network from other teams to all vehicles of this one; `None` without a fleet, or if the station has its own.
    pub strangers: Option<&'a StrangerNetwork>,
    /// Reply of an external law to the last query.
    pub answer: Option<&'a LawReply>,
}

impl<'a> Entering<'a> {
    /// The inputs when the plant with this status has the newest frame of this time: no messages, and neither a law's
    /// reply nor a reason to leave.
    pub fn of_plant(
        right: LocalTime,
        (plant_time, measurement): (PlantTime, Option<&'a Measurement>),
        status: &'a PlantStatus,
    ) -> Self {
        Self {
            right,
            did_not_run_s: None,
            status,
            plant_time,
            measurement,
            leave: false,
            broadcast: Broadcast::default(),
            strangers: None,
            answer: None,
        }
    }
}

/// Everything that enters a station in one step of real time. Two new stations of the same vehicle that get the same inputs,
/// step by step, give the same outputs, bit for bit.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StepInputs {
    /// The correct time.
    pub right: LocalTime,
    /// Time for which the PC did not run this agent before this step, s, if it was late.
    pub did_not_run_s: Option<f64>,
    /// Messages from peers and operators that arrived since the last step, each with the correct time of its arrival.
    pub received: Vec<Received>,
    /// States of other teams that arrived since the last step.
    pub strangers: Vec<StrangerState>,
    /// Intents of other teams that arrived since the last step.
    pub intents: Vec<ReceivedIntent>,
    /// The plant's report beside its frames.
    pub status: PlantStatus,
    /// Time of the newest frame.
    pub plant_time: PlantTime,
    /// The exact measurement of a new frame; `None` if none arrived in time.
    pub measurement: Option<Measurement>,
    /// Whether this vehicle has to land and to leave the swarm.
    pub leave: bool,
    /// Reply of an external law to the last query.
    pub answer: Option<LawReply>,
}

/// One vehicle's agent with its clocks, its sensors and the scenario's network impairments.
#[derive(Clone, Debug)]
pub struct Station {
    own: VehicleId,
    agent: Agent,
    impairments: Impairments,
    clocks: Clocks,
    /// `None` if the measurements are exact.
    sensors: Option<Box<Sensors>>,
    /// Messages received since the last step, stamped by the vehicle's clock.
    received: Vec<Received>,
    /// The network from other teams to this vehicle; `None` without a fleet, or if all vehicles of the team share one.
    strangers: Option<Box<StrangerNetwork>>,
    /// Intents of other teams received since the last step, stamped alike.
    intents: Vec<ReceivedIntent>,
}

impl Station {
    /// A new agent of vehicle `own`, with the clocks of the previous agent.
    ///
    /// # Errors
    ///
    /// A scenario with a formation that this program cannot fly.
    pub fn new(
        scenario: &Scenario,
        own: VehicleId,
        incarnation: Incarnation,
        (aircraft, rules): (&Aircraft, Rules),
        clocks: Clocks,
    ) -> Result<Self, UnsupportedScenario> {
        let agent = Agent::new(scenario, own, incarnation, aircraft, rules)?;
        let (impairments, sensors) = (Impairments::new(scenario, own), Sensors::new(scenario, own));
        let strangers = scenario.team.map(|_| {
            let mut network = Box::new(StrangerNetwork::new(scenario));
            network.begin(own);
            network
        });
        let (received, intents) = (Vec::new(), Vec::new());
        Ok(Self { own, agent, impairments, clocks, sensors, received, strangers, intents })
    }

    /// Makes the agent learn of other teams from the network of its whole team, which every step has.
    pub fn share_strangers(&mut self) {
        self.strangers = None;
    }

    /// Makes the agent read its messages from the inbox of the whole swarm, which every step has in its broadcast. The network
    /// that fills the inbox applies the impairments.
    pub fn share_inbox(&mut self) {
        self.agent.peers.share_inbox();
        self.impairments = Impairments::default();
    }

    /// Lets go of the inbox after a step, so that the next frame's messages can be put into it.
    pub fn release_inbox(&mut self) {
        self.agent.peers.release_inbox();
    }

    /// The agent's clock in the step at this correct time, until that step is taken.
    pub fn step_clock(&self, right: LocalTime) -> StepClock {
        StepClock::new(self.clocks.skew, right, self.agent.step_at(self.clocks.local_time(right)))
    }

    /// Takes the messages that an ideal network delivers, each with the correct time of its arrival. Those that pass
    /// the impairments by now are kept for the next step.
    pub fn receive(&mut self, right: LocalTime, arriving: impl IntoIterator<Item = Received>) {
        let own = ReceiverPosition { flown_s: self.clocks.flown_s(right), position: self.agent.position() };
        let before = self.received.len();
        self.impairments.receive(right, own, arriving, &mut self.received);
        let clock = self.step_clock(right);
        self.received[before..].iter_mut().for_each(|received| received.at = clock.at_arrival(received.at));
    }

    /// Takes the states and intents of other teams that an ideal network delivers, each with the correct time of its arrival. Call
    /// it before every step: some may be late.
    fn receive_strangers(&mut self, right: LocalTime, states: &[StrangerState], intents: &[ReceivedIntent]) {
        let clock = self.step_clock(right);
        let Self { own, agent, strangers: Some(network), .. } = self else { return };
        let receivers: VehicleSet = [*own].into_iter().collect();
        network.set_receivers([(*own, agent.position(), agent.strangers_reach_m())].into_iter());
        states.iter().for_each(|state| network.send(state, right, receivers));
        intents.iter().for_each(|intent| network.send_intent(intent, right, receivers));
        network.deliver(right);
        self.intents.extend(stamped_intents(network, *own, clock));
    }

    /// Takes the intents of other teams that the last delivery of this network, at this correct time, has brought to the vehicle.
    /// They are kept for the next step, which need not follow in the same frame: a busy central controller leaves frames out.
    pub fn take_intents(&mut self, right: LocalTime, network: &StrangerNetwork) {
        self.intents.extend(stamped_intents(network, self.own, self.step_clock(right)));
    }

    /// Whether the network delivers every message to this vehicle at once, so that it need not be kept in flight:
    /// [`Self::step`] takes such messages in place.
    pub fn receives_broadcast(&self) -> bool {
        self.impairments.is_perfect()
    }

    /// Steps the agent with these inputs and all that the impairments have let pass.
    pub fn step(&mut self, entering: &Entering<'_>, workspace: &mut Workspace) -> Outputs {
        let Entering { right, did_not_run_s, status, plant_time, leave, broadcast, answer, .. } = *entering;
        let now = Now { plant: plant_time, local: self.clocks.local_time(right) };
        let measured;
        let measurement = match (&mut self.sensors, entering.measurement) {
            (Some(sensors), Some(exact)) => {
                measured = sensors.measure(plant_time, exact);
                measured.as_ref()
            }
            (_, measurement) => measurement,
        };
        let (network, clock) = (entering.strangers.or(self.strangers.as_deref()), self.step_clock(right));
        let strangers = network.map(|network| KnownStrangers { records: network.records(), right, clock });
        let (received, intents) = (&*self.received, &*self.intents);
        let inputs =
            Inputs { did_not_run_s, status, measurement, received, broadcast, strangers, intents, leave, answer };
        let outputs = self.agent.step(now, &inputs, workspace);
        self.received.clear();
        self.intents.clear();
        if self.agent.membership() == Membership::Active {
            self.clocks.took_off.get_or_insert(right);
        }
        outputs
    }

    /// Receives and steps with these inputs. The lists of what arrived are empty afterwards.
    pub fn step_with(&mut self, inputs: &mut StepInputs, workspace: &mut Workspace) -> Outputs {
        let right = inputs.right;
        self.receive(right, inputs.received.drain(..));
        self.receive_strangers(right, &inputs.strangers, &inputs.intents);
        inputs.strangers.clear();
        inputs.intents.clear();
        let plant = (inputs.plant_time, inputs.measurement.as_ref());
        let entering = Entering {
            did_not_run_s: inputs.did_not_run_s,
            leave: inputs.leave,
            answer: inputs.answer.as_ref(),
            ..Entering::of_plant(right, plant, &inputs.status)
        };
        self.step(&entering, workspace)
    }

    /// The record of the last step. It lacks the figures known only in real time: the step's duration and the missed
    /// frames. `truth` is the plant's true state.
    pub fn trace(&mut self, right: LocalTime, plant_time: PlantTime, truth: &GroundTruth) -> Trace {
        let now = Now { plant: plant_time, local: self.clocks.local_time(right) };
        let mut trace = self.agent.trace(now, truth);
        self.impairments.report_latency(&mut trace.peers);
        for peer in &mut trace.peers {
            peer.delivered_age_s = self.agent.peers.latency_s(peer.id).unwrap_or(peer.delivered_age_s);
        }
        trace
    }

    /// The beliefs of the vehicle after the last step, for displays. They lack the figures known only in real time.
    pub fn facts(&self, right: LocalTime) -> VehicleFacts {
        VehicleFacts { flown_s: self.clocks.flown_s(right), ..self.agent.facts() }
    }

    /// The agent.
    pub fn agent(&self) -> &Agent {
        &self.agent
    }

    /// The clocks, to be passed to the vehicle's next agent.
    pub fn clocks(&self) -> &Clocks {
        &self.clocks
    }

    /// Makes the vehicle's clock jump forward by `by_s`, or back if it is negative.
    pub fn clock_jumps(&mut self, by_s: f64) {
        self.clocks.jump(by_s);
    }

    /// Counts of all messages by their delivery; `None` if the scenario has no impairments.
    pub fn delivery_counts(&self) -> Option<DeliveryCounts> {
        (!self.impairments.is_perfect()).then(|| self.impairments.delivery_counts())
    }
}

/// The intents that the last delivery of this network has brought to a vehicle, each with its time of arrival by this clock.
fn stamped_intents(
    network: &StrangerNetwork,
    own: VehicleId,
    clock: StepClock,
) -> impl Iterator<Item = ReceivedIntent> {
    network.intents(own).map(move |intent| ReceivedIntent { at: clock.at_arrival(intent.at), ..*intent })
}

#[cfg(test)]
mod tests {
    use skein_common::frame::PositionNed;
    use skein_common::message::MessageOrder;
    use skein_common::scenario::{Source, load};

    use super::*;
    use crate::intent::{Area, Intent};

    fn clocks(keys: &str) -> Clocks {
        let text = alloc::format!("swarm.vehicles = 2\n{keys}");
        let scenario = load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario;
        Clocks::new(&scenario, VehicleId::new(1).unwrap())
    }

    #[test]
    fn flight_time_counts_from_take_off_or_continues_that_of_an_earlier_agent() {
        let at = |seconds: f64| LocalTime::from_seconds(seconds);
        let ground = clocks("");
        assert_eq!(ground.flown_s(at(5.0)), None);
        let flying = Clocks { took_off: Some(at(3.0)), ..ground };
        assert_eq!(flying.flown_s(at(3.7)), Some(0.7), "the number nearest to the decimal");
        assert_eq!(flying.after(Some(100.0)).flown_s(at(5.0)), Some(105.0));
        assert_eq!(ground.after(Some(100.0)).flown_s(at(0.0)), Some(100.0));
    }

    #[test]
    fn jumps_add_up_on_top_of_a_wrong_clock() {
        let mut clocks = clocks("[vehicle.1]\nclock_offset_s = 10");
        let right = LocalTime::from_seconds(100.0);
        let local_time = |clocks: &Clocks| clocks.local_time(right).nanoseconds();
        assert_eq!(local_time(&clocks), 110_000_000_000);
        clocks.jump(7.0);
        clocks.jump(-2.0);
        assert_eq!(local_time(&clocks), 115_000_000_000);
        assert_eq!(clocks.flown_s(right), None, "a clock jump does not change the flight time");
    }

    #[test]
    fn intents_of_other_teams_wait_for_the_next_step() {
        let scenario = load(&Source { name: "test.toml", text: "swarm.vehicles = 2" }, &[]).unwrap().scenario;
        let (own, aircraft) = (VehicleId::new(1).unwrap(), Aircraft::shipped("xcell60").unwrap().unwrap());
        let mut station =
            Station::new(&scenario, own, Incarnation(1), (&aircraft, Rules::shipped()), clocks("")).unwrap();
        let mut network = StrangerNetwork::new(&scenario);
        network.begin(own);
        let occupied = Area { centre: PositionNed::new(0.0, 0.0, -30.0), radius_m: 50.0 };
        let intent = Intent { occupied, wanted: None };
        let mut deliver = |sequence: u64, at_s: f64, is_sent: bool| {
            let (order, at) = (MessageOrder { incarnation: Incarnation(1), sequence }, LocalTime::from_seconds(at_s));
            let sent = ReceivedIntent { id: "2/1".parse().unwrap(), order, intent, at };
            if is_sent {
                network.send_intent(&sent, at, [own].into_iter().collect());
            }
            network.deliver(at);
            station.take_intents(at, &network);
            station.intents.iter().map(|intent| intent.order.sequence).collect::<Vec<_>>()
        };
        assert_eq!(deliver(1, 1.0, true), [1]);
        assert_eq!(deliver(2, 1.02, true), [1, 2], "no step has taken the first one");
        assert_eq!(deliver(3, 1.04, false), [1, 2]);
    }
}
