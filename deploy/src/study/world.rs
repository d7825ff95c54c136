//! A whole swarm in one thread and in virtual time: the same agents that fly in real time, over an ideal network.
//!
//! One tick is one frame of every vehicle. What is said in a tick is heard in the next, by everybody, through the same
//! encoding as on the wire.

use std::mem;

use skein_agent::agent::{Agent, Inputs, Outputs};
use skein_agent::aircraft::Aircraft;
use skein_agent::control::Rules;
use skein_agent::peers::{Heard, Word};
use skein_agent::plant::helicopter::{BuiltInVehicle, TICK_S, Weather};
use skein_agent::plant::{Sticks, Truth};
use skein_agent::start::starts;
use skein_common::frame::Origin;
use skein_common::id::{Incarnation, VehicleId};
use skein_common::message::{self, Message};
use skein_common::scenario::Scenario;
use skein_common::state::Membership;
use skein_common::time::{LocalTime, Now};

use super::StudyError;

/// A swarm in virtual time.
#[derive(Debug)]
pub struct World {
    vehicles: Vec<Vehicle>,
    said: Vec<(VehicleId, Word)>,
    ticks: u64,
}

/// One vehicle with its agent.
#[derive(Debug)]
struct Vehicle {
    id: VehicleId,
    plant: BuiltInVehicle,
    agent: Agent,
    /// Whether its agent still runs. Without, the helicopter flies on with its last controls.
    runs: bool,
    truth: Truth,
    command: Option<Sticks>,
    heard: Vec<Heard>,
}

impl World {
    /// The swarm of this scenario on the ground.
    pub fn new(scenario: &Scenario, aircraft: &[Aircraft], rules: &Rules) -> Result<Self, StudyError> {
        let origin = Origin::new(scenario.origin.geodetic());
        let weather = Weather::from(&scenario.world);
        let starts = starts(scenario)?;
        let vehicles = scenario.ids().zip(&starts).zip(aircraft).map(|((id, start), aircraft)| {
            let parameters = aircraft.helicopter.as_ref().ok_or(StudyError::NoModel(id))?;
            let plant = BuiltInVehicle::new(&origin, parameters, start, &weather, scenario.seed, id);
            let agent = Agent::new(scenario, id, Incarnation(1), aircraft, rules.clone())?;
            let truth = plant.frame().truth;
            Ok(Vehicle { id, plant, agent, runs: true, truth, command: None, heard: Vec::new() })
        });
        let vehicles = vehicles.collect::<Result<Vec<_>, StudyError>>()?;
        let said = scenario.ids().map(|id| (id, Word::Appeared(id))).collect();
        Ok(Self { vehicles, said, ticks: 0 })
    }

    /// One frame of everybody.
    pub fn tick(&mut self) {
        let local = LocalTime::from_nanoseconds(self.ticks * (TICK_S * 1e9) as u64);
        self.deliver(local);
        for vehicle in &mut self.vehicles {
            let frame = vehicle.plant.frame();
            vehicle.truth = frame.truth;
            if !vehicle.runs {
                vehicle.plant.advance(None);
                continue;
            }
            let now = Now { plant: frame.time, local };
            let inputs = Inputs { measurement: Some(&frame.measurement), heard: &vehicle.heard, leave: false };
            let Outputs { command, said } = vehicle.agent.step(now, &inputs);
            vehicle.command = command;
            self.said.extend(said.state.map(|state| (vehicle.id, Word::State(through_wire(&state)))));
            self.said.extend(said.mission.map(|mission| (vehicle.id, Word::Mission(through_wire(&mission)))));
            vehicle.plant.advance(command);
        }
        self.ticks += 1;
    }

    /// The agent of this vehicle ends without a word, as by `kill -9`: its token is gone for the others in the next tick.
    pub fn kill(&mut self, id: VehicleId) {
        for vehicle in self.vehicles.iter_mut().filter(|vehicle| vehicle.id == id && vehicle.runs) {
            vehicle.runs = false;
            self.said.push((id, Word::Vanished(id)));
        }
    }

    /// Seconds since the beginning.
    pub fn t_s(&self) -> f64 {
        self.ticks as f64 * TICK_S
    }

    /// Everybody whose agent runs takes part.
    pub fn all_active(&self) -> bool {
        self.vehicles().all(|(_, agent, ..)| agent.membership() == Membership::Active)
    }

    /// Every agent that runs, how its vehicle really was in the last frame, and what was done with the controls.
    pub fn vehicles(&self) -> impl Iterator<Item = (VehicleId, &Agent, &Truth, Option<Sticks>)> {
        let running = self.vehicles.iter().filter(|vehicle| vehicle.runs);
        running.map(|vehicle| (vehicle.id, &vehicle.agent, &vehicle.truth, vehicle.command))
    }

    /// What was said in the last tick arrives with everybody else.
    fn deliver(&mut self, at: LocalTime) {
        let said = mem::take(&mut self.said);
        for vehicle in &mut self.vehicles {
            vehicle.heard.clear();
            let others = said.iter().filter(|(speaker, _)| *speaker != vehicle.id);
            vehicle.heard.extend(others.map(|&(_, word)| Heard { word, at }));
        }
        self.said = said;
        self.said.clear();
    }
}

/// What arrives of a message.
fn through_wire<M: Message>(said: &M) -> M {
    // An agent says nothing that it would not itself believe; if it did, the study is wrong and must not go on.
    #[expect(clippy::expect_used, reason = "a message of ours that does not decode is a bug")]
    message::decode(&message::encode(said)).expect("what an agent says can be heard")
}
