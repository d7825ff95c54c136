//! State of a vehicle: motion, membership, activity, and the status of a peer.

use serde::{Deserialize, Serialize};

use crate::frame::{Geodetic, VelocityNed};
use crate::math;

/// Position, velocity and heading of a vehicle. The position is geodetic, because every simulator has its own local
/// origin. Velocity and heading are local: they refer to the meridian of this position, so that a receiver needs no other
/// vehicle's origin; it turns them into its own swarm's frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct VehicleState {
    /// Geodetic position of the centre of gravity.
    pub position: Geodetic,
    /// Velocity over the ground, local north, east and down, m/s.
    pub velocity: VelocityNed,
    /// Heading clockwise from the local true north, rad.
    pub heading_rad: f64,
}

impl VehicleState {
    /// Largest plausible speed, m/s.
    pub const MAX_SPEED_M_S: f64 = 300.0;

    /// Whether the position is on the globe, all numbers are finite and the speed is at most [`Self::MAX_SPEED_M_S`].
    pub fn is_plausible(&self) -> bool {
        self.position.is_plausible()
            && self.velocity.0.norm_squared() <= math::square(Self::MAX_SPEED_M_S)
            && self.heading_rad.abs() <= 7.0
    }
}

/// Membership of a vehicle in the swarm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum Membership {
    /// The agent receives the agreement state of its peers before it becomes active; the swarm does not wait for it.
    #[default]
    Joining,
    /// The vehicle is an active member: the swarm waits for it.
    Active,
    /// The vehicle landed at the end of its flight; the swarm does not wait for it.
    Left,
}

/// Activity of a vehicle, as operators see it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum Activity {
    /// The vehicle joins the swarm; the agent does not control the plant.
    #[default]
    Joining,
    /// The vehicle climbs to its altitude.
    TakingOff,
    /// The phase after take-off: the vehicle flies to its place in the formation, or is there. Whether it is in formation is a
    /// question of its place, which `in_place_s` of its messages answers.
    Formation,
    /// The vehicle holds position, by order or because no peer, or no quorum, is in contact.
    Holding,
    /// The vehicle descends at its position.
    Landing,
    /// The vehicle is on the ground, its rotor unloaded.
    Landed,
    /// The agent has no data from the simulator: the controls are neutral.
    Blind,
    /// A human pilot has the controls; the agent follows without touching them.
    Released,
}

impl std::fmt::Display for Activity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(match self {
            Self::Joining => "joining",
            Self::TakingOff => "taking off",
            Self::Formation => "formation",
            Self::Holding => "holding",
            Self::Landing => "landing",
            Self::Landed => "landed",
            Self::Blind => "blind",
            Self::Released => "released",
        })
    }
}

/// Status of a peer as an agent sees it, by the age of the peer's newest messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum PeerStatus {
    /// A state of the peer arrived recently.
    Fresh,
    /// No state of the peer arrived for a while: its position is extrapolated.
    Stale,
    /// Contact with the peer is lost: it is not in the formation any more, and is avoided as an obstacle for a while.
    Lost,
}
