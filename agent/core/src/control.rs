//! The vehicle controller: from where the formation wants this helicopter to what the sticks do.
//!
//! Four independent zero-order Sugeno controllers, roll, pitch, heading and collective, as in Garcia & Barnes, "Multi-UAV
//! Simulator Utilizing X-Plane" (2010): product "and", weights of one, weighted average, throttle left to the governor.
//! That paper does not print its rules; those in `deploy/controllers/*.fis` are ours, found on the built-in helicopter.
//!
//! Inputs of the rules, SI:
//!
//! | rules | inputs | output |
//! | --- | --- | --- |
//! | roll | R_E, velocity to the right, bank above trim | stick above trim |
//! | pitch | P_E, velocity backwards, pitch above trim | stick above trim |
//! | heading | set-point minus heading, yaw rate | stick |
//! | collective | set-point minus altitude, climb rate | stick above hover |
//!
//! Velocities are over the ground, in the level frame that points along the heading, less the feed-forward.
//!
//! The formation asks for a velocity. The rules were written for position errors: R_E and P_E are the metres of error at which
//! they ask for that velocity, and this stage alone knows of them ([`Setpoint::error_ne_m`]).

mod fis;
mod membership;
mod sugeno;
mod trim;

use alloc::borrow::ToOwned;
use alloc::format;

use nalgebra::Vector2;
use skein_common::frame::{heading_from_ne, wrap_rad};

use crate::estimate::Estimate;
use crate::plant::Sticks;

pub use fis::{Fis, FisError};
pub use sugeno::Sugeno;
pub(crate) use trim::VELOCITY_PER_ERROR_PER_S;
pub use trim::{AutoTrim, BadTrim, Trim};

/// No step counts for longer than this, s: after a pause of the plant the integrals do not jump.
const LONGEST_STEP_S: f64 = 0.1;
/// No lateral command below this height of the centre of gravity, m; the whole command from 2 m higher.
const GATE_FROM_M: f64 = 1.5;
const GATE_OVER_M: f64 = 2.0;

/// The outermost sets of the collective rules are fully on from this altitude error on, m. Without auto-trim a healthy vehicle
/// hovers up to 7.6 m off its altitude in 8 m/s of wind: the rules leave an error that grows with the air's speed.
const OUTERMOST_ALTITUDE_ERROR_M: f64 = 10.0;

/// How hard the rotor's energy brakes the fall without power, m/s², and collective over m/s of speed beyond that. Found on
/// the built-in helicopter: it hits the ground at 7.4 m/s at most, at 5.5 m/s in the mean, from 2 to 100 m.
const BRAKING_M_S2: f64 = 7.0;
const BRAKE_PER_M_S: f64 = 2.0;

/// Where the formation wants the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setpoint {
    /// The velocity relative to the feed-forward, north and east, m/s: the formation's field after its conversion and the safety
    /// filter, before the gate.
    pub relative_velocity_ne_m_s: Vector2<f64>,
    /// The velocity of the moving centre, north and east, m/s; zero if it is not fed forward.
    pub feedforward_ne_m_s: Vector2<f64>,
    /// Altitude above the swarm's origin, m.
    pub altitude_m: f64,
    /// Heading, clockwise from north.
    pub heading_rad: f64,
}

impl Setpoint {
    /// The relative velocity in the unit of the rule bases: the position error at which they ask for it, north and east, m.
    pub fn error_ne_m(&self) -> Vector2<f64> {
        self.relative_velocity_ne_m_s / VELOCITY_PER_ERROR_PER_S
    }
}

/// What one step commands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Controls {
    /// Always finite and within the controls' travel.
    pub sticks: Sticks,
    /// Why `sticks` is the last good command instead of a new one.
    pub fault: Option<ControlFault>,
}

/// An end of the controller's authority over the climb: it has no more collective to give in this direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CollectiveLimit {
    /// The vehicle cannot be made to sink more.
    Lowest,
    /// The vehicle cannot be made to climb more.
    Highest,
}

impl CollectiveLimit {
    /// The end of the range from `low` to `high` that this value has reached.
    fn of(value: f64, low: f64, high: f64) -> Option<Self> {
        if value >= high {
            Some(Self::Highest)
        } else if value <= low {
            Some(Self::Lowest)
        } else {
            None
        }
    }

    /// Whether more collective could have been asked for in the direction of this altitude error, set-point less altitude.
    pub fn is_towards(self, altitude_error_m: f64) -> bool {
        match self {
            Self::Lowest => altitude_error_m < 0.0,
            Self::Highest => altitude_error_m > 0.0,
        }
    }
}

/// Why a step could not be computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ControlFault {
    /// The estimate holds an infinite number or none.
    #[error("the estimate is not finite")]
    Estimate,
    /// The set-point holds an infinite number or none.
    #[error("the set-point is not finite")]
    Setpoint,
    /// The time since the last step is infinite or not a number.
    #[error("the time step is not finite")]
    TimeStep,
    /// An input of the rules overflowed.
    #[error("no rule fires")]
    Rules,
}

/// The four rule bases.
#[derive(Clone, Debug)]
pub struct Rules {
    /// Inputs R_E (m), velocity to the right (m/s), bank above trim (rad).
    pub roll: Sugeno,
    /// Inputs P_E (m), velocity backwards (m/s), pitch above trim (rad).
    pub pitch: Sugeno,
    /// Inputs heading error (rad), yaw rate (rad/s).
    pub heading: Sugeno,
    /// Inputs altitude error (m), climb rate (m/s).
    pub collective: Sugeno,
}

impl Rules {
    /// The rules that come with the program, `deploy/controllers/*.fis`.
    pub fn shipped() -> Self {
        Self::from_texts([
            ("roll.fis", include_str!("../../../deploy/controllers/roll.fis")),
            ("pitch.fis", include_str!("../../../deploy/controllers/pitch.fis")),
            ("heading.fis", include_str!("../../../deploy/controllers/heading.fis")),
            ("collective.fis", include_str!("../../../deploy/controllers/collective.fis")),
        ])
        // The texts are compiled in, and a test loads them.
        .expect("the shipped rules are well formed")
    }

    /// From the names (for errors) and texts of the roll, pitch, heading and collective rules, in this order.
    pub fn from_texts(files: [(&str, &str); 4]) -> Result<Self, FisError> {
        let [roll, pitch, heading, collective] = files;
        let load = |(file, text): (&str, &str), inputs: usize| {
            let rules = Sugeno::parse(file, text)?;
            if rules.inputs() == inputs {
                Ok(rules)
            } else {
                let what = format!("this controller has {inputs} inputs, not {}", rules.inputs());
                Err(FisError { file: file.to_owned(), line: 1, what })
            }
        };
        Ok(Self {
            roll: load(roll, 3)?,
            pitch: load(pitch, 3)?,
            heading: load(heading, 2)?,
            collective: load(collective, 2)?,
        })
    }
}

/// Flies one vehicle. Call [`VehicleController::step`] once a frame, at about 50 Hz.
#[derive(Clone, Debug)]
pub struct VehicleController {
    rules: Rules,
    trim: Trim,
    auto_trim: Option<AutoTrim>,
    last: Sticks,
    collective_limit: Option<CollectiveLimit>,
}

impl VehicleController {
    /// A controller that has commanded nothing yet.
    pub fn new(rules: Rules, trim: Trim, auto_trim: bool) -> Self {
        let auto_trim = auto_trim.then(AutoTrim::default);
        Self { rules, trim, auto_trim, last: trim.sticks(), collective_limit: None }
    }

    /// The next command. `dt_s` is the time since the last step; it matters to auto-trim only.
    ///
    /// Whatever is not finite in the arguments holds the last command (the trim, before there was one) and all
    /// integrals, and is told as a fault.
    pub fn step(&mut self, dt_s: f64, estimate: &Estimate, setpoint: &Setpoint) -> Controls {
        let fault = match self.command(dt_s, estimate, setpoint) {
            Ok(sticks) => {
                self.last = sticks;
                None
            }
            Err(fault) => Some(fault),
        };
        Controls { sticks: self.last, fault }
    }

    /// Cyclic and pedals as in the hover, collective as last commanded: for a vehicle that knows nothing of itself.
    pub fn neutral(&mut self) -> Sticks {
        self.last = Sticks { collective: self.last.collective, ..self.trim.sticks() };
        self.last
    }

    /// Everything centred while the collective is taken out within a second: for a vehicle on the ground.
    pub fn unload(&mut self, dt_s: f64) -> Sticks {
        let taken_out = dt_s.clamp(0.0, LONGEST_STEP_S);
        self.last = Sticks { collective: (self.last.collective - taken_out).max(0.0), ..Sticks::default() };
        self.last
    }

    /// [`Self::step`] with the pedals at their stop, for a vehicle whose roll or pitch servo is stuck. The stuck axis makes
    /// it tip over at a steady body rate p. Turning at a rate r carries that tilt round: it stays at p/r in the body, and
    /// has no direction in the mean. The axis that is left points everywhere in turn and holds the place.
    pub fn turn(&mut self, dt_s: f64, estimate: &Estimate, setpoint: &Setpoint) -> Controls {
        let controls = self.step(dt_s, estimate, setpoint);
        self.last.yaw = 1.0;
        Controls { sticks: self.last, ..controls }
    }

    /// Without power: upright and slow over the ground, the collective out so that the air from below keeps the rotor
    /// turning. For the last metres the rotor's energy brakes the fall: above the speed from which `BRAKING_M_S2` stops in
    /// this height, the collective comes in.
    pub fn autorotate(&mut self, dt_s: f64, estimate: &Estimate, heading_rad: f64) -> Controls {
        let altitude_m = estimate.position.altitude_m();
        let zero = Vector2::zeros();
        let level = Setpoint { relative_velocity_ne_m_s: zero, feedforward_ne_m_s: zero, altitude_m, heading_rad };
        let controls = self.step(dt_s, estimate, &level);
        if controls.fault.is_none() {
            let stops_from_m_s = (2.0 * BRAKING_M_S2 * estimate.height_m.max(0.0)).sqrt();
            let brake = BRAKE_PER_M_S * (-climb_m_s(estimate) - stops_from_m_s);
            self.last.collective = (self.trim.sticks().collective + brake).clamp(0.0, 1.0);
        }
        Controls { sticks: self.last, ..controls }
    }

    /// What auto-trim has found so far, if it is on.
    pub fn auto_trim(&self) -> Option<AutoTrim> {
        self.auto_trim
    }

    /// The end of its authority over the climb at which the last step was, if any.
    pub fn collective_limit(&self) -> Option<CollectiveLimit> {
        self.collective_limit
    }

    fn command(&mut self, dt_s: f64, estimate: &Estimate, setpoint: &Setpoint) -> Result<Sticks, ControlFault> {
        check(dt_s, estimate, setpoint)?;
        let found = self.auto_trim.unwrap_or_default();
        let gate = gate(estimate.height_m);
        let gated = Setpoint {
            relative_velocity_ne_m_s: setpoint.relative_velocity_ne_m_s * gate,
            feedforward_ne_m_s: setpoint.feedforward_ne_m_s * gate,
            ..*setpoint
        };
        let sticks = self.sticks(estimate, &gated, &found).ok_or(ControlFault::Rules)?;
        if let Some(auto_trim) = &mut self.auto_trim
            && gate >= 1.0
        {
            auto_trim.step(dt_s.clamp(0.0, LONGEST_STEP_S), estimate, &gated);
        }
        self.collective_limit = self.limit_of(&sticks, estimate, &gated);
        Ok(sticks)
    }

    /// The collective's travel ends; or that of the integral does; or the altitude error is so large that the rules ask for
    /// all they can. A vehicle on the ground that is asked to climb has all the collective that it gets there.
    fn limit_of(&self, sticks: &Sticks, estimate: &Estimate, setpoint: &Setpoint) -> Option<CollectiveLimit> {
        let gate = gate(estimate.height_m);
        let altitude_error_m = setpoint.altitude_m - estimate.position.altitude_m();
        if gate == 0.0 && altitude_error_m > 0.0 {
            return Some(CollectiveLimit::Highest);
        }
        let of_integral = self.auto_trim.filter(|_| gate >= 1.0).and_then(|auto_trim| auto_trim.collective_limit());
        let full_m = if self.auto_trim.is_some() { trim::FASTEST_CLIMB_ERROR_M } else { OUTERMOST_ALTITUDE_ERROR_M };
        of_integral
            .or_else(|| CollectiveLimit::of(altitude_error_m, -full_m, full_m))
            .or_else(|| CollectiveLimit::of(sticks.collective, 0.0, 1.0))
    }

    /// The four rule bases on their inputs; `None` if a number overflows.
    fn sticks(&self, estimate: &Estimate, setpoint: &Setpoint, found: &AutoTrim) -> Option<Sticks> {
        let heading_rad = estimate.attitude.heading_rad;
        let [pitch_error_m, roll_error_m] = pseudo_errors(setpoint.error_ne_m(), heading_rad);
        let velocity = heading_from_ne(estimate.velocity.horizontal() - setpoint.feedforward_ne_m_s, heading_rad);
        let tilt = heading_from_ne(found.tilt_ne_rad, heading_rad);
        // A tilt forwards is a negative pitch.
        let roll_rad = estimate.attitude.roll_rad - self.trim.roll_rad - tilt.y;
        let pitch_rad = estimate.attitude.pitch_rad - self.trim.pitch_rad + tilt.x;
        let heading_error_rad = wrap_rad(setpoint.heading_rad - heading_rad);
        let altitude_error_m = setpoint.altitude_m - estimate.position.altitude_m();

        let roll = self.rules.roll.evaluate(&[roll_error_m, velocity.y, roll_rad])?;
        let pitch = self.rules.pitch.evaluate(&[pitch_error_m, -velocity.x, pitch_rad])?;
        let yaw = self.rules.heading.evaluate(&[heading_error_rad, estimate.rates.yaw_rad_s])?;
        let collective = self.rules.collective.evaluate(&[altitude_error_m, climb_m_s(estimate)])?;
        let trim = self.trim.sticks();
        Some(Sticks {
            roll: (trim.roll + roll).clamp(-1.0, 1.0),
            pitch: (trim.pitch + pitch).clamp(-1.0, 1.0),
            yaw: (trim.yaw + yaw).clamp(-1.0, 1.0),
            collective: (trim.collective + found.collective + collective).clamp(0.0, 1.0),
        })
    }
}

fn check(dt_s: f64, estimate: &Estimate, setpoint: &Setpoint) -> Result<(), ControlFault> {
    let Estimate { position, height_m, velocity, attitude, rates, .. } = estimate;
    let Setpoint { relative_velocity_ne_m_s, feedforward_ne_m_s, altitude_m, heading_rad } = setpoint;
    let place_is_finite = position.is_finite() && height_m.is_finite() && velocity.is_finite();
    let horizontal = relative_velocity_ne_m_s.iter().chain(feedforward_ne_m_s);
    if !(place_is_finite && attitude.is_finite() && rates.is_finite()) {
        Err(ControlFault::Estimate)
    } else if !horizontal.chain([altitude_m, heading_rad]).all(|x| x.is_finite()) {
        Err(ControlFault::Setpoint)
    } else if !dt_s.is_finite() {
        Err(ControlFault::TimeStep)
    } else {
        Ok(())
    }
}

/// P_E and R_E, Garcia & Barnes eqs (10) and (11), of a field vector that is already converted to metres:
/// P_E = −(V_x cos ψ + V_y sin ψ), R_E = −V_x sin ψ + V_y cos ψ. Nose-up accelerates backwards, right bank accelerates
/// right: with these signs a positive error asks for a positive stick on both axes.
fn pseudo_errors(error_ne_m: Vector2<f64>, heading_rad: f64) -> [f64; 2] {
    let error = heading_from_ne(error_ne_m, heading_rad);
    [-error.x, error.y]
}

/// Share of the lateral command that is let through at this height, 0 to 1.
fn gate(height_m: f64) -> f64 {
    ((height_m - GATE_FROM_M) / GATE_OVER_M).clamp(0.0, 1.0)
}

fn climb_m_s(estimate: &Estimate) -> f64 {
    -estimate.velocity.down_m_s()
}

#[cfg(test)]
mod tests;
