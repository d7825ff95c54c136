//! Thrust, inflow and torque of the main or tail rotor.

use core::f64::consts::PI;

use super::parameters::{Parameters, RotorParameters};
use crate::lanes::{Real, numbers};

/// Lower bound of the tip speed in the coefficients, which divide by it, m/s.
const MIN_TIP_SPEED_M_S: f64 = 1.0;

numbers! {
    /// The constants of one two-bladed rotor.
    #[derive(Clone, Debug, Default)]
    pub(super) struct Rotor<R> {
        /// Ratio of tip speed to the main shaft's speed, m.
        tip_arm_m: R,
        /// Half the product of lift slope and solidity, aσ/2.
        half_lift: R,
        max_thrust_coefficient: R,
        /// Profile torque coefficient C_D0 σ/8.
        pub(super) profile_torque: R,
        /// ρ A, kg/m: thrust = C_T ρ A (ΩR)².
        density_area: R,
        /// 1/(2 η_w) of the wake contraction η_w.
        half_inverse_contraction: R,
        /// 1/τ_λ of the inflow lag, 1/s.
        inverse_lag: R,
        /// ρ A R, kg: torque = C_Q ρ A R (ΩR)².
        density_area_radius: R,
    }
}

/// The airflow through one rotor.
#[derive(Clone, Copy, Debug)]
pub(super) struct Flow<R> {
    /// Tip speed ΩR, m/s.
    pub(super) tip_speed_m_s: R,
    /// Inverse tip speed 1/(ΩR), s/m.
    pub(super) inverse_tip_speed: R,
    /// Advance ratio squared, μ².
    pub(super) mu_squared: R,
    /// Ratio of axial speed to tip speed, μ_z, positive against the inflow.
    pub(super) mu_z: R,
}

/// The rate of change of an inflow ratio, and the terms of its equation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Inflow<R> {
    /// Its rate of change, 1/s.
    pub(super) rate: R,
    /// C_T, λ − μ_z and D of its equation.
    c_t: R,
    through: R,
    d: R,
}

impl Rotor<f64> {
    /// A rotor whose speed is `gear_ratio` times the main shaft's.
    pub(super) fn new(vehicle: &Parameters, rotor: &RotorParameters, gear_ratio: f64) -> Self {
        let RotorParameters { radius_m, chord_m, lift_slope_per_rad, profile_drag, .. } = *rotor;
        let solidity = 2.0 * chord_m / (PI * radius_m);
        let density_area = vehicle.air_density_kg_m3 * PI * radius_m * radius_m;
        Self {
            tip_arm_m: gear_ratio * radius_m,
            half_lift: lift_slope_per_rad * solidity / 2.0,
            max_thrust_coefficient: rotor.max_thrust_coefficient,
            profile_torque: profile_drag * solidity / 8.0,
            density_area,
            half_inverse_contraction: 0.5 / vehicle.wake_contraction,
            inverse_lag: 1.0 / rotor.inflow_lag_s,
            density_area_radius: density_area * radius_m,
        }
    }

    /// Product of lift slope and solidity, aσ.
    pub(super) fn lift(&self) -> f64 {
        2.0 * self.half_lift
    }

    /// Ratio v_i²/T in a hover, m²/s² per N.
    pub(super) fn induced_squared_per_thrust(&self) -> f64 {
        self.half_inverse_contraction / self.density_area
    }

    /// The hover in still air with this thrust, which must not be negative: D = λ, hence λ = √(C_T/(2 η_w)).
    pub(super) fn hovering(&self, thrust_n: f64, shaft_speed_rad_s: f64) -> HoveringRotor {
        let flow = self.flow(shaft_speed_rad_s, 0.0, 0.0);
        let c_t = thrust_n / self.thrust_n(1.0, &flow);
        let lambda = (c_t * self.half_inverse_contraction).sqrt();
        HoveringRotor {
            thrust_n,
            lambda,
            theta: 3.0 * (c_t / self.half_lift + 0.5 * lambda),
            torque_n_m: self.torque_n_m(c_t * lambda + self.profile_torque, &flow),
        }
    }
}

impl<R: Real> Rotor<R> {
    /// The flow at shaft speed Ω for an airspeed in the disc's plane (squared, m²/s²) and along its axis (m/s, positive
    /// against the inflow).
    #[inline(always)]
    pub(super) fn flow(&self, shaft_speed_rad_s: R, in_plane_squared: R, axial_m_s: R) -> Flow<R> {
        let tip_speed_m_s = (self.tip_arm_m * shaft_speed_rad_s).max(R::splat(MIN_TIP_SPEED_M_S));
        let inverse_tip_speed = R::splat(1.0) / tip_speed_m_s;
        Flow {
            tip_speed_m_s,
            inverse_tip_speed,
            mu_squared: in_plane_squared * inverse_tip_speed * inverse_tip_speed,
            mu_z: axial_m_s * inverse_tip_speed,
        }
    }

    /// Thrust coefficient C_T = (aσ/2)(θ(1/3 + μ²/2) + (μ_z − λ)/2), limited to ±C_Tmax.
    #[inline(always)]
    pub(super) fn thrust_coefficient(&self, theta: R, lambda: R, flow: &Flow<R>) -> R {
        let Flow { mu_squared, mu_z, .. } = *flow;
        let c_t = self.half_lift * (theta * (mu_squared * 0.5 + 1.0 / 3.0) + (mu_z - lambda) * 0.5);
        c_t.clamp(-self.max_thrust_coefficient, self.max_thrust_coefficient)
    }

    /// Rate of change of the inflow ratio, 1/s: λ̇ = (C_T/(2 η_w D) − λ)/τ_λ, which is momentum theory with a lag,
    /// where D = max(√(μ² + (λ − μ_z)²), 0.3 √(|C_T|/(2 η_w)) + 0.001). The floor of D keeps the vortex ring state
    /// finite.
    #[inline(always)]
    pub(super) fn inflow(&self, c_t: R, lambda: R, flow: &Flow<R>) -> Inflow<R> {
        let through = lambda - flow.mu_z;
        let momentum = c_t * self.half_inverse_contraction;
        let floor = momentum.abs().sqrt() * 0.3 + 0.001;
        let d = (flow.mu_squared + through * through).sqrt().max(floor);
        Inflow { rate: (momentum / d - lambda) * self.inverse_lag, c_t, through, d }
    }

    /// The pole of the inflow ratio, 1/s: the derivative of its rate of change by itself, at most −1/τ_λ, without the
    /// limits of C_T and D.
    #[inline(always)]
    pub(super) fn inflow_pole(&self, inflow: &Inflow<R>) -> R {
        let Inflow { c_t, through, d, .. } = *inflow;
        let inverse_d = R::splat(1.0) / d;
        let lift = self.half_lift * 0.5 + c_t * through * inverse_d * inverse_d;
        let slope = self.half_inverse_contraction * inverse_d * lift;
        -(slope.max(R::splat(0.0)) + 1.0) * self.inverse_lag
    }

    /// Thrust T = C_T ρ (ΩR)² A, N.
    #[inline(always)]
    pub(super) fn thrust_n(&self, c_t: R, flow: &Flow<R>) -> R {
        c_t * self.density_area * flow.tip_speed_m_s * flow.tip_speed_m_s
    }

    /// Torque Q = C_Q ρ (ΩR)² A R, N m.
    #[inline(always)]
    pub(super) fn torque_n_m(&self, c_q: R, flow: &Flow<R>) -> R {
        c_q * self.density_area_radius * flow.tip_speed_m_s * flow.tip_speed_m_s
    }
}

/// One rotor in a hover.
#[derive(Clone, Copy, Debug)]
pub(super) struct HoveringRotor {
    pub(super) thrust_n: f64,
    pub(super) lambda: f64,
    /// Blade pitch θ, rad.
    pub(super) theta: f64,
    /// Torque Q, N m.
    pub(super) torque_n_m: f64,
}
