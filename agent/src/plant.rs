//! Plants in real time: the built-in helicopter, paced by this PC's clock, and X-Plane over UDP.

pub mod builtin;
mod vehicle;
pub mod xplane;

use std::net::SocketAddr;

use skein_common::scenario::PlantKind;
use skein_core::builtin::BuiltInPlant;
use skein_core::plant::Plant;

pub use vehicle::{PlantError, PlantVehicle};

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
            None => return Err(PlantError::OtherModel { id, model: scenario.plant.model }),
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
