//! The interface of a formation law: from one vehicle's observation to its command. Implement it to add a law.
//!
//! A law instance belongs to one vehicle. It observes only what that vehicle knows, so that it runs on any vehicle of
//! any swarm, and it may keep a memory. It returns one kind of [`LawCommand`] and reports whether the vehicle is in place.
//! Altitude bands, the conversion to controls and the safety distance are handled by other stages.

use alloc::boxed::Box;
use alloc::format;
use alloc::string::String;
use core::fmt::Debug;

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};
use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::scenario::Formation;

/// Largest speed relative to the centre at which a vehicle counts as slow, m/s.
const SLOW_M_S: f64 = 0.5;

/// A formation law. The same sequence of observations must give bit-identical outputs: a law uses no clock, and no
/// randomness except from the seed of [`Setup`].
pub trait Law: CloneLaw + Debug + Send {
    /// The command for this observation. The agent calls it at every step of the vehicle controller (50 Hz) while the
    /// mission flies a formation, and not while the vehicle holds its position or lands.
    fn update(&mut self, observation: &Observation<'_>) -> LawOutput;

    /// Distance beyond which neighbours and obstacles do not affect the command among `live` members, m. The law need
    /// not observe what is farther away. Ranks and slots count all members at any distance. The agent asks again when that
    /// number has changed.
    fn reach_m(&self, live: usize) -> f64 {
        let _ = live;
        f64::INFINITY
    }
}

/// Copies a law with its memory. Every law that derives `Clone` implements it.
pub trait CloneLaw {
    /// A copy of this law.
    fn clone_law(&self) -> Box<dyn Law>;
}

impl<T: Law + Clone + 'static> CloneLaw for T {
    fn clone_law(&self) -> Box<dyn Law> {
        Box::new(self.clone())
    }
}

impl Clone for Box<dyn Law> {
    fn clone(&self) -> Self {
        (**self).clone_law()
    }
}

/// Inputs for building a law.
#[derive(Clone, Copy, Debug)]
pub struct Setup<'a> {
    /// The vehicle that will fly the law.
    pub own: VehicleId,
    /// The formation of the mission's steps that use the law; a law's own parameters are in `parameters`.
    pub formation: &'a Formation,
    /// Number of vehicles in the swarm, with ids from 1.
    pub vehicles: usize,
    /// Seed for all randomness; differs per vehicle and run.
    pub seed: u64,
}

/// The number `name` of `[formation.parameters]`, or `default` if it is absent.
///
/// # Errors
///
/// A value that is not a number.
pub fn number(setup: &Setup<'_>, name: &str, default: f64) -> Result<f64, String> {
    match setup.formation.parameters.get(name) {
        None => Ok(default),
        Some(toml::Value::Float(number)) => Ok(*number),
        Some(toml::Value::Integer(number)) => Ok(*number as f64),
        Some(other) => Err(format!("`formation.parameters.{name}` has to be a number, not {other}")),
    }
}

/// One vehicle's observation of the swarm at one instant.
#[derive(Clone, Copy, Debug)]
pub struct Observation<'a> {
    /// The observing vehicle.
    pub own: VehicleId,
    /// Its position.
    pub position: PositionNed,
    /// Its velocity over the ground.
    pub velocity: VelocityNed,
    /// Its heading, clockwise from north, rad.
    pub heading_rad: f64,
    /// The other live members whose states it receives, by id: those within the law's reach.
    pub neighbours: &'a [Neighbour],
    /// All other live members, those included whose states it does not receive (`network.graph`) or that are beyond the
    /// law's reach: they count for ranks and slots.
    pub members: VehicleSet,
    /// Obstacles to avoid.
    pub obstacles: &'a [Obstacle],
    /// The formation's goal.
    pub goal: Goal,
    /// Measured time since the law was last queried, s; zero in some steps.
    pub dt_s: f64,
}

/// Another live member, extrapolated from its last state to now. Spelling and order are those of a query to an external law.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Neighbour {
    /// The member's id.
    pub id: VehicleId,
    /// Its position, extrapolated to now.
    #[serde(rename = "position_ned_m")]
    pub position: PositionNed,
    /// Its velocity as last received.
    #[serde(rename = "velocity_ned_m_s")]
    pub velocity: VelocityNed,
    /// Its heading as last received, clockwise from north, rad.
    pub heading_rad: f64,
    /// Most likely age of its last state, s, over which the state was extrapolated.
    pub age_s: f64,
    /// Whether the upper bound of this age is below half a second. If not, the peer was silent or its messages are
    /// delayed.
    #[serde(rename = "fresh")]
    pub is_fresh: bool,
}

/// An obstacle, which is not a live member.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Obstacle {
    /// The vehicle that is the obstacle.
    pub id: VehicleId,
    /// Its estimated position.
    pub position: PositionNed,
    /// Uncertainty of the position, m.
    pub radius_m: f64,
}

/// The goal of the formation. Spelling and order are those of a query to an external law.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Goal {
    /// Step of the mission, counted from 0.
    pub step: usize,
    /// Centre of the formation, at this vehicle's altitude.
    #[serde(rename = "centre_ned_m")]
    pub centre: PositionNed,
    /// Velocity of the centre.
    #[serde(rename = "centre_velocity_ned_m_s")]
    pub centre_velocity: VelocityNed,
    /// Direction of the formation's first axis, clockwise from north, rad.
    pub heading_rad: f64,
    /// Radius of the formation R*, m.
    pub radius_m: f64,
    /// Squared ratio γ of the semi-axes.
    pub gamma: f64,
}

/// The output of a law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LawOutput {
    /// The command to the vehicle.
    pub command: LawCommand,
    /// Whether the vehicle is where the law commands it, altitude aside. It "reaches" a step after a dwell at its
    /// altitude.
    pub reached: bool,
}

/// The command of a law. Numbers that are not finite count as a zero displacement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LawCommand {
    /// A dimensionless field vector, NED, of a length around one, which the scenario's conversion turns into metres.
    /// The third component is used with `vertical = "ellipsoid"` only.
    Field(Vector3<f64>),
    /// Displacement from the current position, north and east, m. The vehicle flies it at 0.5 m/s per metre, at most
    /// 7.5 m/s, in addition to the centre's velocity if that is fed forward.
    Displacement(Vector2<f64>),
    /// Velocity over the ground.
    Velocity {
        /// North and east, m/s; at most 7.5 m/s in addition to the centre's velocity if that is fed forward.
        ne_m_s: Vector2<f64>,
        /// Downwards, m/s; `None` leaves the altitude to the scenario.
        down_m_s: Option<f64>,
    },
}

impl LawCommand {
    /// A velocity over the ground at the scenario's altitude.
    pub fn level(ne_m_s: Vector2<f64>) -> Self {
        Self::Velocity { ne_m_s, down_m_s: None }
    }

    /// The same command, or a zero displacement if its length is not finite: that of 1e200 is not, because it is squared.
    pub(super) fn sane(self) -> Self {
        let finite = match self {
            Self::Field(field) => field.norm_squared().is_finite(),
            Self::Displacement(displacement_ne_m) => displacement_ne_m.norm_squared().is_finite(),
            Self::Velocity { ne_m_s, down_m_s } => {
                ne_m_s.norm_squared().is_finite() && down_m_s.is_none_or(f64::is_finite)
            }
        };
        if finite { self } else { Self::Displacement(Vector2::zeros()) }
    }
}

impl Observation<'_> {
    /// Rank of this vehicle among all live ids, from 0.
    pub fn rank(&self) -> usize {
        self.members.count_below(self.own)
    }

    /// Number of live members, including this vehicle.
    pub fn live(&self) -> usize {
        self.members.len() + 1
    }

    /// Whether the vehicle is slower than 0.5 m/s relative to the centre.
    pub fn is_slow(&self) -> bool {
        (self.velocity.horizontal() - self.goal.centre_velocity.horizontal()).norm() < SLOW_M_S
    }

    /// Displacement from the centre to this vehicle, north and east, m.
    pub fn from_centre_ne_m(&self) -> Vector2<f64> {
        self.position.horizontal() - self.goal.centre.horizontal()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_whose_length_is_not_finite_becomes_none() {
        for wrong in [f64::NAN, f64::INFINITY, 4e176] {
            for command in [
                LawCommand::Field(Vector3::new(0.0, wrong, 0.0)),
                LawCommand::Displacement(Vector2::new(wrong, 1.0)),
                LawCommand::level(Vector2::new(1.0, wrong)),
            ] {
                assert_eq!(command.sane(), LawCommand::Displacement(Vector2::zeros()), "{command:?}");
            }
        }
        let fast = LawCommand::level(Vector2::new(1e9, 0.0));
        assert_eq!(fast.sane(), fast);
    }
}
