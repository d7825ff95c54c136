//! Every step of an agent, for those who measure, record and watch. The docstrings of the fields describe them in recordings
//! too, as descriptions in the JSON schema.

use serde::{Deserialize, Serialize};

use super::{Header, Message, message};
use crate::frame::{Attitude, PositionNed, VelocityNed};
use crate::id::VehicleId;
use crate::state::{Activity, Membership, Standing};
use crate::time::PlantTime;
use crate::topic::{Author, Topic};

/// One step of an agent: what it believed, how it really was, what it did. Sent only while there are subscribers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Trace {
    /// The sender, and when it sent this.
    pub header: Header,
    /// The simulator's time of the frame, ns.
    pub plant_time: PlantTime,
    /// Whether the others count on it.
    pub membership: Membership,
    /// What it is doing.
    pub activity: Activity,
    /// Members it counts as live, itself included.
    pub live: u8,
    /// The step of the mission that it is at, counted from 0.
    pub step: u32,
    /// The highest step that it reached in this life; null before the first.
    pub reached: Option<u32>,
    /// Where it takes the formation's centre to be: north, east, m.
    pub centre_ne_m: [f64; 2],
    /// Own position as estimated: north, east, down, m.
    pub estimate: PositionNed,
    /// Position as it really was: north, east, down, m.
    pub position: PositionNed,
    /// Height above the ground, m.
    pub height_m: f64,
    /// Velocity as it really was: north, east, down, m/s.
    pub velocity: VelocityNed,
    /// Attitude as it really was, Euler angles 3-2-1.
    pub attitude: Attitude,
    /// Shaft power, W; null where the plant does not tell it.
    pub power_w: Option<f64>,
    /// The formation field V: north, east, dimensionless.
    pub field_ne: [f64; 2],
    /// The field converted to a position error: north, east, m.
    pub error_ne_m: [f64; 2],
    /// Altitude asked of the vehicle controller, m above the origin.
    pub altitude_setpoint_m: f64,
    /// Roll, pitch, yaw, collective as written; null while the controls are left alone.
    pub sticks: Option<[f64; 4]>,
    /// Every peer of which a message ever arrived.
    pub peers: Vec<PeerAge>,
    /// Time from the previous frame's arrival to its last control, µs; null in virtual time.
    pub step_us: Option<f64>,
    /// How often the safety filter has stepped in since the start; null where there is none.
    pub safety_activations: Option<u64>,
    /// Asks that an external law has not answered since the start; null where none flies.
    pub law_misses: Option<u64>,
    /// What an external law wants recorded, with its last answer.
    pub law_log: Vec<LawNumber>,
    /// Steps that ended after the next frame was due, since the start.
    pub frame_overruns: u64,
    /// State messages sent since the start.
    pub state_messages: u64,
    /// Their payload, bytes.
    pub state_bytes: u64,
}

/// A number that an external law wants recorded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LawNumber {
    /// The law's name for it, of 32 bytes at most.
    pub name: String,
    /// Its value with the law's last answer, finite.
    pub value: f64,
}

impl LawNumber {
    /// Longest name, bytes.
    pub const MAX_NAME: usize = 32;
    /// Most numbers of one answer.
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
    pub standing: Standing,
    /// Upper bound of the age of its last state by the receiver's clock, s; the delay is included once a round trip is known.
    pub age_s: f64,
    /// Upper bound of the time that this state was on its way, s; null until a round trip is known.
    #[serde(default)]
    pub delay_s: Option<f64>,
    /// How late the newest of its states was when it was delivered, s: what the scenario's network imposed on it, exactly.
    pub delivered_age_s: f64,
}

impl PeerAge {
    /// The time since its last state came, s.
    pub fn silent_s(&self) -> f64 {
        self.age_s - self.delay_s.unwrap_or_default()
    }
}

message!(Trace, 16 * 1024, |said| Author::Vehicle(said.header.sender), |said| {
    let pairs = said.field_ne.iter().chain(&said.error_ne_m).chain(&said.centre_ne_m);
    let options = said.power_w.iter().chain(&said.step_us);
    said.estimate.is_finite()
        && said.position.is_finite()
        && said.velocity.is_finite()
        && said.attitude.is_finite()
        && said.height_m.is_finite()
        && said.altitude_setpoint_m.is_finite()
        && pairs.chain(options).chain(said.sticks.iter().flatten()).all(|number| number.is_finite())
        && said.peers.iter().all(|peer| peer.age_s.is_finite() && peer.delivered_age_s.is_finite())
        && said.law_log.len() <= LawNumber::MAX_COUNT
        && said.law_log.iter().all(LawNumber::is_plausible)
});
