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
use skein_core::aircraft::Profile;

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

/// Values that are requested in addition to the position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Value {
    RunningTime,
    Paused,
    InReplay,
    Crashed,
    Override,
    Roll,
    Pitch,
    Yaw,
    Collective,
    StickRoll,
    StickPitch,
    StickYaw,
    RotorSpeed,
    Version,
    Latitude,
    Longitude,
    Elevation,
    ReferenceLatitude,
    ReferenceLongitude,
}

impl Value {
    pub(super) const ALL: [Self; 19] = [
        Self::RunningTime,
        Self::Paused,
        Self::InReplay,
        Self::Crashed,
        Self::Override,
        Self::Roll,
        Self::Pitch,
        Self::Yaw,
        Self::Collective,
        Self::StickRoll,
        Self::StickPitch,
        Self::StickYaw,
        Self::RotorSpeed,
        Self::Version,
        Self::Latitude,
        Self::Longitude,
        Self::Elevation,
        Self::ReferenceLatitude,
        Self::ReferenceLongitude,
    ];

    /// Path of the value's dataref, `None` if the aircraft's profile has none.
    pub(super) fn path(self, profile: &Profile) -> Option<&str> {
        Some(match self {
            Self::RunningTime => "sim/time/total_running_time_sec",
            Self::Paused => "sim/time/paused",
            Self::InReplay => "sim/time/is_in_replay",
            Self::Crashed => "sim/flightmodel2/misc/has_crashed",
            Self::Override => profile.overrides.first()?.as_str(),
            Self::Roll => profile.roll.as_str(),
            Self::Pitch => profile.pitch.as_str(),
            Self::Yaw => profile.yaw.as_str(),
            Self::Collective => profile.collective.first()?.as_str(),
            // What the pilot's own stick shows, whatever is written to the axes: X-Plane numbers its functions from
            // 1 (pitch), 2 (roll), 3 (yaw).
            Self::StickRoll => "sim/joystick/joy_mapped_axis_value[2]",
            Self::StickPitch => "sim/joystick/joy_mapped_axis_value[1]",
            Self::StickYaw => "sim/joystick/joy_mapped_axis_value[3]",
            Self::RotorSpeed => profile.rotor_speed_rpm.as_str(),
            Self::Version => "sim/version/xplane_internal_version",
            Self::Latitude => "sim/flightmodel/position/latitude",
            Self::Longitude => "sim/flightmodel/position/longitude",
            Self::Elevation => "sim/flightmodel/position/elevation",
            // Where the local frame, to which velocity and attitude refer, touches the Earth.
            Self::ReferenceLatitude => "sim/flightmodel/position/lat_ref",
            Self::ReferenceLongitude => "sim/flightmodel/position/lon_ref",
        })
    }
}

/// Most datarefs that are asked for besides the values, once.
pub(super) const MAX_QUESTIONS: usize = 256;
/// Largest first index of the questions: those above it are not negative either.
const FIRST_QUESTION_MASK: i32 = 0x3FFF_FFFF;

/// Index of each value and of each question in this session.
#[derive(Debug)]
pub struct Indices {
    values: [i32; Value::ALL.len()],
    /// Index of the first question; the others follow it.
    first_question: i32,
}

impl Indices {
    /// Draws distinct indices from unpredictable bytes, or returns `None` if `fill` has no bytes. X-Plane only
    /// echoes indices; they are not negative because its documentation shows no negative one.
    pub fn draw(mut fill: impl FnMut(&mut [u8]) -> bool) -> Option<Self> {
        loop {
            let (mut bytes, mut first) = ([[0; 4]; Value::ALL.len()], [0; 4]);
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

    /// A number that no other program knows.
    pub(super) fn first(&self) -> i32 {
        self.values[0]
    }

    pub(super) fn of(&self, value: Value) -> i32 {
        self.values[value as usize]
    }

    /// Value requested with this index; `None` if the session did not use it.
    pub(super) fn value(&self, index: i32) -> Option<Value> {
        let nth = self.values.iter().position(|own| *own == index)?;
        Value::ALL.get(nth).copied()
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

/// What a datagram's indices reveal about its sender.
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
    /// Latitude, longitude and elevation from values with our indices.
    place: [Option<(Instant, f32)>; 3],
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

    /// Records a coordinate of the aircraft that came with our index.
    pub(super) fn place(&mut self, part: Value, value: f32, at: Instant) {
        let part = match part {
            Value::Latitude => 0,
            Value::Longitude => 1,
            Value::Elevation => 2,
            _ => return,
        };
        self.place[part] = Some((at, value));
    }

    /// Assesses the sender of a position that came from `from` at `at`. Positions are `frame_period_s` apart;
    /// `time_rate` is the simulator's time against local time.
    pub(super) fn assess(
        &mut self,
        from: SocketAddr,
        position: &Position,
        at: Instant,
        frame_period_s: f64,
        time_rate: f64,
    ) -> Sender {
        let contact = Contact { address: from, at };
        if self.proven.is_some_and(|proven| proven.address == from && !proven.is_silent(at)) {
            self.trust(contact);
            return Sender::Simulator;
        }
        let excess_m = self.excess_m(position, at, frame_period_s, time_rate);
        let agrees = excess_m.map(|excess_m| excess_m <= 0.0);
        match self.trusted {
            Some(trusted) if !trusted.is_silent(at) => match agrees {
                _ if trusted.address != from => Sender::Foreign(excess_m),
                Some(false) => Sender::Foreign(excess_m),
                Some(true) | None => {
                    self.trust(contact);
                    Sender::Simulator
                }
            },
            // A simulator that was silent for a while need not compete with other senders again.
            Some(trusted) if trusted.address == from && agrees == Some(true) => {
                self.trust(contact);
                Sender::Simulator
            }
            _ => match agrees {
                Some(true) => self.run_trial(contact),
                Some(false) => Sender::Foreign(excess_m),
                None => Sender::Unproven,
            },
        }
    }

    fn trust(&mut self, contact: Contact) {
        (self.trusted, self.candidate) = (Some(contact), None);
    }

    /// Handles a position that agrees with the values while no port is trusted.
    fn run_trial(&mut self, contact: Contact) -> Sender {
        let (rival, since) = match self.candidate {
            Some((last, since)) if last.is_silent(contact.at) => (None, since),
            Some((last, since)) => (Some(last.address), since),
            None => (None, contact.at),
        };
        match rival {
            Some(rival) if rival != contact.address => {
                // Two senders agree, so neither can be trusted: the trial starts anew.
                self.candidate = Some((contact, contact.at));
                Sender::Foreign(None)
            }
            Some(_) if contact.at.saturating_duration_since(since) >= TRIAL => {
                self.trust(contact);
                Sender::Simulator
            }
            Some(_) => {
                self.candidate = Some((contact, since));
                Sender::Unproven
            }
            None => {
                self.candidate = Some((contact, contact.at));
                Sender::Unproven
            }
        }
    }

    /// Distance of the position from the values' place beyond the tolerance, m; `None` without fresh values.
    ///
    /// A value is an f32, up to one step from the true one, whether X-Plane rounds or truncates (at most 0.85 m of
    /// latitude and 1.7 m of longitude). It may be older than the position by its age, or a frame younger; in that time
    /// the aircraft moves at its speed.
    fn excess_m(&self, position: &Position, at: Instant, frame_period_s: f64, time_rate: f64) -> Option<f64> {
        let [Some(latitude), Some(longitude), Some(elevation)] = self.place else { return None };
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
        let may_move_m = length(speed_m_s.map(f64::from)).min(TOP_SPEED_M_S)
            * time_rate.max(1.0)
            * (age.as_secs_f64() + frame_period_s);
        Some(length(offset_m) - may_move_m - MARGIN_M)
    }
}

/// How far a difference from a value exceeds one f32 step of that value.
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
