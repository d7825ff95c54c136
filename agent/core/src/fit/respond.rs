//! The responses to short steps of each control, which give the gains; and the flight that checks them.

use nalgebra::Vector2;
use skein_common::frame::{BodyRates, HeadingFrame};

use super::flying::Flying;
use super::{Axis, FitError, Fitted, Mean, Responses, Verdict};
use crate::estimate::Estimate;
use crate::plant::Controls;
use crate::setpoint::VELOCITY_PER_ERROR_PER_S;

/// Responses of the built-in helicopter per full control, measured in the same way; a test compares them.
pub(super) const REFERENCE: Responses =
    Responses { roll_rad_s: 3.38, pitch_rad_s: 3.54, yaw_rad_s: 2.06, climb_m_s: 18.3 };
/// Ratios of a response to the reference that the rules can be scaled to.
const LOW: f64 = 0.2;
const HIGH: f64 = 5.0;

/// A step of one control: how far, how long, and the time from which its response is measured, s.
struct Pulse {
    by: f64,
    held_s: f64,
    measured_from_s: f64,
}

impl Axis {
    fn pulse(self) -> Pulse {
        match self {
            // One period of the roll and flap mode is left out, one is averaged.
            Self::Roll | Self::Pitch => Pulse { by: 0.12, held_s: 0.6, measured_from_s: 0.3 },
            Self::Yaw => Pulse { by: 0.25, held_s: 1.0, measured_from_s: 0.5 },
            Self::Collective => Pulse { by: 0.04, held_s: 1.0, measured_from_s: 0.9 },
        }
    }

    /// The quantity by which this control's response is measured.
    fn response(self, estimate: &Estimate) -> f64 {
        let BodyRates { roll_rad_s, pitch_rad_s, yaw_rad_s } = estimate.rates;
        self.of([roll_rad_s, pitch_rad_s, yaw_rad_s, -estimate.velocity.down_m_s()])
    }

    fn response_of(self, responses: &mut Responses) -> &mut f64 {
        let Responses { roll_rad_s, pitch_rad_s, yaw_rad_s, climb_m_s } = responses;
        self.of([roll_rad_s, pitch_rad_s, yaw_rad_s, climb_m_s])
    }
}

/// Time in which the vehicle has to be calm before a step, s, and how long that may take.
const CALM_FOR_S: f64 = 1.5;
const CALM_WITHIN_S: f64 = 40.0;
/// Limits of a calm vehicle.
const CALM_M_S: f64 = 0.2;
const CALM_RAD: f64 = 0.03;
const CALM_RAD_S: f64 = 0.05;
const CALM_M: f64 = 1.0;
const LEVEL_M: f64 = 0.25;

/// Gives each control a step to either side and measures the response.
#[derive(Clone, Debug)]
pub(super) struct Responding {
    pub(super) flying: Flying,
    /// Number of steps done: two for each control.
    done: usize,
    waited_s: f64,
    calm_s: f64,
    /// Time since the step began, s, and the controls and the response just before.
    step: Option<(f64, Controls, f64)>,
    measured: Mean,
    /// Response to the step to the first side.
    first: f64,
}

impl Responding {
    pub(super) fn new(flying: Flying) -> Self {
        let measured = Mean::default();
        Self { flying, done: 0, waited_s: 0.0, calm_s: 0.0, step: None, measured, first: 0.0 }
    }

    pub(super) fn step(&mut self, dt_s: f64, estimate: &Estimate, found: &mut Fitted) -> Verdict {
        let held = self.flying.hold(dt_s, estimate, found);
        let Some(&axis) = Axis::ALL.get(self.done / 2) else {
            // The flight that checks the gains begins at rest, at its altitude.
            self.waited_s += dt_s;
            let is_calm = is_calm(estimate, found, &self.flying, LEVEL_M);
            self.calm_s = if is_calm { self.calm_s + dt_s } else { 0.0 };
            if self.waited_s > CALM_WITHIN_S {
                return Verdict::Fails(restless());
            }
            return if self.calm_s >= CALM_FOR_S { Verdict::Done(held) } else { Verdict::Goes(held) };
        };
        let pulse = axis.pulse();
        let Some((since_s, before, response_before)) = &mut self.step else {
            self.waited_s += dt_s;
            self.calm_s = if is_calm(estimate, found, &self.flying, CALM_M) { self.calm_s + dt_s } else { 0.0 };
            if self.calm_s >= CALM_FOR_S {
                self.step = Some((0.0, held, axis.response(estimate)));
                self.measured = Mean::default();
            } else if self.waited_s > CALM_WITHIN_S {
                return Verdict::Fails(restless());
            }
            return Verdict::Goes(held);
        };
        *since_s += dt_s;
        let is_first = self.done.is_multiple_of(2);
        if *since_s >= pulse.measured_from_s {
            self.measured.add(axis.response(estimate) - *response_before);
        }
        // The other controls continue as the rules say; this one is held at its step.
        let mut controls = held;
        let mut stepped = *before;
        axis.move_by(&mut stepped, if is_first { pulse.by } else { -pulse.by });
        *axis.control(&mut controls) = *axis.control(&mut stepped);
        if *since_s >= pulse.held_s {
            let response = self.measured.get();
            (self.step, self.calm_s, self.waited_s) = (None, 0.0, 0.0);
            self.done += 1;
            if is_first {
                self.first = response;
            } else {
                if let Err(error) = judge(axis, (self.first - response) / (2.0 * pulse.by), found) {
                    return Verdict::Fails(error);
                }
                self.flying.adopt(found);
            }
        }
        Verdict::Goes(controls)
    }
}

fn restless() -> FitError {
    FitError::NotSettled("it does not come to rest between two steps".into())
}

/// Makes a response per full control the gain that gives the reference's.
fn judge(axis: Axis, response: f64, found: &mut Fitted) -> Result<(), FitError> {
    let reference = *axis.response_of(&mut REFERENCE.clone());
    *axis.response_of(&mut found.responses) = response;
    let gain = axis.gain(&mut found.gains);
    let ratio = response / reference * gain.signum();
    if !(LOW..=HIGH).contains(&ratio) {
        return Err(FitError::Response { axis, ratio, low: LOW, high: HIGH });
    }
    *gain = gain.signum() / ratio;
    Ok(())
}

fn is_calm(estimate: &Estimate, found: &Fitted, flying: &Flying, within_m: f64) -> bool {
    let attitude = estimate.attitude;
    let leans_rad =
        (attitude.roll_rad - found.trim.roll_rad).abs().max((attitude.pitch_rad - found.trim.pitch_rad).abs());
    let rates = estimate.rates;
    let turns_rad_s = rates.roll_rad_s.abs().max(rates.pitch_rad_s.abs()).max(rates.yaw_rad_s.abs());
    let off_m = (flying.altitude_m - estimate.position.altitude_m()).abs();
    estimate.velocity.0.norm() < CALM_M_S && leans_rad < CALM_RAD && turns_rad_s < CALM_RAD_S && off_m < within_m
}

/// Length of the flight aside, m, how long each way lasts, s, and the distance from the goal that counts as there, m.
const ASIDE_M: f64 = 8.0;
const EACH_S: f64 = 16.0;
const THERE_M: f64 = 0.5;
/// Limits: overshoot as a share of the way, time until there, s, altitude error, m.
const MOST_OVERSHOOT: f64 = 0.1;
const THERE_WITHIN_S: f64 = 12.0;
const MOST_ALTITUDE_M: f64 = 1.0;

/// Flies to the right, then forward, then back, with the gains found.
#[derive(Clone, Debug)]
pub(super) struct Checking {
    pub(super) flying: Flying,
    start_ne_m: Vector2<f64>,
    leg: usize,
    leg_s: f64,
    /// Last time on this leg at which the vehicle was not at its goal, s.
    away_s: f64,
}

/// The legs in the heading frame, forward and right, in lengths of `ASIDE_M`.
const LEGS: [[f64; 2]; 3] = [[0.0, 1.0], [1.0, 1.0], [0.0, 0.0]];

impl Checking {
    pub(super) fn new(flying: Flying, start_ne_m: Vector2<f64>) -> Self {
        Self { flying, start_ne_m, leg: 0, leg_s: 0.0, away_s: 0.0 }
    }

    pub(super) fn step(&mut self, dt_s: f64, estimate: &Estimate, found: &mut Fitted) -> Verdict {
        let heading = HeadingFrame::new(found.heading_rad);
        let corner = |leg: Option<usize>| {
            let [forward, right] = leg.map_or([0.0, 0.0], |leg| LEGS[leg]);
            self.start_ne_m + heading.to_ne(Vector2::new(forward, right) * ASIDE_M)
        };
        let Some((from_ne_m, goal_ne_m)) =
            LEGS.get(self.leg).map(|_| (corner(self.leg.checked_sub(1)), corner(Some(self.leg))))
        else {
            return Verdict::Done(self.flying.hold(dt_s, estimate, found));
        };
        self.flying.place_ne_m = goal_ne_m;
        let error_ne_m = goal_ne_m - estimate.position.horizontal();
        let controls = self.flying.command(dt_s, estimate, found, error_ne_m * VELOCITY_PER_ERROR_PER_S);
        self.leg_s += dt_s;
        if error_ne_m.norm() > THERE_M {
            self.away_s = self.leg_s;
        }
        let way_ne_m = goal_ne_m - from_ne_m;
        let overshoot = -error_ne_m.dot(&way_ne_m) / way_ne_m.norm_squared();
        found.overshoot = found.overshoot.max(overshoot);
        let off_m = (self.flying.altitude_m - estimate.position.altitude_m()).abs();
        let limit = |what, value: f64, limit: f64| (value > limit).then_some(FitError::Check { what, value, limit });
        let exceeded = limit("the overshoot, share of the way,", found.overshoot, MOST_OVERSHOOT)
            .or_else(|| limit("the altitude error, m,", off_m, MOST_ALTITUDE_M));
        if let Some(error) = exceeded {
            return Verdict::Fails(error);
        }
        if self.leg_s >= EACH_S {
            if let Some(error) = limit("the time to settle, s,", self.away_s, THERE_WITHIN_S) {
                return Verdict::Fails(error);
            }
            found.settled_s = found.settled_s.max(self.away_s);
            (self.leg, self.leg_s, self.away_s) = (self.leg + 1, 0.0, 0.0);
        }
        Verdict::Goes(controls)
    }
}
