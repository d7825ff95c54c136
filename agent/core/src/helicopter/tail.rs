//! The tail: rotor, fin and yaw gyro.

use core::f64::consts::PI;

use super::body::{self, Wrench};
use super::parameters::Parameters;
use super::rotor::{HoveringRotor, Inflow, Rotor};
use super::vector::Vector;
use crate::lanes::{Real, numbers};

numbers! {
    /// The constants of the tail.
    #[derive(Clone, Debug, Default)]
    pub(super) struct Tail<R> {
        pub(super) rotor: Rotor<R>,
        pub(super) arm_m: R,
        pub(super) height_m: R,
        pub(super) gear_ratio: R,
        /// Blockage factor of the fin, f_t = 1 − 0.75 S_vf/A_t.
        blockage: R,
        /// ½ρ S_vf of the fin, kg/m.
        fin_half_density_area: R,
        fin_lift_slope: R,
        /// Share ε_vf of the fin in the tail rotor's wake.
        fin_wake_share: R,
        gyro_gain_s: R,
        gyro_integral_gain: R,
        min_pitch_rad: R,
        max_pitch_rad: R,
    }
}

/// The tail's forces, load on the main shaft and rate of change.
#[derive(Clone, Copy, Debug)]
pub(super) struct TailAction<R> {
    pub(super) wrench: Wrench<R>,
    /// Load torque of the tail rotor on the main shaft, n_tr Q_t, N m.
    pub(super) shaft_torque_n_m: R,
    pub(super) inflow: Inflow<R>,
}

impl Tail<f64> {
    pub(super) fn new(parameters: &Parameters) -> Self {
        let Parameters { fin, tail, tail_rotor, gyro, .. } = parameters;
        Self {
            rotor: Rotor::new(parameters, tail_rotor, tail.gear_ratio),
            arm_m: tail.arm_m,
            height_m: tail_rotor.height_m,
            gear_ratio: tail.gear_ratio,
            blockage: 1.0 - 0.75 * fin.area_m2 / (PI * tail_rotor.radius_m * tail_rotor.radius_m),
            fin_half_density_area: 0.5 * parameters.air_density_kg_m3 * fin.area_m2,
            fin_lift_slope: fin.lift_slope_per_rad,
            fin_wake_share: fin.tail_wake_share,
            gyro_gain_s: gyro.gain_s,
            gyro_integral_gain: gyro.integral_gain,
            min_pitch_rad: tail.min_pitch_rad,
            max_pitch_rad: tail.max_pitch_rad,
        }
    }

    /// Switches the gyro off for good: the blade pitch stays at the gyro's integral.
    pub(super) fn hold_pitch(&mut self) {
        (self.gyro_gain_s, self.gyro_integral_gain) = (0.0, 0.0);
    }

    /// Blade pitch at the lower and upper stop, rad.
    pub(super) fn stops_rad(&self) -> (f64, f64) {
        (self.min_pitch_rad, self.max_pitch_rad)
    }

    /// The tail rotor in a hover in which rotor and fin together push left with this force, N. The fin is in the
    /// rotor's wake and reduces the force by ½ρ S (ε v_i)².
    pub(super) fn hovering(&self, force_n: f64, shaft_speed_rad_s: f64) -> HoveringRotor {
        let fin = self.fin_half_density_area * self.fin_wake_share * self.fin_wake_share;
        let thrust_n = force_n / (self.blockage - fin * self.rotor.induced_squared_per_thrust());
        self.rotor.hovering(thrust_n, shaft_speed_rad_s)
    }
}

impl<R: Real> Tail<R> {
    /// The gyro: blade pitch θ_t = K_p (r_cmd − r) + g, rad, clamped to its stops, and the rate of its integral g,
    /// which is held at a stop while the error would drive it further out.
    #[inline(always)]
    pub(super) fn gyro(&self, rate_error_rad_s: R, integral_rad: R) -> (R, R) {
        let theta = self.gyro_gain_s * rate_error_rad_s + integral_rad;
        let rate = self.gyro_integral_gain * rate_error_rad_s;
        let zero = R::splat(0.0);
        let pushed_out = (self.max_pitch_rad.le(integral_rad) & zero.lt(rate))
            | (integral_rad.le(self.min_pitch_rad) & rate.lt(zero));
        (theta.clamp(self.min_pitch_rad, self.max_pitch_rad), R::select(pushed_out, zero, rate))
    }

    /// Forces of rotor and fin, combined at one point behind and above the centre of gravity, for the blade pitch θ_t,
    /// the inflow ratio λ_t, the main shaft's speed, the airspeed and rates of the body and the main rotor's wake K_λ
    /// v_i:
    ///
    /// ```text
    /// w_tr = w + l q − K_λ v_i                 T_t = f_t C_Tt ρ V_t² A_t, pushing left
    /// v_tr = v − l r + h p                     Q_t = (|C_Tt λ_t| + C_D0t σ_t/8) ρ V_t² A_t R_t
    /// v_f = v − ε λ_t V_t − l r                Y_f: lift for V_fin = √(u² + w_tr²) along, v_f across
    /// ```
    #[inline(always)]
    pub(super) fn action(
        &self,
        (theta, lambda): (R, R),
        shaft_speed_rad_s: R,
        air: Vector<R>,
        rates: Vector<R>,
        wake_m_s: R,
    ) -> TailAction<R> {
        let w_tr = air.z + self.arm_m * rates.y - wake_m_s;
        let sideways_m_s = air.y - self.arm_m * rates.z;
        let in_plane_squared = air.x * air.x + w_tr * w_tr;
        let flow = self.rotor.flow(shaft_speed_rad_s, in_plane_squared, sideways_m_s + self.height_m * rates.x);
        let c_t = self.rotor.thrust_coefficient(theta, lambda, &flow);
        let thrust_n = self.blockage * self.rotor.thrust_n(c_t, &flow);
        let c_q = (c_t * lambda).abs() + self.rotor.profile_torque;
        let v_f = sideways_m_s - self.fin_wake_share * lambda * flow.tip_speed_m_s;
        let fin_n = body::lift_n(self.fin_half_density_area, self.fin_lift_slope, in_plane_squared.sqrt(), v_f);
        TailAction {
            wrench: self.side_force(fin_n - thrust_n),
            shaft_torque_n_m: self.gear_ratio * self.rotor.torque_n_m(c_q, &flow),
            inflow: self.rotor.inflow(c_t, lambda, &flow),
        }
    }

    /// Force and moment of a force y to the right at the tail rotor's hub, N.
    #[inline(always)]
    fn side_force(&self, y: R) -> Wrench<R> {
        let zero = R::splat(0.0);
        Wrench { force: Vector::new(zero, y, zero), moment: Vector::new(y * self.height_m, zero, -y * self.arm_m) }
    }
}
