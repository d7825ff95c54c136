//! Summary of an agent for pages, ground stations and scripts: JSON, at most ten times a second.

use serde::{Deserialize, Serialize};

use super::{Encoding, Failure, Header, MAX_STEP, Message, VehicleFacts, message};
use crate::id::VehicleId;
use crate::scenario::{Setting, TunableKey};
use crate::state::{PeerStatus, VehicleState};
use crate::time::PlantTime;
use crate::topic::{Author, Topic};

/// Summary of an agent: what its vehicle believes of itself, of the formation and of its peers. Every value is the
/// vehicle's own estimate or count, never the ground truth. Sent only while a process subscribes. Numbers are rounded to
/// three decimals.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Sender, number and time of the message.
    pub header: Header,
    /// Simulator time of the last frame, ns.
    pub plant_time: PlantTime,
    /// Facts of the vehicle.
    #[serde(flatten)]
    pub facts: VehicleFacts,
}

/// Contact with one peer. In JSON it is an array of its values, in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "(VehicleId, u32, PeerStatus)", into = "(VehicleId, u32, PeerStatus)")]
pub struct PeerContact {
    /// The peer.
    pub id: VehicleId,
    /// Upper bound of the age of the peer's newest state by the receiver's clock, ms; it includes the delay once a round trip
    /// is known.
    pub age_ms: u32,
    /// Fresh, stale or lost.
    pub standing: PeerStatus,
}

impl PeerContact {
    /// Contact with a peer whose newest state has this age, s; an age beyond the range of [`Self::age_ms`] is cut to it.
    pub fn new(id: VehicleId, age_s: f64, standing: PeerStatus) -> Self {
        // A conversion from a float saturates.
        Self { id, age_ms: (1e3 * age_s).round() as u32, standing }
    }
}

impl From<(VehicleId, u32, PeerStatus)> for PeerContact {
    fn from((id, age_ms, standing): (VehicleId, u32, PeerStatus)) -> Self {
        Self { id, age_ms, standing }
    }
}

impl From<PeerContact> for (VehicleId, u32, PeerStatus) {
    fn from(PeerContact { id, age_ms, standing }: PeerContact) -> Self {
        (id, age_ms, standing)
    }
}

impl Summary {
    /// The same with every number rounded to three decimals.
    pub fn rounded(self) -> Self {
        Self { facts: self.facts.rounded(), ..self }
    }
}

message!(Summary in Json, 8 * 1024, |summary| Author::Vehicle(summary.header.sender), |summary| {
    // JSON has no number that is not finite: ranges are left to check.
    let VehicleFacts { position, velocity, step, reached, settings, process, failures, peers, .. } = &summary.facts;
    let timing = process.map(|process| [process.frame_rate_hz, process.jitter_ms, process.step_p99_us]);
    position.is_none_or(|position| position.0.norm() < MAX_DISTANCE_M)
        && velocity.0.norm() <= VehicleState::MAX_SPEED_M_S
        && timing.is_some_and(|timing| timing.iter().all(|number| *number >= 0.0))
        && *step <= MAX_STEP
        && reached.is_none_or(|reached| reached <= MAX_STEP)
        && settings.len() <= TunableKey::ALL.len()
        && settings.iter().all(Setting::is_in_range)
        && failures.len() <= Failure::KINDS
        && peers.len() <= usize::from(VehicleId::MAX)
});

/// Largest plausible distance from the swarm's origin, m: the diameter of the Earth.
const MAX_DISTANCE_M: f64 = 13e6;

#[cfg(test)]
mod tests;
