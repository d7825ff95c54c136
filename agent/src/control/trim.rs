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
#[error("{key} = {value} is not within {low} to {high}")]
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
const COLLECTIVE_GAIN: f64 = 0.45 * TILT_GAIN;
/// Velocity that the rules ask for per metre of error, 1/s.
pub(crate) const VELOCITY_PER_ERROR: f64 = 0.5;
/// Fastest climb that the rules ask for, m/s.
const FASTEST_CLIMB_M_S: f64 = 2.5;
/// From this altitude error on the rules ask for their fastest climb and the integral rests, m.
pub(super) const FASTEST_CLIMB_ERROR_M: f64 = FASTEST_CLIMB_M_S / VELOCITY_PER_ERROR;
/// Larger velocity errors are manoeuvres, not trim errors, m/s. Under wind the steady error of the climb lies near
/// 1 m/s: its limit must be well above.
const LARGEST_VELOCITY_ERROR_M_S: f64 = 1.5;
const LARGEST_CLIMB_ERROR_M_S: f64 = 2.5;
/// Clamps of the integrals.
const LARGEST_TILT_RAD: f64 = 0.15;
const LARGEST_COLLECTIVE: f64 = 0.1;

/// A slow integrator of the velocity-command error: it finds the tilt and the collective that wind and a wrong trim
/// call for. Unlike an integral of the position error its speed does not depend on how soft the formation's field is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AutoTrim {
    /// t_N and t_E: lean north and east beyond the aircraft's trim, rad.
    pub tilt_ne_rad: Vector2<f64>,
    /// Collective beyond the aircraft's trim.
    pub collective: f64,
}

impl AutoTrim {
    /// One step of the integrals, to be called only in free flight. `setpoint` has its error after the gate.
    /// With e_v = 0.5·error + feed-forward − v and e_w = clamp(0.5·altitude error, ±2.5) − climb:
    /// ṫ = k e_v while |e_v| < 1.5 m/s, ċ = 0.45 k e_w while |e_w| < 2.5 m/s.
    pub(super) fn step(&mut self, dt_s: f64, estimate: &Estimate, setpoint: &Setpoint) {
        let wanted_ne_m_s = setpoint.error_ne_m * VELOCITY_PER_ERROR + setpoint.feedforward_ne_m_s;
        let error_ne_m_s = wanted_ne_m_s - estimate.velocity.horizontal();
        if error_ne_m_s.norm() < LARGEST_VELOCITY_ERROR_M_S {
            let tilt_ne_rad = self.tilt_ne_rad + error_ne_m_s * (TILT_GAIN * dt_s);
            self.tilt_ne_rad = tilt_ne_rad.map(|tilt_rad| tilt_rad.clamp(-LARGEST_TILT_RAD, LARGEST_TILT_RAD));
        }
        let altitude_error_m = setpoint.altitude_m - estimate.position.altitude_m();
        let wanted_m_s = (VELOCITY_PER_ERROR * altitude_error_m).clamp(-FASTEST_CLIMB_M_S, FASTEST_CLIMB_M_S);
        let error_m_s = wanted_m_s - climb_m_s(estimate);
        if error_m_s.abs() < LARGEST_CLIMB_ERROR_M_S {
            let collective = self.collective + COLLECTIVE_GAIN * error_m_s * dt_s;
            self.collective = collective.clamp(-LARGEST_COLLECTIVE, LARGEST_COLLECTIVE);
        }
    }

    /// The limit at which the collective integral is.
    pub(super) fn collective_limit(&self) -> Option<CollectiveLimit> {
        CollectiveLimit::of(self.collective, -LARGEST_COLLECTIVE, LARGEST_COLLECTIVE)
    }
}
