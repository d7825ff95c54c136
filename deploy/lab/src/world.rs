//! Simulates a whole swarm in virtual time, in one thread or several: the same agents that fly in real time, over the
//! scenario's network and under its faults.
//!
//! One tick is one frame of every vehicle. A message sent in a tick is received in the next one by all other agents. It
//! passes through the same encoding as on the wire. Over a perfect network, agents that have received the same share the
//! records of it ([`SharedRecords`]); over another, or by wrong clocks, they read the inbox of the swarm ([`SwarmNetwork`]).
//! Clocks jump before the agents receive messages; all other faults are injected after that and before they step.
//!
//! The agents run beside their vehicles (`world/beside.rs`), or in the central controller of `control.mode = "central"`
//! (`world/central.rs`).

mod beside;
mod central;
mod events;
mod script;
mod vehicle;

use std::mem;
use std::num::NonZeroUsize;

use skein_common::frame::Origin;
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::{self, EventKind, Intent, Message, ShortText, Trace};
use skein_common::scenario::{ControlMode, Scenario};
use skein_common::state::Membership;
use skein_common::time::LocalTime;
use skein_core::agent::Agent;
use skein_core::aircraft::Aircraft;
use skein_core::builtin::{BuiltInPlant, NoFlightModel};
use skein_core::control::Rules;
use skein_core::formation::external::{LawQuery, LawReply};
use skein_core::formation::{self, UnsupportedScenario, Workspace};
use skein_core::helicopter::{BuiltInVehicle, TICK_S};
use skein_core::impairments::{ReceiverPosition, StrangerNetwork, SwarmNetwork};
use skein_core::intent::ReceivedIntent;
use skein_core::outbox::Outbox;
use skein_core::peers::{Broadcast, PeerMessage, Received, ReceivedState, SharedRecords};
use skein_core::plant::{Command, Controls, Frame, GroundTruth};
use skein_core::start::{StartAreaTooSmall, starts};
use skein_core::station::Station;
use skein_core::strangers::StrangerState;
use skein_host::blocks::Blocks;
use skein_host::parallel::at_once;

use crate::faults::{InjectedFault, LinkChanges};
use crate::metrics::Totals;
use central::Central;
use events::Events;

use script::{Operator, ScriptedAction};
use vehicle::{Arriving, Vehicle};

/// Length of a tick, ns.
const TICK_NS: u64 = (TICK_S * 1e9) as u64;

/// The reason why a swarm cannot fly in virtual time.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// This build does not support the scenario.
    #[error(transparent)]
    UnsupportedScenario(#[from] UnsupportedScenario),
    /// The start area is too small for the vehicles.
    #[error(transparent)]
    Starts(#[from] StartAreaTooSmall),
    /// This vehicle's aircraft has no flight model.
    #[error("vehicle {0}: {1}, so only X-Plane can fly it")]
    NoModel(VehicleId, NoFlightModel),
}

/// A swarm in virtual time.
#[derive(Debug)]
pub struct World {
    /// The scenario as the agents receive it.
    scenario: Scenario,
    rules: Rules,
    origin: Origin,
    vehicles: Vec<Vehicle>,
    /// Room for the flight models, for each thread.
    blocks: Vec<Blocks>,
    /// The central controller, if one flies all vehicles.
    central: Option<Box<Central>>,
    /// Room for the agents beside their vehicles, for each thread.
    workspaces: Vec<Workspace>,
    operator: Operator,
    /// Messages to all vehicles that were sent since the agents last received, and those that the agents receive now.
    in_flight: Vec<PeerMessage>,
    arriving: Vec<PeerMessage>,
    /// The knowledge of each other that all agents share which have received every message to all vehicles.
    records: SharedRecords,
    /// The network between all vehicles; `None` if it is perfect, or if each agent needs impairments of its own.
    network: Option<Box<SwarmNetwork>>,
    /// The network from other teams, if the swarm is a team of a fleet.
    strangers: Option<Box<StrangerNetwork>>,
    /// Intents that the agents have sent in the last tick.
    intents: Vec<Intent>,
    /// Messages to one vehicle, a restarted one, that were sent since the agents last received.
    to_one: Vec<(VehicleId, PeerMessage)>,
    /// Queries to external laws since the last call of [`Self::take_asks`].
    asks: Vec<LawQuery>,
    events: Events,
    faults: Vec<InjectedFault>,
    /// Faults that were injected since the last tick.
    pending_faults: Vec<InjectedFault>,
    /// Counters of agents that have ended.
    ended_totals: Totals,
    ticks: u64,
}

impl World {
    /// Creates the swarm of this scenario, on the ground.
    ///
    /// # Errors
    /// This build does not support the scenario, its vehicles do not fit into the start area, or an aircraft has no
    /// flight model.
    pub fn new(scenario: &Scenario, aircraft: &[Aircraft], rules: &Rules) -> Result<Self, WorldError> {
        Self::over(SwarmNetwork::new(scenario, TICK_NS), scenario, aircraft, rules)
    }

    /// [`Self::new`] over this network between all vehicles. Without one each agent has the impairments of its own.
    fn over(
        network: Option<SwarmNetwork>,
        scenario: &Scenario,
        aircraft: &[Aircraft],
        rules: &Rules,
    ) -> Result<Self, WorldError> {
        formation::check(scenario)?;
        let is_central = scenario.control.mode == ControlMode::Central;
        let central = is_central.then(|| Box::new(Central::new(scenario)));
        let scenario = &if is_central { Central::scenario_of_agents(scenario) } else { scenario.clone() };
        let starts = starts(scenario)?;
        let vehicles = scenario.ids().zip(&starts).zip(aircraft).map(|((id, start), aircraft)| {
            let plant = BuiltInPlant::new(scenario, id, aircraft, start).map_err(|why| WorldError::NoModel(id, why))?;
            let known = if is_central { Central::aircraft_of_agents(aircraft) } else { aircraft.clone() };
            Ok(Vehicle::new(scenario, id, known, rules, plant)?)
        });
        let mut vehicles = vehicles.collect::<Result<Vec<_>, WorldError>>()?;
        let mut network = network.map(Box::new);
        let mut strangers = scenario.team.map(|_| Box::new(StrangerNetwork::new(scenario)));
        vehicles.iter_mut().for_each(|vehicle| vehicle.join(network.as_deref_mut(), strangers.as_deref_mut()));
        Ok(Self {
            vehicles,
            blocks: vec![Blocks::default()],
            central,
            workspaces: vec![Workspace::default()],
            origin: Origin::new(scenario.origin.geodetic()),
            in_flight: scenario.ids().map(PeerMessage::Appeared).collect(),
            arriving: Vec::new(),
            records: SharedRecords::new(scenario),
            network,
            strangers,
            intents: Vec::new(),
            to_one: Vec::new(),
            operator: Operator::new(scenario),
            scenario: scenario.clone(),
            rules: rules.clone(),
            asks: Vec::new(),
            events: Events::default(),
            faults: Vec::new(),
            pending_faults: Vec::new(),
            ended_totals: Totals::default(),
            ticks: 0,
        })
    }

    /// Simulates one frame of every vehicle.
    pub fn tick(&mut self) {
        self.step_agents();
        let share = self.vehicles.len().div_ceil(self.blocks.len()).next_multiple_of(Blocks::SIZE);
        match self.blocks.as_mut_slice() {
            [blocks] => blocks.advance(plants(&mut self.vehicles)),
            blocks => {
                let shares = blocks.iter_mut().zip(self.vehicles.chunks_mut(share));
                at_once(shares.map(|(blocks, vehicles)| || blocks.advance(plants(vehicles))));
            }
        }
    }

    /// From now on steps the world in this many threads; in one without this call. The flight does not depend on it.
    pub fn set_threads(&mut self, threads: NonZeroUsize) {
        self.blocks.resize_with(threads.get(), Blocks::default);
        self.workspaces.resize_with(threads.get(), Workspace::default);
    }

    /// The number of threads that step the world.
    pub(crate) fn threads(&self) -> NonZeroUsize {
        NonZeroUsize::new(self.blocks.len()).unwrap_or(NonZeroUsize::MIN)
    }

    /// Simulates one frame of every vehicle of each of these worlds, as [`Self::tick`] does for one, in common blocks.
    pub(crate) fn tick_together<'a>(worlds: impl Iterator<Item = &'a mut Self>, blocks: &mut Blocks) {
        blocks.advance(worlds.flat_map(|world| {
            world.step_agents();
            plants(&mut world.vehicles)
        }));
    }

    /// Simulates the agents' part of one frame.
    fn step_agents(&mut self) {
        self.events.clear();
        self.faults.clear();
        self.faults.append(&mut self.pending_faults);
        let now = self.now();
        self.vehicles.iter_mut().for_each(|vehicle| vehicle.let_clock_jump(now));
        self.deliver(now);
        self.follow_script(now);
        self.intents.clear();
        let Self { vehicles, origin, in_flight, arriving, records, network, strangers, intents, asks, events, .. } =
            self;
        let broadcast = match network {
            Some(network) => Broadcast { inbox: Some(network.inbox()), ..Broadcast::default() },
            None => Broadcast { messages: arriving, records: Some(records), inbox: None },
        };
        let arriving = Arriving { broadcast, strangers: strangers.as_deref() };
        let mut take = |vehicle: &mut Vehicle, outbox: Outbox, ask: Option<Box<LawQuery>>| {
            let id = vehicle.id;
            asks.extend(ask.map(|ask| *ask));
            let state = outbox.state.map(|state| ReceivedState::new(through_wire(&*state), origin));
            in_flight.extend(state.map(PeerMessage::State));
            if let Some(mission) = outbox.mission {
                vehicle.heartbeat = Some(through_wire(&*mission));
                in_flight.extend(vehicle.heartbeat.map(PeerMessage::Mission));
            }
            intents.extend(outbox.intent.map(|intent| through_wire(&*intent)));
            events.add(id, outbox.happened);
        };
        match &mut self.central {
            Some(central) => central.frame(now, arriving, vehicles, &mut take),
            None => beside::frame(now, arriving, vehicles, &mut self.workspaces, &mut take),
        }
        for vehicle in vehicles.iter_mut() {
            let by_human = vehicle.human.fly(vehicle.command, || vehicle.plant.frame());
            vehicle.moved_by = vehicle.pilot.map(Command::Controls).or(by_human);
        }
        self.arriving.clear();
        self.ticks += 1;
    }

    /// The states that the agents have sent in the last tick.
    pub(crate) fn states_in_flight(&self) -> impl Iterator<Item = &ReceivedState> {
        self.in_flight
            .iter()
            .filter_map(|message| if let PeerMessage::State(state) = message { Some(state) } else { None })
    }

    /// The intents that the agents have sent in the last tick.
    pub(crate) fn intents(&self) -> &[Intent] {
        &self.intents
    }

    /// Hands over states and intents of other teams with the vehicles that receive them, in the next tick at the earliest.
    pub(crate) fn receive_strangers(
        &mut self,
        states: &[(StrangerState, VehicleSet)],
        intents: &[(ReceivedIntent, VehicleSet)],
    ) {
        let (now, vehicles) = (self.now(), &self.vehicles);
        let Some(strangers) = &mut self.strangers else { return };
        let agents = vehicles.iter().filter_map(|vehicle| Some((vehicle.id, vehicle.agent()?)));
        strangers.set_receivers(agents.map(|(id, agent)| (id, agent.position(), agent.strangers_reach_m())));
        states.iter().for_each(|(state, receivers)| strangers.send(state, now, *receivers));
        intents.iter().for_each(|(intent, receivers)| strangers.send_intent(intent, now, *receivers));
    }

    /// Ends the agent of this vehicle without a message, as by `kill -9`: its liveliness token vanishes in the next
    /// tick.
    pub fn kill(&mut self, id: VehicleId) {
        if let Some(index) = self.vehicles.iter().position(|vehicle| vehicle.id == id) {
            self.end(index);
        }
    }

    /// Takes the queries that the agents have sent to external laws since the last call.
    pub fn take_asks(&mut self) -> Vec<LawQuery> {
        mem::take(&mut self.asks)
    }

    /// Accepts the answer of a vehicle's external law: its agent receives it in the next tick.
    pub fn answer(&mut self, answer: LawReply) {
        if let Some(vehicle) = self.vehicle_mut(answer.vehicle) {
            vehicle.answer = Some(answer);
        }
    }

    /// Notes the reason why a message of this vehicle's law was refused: its agent reports one reason a tick.
    pub fn refuse(&mut self, id: VehicleId, reason: ShortText) {
        if let Some(vehicle) = self.vehicle_mut(id) {
            vehicle.refusals.push_back(reason);
        }
    }

    /// From now on flies a helicopter by these controls, whatever its agent commands; by its agent again with `None`.
    pub fn set_controls(&mut self, id: VehicleId, controls: Option<Controls>) {
        if let Some(vehicle) = self.vehicle_mut(id) {
            vehicle.pilot = controls;
        }
    }

    fn vehicle_mut(&mut self, id: VehicleId) -> Option<&mut Vehicle> {
        self.vehicles.iter_mut().find(|vehicle| vehicle.id == id)
    }

    /// Every vehicle: its agent if one runs, and the plant's frame that the next tick begins with.
    pub fn frames(&self) -> impl Iterator<Item = (VehicleId, Option<&Agent>, Frame)> {
        self.vehicles.iter().map(|vehicle| (vehicle.id, vehicle.agent(), vehicle.plant.frame()))
    }

    /// Number of vehicles.
    pub(crate) fn vehicle_count(&self) -> usize {
        self.vehicles.len()
    }

    /// Number of heartbeats sent by the agents that run, and their payload, bytes.
    pub(crate) fn heartbeats_sent(&self) -> (u64, u64) {
        let counts = self.vehicles().map(|(_, agent, ..)| agent.heartbeats_sent());
        counts.fold((0, 0), |sum, of_one| (sum.0 + of_one.0, sum.1 + of_one.1))
    }

    /// The correct time of the next tick.
    pub(crate) fn now(&self) -> LocalTime {
        LocalTime::from_nanoseconds(self.ticks * TICK_NS)
    }

    /// Time since the first take-off, s.
    pub(crate) fn since_take_off_s(&self) -> Option<f64> {
        self.flown_s(self.now())
    }

    /// Time since the beginning, s.
    pub fn t_s(&self) -> f64 {
        self.ticks as f64 * TICK_S
    }

    /// Whether every running agent is an active member.
    pub fn all_active(&self) -> bool {
        self.vehicles().all(|(_, agent, ..)| agent.membership() == Membership::Active)
    }

    /// Whether every running agent has finished the mission except for its landing.
    pub fn has_finished(&self) -> bool {
        self.vehicles().count() > 0 && self.vehicles().all(|(_, agent, ..)| agent.has_finished())
    }

    /// Every vehicle whose agent runs: the agent, the ground truth of the last frame, and the controls of a helicopter.
    pub fn vehicles(&self) -> impl Iterator<Item = (VehicleId, &Agent, &GroundTruth, Option<Controls>)> {
        self.all_vehicles().filter_map(|(id, agent, truth, controls)| Some((id, agent?, truth, controls)))
    }

    /// Every vehicle: its agent if one runs, the ground truth of the last frame, and the controls of a helicopter.
    pub fn all_vehicles(&self) -> impl Iterator<Item = (VehicleId, Option<&Agent>, &GroundTruth, Option<Controls>)> {
        let controls = |vehicle: &Vehicle| vehicle.moved_by.and_then(Command::controls);
        self.vehicles.iter().map(move |vehicle| (vehicle.id, vehicle.agent(), &vehicle.truth, controls(vehicle)))
    }

    /// The traces of the last tick, one for each running agent.
    pub fn traces(&mut self) -> impl Iterator<Item = Trace> {
        let now = LocalTime::from_nanoseconds(self.ticks.saturating_sub(1) * TICK_NS);
        self.vehicles.iter_mut().filter_map(move |vehicle| vehicle.trace(now))
    }

    /// The events that agents reported in the last tick.
    pub fn events(&self) -> impl Iterator<Item = (VehicleId, EventKind)> {
        self.events.iter()
    }

    /// The faults that were injected in the last tick.
    pub fn faults(&self) -> &[InjectedFault] {
        &self.faults
    }

    /// The counters of all agents together, including those that have ended.
    ///
    /// The counters of states count what crossed the network: states and controls under a central controller.
    pub fn totals(&self) -> Totals {
        let totals = self.vehicles().fold(self.ended_totals, |totals, (_, agent, ..)| with_counts(totals, agent));
        self.central.as_ref().map_or(totals, |central| central.totals(totals))
    }

    /// Delivers the messages of the last tick to all other running agents. Where the network delivers everything at
    /// once, the agents take the messages in place when they step.
    fn deliver(&mut self, now: LocalTime) {
        if self.central.as_ref().is_some_and(|central| central.is_busy(now)) {
            return;
        }
        mem::swap(&mut self.in_flight, &mut self.arriving);
        let Self { vehicles, arriving, records, network, to_one, strangers, .. } = self;
        if let Some(strangers) = strangers {
            strangers.deliver(now);
            let stations = vehicles.iter_mut().filter_map(|vehicle| vehicle.station.as_mut());
            stations.for_each(|station| station.take_intents(now, strangers));
        }
        if let Some(network) = network {
            for vehicle in vehicles.iter_mut() {
                vehicle.takes_broadcast = true;
                vehicle.station.iter_mut().for_each(Station::release_inbox);
            }
            network.set_receivers(vehicles.iter().map(|vehicle| ReceiverPosition {
                flown_s: vehicle.clocks().flown_s(now),
                position: vehicle.agent().and_then(Agent::position),
            }));
            network.set_clocks(
                now,
                vehicles
                    .iter()
                    .map(|vehicle| vehicle.station.as_ref().map(|station| station.step_clock(now)).unwrap_or_default()),
            );
            network.deliver(now, to_one, arriving);
            to_one.clear();
            return;
        }
        let mut any_takes_broadcast = false;
        for vehicle in vehicles.iter_mut() {
            let id = vehicle.id;
            vehicle.takes_broadcast = vehicle.station.as_ref().is_some_and(|station| station.receives_broadcast());
            any_takes_broadcast |= vehicle.takes_broadcast;
            let to_all = if vehicle.takes_broadcast { &[] } else { arriving.as_slice() };
            let to_all = to_all.iter().filter(|message| message.sender() != Some(id));
            let to_it = to_one.iter().filter(|(receiver, _)| *receiver == id).map(|(_, message)| message);
            // The station applies the impairments.
            if let Some(station) = vehicle.station.as_mut().filter(|_| !vehicle.takes_broadcast || !to_one.is_empty()) {
                station.receive(now, to_it.chain(to_all).map(|message| Received { message: *message, at: now }));
            }
        }
        to_one.clear();
        if any_takes_broadcast {
            records.update(now, arriving);
        }
    }

    /// Carries out the scripted actions and orders that are due.
    fn follow_script(&mut self, now: LocalTime) {
        let mut changes = LinkChanges::default();
        for index in 0..self.vehicles.len() {
            let id = self.vehicles[index].id;
            while let Some(action) = self.vehicles[index].due(now) {
                match action {
                    ScriptedAction::Kill => self.end(index),
                    ScriptedAction::Restart => self.restart(index),
                    ScriptedAction::Fail(what) => self.pending_faults.push(InjectedFault::Failed(id, what)),
                    ScriptedAction::Link(change, sender) => changes.add(change, (sender, id)),
                }
            }
        }
        self.pending_faults.extend(changes.faults());
        if let Some(t_s) = self.flown_s(now) {
            self.act_on_all_agents(t_s);
            self.send_orders(t_s);
        }
        self.faults.append(&mut self.pending_faults);
    }

    /// Time since the first take-off, s: the scripts of the operator and of the central controller count from it.
    fn flown_s(&self, now: LocalTime) -> Option<f64> {
        self.vehicles.iter().filter_map(|vehicle| vehicle.clocks().flown_s(now)).reduce(f64::max)
    }

    /// Carries out the actions that affect all agents at once.
    fn act_on_all_agents(&mut self, t_s: f64) {
        while let Some(action) = self.central.as_mut().and_then(|central| central.due(t_s)) {
            for index in 0..self.vehicles.len() {
                if action == ScriptedAction::Kill { self.end(index) } else { self.restart(index) }
            }
        }
    }

    fn send_orders(&mut self, t_s: f64) {
        let living = self.vehicles.iter().filter_map(Vehicle::agent);
        let orders =
            self.operator.orders_to_send(t_s, |order| living.clone().all(|agent| agent.orders().contain(order)));
        self.in_flight.extend(orders.iter().map(|order| PeerMessage::Order(through_wire(order))));
    }

    fn end(&mut self, index: usize) {
        let vehicle = &mut self.vehicles[index];
        let Some(station) = vehicle.station.take() else { return };
        vehicle.clocks = *station.clocks();
        (vehicle.heartbeat, vehicle.command, vehicle.answer) = (None, None, None);
        vehicle.refusals.clear();
        if let Some(network) = &mut self.network {
            network.end(vehicle.id);
        }
        if let Some(strangers) = &mut self.strangers {
            strangers.end(vehicle.id);
        }
        self.ended_totals = with_counts(self.ended_totals, station.agent());
        self.in_flight.push(PeerMessage::Vanished(vehicle.id));
        self.pending_faults.push(InjectedFault::Died(vehicle.id));
    }

    /// Starts the agent of a vehicle again: it receives the liveliness tokens and heartbeats of all running agents.
    fn restart(&mut self, index: usize) {
        let vehicle = &mut self.vehicles[index];
        if vehicle.station.is_some() {
            return;
        }
        vehicle.incarnation.0 += 1;
        let station = vehicle.new_station(&self.scenario, &self.rules);
        // A study with an unsupported scenario never begins.
        #[expect(clippy::expect_used, reason = "the same scenario made the first agent")]
        let station = station.expect("the scenario has already flown");
        vehicle.station = Some(station);
        let restarted = vehicle.id;
        vehicle.takes_broadcast = self.network.is_some();
        vehicle.join(self.network.as_deref_mut(), self.strangers.as_deref_mut());
        self.in_flight.push(PeerMessage::Appeared(restarted));
        for other in self.vehicles.iter().filter(|other| other.id != restarted && other.station.is_some()) {
            let messages = [Some(PeerMessage::Appeared(other.id)), other.heartbeat.map(PeerMessage::Mission)];
            self.to_one.extend(messages.into_iter().flatten().map(|message| (restarted, message)));
        }
        self.pending_faults.push(InjectedFault::Restarted(restarted));
    }
}

/// The helicopters that move in this frame, with their controls. A point mass costs too little for a block and moves on
/// the way.
fn plants(vehicles: &mut [Vehicle]) -> impl Iterator<Item = (&mut BuiltInVehicle, Option<Controls>)> {
    let moving = vehicles.iter_mut().filter(|vehicle| !vehicle.simulator_frozen);
    moving.filter_map(|Vehicle { plant, moved_by, .. }| match plant {
        BuiltInPlant::Helicopter(helicopter) => Some((&mut **helicopter, moved_by.and_then(Command::controls))),
        BuiltInPlant::PointMass(_) => {
            plant.advance(*moved_by);
            None
        }
    })
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

/// Encodes and decodes a message, as the network does.
///
/// # Panics
/// If a receiver would refuse the message.
pub fn through_wire<M: Message>(message: &M) -> M {
    // An agent sends no message that a receiver would reject. If it did, the study would be wrong and must stop.
    #[expect(clippy::expect_used, reason = "a message of ours that does not decode is a bug")]
    message::decode(&message::encode(message)).expect("an agent's message decodes")
}

#[cfg(test)]
mod tests;
