//! Measurements become an [`Estimate`]: what the vehicle believes of itself.

use skein_common::frame::{Attitude, BodyRates, Geodetic, PositionNed, VelocityNed};

/// What the vehicle believes of itself at one instant. Every number is finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Position in the swarm's local frame.
    pub position: PositionNed,
    /// The same place as it is told to peers.
    pub geodetic: Geodetic,
    /// Height of the centre of gravity above the ground, m.
    pub height_m: f64,
    /// Velocity over the ground.
    pub velocity: VelocityNed,
    /// Attitude.
    pub attitude: Attitude,
    /// Angular velocity.
    pub rates: BodyRates,
    /// Main rotor speed, rad/s, where the plant tells it.
    pub rotor_speed_rad_s: Option<f64>,
}
