//! Plants in real time: the built-in helicopter, paced by this PC's clock, and X-Plane over UDP.

pub mod builtin;
pub mod xplane;

use std::error::Error;
use std::io;
use std::net::SocketAddr;

use skein_common::id::VehicleId;
use skein_common::scenario::{ModelKind, PlantKind, Scenario};
use skein_core::aircraft::Aircraft;
use skein_core::builtin::BuiltInPlant;
use skein_core::control::Rules;
use skein_core::plant::Plant;
use skein_core::start::StartAreaTooSmall;

/// The vehicle for which a plant is opened.
#[derive(Clone, Copy, Debug)]
pub struct PlantVehicle<'a> {
    /// The scenario that it flies.
    pub scenario: &'a Scenario,
    /// Its id.
    pub id: VehicleId,
    /// Its aircraft.
    pub aircraft: &'a Aircraft,
    /// The rules of its controller.
    pub rules: &'a Rules,
    /// Time for which an earlier agent has flown it, s; `None` if it has not flown.
    pub flown_s: Option<f64>,
}

/// The reason why a plant cannot fly a vehicle. Each error is one sentence that the user can act on.
#[derive(Debug, thiserror::Error)]
pub enum PlantError {
    /// Only X-Plane can fly this aircraft.
    #[error("the aircraft {0} has no [helicopter] table, which the built-in plant needs")]
    NoModel(String),
    /// The scenario's model does not fly in this plant.
    #[error(
        "vehicle {0}: `plant.model` = \"{name}\" flies in {plants} only: remove the node's plant and the address of its X-Plane",
        name = .1.name(),
        plants = PlantKind::flown_by(*.1).map(|plant| plant.title).collect::<Vec<_>>().join(" and ")
    )]
    OtherModel(VehicleId, ModelKind),
    /// The plant takes another kind of command than the scenario's, for which the controller is made.
    #[error("vehicle {0}: its plant takes other commands than the scenario's `swarm.plant`: let the two be the same")]
    OtherCommands(VehicleId),
    /// The vehicles do not fit into the start area.
    #[error(transparent)]
    StartArea(StartAreaTooSmall),
    /// The computer lacks what the plant needs, such as a free port.
    #[error(transparent)]
    Open(Box<dyn Error + Send + Sync>),
    /// The simulator's address cannot be resolved.
    #[error("{0:?} is not the address HOST[:PORT] of a simulator: {1}")]
    Address(String, #[source] io::Error),
}

/// The plant that flies a vehicle.
#[derive(Clone, Debug)]
pub enum PlantChoice {
    /// The built-in vehicle in this process.
    BuiltIn(Box<BuiltInPlant>),
    /// A stand-in with X-Plane's protocol, at this address.
    Standin(SocketAddr),
    /// An X-Plane at this address, or else on this computer.
    XPlane(Option<SocketAddr>),
}

impl PlantChoice {
    /// The plant of this kind for a vehicle. `address` is that of its simulator, `HOST[:PORT]`, if the node gives one: it
    /// then flies in X-Plane even where the scenario has the built-in plant.
    ///
    /// # Errors
    /// If a plant of this kind cannot fly the vehicle, or the address cannot be resolved.
    pub fn new(kind: PlantKind, address: Option<&str>, vehicle: &PlantVehicle<'_>) -> Result<Self, PlantError> {
        let &PlantVehicle { scenario, id, .. } = vehicle;
        let kind = if address.is_some() && !kind.spec().has_address() { PlantKind::Xplane } else { kind };
        // The controller is made from the scenario, which every vehicle has alike.
        let command = |kind: PlantKind| kind.spec().command_for(scenario.plant.model);
        match command(kind) {
            None => return Err(PlantError::OtherModel(id, scenario.plant.model)),
            taken if taken != command(scenario.swarm.plant) => return Err(PlantError::OtherCommands(id)),
            _ => {}
        }
        let address = || {
            let of_scenario = || scenario.vehicle(id).and_then(|vehicle| vehicle.xplane.as_deref());
            address.or_else(of_scenario).map(xplane::simulator).transpose()
        };
        Ok(match kind {
            PlantKind::Builtin => Self::BuiltIn(Box::new(builtin::at_start(vehicle)?)),
            PlantKind::Standin => Self::Standin(address()?.unwrap_or_else(|| xplane::default_address(id))),
            PlantKind::Xplane => Self::XPlane(address()?),
        })
    }

    /// The kind of this plant.
    pub fn kind(&self) -> PlantKind {
        match self {
            Self::BuiltIn(_) => PlantKind::Builtin,
            Self::Standin(_) => PlantKind::Standin,
            Self::XPlane(_) => PlantKind::Xplane,
        }
    }

    /// Opens the plant. It touches no simulator before its first frame.
    ///
    /// # Errors
    /// If what the plant needs of this computer, such as a socket for the simulator, cannot be had.
    pub fn open(&self, vehicle: &PlantVehicle<'_>) -> Result<Box<dyn Plant>, PlantError> {
        Ok(match self {
            Self::BuiltIn(built_in) => Box::new(builtin::open(built_in, vehicle)),
            Self::Standin(address) => xplane::open(Some(*address), vehicle)?,
            Self::XPlane(address) => xplane::open(*address, vehicle)?,
        })
    }
}
