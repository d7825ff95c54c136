//! A plant that Skein does not have: a kite inside the agent, a point that follows velocities.
//!
//! The book's page "Extend Skein" adds it with this file as `agent/src/plant/kite.rs`.

use std::time::{Duration, Instant};

use skein_common::frame::Origin;
use skein_core::helicopter::TICK_S;
use skein_core::plant::{Command, Plant, Wake};
use skein_core::point_mass::PointMass;
use skein_core::start::starts;
use skein_host::clock::{now, sleep_until};

use super::{PlantError, PlantVehicle};

/// The kite, at most one tick behind the clock.
pub(super) struct Kite {
    point: PointMass,
    command: Option<Command>,
    ticked: Instant,
}

/// A kite at the vehicle's start.
pub(super) fn open(vehicle: &PlantVehicle<'_>) -> Result<Kite, PlantError> {
    let starts = starts(vehicle.scenario).map_err(PlantError::StartArea)?;
    let origin = Origin::new(vehicle.scenario.origin.geodetic());
    let start = &starts[usize::from(vehicle.id.get()) - 1];
    Ok(Kite { point: PointMass::new(&origin, &vehicle.scenario.plant.point_mass, start), command: None, ticked: now() })
}

impl Plant for Kite {
    fn wait(&mut self, timeout: Duration) -> Wake {
        let (deadline, tick_at) = (now() + timeout, self.ticked + Duration::from_secs_f64(TICK_S));
        sleep_until(tick_at.min(deadline));
        if tick_at > deadline {
            return Wake::default();
        }
        self.ticked = tick_at.max(now() - Duration::from_secs_f64(TICK_S));
        self.point.advance(self.command.and_then(Command::velocity));
        Wake { frame: Some(self.point.frame()), ..Wake::default() }
    }

    fn command(&mut self, command: Command) {
        self.command = Some(command);
    }

    fn release(&mut self) {
        self.command = None;
    }

    fn frame_period_s(&self) -> f64 {
        TICK_S
    }
}
