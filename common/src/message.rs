//! Messages between processes, byte for byte.
//!
//! A message is one version byte and the [postcard](https://postcard.jamesmunns.com) encoding of its struct. Postcard
//! writes no field names. To add, drop or move a field therefore needs a new [`VERSION`]; the golden bytes in the tests
//! fail otherwise. A [`Summary`] is JSON instead, for programs in any language. [`decode`] accepts only what a correct peer can send: the right version, the right size, no bytes
//! left over, every number finite and in range.

mod clock;
mod health;
mod intent;
mod order;
mod severity;
mod simulator;
mod summary;
mod vehicle;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::id::{Incarnation, VehicleId, VehicleSet};
use crate::scenario::Setting;
use crate::state::{Membership, VehicleState};
use crate::time::SenderStamp;
use crate::topic::{Author, Topic};

pub use clock::{ClockAnswer, ClockOffset};
pub use health::{Drops, Health, PeerHealth, Reason, Refused, Traffic};
pub use intent::{Area, Intent};
pub use order::{Order, Signature, StandingOrders, Verb};
pub use severity::Severity;
pub use simulator::{ShortText, SimulatorFault, Standstill};
pub use summary::{PeerContact, Summary};
pub use vehicle::{
    FACTS, Fact, FactColumn, FactLine, FactValues, LawNumber, PeerAge, ProcessFigures, TRACE_COLUMNS, Trace,
    TraceColumn, VehicleFacts,
};

/// Version of the messages: the first byte of every message.
pub const VERSION: u8 = 8;

/// Largest index of a mission step.
pub const MAX_STEP: u32 = 10_000;

/// Reason why [`decode`] refused bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// The message has no bytes.
    #[error("empty message")]
    Empty,
    /// The message was sent by another version of Skein.
    #[error("message of version {0}: this program reads version {VERSION}")]
    Version(u8),
    /// The message is longer than its kind allows.
    #[error("message of {0} bytes: too long for its kind")]
    TooLong(usize),
    /// The bytes do not encode this kind of message.
    #[error("malformed message")]
    Malformed,
    /// A number of the message is not finite or out of its range.
    #[error("message with a value out of range")]
    Implausible,
}

/// The encoding of a message as bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// The version byte and the postcard encoding: short, for the messages that fly the swarm.
    Postcard,
    /// A JSON object with the fields by name and `version`: for programs in any language.
    Json,
}

/// A kind of message between processes.
pub trait Message: Serialize + DeserializeOwned {
    /// Largest size of a message of this kind, bytes.
    const MAX_BYTES: usize;

    /// Encoding of a message of this kind as bytes.
    const ENCODING: Encoding = Encoding::Postcard;

    /// Whether every number is finite and in its range.
    fn is_plausible(&self) -> bool;

    /// Whether the message may be published under this topic: a vehicle publishes under its own id, an operator's
    /// process under its own number.
    fn is_allowed_under(&self, topic: &Topic) -> bool;
}

/// Header of a message from a vehicle: its sender, the sender's incarnation, the message's number and time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Header {
    /// The vehicle that sent the message.
    pub sender: VehicleId,
    /// The sender's incarnation: a restarted agent has a larger one.
    pub incarnation: Incarnation,
    /// Number of the message: it grows with every message of this kind in this incarnation.
    pub sequence: u64,
    /// Time of sending by the sender's own monotonic clock, ns. It orders the messages of this sender; it cannot be compared with
    /// another clock.
    pub stamp: SenderStamp,
}

impl Header {
    /// Position of the message among all messages of its kind from its sender.
    pub fn order(&self) -> MessageOrder {
        MessageOrder { incarnation: self.incarnation, sequence: self.sequence }
    }
}

/// Position of a message among all messages of its kind from one sender: the newer message is the larger one. A message
/// of a later incarnation is newer than all messages of an earlier one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct MessageOrder {
    /// The sender's incarnation.
    pub incarnation: Incarnation,
    /// The number of the message within that incarnation.
    pub sequence: u64,
}

/// State of the sender: position, velocity and heading. It is sent when the peers' dead reckoning of it would be off.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// Sender, number and time of the message.
    pub header: Header,
    /// Position, velocity and heading.
    pub state: VehicleState,
}

/// Heartbeat of an agent that carries its agreement state, of which the receivers keep the newest. Sent on every change and five
/// times a second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Heartbeat {
    /// Sender, number and time of the message.
    pub header: Header,
    /// Hash of the plan. Agents with different plans do not agree with each other.
    pub plan: u64,
    /// Whether the sender is an active member of the swarm.
    pub membership: Membership,
    /// The mission step that the sender is at, counted from 0.
    pub step: u32,
    /// The latest step that the sender vouches for, at most [`Self::step`]: the sender entered it together with all
    /// active members, after two other vehicles or by order, and not after a single other vehicle.
    pub vouched: u32,
    /// The highest step whose goal the sender itself reached in this incarnation.
    pub reached: Option<u32>,
    /// The sender's estimate of how far the formation's centre is along this step's path, m.
    pub progress_m: f64,
    /// One of the orders that the sender knows ([`StandingOrders`]): a new one at once and several times, then each in
    /// turn.
    pub order: Option<Order>,
    /// Number of orders that the sender knows: an observer that has received as many from it knows them all.
    pub orders: u16,
    /// The newest stamp of one peer, each peer in turn: that peer measures the round trip with it.
    pub echo: Option<Echo>,
    /// The vehicles that the sender has lost as active members less than a minute ago: it does not receive them, and does not
    /// keep clear of them.
    pub lost: VehicleSet,
}

/// The stamp of a peer's heartbeat, sent back to that peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Echo {
    /// The vehicle that sent the echoed heartbeat.
    pub of: VehicleId,
    /// The stamp of the echoed heartbeat, by the clock of its sender.
    pub stamp: SenderStamp,
    /// Time between the arrival of the echoed heartbeat and this message, by the clock of this message's sender, µs.
    pub held_us: u32,
}

impl Echo {
    /// Time between the arrival of the heartbeat and its echo, s.
    pub fn held_s(&self) -> f64 {
        f64::from(self.held_us) * 1e-6
    }
}

/// An event of the sender, sent once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Event {
    /// Sender, number and time of the message.
    pub header: Header,
    /// The kind of event.
    pub what: EventKind,
}

/// Kind of an [`Event`]. Its text is what operators read in the log and on the screen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum EventKind {
    /// The sender became an active member of the swarm.
    BecameActive,
    /// Messages of a peer arrived for the first time, or again after a loss of contact.
    PeerFound(VehicleId),
    /// A peer was lost: its liveliness token ended, or its messages stopped.
    PeerLost(VehicleId),
    /// A peer flies a different plan: the sender ignores the peer's agreement state.
    PlanDiffers(VehicleId),
    /// No peer is in contact: the sender holds position.
    AllPeersLost,
    /// The sender accepted an order. The event carries the order without its signature.
    OrderTaken(Order),
    /// The sender reached the goal of this step.
    Reached(u32),
    /// The sender continues to this step, because every active member had reached the step before.
    Advanced(u32),
    /// The sender continues to the next step without some active members, which had not reached the step before and are
    /// not in contact.
    ForcedAdvance {
        /// The new step.
        to: u32,
        /// The vehicles that the sender does not wait for: one bit each, the lowest bit of the first number for vehicle 1.
        without: VehicleSet,
    },
    /// The sender skipped forward to the step of its peers, past a step that it had not reached.
    Skipped {
        /// The step that the sender had not reached.
        from: u32,
        /// The new step.
        to: u32,
    },
    /// The sender holds position: half of the swarm's vehicles or fewer are in contact, itself included, and
    /// `mission.partition = "quorum"` requires more.
    QuorumLost,
    /// More than half of the swarm's vehicles are in contact again.
    QuorumBack,
    /// A component of the sender's vehicle failed.
    Failed(Failure),
    /// The sender's clock jumped: the ages of the peers' states restart.
    ClockJumped,
    /// The vehicle reached its altitude after take-off.
    AtAltitude,
    /// The vehicle landed.
    Landed,
    /// The simulator's data of the vehicle are too old: the controls are neutral.
    OwnDataStale,
    /// The simulator stopped sending: the agent waits for it.
    SimulatorLost,
    /// The simulator's data of the vehicle arrive again.
    OwnDataBack,
    /// An input of the vehicle controller was not finite: the last controls are held.
    ControlFault,
    /// The external law missed too many deadlines: the fallback law flies the vehicle.
    LawLost,
    /// The external law answers again and flies the vehicle.
    LawBack,
    /// The simulator does not simulate the vehicle's flight: the agent waits for it without touching the controls.
    SimulatorStopped(Standstill),
    /// The simulator delivers frames at another rate than before, frames a second. Fewer than 50 fly the vehicle worse; with
    /// fewer than `plant.min_frame_rate_hz` it does not take off.
    FrameRate(u32),
    /// The sender gave the controls of its vehicle to a human pilot.
    ControlsReleased,
    /// The sender took the controls of its vehicle back from the human pilot.
    ControlsTakenBack,
    /// The simulator is set up in a way that impairs the flight. The vehicle flies all the same.
    SimulatorFault(SimulatorFault),
    /// The sender does not fly with this setting of an operator: together with the others it cannot be flown.
    SettingRefused(Setting),
    /// The mission has come to its landing, and the vehicle waits with it: vehicles of another partition, whose places it does
    /// not know, may be below.
    LandingWaits,
    /// The external law sent what is no answer to the open request. The text is the reason; it is reported once for each kind
    /// of reason.
    LawAnswerRefused(ShortText),
}

/// A failure that an agent detected of its own vehicle, with the agent's response. They are ordered from the mildest to the
/// most severe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum Failure {
    /// The measured position is frozen: the agent dead-reckons with the velocity, and lands.
    Position,
    /// The yaw gyro failed: the vehicle lands without heading control.
    Gyro,
    /// The vehicle is not at its altitude and does not approach it: it lands, or stays on the ground.
    Altitude,
    /// A servo does not follow its command: the vehicle lands with the remaining controls.
    Servo,
    /// The engine has no power: the vehicle autorotates.
    Engine,
    /// The vehicle came no nearer to its place in the step for `mission.progress_timeout_s`: it lands.
    Place,
}

impl Failure {
    /// Every kind, from the mildest to the most severe. Its place among the variants is that in the encoding.
    pub const ALL: [Self; 6] = [Self::Place, Self::Position, Self::Gyro, Self::Altitude, Self::Servo, Self::Engine];
    /// Number of kinds of failures.
    pub const KINDS: usize = Self::ALL.len();

    fn severity(self) -> usize {
        Self::ALL.iter().take_while(|milder| **milder != self).count()
    }
}

impl Ord for Failure {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.severity().cmp(&other.severity())
    }
}

impl PartialOrd for Failure {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl std::fmt::Display for Failure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Position => "position frozen, dead-reckons and lands",
            Self::Gyro => "yaw gyro failed, lands",
            Self::Altitude => "altitude not reached, lands",
            Self::Servo => "servo stuck, lands",
            Self::Engine => "engine out, autorotates",
            Self::Place => "place not reached, lands",
        })
    }
}

impl std::fmt::Display for EventKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::BecameActive => f.write_str("active"),
            Self::PeerFound(id) => write!(f, "in contact with vehicle {id}"),
            Self::PeerLost(id) => write!(f, "lost contact with vehicle {id}"),
            Self::PlanDiffers(id) => write!(f, "vehicle {id} flies a different plan, its agreement state is ignored"),
            Self::AllPeersLost => f.write_str("no peer in contact, holds position"),
            Self::OrderTaken(order) => write!(f, "accepts the order: {order}"),
            Self::Reached(step) => write!(f, "reached step {step}"),
            Self::Advanced(step) => write!(f, "continues to step {step}"),
            Self::ForcedAdvance { to, without } => write!(f, "continues to step {to} without vehicle {without}"),
            Self::Skipped { from, to } => write!(f, "skips forward from step {from} to step {to}"),
            Self::QuorumLost => f.write_str("no quorum in contact, holds position"),
            Self::QuorumBack => f.write_str("quorum in contact again"),
            Self::Failed(failure) => write!(f, "{failure}"),
            Self::ClockJumped => f.write_str("clock jumped, ages of the peers' states restart"),
            Self::AtAltitude => f.write_str("at altitude"),
            Self::Landed => f.write_str("landed"),
            Self::OwnDataStale => f.write_str("simulator data stale, controls neutral"),
            Self::SimulatorLost => f.write_str("simulator lost, waiting for it"),
            Self::OwnDataBack => f.write_str("simulator data available again"),
            Self::ControlFault => f.write_str("controller input invalid, last controls held"),
            Self::LawLost => f.write_str("external law unresponsive, fallback law flies"),
            Self::LawBack => f.write_str("external law responds, flies again"),
            Self::SimulatorStopped(why) => write!(f, "{why}"),
            Self::FrameRate(rate_hz) => write!(f, "{rate_hz} frames a second"),
            Self::ControlsReleased => f.write_str("controls released to the human pilot"),
            Self::ControlsTakenBack => f.write_str("controls taken back from the human pilot"),
            Self::SimulatorFault(fault) => write!(f, "{fault}"),
            Self::SettingRefused(setting) => {
                write!(f, "refuses {setting}, which cannot be flown with the other settings")
            }
            Self::LandingWaits => f.write_str("waits with its landing, another partition may be below"),
            Self::LawAnswerRefused(reason) => write!(f, "refuses what the external law sent: {reason}"),
        }
    }
}

macro_rules! message {
    ($name:ident $(in $encoding:ident)?, $max_bytes:expr, $author:expr, $plausible:expr) => {
        impl Message for $name {
            const MAX_BYTES: usize = $max_bytes;
            $(const ENCODING: Encoding = Encoding::$encoding;)?

            fn is_plausible(&self) -> bool {
                let plausible: fn(&Self) -> bool = $plausible;
                plausible(self)
            }

            fn is_allowed_under(&self, topic: &Topic) -> bool {
                let author: fn(&Self) -> Author = $author;
                topic.author() == author(self)
            }
        }
    };
}
use message;

message!(State, 128, |message| Author::Vehicle(message.header.sender), |message| message.state.is_plausible());
message!(Heartbeat, 256, |message| Author::Vehicle(message.header.sender), |message| {
    message.step <= MAX_STEP
        && message.vouched <= message.step
        && message.reached.is_none_or(|reached| reached <= MAX_STEP)
        && message.progress_m.abs() < 1e9
        && message.order.is_none_or(|order| order.is_plausible())
});
message!(Event, 192, |message| Author::Vehicle(message.header.sender), |message| match message.what {
    EventKind::SimulatorStopped(why) => why.is_plausible(),
    EventKind::SimulatorFault(fault) => fault.is_plausible(),
    EventKind::OrderTaken(order) => order.is_plausible(),
    EventKind::SettingRefused(setting) => setting.is_in_range(),
    EventKind::LawAnswerRefused(reason) => reason.is_printable(),
    _ => true,
});

/// Encodes a message as bytes.
///
/// # Panics
/// Never: postcard and JSON can write every type that occurs in a message.
pub fn encode<M: Message>(message: &M) -> Vec<u8> {
    if M::ENCODING == Encoding::Json {
        // A text as key, numbers that are finite or null, lists: JSON can write them all.
        #[expect(clippy::expect_used, reason = "JSON fails only on types that no message has")]
        return serde_json::to_vec(&WithVersion { version: VERSION, message }).expect("every message has an encoding");
    }
    // Room for a whole message: postcard writes byte by byte.
    let mut bytes = Vec::with_capacity(M::MAX_BYTES.min(256));
    bytes.push(VERSION);
    let bytes = postcard::to_extend(message, bytes);
    // Postcard can encode numbers, options, enums and sequences of known length.
    #[expect(clippy::expect_used, reason = "postcard fails only on types that no message has")]
    bytes.expect("every message has an encoding")
}

/// Number of bytes that [`encode`] writes.
///
/// # Panics
/// Never, as [`encode`].
pub fn encoded_len<M: Message>(message: &M) -> usize {
    if M::ENCODING == Encoding::Json {
        return encode(message).len();
    }
    let size = postcard::serialize_with_flavor(message, postcard::ser_flavors::Size::default());
    #[expect(clippy::expect_used, reason = "postcard fails only on types that no message has")]
    let size: usize = size.expect("every message has an encoding");
    1 + size
}

/// Decodes the message in these bytes.
///
/// # Errors
/// If no correct peer of this version can have sent these bytes as a message of this kind.
pub fn decode<M: Message>(bytes: &[u8]) -> Result<M, DecodeError> {
    let message: M = match M::ENCODING {
        Encoding::Postcard => from_postcard(bytes)?,
        Encoding::Json => from_json(bytes)?,
    };
    if message.is_plausible() { Ok(message) } else { Err(DecodeError::Implausible) }
}

fn from_postcard<M: Message>(bytes: &[u8]) -> Result<M, DecodeError> {
    let (&version, body) = bytes.split_first().ok_or(DecodeError::Empty)?;
    if version != VERSION {
        return Err(DecodeError::Version(version));
    }
    if bytes.len() > M::MAX_BYTES {
        return Err(DecodeError::TooLong(bytes.len()));
    }
    let (message, rest) = postcard::take_from_bytes::<M>(body).map_err(|_| DecodeError::Malformed)?;
    if rest.is_empty() { Ok(message) } else { Err(DecodeError::Malformed) }
}

fn from_json<M: Message>(bytes: &[u8]) -> Result<M, DecodeError> {
    #[derive(Deserialize)]
    struct OnlyVersion {
        version: u8,
    }

    if bytes.is_empty() {
        return Err(DecodeError::Empty);
    }
    if bytes.len() > M::MAX_BYTES {
        return Err(DecodeError::TooLong(bytes.len()));
    }
    let OnlyVersion { version } = serde_json::from_slice(bytes).map_err(|_| DecodeError::Malformed)?;
    if version != VERSION {
        return Err(DecodeError::Version(version));
    }
    serde_json::from_slice(bytes).map_err(|_| DecodeError::Malformed)
}

/// A message as a JSON object that names its version.
#[derive(Serialize)]
struct WithVersion<'a, M> {
    version: u8,
    #[serde(flatten)]
    message: &'a M,
}

#[cfg(test)]
mod tests;
