//! The vehicle that a plant flies, as plants need it.

use std::error::Error;
use std::io;

use skein_common::id::VehicleId;
use skein_common::scenario::{ModelKind, PlantKind, Scenario};
use skein_core::aircraft::Aircraft;
use skein_core::control::Rules;
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

/// Why a plant cannot fly a vehicle. Each error is one sentence that the user can act on.
#[derive(Debug, thiserror::Error)]
pub enum PlantError {
    /// Only X-Plane can fly this aircraft.
    #[error("the aircraft {0} has no [helicopter] table, which the built-in plant needs")]
    NoModel(String),
    /// The scenario's model does not fly in this plant.
    #[error(
        "vehicle {id}: `plant.model` = \"{}\" flies in {plants} only: remove the node's plant and the address of its X-Plane",
        model.name(),
        plants = PlantKind::flown_by(*model).map(|plant| plant.title).collect::<Vec<_>>().join(" and ")
    )]
    OtherModel {
        /// The vehicle's id.
        id: VehicleId,
        /// The scenario's model.
        model: ModelKind,
    },
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
