//! The vehicle that a plant flies, as plants need it.

use std::io;

use skein_common::id::VehicleId;
use skein_common::scenario::Scenario;
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
    /// A point mass flies in the built-in plant only.
    #[error(
        "vehicle {0}: `plant.model` = \"point_mass\" flies in the built-in plant only: remove the node's plant and the \
         address of its X-Plane"
    )]
    PointMassInXPlane(VehicleId),
    /// The vehicles do not fit into the start area.
    #[error(transparent)]
    StartArea(StartAreaTooSmall),
    /// The simulator's address cannot be resolved.
    #[error("{text:?} is not the address HOST[:PORT] of a simulator: {source}")]
    Address {
        /// The text given.
        text: String,
        /// The system's error.
        source: io::Error,
    },
}
