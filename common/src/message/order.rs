//! What an operator asks of the swarm.

use serde::{Deserialize, Serialize};

use super::{Message, message};
use crate::topic::{Author, Topic};

/// An operator's order: a register, merged by taking the larger one, so that it spreads from any node to all. An order to
/// abort is larger than any other: nothing takes it back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Order {
    /// One more than the largest epoch that the issuer had heard of.
    pub epoch: u64,
    /// Random number of the issuing process: breaks ties between two who spoke at once.
    pub issuer: u64,
    /// What to do.
    pub verb: Verb,
    /// Who may have given it; none where orders are not sealed.
    pub seal: Option<Seal>,
}

/// An Ed25519 signature (RFC 8032) of an order: in a swarm with an orders key, nothing else makes it one.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Seal([u8; 32], [u8; 32]);

impl Seal {
    /// Length of its bytes.
    pub const BYTES: usize = 64;

    /// The seal of these bytes.
    pub fn from_bytes(bytes: [u8; Self::BYTES]) -> Self {
        let (mut first, mut second) = ([0; 32], [0; 32]);
        first.copy_from_slice(&bytes[..32]);
        second.copy_from_slice(&bytes[32..]);
        Self(first, second)
    }

    /// Its bytes.
    pub fn to_bytes(self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        bytes[..32].copy_from_slice(&self.0);
        bytes[32..].copy_from_slice(&self.1);
        bytes
    }
}

impl std::fmt::Debug for Seal {
    /// Enough to tell two apart.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [a, b, c, d, ..] = self.0;
        write!(f, "Seal({a:02x}{b:02x}{c:02x}{d:02x}…)")
    }
}

impl Ord for Order {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        let rank = |order: &Self| (order.verb == Verb::Abort, order.epoch, order.issuer, order.verb, order.seal);
        rank(self).cmp(&rank(other))
    }
}

impl PartialOrd for Order {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

/// What an operator can ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum Verb {
    /// Stop where you are, at the altitude you have.
    Hold,
    /// Descend where you are. Until it is down a vehicle can be called back.
    Land,
    /// Fly on, at this step of the mission or a later one.
    Goto(u32),
    /// Give up: descend where you are, whatever is ordered later.
    Abort,
}

impl std::fmt::Display for Verb {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Hold => f.write_str("hold"),
            Self::Land => f.write_str("land"),
            Self::Goto(step) => write!(f, "goto {step}"),
            Self::Abort => f.write_str("abort"),
        }
    }
}

message!(Order, 128, |said| Author::Issuer(said.issuer), |_| true);
