//! One vehicle of a world: its helicopter, its failures, and the station with its agent.

use std::collections::VecDeque;

use skein_common::id::{Incarnation, VehicleId};
use skein_common::message::{EventKind, Heartbeat, ShortText, Trace};
use skein_common::scenario::Scenario;
use skein_common::time::{LocalTime, PlantTime};
use skein_core::agent::{Agent, Outputs};
use skein_core::aircraft::Aircraft;
use skein_core::builtin::BuiltInPlant;
use skein_core::control::Rules;
use skein_core::formation::external::LawReply;
use skein_core::formation::{UnsupportedScenario, Workspace};
use skein_core::helicopter::Script;
use skein_core::impairments::{StrangerNetwork, SwarmNetwork};
use skein_core::peers::Broadcast;
use skein_core::pilot::SimulatedPilot;
use skein_core::plant::{Command, Controls, Frame, GroundTruth, Measurement, PlantStatus};
use skein_core::station::{Clocks, Entering, Station};

use super::script::{self, ScriptedAction};
use crate::faults::Schedule;

/// The messages that the agents of all vehicles receive in a tick and take in place.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Arriving<'a> {
    /// The messages to all vehicles of the swarm.
    pub(super) broadcast: Broadcast<'a>,
    /// The network from other teams.
    pub(super) strangers: Option<&'a StrangerNetwork>,
}

/// One vehicle with its agent.
#[derive(Debug)]
pub(super) struct Vehicle {
    pub(super) id: VehicleId,
    pub(super) aircraft: Aircraft,
    pub(super) plant: BuiltInPlant,
    /// Failures of the plant.
    pub(super) script: Script,
    /// All other scripted actions on the vehicle.
    pub(super) actions: Schedule<ScriptedAction>,
    clock_jumps: Schedule<f64>,
    /// The station with the agent; `None` while the agent is dead.
    pub(super) station: Option<Station>,
    /// Whether the agent takes the messages to all vehicles in place in this frame.
    pub(super) takes_broadcast: bool,
    /// Incarnation of the agent, or of the last one.
    pub(super) incarnation: Incarnation,
    /// Clocks while no station runs; a running station has its own.
    pub(super) clocks: Clocks,
    /// Answer of the external law for the next step.
    pub(super) answer: Option<LawReply>,
    /// The reasons why other things that the law sent were refused.
    pub(super) refusals: VecDeque<ShortText>,
    /// The newest heartbeat, which a restarted agent receives first.
    pub(super) heartbeat: Option<Heartbeat>,
    pub(super) truth: GroundTruth,
    /// Plant time of the last frame.
    pub(super) plant_time: PlantTime,
    pub(super) command: Option<Command>,
    /// The command that moves the plant in this frame: the agent's, or that of a pilot.
    pub(super) moved_by: Option<Command>,
    /// Flies the vehicle while its agent has released it.
    pub(super) human: SimulatedPilot,
    /// Controls that replace the agent's command.
    pub(super) pilot: Option<Controls>,
    /// Whether the simulator stands still in this frame.
    pub(super) simulator_frozen: bool,
}

impl Vehicle {
    pub(super) fn new(
        scenario: &Scenario,
        id: VehicleId,
        aircraft: Aircraft,
        rules: &Rules,
        plant: BuiltInPlant,
    ) -> Result<Self, UnsupportedScenario> {
        let human = SimulatedPilot::new(scenario, &aircraft, rules);
        let mut vehicle = Self {
            id,
            aircraft,
            truth: plant.frame().truth,
            plant,
            script: Script::of(&scenario.mission.events, id),
            actions: script::actions(scenario, id),
            clock_jumps: script::clock_jumps(scenario, id),
            station: None,
            takes_broadcast: false,
            incarnation: Incarnation(1),
            clocks: Clocks::new(scenario, id),
            answer: None,
            refusals: VecDeque::new(),
            heartbeat: None,
            plant_time: PlantTime::ZERO,
            command: None,
            moved_by: None,
            human,
            pilot: None,
            simulator_frozen: false,
        };
        vehicle.clocks.jump(script::clock_begins_s(scenario, id));
        vehicle.station = Some(vehicle.new_station(scenario, rules)?);
        Ok(vehicle)
    }

    pub(super) fn new_station(&self, scenario: &Scenario, rules: &Rules) -> Result<Station, UnsupportedScenario> {
        Station::new(scenario, self.id, self.incarnation, (&self.aircraft, rules.clone()), self.clocks)
    }

    /// Makes the agent receive its messages from the networks of the whole swarm.
    pub(super) fn join(&mut self, network: Option<&mut SwarmNetwork>, strangers: Option<&mut StrangerNetwork>) {
        let Some(station) = &mut self.station else { return };
        if let Some(network) = network {
            station.share_inbox();
            network.begin(self.id);
        }
        if let Some(strangers) = strangers {
            station.share_strangers();
            strangers.begin(self.id);
        }
    }

    /// The agent, if it runs.
    pub(super) fn agent(&self) -> Option<&Agent> {
        self.station.as_ref().map(Station::agent)
    }

    /// The vehicle's clocks, which run on while the agent is dead.
    pub(super) fn clocks(&self) -> &Clocks {
        self.station.as_ref().map_or(&self.clocks, Station::clocks)
    }

    /// Carries out the jumps of the vehicle's clock that are due now.
    pub(super) fn let_clock_jump(&mut self, now: LocalTime) {
        while let Some(by_s) = self.clocks().flown_s(now).and_then(|flown_s| self.clock_jumps.due(flown_s)) {
            match &mut self.station {
                Some(station) => station.clock_jumps(by_s),
                None => self.clocks.jump(by_s),
            }
        }
    }

    /// Takes the next action on the vehicle that is due now.
    pub(super) fn due(&mut self, now: LocalTime) -> Option<ScriptedAction> {
        self.actions.due(self.clocks().flown_s(now)?)
    }

    /// The plant's frame under its present failures.
    pub(super) fn frame(&mut self, now: LocalTime) -> Frame {
        let script = self.clocks().flown_s(now).map(|flown_s| self.script.at(flown_s)).unwrap_or_default();
        self.plant.fail(script.failures);
        let frame = self.plant.frame();
        (self.truth, self.plant_time) = (frame.truth, frame.time);
        self.simulator_frozen = script.simulator_frozen;
        frame
    }

    /// Steps the agent, if it runs; it takes the messages to all vehicles if it may.
    pub(super) fn step(
        &mut self,
        now: LocalTime,
        plant: (PlantTime, Option<&Measurement>),
        arriving: Arriving<'_>,
        workspace: &mut Workspace,
    ) -> Option<Outputs> {
        let station = self.station.as_mut()?;
        let status = PlantStatus { controls: self.moved_by.and_then(Command::controls), ..PlantStatus::default() };
        let (answer, refusal) = (self.answer.take(), self.refusals.pop_front());
        let broadcast = if self.takes_broadcast { arriving.broadcast } else { Broadcast::default() };
        let answer = answer.as_ref();
        let entering =
            Entering { broadcast, strangers: arriving.strangers, answer, ..Entering::of_plant(now, plant, &status) };
        let mut outputs = station.step(&entering, workspace);
        outputs.outbox.happened.extend(refusal.map(EventKind::LawAnswerRefused));
        Some(outputs)
    }

    pub(super) fn trace(&mut self, now: LocalTime) -> Option<Trace> {
        Some(self.station.as_mut()?.trace(now, self.plant_time, &self.truth))
    }
}
