//! A law: from what one vehicle sees to what it should do. Whoever has an idea of a formation writes one of these.
//!
//! A law belongs to one vehicle. It sees what that vehicle knows, and nothing else, so that it can be moved to any vehicle
//! and any swarm; it may remember what it saw. It answers in one of the ways of [`Wanted`], and says whether it is content.
//! Heights, the way from a wish to the sticks, and the distance that all keep are none of its business.

use alloc::boxed::Box;
use alloc::format;
use alloc::string::String;
use core::fmt::Debug;

use nalgebra::{Vector2, Vector3};
use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::scenario::Formation;

/// In place, a vehicle is slower than this relative to the centre, m/s.
const SLOW_M_S: f64 = 0.5;

/// What a vehicle is to do, from what it sees. Same sights, same answers, bit for bit: no clock, no randomness but the
/// seed's of [`Setup`].
pub trait Law: CloneLaw + Debug + Send {
    /// What to do now. Asked at every step of the vehicle controller (50 Hz) while the mission wants a formation, and not
    /// while the vehicle holds its place or lands.
    fn ask(&mut self, sight: &Sight<'_>) -> Answer;
}

/// A law can be copied, with all that it remembers. Whatever derives `Clone` can.
pub trait CloneLaw {
    /// The same once more.
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

/// What a law is made from.
#[derive(Clone, Copy, Debug)]
pub struct Setup<'a> {
    /// Whose law it is to be.
    pub own: VehicleId,
    /// The formation of the steps of the mission that it flies; a law's own parameters stand in `parameters`.
    pub formation: &'a Formation,
    /// How many vehicles the swarm has, ids 1 to this.
    pub vehicles: usize,
    /// For all randomness; differs per vehicle and run.
    pub seed: u64,
}

/// A number of `[formation.parameters]`, or this where it is not given.
///
/// # Errors
/// If something else stands there.
pub fn number(setup: &Setup<'_>, name: &str, default: f64) -> Result<f64, String> {
    match setup.formation.parameters.get(name) {
        None => Ok(default),
        Some(toml::Value::Float(number)) => Ok(*number),
        Some(toml::Value::Integer(number)) => Ok(*number as f64),
        Some(other) => Err(format!("`formation.parameters.{name}` has to be a number, not {other}")),
    }
}

/// What one vehicle sees of the swarm at one instant.
#[derive(Clone, Copy, Debug)]
pub struct Sight<'a> {
    /// Who sees it.
    pub own: VehicleId,
    /// Where it is.
    pub position: PositionNed,
    /// Over the ground.
    pub velocity: VelocityNed,
    /// Where its nose points, clockwise from north, rad.
    pub heading_rad: f64,
    /// The other live members that it hears, by id.
    pub neighbours: &'a [Neighbour],
    /// Live members besides, of whose places it is told nothing (`network.graph`): they count, and have their ranks.
    pub unseen: VehicleSet,
    /// What to keep away from besides.
    pub obstacles: &'a [Obstacle],
    /// Where the formation is to be.
    pub goal: Goal,
    /// Since the law was last asked, s; measured, now and then zero.
    pub dt_s: f64,
}

/// Another live member, carried forward from its last word to now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// Who.
    pub id: VehicleId,
    /// Its place now.
    pub position: PositionNed,
    /// As last heard.
    pub velocity: VelocityNed,
    /// As last heard, clockwise from north, rad.
    pub heading_rad: f64,
    /// The most likely age of its last state, s: it was carried forward for so long.
    pub age_s: f64,
    /// The upper bound of this age is below half a second. Otherwise the peer has been silent, or its messages take long.
    pub is_fresh: bool,
}

/// Something to keep away from that is no member.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Obstacle {
    /// Whose place it is.
    pub id: VehicleId,
    /// Where it is thought to be.
    pub position: PositionNed,
    /// How far around that it may be, m.
    pub radius_m: f64,
}

/// Where the formation is to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Step of the mission, counted from 0.
    pub step: usize,
    /// Its centre.
    pub centre: PositionNed,
    /// How the centre moves.
    pub centre_velocity: VelocityNed,
    /// Direction of the formation's first axis, clockwise from north, rad.
    pub heading_rad: f64,
    /// How large the formation is, m (R*).
    pub radius_m: f64,
    /// Squared ratio of its semi-axes (γ).
    pub gamma: f64,
}

/// What a law says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    /// What it wants.
    pub wanted: Wanted,
    /// The vehicle is where the law wants it, heights aside: after a while of this, at its height, it has "reached".
    pub is_there: bool,
}

/// What a law wants of the vehicle. Numbers that are not finite count as no wish.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Wanted {
    /// A direction and an urgency, NED, dimensionless, of length one or so: the scenario's conversion makes metres of it.
    /// The third component counts under `vertical = "ellipsoid"` alone.
    Field(Vector3<f64>),
    /// To be this far from here, north and east, m. It is flown there at half a metre a second for each metre, 7.5 m/s at
    /// most, on top of the centre's velocity where that is fed forward.
    Way(Vector2<f64>),
    /// To fly at this velocity over the ground.
    Velocity {
        /// North and east, m/s; no more than 7.5 m/s besides the centre's velocity where that is fed forward.
        ne_m_s: Vector2<f64>,
        /// Downwards, m/s; `None` leaves the height to the scenario.
        down_m_s: Option<f64>,
    },
}

impl Wanted {
    /// A velocity over the ground at the height that the scenario says.
    pub fn level(ne_m_s: Vector2<f64>) -> Self {
        Self::Velocity { ne_m_s, down_m_s: None }
    }

    /// The same, or to stay here if it is not finite.
    pub(super) fn sane(self) -> Self {
        let finite = match self {
            Self::Field(field) => field.iter().all(|x| x.is_finite()),
            Self::Way(way_ne_m) => way_ne_m.iter().all(|x| x.is_finite()),
            Self::Velocity { ne_m_s, down_m_s } => ne_m_s.iter().chain(&down_m_s).all(|x| x.is_finite()),
        };
        if finite { self } else { Self::Way(Vector2::zeros()) }
    }
}

impl Sight<'_> {
    /// Place in the order of all live ids, from 0.
    pub fn rank(&self) -> usize {
        let seen = self.neighbours.iter().filter(|neighbour| neighbour.id < self.own).count();
        seen + self.unseen.iter().filter(|id| *id < self.own).count()
    }

    /// Live members, the own vehicle included.
    pub fn live(&self) -> usize {
        self.neighbours.len() + self.unseen.len() + 1
    }

    /// Slower than half a metre a second relative to the centre.
    pub fn is_slow(&self) -> bool {
        (self.velocity.horizontal() - self.goal.centre_velocity.horizontal()).norm() < SLOW_M_S
    }

    /// The way from the centre to the own place, north and east, m.
    pub fn from_centre_ne_m(&self) -> Vector2<f64> {
        self.position.horizontal() - self.goal.centre.horizontal()
    }
}
