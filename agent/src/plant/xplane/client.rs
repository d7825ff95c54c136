//! The agent's side of the protocol without socket and clock: it reads the simulator's datagrams, makes frames of them
//! and writes its own.
//!
//! X-Plane replies to the address that asked, from an undocumented port. A reply is therefore recognised by the
//! simulator's IP address, by the session's indices and by what they prove (`session`). Any other datagram is dropped and
//! counted.
//!
//! A position (RPOS) makes a frame. Dataref values (RREF) update the latest value and make no frame. Of several positions
//! that were received together the newest makes the frame. `clock` estimates the simulator's time; while it is stopped,
//! in a paused simulator, positions make no frames.

mod clock;
mod holder;
mod inquiry;
mod pilot;
mod session;
mod traffic;

use std::fmt;
use std::net::{IpAddr, SocketAddr};
use std::time::{Duration, Instant};

use skein_common::frame::{Geodetic, Origin, TangentPlane};
use skein_common::math::{cos, hypot};
use skein_common::message::Standstill;
use skein_common::scenario::VehicleModel;

use super::convert;
use super::placing::{NEAR_ORIGIN_M, Placing, PlacingState, from_origin_m, is_flying};
use super::wire::dref::Write;
use super::wire::prel::Placement;
use super::wire::rpos::{self, Position};
use super::wire::{WireError, encode_rate, rref};
use clock::Clock;
use holder::Holder;
use inquiry::Inquiry;
pub use inquiry::RANDOM_FAILURES;
use pilot::Pilot;
pub use session::Indices;
use session::{METRES_PER_DEGREE, Provenance, Reading, Readings, Sender, Senders, TOP_SPEED_M_S, wrap_deg};
use skein_core::aircraft::{Dataref, Profile};
use skein_core::plant::{Command, Controls, Frame, PeerPose, PlantStatus};
use traffic::PeerTraffic;

/// Time between two subscriptions, needed because X-Plane forgets its subscribers when it restarts.
const RESUBSCRIBE: Duration = Duration::from_secs(5);
/// Time between two subscriptions while no position arrives.
const RESUBSCRIBE_SILENT: Duration = Duration::from_secs(1);
/// Time between two confirmations of the overrides.
pub(super) const CONFIRM_OVERRIDES: Duration = Duration::from_millis(200);
/// Age at which a dataref's value expires.
const STALE: Duration = Duration::from_secs(1);
/// The release is sent several times, because X-Plane does not acknowledge it and a lost one would leave the pilot
/// without control.
const RELEASE_REPEATS: u32 = 3;

/// Distance between two frames, beyond what the fastest aircraft flies, above which it was placed, m.
const PLACED_BEYOND_M: f64 = 5.0;

/// Takes a datagram and sends it to the simulator.
pub type Send<'a> = &'a mut dyn FnMut(&[u8]);

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
    /// Commands that were not sent because another program flies the aircraft.
    pub withheld_commands: u64,
    /// Commands outside the controls' travel, which were not sent.
    pub refused_commands: u64,
    /// Socket errors, including those because the simulator is not up; a client without a socket has none.
    pub faults: u64,
}

/// The agent's side of a conversation with one X-Plane. The caller passes the times and carries the datagrams.
pub struct Client {
    origin: Origin,
    rate_hz: u32,
    profile: Profile,
    indices: Indices,
    senders: Senders,
    clock: Clock,
    holder: Holder,
    pilot: Pilot,
    /// Whether the agent has left the controls to the pilot.
    is_released: bool,
    /// The placement of the aircraft at its start, for as long as it has to be placed before its flight.
    placing: Option<Placing>,
    traffic: PeerTraffic,
    /// The questions that it asks the simulator once, if it does.
    inquiry: Option<Inquiry>,
    readings: Readings,
    /// The position of the last frame, and whether that frame was too far from the one before to have been flown.
    place: Option<(Position, Instant)>,
    was_placed: bool,
    /// X-Plane's local frame.
    plane: Option<TangentPlane>,
    /// The newest position that has not yet made a frame, and its arrival time.
    pub(super) position: Option<(Position, Instant)>,
    pub(super) last_position: Option<Instant>,
    last_subscribed: Option<Instant>,
    overrides_confirmed: Option<Instant>,
    outgoing: Vec<u8>,
    /// Counts so far.
    pub counters: Counters,
}

impl Client {
    /// A client that will ask for `rate_hz` positions a second. It sends nothing before the first [`Self::renew`] and does
    /// not touch the controls before the first [`Self::command`].
    pub fn new(origin: &Origin, profile: &Profile, rate_hz: u32, indices: Indices) -> Self {
        Self {
            origin: *origin,
            rate_hz: rate_hz.max(1),
            profile: profile.clone(),
            senders: Senders::default(),
            clock: Clock::new(),
            holder: Holder::new(indices.of(Reading::ALL[0]).unsigned_abs()),
            pilot: Pilot::default(),
            is_released: false,
            indices,
            placing: None,
            traffic: PeerTraffic::default(),
            inquiry: None,
            readings: Readings::default(),
            place: None,
            was_placed: false,
            plane: None,
            position: None,
            last_position: None,
            last_subscribed: None,
            overrides_confirmed: None,
            outgoing: Vec::with_capacity(rref::REQUEST_SIZE),
            counters: Counters::default(),
        }
    }

    /// From now on asks the simulator, once after each of its starts, which datarefs of the profile it has, watches its random
    /// failures and its aircraft, and does not fly another aircraft than the profile is for.
    pub fn inquire(&mut self) {
        self.inquiry = Some(Inquiry::new(&self.profile));
    }

    /// Takes over what the scenario says: the aircraft is placed at `start` before its flight if it is on the ground
    /// elsewhere; and from the table `[plant]` whether random failures are wanted, which peers are drawn as the simulator's
    /// other aircraft, and the deflection of the stick with which the pilot takes the controls.
    ///
    /// # Errors
    /// If the path of the aircraft file for peers does not fit into a message.
    pub fn set_up(&mut self, start: Option<Placement>, plant: &VehicleModel) -> Result<(), WireError> {
        self.placing = start.map(Placing::at);
        if plant.random_failures {
            self.inquiry.iter_mut().for_each(|inquiry| inquiry.wants_failures = true);
        }
        self.pilot.takes_at = plant.stick_release.map(|deflection| deflection as f32);
        self.traffic = PeerTraffic::new(plant.show_peers, plant.peer_acf.as_deref())?;
        Ok(())
    }

    /// Whether it draws peers.
    pub fn shows_peers(&self) -> bool {
        !self.traffic.aircraft.is_empty()
    }

    /// Draws the nearest of these peers, and no others.
    pub fn show_peers(&mut self, peers: &[PeerPose], now: Instant, send: Send<'_>) {
        // Without a position the simulator is not there, or is another one than this session's.
        if self.last_position.is_some_and(|last| now < last + RESUBSCRIBE_SILENT) {
            self.traffic.show(peers, now, &mut self.outgoing, send);
        }
    }

    /// Positions of the controls as X-Plane reports them now; `None` if one has not arrived lately.
    pub fn controls(&self, now: Instant) -> Option<Controls> {
        pilot::controls(&self.readings, now)
    }

    /// The status that the simulator reports now beside its frames.
    pub fn status(&mut self, now: Instant) -> PlantStatus {
        PlantStatus {
            standstill: self.standstill(now),
            faults: self.inquiry.as_ref().map_or_else(Vec::new, |inquiry| inquiry.faults.clone()),
            controls: self.controls(now),
            pilot_takes_over: self.pilot.takes_over(&self.readings, now),
        }
    }

    /// X-Plane's version number, once received: 121400 is 12.1.4.
    pub fn version(&self) -> Option<u32> {
        self.readings.last(Reading::Version).map(|version| version as u32)
    }

    /// Whether the simulator reports that it is paused.
    pub fn is_paused(&self) -> bool {
        self.readings.is_on(Reading::Paused)
    }

    /// The reason why the simulator does not simulate this program's flight, if it does not.
    fn standstill(&mut self, now: Instant) -> Option<Standstill> {
        let other = self.inquiry.as_ref().and_then(Inquiry::other_aircraft);
        let reasons = [
            self.readings.is_on(Reading::InReplay).then_some(Standstill::InReplay),
            self.is_paused().then_some(Standstill::Paused),
            self.readings.is_on(Reading::Crashed).then_some(Standstill::Crashed),
            (!self.is_released && self.holder.is_other(now)).then_some(Standstill::Occupied),
            other.map(Standstill::OtherAircraft),
            (self.was_placed || self.placing.is_some()).then_some(Standstill::Placed),
        ];
        reasons.into_iter().flatten().next()
    }

    /// Nominal time between two frames, s.
    pub fn frame_period_s(&self) -> f64 {
        1.0 / f64::from(self.rate_hz)
    }

    /// Asks for positions and values if that is due.
    pub fn renew(&mut self, now: Instant, send: Send<'_>) {
        let is_over = |since: Option<Instant>, timeout| since.is_none_or(|since| now >= since + timeout);
        let is_silent = is_over(self.last_position, RESUBSCRIBE_SILENT);
        let timeout = if is_silent { RESUBSCRIBE_SILENT } else { RESUBSCRIBE };
        if is_over(self.last_subscribed, timeout) {
            self.subscribe(self.rate_hz, 1, send);
            self.last_subscribed = Some(now);
        }
        if self.inquiry.as_ref().is_some_and(|inquiry| inquiry.other_aircraft().is_some()) {
            // It is for its pilot to fly.
            self.give_back(send);
        }
        self.place(now, send);
        let Self { inquiry, indices, outgoing, last_position, origin, place, .. } = self;
        let is_answering = last_position.is_some_and(|last| now < last + RESUBSCRIBE_SILENT);
        if let Some(inquiry) = inquiry {
            let from_origin_m = place.as_ref().map(|(position, _)| from_origin_m(origin, position));
            let near = from_origin_m.filter(|(away_m, _)| *away_m < NEAR_ORIGIN_M);
            inquiry.ground_m = near.map(|(_, ground_m)| ground_m);
            inquiry.proceed(now, is_answering, |nth, request| ask(indices, nth, request, outgoing, send));
        }
    }

    /// Places the aircraft if that is due. An aircraft in the air is never placed: an agent that starts again in flight
    /// finds it flying.
    fn place(&mut self, now: Instant, send: Send<'_>) {
        let (Some(placing), Some((position, _))) = (&mut self.placing, &self.place) else { return };
        let state = placing.state(position);
        if state == PlacingState::Failed {
            tracing::warn!("the simulator did not place the aircraft at its start: the flight begins where it is");
        }
        if state != PlacingState::UnderWay || is_flying(position) {
            self.placing = None;
        } else if let Some(placement) = placing.due(Some(position), now) {
            placement.encode(&mut self.outgoing);
            send(&self.outgoing);
        }
    }

    /// Requests the position and the values; rates of zero end the subscription. A lost request is repeated later.
    fn subscribe(&mut self, rate_hz: u32, slow_hz: u32, send: Send<'_>) {
        encode_rate(&rpos::TAG, rate_hz, &mut self.outgoing);
        send(&self.outgoing);
        for &value in Reading::ALL {
            let frequency_hz = if value == Reading::Version { slow_hz } else { rate_hz };
            let Some(path) = value.path(&self.profile) else { continue };
            if !self.pilot.needs(value) {
                continue;
            }
            let index = self.indices.of(value);
            if (rref::DatarefRequest { frequency_hz, index, path }).encode(&mut self.outgoing).is_ok() {
                send(&self.outgoing);
            }
        }
    }

    /// Takes a datagram that arrived at `now` from `from`; those that are not of the simulator at this address are dropped
    /// and counted.
    pub fn receive(&mut self, datagram: &[u8], from: SocketAddr, simulator: IpAddr, now: Instant) {
        if from.ip() != simulator {
            self.refuse_foreign(from, "which is not the simulator's address");
            return;
        }
        let outcome = match datagram.first_chunk() {
            Some(&rpos::TAG) => Position::decode(datagram).map(Some),
            Some(&rref::TAG) => self.take_values(datagram, from, now).map(|()| None),
            _ => Err(WireError::WrongTag),
        };
        match outcome {
            Ok(Some(position)) if self.is_own(from, &position, now) => {
                self.counters.skipped_frames += u64::from(self.position.replace((position, now)).is_some());
            }
            Ok(_) => {}
            Err(error) => self.refuse(error),
        }
    }

    /// Whether this position is the simulator's.
    fn is_own(&mut self, from: SocketAddr, position: &Position, now: Instant) -> bool {
        let (period_s, rate) = (self.frame_period_s(), self.clock.rate);
        match self.senders.assess((from, now), position, &self.readings, period_s, rate) {
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

    fn take_values(&mut self, datagram: &[u8], from: SocketAddr, now: Instant) -> Result<(), WireError> {
        let values = rref::decode_values(datagram)?;
        match self.indices.assess(values.map(|(index, _)| index)) {
            Provenance::Proof => self.senders.prove(from, now),
            Provenance::Ours => {}
            Provenance::Foreign => {
                self.refuse_foreign(from, "whose values were not asked for");
                return Ok(());
            }
        }
        for (index, value) in rref::decode_values(datagram)? {
            if !value.is_finite() {
                self.counters.malformed += 1;
                continue;
            }
            let Some(reading) = self.indices.value(index) else {
                let question = self.indices.question(index).zip(self.inquiry.as_mut());
                question.into_iter().for_each(|(nth, inquiry)| inquiry.answer(nth, value));
                continue;
            };
            let before = self.readings.take(reading, value, now);
            match reading {
                Reading::RunningTime => {
                    if before.is_some_and(|before| value < before) {
                        self.traffic.simulator_restarted();
                        self.inquiry.iter_mut().for_each(Inquiry::restart);
                    }
                    self.clock.running_time(now, value);
                }
                Reading::Override => self.holder.overridden(value != 0.0),
                Reading::Roll => self.holder.read(value, now),
                // X-Plane moves the origin of its local frame after an aircraft that flies far.
                Reading::ReferenceLatitude | Reading::ReferenceLongitude if before != Some(value) => {
                    let [latitude, longitude] = [Reading::ReferenceLatitude, Reading::ReferenceLongitude]
                        .map(|part| self.readings.last(part).map(f64::from));
                    let place = latitude.zip(longitude).map(|(lat, lon)| Geodetic::from_degrees(lat, lon, 0.0));
                    self.plane = place.filter(Geodetic::is_plausible).map(TangentPlane::new);
                }
                _ => {}
            }
        }
        self.clock.set_paused(self.is_paused() || self.readings.is_on(Reading::InReplay));
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

    /// The frame of the newest position; `None` without one, if it is not plausible, or if the simulator's time is stopped.
    pub fn frame(&mut self) -> Option<Frame> {
        let (position, at) = self.position.take()?;
        let rotor_speed_rpm = self.readings.fresh(Reading::RotorSpeed, at);
        let rotor_speed_rad_s = rotor_speed_rpm.map(|rpm| convert::rad_s_from_rpm(rpm.into()));
        let Some(measurement) = convert::measurement(&position, self.plane.as_ref(), rotor_speed_rad_s) else {
            self.refuse(WireError::OutOfRange);
            return None;
        };
        let longest = Duration::from_secs_f64(1.5 * self.frame_period_s());
        let last = self.last_position.replace(at);
        self.counters.gaps += u64::from(last.is_some_and(|last| at > last + longest));
        if last.is_some_and(|last| at >= last + RESUBSCRIBE_SILENT) {
            // X-Plane draws no frames while it loads an aircraft.
            self.inquiry.iter_mut().for_each(Inquiry::restart);
        }
        let Some(time) = self.clock.frame(at) else {
            self.counters.frozen_frames += 1;
            return None;
        };
        let was_placed = self.place.replace((position, at)).is_some_and(|last| is_elsewhere(last, (position, at)));
        if was_placed {
            // Perhaps with another aircraft.
            self.inquiry.iter_mut().for_each(Inquiry::restart);
        }
        self.was_placed = was_placed;
        self.counters.frames += 1;
        Some(Frame { time, truth: convert::truth(&measurement, &self.origin), measurement })
    }

    /// Sets the controls, or leaves them to the pilot; a command outside their travel is counted and not sent.
    pub fn command(&mut self, command: Command, now: Instant, send: Send<'_>) {
        self.is_released = command == Command::Release;
        if self.is_released {
            if self.pilot.flies() {
                // From now on the controls are asked for, too.
                self.last_subscribed = None;
            }
            self.give_back(send);
            return;
        }
        let Some(controls) = command.controls().filter(Controls::is_within_limits) else {
            self.counters.refused_commands += 1;
            return;
        };
        if self.holder.is_other(now) || self.holder.is_unknown(now) {
            self.counters.withheld_commands += 1;
            return;
        }
        let Self { profile, outgoing, overrides_confirmed, .. } = self;
        if overrides_confirmed.is_none_or(|at| now >= at + CONFIRM_OVERRIDES) {
            // Also a confirmation: X-Plane forgets it when the aircraft is reloaded.
            profile.overrides.iter().for_each(|dataref| write(dataref, 1.0, outgoing, send));
            profile.hold.iter().for_each(|(dataref, value)| write(dataref, *value, outgoing, send));
            *overrides_confirmed = Some(now);
        }
        self.holder.wrote(controls.roll as f32);
        write(&profile.roll, controls.roll as f32, outgoing, send);
        write(&profile.pitch, controls.pitch as f32, outgoing, send);
        write(&profile.yaw, controls.yaw as f32, outgoing, send);
        profile.collective.iter().for_each(|dataref| write(dataref, controls.collective as f32, outgoing, send));
    }

    /// Gives the controls back, if they were taken, and ends the subscription.
    pub fn release(&mut self, send: Send<'_>) {
        self.give_back(send);
        if self.last_subscribed.take().is_some() {
            for _ in 0..RELEASE_REPEATS {
                self.subscribe(0, 0, send);
            }
            self.traffic.release(&mut self.outgoing, send);
            let Self { inquiry, indices, outgoing, .. } = self;
            if let Some(inquiry) = inquiry {
                inquiry.release(|nth, request| ask(indices, nth, request, outgoing, send));
            }
        }
    }

    /// Gives the controls back if they were taken, and again while X-Plane reports that they still are.
    fn give_back(&mut self, send: Send<'_>) {
        let was_holding = self.overrides_confirmed.take().is_some();
        if was_holding {
            self.holder.gave_back();
        }
        let repeats = if was_holding { RELEASE_REPEATS } else { u32::from(self.holder.is_left_over()) };
        let Self { profile, outgoing, .. } = self;
        for dataref in (0..repeats).flat_map(|_| &profile.overrides) {
            write(dataref, 0.0, outgoing, send);
        }
    }
}

/// Writes a dataref, whose path fits into every message.
fn write(dataref: &Dataref, value: f32, out: &mut Vec<u8>, send: Send<'_>) {
    if (Write { value, path: dataref.as_str() }).encode(out).is_ok() {
        send(out);
    }
}

/// Sends a question.
fn ask(indices: &Indices, nth: usize, request: rref::DatarefRequest<'_>, out: &mut Vec<u8>, send: Send<'_>) {
    // A profile's paths were checked, so that each fits.
    if (rref::DatarefRequest { index: indices.of_question(nth), ..request }).encode(out).is_ok() {
        send(out);
    }
}

/// Whether an aircraft cannot have flown from one of these positions to the other: it was placed there.
fn is_elsewhere((from, at): (Position, Instant), (to, now): (Position, Instant)) -> bool {
    let along_m = distance_m((from.latitude_deg, from.longitude_deg), (to.latitude_deg, to.longitude_deg));
    let moved_m = hypot(along_m, to.elevation_m - from.elevation_m);
    moved_m > PLACED_BEYOND_M + TOP_SPEED_M_S * now.saturating_duration_since(at).as_secs_f64()
}

/// Distance between two places, latitude and longitude in degrees, m; exact enough for places a few kilometres apart.
fn distance_m((latitude_deg, longitude_deg): (f64, f64), (to_latitude_deg, to_longitude_deg): (f64, f64)) -> f64 {
    let north_m = METRES_PER_DEGREE * (to_latitude_deg - latitude_deg);
    let turn_deg = wrap_deg(to_longitude_deg - longitude_deg);
    hypot(north_m, METRES_PER_DEGREE * cos(latitude_deg.to_radians()) * turn_deg)
}

#[cfg(test)]
mod tests;
