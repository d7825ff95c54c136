//! The sensors of the vehicles: precision, errors, latency and dropouts of measurements.

use serde::{Deserialize, Serialize};

use super::super::key::declare::*;
use super::super::key::keys;

keys! {
    /// Sensors of the vehicles, `[sensing]`.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct Sensing at "sensing." {
        position: PositionSensing = OneOf(&["exact", "f32_latlon"]), text("exact"),
            "precision of measured positions; \"f32_latlon\" rounds degrees to single precision, as in Garcia & Barnes 2010",
            paper(text("f32_latlon"));
        velocity: VelocitySensing = OneOf(&["measured", "differenced"]), text("measured"),
            "source of the horizontal velocity: measured, or differenced from positions as a simple GPS receiver does";
        differenced_tau_s: f64 = above_zero(60.0), number(1.0),
            "time constant tau of the filter under velocity = \"differenced\"; 1 s damps the steps of rounded positions";
        latency_s: f64 = from(0.0, 2.0), number(0.0),
            "age at which a measurement reaches the agent, rounded up to whole frames; by default it is the present one";
        dropout: f64 = from(0.0, 1.0), number(0.0),
            "share of frames without any measurement; by default none is missing", unit_is("1");
        dropout_s: Option<f64> = above_zero_or("none", 60.0), text("none"),
            "mean length of a dropout; \"none\": each frame is dropped independently";
        correlation_s: Option<f64> = above_zero_or("none", 1e4), text("none"),
            "correlation time of the noise of position and altitude, a first-order Gauss-Markov process; \"none\": white noise. A satellite \
             receiver's error drifts over tens of seconds";
        /// Standard deviations of the random errors that change from frame to frame.
        noise: SensorErrors;
        /// Standard deviations from which the constant errors of each vehicle are drawn once.
        bias: SensorErrors;
    }
}

impl Sensing {
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

/// The keys of `[sensing.noise]` and `[sensing.bias]`.
#[rustfmt::skip]
pub(in crate::scenario) const SENSOR_ERROR_KEYS: &[Key] = &[
    Key::new("sensing.noise.position_m", from(0.0, 100.0), number(0.0),
        "standard deviation of the noise of the position, north and east each; by default sensors are exact"),
    Key::new("sensing.noise.altitude_m", from(0.0, 100.0), number(0.0),
        "standard deviation of the noise of the altitude; the height above the ground has a sensor of its own and stays exact"),
    Key::new("sensing.noise.velocity_m_s", from(0.0, 10.0), number(0.0),
        "standard deviation of the white noise of each component of the velocity"),
    Key::new("sensing.noise.attitude_deg", from(0.0, 10.0), number(0.0),
        "standard deviation of the white noise of roll and pitch"),
    Key::new("sensing.noise.heading_deg", from(0.0, 10.0), number(0.0),
        "standard deviation of the white noise of the heading"),
    Key::new("sensing.noise.rate_deg_s", from(0.0, 100.0), number(0.0),
        "standard deviation of the white noise of each body rate"),
    Key::new("sensing.bias.position_m", from(0.0, 100.0), number(0.0),
        "standard deviation from which each vehicle's constant error of the position is drawn, north and east each; by default sensors are exact"),
    Key::new("sensing.bias.altitude_m", from(0.0, 100.0), number(0.0),
        "standard deviation from which each vehicle's constant error of the altitude is drawn"),
    Key::new("sensing.bias.velocity_m_s", from(0.0, 10.0), number(0.0),
        "standard deviation from which each vehicle's constant error of each component of the velocity is drawn"),
    Key::new("sensing.bias.attitude_deg", from(0.0, 10.0), number(0.0),
        "standard deviation from which each vehicle's constant error of roll and pitch is drawn"),
    Key::new("sensing.bias.heading_deg", from(0.0, 10.0), number(0.0),
        "standard deviation from which each vehicle's constant error of the heading is drawn"),
    Key::new("sensing.bias.rate_deg_s", from(0.0, 100.0), number(0.0),
        "standard deviation from which each vehicle's constant error of each body rate is drawn"),
];
