//! Received messages, as the stages of the loop get them.

use serde::{Deserialize, Serialize};
use skein_common::frame::{Geodetic, Origin, PositionNed, VelocityNed};
use skein_common::id::VehicleId;
use skein_common::message::{Header, Heartbeat, Order, State, encoded_len};
use skein_common::state::VehicleState;
use skein_common::time::LocalTime;

/// A received message with its time of arrival.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Received {
    /// The message.
    pub message: PeerMessage,
    /// Time of arrival by the own clock.
    pub at: LocalTime,
}

/// A message from a peer, the network or an operator.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum PeerMessage {
    /// A peer's state.
    State(ReceivedState),
    /// A peer's heartbeat with its agreement state.
    Mission(Heartbeat),
    /// A peer's liveliness token appeared.
    Appeared(VehicleId),
    /// A peer's liveliness token vanished.
    Vanished(VehicleId),
    /// An operator's order, sent by the operator.
    Order(Order),
}

/// A peer's state in the swarm's frame, converted once for all receivers in this process.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReceivedState {
    /// Sender, number and time of the message.
    pub header: Header,
    /// The position as sent.
    pub geodetic: Geodetic,
    /// The velocity over the ground in the swarm's frame.
    pub velocity: VelocityNed,
    /// The heading in the swarm's frame, rad.
    pub heading_rad: f64,
    /// The position in the swarm's frame.
    pub position: PositionNed,
}

impl ReceivedState {
    /// The state of this message, in the frame at `origin`.
    pub fn new(message: State, origin: &Origin) -> Self {
        let State { header, state: VehicleState { position: geodetic, velocity, heading_rad } } = message;
        let (position, convergence) = origin.locate(&geodetic);
        let velocity = convergence.velocity_from_local(velocity);
        Self { header, geodetic, velocity, heading_rad: convergence.heading_from_local(heading_rad), position }
    }

    /// Length of the message as sent, bytes.
    pub fn message_len(&self) -> usize {
        // A number has the same length in every frame.
        let &Self { header, geodetic: position, velocity, heading_rad, .. } = self;
        encoded_len(&State { header, state: VehicleState { position, velocity, heading_rad } })
    }
}

impl PeerMessage {
    /// Whether the message has a header with its sender and number.
    pub(super) fn is_numbered(&self) -> bool {
        matches!(self, Self::State(_) | Self::Mission(_))
    }

    /// The sender; `None` for an operator.
    pub fn sender(&self) -> Option<VehicleId> {
        match self {
            Self::State(message) => Some(message.header.sender),
            Self::Mission(message) => Some(message.header.sender),
            Self::Appeared(id) | Self::Vanished(id) => Some(*id),
            Self::Order(_) => None,
        }
    }
}
