//! A swarm over X-Plane's protocol in virtual time: every agent talks with a stand-in's simulator by the bytes of the
//! protocol, over a link that loses datagrams, at any frame rate. The control loop is that of an agent in real time: a
//! step for every frame, and one without a frame when one and a half periods have passed.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use clap::{Args, Command as Arguments, FromArgMatches};
use rand::Rng;
use skein_agent::plant::xplane::client::{Client, Indices};
use skein_agent::plant::xplane::server::{DATAREFS, Task};
use skein_agent::plant::xplane::standin::{RunState, Simulator, StandinOptions};
use skein_agent::plant::xplane::wire::aircraft::Load;
use skein_agent::plant::xplane::wire::dref::Write;
use skein_agent::plant::xplane::wire::operation;
use skein_common::frame::{Geodetic, Origin, PositionNed};
use skein_common::id::{Incarnation, VehicleId};
use skein_common::message::{EventKind, Order};
use skein_common::scenario::Scenario;
use skein_common::state::Membership;
use skein_common::time::{LocalTime, PlantTime};
use skein_core::agent::Agent;
use skein_core::aircraft::Aircraft;
use skein_core::control::Rules;
use skein_core::formation::Workspace;
use skein_core::helicopter::Start;
use skein_core::outbox::Outbox;
use skein_core::peers::{PeerMessage, Received, ReceivedState};
use skein_core::plant::{Command, Controls, Frame, GroundTruth};
use skein_core::random::{self, Purpose};
use skein_core::start::starts;
use skein_core::station::{Clocks, Entering, Station};
use skein_lab::metrics::{Metrics, Report, Run, VehicleNow, Wall};
use skein_lab::world::through_wire;

use crate::schedule::Schedule;
use crate::{in_parallel, median_and_worst, scenario};

/// Time that a datagram or a message needs, ns.
const DELAY_NS: u64 = 300_000;
/// Time between two observations of the flight, ns.
const OBSERVATION_NS: u64 = 20_000_000;
/// Positions that an agent asks for, Hz.
const RATE_HZ: u32 = 50;
/// Time without a frame after which an agent steps, as a number of frame periods.
const TIMEOUT_PERIODS: f64 = 1.5;
/// Number of times that an order is sent.
const ORDER_REPEATS: usize = 5;
/// Longest time until all vehicles have joined, s.
const JOIN_LIMIT_S: f64 = 60.0;

/// The frames and the link of every simulator of a flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frames {
    /// Frames a second.
    pub rate: u32,
    /// Largest deviation of a frame's length, as a share of it.
    pub jitter: f64,
    /// Share of datagrams that are lost, in both directions.
    pub drop: f64,
}

/// What happens at a time.
enum WireEvent {
    /// The simulator of this vehicle runs a frame.
    Frame(usize),
    /// A datagram arrives at the agent of this vehicle.
    Datagram(usize, Vec<u8>),
    /// The agent of this vehicle steps without a frame, unless it has stepped since the step of this number.
    Deadline(usize, u64),
    /// A message of this vehicle arrives at all others.
    Message(usize, Box<PeerMessage>),
    /// The flight is observed.
    Observation,
}

/// One vehicle: its agent, its client and its simulator.
struct Vehicle {
    id: VehicleId,
    station: Station,
    client: Client,
    simulator: Simulator,
    /// Datagrams that wait for the simulator's next frame.
    waiting: Vec<Vec<u8>>,
    command: Option<Command>,
    plant_time: PlantTime,
    /// Number of steps so far.
    steps: u64,
    /// When its agent last wrote the controls.
    commanded: Option<LocalTime>,
    /// Largest change of the cyclic from one written command to the next one within a tenth of a second, by axis.
    largest_step: [f64; 2],
}

/// A swarm over the protocol in virtual time.
pub struct Swarm {
    vehicles: Vec<Vehicle>,
    origin: Origin,
    schedule: Schedule<WireEvent>,
    /// The instant of time zero; only differences from it are used.
    zero: Instant,
    workspace: Workspace,
    /// Everything that the agents reported: time, s, vehicle, event.
    pub events: Vec<(f64, VehicleId, EventKind)>,
}

/// Address of a vehicle's agent; its simulator is at the same IP address.
fn address(nth: usize) -> SocketAddr {
    ([127, 0, 0, 1], 20_000 + nth as u16).into()
}

/// Address from which the simulators send.
fn simulator_address() -> SocketAddr {
    ([127, 0, 0, 1], 49_000).into()
}

/// The options of a stand-in that is started without any.
///
/// # Panics
/// Never: every option has a default.
pub fn default_options() -> StandinOptions {
    let defaults = StandinOptions::augment_args(Arguments::new("standin")).get_matches_from(["standin"]);
    StandinOptions::from_arg_matches(&defaults).expect("defaults")
}

/// Options of the simulator of a vehicle at this place.
fn options(scenario: &Scenario, origin: &Origin, id: VehicleId, start: &Start, cell: Frames) -> StandinOptions {
    let (place, convergence) = origin.place(PositionNed::new(start.north_m, start.east_m, 0.0));
    StandinOptions {
        id,
        lat_deg: place.latitude_rad.to_degrees(),
        lon_deg: place.longitude_rad.to_degrees(),
        alt_m: place.altitude_m,
        heading_deg: convergence.heading_to_local(start.heading_rad).to_degrees(),
        rate: cell.rate,
        jitter: cell.jitter,
        drop: cell.drop,
        seed: scenario.seed,
        ..default_options()
    }
}

impl Swarm {
    /// The swarm of this scenario at rest at its start, with the shipped aircraft.
    ///
    /// # Panics
    /// If the scenario is not valid.
    pub fn new(scenario: &Scenario, cell: Frames) -> Self {
        let aircraft = Aircraft::shipped("xcell60").expect("a shipped aircraft").expect("a well-formed file");
        Self::of(scenario, cell, &aircraft, &default_options().acf)
    }

    /// The same on ground that is so many metres above the scenario's origin.
    ///
    /// # Panics
    /// If the scenario is not valid.
    pub fn on_ground(scenario: &Scenario, cell: Frames, ground_m: f64) -> Self {
        let aircraft = Aircraft::shipped("xcell60").expect("a shipped aircraft").expect("a well-formed file");
        Self::built(scenario, cell, (&aircraft, &default_options().acf), ground_m)
    }

    /// The same with this aircraft, in simulators that have loaded the aircraft of this path.
    ///
    /// # Panics
    /// If the scenario is not valid.
    pub fn of(scenario: &Scenario, cell: Frames, aircraft: &Aircraft, acf: &str) -> Self {
        Self::built(scenario, cell, (aircraft, acf), 0.0)
    }

    fn built(scenario: &Scenario, cell: Frames, (aircraft, acf): (&Aircraft, &str), ground_m: f64) -> Self {
        let origin = Origin::new(scenario.origin.geodetic());
        let starts = starts(scenario).expect("room for all starts");
        let vehicles = scenario.ids().zip(&starts).map(|(id, start)| {
            let mut generator = random::generator(scenario.seed, Some(id), Purpose::Study);
            let indices = Indices::draw(|bytes| {
                generator.fill_bytes(bytes);
                true
            });
            let clocks = Clocks::new(scenario, id);
            let mut client = Client::new(&origin, &aircraft.xplane, RATE_HZ, indices.expect("random numbers"));
            client.inquire();
            client.set_up(None, &scenario.plant).expect("a path that fits");
            let options = options(scenario, &origin, id, start, cell);
            let alt_m = options.alt_m + ground_m;
            let options = StandinOptions { acf: acf.to_owned(), alt_m, ..options };
            let simulator = Simulator::new(&options).expect("valid options");
            Vehicle {
                id,
                station: Station::new(scenario, id, Incarnation(1), (aircraft, Rules::shipped()), clocks)
                    .expect("a scenario that can be flown"),
                client,
                simulator,
                waiting: Vec::new(),
                command: None,
                plant_time: PlantTime::ZERO,
                steps: 0,
                commanded: None,
                largest_step: [0.0; 2],
            }
        });
        let mut swarm = Self {
            vehicles: vehicles.collect(),
            origin,
            schedule: Schedule::default(),
            zero: skein_host::clock::now(),
            workspace: Workspace::default(),
            events: Vec::new(),
        };
        for nth in 0..swarm.vehicles.len() {
            let appeared = PeerMessage::Appeared(swarm.vehicles[nth].id);
            swarm.schedule.after(DELAY_NS, WireEvent::Message(nth, Box::new(appeared)));
            // Simulators are not in step with each other.
            swarm.schedule.after(nth as u64 * 3_000_000, WireEvent::Frame(nth));
            swarm.renew(nth);
            swarm.plan_deadline(nth);
        }
        swarm.schedule.after(0, WireEvent::Observation);
        swarm
    }

    /// Time since the beginning.
    pub fn now(&self) -> LocalTime {
        LocalTime::from_nanoseconds(self.schedule.now_ns)
    }

    fn instant(&self) -> Instant {
        self.zero + Duration::from_nanos(self.schedule.now_ns)
    }

    /// Runs until this time, s.
    pub fn run_until(&mut self, t_s: f64) {
        while self.now().seconds() < t_s {
            self.run();
        }
    }

    /// Runs until the next observation, 20 ms.
    pub fn run(&mut self) {
        while let Some(event) = self.schedule.next_until(u64::MAX) {
            match event {
                WireEvent::Frame(nth) => self.frame(nth),
                WireEvent::Datagram(nth, datagram) => self.receive(nth, &datagram),
                WireEvent::Deadline(nth, steps) if self.vehicles[nth].steps == steps => self.step(nth, None),
                WireEvent::Deadline(..) => {}
                WireEvent::Message(from, message) => self.deliver(from, *message),
                WireEvent::Observation => {
                    self.schedule.after(OBSERVATION_NS, WireEvent::Observation);
                    return;
                }
            }
        }
    }

    /// Runs a frame of a simulator.
    fn frame(&mut self, nth: usize) {
        let Vehicle { simulator, waiting, .. } = &mut self.vehicles[nth];
        let (frame_s, presence) = simulator.begin_frame();
        let mut sent = Vec::new();
        if presence == RunState::Gone {
            waiting.clear();
        }
        if presence == RunState::Running {
            for datagram in std::mem::take(waiting) {
                if !simulator.receive(&datagram, address(nth)) {
                    break;
                }
            }
            simulator.end_frame(frame_s, |_, datagram| sent.push(datagram.to_vec()));
        }
        for datagram in sent {
            self.schedule.after(DELAY_NS, WireEvent::Datagram(nth, datagram));
        }
        self.schedule.after((frame_s * 1e9) as u64, WireEvent::Frame(nth));
    }

    fn receive(&mut self, nth: usize, datagram: &[u8]) {
        let now = self.instant();
        let client = &mut self.vehicles[nth].client;
        client.receive(datagram, simulator_address(), simulator_address().ip(), now);
        if let Some(frame) = client.frame() {
            self.step(nth, Some(frame));
        }
    }

    /// Steps the agent, as its control thread does.
    fn step(&mut self, nth: usize, frame: Option<Frame>) {
        let (now, instant) = (self.now(), self.instant());
        let vehicle = &mut self.vehicles[nth];
        vehicle.steps += 1;
        vehicle.plant_time = frame.map_or(vehicle.plant_time, |frame| frame.time);
        let plant = (vehicle.plant_time, frame.as_ref().map(|frame| &frame.measurement));
        let status = vehicle.client.status(instant);
        let outputs = vehicle.station.step(&Entering::of_plant(now, plant, &status), &mut self.workspace);
        if let Some(command) = outputs.command {
            // The first command after a pilot's controls is compared with these.
            let (before, is_next) = match vehicle.command.replace(command) {
                Some(Command::Release) => (status.controls, true),
                before => {
                    let is_next = vehicle.commanded.is_some_and(|at| now.seconds_since(at) < 0.1);
                    (before.and_then(Command::controls), is_next)
                }
            };
            if let (Some(before), Some(after), true) = (before, command.controls(), is_next) {
                let steps = [(after.roll - before.roll).abs(), (after.pitch - before.pitch).abs()];
                vehicle.largest_step = [0, 1].map(|axis| vehicle.largest_step[axis].max(steps[axis]));
            }
            vehicle.commanded = if command == Command::Release { vehicle.commanded } else { Some(now) };
            vehicle.client.command(command, instant, &mut |datagram| vehicle.waiting.push(datagram.to_vec()));
        }
        if vehicle.client.shows_peers() {
            let poses: Vec<_> = vehicle.station.agent().peer_poses(&self.origin).collect();
            vehicle.client.show_peers(&poses, instant, &mut |datagram| vehicle.waiting.push(datagram.to_vec()));
        }
        let happened = outputs.outbox.happened.iter().map(|what| (now.seconds(), vehicle.id, *what));
        self.events.extend(happened);
        self.send(nth, outputs.outbox);
        self.renew(nth);
        self.plan_deadline(nth);
    }

    fn plan_deadline(&mut self, nth: usize) {
        let timeout_ns = (TIMEOUT_PERIODS * self.vehicles[nth].client.frame_period_s() * 1e9) as u64;
        self.schedule.after(timeout_ns, WireEvent::Deadline(nth, self.vehicles[nth].steps));
    }

    fn renew(&mut self, nth: usize) {
        let now = self.instant();
        let Vehicle { client, waiting, .. } = &mut self.vehicles[nth];
        client.renew(now, &mut |datagram| waiting.push(datagram.to_vec()));
    }

    fn send(&mut self, nth: usize, outbox: Outbox) {
        let state = outbox.state.map(|state| ReceivedState::new(through_wire(&*state), &self.origin));
        let mission = outbox.mission.map(|mission| PeerMessage::Mission(through_wire(&*mission)));
        for message in state.map(PeerMessage::State).into_iter().chain(mission) {
            self.schedule.after(DELAY_NS, WireEvent::Message(nth, Box::new(message)));
        }
    }

    fn deliver(&mut self, from: usize, message: PeerMessage) {
        let now = self.now();
        let others = self.vehicles.iter_mut().enumerate().filter(|(nth, _)| *nth != from);
        others.for_each(|(_, vehicle)| vehicle.station.receive(now, [Received { message, at: now }]));
    }

    /// Writes a dataref of the simulator of the vehicle at this place.
    ///
    /// # Panics
    /// If the path does not fit into a message.
    pub fn write(&mut self, nth: usize, path: &str, value: f32) {
        let mut datagram = Vec::new();
        Write { value, path }.encode(&mut datagram).expect("a path that fits");
        self.order(nth, datagram);
    }

    /// Gives an order to all vehicles, as an operator who is in contact with each.
    pub fn give(&mut self, order: Order) {
        let now = self.now();
        let message = PeerMessage::Order(through_wire(&order));
        self.vehicles.iter_mut().for_each(|vehicle| vehicle.station.receive(now, [Received { message, at: now }]));
    }

    /// The simulator's frame of the vehicle at this place.
    pub fn truth(&self, nth: usize) -> Frame {
        self.vehicles[nth].simulator.truth()
    }

    /// Positions of the controls as the simulator of the vehicle at this place last reported them.
    pub fn controls(&self, nth: usize) -> Option<Controls> {
        self.vehicles[nth].client.controls(self.instant())
    }

    /// Sends a command of X-Plane to the simulator of the vehicle at this place.
    ///
    /// # Panics
    /// If the path does not fit into a message.
    pub fn command(&mut self, nth: usize, path: &str) {
        let mut datagram = Vec::new();
        operation::Command { path }.encode(&mut datagram).expect("a path that fits");
        self.order(nth, datagram);
    }

    /// Loads the aircraft file of this path in the simulator of the vehicle at this place.
    ///
    /// # Panics
    /// If the path does not fit into a message.
    pub fn load(&mut self, nth: usize, path: &str) {
        let mut datagram = Vec::new();
        Load { aircraft: 0, path, livery: 0 }.encode(&mut datagram).expect("a path that fits");
        self.order(nth, datagram);
    }

    /// Number that a dataref of the simulator of the vehicle at this place holds, as its Web API reads it.
    ///
    /// # Panics
    /// If the simulator has no such number.
    pub fn read(&mut self, nth: usize, path: &str) -> f64 {
        let dataref = DATAREFS.iter().position(|dataref| dataref.path == path).expect("a dataref");
        let values = self.vehicles[nth].simulator.serve(&Task::Read(vec![(dataref, None)])).expect("a frame");
        values.first().and_then(|value| value.as_f64()).expect("a number")
    }

    /// Sends an order to a simulator several times, because one may be lost.
    fn order(&mut self, nth: usize, datagram: Vec<u8>) {
        self.vehicles[nth].waiting.extend(std::iter::repeat_n(datagram, ORDER_REPEATS));
    }

    /// When the agent of the vehicle at this place last wrote the controls.
    pub fn commanded(&self, nth: usize) -> Option<LocalTime> {
        self.vehicles[nth].commanded
    }

    /// Largest change of roll and pitch from one command to the next so far.
    pub fn largest_step(&self, nth: usize) -> [f64; 2] {
        self.vehicles[nth].largest_step
    }

    /// The agent of the vehicle at this place.
    pub fn agent(&self, nth: usize) -> &Agent {
        self.vehicles[nth].station.agent()
    }

    /// True position and height above the ground of the vehicle at this place, m.
    pub fn place(&self, nth: usize) -> (PositionNed, f64) {
        let measurement = self.vehicles[nth].simulator.truth().measurement;
        (self.origin.ned_from_geodetic(&measurement.position), measurement.height_m)
    }

    /// Number of vehicles.
    pub fn vehicles(&self) -> usize {
        self.vehicles.len()
    }

    /// Places of the other aircraft that the simulator of the vehicle at this place draws.
    pub fn drawn(&mut self, nth: usize) -> Vec<PositionNed> {
        let server = &self.vehicles[nth].simulator.server;
        let drawn = (1..=19).filter_map(|number| server.other(number));
        let geodetic =
            drawn.map(|pose| Geodetic::from_degrees(pose.latitude_deg, pose.longitude_deg, pose.elevation_m));
        geodetic.map(|place| self.origin.ned_from_geodetic(&place)).collect()
    }

    /// Whether every vehicle is an active member.
    pub fn all_active(&self) -> bool {
        self.vehicles.iter().all(|vehicle| vehicle.station.agent().membership() == Membership::Active)
    }

    /// What the metrics take of every vehicle.
    pub fn observe(&self, t_s: f64, metrics: &mut Metrics) {
        let (sampled, now) = (metrics.sampled(), &self.vehicles);
        let vehicles: Vec<_> = now.iter().map(|vehicle| self.vehicle_now(vehicle)).collect();
        for vehicle in now {
            vehicle.station.agent().peer_ages(sampled).for_each(|peer| metrics.observe_age(peer.age_s));
        }
        metrics.observe(t_s, &vehicles);
    }

    fn vehicle_now(&self, vehicle: &Vehicle) -> VehicleNow {
        let (agent, frame) = (vehicle.station.agent(), vehicle.simulator.truth());
        let (position, convergence) = self.origin.locate(&frame.measurement.position);
        let velocity = convergence.velocity_from_local(frame.measurement.velocity);
        let attitude = convergence.attitude_from_local(frame.measurement.attitude);
        VehicleNow {
            id: vehicle.id,
            runs: true,
            membership: agent.membership(),
            truth: GroundTruth { position, velocity, attitude, ..frame.truth },
            controls: vehicle.command.and_then(Command::controls).filter(Controls::is_within_limits),
            step: agent.at_step(),
            reached: agent.reached(),
            centre_ne_m: agent.centre_ne_m(),
            in_contact: agent.peers_in_contact(),
            fresh: agent.fresh_peers(),
            fallback_flies: agent.fallback_flies(),
        }
    }
}

/// Flies the shipped hover with this seed for so long, s, whatever the frame rate; `None` if not all vehicles join.
pub fn fly(seed: u64, cell: Frames, duration_s: f64) -> Option<Report> {
    let scenario = Scenario { seed, ..scenario("hover.toml", &["plant.min_frame_rate_hz=0"]) };
    let mut swarm = Swarm::new(&scenario, cell);
    let mut metrics = Metrics::new(&scenario, Run::new(&scenario, "wire"));
    let mut zero_s = None;
    loop {
        swarm.run();
        let t_s = swarm.now().seconds();
        match zero_s {
            None if swarm.all_active() => zero_s = Some(t_s),
            None if t_s > JOIN_LIMIT_S => return None,
            None => {}
            Some(zero_s) if t_s - zero_s > duration_s => break,
            Some(zero_s) => swarm.observe(t_s - zero_s, &mut metrics),
        }
    }
    Some(metrics.report(Wall { wall_s: 0.0, real_time_factor: 0.0 }))
}

/// All cells of the table.
pub fn cells() -> Vec<Frames> {
    let rates = [100, 50, 30, 20, 15];
    let links = [(0.0, 0.0), (0.0, 0.05), (0.0, 0.2), (0.5, 0.0), (0.5, 0.05), (0.5, 0.2)];
    rates.iter().flat_map(|&rate| links.map(|(jitter, drop)| Frames { rate, jitter, drop })).collect()
}

/// The figures of the shipped hover in every cell: median and largest of the seeds.
pub fn table(seeds: u64) -> String {
    let mut text = "frames/s  jitter  lost  at altitude s   in band s        even 10 deg s    radial rms m   \
                    spacing deg    tilt deg       separation m  crashes\n"
        .to_owned();
    for cell in cells() {
        let flown: Vec<Option<Report>> = in_parallel(0..seeds, |seed| fly(seed, cell, 400.0));
        let of = |figure: fn(&Report) -> Option<f64>| {
            median_and_worst(flown.iter().map(|run| run.as_ref().and_then(figure)))
        };
        let lost: u64 = flown.iter().flatten().map(|run| run.crashes + run.collisions).sum();
        let separation = flown.iter().flatten().filter_map(|run| run.min_separation_m).fold(f64::MAX, f64::min);
        text += &format!(
            "{:<9} {:5.0} % {:3.0} %  {:<15} {:<16} {:<16} {:<14} {:<14} {:<14} {separation:12.1}  {lost}\n",
            cell.rate,
            100.0 * cell.jitter,
            100.0 * cell.drop,
            of(|run| run.at_altitude_s),
            of(|run| run.in_band_s),
            of(|run| run.even_10deg_s),
            of(|run| run.radial_rms_m),
            of(|run| run.spacing_error_deg),
            of(|run| Some(run.max_tilt_deg)),
        );
    }
    text
}
