//! What a vehicle knows of itself and tells its peers.

use serde::{Deserialize, Serialize};

use crate::frame::{Geodetic, VelocityNed};
use crate::math;

/// Where a vehicle is and how it moves. The position is geodetic, because every simulator has its own local origin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct VehicleState {
    /// Position of the centre of gravity.
    pub position: Geodetic,
    /// Velocity over the ground.
    pub velocity: VelocityNed,
    /// Clockwise from true north, rad.
    pub heading_rad: f64,
}

impl VehicleState {
    /// Faster than this nobody flies: 300 m/s.
    pub const MAX_SPEED_M_S: f64 = 300.0;

    /// On the globe, finite, and slower than [`Self::MAX_SPEED_M_S`].
    pub fn is_plausible(&self) -> bool {
        self.position.is_plausible()
            && self.velocity.0.norm_squared() <= math::square(Self::MAX_SPEED_M_S)
            && self.heading_rad.abs() <= 7.0
    }
}

/// Where an agent stands in the swarm's agreement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum Membership {
    /// Receives what the others already agreed on; no vehicle waits for it.
    #[default]
    Joining,
    /// Takes part.
    Active,
    /// Has landed for good; no vehicle waits for it.
    Left,
}

/// What a vehicle is doing, as people see it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum Activity {
    /// Joining the swarm, controls untouched.
    #[default]
    Joining,
    /// Climbing to its altitude.
    TakingOff,
    /// Flying in formation.
    Formation,
    /// Holding its place, ordered to or because it receives from no peer.
    Holding,
    /// Descending where it is.
    Landing,
    /// Down, rotor unloaded.
    Landed,
    /// Without data of its own: controls neutral.
    Blind,
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
        })
    }
}

/// How a peer's newest state stands with the vehicle that received it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum Standing {
    /// Received just now.
    Fresh,
    /// Not received for a while, carried forward.
    Stale,
    /// Gone: no part of the formation, an obstacle for a while.
    Lost,
}
