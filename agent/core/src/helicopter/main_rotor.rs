//! The main rotor: its forces on the body, its torque, and how its disc tilts.

use nalgebra::Vector3;

use super::body::Wrench;
use super::ground;
use super::parameters::Parameters;
use super::rotor::{Flow, Rotor};

/// What is constant of the main rotor.
#[derive(Clone, Debug)]
pub(super) struct MainRotor {
    pub(super) rotor: Rotor,
    radius_m: f64,
    height_m: f64,
    /// K_β.
    hub_stiffness: f64,
    /// 1/(τ_e Ω) = γ_fb/16.
    flap_bandwidth: f64,
    /// aσ.
    lift: f64,
    /// 2 K_μ.
    blow_back: f64,
    /// 16 K_μ.
    heave_flap: f64,
    /// A_lon/Ω_nom² and B_lat/Ω_nom².
    longitudinal_gain: f64,
    lateral_gain: f64,
}

/// The main rotor's part of the state.
#[derive(Clone, Copy, Debug)]
pub(super) struct MainRotorState {
    /// Ω.
    pub(super) speed_rad_s: f64,
    /// θ0.
    pub(super) collective_rad: f64,
    /// δ_lat, δ_lon.
    pub(super) lateral_rad: f64,
    pub(super) longitudinal_rad: f64,
    /// λ.
    pub(super) lambda: f64,
    /// a1, b1.
    pub(super) a1: f64,
    pub(super) b1: f64,
}

/// What the main rotor does.
#[derive(Clone, Copy, Debug)]
pub(super) struct MainRotorAction {
    pub(super) wrench: Wrench,
    /// Q.
    pub(super) torque_n_m: f64,
    /// v_i.
    pub(super) induced_m_s: f64,
    pub(super) lambda_rate: f64,
    pub(super) a1_rate: f64,
    pub(super) b1_rate: f64,
}

impl MainRotor {
    pub(super) fn new(parameters: &Parameters) -> Self {
        let head = &parameters.head;
        let rotor = Rotor::new(parameters, &parameters.main_rotor, 1.0);
        let nominal_squared = head.nominal_speed_rad_s * head.nominal_speed_rad_s;
        Self {
            lift: rotor.lift(),
            rotor,
            radius_m: parameters.main_rotor.radius_m,
            height_m: parameters.main_rotor.height_m,
            hub_stiffness: head.hub_stiffness_n_m_per_rad,
            flap_bandwidth: head.flybar_lock_number / 16.0,
            blow_back: 2.0 * head.speed_flap_scaling,
            heave_flap: 16.0 * head.speed_flap_scaling,
            longitudinal_gain: head.longitudinal_flap_gain_rad_per_rad / nominal_squared,
            lateral_gain: head.lateral_flap_gain_rad_per_rad / nominal_squared,
        }
    }

    /// Forces, moments and rates for the air's velocity over the body (body axes), the body's rates and the height of the
    /// centre of gravity above the ground; `uprightness` is the vertical part of the mast's direction.
    #[inline]
    pub(super) fn action(
        &self,
        state: &MainRotorState,
        air: &Vector3<f64>,
        rates: &Vector3<f64>,
        height_m: f64,
        uprightness: f64,
    ) -> MainRotorAction {
        let flow = self.rotor.flow(state.speed_rad_s, air.x * air.x + air.y * air.y, air.z);
        let c_t = self.rotor.thrust_coefficient(state.collective_rad, state.lambda, &flow);
        let c_q = c_t * (state.lambda - flow.mu_z) + self.rotor.profile_torque * (1.0 + 7.0 / 3.0 * flow.mu_squared);
        let torque_n_m = self.rotor.torque_n_m(c_q, &flow);
        let hub_height_m = height_m + self.height_m * uprightness;
        let thrust_n = self.rotor.thrust_n(c_t, &flow) * ground::thrust_factor(self.radius_m, hub_height_m);
        let (a1_rate, b1_rate) = self.flapping(state, air, rates, &flow);
        MainRotorAction {
            wrench: self.wrench(state, thrust_n, torque_n_m),
            torque_n_m,
            induced_m_s: state.lambda * flow.tip_speed_m_s,
            lambda_rate: self.rotor.inflow_rate(c_t, state.lambda, &flow),
            a1_rate,
            b1_rate,
        }
    }

    /// X = −T a1, Y = T b1, Z = −T, L = (K_β + T h) b1, M = (K_β + T h) a1, N = −Q.
    #[inline]
    fn wrench(&self, state: &MainRotorState, t: f64, q: f64) -> Wrench {
        let stiffness = self.stiffness(t);
        Wrench {
            force: Vector3::new(-t * state.a1, t * state.b1, -t),
            moment: Vector3::new(stiffness * state.b1, stiffness * state.a1, -q),
        }
    }

    /// Moment on the body over the disc's tilt, K_β + T h_mr.
    #[inline]
    pub(super) fn stiffness(&self, t: f64) -> f64 {
        self.hub_stiffness + t * self.height_m
    }

    /// First-order flapping with the stabiliser bar's lag τ_e = 16/(γ_fb Ω), s = (Ω/Ω_nom)²:
    ///
    /// ```text
    /// ȧ1 = −q + (−a1 + d u/V + dz w/V + A_lon s δ_lon)/τ_e      d  = 2 K_μ (4θ0/3 − λ)
    /// ḃ1 = −p + (−b1 − d v/V          + B_lat s δ_lat)/τ_e      dz = 16 K_μ μ²/((1 − μ²/2)(8μ + aσ))
    /// ```
    ///
    /// Positive a1 tilts the disc back, positive b1 tilts it right. The disc tilts away from the wind on both axes; where the
    /// lateral term is printed with two minus signs that cancel, sideslip would be unstable.
    #[inline]
    fn flapping(&self, state: &MainRotorState, air: &Vector3<f64>, rates: &Vector3<f64>, flow: &Flow) -> (f64, f64) {
        let MainRotorState { speed_rad_s, collective_rad, lambda, a1, b1, .. } = *state;
        let per_lag = self.flap_bandwidth * speed_rad_s;
        let s = speed_rad_s * speed_rad_s;
        let d = self.blow_back * (4.0 / 3.0 * collective_rad - lambda) * flow.inverse_tip_speed;
        // The expansion in μ holds well below 1 and its denominator vanishes at √2: a rotor that has all but stopped.
        let mu_squared = flow.mu_squared.min(1.0);
        let dz = self.heave_flap * mu_squared / ((1.0 - 0.5 * mu_squared) * (8.0 * mu_squared.sqrt() + self.lift));
        let back = d * air.x + dz * flow.mu_z + self.longitudinal_gain * s * state.longitudinal_rad;
        let right = -d * air.y + self.lateral_gain * s * state.lateral_rad;
        ((back - a1) * per_lag - rates.y, (right - b1) * per_lag - rates.x)
    }
}
