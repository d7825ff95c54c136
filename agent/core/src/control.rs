//! The control stage: converts the formation's setpoint to the vehicle's command.
//!
//! A point mass gets velocities ([`VelocityController`]); [`Controller`] is either. The rest of this module is the
//! [`VehicleController`] of a helicopter. It consists of four independent Sugeno controllers (roll, pitch,
//! heading, collective), as in Garcia & Barnes, "Multi-UAV Simulator Utilizing X-Plane" (2010): constants, product "and",
//! weights of one, weighted average, throttle left to the governor. That paper does not print its rules; those in
//! `deploy/controllers/*.fis` are ours, tuned on the built-in helicopter.
//!
//! Inputs of the rules, in SI units:
//!
//! | rules | inputs | output |
//! | --- | --- | --- |
//! | roll | R_E, velocity to the right, bank above trim | roll control above trim |
//! | pitch | P_E, velocity backwards, pitch above trim | pitch control above trim |
//! | heading | setpoint minus heading, yaw rate | yaw control |
//! | collective | setpoint minus altitude, climb rate | collective above hover |
//!
//! Velocities are over the ground, in the level frame along the heading, minus the feed-forward.
//!
//! The formation commands a velocity, but the rules were written for position errors: R_E and P_E are the errors, m, at
//! which the rules command that velocity. Only this stage uses them ([`Setpoint::error_ne_m`]).

mod axis;
mod fis;
mod gains;
mod membership;
mod stage;
mod sugeno;
mod trim;
mod velocity;

use alloc::format;
use alloc::sync::Arc;
use alloc::vec::Vec;

use nalgebra::Vector2;
use skein_common::frame::{HeadingFrame, wrap_rad};

use crate::estimate::Estimate;
use crate::plant::Controls;
use crate::setpoint::{CollectiveLimit, Setpoint};

pub use fis::FisError;
pub use gains::{Gains, OutOfLimits};
pub use stage::Controller;
pub use sugeno::Sugeno;
pub use trim::{AutoTrim, Trim};
pub use velocity::VelocityController;

/// Longest time step of the integrals, s: after a pause of the plant they do not jump.
const LONGEST_STEP_S: f64 = 0.1;
/// Height of the centre of gravity below which the lateral command is zero, m. It is complete from 2 m higher.
const GATE_FROM_M: f64 = 1.5;
const GATE_OVER_M: f64 = 2.0;

/// Altitude error at which the outermost sets of the collective rules reach their full degree, m. Without auto-trim a
/// healthy vehicle hovers up to 7.6 m off its altitude in 8 m/s of wind: the rules leave an error that grows with
/// airspeed.
const OUTERMOST_ALTITUDE_ERROR_M: f64 = 10.0;

/// Deceleration that the rotor's energy can give a fall without power, m/s², and collective per m/s of excess speed.
/// Tuned on the built-in helicopter: it hits the ground at 7.4 m/s at most, and at 5.5 m/s on average, from 2 to 100 m.
const BRAKING_M_S2: f64 = 7.0;
const BRAKE_PER_M_S: f64 = 2.0;

/// Time over which the controls pass from those of a human pilot to those of the rules, s.
const TRANSFER_S: f64 = 1.0;

/// The output of one control step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlOutput {
    /// The controls, always finite and within their travel.
    pub controls: Controls,
    /// The reason why `controls` repeats the last good command; `None` for a new command.
    pub fault: Option<ControlFault>,
}

/// The reason why a step could not compute new controls.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ControlFault {
    /// The estimate contains an infinite number or NaN.
    #[error("the estimate is not finite")]
    Estimate,
    /// The setpoint contains an infinite number or NaN.
    #[error("the setpoint is not finite")]
    Setpoint,
    /// The time since the last step is infinite or NaN.
    #[error("the time step is not finite")]
    TimeStep,
    /// An input of the rules overflowed.
    #[error("no rule fires")]
    Rules,
}

/// The four rule bases. A clone shares them, so that all vehicles of a process use the same memory.
#[derive(Clone, Debug)]
pub struct Rules {
    /// Inputs R_E (m), velocity to the right (m/s), bank above trim (rad).
    pub roll: Arc<Sugeno>,
    /// Inputs P_E (m), velocity backwards (m/s), pitch above trim (rad).
    pub pitch: Arc<Sugeno>,
    /// Inputs heading error (rad), yaw rate (rad/s).
    pub heading: Arc<Sugeno>,
    /// Inputs altitude error (m), climb rate (m/s).
    pub collective: Arc<Sugeno>,
    /// Unusual features of the files that they were read from, each with its place.
    pub warnings: Arc<[FisError]>,
}

impl Rules {
    /// The rules compiled into the program, `deploy/controllers/*.fis`.
    pub fn shipped() -> Self {
        Self::from_texts([
            ("roll.fis", include_str!("../../../deploy/controllers/roll.fis")),
            ("pitch.fis", include_str!("../../../deploy/controllers/pitch.fis")),
            ("heading.fis", include_str!("../../../deploy/controllers/heading.fis")),
            ("collective.fis", include_str!("../../../deploy/controllers/collective.fis")),
        ])
        // A test loads these compiled-in texts.
        .expect("the shipped rules are well formed")
    }

    /// Reads the roll, pitch, heading and collective rules, in this order, each from its name (for errors) and text.
    ///
    /// # Errors
    ///
    /// The first fault of a text, with its place: it cannot be read, leaves inputs uncovered, has a wrong number of inputs, or
    /// contradicts what the controller does: names, units and order of the inputs, the size of the output, and the sign of
    /// the response.
    pub fn from_texts(files: [(&str, &str); 4]) -> Result<Self, FisError> {
        let mut warnings = Vec::new();
        let mut load = |nth: usize| {
            let (axis, (file, text)) = (&axis::AXES[nth], files[nth]);
            let (rules, fis, places, output) = Sugeno::parse_output(file, text, axis.outputs)?;
            if rules.inputs() != axis.inputs.len() {
                let what = format!("this controller has {} inputs, not {}", axis.inputs.len(), rules.inputs());
                return Err(places.inputs[0].error(file, what));
            }
            warnings.extend(axis::check(axis, file, (&fis, &places, output), &rules)?);
            Ok(Arc::new(rules))
        };
        let (roll, pitch, heading, collective) = (load(0)?, load(1)?, load(2)?, load(3)?);
        Ok(Self { roll, pitch, heading, collective, warnings: warnings.into() })
    }

    /// These rules, but for one axis (0 to 3: roll, pitch, heading, collective) those of `other`.
    pub(crate) fn with_axis_of(&self, axis: usize, other: &Self) -> Self {
        let mut rules = self.clone();
        match axis {
            0 => rules.roll = other.roll.clone(),
            1 => rules.pitch = other.pitch.clone(),
            2 => rules.heading = other.heading.clone(),
            _ => rules.collective = other.collective.clone(),
        }
        rules
    }
}

/// The controller of one vehicle. Call [`VehicleController::step`] once per frame, at about 50 Hz.
#[derive(Clone, Debug)]
pub struct VehicleController {
    rules: Rules,
    trim: Trim,
    gains: Gains,
    /// `None` if auto-trim is off.
    auto_trim: Option<AutoTrim>,
    last: Controls,
    /// The limit of the climb authority at the last step, if it was at one.
    collective_limit: Option<CollectiveLimit>,
    transfer: Option<Transfer>,
}

/// A bumpless transfer: the difference between the pilot's controls and those of the rules at its begin fades out.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Transfer {
    /// It begins with the next step, from these controls.
    From(Controls),
    /// This difference is left for a share of [`TRANSFER_S`], 0 to 1.
    Fading { difference: Controls, left: f64 },
}

impl Transfer {
    /// The controls on the way to those of the rules, and the rest of the transfer `dt_s` later.
    fn step(self, to: Controls, dt_s: f64) -> (Controls, Option<Self>) {
        let (difference, left) = match self {
            Self::From(from) => (combine(from, to, |from, to| from - to), 1.0),
            Self::Fading { difference, left } => (difference, left),
        };
        let left_after = left - dt_s.clamp(0.0, LONGEST_STEP_S) / TRANSFER_S;
        let rest = (left_after > 0.0).then_some(Self::Fading { difference, left: left_after });
        (combine(to, difference, |to, difference| to + left * difference).clamped(), rest)
    }
}

/// Combines two sets of controls axis by axis.
fn combine(one: Controls, other: Controls, with: impl Fn(f64, f64) -> f64) -> Controls {
    Controls {
        roll: with(one.roll, other.roll),
        pitch: with(one.pitch, other.pitch),
        yaw: with(one.yaw, other.yaw),
        collective: with(one.collective, other.collective),
    }
}

impl VehicleController {
    /// A controller that has not commanded anything yet.
    pub fn new(rules: Rules, trim: Trim, gains: Gains, auto_trim: bool) -> Self {
        let auto_trim = auto_trim.then(AutoTrim::default);
        Self { rules, trim, gains, auto_trim, last: trim.controls(), collective_limit: None, transfer: None }
    }

    /// Computes the next controls. `dt_s` is the time since the last step; only auto-trim uses it.
    ///
    /// If an argument is not finite, the step repeats the last controls (before the first step, the trim), freezes all
    /// integrals and reports a fault.
    pub fn step(&mut self, dt_s: f64, estimate: &Estimate, setpoint: &Setpoint) -> ControlOutput {
        let fault = match self.command(dt_s, estimate, setpoint) {
            Ok(controls) => {
                self.last = controls;
                None
            }
            Err(fault) => Some(fault),
        };
        ControlOutput { controls: self.last, fault }
    }

    /// Takes the vehicle over from a human pilot: the integrals begin anew, and the next steps lead from the controls that
    /// the pilot left to those of the rules within a second. Where these are unknown, the rules apply at once.
    pub fn take_over(&mut self, controls: Option<Controls>) {
        self.auto_trim = self.auto_trim.map(|_| AutoTrim::default());
        self.transfer = controls.filter(Controls::is_within_limits).map(Transfer::From);
    }

    /// Cyclic and pedals at trim, collective unchanged: for a vehicle without own data.
    pub fn neutral(&mut self) -> Controls {
        self.last = Controls { collective: self.last.collective, ..self.trim.controls() };
        self.last
    }

    /// Cyclic and pedals centred, collective lowered to zero within a second: for a vehicle on the ground.
    pub fn unload(&mut self, dt_s: f64) -> Controls {
        let taken_out = dt_s.clamp(0.0, LONGEST_STEP_S);
        self.last = Controls { collective: (self.last.collective - taken_out).max(0.0), ..Controls::default() };
        self.last
    }

    /// [`Self::step`] with full pedal, for a vehicle whose roll or pitch servo is stuck. The stuck axis tips the
    /// vehicle over at a steady body rate p. Yawing at a rate r turns that tilt around: it stays at p/r in the body and
    /// has no mean direction. The working axis points in every direction in turn and holds the position.
    pub fn turn(&mut self, dt_s: f64, estimate: &Estimate, setpoint: &Setpoint) -> ControlOutput {
        let controls = self.step(dt_s, estimate, setpoint);
        self.last.yaw = 1.0;
        ControlOutput { controls: self.last, ..controls }
    }

    /// Autorotation, for a vehicle without power: upright, slow over the ground, with low collective so that the air
    /// from below keeps the rotor turning. In the last metres the rotor's energy brakes the fall: the collective rises
    /// above the speed that `BRAKING_M_S2` can stop within the remaining height.
    pub fn autorotate(&mut self, dt_s: f64, estimate: &Estimate, heading_rad: f64) -> ControlOutput {
        let altitude_m = estimate.position.altitude_m();
        let zero = Vector2::zeros();
        let level = Setpoint { relative_velocity_ne_m_s: zero, feedforward_ne_m_s: zero, altitude_m, heading_rad };
        let controls = self.step(dt_s, estimate, &level);
        if controls.fault.is_none() {
            let stops_from_m_s = (2.0 * BRAKING_M_S2 * estimate.height_m.max(0.0)).sqrt();
            let brake = self.gains.collective * BRAKE_PER_M_S * (-climb_m_s(estimate) - stops_from_m_s);
            self.last.collective = (self.trim.controls().collective + brake).clamp(0.0, 1.0);
        }
        ControlOutput { controls: self.last, ..controls }
    }

    fn command(&mut self, dt_s: f64, estimate: &Estimate, setpoint: &Setpoint) -> Result<Controls, ControlFault> {
        check(dt_s, estimate, setpoint)?;
        let found = self.auto_trim.unwrap_or_default();
        let gate = gate(estimate.height_m);
        let gated = Setpoint {
            relative_velocity_ne_m_s: setpoint.relative_velocity_ne_m_s * gate,
            feedforward_ne_m_s: setpoint.feedforward_ne_m_s * gate,
            ..*setpoint
        };
        let by_rules = self.controls(estimate, &gated, &found).ok_or(ControlFault::Rules)?;
        let controls = match self.transfer.take() {
            Some(transfer) => {
                let (controls, rest) = transfer.step(by_rules, dt_s);
                self.transfer = rest;
                controls
            }
            None => by_rules,
        };
        if let Some(auto_trim) = &mut self.auto_trim
            && gate >= 1.0
        {
            auto_trim.step(dt_s.clamp(0.0, LONGEST_STEP_S), estimate, &gated);
        }
        self.collective_limit = self.limit_of(&controls, estimate, &gated);
        Ok(controls)
    }

    /// The collective limit: the end of the control's travel, the end of the integral's range, or an altitude error at
    /// which the rules give their maximum. A vehicle on the ground with a command to climb is at its highest limit.
    fn limit_of(&self, controls: &Controls, estimate: &Estimate, setpoint: &Setpoint) -> Option<CollectiveLimit> {
        let gate = gate(estimate.height_m);
        let altitude_error_m = setpoint.altitude_m - estimate.position.altitude_m();
        if gate == 0.0 && altitude_error_m > 0.0 {
            return Some(CollectiveLimit::Highest);
        }
        let of_integral = self.auto_trim.filter(|_| gate >= 1.0).and_then(|auto_trim| auto_trim.collective_limit());
        let full_m = if self.auto_trim.is_some() { trim::FASTEST_CLIMB_ERROR_M } else { OUTERMOST_ALTITUDE_ERROR_M };
        of_integral
            .or_else(|| CollectiveLimit::of(altitude_error_m, -full_m, full_m))
            .or_else(|| CollectiveLimit::of(controls.collective, 0.0, 1.0))
    }

    /// Evaluates the four rule bases; `None` if a number overflows.
    fn controls(&self, estimate: &Estimate, setpoint: &Setpoint, found: &AutoTrim) -> Option<Controls> {
        let heading_rad = estimate.attitude.heading_rad;
        let frame = HeadingFrame::new(heading_rad);
        let [pitch_error_m, roll_error_m] = pseudo_errors(setpoint.error_ne_m(), &frame);
        let velocity = frame.from_ne(estimate.velocity.horizontal() - setpoint.feedforward_ne_m_s);
        let tilt = frame.from_ne(found.tilt_ne_rad);
        // A forward tilt is a negative pitch.
        let roll_rad = estimate.attitude.roll_rad - self.trim.roll_rad - tilt.y;
        let pitch_rad = estimate.attitude.pitch_rad - self.trim.pitch_rad + tilt.x;
        let heading_error_rad = wrap_rad(setpoint.heading_rad - heading_rad);
        let altitude_error_m = setpoint.altitude_m - estimate.position.altitude_m();

        let roll = self.rules.roll.evaluate(&[roll_error_m, velocity.y, roll_rad])?;
        let pitch = self.rules.pitch.evaluate(&[pitch_error_m, -velocity.x, pitch_rad])?;
        let yaw = self.rules.heading.evaluate(&[heading_error_rad, estimate.rates.yaw_rad_s])?;
        let collective = self.rules.collective.evaluate(&[altitude_error_m, climb_m_s(estimate)])?;
        let (trim, gains) = (self.trim.controls(), &self.gains);
        let by_rules = Controls {
            roll: trim.roll + gains.roll * roll,
            pitch: trim.pitch + gains.pitch * pitch,
            yaw: trim.yaw + gains.yaw * yaw,
            collective: trim.collective + found.collective + gains.collective * collective,
        };
        Some(by_rules.clamped())
    }
}

fn check(dt_s: f64, estimate: &Estimate, setpoint: &Setpoint) -> Result<(), ControlFault> {
    let Estimate { position, height_m, velocity, attitude, rates, .. } = estimate;
    let Setpoint { relative_velocity_ne_m_s, feedforward_ne_m_s, altitude_m, heading_rad } = setpoint;
    let place_is_finite = position.is_finite() && height_m.is_finite() && velocity.is_finite();
    let [relative, feedforward] =
        [relative_velocity_ne_m_s, feedforward_ne_m_s].map(|velocity| velocity.x.is_finite() && velocity.y.is_finite());
    if !(place_is_finite && attitude.is_finite() && rates.is_finite()) {
        Err(ControlFault::Estimate)
    } else if !(relative && feedforward && altitude_m.is_finite() && heading_rad.is_finite()) {
        Err(ControlFault::Setpoint)
    } else if !dt_s.is_finite() {
        Err(ControlFault::TimeStep)
    } else {
        Ok(())
    }
}

/// The position errors P_E and R_E, Garcia & Barnes eqs (10) and (11), of a field vector in metres:
/// P_E = −(V_x cos ψ + V_y sin ψ), R_E = −V_x sin ψ + V_y cos ψ. Nose-up accelerates backwards, right bank accelerates
/// right: with these signs a positive error gives a positive control on both axes.
fn pseudo_errors(error_ne_m: Vector2<f64>, frame: &HeadingFrame) -> [f64; 2] {
    let error = frame.from_ne(error_ne_m);
    [-error.x, error.y]
}

/// Share of the lateral command that is used at this height, 0 to 1.
fn gate(height_m: f64) -> f64 {
    ((height_m - GATE_FROM_M) / GATE_OVER_M).clamp(0.0, 1.0)
}

fn climb_m_s(estimate: &Estimate) -> f64 {
    -estimate.velocity.down_m_s()
}

#[cfg(test)]
mod tests;
