//! Orders of an operator, to the whole swarm or to some of its vehicles.

mod standing;

use serde::{Deserialize, Serialize};

use super::{Message, message};
use crate::id::{VehicleId, VehicleSet};
use crate::scenario::Setting;
use crate::topic::{Author, Topic};

pub use standing::StandingOrders;

/// Order of an operator. Agents keep the larger of two orders to a vehicle and repeat it, so that an order spreads from
/// any vehicle to all ([`StandingOrders`]). An order to abort is larger than any other: it cannot be revoked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Order {
    /// One more than the largest epoch that the issuer had received.
    pub epoch: u64,
    /// Random number of the issuing process: it breaks ties between two orders that were given at the same time.
    pub issuer: u64,
    /// The action.
    pub verb: Verb,
    /// The vehicles that the order names; `None` for the whole swarm. The set is not empty.
    pub vehicles: Option<VehicleSet>,
    /// Signature of the operator; `None` in a swarm whose orders are not signed.
    #[serde(rename = "seal")]
    pub signature: Option<Signature>,
}

/// Ed25519 signature (RFC 8032) of an order. A swarm with an orders key accepts only orders with a valid signature.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Signature([u8; 32], [u8; 32]);

impl Signature {
    /// Length of a signature, bytes.
    pub const BYTES: usize = 64;

    /// Makes a signature from its bytes.
    pub fn from_bytes(bytes: [u8; Self::BYTES]) -> Self {
        let (mut first, mut second) = ([0; 32], [0; 32]);
        first.copy_from_slice(&bytes[..32]);
        second.copy_from_slice(&bytes[32..]);
        Self(first, second)
    }

    /// The bytes of the signature.
    pub fn to_bytes(self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        bytes[..32].copy_from_slice(&self.0);
        bytes[32..].copy_from_slice(&self.1);
        bytes
    }
}

impl std::fmt::Debug for Signature {
    /// The first four bytes: enough to distinguish two signatures in a test's output.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [a, b, c, d, ..] = self.0;
        write!(f, "Signature({a:02x}{b:02x}{c:02x}{d:02x}…)")
    }
}

impl Order {
    /// Whether the order is to this vehicle.
    pub fn is_to(&self, id: VehicleId) -> bool {
        self.vehicles.is_none_or(|vehicles| vehicles.contains(id))
    }
}

impl std::fmt::Display for Order {
    /// `hold`, or `hold, vehicle 1, 3`
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.vehicles {
            Some(vehicles) => write!(f, "{}, vehicle {vehicles}", self.verb),
            None => write!(f, "{}", self.verb),
        }
    }
}

impl Ord for Order {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        let Self { epoch, issuer, verb, vehicles, signature } = self;
        let rank = (*verb == Verb::Abort, epoch, issuer, verb, vehicles, signature);
        let Self { epoch, issuer, verb, vehicles, signature } = other;
        rank.cmp(&(*verb == Verb::Abort, epoch, issuer, verb, vehicles, signature))
    }
}

impl PartialOrd for Order {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

/// Action of an order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum Verb {
    /// Hold position at the present altitude.
    Hold,
    /// Land at the present position. A landing vehicle can be recalled until touchdown.
    Land,
    /// Continue the mission at this step or a later one.
    Goto(u32),
    /// Abort the mission: land at the present position and ignore all later orders.
    Abort,
    /// Give the controls to a human pilot. The order always names its vehicles, and only a later order that names a
    /// vehicle takes its controls back.
    Release,
    /// Change a key in flight. The order is always to the whole swarm.
    Set(Setting),
}

impl std::fmt::Display for Verb {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Hold => f.write_str("hold"),
            Self::Land => f.write_str("land"),
            Self::Goto(step) => write!(f, "goto {step}"),
            Self::Abort => f.write_str("abort"),
            Self::Release => f.write_str("release"),
            Self::Set(setting) => write!(f, "set {setting}"),
        }
    }
}

message!(Order, 192, |order| Author::Issuer(order.issuer), |order| {
    match order.verb {
        Verb::Set(setting) => order.vehicles.is_none() && setting.is_in_range(),
        verb => order.vehicles.map_or(verb != Verb::Release, |vehicles| !vehicles.is_empty()),
    }
});
