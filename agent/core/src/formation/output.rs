//! The output of the formation stage.

use nalgebra::Vector2;

use crate::estimate::Estimate;
use crate::setpoint::Setpoint;

/// Share of the commanded velocity with which a vehicle flies as its law commands.
const FOLLOWS: f64 = 0.25;
/// Commanded velocity below which a law wants the vehicle where it is, m/s.
const STILL_M_S: f64 = 0.5;

/// The output of the formation stage for one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FormationOutput {
    /// The field V, north and east, dimensionless; zero if no law was queried or the law gives no field.
    pub field_ne: Vector2<f64>,
    /// The velocity that the law commands, before the safety filter and relative to the feed-forward, north and east, m/s.
    pub command_ne_m_s: Vector2<f64>,
    /// The setpoint for the vehicle controller.
    pub setpoint: Setpoint,
    /// Whether the vehicle is in the position the law commands, at its altitude and slow. It "reaches" a step after a
    /// dwell.
    pub in_place: bool,
}

impl FormationOutput {
    /// Altitude setpoint minus the vehicle's altitude, m.
    pub fn altitude_error_m(&self, estimate: &Estimate) -> f64 {
        self.setpoint.altitude_m - estimate.position.altitude_m()
    }

    /// Whether a vehicle with this velocity over the ground, north and east, m/s, flies as its law commands: at a quarter of the
    /// commanded velocity or faster, or the law commands next to none.
    pub fn is_followed(&self, velocity_ne_m_s: Vector2<f64>) -> bool {
        let command = self.command_ne_m_s;
        let along = (velocity_ne_m_s - self.setpoint.feedforward_ne_m_s).dot(&command);
        command.norm() < STILL_M_S || along >= FOLLOWS * command.norm_squared()
    }
}
