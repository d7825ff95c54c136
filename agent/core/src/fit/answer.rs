//! The second rung: in which direction each control works, found on the ground.
//!
//! Cyclic tilts a vehicle on its skids by a fraction of a degree, the more the less its weight rests on them, and pedals
//! turn it a little. Each control is moved to one side and then to the other; the difference of the two ends does not
//! depend on slope or trim. The collective rises from pair to pair, until all three have answered.

use super::{Axis, FitError, Found, Mean, TIPS_FROM_RAD, Verdict};
use crate::estimate::Estimate;
use crate::plant::Controls;

/// How far a control is moved to each side.
const DEFLECTION: f64 = 0.2;
/// How long it stays there, s, and over which time at the end its effect is measured.
const HELD_S: f64 = 0.7;
const MEASURED_S: f64 = 0.25;
/// Rise of the collective from one round of the controls to the next.
const RISE: f64 = 0.05;
/// Time in which the collective rises, s.
const RISE_S: f64 = 0.5;
/// Differences that count as an answer: of attitude, rad, and of the yaw rate, rad/s.
const TILT_RAD: f64 = 0.001;
const YAW_RAD_S: f64 = 0.01;
/// Height above standing at which the vehicle counts as lifting off, m.
const LIFTS_FROM_M: f64 = 0.1;
/// The axes that answer on the ground.
const AXES: [Axis; 3] = [Axis::Roll, Axis::Pitch, Axis::Yaw];

#[derive(Clone, Debug, Default)]
pub(super) struct Answering {
    collective: f64,
    /// Direction of each of `AXES`, once it is known.
    directions: [Option<f64>; 3],
    /// The axis being tried, and whether it is at its second side.
    axis: usize,
    is_second: bool,
    /// Time at this side, or time since the collective began to rise, s.
    held_s: f64,
    rises_s: f64,
    effects: [Mean; 2],
}

impl Answering {
    /// The collective at which all controls had answered.
    pub(super) fn collective(&self) -> f64 {
        self.collective
    }

    pub(super) fn step(&mut self, dt_s: f64, estimate: &Estimate, found: &mut Found) -> Verdict {
        let unknown = self.directions.iter().position(Option::is_none);
        let Some(unknown) = unknown else {
            for (axis, direction) in AXES.into_iter().zip(self.directions) {
                *axis.gain(&mut found.gains) = direction.unwrap_or(1.0);
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
        axis.move_by(&mut controls, if self.is_second { -DEFLECTION } else { DEFLECTION });
        let effect = match axis {
            Axis::Roll => estimate.attitude.roll_rad,
            Axis::Pitch => estimate.attitude.pitch_rad,
            _ => estimate.rates.yaw_rad_s,
        };
        if self.held_s >= HELD_S - MEASURED_S {
            self.effects[usize::from(self.is_second)].add(effect);
        }
        if self.held_s >= HELD_S {
            self.held_s = 0.0;
            if self.is_second {
                let difference = self.effects[0].get() - self.effects[1].get();
                let least = if axis == Axis::Yaw { YAW_RAD_S } else { TILT_RAD };
                if difference.abs() >= least && difference.abs() < 2.0 * TIPS_FROM_RAD {
                    self.directions[self.axis] = Some(difference.signum());
                }
                self.next_axis();
            } else {
                self.is_second = true;
            }
        }
        Verdict::Goes(controls)
    }

    /// Goes on to the next axis; after the last the collective rises.
    fn next_axis(&mut self) {
        self.is_second = false;
        self.effects = Default::default();
        self.axis += 1;
        if self.axis == AXES.len() {
            self.axis = 0;
            self.rises_s = RISE_S;
        }
    }
}
