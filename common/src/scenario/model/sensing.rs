//! The sensors of the vehicles: precision, errors, latency and dropouts of measurements.

use serde::{Deserialize, Serialize};

/// Sensors of the vehicles, `[sensing]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sensing {
    /// Precision of measured positions.
    pub position: PositionSensing,
    /// Source of the horizontal velocity.
    pub velocity: VelocitySensing,
    /// Time constant τ of the differencing filter, s.
    pub differenced_tau_s: f64,
    /// Age at which a measurement reaches the agent, s.
    pub latency_s: f64,
    /// Share of frames without a measurement.
    pub dropout: f64,
    /// Mean length of a dropout, s; `None`: each frame is dropped independently.
    pub dropout_s: Option<f64>,
    /// Correlation time of the noise of position and altitude, s; `None`: white noise.
    pub correlation_s: Option<f64>,
    /// Standard deviations of the random errors that change from frame to frame.
    pub noise: SensorErrors,
    /// Standard deviations from which the constant errors of each vehicle are drawn once.
    pub bias: SensorErrors,
}

impl Sensing {
    /// Sensors with this precision and this source of the velocity, without any other error, latency or dropout.
    pub fn without_errors(position: PositionSensing, velocity: VelocitySensing) -> Self {
        Self {
            position,
            velocity,
            differenced_tau_s: 1.0,
            latency_s: 0.0,
            dropout: 0.0,
            dropout_s: None,
            correlation_s: None,
            noise: SensorErrors::default(),
            bias: SensorErrors::default(),
        }
    }

    /// Whether the sensors have neither noise, bias, latency nor dropouts.
    pub fn is_without_errors(&self) -> bool {
        let none = SensorErrors::default();
        self.latency_s == 0.0 && self.dropout == 0.0 && self.noise == none && self.bias == none
    }
}

/// Precision of measured positions, `sensing.position`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PositionSensing {
    /// The exact position.
    Exact,
    /// Latitude and longitude in degrees, rounded to single precision.
    F32Latlon,
}

/// Source of the horizontal velocity, `sensing.velocity`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VelocitySensing {
    /// The velocity that the plant measures.
    Measured,
    /// The filtered difference of positions.
    Differenced,
}

/// Standard deviations of the errors of a vehicle's sensors, `[sensing.noise]` and `[sensing.bias]`; by default zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SensorErrors {
    /// Position north, and position east, m.
    pub position_m: f64,
    /// Altitude, m.
    pub altitude_m: f64,
    /// Each component of the velocity, m/s.
    pub velocity_m_s: f64,
    /// Roll angle, and pitch angle, °.
    pub attitude_deg: f64,
    /// Heading, °.
    pub heading_deg: f64,
    /// Each body rate, °/s.
    pub rate_deg_s: f64,
}

impl SensorErrors {
    /// [`SensorErrors::attitude_deg`] in radians.
    pub fn attitude_rad(&self) -> f64 {
        self.attitude_deg.to_radians()
    }

    /// [`SensorErrors::heading_deg`] in radians.
    pub fn heading_rad(&self) -> f64 {
        self.heading_deg.to_radians()
    }

    /// [`SensorErrors::rate_deg_s`] in radians per second.
    pub fn rate_rad_s(&self) -> f64 {
        self.rate_deg_s.to_radians()
    }
}
