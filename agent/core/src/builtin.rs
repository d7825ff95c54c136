//! The built-in plant: the vehicle that a study, or an agent without a simulator, flies.

use alloc::boxed::Box;

use skein_common::frame::Origin;
use skein_common::id::VehicleId;
use skein_common::scenario::{ModelKind, Scenario};

use crate::aircraft::Aircraft;
use crate::helicopter::{BuiltInVehicle, Failures, Start, Weather};
use crate::plant::{Command, Frame};
use crate::point_mass::PointMass;

/// The aircraft file has no `[helicopter]` table, so that only X-Plane can fly the aircraft.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the aircraft has no [helicopter] table")]
pub struct NoFlightModel;

/// A vehicle of the built-in plant, of the kind that the scenario's `plant.model` names.
#[derive(Clone, Debug)]
pub enum BuiltInPlant {
    /// A helicopter with its weather.
    Helicopter(Box<BuiltInVehicle>),
    /// A point that follows velocities.
    PointMass(Box<PointMass>),
}

impl BuiltInPlant {
    /// Vehicle `own` of a scenario, at rest at its start.
    ///
    /// # Errors
    /// A helicopter whose aircraft has no flight model.
    pub fn new(scenario: &Scenario, own: VehicleId, aircraft: &Aircraft, start: &Start) -> Result<Self, NoFlightModel> {
        let origin = Origin::new(scenario.origin.geodetic());
        Ok(match scenario.plant.model {
            ModelKind::Helicopter => {
                let parameters = aircraft.helicopter.as_ref().ok_or(NoFlightModel)?;
                let weather = Weather::from(&scenario.world);
                let vehicle = BuiltInVehicle::new(&origin, parameters, start, &weather, scenario.seed, own);
                Self::Helicopter(Box::new(vehicle))
            }
            ModelKind::PointMass => {
                Self::PointMass(Box::new(PointMass::new(&origin, &scenario.plant.point_mass, start)))
            }
        })
    }

    /// The current frame. The measurement is exact unless a failure changes it.
    pub fn frame(&self) -> Frame {
        match self {
            Self::Helicopter(vehicle) => vehicle.frame(),
            Self::PointMass(point) => point.frame(),
        }
    }

    /// Advances by one tick of 20 ms. `None`, and a command of the other kind of vehicle, keep the last command.
    pub fn advance(&mut self, command: Option<Command>) {
        match self {
            Self::Helicopter(vehicle) => vehicle.advance(command.and_then(Command::controls)),
            Self::PointMass(point) => point.advance(command.and_then(Command::velocity)),
        }
    }

    /// From now on exactly these failures are present; all others are cured.
    pub fn fail(&mut self, failures: Failures) {
        match self {
            Self::Helicopter(vehicle) => vehicle.fail(failures),
            Self::PointMass(point) => point.fail(failures),
        }
    }
}
