//! The simulator's side of the protocol: X-Plane's reply to each datagram. It has no socket and no clock: the caller
//! runs each frame and sends the datagrams.
//!
//! As in X-Plane, requests are neither confirmed nor rejected. Datagrams of a wrong size, unknown datarefs and writes
//! to read-only ones are ignored. A subscription is identified by the client's address, port and index, and lasts until
//! the client ends it. A written value takes effect in the next frame. An axis without an override belongs to the
//! pilot, whose controls are always centred here.
//!
//! While it is paused or in replay, time stands still, and the messages continue. A reset gives the overrides back. Datarefs
//! below `skein/standin/` order faults, so that tests and students see what a real simulator does on a bad day.

mod air;
mod clients;
mod datarefs;
mod motion;
mod output;
mod settings;
mod weather;
mod web;

use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;

use super::convert;
use super::wire::aircraft::{ACFN, Load, Move, VEHS, VEHX};
use super::wire::becn::{self, Beacon};
use super::wire::dref::{self, Write};
use super::wire::operation::{self, Command};
use super::wire::prel::{self, Placement};
use super::wire::{self, WireError, radr, rows, rpos, rref};
use clients::Clients;
pub use datarefs::{DATAREFS, DEFAULT_ACF, Dataref, Surroundings, ValueType};
use datarefs::{Handle, Others, Situation, reference_below};
use motion::Motion;
use output::{Radar, Rows};
pub(super) use settings::Setting;
use settings::Settings;
use skein_common::frame::TangentPlane;
use skein_core::plant::{Controls, Frame};
pub use weather::{MOST_TURBULENT, SEVERE_W20_M_S};
pub use web::{Elements, Flight, Task};

/// A client silent for this long counts as gone where that matters, s. Our agents subscribe again every five seconds.
const PRESUMED_GONE_S: u64 = 12;
/// Largest number of unknown datarefs that are remembered, so that each is logged once.
const MAX_UNKNOWN: usize = 64;
/// Longest time that X-Plane simulates in one frame, s.
const LONGEST_STEP_S: f64 = 1.0 / 19.0;

/// Version of X-Plane to emulate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Version {
    /// X-Plane 11.55
    #[value(name = "11")]
    V11,
    /// X-Plane 12.4.0
    #[value(name = "12")]
    V12,
}

impl Version {
    /// X-Plane's internal version number.
    pub fn internal(self) -> i32 {
        match self {
            Self::V11 => 115_501,
            Self::V12 => 124_000,
        }
    }

    /// Number of elements of per-engine arrays.
    fn engines(self) -> usize {
        match self {
            Self::V11 => 8,
            Self::V12 => 16,
        }
    }
}

/// An order to the caller about the user's own aircraft, after a datagram.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// Put it to this place.
    Place(Placement),
    /// Hold it in this pose, or let it fly on from there.
    Move(Move),
    /// Put it back to its start.
    Reset,
    /// Do nothing for this many seconds, as a program that hangs.
    Freeze(f32),
    /// End, and start again after this many seconds.
    Restart(f32),
}

/// The effect of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Pauses a running simulation, resumes a paused one.
    PauseToggle,
    /// Pauses.
    Pause,
    /// Resumes.
    Resume,
    /// Puts the aircraft back to its start and gives the controls back.
    Reset,
}

/// A command of the simulator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandEntry {
    /// Its name.
    pub path: &'static str,
    /// The description that X-Plane shows.
    pub description: &'static str,
    /// Its effect.
    pub action: Action,
}

const fn command(path: &'static str, description: &'static str, action: Action) -> CommandEntry {
    CommandEntry { path, description, action }
}

/// All commands that do something.
pub static COMMANDS: &[CommandEntry] = &[
    command("sim/operation/pause_toggle", "Pause or resume the simulation.", Action::PauseToggle),
    command("sim/operation/pause_on", "Pause the simulation.", Action::Pause),
    command("sim/operation/pause_off", "Resume the simulation.", Action::Resume),
    command("sim/operation/reset_flight", "Reset the flight to its most recent start.", Action::Reset),
    command("sim/operation/reset_to_runway", "Reset the flight to the nearest runway.", Action::Reset),
    command("sim/operation/go_to_default", "Reset the flight to the nearest airport.", Action::Reset),
    command("sim/operation/reload_aircraft", "Reload the aircraft and its art.", Action::Reset),
    command("sim/operation/reload_aircraft_no_art", "Reload the aircraft without its art.", Action::Reset),
];

/// Function of an axis of the pilot's stick that moves the collective.
const COLLECTIVE_FUNCTION: usize = 5;

/// State of the simulator's side between frames.
pub struct Server {
    version: Version,
    frame_rate_hz: u32,
    frames: u64,
    /// Simulated time since the start, s.
    running_s: f64,
    /// Whether time stands still because of a pause.
    pub is_paused: bool,
    /// Number of datagrams so far that would have ended X-Plane or the computer.
    pub refused_ends: u64,
    clients: Clients,
    rows: Rows,
    radar: Radar,
    settings: Settings,
    surroundings: Surroundings,
    /// Frame in which written weather is taken over.
    weather_due: Option<u64>,
    /// The situation of the last frame, for clients of the Web API.
    situation: Option<Situation>,
    /// Velocity of the last frame, and the specific force since the one before.
    motion: Option<Motion>,
    /// Poses of the other aircraft.
    others: Others,
    /// The files that clients have loaded last for the other aircraft, by number.
    pub loaded: BTreeMap<u8, String>,
    /// Origin of X-Plane's local frame.
    reference: Option<TangentPlane>,
    has_collective: bool,
    /// Whether a client has moved the pilot's stick.
    has_stick: bool,
    /// Number of malformed datagrams so far.
    pub malformed: u64,
    unknown: BTreeSet<String>,
    pairs: Vec<(i32, f32)>,
    outgoing: Vec<u8>,
}

impl Server {
    /// A simulator with a running engine and free controls, which draws `frame_rate_hz` frames a second.
    pub fn new(version: Version, frame_rate_hz: u32, surroundings: Surroundings) -> Self {
        let frame_rate_hz = frame_rate_hz.max(1);
        let mut settings = Settings::new();
        weather::show(&mut settings, &surroundings.weather);
        Self {
            version,
            frame_rate_hz,
            frames: 0,
            running_s: 0.0,
            is_paused: false,
            refused_ends: 0,
            rows: Rows::default(),
            radar: Radar::default(),
            clients: Clients::new(frame_rate_hz, PRESUMED_GONE_S * u64::from(frame_rate_hz)),
            settings,
            surroundings,
            weather_due: None,
            situation: None,
            motion: None,
            others: Others::default(),
            loaded: BTreeMap::new(),
            reference: None,
            has_collective: false,
            has_stick: false,
            malformed: 0,
            unknown: BTreeSet::new(),
            pairs: Vec::with_capacity(rref::MAX_VALUES),
            outgoing: Vec::new(),
        }
    }

    /// Processes a datagram. Returns what the caller has to do with the user's own aircraft.
    #[must_use]
    pub fn handle(&mut self, datagram: &[u8], from: SocketAddr) -> Option<Order> {
        self.clients.received(from, self.frames);
        let outcome = match datagram.first_chunk() {
            Some(&rpos::TAG) => wire::decode_rate(datagram, &rpos::TAG)
                .map(|rate_hz| self.clients.subscribe_position(from, rate_hz, self.frames))
                .map(|()| None),
            Some(&rref::TAG) => self.subscribe_value(datagram, from).map(|()| None),
            Some(&dref::TAG) => self.write(datagram),
            Some(&prel::TAG) => Placement::decode(datagram).map(|placement| self.place(placement)),
            Some(&operation::CMND) => Command::decode(datagram).map(|command| self.run(command)),
            Some(&rows::TAG) => rows::decode_rows(datagram).map(|rows| {
                self.has_collective |= output::write(&rows, &mut self.settings);
                None
            }),
            Some(tag) if [VEHX, VEHS].contains(tag) => Move::decode(datagram).map(|moved| self.move_aircraft(moved)),
            Some(&ACFN) => Load::decode(datagram).map(|load| self.load(&load)),
            Some(&radr::TAG) => wire::decode_rate(datagram, &radr::TAG)
                .map(|rate_hz| self.radar.subscribe(from, rate_hz, self.frame_rate_hz))
                .map(|()| None),
            Some(tag) if operation::ENDS.contains(tag) => {
                // A class of students shares a network: one of them must not end the simulator of another.
                self.refused_ends += 1;
                Ok(None)
            }
            Some(_) => self.rows.handle(datagram, from).map(|()| None),
            None => Err(WireError::WrongSize),
        };
        outcome.unwrap_or_else(|error| {
            self.malformed += 1;
            if self.malformed.is_power_of_two() {
                tracing::debug!(malformed = self.malformed, %from, "ignored a datagram: {error}");
            }
            None
        })
    }

    /// Moves an aircraft. Under VEHX its own path ends, until a client gives that back.
    fn move_aircraft(&mut self, moved: Move) -> Option<Order> {
        let number = usize::from(moved.aircraft);
        if moved.tag == VEHX {
            self.settings.store(Setting::OverridePlanePath, number, 1.0);
        }
        match number.checked_sub(1) {
            None => return Some(Order::Move(moved)),
            Some(nth) => self.others.get_mut(nth).into_iter().for_each(|other| *other = Some(moved)),
        }
        None
    }

    /// Whether a client holds the user's own aircraft in a pose, without its flight model.
    pub fn holds_own(&self) -> bool {
        self.settings.get(Setting::OverridePlanePath, 0) != 0.0
    }

    /// Loads the user's own aircraft, which begins a new flight in the same place after some seconds without frames; of the
    /// other aircraft only the path is kept.
    fn load(&mut self, load: &Load<'_>) -> Option<Order> {
        if load.aircraft > 0 {
            self.loaded.insert(load.aircraft, load.path.to_owned());
            return None;
        }
        self.surroundings.acf = load.path.into();
        self.give_back();
        Some(self.settings.first(Setting::LoadTime)).filter(|&seconds| seconds > 0.0).map(Order::Freeze)
    }

    /// Pose of the other aircraft of this number, 1 to 19, if a client has moved it.
    pub fn other(&self, number: u8) -> Option<&Move> {
        self.others.get(usize::from(number).checked_sub(1)?)?.as_ref()
    }

    /// A placement begins a new flight, in which the pilot has the controls.
    fn place(&mut self, placement: Placement) -> Option<Order> {
        (placement.aircraft == 0).then(|| {
            self.give_back();
            Order::Place(placement)
        })
    }

    /// Runs a command; those that are not in [`COMMANDS`] do nothing here.
    fn run(&mut self, command: Command<'_>) -> Option<Order> {
        match COMMANDS.iter().find(|entry| entry.path == command.path) {
            Some(entry) => self.act(entry.action),
            None => {
                tracing::debug!(path = command.path, "a command without effect here");
                None
            }
        }
    }

    fn act(&mut self, action: Action) -> Option<Order> {
        match action {
            Action::PauseToggle => self.is_paused = !self.is_paused,
            Action::Pause => self.is_paused = true,
            Action::Resume => self.is_paused = false,
            Action::Reset => {
                self.give_back();
                return Some(Order::Reset);
            }
        }
        None
    }

    /// Gives the controls back and ends a replay and a crash; the weather and the orders for the network stay.
    fn give_back(&mut self) {
        let old = std::mem::replace(&mut self.settings, Settings::new());
        let own = [Setting::DataRate, Setting::RandomFailures, Setting::Speed, Setting::DropShare, Setting::LoadTime];
        let of_flight = [Setting::LocalTime, Setting::LocalDate, Setting::Payload, Setting::Fuel];
        weather::SETTINGS.into_iter().chain([&own[..], &of_flight]).for_each(|kept| self.settings.keep(&old, kept));
        (self.has_collective, self.has_stick) = (false, false);
    }

    /// Whether the past is shown, while time stands still.
    pub fn is_in_replay(&self) -> bool {
        self.settings.first(Setting::Replay) != 0.0
    }

    /// Whether the aircraft has crashed and lies where it is until the next reset.
    pub fn has_crashed(&self) -> bool {
        self.settings.first(Setting::Crash) != 0.0
    }

    /// Share of datagrams, of both directions, that the network loses.
    pub fn drop_share(&self) -> f64 {
        self.settings.first(Setting::DropShare).into()
    }

    /// Sets the share of datagrams that the network loses.
    pub fn set_drop_share(&mut self, share: f64) {
        self.settings.store(Setting::DropShare, 0, share as f32);
    }

    /// Time that is simulated in a frame of this length, s. X-Plane never simulates more than 1/19 s in one frame: with
    /// fewer frames a second its time is slower than real time.
    pub fn simulated_s(&self, frame_s: f64) -> f64 {
        let speed = f64::from(self.settings.first(Setting::Speed));
        if self.is_paused || self.is_in_replay() { 0.0 } else { frame_s.min(LONGEST_STEP_S) * speed }
    }

    fn subscribe_value(&mut self, datagram: &[u8], from: SocketAddr) -> Result<(), WireError> {
        let rref::DatarefRequest { frequency_hz, index, path } = rref::DatarefRequest::decode(datagram)?;
        if frequency_hz == 0 {
            self.clients.unsubscribe_value(from, index);
        } else if let Some(handle) = self.find(path) {
            self.clients.subscribe_value(from, index, handle, frequency_hz, self.frames);
        }
        Ok(())
    }

    fn write(&mut self, datagram: &[u8]) -> Result<Option<Order>, WireError> {
        let Write { value, path } = Write::decode(datagram)?;
        let written = self.find(path).and_then(|handle| handle.write(value, &mut self.settings));
        Ok(written.and_then(|setting| self.after_write(setting)))
    }

    /// Follows a written setting with its consequences.
    fn after_write(&mut self, setting: Setting) -> Option<Order> {
        self.has_collective |= setting == Setting::Collective;
        self.has_stick |= setting == Setting::Stick;
        self.weather_written(setting);
        let ordered_s = Some(self.settings.first(setting)).filter(|&seconds| seconds > 0.0);
        match setting {
            Setting::Freeze => ordered_s.map(Order::Freeze),
            Setting::Restart => ordered_s.map(Order::Restart),
            _ => None,
        }
    }

    fn find(&mut self, path: &str) -> Option<Handle> {
        let handle = Handle::find(path, self.version.engines(), &self.surroundings.acf);
        if handle.is_none() && self.unknown.len() < MAX_UNKNOWN && self.unknown.insert(path.to_owned()) {
            tracing::info!(dataref = path, "unknown dataref or array element");
        }
        handle
    }

    /// Starts a frame: returns the controls if a client holds them, which it does while an override is 1, from the
    /// first written collective on. An axis without an override springs back to its centre, or where the pilot's stick is
    /// if a client has moved that: then the pilot flies while no override is on.
    pub fn take_controls(&mut self) -> Option<Controls> {
        let is_on = |settings: &Settings, setting| settings.first(setting) != 0.0;
        let has_joystick = is_on(&self.settings, Setting::OverrideJoystick);
        let mut is_held = has_joystick;
        // Each axis with the function of the pilot's stick that moves it.
        for (axis, its_override, function) in [
            (Setting::Roll, Setting::OverrideRoll, 2),
            (Setting::Pitch, Setting::OverridePitch, 1),
            (Setting::Yaw, Setting::OverrideYaw, 3),
        ] {
            if has_joystick || is_on(&self.settings, its_override) {
                is_held = true;
            } else {
                let by_stick = if self.has_stick { self.settings.get(Setting::Stick, function) } else { 0.0 };
                self.settings.set_first(axis, by_stick);
            }
        }
        let is_flown = is_held || self.has_stick;
        if self.has_stick && !is_held {
            self.settings.set_all(Setting::Collective, self.settings.get(Setting::Stick, COLLECTIVE_FUNCTION));
        }
        let stick = |setting| f64::from(self.settings.first(setting));
        (is_flown && self.has_collective).then(|| Controls {
            roll: stick(Setting::Roll),
            pitch: stick(Setting::Pitch),
            yaw: stick(Setting::Yaw),
            collective: stick(Setting::Collective),
        })
    }

    /// Ends a frame that lasted `frame_s`: passes each datagram that is due to `send`, the values before the position.
    pub fn publish(&mut self, frame: &Frame, frame_s: f64, mut send: impl FnMut(SocketAddr, &[u8])) {
        let simulated_s = self.simulated_s(frame_s);
        self.frames += 1;
        self.running_s += simulated_s;
        if self.settings.first(Setting::MoveOrigin) != 0.0 {
            self.settings.set_first(Setting::MoveOrigin, 0.0);
            self.reference = None;
        }
        let reference = self.reference.get_or_insert_with(|| reference_below(&frame.measurement.position));
        let local = reference.ned_from_geodetic(&frame.measurement.position);
        let motion = self.motion.take().unwrap_or_else(|| Motion::begin(frame)).after(frame);
        self.motion = Some(motion);
        let situation = Situation {
            position: convert::position(&frame.measurement, reference),
            true_attitude: frame.measurement.attitude,
            rotor_speed_rad_s: frame.measurement.rotor_speed_rad_s.unwrap_or(0.0),
            specific_force_g: motion.specific_force_g,
            local_m: [local.y, -local.z, -local.x],
            reference: reference.geodetic(),
            running_s: self.running_s,
            flight_s: frame.time.seconds(),
            frame_period_s: frame_s,
            speed: simulated_s / frame_s,
            version: self.version.internal(),
            is_paused: self.is_paused,
            surroundings: self.surroundings.clone(),
            others: self.others,
        };
        for client in &mut self.clients.all {
            self.pairs.clear();
            for value in &mut client.values {
                if value.schedule.is_due(self.frame_rate_hz) {
                    self.pairs.push((value.index, value.handle.read(&situation, &self.settings) as f32));
                }
            }
            for batch in self.pairs.chunks(rref::MAX_VALUES) {
                if rref::encode_values(batch, &mut self.outgoing).is_ok() {
                    send(client.address, &self.outgoing);
                }
            }
            if client.position.as_mut().is_some_and(|position| position.is_due(self.frame_rate_hz)) {
                situation.position.encode(&mut self.outgoing);
                send(client.address, &self.outgoing);
            }
        }
        let version = self.version;
        if let Some(to) = self.rows.due(&situation, &self.settings, version, &mut self.outgoing) {
            send(to, &self.outgoing);
        }
        if let Some(to) = self.radar.due(&situation, version, self.frame_rate_hz, &mut self.outgoing) {
            send(to, &self.outgoing);
        }
        self.situation = Some(situation);
    }

    /// The beacon, in the first frame and then once a second.
    pub fn beacon(&mut self, port: u16, computer: &str) -> Option<&[u8]> {
        if !self.frames.is_multiple_of(self.frame_rate_hz.into()) {
            return None;
        }
        let beacon = Beacon {
            minor: 2,
            host_id: 1,
            version: self.version.internal(),
            role: 1,
            port,
            name: computer.to_owned(),
            raknet_port: Some(becn::RAKNET_PORT),
        };
        beacon.encode(&mut self.outgoing).ok().map(|()| self.outgoing.as_slice())
    }

    /// Removes the client at this address, which has gone.
    pub fn forget(&mut self, client: SocketAddr) {
        self.clients.forget(client);
        self.radar.forget(client);
    }

    /// Whether a subscriber has sent anything lately.
    pub fn is_used(&self) -> bool {
        let lately = PRESUMED_GONE_S * u64::from(self.frame_rate_hz);
        self.clients.all.iter().any(|client| client.last_received + lately >= self.frames)
    }
}

#[cfg(test)]
mod tests;
