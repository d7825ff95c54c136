//! Recognises the simulator's datagrams.
//!
//! Any program on this computer can send to the agent's port, and X-Plane does not document from which port it replies.
//! Two facts still identify its datagrams:
//!
//! * A reply to a dataref request (RREF) echoes the request's index. Each session draws its indices at random, so only
//!   the queried simulator knows them. A datagram of 183 guesses contains three of nineteen indices out of 2³¹ with
//!   probability 10⁻¹⁸.
//! * A position (RPOS) echoes nothing. It is the simulator's if it comes from the same port as values with our indices.
//!   A simulator that sends the two kinds from different ports is recognised by agreement: its positions agree with the
//!   latitude, longitude and elevation that came with our indices, and those of no other port do. Once recognised, the
//!   port alone decides until it has been silent for a second, because a port belongs to one process at a time.
//!
//! This module has no clock and no socket: the caller passes arrival times and addresses.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use skein_common::math::cos;

use super::{RESUBSCRIBE_SILENT, STALE};
use crate::plant::xplane::wire::rpos::Position;
use skein_core::aircraft::{Dataref, Profile};

/// Number of our indices that proves a datagram in spite of foreign indices in it: too many to be guessed.
const PROOF_COUNT: u32 = 3;
/// Age above which values neither refute nor support a position. X-Plane slows its time below 19 frames a second, so a
/// value comes at least every 53 ms; one of four in a row arrives.
const FRESH: Duration = Duration::from_millis(250);
/// Time for which one port's positions must agree, while those of no other port do, before the port is trusted. It is
/// longer than the subscription period of a silent simulator, so a lost request does not favour another sender.
const TRIAL: Duration = RESUBSCRIBE_SILENT.saturating_add(Duration::from_millis(500));

/// Length of a degree of latitude, m.
pub(super) const METRES_PER_DEGREE: f64 = 111_320.0;
/// Highest speed of a position that widens the tolerance, m/s; no helicopter flies faster.
pub(super) const TOP_SPEED_M_S: f64 = 100.0;
/// Tolerance for motion that the speed does not cover, m. An acceleration of 2 g over 270 ms, the longest time between
/// a fresh value and a position, amounts to 0.7 m.
const MARGIN_M: f64 = 1.0;

macro_rules! values {
    ($($value:ident: $path:expr;)*) => {
        /// Values that are requested in addition to the position.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(super) enum Reading {
            $($value,)*
        }

        impl Reading {
            pub(super) const ALL: &[Self] = &[$(Self::$value,)*];

            /// Path of the value's dataref, `None` if the aircraft's profile has none.
            pub(super) fn path(self, profile: &Profile) -> Option<&str> {
                let path: fn(&Profile) -> Option<&str> = match self {
                    $(Self::$value => $path,)*
                };
                path(profile)
            }
        }
    };
}

values! {
    RunningTime: |_| Some("sim/time/total_running_time_sec");
    Paused: |_| Some("sim/time/paused");
    InReplay: |_| Some("sim/time/is_in_replay");
    Crashed: |_| Some("sim/flightmodel2/misc/has_crashed");
    Override: |profile| profile.overrides.first().map(Dataref::as_str);
    Roll: |profile| Some(profile.roll.as_str());
    Pitch: |profile| Some(profile.pitch.as_str());
    Yaw: |profile| Some(profile.yaw.as_str());
    Collective: |profile| profile.collective.first().map(Dataref::as_str);
    // The pilot's own stick, whatever is written to the axes: X-Plane numbers its functions from 1 (pitch), 2 (roll), 3 (yaw).
    StickRoll: |_| Some("sim/joystick/joy_mapped_axis_value[2]");
    StickPitch: |_| Some("sim/joystick/joy_mapped_axis_value[1]");
    StickYaw: |_| Some("sim/joystick/joy_mapped_axis_value[3]");
    RotorSpeed: |profile| Some(profile.rotor_speed_rpm.as_str());
    Version: |_| Some("sim/version/xplane_internal_version");
    Latitude: |_| Some("sim/flightmodel/position/latitude");
    Longitude: |_| Some("sim/flightmodel/position/longitude");
    Elevation: |_| Some("sim/flightmodel/position/elevation");
    // The place where the local frame, to which velocity and attitude refer, touches the Earth.
    ReferenceLatitude: |_| Some("sim/flightmodel/position/lat_ref");
    ReferenceLongitude: |_| Some("sim/flightmodel/position/lon_ref");
}

/// The newest value of each reading, and when it arrived.
#[derive(Clone, Debug, Default)]
pub(super) struct Readings([Option<(Instant, f32)>; Reading::ALL.len()]);

impl Readings {
    /// Takes a value; returns the one before.
    pub(super) fn take(&mut self, reading: Reading, value: f32, at: Instant) -> Option<f32> {
        self.0[reading as usize].replace((at, value)).map(|(_, before)| before)
    }

    /// The value, whenever it arrived.
    pub(super) fn last(&self, reading: Reading) -> Option<f32> {
        self.0[reading as usize].map(|(_, value)| value)
    }

    /// The value, if it has not expired.
    pub(super) fn fresh(&self, reading: Reading, now: Instant) -> Option<f32> {
        self.0[reading as usize].filter(|(at, _)| now.saturating_duration_since(*at) < STALE).map(|(_, value)| value)
    }

    /// Whether the last value is another than 0.
    pub(super) fn is_on(&self, reading: Reading) -> bool {
        self.last(reading).is_some_and(|value| value != 0.0)
    }
}

/// Most datarefs that are asked for besides the values, once.
pub(super) const MAX_QUESTIONS: usize = 256;
/// Largest first index of the questions: those above it are not negative either.
const FIRST_QUESTION_MASK: i32 = 0x3FFF_FFFF;

/// Index of each value and of each question in this session.
#[derive(Debug)]
pub struct Indices {
    values: [i32; Reading::ALL.len()],
    /// Index of the first question; the others follow it.
    first_question: i32,
}

impl Indices {
    /// Draws distinct indices from unpredictable bytes, or returns `None` if `fill` has no bytes. X-Plane only
    /// echoes indices; they are not negative because its documentation shows no negative one.
    pub fn draw(mut fill: impl FnMut(&mut [u8]) -> bool) -> Option<Self> {
        loop {
            let (mut bytes, mut first) = ([[0; 4]; Reading::ALL.len()], [0; 4]);
            if !fill(bytes.as_flattened_mut()) || !fill(&mut first) {
                return None;
            }
            let values = bytes.map(|bytes| i32::from_le_bytes(bytes) & i32::MAX);
            let drawn = Self { values, first_question: i32::from_le_bytes(first) & FIRST_QUESTION_MASK };
            let is_distinct =
                |(nth, index): (usize, &i32)| !values[..nth].contains(index) && drawn.question(*index).is_none();
            if values.iter().enumerate().all(is_distinct) {
                return Some(drawn);
            }
        }
    }

    /// Index of a question.
    pub(super) fn of_question(&self, nth: usize) -> i32 {
        self.first_question + nth.min(MAX_QUESTIONS - 1) as i32
    }

    /// The question that was asked with this index, if any.
    pub(super) fn question(&self, index: i32) -> Option<usize> {
        let nth = usize::try_from(index.checked_sub(self.first_question)?).ok()?;
        (nth < MAX_QUESTIONS).then_some(nth)
    }

    pub(super) fn of(&self, value: Reading) -> i32 {
        self.values[value as usize]
    }

    /// Reading requested with this index; `None` if the session did not use it.
    pub(super) fn value(&self, index: i32) -> Option<Reading> {
        let nth = self.values.iter().position(|own| *own == index)?;
        Reading::ALL.get(nth).copied()
    }

    /// Classifies a datagram with these indices.
    pub(super) fn assess(&self, indices: impl Iterator<Item = i32>) -> Provenance {
        let (mut ours, mut others) = (0_u32, false);
        for index in indices {
            match self.value(index) {
                Some(value) => ours |= 1 << value as u32,
                None => others |= self.question(index).is_none(),
            }
        }
        match ours.count_ones() {
            PROOF_COUNT.. => Provenance::Proof,
            // X-Plane may send each value by itself, but has no reason to add other values to it.
            _ if !others => Provenance::Ours,
            _ => Provenance::Foreign,
        }
    }
}

/// The conclusion from a datagram's indices about its sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Provenance {
    /// The sender is certainly the simulator.
    Proof,
    /// All indices are ours; the sender may be the simulator.
    Ours,
    /// The sender was not asked.
    Foreign,
}

/// Assessment of a position's sender.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Sender {
    /// The simulator.
    Simulator,
    /// Possibly the simulator: there are no values yet to compare with, or its positions have not agreed for long
    /// enough.
    Unproven,
    /// Not the simulator: its position is this much farther away than the values allow, m, or (`None`) other senders
    /// are equally credible.
    Foreign(Option<f64>),
}

/// Learns the port from which the simulator's positions come.
#[derive(Debug, Default)]
pub(super) struct Senders {
    /// Port that sends values with our indices.
    proven: Option<Contact>,
    /// Port whose positions are trusted.
    trusted: Option<Contact>,
    /// Port on trial, and since when its positions have agreed.
    candidate: Option<(Contact, Instant)>,
}

/// A sender and the time of its last datagram.
#[derive(Clone, Copy, Debug)]
struct Contact {
    address: SocketAddr,
    at: Instant,
}

impl Contact {
    fn is_silent(&self, now: Instant) -> bool {
        now.saturating_duration_since(self.at) >= STALE
    }
}

impl Senders {
    /// Records a datagram that only the simulator can have sent.
    pub(super) fn prove(&mut self, address: SocketAddr, at: Instant) {
        self.proven = Some(Contact { address, at });
    }

    /// Assesses the sender of a position that came from `from` at `at`, by the values with our indices. Positions are
    /// `frame_period_s` apart; `time_rate` is the simulator's time against local time.
    pub(super) fn assess(
        &mut self,
        (from, at): (SocketAddr, Instant),
        position: &Position,
        readings: &Readings,
        frame_period_s: f64,
        time_rate: f64,
    ) -> Sender {
        let contact = Contact { address: from, at };
        if self.proven.is_some_and(|proven| proven.address == from && !proven.is_silent(at)) {
            return self.trust(contact);
        }
        let excess_m = excess_m(position, readings, at, frame_period_s, time_rate);
        let agrees = excess_m.map(|excess_m| excess_m <= 0.0);
        let is_trusted = self.trusted.is_some_and(|trusted| trusted.address == from);
        let holds = self.trusted.is_some_and(|trusted| !trusted.is_silent(at));
        match agrees {
            _ if holds && !is_trusted => Sender::Foreign(excess_m),
            Some(false) => Sender::Foreign(excess_m),
            // A simulator that was silent for a while need not compete with other senders again.
            Some(true) if is_trusted => self.trust(contact),
            None if holds => self.trust(contact),
            Some(true) => self.run_trial(contact),
            None => Sender::Unproven,
        }
    }

    fn trust(&mut self, contact: Contact) -> Sender {
        (self.trusted, self.candidate) = (Some(contact), None);
        Sender::Simulator
    }

    /// Handles a position that agrees with the values while no port is trusted.
    fn run_trial(&mut self, contact: Contact) -> Sender {
        let candidate = self.candidate.filter(|(last, _)| !last.is_silent(contact.at));
        let (since, outcome) = match candidate {
            // Two senders agree, so neither can be trusted: the trial starts anew.
            Some((last, _)) if last.address != contact.address => (contact.at, Sender::Foreign(None)),
            Some((_, since)) if contact.at.saturating_duration_since(since) >= TRIAL => return self.trust(contact),
            Some((_, since)) => (since, Sender::Unproven),
            None => (contact.at, Sender::Unproven),
        };
        self.candidate = Some((contact, since));
        outcome
    }
}

/// Distance of the position from the values' place beyond the tolerance, m; `None` without fresh values.
///
/// A value is an f32, up to one step from the true one, whether X-Plane rounds or truncates (at most 0.85 m of
/// latitude and 1.7 m of longitude). It may be older than the position by its age, or a frame younger; in that time
/// the aircraft moves at its speed.
fn excess_m(position: &Position, readings: &Readings, at: Instant, frame_period_s: f64, time_rate: f64) -> Option<f64> {
    let place = [Reading::Latitude, Reading::Longitude, Reading::Elevation].map(|part| readings.0[part as usize]);
    let [Some(latitude), Some(longitude), Some(elevation)] = place else { return None };
    let oldest = latitude.0.min(longitude.0).min(elevation.0);
    let age = at.saturating_duration_since(oldest);
    if age > FRESH {
        return None;
    }
    let east_m_per_degree = METRES_PER_DEGREE * cos(position.latitude_deg.to_radians());
    let turn_deg = wrap_deg(position.longitude_deg - f64::from(longitude.1));
    let offset_m = [
        excess(position.latitude_deg - f64::from(latitude.1), latitude.1) * METRES_PER_DEGREE,
        excess(turn_deg, longitude.1) * east_m_per_degree,
        excess(position.elevation_m - f64::from(elevation.1), elevation.1),
    ];
    let speed_m_s = [position.velocity_east_m_s, position.velocity_up_m_s, position.velocity_south_m_s];
    let may_move_m =
        length(speed_m_s.map(f64::from)).min(TOP_SPEED_M_S) * time_rate.max(1.0) * (age.as_secs_f64() + frame_period_s);
    Some(length(offset_m) - may_move_m - MARGIN_M)
}

/// The excess of a difference from a value over one f32 step of that value, in the value's unit; 0 if it is within the step.
fn excess(difference: f64, value: f32) -> f64 {
    let step = f64::from(value.abs().next_up() - value.abs());
    (difference.abs() - step).max(0.0)
}

pub(super) fn wrap_deg(degrees: f64) -> f64 {
    (degrees + 180.0).rem_euclid(360.0) - 180.0
}

fn length(parts: [f64; 3]) -> f64 {
    parts.iter().map(|part| part * part).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests;
