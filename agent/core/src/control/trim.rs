//! Trim: what keeps this aircraft hovering, as configured and as found in flight.

use nalgebra::Vector2;
use serde::Deserialize;

use super::{CollectiveLimit, Setpoint, climb_m_s};
use crate::estimate::Estimate;
use crate::plant::Sticks;

/// What the sticks and the attitude are in a hover without wind: the `[trim]` table of an aircraft's file, which has the
/// angles in degrees.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(try_from = "TrimTable")]
pub struct Trim {
    /// −1 to 1.
    pub roll_stick: f64,
    /// −1 to 1.
    pub pitch_stick: f64,
    /// −1 to 1.
    pub yaw_stick: f64,
    /// 0 to 1.
    pub collective: f64,
    /// Right bank positive.
    pub roll_rad: f64,
    /// Nose up positive.
    pub pitch_rad: f64,
}

impl Trim {
    /// The controls in the hover, within their travel whatever the fields hold.
    pub(crate) fn sticks(&self) -> Sticks {
        let within = |value: f64, low: f64| if value.is_finite() { value.clamp(low, 1.0) } else { 0.0 };
        Sticks {
            roll: within(self.roll_stick, -1.0),
            pitch: within(self.pitch_stick, -1.0),
            yaw: within(self.yaw_stick, -1.0),
            collective: within(self.collective, 0.0),
        }
    }
}

/// The table as written.
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

/// A `[trim]` table with a number that no hover has.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{key} is {value}, but has to be within {low} to {high}")]
pub struct BadTrim {
    key: &'static str,
    value: f64,
    low: f64,
    high: f64,
}

impl TryFrom<TrimTable> for Trim {
    type Error = BadTrim;

    fn try_from(table: TrimTable) -> Result<Self, BadTrim> {
        let within = |key, value: f64, low: f64, high: f64| {
            if (low..=high).contains(&value) { Ok(value) } else { Err(BadTrim { key, value, low, high }) }
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

/// k of the tilt integral, rad/s per m/s.
const TILT_GAIN: f64 = 0.01;
/// Of the collective integral, 1/s per m/s.
const COLLECTIVE_GAIN: f64 = 0.9 * TILT_GAIN;
/// The velocity that the rules ask for per metre of error, 1/s. Half as much is exact in floating point.
pub(crate) const VELOCITY_PER_ERROR_PER_S: f64 = 0.5;
/// From this altitude error on the rules ask for their fastest climb, m.
pub(super) const FASTEST_CLIMB_ERROR_M: f64 = 5.0;
/// Climb in which the rules settle, per metre of altitude error, where hover and climb are trimmed alike, 1/s. A climb
/// takes more collective than a hover. The rules ask for 0.5 per metre; the integral must not fill with the rest, or the
/// vehicle overshoots.
const CLIMB_PER_ERROR: f64 = 0.38;
/// Larger velocity errors are manoeuvres, not trim errors, m/s.
const LARGEST_VELOCITY_ERROR_M_S: f64 = 1.5;
/// No error of the climb counts for more than this, m/s. It must not rest beyond: a vehicle that stops in a strong wind has
/// a collective found at speed, with which it climbs while the rules ask for the fastest descent.
const LARGEST_CLIMB_ERROR_M_S: f64 = 2.5;
/// A velocity error up to this is a trim error too while the vehicle is steadily held up, m/s: a strong wind blows a vehicle
/// without trim along at 2 to 4 m/s, and the rules ask for no more lean.
const LARGEST_HELD_UP_ERROR_M_S: f64 = 4.0;
/// A vehicle is held up if it does not fly faster than this where it is asked to, m/s.
const HELD_UP_BELOW_M_S: f64 = 0.5;
/// A velocity that differs by less than this from its own mean of the last seconds is steady, m/s, s.
const STEADY_WITHIN_M_S: f64 = 0.3;
const STEADY_OVER_S: f64 = 2.0;
/// Clamps of the integrals. The lean is that of a hover in 13 m/s of wind; in 15 m/s the tail rotor comes to its stop. The
/// collective is what a flight at 14 m/s takes beyond the hover.
const LARGEST_TILT_RAD: f64 = 0.3;
const LARGEST_COLLECTIVE: f64 = 0.12;

/// A slow integrator of the velocity-command error: it finds the tilt and the collective that wind and a wrong trim
/// call for. Unlike an integral of the position error its speed does not depend on how soft the formation's field is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AutoTrim {
    /// t_N and t_E: lean north and east beyond the aircraft's trim, rad.
    pub tilt_ne_rad: Vector2<f64>,
    /// Collective beyond the aircraft's trim.
    pub collective: f64,
    /// The velocity over the ground, north and east, averaged over the last seconds, m/s.
    pub mean_velocity_ne_m_s: Vector2<f64>,
}

impl AutoTrim {
    /// One step of the integrals, to be called only in free flight. `setpoint` is the one after the gate.
    /// With e_v = relative velocity + feed-forward − v and e_w = 0.38·clamp(altitude error, ±5 m) − climb:
    /// ṫ = k e_v while |e_v| < 1.5 m/s, or < 4 m/s where it is held up, |t| ≤ 0.3 rad;
    /// ċ = 0.9 k clamp(e_w, ±2.5 m/s), |c| ≤ 0.12.
    pub(super) fn step(&mut self, dt_s: f64, estimate: &Estimate, setpoint: &Setpoint) {
        let velocity_ne_m_s = estimate.velocity.horizontal();
        let wanted_ne_m_s = setpoint.relative_velocity_ne_m_s + setpoint.feedforward_ne_m_s;
        let changed_m_s = (velocity_ne_m_s - self.mean_velocity_ne_m_s).norm();
        self.mean_velocity_ne_m_s += (velocity_ne_m_s - self.mean_velocity_ne_m_s) * (dt_s / STEADY_OVER_S).min(1.0);
        let is_held_up = changed_m_s < STEADY_WITHIN_M_S
            && velocity_ne_m_s.dot(&wanted_ne_m_s) < HELD_UP_BELOW_M_S * wanted_ne_m_s.norm();

        let error_ne_m_s = wanted_ne_m_s - velocity_ne_m_s;
        let largest_m_s = if is_held_up { LARGEST_HELD_UP_ERROR_M_S } else { LARGEST_VELOCITY_ERROR_M_S };
        if error_ne_m_s.norm() < largest_m_s {
            self.tilt_ne_rad = (self.tilt_ne_rad + error_ne_m_s * (TILT_GAIN * dt_s)).cap_magnitude(LARGEST_TILT_RAD);
        }
        let altitude_error_m = setpoint.altitude_m - estimate.position.altitude_m();
        let wanted_m_s = CLIMB_PER_ERROR * altitude_error_m.clamp(-FASTEST_CLIMB_ERROR_M, FASTEST_CLIMB_ERROR_M);
        let error_m_s = wanted_m_s - climb_m_s(estimate);
        let error_m_s = error_m_s.clamp(-LARGEST_CLIMB_ERROR_M_S, LARGEST_CLIMB_ERROR_M_S);
        let collective = self.collective + COLLECTIVE_GAIN * error_m_s * dt_s;
        self.collective = collective.clamp(-LARGEST_COLLECTIVE, LARGEST_COLLECTIVE);
    }

    /// The limit at which the collective integral is.
    pub(super) fn collective_limit(&self) -> Option<CollectiveLimit> {
        CollectiveLimit::of(self.collective, -LARGEST_COLLECTIVE, LARGEST_COLLECTIVE)
    }
}
