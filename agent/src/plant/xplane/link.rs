//! The agent's side of the protocol: X-Plane as a [`Plant`].
//!
//! The link is one unconnected UDP socket on the control thread. X-Plane replies to the address that asked, from an
//! undocumented port. A reply is therefore recognised by the simulator's IP address, by the session's indices and by
//! what they prove (`session`). Any other datagram is dropped and counted.
//!
//! A position (RPOS) makes a frame. Dataref values (RREF) update the latest value and make no frame. Of several queued
//! positions the newest makes the frame. `clock` estimates the simulator's time; while it is stopped, in a paused
//! simulator, positions make no frames and [`Plant::wait`] ends at its deadline.

mod beacon;
mod controls;
mod session;

use std::fmt;
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use skein_common::frame::Origin;
use skein_host::clock::now;

use super::clock::Clock;
use super::convert;
use super::socket::{Port, Received};
use super::wire::rpos::{self, Position};
use super::wire::{PORT, WireError, rref};
use beacon::Search;
use controls::ControlWriter;
use session::{Indices, Provenance, Sender, Senders, Value};
use skein_core::aircraft::{Dataref, Profile};
use skein_core::plant::{Command, Controls, Frame, Plant, Wake};

/// Time between two subscriptions, needed because X-Plane forgets its subscribers when it restarts.
const RESUBSCRIBE: Duration = Duration::from_secs(5);
/// Time between two subscriptions while no position arrives.
const RESUBSCRIBE_SILENT: Duration = Duration::from_secs(1);
/// Time between two confirmations of the overrides.
const CONFIRM_OVERRIDES: Duration = Duration::from_millis(200);
/// Age at which a dataref's value expires.
const STALE: Duration = Duration::from_secs(1);
/// Largest number of queued datagrams read without waiting: a flood must not delay the newest position.
const MAX_QUEUED: u32 = 1024;
/// The release is sent several times, because X-Plane does not acknowledge it and a lost one would leave the pilot
/// without control.
const RELEASE_REPEATS: u32 = 3;

/// Why the link to the simulator could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum XPlaneLinkError {
    /// The socket for the simulator could not be opened.
    #[error("cannot open a UDP socket on {listen}: {source}")]
    Bind {
        /// Local address to bind.
        listen: IpAddr,
        /// The system's error.
        source: io::Error,
    },
    /// The socket for the beacon could not be opened, and the scenario gives no address.
    #[error("cannot listen for X-Plane's beacon: {0}; give the simulator's address instead")]
    Beacon(io::Error),
    /// The simulator and the local address are of different families.
    #[error("an X-Plane at {simulator} cannot be reached from {listen}: one is IPv4, the other IPv6")]
    AddressFamily {
        /// The simulator's address.
        simulator: SocketAddr,
        /// Local address to bind.
        listen: IpAddr,
    },
    /// A dataref of the aircraft's profile does not fit into a message.
    #[error("a dataref of the aircraft's profile cannot be encoded: {0}")]
    Profile(WireError),
    /// The system cannot generate indices that other programs cannot guess.
    #[error("this system provides no random numbers, which are needed to recognise X-Plane's replies")]
    NoRandomness,
}

/// Counts since the link was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames delivered.
    pub frames: u64,
    /// Datagrams that do not follow the protocol or have implausible numbers.
    pub malformed: u64,
    /// Datagrams that the simulator did not send: from another address, with unrequested indices, or with positions of
    /// another sender.
    pub foreign: u64,
    /// Positions that came before the simulator's sending port was known.
    pub unproven: u64,
    /// Positions skipped because a newer one was queued behind them.
    pub skipped_frames: u64,
    /// Pauses longer than one and a half frame periods between two positions.
    pub gaps: u64,
    /// Positions that came while the simulator's time was stopped.
    pub frozen_frames: u64,
    /// Commands outside the controls' travel, which were not sent.
    pub refused_commands: u64,
    /// Socket errors, including those because the simulator is not up.
    pub faults: u64,
}

/// Link to one X-Plane, real or a stand-in.
pub struct XPlane {
    origin: Origin,
    rate_hz: u32,
    rotor_speed_rpm: Dataref,
    indices: Indices,
    senders: Senders,
    port: Port,
    listen: IpAddr,
    simulator: Option<SocketAddr>,
    search: Option<Search>,
    controls: ControlWriter,
    clock: Clock,
    /// When the rotor speed arrived, and its value in revolutions per minute.
    rotor_speed: Option<(Instant, f32)>,
    version: Option<u32>,
    last_position: Option<Instant>,
    last_subscribed: Option<Instant>,
    overrides_confirmed: Option<Instant>,
    outgoing: Vec<u8>,
    counters: Counters,
}

impl XPlane {
    /// Prepares a link to the X-Plane at `address`, or to the one on this host that announces itself by its beacon. It
    /// will ask for `rate_hz` positions a second at a free port of `listen`. It sends nothing before the first
    /// [`Plant::wait`] and does not touch the controls before the first [`Plant::command`].
    ///
    /// # Errors
    /// If a socket cannot be opened, a dataref does not fit, or the system provides no random numbers.
    pub fn new(
        origin: &Origin,
        address: Option<SocketAddr>,
        profile: &Profile,
        rate_hz: u32,
        listen: IpAddr,
    ) -> Result<Self, XPlaneLinkError> {
        let simulator = address.unwrap_or((Ipv4Addr::LOCALHOST, PORT).into());
        if simulator.is_ipv4() != listen.is_ipv4() {
            return Err(XPlaneLinkError::AddressFamily { simulator, listen });
        }
        let search = if address.is_none() { Some(Search::new().map_err(XPlaneLinkError::Beacon)?) } else { None };
        let port = UdpSocket::bind((listen, 0)).and_then(Port::new);
        Ok(Self {
            origin: *origin,
            rate_hz: rate_hz.max(1),
            rotor_speed_rpm: profile.rotor_speed_rpm.clone(),
            indices: Indices::draw().ok_or(XPlaneLinkError::NoRandomness)?,
            senders: Senders::default(),
            port: port.map_err(|source| XPlaneLinkError::Bind { listen, source })?,
            listen,
            simulator: address,
            search,
            controls: ControlWriter::new(profile).map_err(XPlaneLinkError::Profile)?,
            clock: Clock::new(),
            rotor_speed: None,
            version: None,
            last_position: None,
            last_subscribed: None,
            overrides_confirmed: None,
            outgoing: Vec::with_capacity(rref::REQUEST_SIZE),
            counters: Counters::default(),
        })
    }

    /// Address of the simulator, once known.
    pub fn simulator(&self) -> Option<SocketAddr> {
        self.simulator
    }

    /// X-Plane's version number, once received: 121400 is 12.1.4.
    pub fn version(&self) -> Option<u32> {
        self.version
    }

    /// Whether the simulator reports that it is paused.
    pub fn is_paused(&self) -> bool {
        self.clock.is_paused()
    }

    /// Last measured rate, simulated seconds per local second; 1 until measured.
    pub fn time_rate(&self) -> f64 {
        self.clock.rate()
    }

    /// Counts so far.
    pub fn counters(&self) -> Counters {
        Counters { faults: self.port.faults, ..self.counters }
    }

    /// Address of the simulator; searches for its beacon if none was given.
    fn find(&mut self, deadline: Instant) -> Option<SocketAddr> {
        if let (None, Some(search)) = (self.simulator, &mut self.search) {
            let port = search.find(deadline, &mut self.counters)?;
            // The simulator is on this host and replies from the address at which it was asked.
            let host = if self.listen.is_unspecified() { Ipv4Addr::LOCALHOST.into() } else { self.listen };
            self.simulator = Some(SocketAddr::new(host, port));
            self.search = None;
        }
        self.simulator
    }

    fn renew_subscription(&mut self, simulator: SocketAddr) {
        let now = now();
        let is_over = |since: Option<Instant>, timeout| since.is_none_or(|since| now >= since + timeout);
        let is_silent = is_over(self.last_position, RESUBSCRIBE_SILENT);
        let timeout = if is_silent { RESUBSCRIBE_SILENT } else { RESUBSCRIBE };
        if is_over(self.last_subscribed, timeout) {
            self.subscribe(simulator, self.rate_hz, 1);
            self.last_subscribed = Some(now);
        }
    }

    /// Requests the position and the values; rates of zero end the subscription.
    fn subscribe(&mut self, simulator: SocketAddr, rate_hz: u32, slow_hz: u32) {
        rpos::PositionRequest { rate_hz }.encode(&mut self.outgoing);
        // A lost request is repeated later.
        let _ = self.port.send(&self.outgoing, simulator);
        for value in Value::ALL {
            let frequency_hz = if value == Value::Version { slow_hz } else { rate_hz };
            let (index, path) = (self.indices.of(value), value.path(&self.rotor_speed_rpm));
            if (rref::DatarefRequest { frequency_hz, index, path }).encode(&mut self.outgoing).is_ok() {
                let _ = self.port.send(&self.outgoing, simulator);
            }
        }
    }

    /// The newest position that is queued or arrives before the deadline, with its arrival time.
    fn newest_position(&mut self, simulator: IpAddr, deadline: Instant) -> Option<(Position, Instant)> {
        let mut newest = None;
        let mut may_take = MAX_QUEUED;
        while may_take > 0 {
            let at_once = newest.is_some() || now() >= deadline;
            match self.port.receive((!at_once).then_some(deadline)) {
                Received::Datagram(size, from) => {
                    if let Some(position) = self.process(size, from, simulator) {
                        self.counters.skipped_frames += u64::from(newest.is_some());
                        newest = Some(position);
                    }
                }
                Received::Fault => {}
                Received::Nothing => break,
            }
            may_take -= u32::from(at_once);
        }
        newest
    }

    /// Processes one datagram; returns the position if it is one of the simulator.
    fn process(&mut self, size: usize, from: SocketAddr, simulator: IpAddr) -> Option<(Position, Instant)> {
        if from.ip() != simulator {
            self.refuse_foreign(from, "which is not the simulator's address");
            return None;
        }
        let now = now();
        let datagram = self.port.datagram(size);
        let outcome = match datagram.first_chunk() {
            Some(&rpos::TAG) => Position::decode(datagram).map(Some),
            Some(&rref::TAG) => self.take_values(size, from, now).map(|()| None),
            _ => Err(WireError::WrongTag),
        };
        match outcome {
            Ok(position) => {
                position.filter(|position| self.is_own(from, position, now)).map(|position| (position, now))
            }
            Err(error) => {
                self.refuse(error);
                None
            }
        }
    }

    /// Whether this position is the simulator's.
    fn is_own(&mut self, from: SocketAddr, position: &Position, now: Instant) -> bool {
        match self.senders.assess(from, position, now, self.frame_period_s(), self.clock.rate()) {
            Sender::Simulator => return true,
            Sender::Unproven => self.counters.unproven += 1,
            Sender::Foreign(Some(excess_m)) if excess_m > 0.0 => {
                self.refuse_foreign(
                    from,
                    format_args!("whose position is {excess_m:.1} m farther away than X-Plane's values allow"),
                );
            }
            Sender::Foreign(_) => self.refuse_foreign(from, "whose positions compete with another sender's"),
        }
        false
    }

    fn take_values(&mut self, size: usize, from: SocketAddr, now: Instant) -> Result<(), WireError> {
        let values = rref::decode_values(self.port.datagram(size))?;
        match self.indices.assess(values.map(|(index, _)| index)) {
            Provenance::Proof => self.senders.prove(from, now),
            Provenance::Ours => {}
            Provenance::Foreign => {
                self.refuse_foreign(from, "whose values were not asked for");
                return Ok(());
            }
        }
        for (index, value) in rref::decode_values(self.port.datagram(size))? {
            match self.indices.value(index) {
                _ if !value.is_finite() => self.counters.malformed += 1,
                Some(Value::RunningTime) => self.clock.running_time(now, value),
                Some(Value::Paused) => self.clock.set_paused(value != 0.0),
                Some(Value::RotorSpeed) => self.rotor_speed = Some((now, value)),
                Some(Value::Version) => self.version = Some(value as u32),
                Some(part) => self.senders.place(part, value, now),
                None => {}
            }
        }
        Ok(())
    }

    /// Counts a datagram of another program; logs the first, second, fourth, eighth and so on.
    fn refuse_foreign(&mut self, from: SocketAddr, why: impl fmt::Display) {
        self.counters.foreign += 1;
        if self.counters.foreign.is_power_of_two() {
            tracing::warn!(foreign = self.counters.foreign, "dropped a datagram from {from}, {why}");
        }
    }

    /// Counts a malformed datagram of the simulator; logs the first, second, fourth, eighth and so on.
    fn refuse(&mut self, error: WireError) {
        self.counters.malformed += 1;
        if self.counters.malformed.is_power_of_two() {
            tracing::warn!(malformed = self.counters.malformed, "dropped a datagram from the simulator: {error}");
        }
    }

    /// Makes a frame of a position, unless it is not plausible or the simulator's time is stopped.
    fn frame(&mut self, position: &Position, at: Instant) -> Option<Frame> {
        let rotor_speed_rad_s = self
            .rotor_speed
            .filter(|&(since, _)| at.saturating_duration_since(since) < STALE)
            .map(|(_, rpm)| convert::rad_s_from_rpm(rpm.into()));
        let Some(measurement) = convert::measurement(position, rotor_speed_rad_s) else {
            self.refuse(WireError::OutOfRange);
            return None;
        };
        let longest = Duration::from_secs_f64(1.5 * self.frame_period_s());
        let last = self.last_position.replace(at);
        self.counters.gaps += u64::from(last.is_some_and(|last| at > last + longest));
        let Some(time) = self.clock.frame(at) else {
            self.counters.frozen_frames += 1;
            return None;
        };
        self.counters.frames += 1;
        Some(Frame { time, truth: convert::truth(&measurement, &self.origin), measurement })
    }
}

impl Plant for XPlane {
    fn wait(&mut self, timeout: Duration) -> Wake {
        let deadline = now() + timeout;
        let Some(simulator) = self.find(deadline) else { return Wake::Deadline };
        self.renew_subscription(simulator);
        while let Some((position, at)) = self.newest_position(simulator.ip(), deadline) {
            if let Some(frame) = self.frame(&position, at) {
                return Wake::Frame(frame);
            }
            if now() >= deadline {
                break;
            }
        }
        Wake::Deadline
    }

    fn command(&mut self, command: Command) {
        let Some(simulator) = self.simulator else { return };
        let Some(controls) = command.controls().filter(Controls::is_within_limits) else {
            self.counters.refused_commands += 1;
            return;
        };
        let now = now();
        if self.overrides_confirmed.is_none_or(|at| now >= at + CONFIRM_OVERRIDES) {
            self.controls.take(&mut self.port, simulator);
            self.overrides_confirmed = Some(now);
        }
        self.controls.set(controls, &mut self.port, simulator);
    }

    fn release(&mut self) {
        let Some(simulator) = self.simulator else { return };
        let was_holding = self.overrides_confirmed.take().is_some();
        let was_subscribed = self.last_subscribed.take().is_some();
        for _ in 0..RELEASE_REPEATS {
            if was_holding {
                self.controls.release(&mut self.port, simulator);
            }
            if was_subscribed {
                self.subscribe(simulator, 0, 0);
            }
        }
    }

    fn frame_period_s(&self) -> f64 {
        1.0 / f64::from(self.rate_hz)
    }

    fn skipped_frames(&self) -> u64 {
        self.counters.skipped_frames
    }

    fn malformed(&self) -> u64 {
        self.counters.malformed
    }

    fn foreign(&self) -> u64 {
        self.counters.foreign
    }
}

impl Drop for XPlane {
    /// Releases the controls however the agent ends, so that the pilot gets them back.
    fn drop(&mut self) {
        self.release();
    }
}

#[cfg(test)]
mod tests;
