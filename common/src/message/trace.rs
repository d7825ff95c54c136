//! Trace of every step of an agent, for measurement, recording and display. The docstrings of the fields are the descriptions in
//! the JSON schema of recordings.

use serde::{Deserialize, Serialize};

use super::{Header, Message, message};
use crate::frame::{Attitude, PositionNed, VelocityNed};
use crate::id::VehicleId;
use crate::scenario::{Setting, TunableKey};
use crate::state::{Activity, Membership, PeerStatus};
use crate::time::PlantTime;
use crate::topic::{Author, Topic};

/// Trace of one step of an agent: its estimates, the ground truth and its outputs. Sent only while a process
/// subscribes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Trace {
    /// Sender, number and time of the message.
    pub header: Header,
    /// Simulator time of the frame, ns.
    pub plant_time: PlantTime,
    /// Whether the vehicle is an active member of the swarm.
    pub membership: Membership,
    /// The vehicle's activity.
    pub activity: Activity,
    /// Number of live members that the agent counts, itself included.
    pub live: u8,
    /// The mission step that the agent is at, counted from 0.
    pub step: u32,
    /// The highest step whose goal the vehicle reached in this incarnation; null before the first.
    pub reached: Option<u32>,
    /// Time for which the vehicle has been in formation without interruption, s: at its altitude, and where the law wants it;
    /// null while it is not in formation, and from releases that did not record it.
    #[serde(default)]
    pub in_place_s: Option<f64>,
    /// Present values of the keys that operators have set in flight.
    #[serde(default)]
    pub settings: Vec<Setting>,
    /// The agent's estimate of the formation's centre, north and east, m.
    pub centre_ne_m: [f64; 2],
    /// Estimated own position, north, east and down, m.
    pub estimate: PositionNed,
    /// True position in the swarm's frame, north, east and down, m.
    pub position: PositionNed,
    /// True height above the ground, m.
    pub height_m: f64,
    /// True velocity in the swarm's frame, north, east and down, m/s.
    pub velocity: VelocityNed,
    /// True attitude in the swarm's frame, Euler angles 3-2-1, rad.
    pub attitude: Attitude,
    /// Shaft power, W; null where the plant does not report it.
    pub power_w: Option<f64>,
    /// The formation field V: north, east, dimensionless.
    pub field_ne: [f64; 2],
    /// The field converted to a position error: north, east, m.
    pub error_ne_m: [f64; 2],
    /// Altitude setpoint of the vehicle controller above the origin, m.
    pub altitude_setpoint_m: f64,
    /// Controls sent to the plant: roll, pitch, yaw, collective; null while the agent does not control the plant, and for
    /// a point mass, which has none.
    #[serde(rename = "sticks")]
    pub controls: Option<[f64; 4]>,
    /// Every peer of which a message ever arrived.
    pub peers: Vec<PeerAge>,
    /// Time from the previous frame's arrival to its last control output, µs; null in virtual time.
    pub step_us: Option<f64>,
    /// Number of activations of the safety filter since the start; null without a filter.
    pub safety_activations: Option<u64>,
    /// Number of requests that the external law did not answer since the start; null without an external law.
    pub law_misses: Option<u64>,
    /// Whether the fallback flies in the place of the external law; null where the vehicle flies by no external law, and from
    /// releases that did not record it.
    #[serde(default)]
    pub fallback_flies: Option<bool>,
    /// Numbers that the external law asked to record with its last answer.
    pub law_log: Vec<LawNumber>,
    /// Number of steps that ended after the next frame was due, since the start.
    pub frame_overruns: u64,
    /// Number of state messages sent since the start.
    pub state_messages: u64,
    /// Payload of the state messages sent, bytes.
    pub state_bytes: u64,
}

/// A number that an external law asks to record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LawNumber {
    /// Name that the law gives the number, at most 32 bytes.
    pub name: String,
    /// The number; it is finite.
    pub value: f64,
}

impl LawNumber {
    /// Largest length of a name, bytes.
    pub const MAX_NAME: usize = 32;
    /// Largest number of recorded numbers in one answer.
    pub const MAX_COUNT: usize = 16;

    fn is_plausible(&self) -> bool {
        self.name.len() <= Self::MAX_NAME && self.value.is_finite()
    }
}

/// Age of one peer's newest state at one step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PeerAge {
    /// The peer.
    pub id: VehicleId,
    /// How its newest state stands with this vehicle.
    pub standing: PeerStatus,
    /// Upper bound of the age of the peer's newest state by the receiver's clock, s; it includes the delay once a round
    /// trip is known.
    pub age_s: f64,
    /// Upper bound of the network delay of that state, s; null until a round trip is known.
    #[serde(default)]
    pub delay_s: Option<f64>,
    /// Exact delay that the scenario's network impairments added to that state, s.
    pub delivered_age_s: f64,
}

impl PeerAge {
    fn is_plausible(&self) -> bool {
        [self.age_s, self.delivered_age_s].iter().chain(&self.delay_s).all(|number| number.is_finite())
    }

    /// Time since the newest state of the peer arrived, s.
    pub fn silent_s(&self) -> f64 {
        self.age_s - self.delay_s.unwrap_or_default()
    }
}

message!(Trace, 16 * 1024, |trace| Author::Vehicle(trace.header.sender), |trace| {
    let pairs = trace.field_ne.iter().chain(&trace.error_ne_m).chain(&trace.centre_ne_m);
    let options = trace.power_w.iter().chain(&trace.step_us).chain(&trace.in_place_s);
    trace.estimate.is_finite()
        && trace.position.is_finite()
        && trace.velocity.is_finite()
        && trace.attitude.is_finite()
        && trace.height_m.is_finite()
        && trace.altitude_setpoint_m.is_finite()
        && pairs.chain(options).chain(trace.controls.iter().flatten()).all(|number| number.is_finite())
        && trace.settings.len() <= TunableKey::ALL.len()
        && trace.settings.iter().all(Setting::is_in_range)
        && trace.peers.iter().all(PeerAge::is_plausible)
        && trace.law_log.len() <= LawNumber::MAX_COUNT
        && trace.law_log.iter().all(LawNumber::is_plausible)
});
