//! The central controller: the baseline for comparisons, after the paper's single control computer (Garcia & Barnes
//! 2010, section 3). It reads every aircraft's state over the network, computes every control and sends it back.
//!
//! ```text
//!  aircraft 1 --state--> |  central controller: all agents,        | --controls--> aircraft 1
//!  aircraft n --state--> |  one after the other, in shared memory  | --controls--> aircraft n
//! ```
//!
//! It runs the same agents that otherwise fly beside each vehicle. Once a frame every simulator sends its state. The
//! controller takes the newest state that has arrived from each aircraft, steps every agent, and sends the controls as
//! soon as they are computed.
//!
//! Every datagram crosses the scenario's network. The controller counts as one more vehicle on it, at the origin; the
//! controller and every aircraft receive through an [`Impairments`]. If controls are lost, the aircraft keeps its last ones; if
//! they arrive out of order, the newest count. The agents exchange all messages without loss, one frame of the
//! controller later. An external law answers a central controller as it would answer many agents.
//!
//! An agent in the central controller has no flight model of its aircraft. To find a servo or a gyro that does not
//! follow, it compares every frame with the command before it: a command that is still in flight looks like a stuck
//! servo. A failed engine and a frozen position are detected here too.
//!
//! The controller needs `control.central_step_s` for each vehicle and frame. While it is busy, it skips frames of 20 ms
//! (`frame_overruns`). Controls that reach a simulator before its next frame count for all of the present one, as in
//! X-Plane: a controller that is fast enough, over a network without delay, adds no delay at all.

use std::collections::VecDeque;

use skein_common::frame::{Geodetic, Origin, PositionNed, VelocityNed};
use skein_common::id::{Incarnation, VehicleId};
use skein_common::message::{Header, State};
use skein_common::scenario::{Fault, Graph, Network, Scenario, SendMode, Source, load};
use skein_common::state::VehicleState;
use skein_common::time::{LocalTime, PlantTime};
use skein_core::agent::Outputs;
use skein_core::aircraft::Aircraft;
use skein_core::formation::Workspace;
use skein_core::formation::external::LawQuery;
use skein_core::impairments::{Impairments, ReceiverPosition};
use skein_core::outbox::Outbox;
use skein_core::peers::{PeerMessage, Received, ReceivedState};
use skein_core::plant::{Command, Measurement};

use super::TICK_NS;
use super::beside::TakeOutputs;
use super::script::{ScriptedAction, outages};
use super::vehicle::{Arriving, Vehicle};
use crate::faults::Schedule;
use crate::metrics::Totals;

/// Size of the state that an aircraft sends in a frame, bytes: X-Plane's RPOS. The rotor speed is not counted, because
/// it is only needed until the rotor turns at full speed.
const STATE_BYTES: u64 = 69;
/// Size of the controls that an aircraft receives, bytes: X-Plane's DATA with the rows of the joystick and the
/// collective.
const CONTROLS_BYTES: u64 = 5 + 2 * 36;
/// Most frames of a vehicle that are in flight: four minutes of them; the longest delay of the network is one minute.
const MAX_IN_FLIGHT: usize = 12_000;

/// The central controller, with both ends of its link to every aircraft.
#[derive(Debug)]
pub(super) struct Central {
    /// Id of the controller on the network.
    id: VehicleId,
    /// Position of the controller on the globe.
    place: Geodetic,
    origin: Origin,
    /// Time to compute one vehicle's step, s.
    step_s: f64,
    workspace: Workspace,
    outages: Schedule<ScriptedAction>,
    is_running: bool,
    /// Time at which the current frame is computed.
    busy_until: LocalTime,
    impairments: Impairments,
    /// One link for each vehicle, in the order of ids.
    links: Vec<AircraftLink>,
    received: Vec<Received>,
    totals: Totals,
}

/// The link to one aircraft, with the datagrams in both directions.
#[derive(Debug)]
struct AircraftLink {
    /// Impairments of what the aircraft receives.
    impairments: Impairments,
    states: InFlight<(PlantTime, Measurement)>,
    commands: InFlight<Command>,
    /// The newest state that has arrived and that no step has used yet.
    newest: Option<(PlantTime, Measurement)>,
    /// Plant time of the last state that a step used.
    plant_time: PlantTime,
    /// Commands that are not sent yet, with the times at which they are computed.
    computed: VecDeque<Received>,
}

/// The contents of datagrams that may still arrive, by number: the simulated network carries only the number.
#[derive(Debug)]
struct InFlight<T> {
    sent: VecDeque<T>,
    /// Number of the first entry of `sent`.
    first: u64,
}

impl<T> InFlight<T> {
    fn new() -> Self {
        Self { sent: VecDeque::new(), first: 0 }
    }

    /// Keeps the content of a datagram and returns its number.
    fn send(&mut self, what: T) -> u64 {
        if self.sent.len() == MAX_IN_FLIGHT {
            self.sent.pop_front();
            self.first += 1;
        }
        self.sent.push_back(what);
        self.first + self.sent.len() as u64 - 1
    }

    /// Takes the content with this number; `None` if a later datagram has arrived before.
    fn arrive(&mut self, number: u64) -> Option<T> {
        let before = usize::try_from(number.checked_sub(self.first)?).ok()?;
        if before >= self.sent.len() {
            return None;
        }
        self.first = number + 1;
        self.sent.drain(..=before).next_back()
    }
}

/// The same network with the controller as one more vehicle, the last one, in contact with all others.
fn with_central_controller(scenario: &Scenario) -> (Scenario, VehicleId) {
    let mut scenario = scenario.clone();
    scenario.swarm.vehicles += 1;
    scenario.network.graph = Graph::All;
    // A central scenario never uses the last id, so one is left for the controller.
    #[expect(clippy::expect_used, reason = "scenarios without vehicles are refused")]
    let id = scenario.ids().last().expect("a vehicle");
    if let Some(mut controller) = scenario.vehicle.last().cloned() {
        controller.id = id;
        scenario.vehicle.push(controller);
    }
    (scenario, id)
}

impl Central {
    /// The central controller of this scenario.
    pub(super) fn new(scenario: &Scenario) -> Self {
        let (network, id) = with_central_controller(scenario);
        Self {
            id,
            place: scenario.origin.geodetic(),
            origin: Origin::new(scenario.origin.geodetic()),
            step_s: scenario.control.central_step_s,
            workspace: Workspace::default(),
            outages: Schedule::new(outages(&scenario.mission.events, &Fault::KillControl).collect()),
            is_running: true,
            busy_until: LocalTime::ZERO,
            impairments: Impairments::new(&network, id),
            links: scenario.ids().map(|id| AircraftLink::new(Impairments::new(&network, id))).collect(),
            received: Vec::new(),
            totals: Totals::default(),
        }
    }

    /// Whether the controller still computes a frame: then its agents receive nothing.
    pub(super) fn is_busy(&self, now: LocalTime) -> bool {
        self.busy_until > now
    }

    /// Sends every simulator's frame and reads the states that have arrived.
    ///
    /// Returns true if the controller has time for a frame: then [`Self::step`] is due for every vehicle.
    fn read(&mut self, now: LocalTime, vehicles: &mut [Vehicle]) -> bool {
        let mut sent = Vec::with_capacity(vehicles.len());
        for (link, vehicle) in self.links.iter_mut().zip(vehicles.iter_mut()) {
            let frame = vehicle.frame(now);
            if vehicle.simulator_frozen {
                continue;
            }
            let number = link.states.send((frame.time, frame.measurement));
            let Measurement { position, velocity, attitude, .. } = frame.measurement;
            let state = VehicleState { position, velocity, heading_rad: attitude.heading_rad };
            sent.push(numbered_datagram(&self.origin, (vehicle.id, number), state, now));
            self.totals.state_messages += 1;
            self.totals.state_bytes += STATE_BYTES;
        }
        let flown_s = vehicles.iter().filter_map(|vehicle| vehicle.clocks().flown_s(now)).reduce(f64::max);
        let here = ReceiverPosition { flown_s, position: Some(PositionNed::default()) };
        self.impairments.receive(now, here, sent, &mut self.received);
        for (sender, number) in self.received.drain(..).filter_map(datagram_number) {
            let link = self.links.get_mut(usize::from(sender.get()) - 1);
            if let Some((link, state)) = link.and_then(|link| link.states.arrive(number).map(|state| (link, state))) {
                link.newest = Some(state);
            }
        }
        if !self.is_running {
            self.links.iter_mut().for_each(|link| link.newest = None);
            return false;
        }
        if self.is_busy(now) {
            self.totals.frame_overruns += 1;
            return false;
        }
        self.busy_until = now.plus_seconds(self.step_s * self.links.len() as f64);
        true
    }

    /// Steps one vehicle's agent in the frame that begins now. Returns the messages and the query that the agent sends.
    fn step(
        &mut self,
        now: LocalTime,
        arriving: Arriving<'_>,
        vehicle: &mut Vehicle,
    ) -> Option<(Outbox, Option<Box<LawQuery>>)> {
        let rank = usize::from(vehicle.id.get());
        let link = self.links.get_mut(rank - 1)?;
        let newest = link.newest.take();
        link.plant_time = newest.map_or(link.plant_time, |(plant_time, _)| plant_time);
        let measurement = newest.as_ref().map(|(_, measurement)| measurement);
        let Outputs { command, outbox, ask } =
            vehicle.step(now, (link.plant_time, measurement), arriving, &mut self.workspace)?;
        if let Some(command) = command {
            let at = now.plus_seconds(self.step_s * rank as f64);
            let state = VehicleState { position: self.place, velocity: VelocityNed::default(), heading_rad: 0.0 };
            link.computed.push_back(numbered_datagram(&self.origin, (self.id, link.commands.send(command)), state, at));
        }
        Some((outbox, ask))
    }

    /// Delivers the commands that arrive before the next frame.
    fn write(&mut self, now: LocalTime, vehicles: &mut [Vehicle]) {
        let next_frame = LocalTime::from_nanoseconds(now.nanoseconds() + TICK_NS - 1);
        for (link, vehicle) in self.links.iter_mut().zip(vehicles) {
            let computed = link.computed.partition_point(|controls| controls.at <= next_frame);
            self.totals.state_messages += computed as u64;
            self.totals.state_bytes += computed as u64 * CONTROLS_BYTES;
            let there =
                ReceiverPosition { flown_s: vehicle.clocks().flown_s(now), position: Some(vehicle.truth.position) };
            link.impairments.receive(next_frame, there, link.computed.drain(..computed), &mut self.received);
            for (_, number) in self.received.drain(..).filter_map(datagram_number) {
                vehicle.command = link.commands.arrive(number).or(vehicle.command);
            }
        }
    }

    /// The scenario that the agents of a central controller receive: they share a perfect network and one clock, and send
    /// every frame, because silence would save nothing. Frames that a slow controller skips are not those of a slow
    /// simulator: they keep no vehicle on the ground.
    pub(super) fn scenario_of_agents(scenario: &Scenario) -> Scenario {
        let defaults = Source { name: "defaults", text: "swarm.vehicles = 1" };
        #[expect(clippy::expect_used, reason = "the smallest scenario, which tests load")]
        let perfect = load(&defaults, &[]).expect("a scenario of defaults").scenario.network;
        let peer_stale_s = scenario.network.peer_stale_s;
        let network = Network { send: SendMode::EveryFrame, peer_stale_s, ..perfect };
        let mut scenario = Scenario { network, ..scenario.clone() };
        scenario.plant.min_frame_rate_hz = 0.0;
        for vehicle in &mut scenario.vehicle {
            (vehicle.clock_offset_s, vehicle.clock_drift_ppm) = (0.0, 0.0);
        }
        scenario
    }

    /// The aircraft data that the agents of a central controller receive: the aircraft without its flight model.
    pub(super) fn aircraft_of_agents(aircraft: &Aircraft) -> Aircraft {
        let of_model = aircraft.helicopter.as_ref().map(|model| model.head.nominal_speed_rad_s);
        let rotor_speed_rad_s = aircraft.rotor_speed_rad_s.or(of_model);
        Aircraft { helicopter: None, rotor_speed_rad_s, ..aircraft.clone() }
    }

    /// Takes the next outage or restart of the controller that is due at this time after the first take-off, s. An outage
    /// discards controls that are computed and not sent.
    pub(super) fn due(&mut self, flown_s: f64) -> Option<ScriptedAction> {
        let action = self.outages.due(flown_s)?;
        self.is_running = action != ScriptedAction::Kill;
        if !self.is_running {
            self.busy_until = LocalTime::ZERO;
            self.links.iter_mut().for_each(|link| link.computed.clear());
        }
        Some(action)
    }

    /// Simulates the agents' part of one frame: one computer steps all agents, one after the other.
    pub(super) fn frame(
        &mut self,
        now: LocalTime,
        arriving: Arriving<'_>,
        vehicles: &mut [Vehicle],
        take: &mut TakeOutputs<'_>,
    ) {
        if self.read(now, vehicles) {
            for vehicle in vehicles.iter_mut() {
                if let Some((outbox, ask)) = self.step(now, arriving, vehicle) {
                    take(vehicle, outbox, ask);
                }
            }
        }
        self.write(now, vehicles);
    }

    /// The counters of what crossed the network: states to the controller and controls from it instead of the agents'
    /// messages.
    pub(super) fn totals(&self, of_agents: Totals) -> Totals {
        let Totals { state_messages, state_bytes, frame_overruns, .. } = self.totals;
        Totals { state_messages, state_bytes, frame_overruns, ..of_agents }
    }
}

impl AircraftLink {
    fn new(impairments: Impairments) -> Self {
        Self {
            impairments,
            states: InFlight::new(),
            commands: InFlight::new(),
            newest: None,
            plant_time: PlantTime::ZERO,
            computed: VecDeque::new(),
        }
    }
}

/// A datagram as the simulated network carries it: sender, position and number.
fn numbered_datagram(
    origin: &Origin,
    (sender, sequence): (VehicleId, u64),
    state: VehicleState,
    at: LocalTime,
) -> Received {
    let header = Header { sender, incarnation: Incarnation(1), sequence, stamp: at.into() };
    Received { message: PeerMessage::State(ReceivedState::new(State { header, state }, origin)), at }
}

fn datagram_number(received: Received) -> Option<(VehicleId, u64)> {
    match received.message {
        PeerMessage::State(ReceivedState { header, .. }) => Some((header.sender, header.sequence)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_newer_datagram_replaces_those_in_flight_before_it() {
        let mut in_flight = InFlight::new();
        let numbers: Vec<u64> = ["a", "b", "c", "d"].into_iter().map(|what| in_flight.send(what)).collect();
        assert_eq!(numbers, [0, 1, 2, 3]);
        assert_eq!(in_flight.arrive(2), Some("c"), "a and b are late or lost");
        assert_eq!(in_flight.arrive(1), None, "overtaken");
        assert_eq!(in_flight.arrive(2), None, "twice");
        assert_eq!(in_flight.arrive(3), Some("d"));
        assert_eq!(in_flight.send("e"), 4);
        assert_eq!(in_flight.arrive(4), Some("e"));
    }

    #[test]
    fn datagrams_that_never_arrive_are_dropped() {
        let mut in_flight = InFlight::new();
        let last = (0..2 * MAX_IN_FLIGHT).map(|what| in_flight.send(what)).last();
        assert_eq!(in_flight.sent.len(), MAX_IN_FLIGHT);
        assert_eq!(in_flight.arrive(0), None);
        assert_eq!(last.and_then(|last| in_flight.arrive(last)), Some(2 * MAX_IN_FLIGHT - 1));
    }
}
