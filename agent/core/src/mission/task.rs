//! What the mission stage asks of the formation stage.

use nalgebra::Vector2;

/// What the formation stage is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Task {
    /// Nothing: leave the controls alone.
    Wait,
    /// Fly the formation law.
    Formation(Goal),
    /// Go to this place and stay.
    Stay {
        /// North and east, m.
        at_ne_m: Vector2<f64>,
        /// Above the origin, m; sinks during a landing.
        altitude_m: f64,
        /// Clockwise from north.
        heading_rad: f64,
        /// On the way down: nothing changes the altitude.
        lands: bool,
    },
    /// Without power: come down as softly as it goes.
    Autorotate {
        /// Clockwise from north.
        heading_rad: f64,
    },
    /// Down: take the collective out and keep everything else neutral.
    Park,
}

/// Where the formation is to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// The step of the mission, which says what the formation is.
    pub step: usize,
    /// Centre, north and east, m.
    pub centre_ne_m: Vector2<f64>,
    /// How the centre moves, north and east, m/s.
    pub centre_velocity_ne_m_s: Vector2<f64>,
    /// The vehicle's heading, clockwise from north.
    pub heading_rad: f64,
}
