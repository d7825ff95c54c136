//! The plant: what is flown, and what the built-in plant simulates.

use serde::{Deserialize, Serialize};

/// The plant that is flown, `swarm.plant`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PlantKind {
    /// The vehicle model inside the agent.
    Builtin,
    /// The built-in helicopter behind X-Plane's UDP protocol.
    Standin,
    /// X-Plane.
    Xplane,
}

/// The model of the built-in plant, and how X-Plane is used, `[plant]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VehicleModel {
    /// What the built-in plant simulates.
    pub model: ModelKind,
    /// Frames a second below which a vehicle does not take off.
    pub min_frame_rate_hz: f64,
    /// Largest number of peers that an X-Plane draws.
    pub show_peers: usize,
    /// Path of the aircraft file that X-Plane loads to draw peers, below X-Plane's folder.
    pub peer_acf: Option<String>,
    /// Deflection of the pilot's own stick beyond which the pilot of a simulator takes the controls, 0 to 1; `None`: never.
    pub stick_release: Option<f64>,
    /// Whether random failures of an X-Plane are part of the flight.
    pub random_failures: bool,
    /// Local time of day of an X-Plane, h; `None` changes nothing.
    pub local_time_h: Option<f64>,
    /// Weight of the payload of an X-Plane's aircraft, kg; `None` leaves it to X-Plane.
    pub payload_kg: Option<f64>,
    /// Weight of the fuel of an X-Plane's aircraft, kg; `None` leaves it to X-Plane.
    pub fuel_kg: Option<f64>,
    /// Limits and lags of a point mass.
    pub point_mass: PointMassLimits,
}

/// What the built-in plant simulates, `plant.model`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModelKind {
    /// The helicopter of the aircraft file.
    Helicopter,
    /// A point that follows commanded velocities.
    PointMass,
}

/// Limits and lags of a point mass, `[plant.point_mass]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PointMassLimits {
    /// Largest horizontal speed, m/s.
    pub max_speed_m_s: f64,
    /// Largest climb rate and largest sink rate, m/s.
    pub max_climb_m_s: f64,
    /// Largest horizontal acceleration and largest vertical acceleration, m/s²; `None`: no limit.
    pub max_acceleration_m_s2: Option<f64>,
    /// Time constant of the velocity, s; 0: the point has the commanded velocity at once.
    pub lag_s: f64,
    /// Largest heading rate, °/s.
    pub max_turn_deg_s: f64,
    /// Time constant of the heading rate, s; 0: the point has the commanded rate at once.
    pub turn_lag_s: f64,
}

impl PointMassLimits {
    /// [`PointMassLimits::max_turn_deg_s`] in radians per second.
    pub fn max_turn_rad_s(&self) -> f64 {
        self.max_turn_deg_s.to_radians()
    }
}
