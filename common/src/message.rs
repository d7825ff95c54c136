//! What is said between processes, byte for byte.
//!
//! A message is one version byte and the [postcard](https://postcard.jamesmunns.com) encoding of its struct. Postcard
//! writes no field names: a field added, dropped or moved is a new [`VERSION`], and the golden bytes in the tests say so.
//! [`decode`] accepts only what a correct peer can have said: right version, right size, nothing left over, every number
//! finite and in range.

mod clock;
mod health;
mod order;
mod trace;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::id::{Incarnation, VehicleId, VehicleSet};
use crate::state::{Membership, VehicleState};
use crate::time::SenderStamp;
use crate::topic::{Author, Topic};

pub use clock::{ClockAnswer, ClockOffset};
pub use health::{Drops, Health, PeerHealth, Reason, Refused};
pub use order::{Order, Seal, Verb};
pub use trace::{LawNumber, PeerAge, Trace};

/// The first byte of every message.
pub const VERSION: u8 = 5;

/// No mission has more steps than this.
pub const MAX_STEP: u32 = 10_000;

/// Why bytes are not a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// No bytes at all.
    #[error("an empty message")]
    Empty,
    /// Said by another version of Skein.
    #[error("a message of version {0}, where {VERSION} is spoken")]
    Version(u8),
    /// Longer than this kind of message ever is.
    #[error("a message of {0} bytes, too long for its kind")]
    TooLong(usize),
    /// Not the encoding of this kind of message.
    #[error("a malformed message")]
    Malformed,
    /// A number in it is not finite or out of its range.
    #[error("a message with an impossible value")]
    Implausible,
}

/// A kind of message.
pub trait Message: Serialize + DeserializeOwned {
    /// No message of this kind is longer, bytes.
    const MAX_BYTES: usize;

    /// Every number is finite and in its range.
    fn is_plausible(&self) -> bool;

    /// Whether it may be said under this topic: a vehicle speaks in its own branch, an issuer under its own number.
    fn may_stand_under(&self, topic: &Topic) -> bool;
}

/// Who says it, in which life, and in which order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// The speaker.
    pub sender: VehicleId,
    /// The speaker's present life: a restarted agent has a larger one.
    pub incarnation: Incarnation,
    /// Grows with every message of this kind in this life.
    pub sequence: u64,
    /// The speaker's own clock. It orders the speaker's words and says nothing to anybody else's clock.
    pub stamp: SenderStamp,
}

impl Header {
    /// The place of the message among all messages of its kind from its sender.
    pub fn order(&self) -> MessageOrder {
        MessageOrder { incarnation: self.incarnation, sequence: self.sequence }
    }
}

/// The place of a message among all messages of its kind from one sender: the newer message is the larger one. A message of a
/// later life is newer than all messages of an earlier life.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MessageOrder {
    /// The sender's life.
    pub incarnation: Incarnation,
    /// The number of the message within that life.
    pub sequence: u64,
}

/// The speaker's state, on need.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// Who and when.
    pub header: Header,
    /// Where it is and how it moves.
    pub state: VehicleState,
}

/// The speaker's part in the agreement: a register of which the others keep the newest, said on change and five times a second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mission {
    /// Who and when.
    pub header: Header,
    /// Hash of the plan. Agents with different plans do not agree with each other.
    pub plan: u64,
    /// Whether the others count on the speaker.
    pub membership: Membership,
    /// The step of the mission that the speaker is at, counted from 0.
    pub step: u32,
    /// The latest step that the speaker vouches for, at most [`Self::step`]: it came there with all active members, after
    /// two others or by order, and not after a single one.
    pub vouched: u32,
    /// The highest step that the speaker itself reached in this life.
    pub reached: Option<u32>,
    /// How far the speaker takes the centre to be along this step's path, m.
    pub progress_m: f64,
    /// The newest order the speaker knows of.
    pub order: Option<Order>,
    /// The newest stamp of one peer, each peer in turn: the peer measures the round trip by it.
    pub echo: Option<Echo>,
}

/// The stamp of a peer's heartbeat, sent back to that peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Echo {
    /// The vehicle that sent the heartbeat.
    pub of: VehicleId,
    /// The stamp of the heartbeat, by the clock of its sender.
    pub stamp: SenderStamp,
    /// The time between the heartbeat's arrival and this message, by the clock of this message's sender, µs.
    pub held_us: u32,
}

impl Echo {
    /// How long the stamp was held, s.
    pub fn held_s(&self) -> f64 {
        f64::from(self.held_us) * 1e-6
    }
}

/// Something that happened, said once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Event {
    /// Who and when.
    pub header: Header,
    /// What happened.
    pub what: Happening,
}

/// What can happen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Happening {
    /// The speaker became an active member.
    BecameActive,
    /// A peer was heard for the first time, or again.
    PeerFound(VehicleId),
    /// A peer is gone: its token or its word has.
    PeerLost(VehicleId),
    /// A peer flies another plan: its part in the agreement is ignored.
    PlanDiffers(VehicleId),
    /// Nobody is heard any more; the speaker holds its place.
    AllPeersLost,
    /// An order was taken up; told without its seal.
    OrderTaken(Order),
    /// The speaker has reached this step's goal.
    Reached(u32),
    /// The speaker goes on to this step: everybody who counts had reached the one before.
    Advanced(u32),
    /// The speaker goes on without some who had counted at the step before, had not reached it, and are not heard now.
    ForcedAdvance {
        /// The step gone on to.
        to: u32,
        /// Those not waited for.
        without: VehicleSet,
    },
    /// The speaker was carried forward to where others are, past a step that it had not reached.
    Skipped {
        /// The step that it had not reached.
        from: u32,
        /// The step that it is at now.
        to: u32,
    },
    /// Too few are heard for a swarm that only goes on with more than half: the speaker holds its place.
    QuorumLost,
    /// More than half are heard again.
    QuorumBack,
    /// Something of the speaker's own vehicle has failed.
    Failed(Failure),
    /// The own clock has jumped; ages are counted anew from it.
    ClockJumped,
    /// The speaker is at its altitude.
    AtAltitude,
    /// The speaker is down.
    Landed,
    /// No data of its own: controls neutral.
    OwnDataStale,
    /// The simulator is gone; the speaker waits for it.
    SimulatorLost,
    /// Own data are back.
    OwnDataBack,
    /// The controller was given a number it cannot use; the last controls stand.
    ControlFault,
    /// The external law does not answer: the fallback flies.
    LawLost,
    /// The external law answers, and flies again.
    LawBack,
}

/// What a vehicle finds failed of itself, from the mildest to the most severe, with what it does then.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Failure {
    /// The position repeats: it reckons on by its velocity, and lands.
    Position,
    /// The yaw gyro is dead: it lands, its nose anywhere.
    Gyro,
    /// It neither is at its altitude nor comes nearer to it, whatever the reason: it lands, or stays on the ground.
    Altitude,
    /// A servo does not follow: it lands as well as it can.
    Servo,
    /// No power: it comes down.
    Engine,
}

impl Failure {
    /// How many there are.
    pub const KINDS: usize = 5;
}

impl std::fmt::Display for Failure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Position => "position frozen, reckons on and lands",
            Self::Gyro => "yaw gyro off, lands",
            Self::Altitude => "does not come to its altitude, lands",
            Self::Servo => "servo stuck, lands",
            Self::Engine => "engine out, comes down",
        })
    }
}

impl std::fmt::Display for Happening {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::BecameActive => f.write_str("takes part"),
            Self::PeerFound(id) => write!(f, "hears vehicle {id}"),
            Self::PeerLost(id) => write!(f, "lost vehicle {id}"),
            Self::PlanDiffers(id) => write!(f, "vehicle {id} flies another plan, ignored"),
            Self::AllPeersLost => f.write_str("hears nobody, holds its place"),
            Self::OrderTaken(order) => write!(f, "takes the order: {}", order.verb),
            Self::Reached(step) => write!(f, "reached step {step}"),
            Self::Advanced(step) => write!(f, "goes on to step {step}"),
            Self::ForcedAdvance { to, without } => write!(f, "goes on to step {to} without vehicle {without}"),
            Self::Skipped { from, to } => write!(f, "carried forward from step {from} to step {to}"),
            Self::QuorumLost => f.write_str("hears too few to go on, holds its place"),
            Self::QuorumBack => f.write_str("hears enough to go on"),
            Self::Failed(failure) => write!(f, "{failure}"),
            Self::ClockJumped => f.write_str("own clock jumped, ages counted anew"),
            Self::AtAltitude => f.write_str("at altitude"),
            Self::Landed => f.write_str("landed"),
            Self::OwnDataStale => f.write_str("own data stale, controls neutral"),
            Self::SimulatorLost => f.write_str("simulator gone, waiting for it"),
            Self::OwnDataBack => f.write_str("own data back"),
            Self::ControlFault => f.write_str("controller refused its input, controls held"),
            Self::LawLost => f.write_str("own law does not answer, the fallback flies"),
            Self::LawBack => f.write_str("own law answers, flies again"),
        }
    }
}

macro_rules! message {
    ($name:ident, $max_bytes:expr, $author:expr, $plausible:expr) => {
        impl Message for $name {
            const MAX_BYTES: usize = $max_bytes;

            fn is_plausible(&self) -> bool {
                let plausible: fn(&Self) -> bool = $plausible;
                plausible(self)
            }

            fn may_stand_under(&self, topic: &Topic) -> bool {
                let author: fn(&Self) -> Author = $author;
                topic.author() == author(self)
            }
        }
    };
}
use message;

message!(State, 128, |said| Author::Vehicle(said.header.sender), |said| said.state.is_plausible());
message!(Mission, 192, |said| Author::Vehicle(said.header.sender), |said| {
    said.step <= MAX_STEP
        && said.vouched <= said.step
        && said.reached.is_none_or(|reached| reached <= MAX_STEP)
        && said.progress_m.abs() < 1e9
});
message!(Event, 128, |said| Author::Vehicle(said.header.sender), |_| true);

/// The message as bytes.
///
/// # Panics
/// Never: none of our messages holds anything that postcard cannot write.
pub fn encode<M: Message>(message: &M) -> Vec<u8> {
    let bytes = postcard::to_extend(message, vec![VERSION]);
    // Structs of numbers, options, enums and sequences of known length always have an encoding.
    #[expect(clippy::expect_used, reason = "postcard fails only on types that no message of ours has")]
    bytes.expect("every message has an encoding")
}

/// The message in these bytes, if a correct peer can have said it.
pub fn decode<M: Message>(bytes: &[u8]) -> Result<M, DecodeError> {
    let (&version, body) = bytes.split_first().ok_or(DecodeError::Empty)?;
    if version != VERSION {
        return Err(DecodeError::Version(version));
    }
    if bytes.len() > M::MAX_BYTES {
        return Err(DecodeError::TooLong(bytes.len()));
    }
    let (message, rest) = postcard::take_from_bytes::<M>(body).map_err(|_| DecodeError::Malformed)?;
    if !rest.is_empty() {
        return Err(DecodeError::Malformed);
    }
    if message.is_plausible() { Ok(message) } else { Err(DecodeError::Implausible) }
}

#[cfg(test)]
mod tests;
