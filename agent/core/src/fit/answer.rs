//! The second rung: in which direction each control works, found on the ground.
//!
//! Cyclic tilts a vehicle on its skids by a fraction of a degree, the more the less its weight rests on them, and pedals
//! turn it a little. Each control is moved to one side, to the other, and to the first again: the middle against the mean
//! of the others does not depend on slope or trim, nor on a steady creep. The collective rises from round to round, until
//! all three have answered.

use super::{Axis, FitError, Fitted, Mean, Verdict};
use crate::estimate::Estimate;
use crate::plant::Controls;

/// Deflection of a control to each side, in the units of [`Controls`].
const DEFLECTION: f64 = 0.2;
/// Time for which a control stays at a side, s, and the time at its end over which the effect is measured, s.
const HELD_S: f64 = 0.7;
const MEASURED_S: f64 = 0.25;
/// Rise of the collective from one round of the controls to the next.
const RISE: f64 = 0.05;
/// Time in which the collective rises, s.
const RISE_S: f64 = 0.5;
/// Differences that count as an answer: of attitude, rad, and of the yaw rate, rad/s.
const TILT_RAD: f64 = 0.002;
const YAW_RAD_S: f64 = 0.02;
/// Largest difference of the first side's two effects, as a share of the answer: more is no answer, but unrest.
const UNREST: f64 = 0.5;
/// Height above standing at which the vehicle counts as lifting off, m.
const LIFTS_FROM_M: f64 = 0.1;
/// Gain of the yaw control until its response is known: a gyro closes a fast loop of its own, which a strong yaw control
/// can drive into oscillation. Cyclic of up to five times the usual strength flies with a gain of 1.
const CAUTIOUS_YAW: f64 = 0.5;
/// The axes that answer on the ground.
const AXES: [Axis; 3] = [Axis::Roll, Axis::Pitch, Axis::Yaw];

#[derive(Clone, Debug, Default)]
pub(super) struct Answering {
    /// The collective, in the end the one at which all controls had answered.
    pub(super) collective: f64,
    /// Direction of each of `AXES`, once it is known.
    directions: [Option<f64>; 3],
    /// The axis being tried, and the part of its round: one side, the other, the first again.
    axis: usize,
    part: usize,
    /// Time at this side, or time since the collective began to rise, s.
    held_s: f64,
    rises_s: f64,
    effects: [Mean; 3],
}

impl Answering {
    pub(super) fn step(&mut self, dt_s: f64, estimate: &Estimate, found: &mut Fitted) -> Verdict {
        let unknown = self.directions.iter().position(Option::is_none);
        let Some(unknown) = unknown else {
            for (axis, direction) in AXES.into_iter().zip(self.directions) {
                let strength = if axis == Axis::Yaw { CAUTIOUS_YAW } else { 1.0 };
                *axis.gain(&mut found.gains) = strength * direction.unwrap_or(1.0);
            }
            return Verdict::Done(Controls { collective: self.collective, ..Controls::default() });
        };
        let axis = AXES[unknown];
        let is_full = self.collective >= 1.0;
        if estimate.height_m > found.standing_m + LIFTS_FROM_M || is_full {
            return Verdict::Fails(FitError::NoAnswer { axis });
        }
        let mut controls = Controls { collective: self.collective, ..Controls::default() };
        if self.rises_s > 0.0 {
            self.rises_s -= dt_s;
            self.collective = (self.collective + RISE * dt_s / RISE_S).min(1.0);
            return Verdict::Goes(controls);
        }
        let axis = AXES[self.axis];
        if self.directions[self.axis].is_some() {
            self.next_axis();
            return Verdict::Goes(controls);
        }
        self.held_s += dt_s;
        axis.move_by(&mut controls, if self.part == 1 { -DEFLECTION } else { DEFLECTION });
        let effect = match axis {
            Axis::Roll => estimate.attitude.roll_rad,
            Axis::Pitch => estimate.attitude.pitch_rad,
            _ => estimate.rates.yaw_rad_s,
        };
        if self.held_s >= HELD_S - MEASURED_S {
            self.effects[self.part].add(effect);
        }
        if self.held_s >= HELD_S {
            self.held_s = 0.0;
            self.part += 1;
            if self.part == self.effects.len() {
                let [first, other, again] = self.effects.map(|effect| effect.get());
                let difference = 0.5 * (first + again) - other;
                let least = if axis == Axis::Yaw { YAW_RAD_S } else { TILT_RAD };
                if difference.abs() >= least && (first - again).abs() < UNREST * difference.abs() {
                    self.directions[self.axis] = Some(difference.signum());
                }
                self.next_axis();
            }
        }
        Verdict::Goes(controls)
    }

    /// Continues to the next axis; after the last the collective rises.
    fn next_axis(&mut self) {
        self.part = 0;
        self.effects = Default::default();
        self.axis += 1;
        if self.axis == AXES.len() {
            self.axis = 0;
            self.rises_s = RISE_S;
        }
    }
}
