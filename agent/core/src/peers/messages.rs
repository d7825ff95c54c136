//! The newest messages of all vehicles, wherever they lie.

use alloc::sync::Arc;
use alloc::vec::Vec;

use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::VehicleId;

use super::inbox::SwarmInbox;
use super::index;
use super::peer::{KeptHeartbeat, Motion, Newest};

/// The newest messages of all vehicles.
#[derive(Clone, Debug)]
pub(super) enum Messages {
    /// Those that only this agent has received, or agents that have received the same.
    Own {
        newest: Vec<Newest>,
        /// The newest state of each vehicle.
        motions: Vec<Motion>,
    },
    /// Those in the inbox of the whole swarm at this receiver. Between two frames no record holds the inbox.
    Swarm { inbox: Option<Arc<SwarmInbox>>, receiver: VehicleId },
}

impl Default for Messages {
    fn default() -> Self {
        Self::Own { newest: Vec::new(), motions: Vec::new() }
    }
}

impl Messages {
    /// Makes room for the messages of so many vehicles.
    pub(super) fn prepare(&mut self, vehicles: usize) {
        if let Self::Own { newest, motions } = self {
            newest.resize(vehicles, Newest::default());
            motions.resize(vehicles, Motion::default());
        }
    }

    /// Becomes equal to other messages, in the memory of these.
    pub(super) fn copy_from(&mut self, other: &Self) {
        match (self, other) {
            (Self::Own { newest, motions }, Self::Own { newest: other, motions: others }) => {
                newest.clone_from(other);
                motions.clone_from(others);
            }
            (own, other) => *own = other.clone(),
        }
    }

    /// The newest messages of a vehicle, if any can be known.
    pub(super) fn newest(&self, id: VehicleId) -> Option<Newest> {
        match self {
            Self::Own { newest, .. } => newest.get(index(id)).copied(),
            Self::Swarm { inbox, receiver } => Some(inbox.as_ref()?.newest(index(id), *receiver)),
        }
    }

    /// The newest state of a vehicle, if any was received.
    #[inline]
    pub(super) fn motion(&self, id: VehicleId) -> Option<Motion> {
        match self {
            Self::Own { motions, .. } => motions.get(index(id)).copied(),
            Self::Swarm { inbox, receiver } => inbox.as_ref()?.motion(index(id), *receiver),
        }
    }

    /// The position and the velocity in the newest state of a vehicle, if any was received.
    #[inline]
    pub(super) fn reported(&self, id: VehicleId) -> Option<(PositionNed, VelocityNed)> {
        match self {
            Self::Own { motions, .. } => motions.get(index(id)).map(|motion| (motion.position, motion.velocity)),
            Self::Swarm { inbox, receiver } => inbox.as_ref()?.reported(index(id), *receiver),
        }
    }

    /// The newest heartbeat of a vehicle, if any was received.
    pub(super) fn heartbeat(&self, id: VehicleId) -> Option<KeptHeartbeat> {
        match self {
            Self::Own { newest, .. } => newest.get(index(id))?.heartbeat,
            Self::Swarm { inbox, receiver } => inbox.as_ref()?.heartbeat(index(id), *receiver),
        }
    }

    /// Time from the sending to the arrival of a vehicle's newest state, s, where the inbox knows it.
    pub(super) fn latency_s(&self, id: VehicleId) -> Option<f64> {
        match self {
            Self::Own { .. } => None,
            Self::Swarm { inbox, receiver } => inbox.as_ref()?.latency_s(index(id), *receiver),
        }
    }
}
