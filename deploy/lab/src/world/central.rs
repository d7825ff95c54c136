//! The baseline to compare with: the paper's one control machine (Garcia & Barnes 2010, section 3), which reads every
//! aircraft's state over the network, computes every control and sends it back.
//!
//! ```text
//!  aircraft 1 --state--> |  the machine: all agents, one after the other  | --controls--> aircraft 1
//!  aircraft n --state--> |  in one memory                                 | --controls--> aircraft n
//! ```
//!
//! The agents are those that otherwise fly beside each vehicle; only their place is another. Once a frame every simulator
//! sends its state, and the machine takes the newest that has arrived of each, steps every agent and sends its controls as
//! soon as they are computed. Every datagram crosses the scenario's network: the machine and every aircraft hear through an
//! [`Ear`], on a network on which the machine is one more vehicle, standing at the origin. What of a state is lost or late is missing or late;
//! controls that are lost leave the sticks where they are, and of controls out of order the newest stand. Among each other
//! the agents hear everything, one frame of the machine later. A law in another program answers one machine as it would many.
//!
//! On the machine an agent knows its aircraft without the flight model. What it would find by that, a servo or a gyro that does not
//! follow, it finds by holding every frame against the command before it: a command that is still on its way is taken for a
//! servo that sticks. A failed engine and a position that stands still are found here too.
//!
//! The machine needs `control.central_step_s` for a vehicle and frame. While it is busy it leaves frames of 20 ms out
//! (`frame_overruns`). Controls that reach a simulator before its next frame count for all of the present one, as in
//! X-Plane: a machine that is fast enough over a network without delay costs no time at all.

use std::collections::VecDeque;

use skein_common::frame::{Geodetic, PositionNed, VelocityNed};
use skein_common::id::{Incarnation, VehicleId};
use skein_common::message::{Header, State};
use skein_common::scenario::{Graph, Network, Scenario, SendMode, Source, load};
use skein_common::state::VehicleState;
use skein_common::time::{LocalTime, PlantTime};
use skein_core::agent::Outputs;
use skein_core::aircraft::Aircraft;
use skein_core::formation::external::Ask;
use skein_core::impairments::{Ear, Whereabouts};
use skein_core::outbox::Outbox;
use skein_core::peers::{Heard, Word};
use skein_core::plant::{Measurement, Sticks};

use super::TICK_NS;
use super::driver::{Driver, Take};
use super::script::Deed;
use super::vehicle::Vehicle;
use crate::faults::{Agenda, control_kills};
use crate::metrics::Totals;

/// What an aircraft tells in a frame, bytes: X-Plane's RPOS. The rotor's speed, which nobody needs once it is there, is free.
const STATE_BYTES: u64 = 69;
/// What the machine answers, bytes: X-Plane's DATA with the rows of the joystick and of the collective.
const CONTROLS_BYTES: u64 = 5 + 2 * 36;
/// More than so many frames of a vehicle are not under way: four minutes, of which the network's longest delay is one.
const UNDER_WAY: usize = 12_000;

/// The one machine, and the two ends of its link to every aircraft.
#[derive(Debug)]
pub(super) struct Central {
    /// On the network.
    id: VehicleId,
    /// Where it stands.
    place: Geodetic,
    /// For one vehicle and frame, s.
    step_s: f64,
    deaths: Agenda<Deed>,
    runs: bool,
    /// Until when it computes what it has begun.
    busy_until: LocalTime,
    ear: Ear,
    /// One for each vehicle, in the order of ids.
    lines: Vec<Line>,
    heard: Vec<Heard>,
    totals: Totals,
}

/// What goes to and from one aircraft.
#[derive(Debug)]
struct Line {
    /// The aircraft's.
    ear: Ear,
    states: UnderWay<(PlantTime, Measurement)>,
    controls: UnderWay<Sticks>,
    /// The newest state that has come in and that no frame has taken up.
    newest: Option<(PlantTime, Measurement)>,
    /// Of the last state that was taken up.
    plant_time: PlantTime,
    /// Controls with the times at which they are computed.
    computed: VecDeque<Heard>,
    simulator_frozen: bool,
}

/// What was sent and may still arrive, by its number. The network carries only the number.
#[derive(Debug)]
struct UnderWay<T> {
    sent: VecDeque<T>,
    /// Of the first of `sent`.
    first: u64,
}

impl<T> UnderWay<T> {
    fn new() -> Self {
        Self { sent: VecDeque::new(), first: 0 }
    }

    /// Gives its number.
    fn send(&mut self, what: T) -> u64 {
        if self.sent.len() == UNDER_WAY {
            self.sent.pop_front();
            self.first += 1;
        }
        self.sent.push_back(what);
        self.first + self.sent.len() as u64 - 1
    }

    /// What has this number, unless something later has arrived before it.
    fn arrive(&mut self, number: u64) -> Option<T> {
        let before = usize::try_from(number.checked_sub(self.first)?).ok()?;
        if before >= self.sent.len() {
            return None;
        }
        self.first = number + 1;
        self.sent.drain(..=before).next_back()
    }
}

/// The same network with the machine as one more vehicle on it, the last; everybody hears it, and it everybody.
fn with_machine(scenario: &Scenario) -> (Scenario, VehicleId) {
    let mut scenario = scenario.clone();
    scenario.swarm.vehicles += 1;
    scenario.network.graph = Graph::All;
    // A scenario with as many vehicles as there are ids is not central.
    #[expect(clippy::expect_used, reason = "scenarios without vehicles are refused")]
    let id = scenario.ids().last().expect("a vehicle");
    if let Some(mut machine) = scenario.vehicle.last().cloned() {
        machine.id = id;
        scenario.vehicle.push(machine);
    }
    (scenario, id)
}

impl Central {
    /// The machine of this scenario.
    pub(super) fn new(scenario: &Scenario) -> Self {
        let (network, id) = with_machine(scenario);
        let mut deaths = Vec::new();
        for dead in control_kills(&scenario.mission.events) {
            deaths.extend([(dead.start, Deed::Kill), (dead.end, Deed::Restart)]);
        }
        Self {
            id,
            place: scenario.origin.geodetic(),
            step_s: scenario.control.central_step_s,
            deaths: Agenda::new(deaths),
            runs: true,
            busy_until: LocalTime::ZERO,
            ear: Ear::new(&network, id),
            lines: scenario.ids().map(|id| Line::new(Ear::new(&network, id))).collect(),
            heard: Vec::new(),
            totals: Totals::default(),
        }
    }

    /// Whether it still computes what it has begun: then no agent on it listens.
    fn is_busy(&self, now: LocalTime) -> bool {
        self.busy_until > now
    }

    /// Every simulator's frame: it goes out, and what has arrived of all is read. Whether the machine has time for a frame
    /// of its own: then [`Self::step`] is due for every vehicle.
    fn read(&mut self, now: LocalTime, vehicles: &mut [Vehicle]) -> bool {
        let mut sent = Vec::with_capacity(vehicles.len());
        for (line, vehicle) in self.lines.iter_mut().zip(vehicles.iter_mut()) {
            let (frame, simulator_frozen) = vehicle.frame(now);
            line.simulator_frozen = simulator_frozen;
            if simulator_frozen {
                continue;
            }
            let number = line.states.send((frame.time, frame.measurement));
            let Measurement { position, velocity, attitude, .. } = frame.measurement;
            let state = VehicleState { position, velocity, heading_rad: attitude.heading_rad };
            sent.push(numbered(vehicle.id, number, state, now));
            self.totals.state_messages += 1;
            self.totals.state_bytes += STATE_BYTES;
        }
        let flown_s = vehicles.iter().filter_map(|vehicle| vehicle.clocks().flown_s(now)).reduce(f64::max);
        let here = Whereabouts { flown_s, position: Some(PositionNed::default()) };
        self.ear.receive(now, here, sent, &mut self.heard);
        for (sender, number) in self.heard.drain(..).filter_map(number_of) {
            let line = self.lines.get_mut(usize::from(sender.get()) - 1);
            if let Some((line, state)) = line.and_then(|line| line.states.arrive(number).map(|state| (line, state))) {
                line.newest = Some(state);
            }
        }
        if !self.runs {
            self.lines.iter_mut().for_each(|line| line.newest = None);
            return false;
        }
        if self.is_busy(now) {
            self.totals.frame_overruns += 1;
            return false;
        }
        self.busy_until = now.plus_seconds(self.step_s * self.lines.len() as f64);
        true
    }

    /// One vehicle's part of the frame that begins now. Gives what its agent says to the others,
    /// and asks.
    fn step(&mut self, now: LocalTime, vehicle: &mut Vehicle) -> Option<(Outbox, Option<Ask>)> {
        let rank = usize::from(vehicle.id.get());
        let line = self.lines.get_mut(rank - 1)?;
        let newest = line.newest.take();
        line.plant_time = newest.map_or(line.plant_time, |(plant_time, _)| plant_time);
        let measurement = newest.as_ref().map(|(_, measurement)| measurement);
        let Outputs { command, outbox, ask } = vehicle.step(now, (line.plant_time, measurement))?;
        if let Some(sticks) = command {
            let at = now.plus_seconds(self.step_s * rank as f64);
            let state = VehicleState { position: self.place, velocity: VelocityNed::default(), heading_rad: 0.0 };
            line.computed.push_back(numbered(self.id, line.controls.send(sticks), state, at));
        }
        Some((outbox, ask))
    }

    /// What arrives at the simulators before their next frames; they go on to these.
    fn write(&mut self, now: LocalTime, vehicles: &mut [Vehicle]) {
        let next_frame = LocalTime::from_nanoseconds(now.nanoseconds() + TICK_NS - 1);
        for (line, vehicle) in self.lines.iter_mut().zip(vehicles) {
            let computed = line.computed.partition_point(|controls| controls.at <= next_frame);
            self.totals.state_messages += computed as u64;
            self.totals.state_bytes += computed as u64 * CONTROLS_BYTES;
            let there = Whereabouts { flown_s: vehicle.clocks().flown_s(now), position: Some(vehicle.truth.position) };
            line.ear.receive(next_frame, there, line.computed.drain(..computed), &mut self.heard);
            for (_, number) in self.heard.drain(..).filter_map(number_of) {
                vehicle.command = line.controls.arrive(number).or(vehicle.command);
            }
            if !line.simulator_frozen {
                vehicle.plant.advance(vehicle.command);
            }
        }
    }
}

impl Driver for Central {
    /// On one machine the agents hear each other perfectly and have one clock, and silence saves nothing.
    fn as_agents_see_it(&self, scenario: &Scenario) -> Scenario {
        let defaults = Source { name: "defaults", text: "swarm.vehicles = 1" };
        #[expect(clippy::expect_used, reason = "the least that a scenario can say, which tests load")]
        let perfect = load(&defaults, &[]).expect("a scenario of defaults").scenario.network;
        let peer_stale_s = scenario.network.peer_stale_s;
        let network = Network { send: SendMode::EveryFrame, peer_stale_s, ..perfect };
        let mut scenario = Scenario { network, ..scenario.clone() };
        for vehicle in &mut scenario.vehicle {
            (vehicle.clock_offset_s, vehicle.clock_drift_ppm) = (0.0, 0.0);
        }
        scenario
    }

    /// Without its flight model.
    fn as_agents_know_it(&self, aircraft: &Aircraft) -> Aircraft {
        let of_model = aircraft.helicopter.as_ref().map(|model| model.head.nominal_speed_rad_s);
        let rotor_speed_rad_s = aircraft.rotor_speed_rad_s.or(of_model);
        Aircraft { helicopter: None, rotor_speed_rad_s, ..aircraft.clone() }
    }

    fn listens(&self, now: LocalTime) -> bool {
        !self.is_busy(now)
    }

    /// What ends with the machine, what it has read or has not sent yet included, and what begins anew with it.
    fn due(&mut self, flown_s: f64) -> Option<Deed> {
        let deed = self.deaths.due(flown_s)?;
        self.runs = deed != Deed::Kill;
        if !self.runs {
            self.busy_until = LocalTime::ZERO;
            self.lines.iter_mut().for_each(|line| line.computed.clear());
        }
        Some(deed)
    }

    fn frame(&mut self, now: LocalTime, vehicles: &mut [Vehicle], take: &mut Take<'_>) {
        if self.read(now, vehicles) {
            for vehicle in vehicles.iter_mut() {
                if let Some((outbox, ask)) = self.step(now, vehicle) {
                    take(vehicle, outbox, ask);
                }
            }
        }
        self.write(now, vehicles);
    }

    /// States to the machine and controls from it, in place of the agents' messages.
    fn totals(&self, of_agents: Totals) -> Totals {
        let Totals { state_messages, state_bytes, frame_overruns, .. } = self.totals;
        Totals { state_messages, state_bytes, frame_overruns, ..of_agents }
    }
}

impl Line {
    fn new(ear: Ear) -> Self {
        Self {
            ear,
            states: UnderWay::new(),
            controls: UnderWay::new(),
            newest: None,
            plant_time: PlantTime::ZERO,
            computed: VecDeque::new(),
            simulator_frozen: false,
        }
    }
}

/// A datagram as the network carries it: who sends it, from where, its number.
fn numbered(sender: VehicleId, sequence: u64, state: VehicleState, at: LocalTime) -> Heard {
    let header = Header { sender, incarnation: Incarnation(1), sequence, stamp: at.into() };
    Heard { word: Word::State(State { header, state }), at }
}

fn number_of(heard: Heard) -> Option<(VehicleId, u64)> {
    match heard.word {
        Word::State(State { header, .. }) => Some((header.sender, header.sequence)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_what_is_under_way_the_newest_stands() {
        let mut under_way = UnderWay::new();
        let numbers: Vec<u64> = ["a", "b", "c", "d"].into_iter().map(|what| under_way.send(what)).collect();
        assert_eq!(numbers, [0, 1, 2, 3]);
        assert_eq!(under_way.arrive(2), Some("c"), "a and b are late or lost");
        assert_eq!(under_way.arrive(1), None, "overtaken");
        assert_eq!(under_way.arrive(2), None, "twice");
        assert_eq!(under_way.arrive(3), Some("d"));
        assert_eq!(under_way.send("e"), 4);
        assert_eq!(under_way.arrive(4), Some("e"));
    }

    #[test]
    fn what_is_never_to_arrive_is_forgotten() {
        let mut under_way = UnderWay::new();
        let last = (0..2 * UNDER_WAY).map(|what| under_way.send(what)).last();
        assert_eq!(under_way.sent.len(), UNDER_WAY);
        assert_eq!(under_way.arrive(0), None);
        assert_eq!(last.and_then(|last| under_way.arrive(last)), Some(2 * UNDER_WAY - 1));
    }
}
