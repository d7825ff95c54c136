//! The plant: what is flown, and what the built-in plant simulates.

use serde::{Deserialize, Serialize};

use super::super::key::keys;

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

/// The facts about one kind of plant that the program outside the plant's own module needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlantSpec {
    /// The kind.
    pub kind: PlantKind,
    /// Its spelling in scenarios, cluster files and on the command line; [`PlantKind`] is serialised as the same.
    pub name: &'static str,
    /// Its name in sentences.
    pub title: &'static str,
    /// Its explanation in the help of the command line.
    pub help: &'static str,
    /// The place where its simulator runs.
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

keys! {
    /// The model of the built-in plant, and how X-Plane is used, `[plant]`.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct VehicleModel at "plant." {
        model: ModelKind = OneOf(&["helicopter", "point_mass"]), text("helicopter"),
            "what the built-in plant simulates: the helicopter of the aircraft file, or a point that follows velocities (\"point_mass\"), \
             for studies of laws at scale; a helicopter is nearer to flight";
        min_frame_rate_hz: f64 = from(0.0, 50.0), number(20.0),
            "frame rate below which a vehicle does not take off, 0 for none; Garcia & Barnes 2010 refuse less than 20 Hz, and X-Plane slows \
             its time below 19 Hz";
        show_peers: usize = Integer(0, 19), whole(0),
            "how many of its nearest peers each X-Plane draws as its other aircraft, at most 19; 0 leaves X-Plane's other aircraft alone, \
             each of which costs frame rate", unit_is("vehicles");
        peer_acf: Option<String> = Text, Nothing,
            "aircraft file that X-Plane loads to draw peers, its path below X-Plane's folder, as Aircraft/My/heli.acf; without it peers look \
             like the other aircraft that X-Plane has loaded";
        stick_release: Option<f64> = above_zero_or("none", 1.0), text("none"),
            "deflection of the pilot's own stick, a share of its travel, beyond which a simulator's pilot takes the controls; never by \
             default: an uncentred stick would take them", unit_is("1");
        random_failures: bool = Bool, flag(false),
            "whether X-Plane's random failures are part of the flight: check and status then state that they are on, instead of a \
             fault; Skein does not turn them on";
        local_time_h: Option<f64> = from_or("none", 0.0, 24.0), text("none"),
            "local time of day of an X-Plane, which the Web API of 12.4 sets; \"none\" changes nothing", unit_is("h");
        payload_kg: Option<f64> = from_or("none", 0.0, 1e4), text("none"),
            "payload of an X-Plane's aircraft when it is placed, which the Web API of 12.4 sets; \"none\" leaves it to X-Plane",
            unit_is("kg");
        fuel_kg: Option<f64> = from_or("none", 0.0, 1e4), text("none"),
            "fuel in the first tank of an X-Plane's aircraft when it is placed, which the Web API of 12.4 sets; \"none\" leaves it to X-Plane",
            unit_is("kg");
        /// Limits and lags of a point mass.
        point_mass: PointMassLimits;
    }
}

/// The vehicle that the built-in plant simulates, `plant.model`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModelKind {
    /// The helicopter of the aircraft file.
    Helicopter,
    /// A point that follows commanded velocities.
    PointMass,
}

keys! {
    /// Limits and lags of a point mass, `[plant.point_mass]`.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct PointMassLimits at "plant.point_mass." {
        max_speed_m_s: f64 = above_zero(100.0), number(10.0),
            "largest horizontal speed of a point mass; 10 m/s are above the 7.5 m/s that a formation commands beside its centre's speed";
        max_climb_m_s: f64 = above_zero(50.0), number(2.5),
            "largest climb rate and sink rate of a point mass; the built-in helicopter's controllers command 2.5 m/s";
        max_acceleration_m_s2: Option<f64> = above_zero_or("none", 1e3), number(3.0),
            "largest acceleration of a point mass, horizontal and vertical each; 3 m/s2 are a helicopter's at a lean of 17 degrees";
        lag_s: f64 = from(0.0, 10.0), number(1.0),
            "time constant of a point mass's velocity; 1 s is the helicopter's lag. 0 with max_acceleration_m_s2 = \"none\" is a single integrator";
        max_turn_deg_s: f64 = above_zero(720.0), number(60.0),
            "largest heading rate of a point mass";
        turn_lag_s: f64 = from(0.0, 10.0), number(0.2),
            "time constant of a point mass's heading rate; the helicopter's gyro needs less";
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
