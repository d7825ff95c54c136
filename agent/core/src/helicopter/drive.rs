//! Engine, governor and shaft.

use super::parameters::Parameters;
use crate::lanes::{Real, numbers};

numbers! {
    /// The constants of the drive.
    #[derive(Clone, Debug, Default)]
    pub(super) struct Drive<R> {
        pub(super) nominal_speed_rad_s: R,
        max_power_w: R,
        gain: R,
        pub(super) integral_gain: R,
        inverse_inertia: R,
    }
}

/// The governor's output.
#[derive(Clone, Copy, Debug)]
pub(super) struct Throttle<R> {
    /// Shaft power, W.
    pub(super) power_w: R,
    pub(super) integral_rate: R,
}

/// Below this speed (rad/s) the engine's torque is that of this speed.
const MIN_SPEED_RAD_S: f64 = 1.0;

impl Drive<f64> {
    pub(super) fn new(parameters: &Parameters) -> Self {
        Self {
            nominal_speed_rad_s: parameters.head.nominal_speed_rad_s,
            max_power_w: parameters.engine.max_power_w,
            gain: parameters.engine.governor_gain_s_per_rad,
            integral_gain: parameters.engine.governor_integral_gain_per_rad,
            inverse_inertia: 1.0 / parameters.head.rotational_inertia_kg_m2,
        }
    }

    /// Cuts the engine's power for good. The governor keeps running.
    pub(super) fn stop(&mut self) {
        self.max_power_w = 0.0;
    }

    /// The governor's integral that holds this power at nominal speed, rad.
    pub(super) fn integral_for(&self, power_w: f64) -> f64 {
        power_w / (self.max_power_w * self.integral_gain)
    }
}

impl<R: Real> Drive<R> {
    /// The governor: throttle K_p e + K_i w, clamped to 0..1, for the speed error e = Ω_nom − Ω. The integral ẇ = e is
    /// held while the throttle is at a limit and the error would drive it further out.
    #[inline(always)]
    pub(super) fn throttle(&self, speed_rad_s: R, integral: R) -> Throttle<R> {
        let (zero, one) = (R::splat(0.0), R::splat(1.0));
        let error = self.nominal_speed_rad_s - speed_rad_s;
        let demand = self.gain * error + self.integral_gain * integral;
        let pushed_out = (one.le(demand) & zero.lt(error)) | (demand.le(zero) & error.lt(zero));
        Throttle {
            power_w: self.max_power_w * demand.clamp(zero, one),
            integral_rate: R::select(pushed_out, zero, error),
        }
    }

    /// Angular acceleration of the shaft, rad/s²: Ω̇ = (P/Ω − Q)/I_rot for the load torque Q of both rotors.
    #[inline(always)]
    pub(super) fn shaft_acceleration(&self, speed_rad_s: R, power_w: R, load_n_m: R) -> R {
        (power_w / speed_rad_s.max(R::splat(MIN_SPEED_RAD_S)) - load_n_m) * self.inverse_inertia
    }
}
