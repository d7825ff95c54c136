//! Flight under the rules with what is known so far; lift-off and landing.

use nalgebra::Vector2;

use super::{FitError, Fitted, Verdict};
use crate::control::{Rules, VehicleController};
use crate::estimate::Estimate;
use crate::plant::Controls;
use crate::setpoint::Setpoint;

/// Height of the hover above standing, m.
pub(super) const HOVER_M: f64 = 6.0;
/// Velocity commanded per metre to the goal, 1/s, and at most, m/s.
const HOLD_PER_S: f64 = 0.35;
const HOLD_M_S: f64 = 1.2;
/// Rise of the collective until lift-off, 1/s, and the heights above standing at which the vehicle no longer stands and
/// at which it flies, m.
const RISE_PER_S: f64 = 0.05;
const LIFTED_M: f64 = 0.05;
const FLIES_FROM_M: f64 = 0.4;
/// Speed of the descent, m/s, and its last metre.
const DESCENT_M_S: f64 = 0.8;
const LAST_DESCENT_M_S: f64 = 0.3;
/// Largest distance of the altitude's goal below a vehicle that sinks, and below one that does not, m; speed of descent from which
/// a vehicle counts as sinking, m/s.
const AHEAD_M: f64 = 2.0;
const FAR_AHEAD_M: f64 = 12.0;
const SINKS_FROM_M_S: f64 = 0.2;
/// Height above standing at which the vehicle counts as down, m, and how long it takes to take off the load, s.
const DOWN_M: f64 = 0.08;
const UNLOAD_S: f64 = 2.0;

/// A vehicle flown by the rules about one place.
#[derive(Clone, Debug)]
pub(super) struct Flying {
    rules: Rules,
    controller: VehicleController,
    /// The place to hold, north and east, m, and its altitude above the origin, m.
    pub(super) place_ne_m: Vector2<f64>,
    pub(super) altitude_m: f64,
    /// Time on the ground after a landing, s.
    down_s: f64,
}

impl Flying {
    pub(super) fn new(rules: Rules, found: &Fitted, estimate: &Estimate) -> Self {
        let controller = VehicleController::new(rules.clone(), found.trim, found.gains, true);
        let ground_m = estimate.position.altitude_m() - estimate.height_m;
        let place_ne_m = estimate.position.horizontal();
        let altitude_m = ground_m + found.standing_m + HOVER_M;
        Self { rules, controller, place_ne_m, altitude_m, down_s: 0.0 }
    }

    /// Takes over a trim, or gains, found in flight. The integrals begin anew: the trim contains what they had found.
    pub(super) fn adopt(&mut self, found: &Fitted) {
        self.controller = VehicleController::new(self.rules.clone(), found.trim, found.gains, true);
    }

    /// The controls that hold place and altitude.
    pub(super) fn hold(&mut self, dt_s: f64, estimate: &Estimate, found: &Fitted) -> Controls {
        let error_ne_m = self.place_ne_m - estimate.position.horizontal();
        self.command(dt_s, estimate, found, (error_ne_m * HOLD_PER_S).cap_magnitude(HOLD_M_S))
    }

    /// The controls for this velocity, north and east, m/s.
    pub(super) fn command(
        &mut self,
        dt_s: f64,
        estimate: &Estimate,
        found: &Fitted,
        relative_velocity_ne_m_s: Vector2<f64>,
    ) -> Controls {
        let setpoint = Setpoint {
            relative_velocity_ne_m_s,
            feedforward_ne_m_s: Vector2::zeros(),
            altitude_m: self.altitude_m,
            heading_rad: found.heading_rad,
        };
        self.controller.step(dt_s, estimate, &setpoint).controls
    }

    /// Descends where the vehicle is, then takes the load off.
    pub(super) fn land(&mut self, dt_s: f64, estimate: &Estimate, found: &Fitted) -> Verdict {
        let above_m = estimate.height_m - found.standing_m;
        if above_m < DOWN_M {
            self.down_s += dt_s;
            let controls = self.controller.unload(dt_s);
            return if self.down_s > UNLOAD_S { Verdict::Done(controls) } else { Verdict::Goes(controls) };
        }
        if self.down_s > 0.0 {
            return Verdict::Goes(self.controller.unload(dt_s));
        }
        let descent_m_s = if above_m > 1.0 { DESCENT_M_S } else { LAST_DESCENT_M_S };
        // The goal sinks ahead of the vehicle: not so far that the rules hurry, but the air that the ground holds up must
        // not carry the vehicle.
        let sinks = estimate.velocity.down_m_s() > SINKS_FROM_M_S;
        let lowest_m = estimate.position.altitude_m() - if sinks { AHEAD_M } else { FAR_AHEAD_M };
        self.altitude_m = (self.altitude_m - descent_m_s * dt_s).max(lowest_m);
        let standing = Vector2::zeros();
        let controls = if above_m > 2.0 {
            self.hold(dt_s, estimate, found)
        } else {
            self.command(dt_s, estimate, found, standing)
        };
        Verdict::Goes(controls)
    }
}

/// Raises the collective until the vehicle lifts off.
#[derive(Clone, Debug)]
pub(super) struct Lifting {
    pub(super) flying: Flying,
    collective: f64,
    /// The collective at which the vehicle left the ground.
    lifted: Option<f64>,
}

impl Lifting {
    pub(super) fn new(flying: Flying, collective: f64) -> Self {
        Self { flying, collective, lifted: None }
    }

    pub(super) fn step(&mut self, dt_s: f64, estimate: &Estimate, found: &mut Fitted) -> Verdict {
        let above_m = estimate.height_m - found.standing_m;
        if above_m > LIFTED_M {
            self.lifted.get_or_insert(self.collective);
        } else {
            self.lifted = None;
        }
        // Holds the heading and an upright attitude; there is no place to hold before the vehicle flies.
        self.flying.place_ne_m = estimate.position.horizontal();
        let controls = Controls { collective: self.collective, ..self.flying.hold(dt_s, estimate, found) };
        if above_m > FLIES_FROM_M {
            found.trim.collective = self.lifted.unwrap_or(self.collective);
            return Verdict::Done(controls);
        }
        if self.collective >= 1.0 && self.lifted.is_none() {
            return Verdict::Fails(FitError::NoLift);
        }
        self.collective = (self.collective + RISE_PER_S * dt_s).min(1.0);
        Verdict::Goes(controls)
    }
}
