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

/// What everything outside a plant's own module has to know of one kind of plant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlantSpec {
    /// The kind.
    pub kind: PlantKind,
    /// Its spelling in scenarios, cluster files and on the command line; [`PlantKind`] is serialised as the same.
    pub name: &'static str,
    /// Its name in sentences.
    pub title: &'static str,
    /// What it is, as the help of the command line explains it.
    pub help: &'static str,
    /// Where its simulator runs.
    pub simulator: Simulator,
    /// The models that fly in it, each with the commands that it takes.
    pub models: &'static [(ModelKind, CommandKind)],
    /// The failures of vehicle and simulator that it plays in real time.
    pub failures: PlayedFailures,
    /// Whether its ground is flat, at the height of the origin.
    pub is_ground_flat: bool,
    /// Whether a vehicle may begin where its simulator has it, `start.pattern = "as_is"`.
    pub has_own_start: bool,
}

/// The place where a plant's simulator runs: it decides which program starts the simulator, and whether the simulator has an
/// address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Simulator {
    /// Inside the agent: it has no address, and the aircraft needs a flight model.
    Inside,
    /// In a process that `skein fly` starts for each vehicle. On a cluster users start it; `check` asks it where a node names
    /// its address.
    Launched {
        /// The arguments of `skein` that start it, before its options.
        command: &'static [&'static str],
    },
    /// In a program that users start before the flight: `fly` and `check` ask each vehicle's for an answer.
    Given,
}

/// The kind of command that a plant takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommandKind {
    /// Positions of a helicopter's controls.
    Controls,
    /// Velocities.
    Velocities,
}

/// The failures of vehicle and simulator that a plant plays in real time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlayedFailures {
    /// All of them; the agent plays them.
    All,
    /// A simulator that stands still; `fly` stops its process.
    Freeze,
    /// None.
    Nothing,
}

/// Every kind of plant, in the order of [`PlantKind`].
const SPECS: &[PlantSpec] = &[
    PlantSpec {
        kind: PlantKind::Builtin,
        name: "builtin",
        title: "the built-in plant",
        help: "The helicopter inside the agent",
        simulator: Simulator::Inside,
        models: &[(ModelKind::Helicopter, CommandKind::Controls), (ModelKind::PointMass, CommandKind::Velocities)],
        failures: PlayedFailures::All,
        is_ground_flat: true,
        has_own_start: false,
    },
    PlantSpec {
        kind: PlantKind::Standin,
        name: "standin",
        title: "the stand-in",
        help: "The same helicopter behind X-Plane's UDP protocol",
        simulator: Simulator::Launched { command: &["xplane", "standin"] },
        models: &[(ModelKind::Helicopter, CommandKind::Controls)],
        failures: PlayedFailures::Freeze,
        is_ground_flat: true,
        has_own_start: false,
    },
    PlantSpec {
        kind: PlantKind::Xplane,
        name: "xplane",
        title: "X-Plane",
        help: "X-Plane",
        simulator: Simulator::Given,
        models: &[(ModelKind::Helicopter, CommandKind::Controls)],
        failures: PlayedFailures::Nothing,
        is_ground_flat: false,
        has_own_start: true,
    },
];

impl PlantKind {
    /// The names of all kinds.
    pub const NAMES: &[&str] = &{
        let mut names = [""; SPECS.len()];
        let mut nth = 0;
        while nth < names.len() {
            names[nth] = SPECS[nth].name;
            nth += 1;
        }
        names
    };

    /// All kinds.
    pub fn all() -> impl Iterator<Item = Self> {
        SPECS.iter().map(|spec| spec.kind)
    }

    /// The kinds in which this model flies.
    pub fn flown_by(model: ModelKind) -> impl Iterator<Item = &'static PlantSpec> {
        SPECS.iter().filter(move |spec| spec.command_for(model).is_some())
    }

    /// Everything that is to be known of this kind outside its own module.
    pub fn spec(self) -> &'static PlantSpec {
        &SPECS[self as usize]
    }

    /// The kind with this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::all().find(|kind| kind.spec().name == name)
    }
}

impl ModelKind {
    /// Its spelling in scenarios.
    pub fn name(self) -> &'static str {
        match self {
            Self::Helicopter => "helicopter",
            Self::PointMass => "point_mass",
        }
    }
}

impl PlantSpec {
    /// The kind of command that it takes for this model; `None` if the model does not fly in it.
    pub fn command_for(&self, model: ModelKind) -> Option<CommandKind> {
        self.models.iter().find(|(flown, _)| *flown == model).map(|(_, command)| *command)
    }

    /// Whether its simulator has an address.
    pub fn has_address(&self) -> bool {
        self.simulator != Simulator::Inside
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_of_plant_has_its_own_spec_under_its_serialised_name() {
        for (kind, name) in PlantKind::all().zip(PlantKind::NAMES) {
            assert_eq!((kind.spec().kind, kind.spec().name, PlantKind::named(name)), (kind, *name, Some(kind)));
            assert_eq!(toml::Value::try_from(kind).unwrap().as_str(), Some(*name));
            assert!(!kind.spec().models.is_empty(), "{name} flies nothing");
        }
        assert_eq!(PlantKind::named("boat"), None);
        for model in [ModelKind::Helicopter, ModelKind::PointMass] {
            assert_eq!(toml::Value::try_from(model).unwrap().as_str(), Some(model.name()));
        }
    }
}
