//! Engine, governor and shaft.

use super::parameters::Parameters;

/// The constants of the drive.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    pub(super) nominal_speed_rad_s: f64,
    max_power_w: f64,
    gain: f64,
    pub(super) integral_gain: f64,
    inverse_inertia: f64,
}

/// The governor's output.
#[derive(Clone, Copy, Debug)]
pub(super) struct Throttle {
    /// Shaft power, W.
    pub(super) power_w: f64,
    pub(super) integral_rate: f64,
}

/// Below this speed (rad/s) the engine's torque is that of this speed.
const MIN_SPEED_RAD_S: f64 = 1.0;

impl Drive {
    pub(super) fn new(parameters: &Parameters) -> Self {
        Self {
            nominal_speed_rad_s: parameters.head.nominal_speed_rad_s,
            max_power_w: parameters.engine.max_power_w,
            gain: parameters.engine.governor_gain_s_per_rad,
            integral_gain: parameters.engine.governor_integral_gain_per_rad,
            inverse_inertia: 1.0 / parameters.head.rotational_inertia_kg_m2,
        }
    }

    /// The governor: throttle K_p e + K_i w, clamped to 0..1, for the speed error e = Ω_nom − Ω. The integral ẇ = e is
    /// held while the throttle is at a limit and the error would drive it further out.
    #[inline]
    pub(super) fn throttle(&self, speed_rad_s: f64, integral: f64) -> Throttle {
        let error = self.nominal_speed_rad_s - speed_rad_s;
        let demand = self.gain * error + self.integral_gain * integral;
        let pushed_out = (demand >= 1.0 && error > 0.0) || (demand <= 0.0 && error < 0.0);
        Throttle {
            power_w: self.max_power_w * demand.clamp(0.0, 1.0),
            integral_rate: if pushed_out { 0.0 } else { error },
        }
    }

    /// Angular acceleration of the shaft, rad/s²: Ω̇ = (P/Ω − Q)/I_rot for the load torque Q of both rotors.
    #[inline]
    pub(super) fn shaft_acceleration(&self, speed_rad_s: f64, power_w: f64, load_n_m: f64) -> f64 {
        (power_w / speed_rad_s.max(MIN_SPEED_RAD_S) - load_n_m) * self.inverse_inertia
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
