//! The hover, whose mean controls and attitude become the trim.

use alloc::format;

use super::flying::{Flying, HOVER_M};
use super::{FitError, Fitted, Mean, Verdict};
use crate::control::Trim;
use crate::estimate::Estimate;
use crate::plant::Controls;

/// Length of one window, s: its means become the trim of the next.
const WINDOW_S: f64 = 6.0;
/// Windows until the hover has to be steady.
const MOST_WINDOWS: u32 = 20;
/// Limits of a steady hover: speed, m/s, altitude error, m, and change of the trim from one window to the next.
const STEADY_M_S: f64 = 0.15;
const STEADY_M: f64 = 0.3;
const STEADY_RAD: f64 = 0.004;
const STEADY_COLLECTIVE: f64 = 0.01;
/// Speed below which a window's means improve the trim, m/s.
const USEFUL_M_S: f64 = 1.0;
/// Least collective that has to be left above the hover.
pub(super) const LEAST_MARGIN: f64 = 0.15;

#[derive(Clone, Debug)]
pub(super) struct Hovering {
    pub(super) flying: Flying,
    /// Whether the vehicle has come up to its height.
    is_up: bool,
    window_s: f64,
    windows: u32,
    /// Roll, pitch, yaw, collective; roll angle, pitch angle.
    means: [Mean; 6],
    /// Largest speed, m/s, and altitude error, m, in this window.
    fastest_m_s: f64,
    farthest_m: f64,
}

impl Hovering {
    pub(super) fn new(flying: Flying) -> Self {
        let means = Default::default();
        Self { flying, is_up: false, window_s: 0.0, windows: 0, means, fastest_m_s: 0.0, farthest_m: 0.0 }
    }

    pub(super) fn step(&mut self, dt_s: f64, estimate: &Estimate, found: &mut Fitted) -> Verdict {
        let controls = self.flying.hold(dt_s, estimate, found);
        self.is_up |= estimate.height_m > found.standing_m + 0.7 * HOVER_M;
        self.window_s += dt_s;
        self.measure(&controls, estimate);
        if self.window_s < WINDOW_S {
            return Verdict::Goes(controls);
        }
        self.windows += 1;
        let (before, is_calm) = (found.trim, self.fastest_m_s < STEADY_M_S && self.farthest_m < STEADY_M);
        if self.is_up && self.fastest_m_s < USEFUL_M_S {
            found.trim = self.trim();
            self.flying.adopt(found);
        }
        let changed_rad =
            (found.trim.roll_rad - before.roll_rad).abs().max((found.trim.pitch_rad - before.pitch_rad).abs());
        let changed = (found.trim.collective - before.collective).abs();
        let (fastest_m_s, farthest_m) = (self.fastest_m_s, self.farthest_m);
        (self.window_s, self.means, self.fastest_m_s, self.farthest_m) = (0.0, Default::default(), 0.0, 0.0);
        if self.is_up && is_calm && changed_rad < STEADY_RAD && changed < STEADY_COLLECTIVE {
            let collective = found.trim.collective;
            if collective > 1.0 - LEAST_MARGIN {
                return Verdict::Fails(FitError::Margin { collective, least: LEAST_MARGIN });
            }
            return Verdict::Done(controls);
        }
        if self.windows == MOST_WINDOWS {
            let how = format!("up to {fastest_m_s:.2} m/s and {farthest_m:.2} m off its altitude");
            return Verdict::Fails(FitError::NotSettled(how));
        }
        Verdict::Goes(controls)
    }

    fn measure(&mut self, controls: &Controls, estimate: &Estimate) {
        let Controls { roll, pitch, yaw, collective } = *controls;
        let attitude = estimate.attitude;
        let values = [roll, pitch, yaw, collective, attitude.roll_rad, attitude.pitch_rad];
        for (mean, value) in self.means.iter_mut().zip(values) {
            mean.add(value);
        }
        self.fastest_m_s = self.fastest_m_s.max(estimate.velocity.0.norm());
        self.farthest_m = self.farthest_m.max((self.flying.altitude_m - estimate.position.altitude_m()).abs());
    }

    fn trim(&self) -> Trim {
        let [roll_stick, pitch_stick, yaw_stick, collective, roll_rad, pitch_rad] = self.means.map(|mean| mean.get());
        Trim { roll_stick, pitch_stick, yaw_stick, collective, roll_rad, pitch_rad }
    }
}
