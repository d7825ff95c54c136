//! A helicopter of the built-in model, flown by the vehicle controller straight to its target, with a diagnosis.

use nalgebra::Vector2;
use skein_common::frame::{Geodetic, Origin};
use skein_common::id::VehicleId;
use skein_common::message::Failure;
use skein_common::scenario::{PositionSensing, VelocitySensing};
use skein_common::time::{LocalTime, Now, PlantTime};

use crate::aircraft::Aircraft;
use crate::control::{Rules, VehicleController};
use crate::diagnosis::Diagnosis;
use crate::estimate::{Estimate, Estimator};
use crate::helicopter::{BuiltInVehicle, Failures, Start, TICK_S, Weather};
use crate::plant::{Controls, GroundTruth};
use crate::setpoint::{Setpoint, VELOCITY_PER_ERROR_PER_S};
use crate::tests::sensing_without_errors;

/// The sensing of a vehicle.
#[derive(Clone, Copy, Debug)]
pub(super) enum FlightSensing {
    Exact,
    /// Sensing as in Garcia & Barnes 2010.
    Paper,
}

/// Largest position error passed to the controller, as in the formation's conversion, m.
const FARTHEST_M: f64 = 28.0;

#[derive(Clone)]
pub(super) struct Flight {
    pub(super) vehicle: BuiltInVehicle,
    estimator: Estimator,
    pub(super) controller: VehicleController,
    pub(super) diagnosis: Diagnosis,
    pub(super) command: Option<Controls>,
    time_s: f64,
    /// Time of the last measurement.
    measured_s: f64,
    /// Target position, north and east, and its velocity.
    pub(super) place_ne_m: Vector2<f64>,
    pub(super) moves_ne_m_s: Vector2<f64>,
    pub(super) altitude_m: f64,
    pub(super) heading_rad: f64,
    /// Failures found, with their times.
    pub(super) found: Vec<(f64, Failure)>,
}

impl Flight {
    /// A helicopter on the ground with the command to hover at 30 m. The seed sets the direction of wind and gusts.
    pub(super) fn new(senses: FlightSensing, wind_m_s: f64, gust_w20_m_s: f64, seed: u64) -> Self {
        let aircraft = Aircraft::shipped("xcell60").unwrap().unwrap();
        let parameters = aircraft.helicopter.as_ref().unwrap();
        let origin = Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0));
        let weather = Weather { wind_m_s, wind_from_rad: seed as f64, gust_w20_m_s };
        let (position, velocity) = match senses {
            FlightSensing::Exact => (PositionSensing::Exact, VelocitySensing::Measured),
            FlightSensing::Paper => (PositionSensing::F32Latlon, VelocitySensing::Differenced),
        };
        let heading_rad = 0.7 * seed as f64;
        let start = Start { heading_rad, ..Start::default() };
        let id = VehicleId::new(1).unwrap();
        Self {
            vehicle: BuiltInVehicle::new(&origin, parameters, &start, &weather, seed, id),
            estimator: Estimator::new(origin, &sensing_without_errors(position, velocity)),
            controller: VehicleController::new(Rules::shipped(), aircraft.trim, aircraft.gains, true),
            diagnosis: Diagnosis::new(&super::scenario(), &aircraft),
            command: None,
            time_s: 0.0,
            measured_s: -TICK_S,
            place_ne_m: Vector2::zeros(),
            moves_ne_m_s: Vector2::zeros(),
            altitude_m: 30.0,
            heading_rad,
            found: Vec::new(),
        }
    }

    /// The current estimate, after the diagnosis has evaluated the measurement.
    pub(super) fn estimate(&mut self) -> Estimate {
        let frame = self.vehicle.frame();
        let now = Now { plant: PlantTime::from_seconds(self.time_s), local: LocalTime::from_seconds(self.time_s) };
        let estimate = self.estimator.update(now, Some(&frame.measurement)).unwrap();
        let dt_s = self.time_s - self.measured_s;
        self.measured_s = self.time_s;
        if let Some(failure) = self.diagnosis.update(dt_s, &frame.measurement, self.command) {
            self.found.push((self.time_s, failure));
        }
        estimate
    }

    /// The setpoint towards the target.
    pub(super) fn setpoint(&self, estimate: &Estimate) -> Setpoint {
        let error_ne_m = (self.place_ne_m - estimate.position.horizontal()).cap_magnitude(FARTHEST_M);
        let relative_velocity_ne_m_s = error_ne_m * VELOCITY_PER_ERROR_PER_S;
        let Self { moves_ne_m_s: feedforward_ne_m_s, altitude_m, heading_rad, .. } = *self;
        Setpoint { relative_velocity_ne_m_s, feedforward_ne_m_s, altitude_m, heading_rad }
    }

    /// Commands these controls and advances by one tick.
    pub(super) fn advance(&mut self, controls: Controls) {
        self.command = Some(controls);
        self.fly_with(controls);
    }

    /// Advances by one tick in which these controls reach the vehicle.
    pub(super) fn fly_with(&mut self, controls: Controls) {
        self.vehicle.advance(Some(controls));
        self.time_s += TICK_S;
        self.place_ne_m += self.moves_ne_m_s * TICK_S;
    }

    pub(super) fn fly(&mut self, seconds: f64) {
        for _ in 0..(seconds / TICK_S).round() as u32 {
            let controls = self.decide(TICK_S);
            self.advance(controls);
        }
    }

    /// Commands the controls that follow from the current estimate.
    pub(super) fn decide(&mut self, dt_s: f64) -> Controls {
        let estimate = self.estimate();
        let controls = self.controller.step(dt_s, &estimate, &self.setpoint(&estimate)).controls;
        self.command = Some(controls);
        controls
    }

    /// Moves the target to the estimated position.
    pub(super) fn stop_here(&mut self) {
        let estimate = self.estimate();
        self.place_ne_m = estimate.position.horizontal();
        self.altitude_m = estimate.position.altitude_m();
        self.moves_ne_m_s = Vector2::zeros();
    }

    /// Descends at 2 m/s and finally at 0.7 m/s until the helicopter is on the ground.
    pub(super) fn land(&mut self) {
        let until_s = self.time_s + 120.0;
        while self.truth().height_m > 0.26 {
            assert!(self.time_s < until_s, "the helicopter does not reach the ground: {:?}", self.truth());
            let sink_m_s = if self.truth().height_m > 6.0 { 2.0 } else { 0.7 };
            let lowest_m = self.truth().position.altitude_m() - 3.0;
            self.altitude_m = (self.altitude_m - sink_m_s * TICK_S).max(lowest_m);
            self.fly(TICK_S);
        }
        self.fly(1.0);
    }

    pub(super) fn dead_reckon(&mut self) {
        self.estimator.dead_reckon();
    }

    pub(super) fn fail(&mut self, failures: Failures) {
        self.vehicle.fail(failures);
    }

    pub(super) fn time_s(&self) -> f64 {
        self.time_s
    }

    pub(super) fn truth(&self) -> GroundTruth {
        self.vehicle.frame().truth
    }
}
