//! A complete vehicle: the helicopter, the air around it and its measurements.

use skein_common::frame::{Convergence, Geodetic, Origin, VelocityNed};
use skein_common::id::VehicleId;
use skein_common::time::PlantTime;

use super::wind::{LocalWind, Weather};
use super::{Failures, Helicopter, Parameters, TICK_S};
use crate::plant::{Controls, Frame, GroundTruth, Measurement};
use crate::random::{self, Purpose};

/// Initial place of a vehicle on flat ground at the height of the swarm's origin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Start {
    /// North of the origin, m.
    pub north_m: f64,
    /// East of the origin, m.
    pub east_m: f64,
    /// Heading clockwise from north, rad.
    pub heading_rad: f64,
}

/// The built-in helicopter with its weather, as flown by a study, an agent without a simulator, and the X-Plane
/// stand-in.
#[derive(Clone, Debug)]
pub struct BuiltInVehicle {
    origin: Origin,
    pub(super) helicopter: Helicopter,
    air: LocalWind,
    ticks: u64,
    /// The last valid controls; `None` before the first.
    controls: Option<Controls>,
    failures: Failures,
    /// The position that is measured while the position is frozen, with the convergence there.
    frozen: Option<(Geodetic, Convergence)>,
}

impl BuiltInVehicle {
    /// A vehicle at rest at its start, rotor at speed. `seed` and `vehicle` determine its gusts.
    pub fn new(
        origin: &Origin,
        parameters: &Parameters,
        start: &Start,
        weather: &Weather,
        seed: u64,
        vehicle: VehicleId,
    ) -> Self {
        Self {
            origin: *origin,
            helicopter: Helicopter::at_rest(parameters, start.north_m, start.east_m, 0.0, start.heading_rad),
            air: LocalWind::new(weather, random::generator(seed, Some(vehicle), Purpose::Wind)),
            ticks: 0,
            controls: None,
            failures: Failures::default(),
            frozen: None,
        }
    }

    /// The current frame. The measurement is exact unless a failure changes it.
    pub fn frame(&self) -> Frame {
        let helicopter = &self.helicopter;
        let (position, attitude) = (helicopter.position(), helicopter.attitude());
        let (velocity, height_m) = (helicopter.velocity(), helicopter.height_m());
        let (measured, convergence) = self.frozen.unwrap_or_else(|| self.origin.place(position));
        Frame {
            time: PlantTime::from_seconds(self.ticks as f64 * TICK_S),
            measurement: Measurement {
                position: measured,
                height_m,
                velocity: convergence.velocity_to_local(velocity),
                attitude: convergence.attitude_to_local(attitude),
                rates: helicopter.rates(),
                rotor_speed_rad_s: Some(helicopter.rotor_speed_rad_s()),
            },
            truth: GroundTruth { position, height_m, velocity, attitude, power_w: Some(helicopter.power_w()) },
        }
    }

    /// Advances by one tick. `None` keeps the last controls. Before the first controls the vehicle is held on the
    /// ground and only time passes: otherwise the gyro's integral would wind up against the ground and the heading
    /// would swing at lift-off. Controls that are not finite are ignored, and values beyond the travel are clamped.
    pub fn advance(&mut self, controls: Option<Controls>) {
        if let Some((controls, wind)) = self.begin_tick(controls) {
            self.helicopter.advance(&controls, wind);
        }
    }

    /// Begins one tick: the controls and the wind with which the helicopter flies it; `None` while it is held on the
    /// ground.
    pub(super) fn begin_tick(&mut self, controls: Option<Controls>) -> Option<(Controls, VelocityNed)> {
        self.ticks += 1;
        self.controls = controls.filter(is_finite).or(self.controls);
        Some((self.controls?, self.air.advance(self.helicopter.height_m())))
    }

    /// From now on this weather prevails; the gusts continue from where they are.
    pub fn set_weather(&mut self, weather: &Weather) {
        self.air.set_weather(weather);
    }

    /// From now on exactly these failures are present; all others are cured.
    pub fn fail(&mut self, failures: Failures) {
        if failures == self.failures {
            return;
        }
        self.frozen = failures
            .position_frozen
            .then(|| self.frozen.unwrap_or_else(|| self.origin.place(self.helicopter.position())));
        self.helicopter.fail(&failures);
        self.failures = failures;
    }

    /// The failures present.
    pub fn failures(&self) -> Failures {
        self.failures
    }
}

fn is_finite(controls: &Controls) -> bool {
    [controls.roll, controls.pitch, controls.yaw, controls.collective].iter().all(|deflection| deflection.is_finite())
}

#[cfg(test)]
mod tests;
