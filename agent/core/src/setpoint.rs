//! The values that pass between the formation stage and the control stage: the formation's setpoint, and the limit that control met with the
//! last one.

use nalgebra::Vector2;

/// Velocity that the rules of the control stage command per metre of position error, 1/s. Multiplication by 0.5 is exact in
/// floating point.
pub(crate) const VELOCITY_PER_ERROR_PER_S: f64 = 0.5;

/// The formation's command to the vehicle controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setpoint {
    /// Commanded velocity relative to the feed-forward, north and east, m/s: the formation's field after conversion and
    /// safety filter, before the gate.
    pub relative_velocity_ne_m_s: Vector2<f64>,
    /// Velocity of the moving centre, north and east, m/s; zero if it is not fed forward.
    pub feedforward_ne_m_s: Vector2<f64>,
    /// Altitude above the swarm's origin, m.
    pub altitude_m: f64,
    /// Heading, clockwise from north, rad.
    pub heading_rad: f64,
}

impl Setpoint {
    /// The relative velocity in the unit of the rule bases: the position error at which they command it, north and
    /// east, m.
    pub fn error_ne_m(&self) -> Vector2<f64> {
        self.relative_velocity_ne_m_s / VELOCITY_PER_ERROR_PER_S
    }
}

/// The limit of the controller's authority over the climb, which the mission takes of the last step: no collective is left in this
/// direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CollectiveLimit {
    /// The collective is at its lowest: the vehicle cannot sink faster.
    Lowest,
    /// The collective is at its highest: the vehicle cannot climb faster.
    Highest,
}

impl CollectiveLimit {
    /// The limit of the range from `low` to `high` that this value has reached.
    pub(crate) fn of(value: f64, low: f64, high: f64) -> Option<Self> {
        if value >= high {
            Some(Self::Highest)
        } else if value <= low {
            Some(Self::Lowest)
        } else {
            None
        }
    }

    /// Whether this limit prevents a correction of this altitude error, setpoint minus altitude, m.
    pub fn is_towards(self, altitude_error_m: f64) -> bool {
        match self {
            Self::Lowest => altitude_error_m < 0.0,
            Self::Highest => altitude_error_m > 0.0,
        }
    }
}
