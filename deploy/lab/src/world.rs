//! A whole swarm in one thread and in virtual time: the same agents that fly in real time, over the scenario's network
//! and under its faults.
//!
//! One tick is one frame of every vehicle. What is said in a tick is heard in the next, by everybody, through the same
//! encoding as on the wire and through each receiver's [`Station`](skein_core::station::Station). What the scenario does to the swarm it does between hearing
//! and stepping.
//!
//! Where the agents run is the driver's to say (`world/driver.rs`): beside their vehicles, or on the one machine of
//! `control.mode = "central"` (`world/central.rs`).

mod central;
mod driver;
mod script;
mod vehicle;

use std::mem;

use skein_common::frame::Origin;
use skein_common::id::VehicleId;
use skein_common::message::{self, Happening, Message, Trace};
use skein_common::scenario::{ControlMode, Scenario};
use skein_common::state::Membership;
use skein_common::time::LocalTime;
use skein_core::agent::Agent;
use skein_core::aircraft::Aircraft;
use skein_core::control::Rules;
use skein_core::formation::external::{Answer, Ask};
use skein_core::formation::{self, NotFlown};
use skein_core::helicopter::{BuiltInVehicle, TICK_S, Weather};
use skein_core::peers::{Heard, Word};
use skein_core::plant::{Sticks, Truth};
use skein_core::start::{TooFull, starts};

use crate::faults::{Incident, LinkChanges};
use crate::metrics::Totals;
use central::Central;
use driver::{Beside, Driver};
use script::{Deed, Operator};
use vehicle::Vehicle;

/// Nanoseconds of a tick.
const TICK_NS: u64 = (TICK_S * 1e9) as u64;

/// Why a swarm cannot be flown in virtual time.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// The scenario asks for what is not flown.
    #[error(transparent)]
    NotFlown(#[from] NotFlown),
    /// The starts do not fit.
    #[error(transparent)]
    Starts(#[from] TooFull),
    /// This vehicle's aircraft has no flight model.
    #[error("vehicle {0}: its aircraft has no [helicopter] table, so only X-Plane can fly it")]
    NoModel(VehicleId),
}

/// A swarm in virtual time.
#[derive(Debug)]
pub struct World {
    /// As the agents fly it.
    scenario: Scenario,
    rules: Rules,
    vehicles: Vec<Vehicle>,
    driver: Box<dyn Driver>,
    operator: Operator,
    /// What was said since everybody last heard.
    said: Vec<Said>,
    /// What external laws were asked since anybody took it.
    asks: Vec<Ask>,
    happened: Vec<(VehicleId, Happening)>,
    incidents: Vec<Incident>,
    /// What was done since the last tick.
    done: Vec<Incident>,
    /// Of agents that have ended.
    ended: Totals,
    ticks: u64,
}

/// A word on its way.
#[derive(Debug)]
struct Said {
    /// `None` for the operator.
    speaker: Option<VehicleId>,
    /// `None` for everybody.
    hearer: Option<VehicleId>,
    word: Word,
}

impl World {
    /// The swarm of this scenario on the ground.
    ///
    /// # Errors
    /// If the scenario asks for what is not flown.
    pub fn new(scenario: &Scenario, aircraft: &[Aircraft], rules: &Rules) -> Result<Self, WorldError> {
        formation::check(scenario)?;
        let driver: Box<dyn Driver> = match scenario.control.mode {
            ControlMode::Each => Box::new(Beside),
            ControlMode::Central => Box::new(Central::new(scenario)),
        };
        let scenario = &driver.as_agents_see_it(scenario);
        let (origin, weather) = (Origin::new(scenario.origin.geodetic()), Weather::from(&scenario.world));
        let starts = starts(scenario)?;
        let vehicles = scenario.ids().zip(&starts).zip(aircraft).map(|((id, start), aircraft)| {
            let parameters = aircraft.helicopter.as_ref().ok_or(WorldError::NoModel(id))?;
            let plant = BuiltInVehicle::new(&origin, parameters, start, &weather, scenario.seed, id);
            let known = driver.as_agents_know_it(aircraft);
            Ok(Vehicle::new(scenario, id, known, rules, plant)?)
        });
        let vehicles = vehicles.collect::<Result<Vec<_>, WorldError>>()?;
        Ok(Self {
            vehicles,
            driver,
            said: scenario.ids().map(|id| Said::to_all(id, Word::Appeared(id))).collect(),
            operator: Operator::new(scenario),
            scenario: scenario.clone(),
            rules: rules.clone(),
            asks: Vec::new(),
            happened: Vec::new(),
            incidents: Vec::new(),
            done: Vec::new(),
            ended: Totals::default(),
            ticks: 0,
        })
    }

    /// One frame of everybody.
    pub fn tick(&mut self) {
        self.happened.clear();
        self.incidents.clear();
        self.incidents.append(&mut self.done);
        let now = LocalTime::from_nanoseconds(self.ticks * TICK_NS);
        self.deliver(now);
        self.follow_script(now);
        let Self { vehicles, driver, said, asks, happened, .. } = self;
        driver.frame(now, vehicles, &mut |vehicle, outbox, ask| {
            let id = vehicle.id;
            asks.extend(ask);
            said.extend(outbox.state.map(|state| Said::to_all(id, Word::State(through_wire(&state)))));
            if let Some(mission) = outbox.mission {
                vehicle.register = Some(through_wire(&mission));
                said.extend(vehicle.register.map(|mission| Said::to_all(id, Word::Mission(mission))));
            }
            happened.extend(outbox.happened.into_iter().map(|what| (id, what)));
        });
        self.ticks += 1;
    }

    /// The agent of this vehicle ends without a word, as by `kill -9`: its token is gone for the others in the next tick.
    pub fn kill(&mut self, id: VehicleId) {
        if let Some(index) = self.vehicles.iter().position(|vehicle| vehicle.id == id) {
            self.end(index);
        }
    }

    /// What external laws were asked since the last call, by vehicle.
    pub fn take_asks(&mut self) -> Vec<Ask> {
        mem::take(&mut self.asks)
    }

    /// What the law of a vehicle has answered: its agent learns of it in the next tick.
    pub fn answer(&mut self, answer: Answer) {
        if let Some(vehicle) = self.vehicles.iter_mut().find(|vehicle| vehicle.id == answer.vehicle) {
            vehicle.answer = Some(answer);
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

    /// Nobody who still takes part has anything of the mission left but to land.
    pub fn has_finished(&self) -> bool {
        self.vehicles().count() > 0 && self.vehicles().all(|(_, agent, ..)| agent.has_finished())
    }

    /// Every agent that runs, how its vehicle really was in the last frame, and what was done with the controls.
    pub fn vehicles(&self) -> impl Iterator<Item = (VehicleId, &Agent, &Truth, Option<Sticks>)> {
        self.everybody().filter_map(|(id, agent, truth, sticks)| Some((id, agent?, truth, sticks)))
    }

    /// Every vehicle: its agent if one runs, how it really was in the last frame, and what the agent did with the controls.
    pub fn everybody(&self) -> impl Iterator<Item = (VehicleId, Option<&Agent>, &Truth, Option<Sticks>)> {
        self.vehicles.iter().map(|vehicle| (vehicle.id, vehicle.agent(), &vehicle.truth, vehicle.command))
    }

    /// The last tick's step of every agent that runs.
    pub fn traces(&mut self) -> impl Iterator<Item = Trace> {
        let now = LocalTime::from_nanoseconds(self.ticks.saturating_sub(1) * TICK_NS);
        self.vehicles.iter_mut().filter_map(move |vehicle| vehicle.trace(now))
    }

    /// What the agents told of themselves in the last tick.
    pub fn happened(&self) -> &[(VehicleId, Happening)] {
        &self.happened
    }

    /// What was done to the swarm in the last tick.
    pub fn incidents(&self) -> &[Incident] {
        &self.incidents
    }

    /// What all agents together have counted, those that have ended included.
    ///
    /// Of states it is what crossed the network: under one machine states and controls.
    pub fn totals(&self) -> Totals {
        let totals = self.vehicles().fold(self.ended, |totals, (_, agent, ..)| with_counts(totals, agent));
        self.driver.totals(totals)
    }

    /// What was said in the last tick arrives with everybody else who lives.
    fn deliver(&mut self, now: LocalTime) {
        if !self.driver.listens(now) {
            return;
        }
        let mut said = mem::take(&mut self.said);
        for vehicle in self.vehicles.iter_mut().filter(|vehicle| vehicle.station.is_some()) {
            let id = vehicle.id;
            let is_for_it = |said: &&Said| said.speaker != Some(id) && said.hearer.is_none_or(|hearer| hearer == id);
            vehicle.hear(now, said.iter().filter(is_for_it).map(|said| Heard { word: said.word, at: now }));
        }
        said.clear();
        self.said = said;
    }

    /// Does what is due.
    fn follow_script(&mut self, now: LocalTime) {
        let mut changes = LinkChanges::default();
        for index in 0..self.vehicles.len() {
            let id = self.vehicles[index].id;
            while let Some(deed) = self.vehicles[index].due(now) {
                match deed {
                    Deed::Kill => self.end(index),
                    Deed::Restart => self.restart(index),
                    Deed::Fail(what) => self.done.push(Incident::Failed(id, what)),
                    Deed::Jump(by_s) => self.vehicles[index].clock_jumps(by_s),
                    Deed::Link(change, sender) => changes.add(change, (sender, id)),
                }
            }
        }
        self.done.extend(changes.incidents());
        if let Some(t_s) = self.flown_s(now) {
            self.strike_all(t_s);
            self.order(t_s);
        }
        self.incidents.append(&mut self.done);
    }

    /// Since the first take-off, s: the operator's clock and the one machine's begin with it.
    fn flown_s(&self, now: LocalTime) -> Option<f64> {
        self.vehicles.iter().filter_map(|vehicle| vehicle.clocks().flown_s(now)).reduce(f64::max)
    }

    /// Does what happens to all agents at once.
    fn strike_all(&mut self, t_s: f64) {
        while let Some(deed) = self.driver.due(t_s) {
            for index in 0..self.vehicles.len() {
                if deed == Deed::Kill { self.end(index) } else { self.restart(index) }
            }
        }
    }

    fn order(&mut self, t_s: f64) {
        let repeats = |vehicle: &Vehicle, order| vehicle.register.is_some_and(|register| register.order >= Some(order));
        let living = self.vehicles.iter().filter(|vehicle| vehicle.station.is_some());
        let order = self.operator.says(t_s, |order| living.clone().all(|vehicle| repeats(vehicle, *order)));
        self.said.extend(order.map(|order| Said {
            speaker: None,
            hearer: None,
            word: Word::Order(through_wire(&order)),
        }));
    }

    fn end(&mut self, index: usize) {
        let vehicle = &mut self.vehicles[index];
        let Some(station) = vehicle.station.take() else { return };
        vehicle.clocks = *station.clocks();
        (vehicle.register, vehicle.command, vehicle.answer) = (None, None, None);
        self.ended = with_counts(self.ended, station.agent());
        self.said.push(Said::to_all(vehicle.id, Word::Vanished(vehicle.id)));
        self.done.push(Incident::Died(vehicle.id));
    }

    /// A new life finds the tokens of those who live and their registers.
    fn restart(&mut self, index: usize) {
        let vehicle = &mut self.vehicles[index];
        if vehicle.station.is_some() {
            return;
        }
        vehicle.incarnation.0 += 1;
        let station = vehicle.new_station(&self.scenario, &self.rules);
        // A study whose scenario is refused never begins.
        #[expect(clippy::expect_used, reason = "the same scenario made the first agent")]
        let station = station.expect("a scenario that was flown");
        vehicle.station = Some(station);
        let newborn = vehicle.id;
        self.said.push(Said::to_all(newborn, Word::Appeared(newborn)));
        for other in self.vehicles.iter().filter(|other| other.id != newborn && other.station.is_some()) {
            let words = [Some(Word::Appeared(other.id)), other.register.map(Word::Mission)];
            let to_newborn = |word| Said { speaker: Some(other.id), hearer: Some(newborn), word };
            self.said.extend(words.into_iter().flatten().map(to_newborn));
        }
        self.done.push(Incident::Restarted(newborn));
    }
}

impl Said {
    fn to_all(speaker: VehicleId, word: Word) -> Self {
        Self { speaker: Some(speaker), hearer: None, word }
    }
}

fn with_counts(totals: Totals, agent: &Agent) -> Totals {
    let (messages, bytes) = agent.states_sent();
    let activations = agent.safety_activations().map(|more| more + totals.safety_activations.unwrap_or(0));
    let misses = agent.law_misses().map(|more| more + totals.law_misses.unwrap_or(0));
    Totals {
        state_messages: totals.state_messages + messages,
        state_bytes: totals.state_bytes + bytes,
        safety_activations: activations.or(totals.safety_activations),
        law_misses: misses.or(totals.law_misses),
        ..totals
    }
}

/// What arrives of a message.
fn through_wire<M: Message>(said: &M) -> M {
    // An agent says nothing that it would not itself believe; if it did, the study is wrong and must not go on.
    #[expect(clippy::expect_used, reason = "a message of ours that does not decode is a bug")]
    message::decode(&message::encode(said)).expect("what an agent says can be heard")
}
