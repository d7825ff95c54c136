//! The main rotor: its forces on the body, its torque and the tilt of its disc.

use super::body::Wrench;
use super::ground;
use super::parameters::Parameters;
use super::rotor::{Flow, Inflow, Rotor};
use super::vector::Vector;
use crate::lanes::{Real, numbers};

numbers! {
    /// The constants of the main rotor.
    #[derive(Clone, Debug, Default)]
    pub(super) struct MainRotor<R> {
        pub(super) rotor: Rotor<R>,
        radius_m: R,
        height_m: R,
        /// Hub stiffness K_β, N m/rad.
        hub_stiffness: R,
        /// Flapping bandwidth per rotor speed, 1/(τ_e Ω) = γ_fb/16.
        flap_bandwidth: R,
        /// Product of lift slope and solidity, aσ.
        lift: R,
        /// Gain of the tilt away from the airspeed, 2 K_μ.
        blow_back: R,
        /// Gain of the tilt by vertical speed, 16 K_μ.
        heave_flap: R,
        /// Cyclic gains A_lon/Ω_nom² and B_lat/Ω_nom².
        longitudinal_gain: R,
        lateral_gain: R,
    }
}

/// The main rotor's components of the state.
#[derive(Clone, Copy, Debug)]
pub(super) struct MainRotorState<R> {
    /// Rotor speed Ω, rad/s.
    pub(super) speed_rad_s: R,
    /// Collective blade pitch θ0, rad.
    pub(super) collective_rad: R,
    /// Cyclic blade pitch δ_lat, δ_lon, rad.
    pub(super) lateral_rad: R,
    pub(super) longitudinal_rad: R,
    /// Inflow ratio λ.
    pub(super) lambda: R,
    /// Tilt of the disc a1 (back) and b1 (right), rad.
    pub(super) a1: R,
    pub(super) b1: R,
}

/// The main rotor's forces, torque and rates of change.
#[derive(Clone, Copy, Debug)]
pub(super) struct MainRotorAction<R> {
    pub(super) wrench: Wrench<R>,
    /// Torque Q, N m.
    pub(super) torque_n_m: R,
    /// Induced speed v_i, m/s.
    pub(super) induced_m_s: R,
    pub(super) inflow: Inflow<R>,
    pub(super) a1_rate: R,
    pub(super) b1_rate: R,
}

impl MainRotor<f64> {
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
}

impl<R: Real> MainRotor<R> {
    /// Forces, moments and rates for the airspeed of the body and its rates (body axes) and the height of the centre of
    /// gravity above the ground; `uprightness` is the vertical component of the mast's direction.
    #[inline(always)]
    pub(super) fn action(
        &self,
        state: &MainRotorState<R>,
        air: Vector<R>,
        rates: Vector<R>,
        height_m: R,
        uprightness: R,
    ) -> MainRotorAction<R> {
        let flow = self.rotor.flow(state.speed_rad_s, air.x * air.x + air.y * air.y, air.z);
        let c_t = self.rotor.thrust_coefficient(state.collective_rad, state.lambda, &flow);
        let c_q = c_t * (state.lambda - flow.mu_z) + self.rotor.profile_torque * (flow.mu_squared * (7.0 / 3.0) + 1.0);
        let torque_n_m = self.rotor.torque_n_m(c_q, &flow);
        let hub_height_m = height_m + self.height_m * uprightness;
        let thrust_n = self.rotor.thrust_n(c_t, &flow) * ground::thrust_factor(self.radius_m, hub_height_m);
        let (a1_rate, b1_rate) = self.flapping(state, air, rates, &flow);
        MainRotorAction {
            wrench: self.wrench(state, thrust_n, torque_n_m),
            torque_n_m,
            induced_m_s: state.lambda * flow.tip_speed_m_s,
            inflow: self.rotor.inflow(c_t, state.lambda, &flow),
            a1_rate,
            b1_rate,
        }
    }

    /// Force and moment on the body: X = −T a1, Y = T b1, Z = −T, L = (K_β + T h) b1, M = (K_β + T h) a1, N = −Q.
    #[inline(always)]
    fn wrench(&self, state: &MainRotorState<R>, t: R, q: R) -> Wrench<R> {
        let stiffness = self.stiffness(t);
        Wrench {
            force: Vector::new(-t * state.a1, t * state.b1, -t),
            moment: Vector::new(stiffness * state.b1, stiffness * state.a1, -q),
        }
    }

    /// Moment on the body per tilt of the disc, K_β + T h_mr, N m/rad.
    #[inline(always)]
    pub(super) fn stiffness(&self, t: R) -> R {
        self.hub_stiffness + t * self.height_m
    }

    /// First-order flapping with the stabiliser bar's lag τ_e = 16/(γ_fb Ω), s = (Ω/Ω_nom)²:
    ///
    /// ```text
    /// ȧ1 = −q + (−a1 + d u/V + dz w/V + A_lon s δ_lon)/τ_e      d  = 2 K_μ (4θ0/3 − λ)
    /// ḃ1 = −p + (−b1 − d v/V          + B_lat s δ_lat)/τ_e      dz = 16 K_μ μ²/((1 − μ²/2)(8μ + aσ))
    /// ```
    ///
    /// Positive a1 tilts the disc back, positive b1 tilts it right. The disc tilts away from the wind on both axes. The
    /// paper prints the lateral term with two minus signs that cancel: sideslip would then be unstable.
    #[inline(always)]
    fn flapping(&self, state: &MainRotorState<R>, air: Vector<R>, rates: Vector<R>, flow: &Flow<R>) -> (R, R) {
        let MainRotorState { speed_rad_s, collective_rad, lambda, a1, b1, .. } = *state;
        let per_lag = self.flap_bandwidth * speed_rad_s;
        let s = speed_rad_s * speed_rad_s;
        let d = self.blow_back * (collective_rad * (4.0 / 3.0) - lambda) * flow.inverse_tip_speed;
        // The expansion in μ holds well below 1, and its denominator vanishes at √2, when the rotor has almost stopped.
        let mu_squared = flow.mu_squared.min(R::splat(1.0));
        let dz =
            self.heave_flap * mu_squared / ((R::splat(1.0) - mu_squared * 0.5) * (mu_squared.sqrt() * 8.0 + self.lift));
        let back = d * air.x + dz * flow.mu_z + self.longitudinal_gain * s * state.longitudinal_rad;
        let right = -d * air.y + self.lateral_gain * s * state.lateral_rad;
        ((back - a1) * per_lag - rates.y, (right - b1) * per_lag - rates.x)
    }
}
