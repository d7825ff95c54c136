//! The task that the mission stage gives to the formation stage.

use nalgebra::Vector2;

/// The task of the formation stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Task {
    /// Leave the controls unchanged.
    Wait,
    /// Leave the controls to a human pilot.
    Release,
    /// Fly the formation law.
    Formation(MissionGoal),
    /// Fly to this position and stay there.
    Stay {
        /// Position, north and east, m.
        at_ne_m: Vector2<f64>,
        /// Altitude above the origin, m; decreases during a landing.
        altitude_m: f64,
        /// Heading, clockwise from north, rad.
        heading_rad: f64,
        /// Whether this is a landing, in which nothing is added to the altitude.
        lands: bool,
    },
    /// Descend without engine power, as softly as possible.
    Autorotate {
        /// Heading, clockwise from north, rad.
        heading_rad: f64,
    },
    /// On the ground: lower the collective and keep all other controls neutral.
    Park,
}

/// The goal of the formation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MissionGoal {
    /// The step of the mission, which determines the formation.
    pub step: usize,
    /// Centre, north and east, m.
    pub centre_ne_m: Vector2<f64>,
    /// Velocity of the centre, north and east, m/s.
    pub centre_velocity_ne_m_s: Vector2<f64>,
    /// Commanded heading of the vehicle, clockwise from north, rad.
    pub heading_rad: f64,
}
