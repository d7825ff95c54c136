//! Trim: the controls and attitude of a steady hover, as configured and as found in flight.

use nalgebra::Vector2;
use serde::Deserialize;

use super::climb_m_s;
use super::gains::OutOfLimits;
use crate::estimate::Estimate;
use crate::plant::Controls;
use crate::setpoint::{CollectiveLimit, Setpoint};

/// Controls and attitude in a hover without wind: the `[trim]` table of an aircraft file, which has the angles in
/// degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(try_from = "TrimTable")]
pub struct Trim {
    /// Roll control, −1 to 1.
    pub roll_stick: f64,
    /// Pitch control, −1 to 1.
    pub pitch_stick: f64,
    /// Yaw control, −1 to 1.
    pub yaw_stick: f64,
    /// Collective control, 0 to 1.
    pub collective: f64,
    /// Roll angle, right bank positive, rad.
    pub roll_rad: f64,
    /// Pitch angle, nose up positive, rad.
    pub pitch_rad: f64,
}

impl Trim {
    /// The controls in the hover, clamped to their travel even if a field is out of range.
    pub(crate) fn controls(&self) -> Controls {
        let within = |value: f64, low: f64| if value.is_finite() { value.clamp(low, 1.0) } else { 0.0 };
        Controls {
            roll: within(self.roll_stick, -1.0),
            pitch: within(self.pitch_stick, -1.0),
            yaw: within(self.yaw_stick, -1.0),
            collective: within(self.collective, 0.0),
        }
    }
}

/// The `[trim]` table as written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TrimTable {
    roll_stick: f64,
    pitch_stick: f64,
    yaw_stick: f64,
    collective: f64,
    roll_deg: f64,
    pitch_deg: f64,
}

impl TryFrom<TrimTable> for Trim {
    type Error = OutOfLimits;

    fn try_from(table: TrimTable) -> Result<Self, OutOfLimits> {
        let within = |key, value: f64, low: f64, high: f64| {
            if (low..=high).contains(&value) {
                Ok(value)
            } else {
                Err(OutOfLimits { key, value, low, high, or_negative: "" })
            }
        };
        Ok(Self {
            roll_stick: within("roll_stick", table.roll_stick, -1.0, 1.0)?,
            pitch_stick: within("pitch_stick", table.pitch_stick, -1.0, 1.0)?,
            yaw_stick: within("yaw_stick", table.yaw_stick, -1.0, 1.0)?,
            collective: within("collective", table.collective, 0.0, 1.0)?,
            roll_rad: within("roll_deg", table.roll_deg, -45.0, 45.0)?.to_radians(),
            pitch_rad: within("pitch_deg", table.pitch_deg, -45.0, 45.0)?.to_radians(),
        })
    }
}

/// Gain k of the tilt integral, rad/s per m/s.
const TILT_GAIN: f64 = 0.01;
/// Gain of the collective integral, 1/s per m/s.
const COLLECTIVE_GAIN: f64 = 0.9 * TILT_GAIN;
/// Altitude error from which the rules command their fastest climb, m.
pub(super) const FASTEST_CLIMB_ERROR_M: f64 = 5.0;
/// Climb rate that the rules reach per metre of altitude error with the trim of a hover, 1/s. A climb needs more
/// collective than a hover: the rules command 0.5 per metre, and the integral must not fill with the difference, or the
/// vehicle overshoots.
const CLIMB_PER_ERROR: f64 = 0.38;
/// Largest velocity error that counts as a trim error, m/s; larger ones are manoeuvres.
const LARGEST_VELOCITY_ERROR_M_S: f64 = 1.5;
/// Limit of the climb error, m/s. Larger errors must not stop the integral: a vehicle that stops in a strong wind has a
/// collective found at speed, with which it climbs while the rules command the fastest descent.
const LARGEST_CLIMB_ERROR_M_S: f64 = 2.5;
/// Largest velocity error that counts as a trim error while the vehicle is steadily held up, m/s: a strong wind blows
/// an untrimmed vehicle along at 2 to 4 m/s, and the rules do not command more lean.
const LARGEST_HELD_UP_ERROR_M_S: f64 = 4.0;
/// Speed along the commanded direction below which a vehicle counts as held up, m/s.
const HELD_UP_BELOW_M_S: f64 = 0.5;
/// Largest difference of a steady velocity from its mean, m/s, and the time constant of that mean, s.
const STEADY_WITHIN_M_S: f64 = 0.3;
const STEADY_OVER_S: f64 = 2.0;
/// Limits of the integrals. The lean is that of a hover in 13 m/s of wind; in 15 m/s the tail rotor reaches its stop.
/// The collective is the excess over the hover in flight at 14 m/s.
const LARGEST_TILT_RAD: f64 = 0.3;
const LARGEST_COLLECTIVE: f64 = 0.12;

/// A slow integrator of the velocity error. It finds the tilt and collective that balance wind and a wrong trim. Unlike
/// an integral of the position error, its speed does not depend on the stiffness of the formation's field.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AutoTrim {
    /// Lean t_N and t_E, north and east, beyond the aircraft's trim, rad.
    pub tilt_ne_rad: Vector2<f64>,
    /// Collective beyond the aircraft's trim.
    pub collective: f64,
    /// Mean velocity over the ground in the last seconds, north and east, m/s.
    pub mean_velocity_ne_m_s: Vector2<f64>,
}

impl AutoTrim {
    /// Advances the integrals by one step; call it only in free flight. `setpoint` is the setpoint after the gate.
    /// With e_v = relative velocity + feed-forward − v and e_w = 0.38·clamp(altitude error, ±5 m) − climb:
    /// ṫ = k e_v while |e_v| < 1.5 m/s, or < 4 m/s for a vehicle that is held up, |t| ≤ 0.3 rad;
    /// ċ = 0.9 k clamp(e_w, ±2.5 m/s), |c| ≤ 0.12.
    pub(super) fn step(&mut self, dt_s: f64, estimate: &Estimate, setpoint: &Setpoint) {
        let velocity_ne_m_s = estimate.velocity.horizontal();
        let command_ne_m_s = setpoint.relative_velocity_ne_m_s + setpoint.feedforward_ne_m_s;
        let changed_m_s = (velocity_ne_m_s - self.mean_velocity_ne_m_s).norm();
        self.mean_velocity_ne_m_s += (velocity_ne_m_s - self.mean_velocity_ne_m_s) * (dt_s / STEADY_OVER_S).min(1.0);
        let is_held_up = changed_m_s < STEADY_WITHIN_M_S
            && velocity_ne_m_s.dot(&command_ne_m_s) < HELD_UP_BELOW_M_S * command_ne_m_s.norm();

        let error_ne_m_s = command_ne_m_s - velocity_ne_m_s;
        let largest_m_s = if is_held_up { LARGEST_HELD_UP_ERROR_M_S } else { LARGEST_VELOCITY_ERROR_M_S };
        if error_ne_m_s.norm() < largest_m_s {
            self.tilt_ne_rad = (self.tilt_ne_rad + error_ne_m_s * (TILT_GAIN * dt_s)).cap_magnitude(LARGEST_TILT_RAD);
        }
        let altitude_error_m = setpoint.altitude_m - estimate.position.altitude_m();
        let command_m_s = CLIMB_PER_ERROR * altitude_error_m.clamp(-FASTEST_CLIMB_ERROR_M, FASTEST_CLIMB_ERROR_M);
        let error_m_s = command_m_s - climb_m_s(estimate);
        let error_m_s = error_m_s.clamp(-LARGEST_CLIMB_ERROR_M_S, LARGEST_CLIMB_ERROR_M_S);
        let collective = self.collective + COLLECTIVE_GAIN * error_m_s * dt_s;
        self.collective = collective.clamp(-LARGEST_COLLECTIVE, LARGEST_COLLECTIVE);
    }

    /// The limit of the collective integral, if it has reached one.
    pub(super) fn collective_limit(&self) -> Option<CollectiveLimit> {
        CollectiveLimit::of(self.collective, -LARGEST_COLLECTIVE, LARGEST_COLLECTIVE)
    }
}
