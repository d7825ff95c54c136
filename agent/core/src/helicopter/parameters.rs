//! The parameters of one helicopter type: the `[helicopter]` table of an aircraft file.

use alloc::vec;
use alloc::vec::Vec;

use serde::Deserialize;

/// All parameters of the flight model. Symbols: Gavrilets, Mettler and Feron (2003).
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Parameters {
    /// Mass m.
    pub mass_kg: f64,
    /// Gravity g.
    pub gravity_m_s2: f64,
    /// Air density ρ.
    pub air_density_kg_m3: f64,
    /// Wake contraction η_w of both rotors.
    pub wake_contraction: f64,
    /// Moments of inertia; the products are zero.
    pub inertia: Inertia,
    /// Main rotor, clockwise seen from above.
    pub main_rotor: RotorParameters,
    /// Hub, stabiliser bar and shaft of the main rotor.
    pub head: Head,
    /// Tail rotor, which pushes the tail to the left.
    pub tail_rotor: RotorParameters,
    /// Position and drive of the tail rotor.
    pub tail: TailParameters,
    /// Vertical fin.
    pub fin: Fin,
    /// Horizontal stabiliser.
    pub stabiliser: Stabiliser,
    /// Fuselage.
    pub fuselage: Fuselage,
    /// Engine or motor, with the governor of the rotor speed.
    pub engine: Engine,
    /// Yaw gyro.
    pub gyro: Gyro,
    /// Travel and lag of the servos.
    pub servos: Servos,
    /// Contact with the ground.
    pub skids: Skids,
}

/// The wording of a condition on a number, and its test.
#[derive(Clone, Copy)]
pub(super) struct NumberRule(pub(super) &'static str, pub(super) fn(f64) -> bool);

const ANY: NumberRule = NumberRule("a finite number", f64::is_finite);
pub(super) const POSITIVE: NumberRule =
    NumberRule("finite and greater than 0", |value| value.is_finite() && value > 0.0);
const NOT_NEGATIVE: NumberRule = NumberRule("finite and not negative", |value| value.is_finite() && value >= 0.0);
const LAG: NumberRule = NumberRule("finite and at least 0.01 s, or the integration step is too long for it", |value| {
    value.is_finite() && value >= 0.01
});

/// Declares tables of numbers, each number with its condition; after a `;`, a table may have one more field.
macro_rules! tables {
    ($($(#[$about:meta])* pub struct $name:ident {
        $($(#[$about_field:meta])* $field:ident: $rule:expr),* $(,)? $(; $(#[$about_other:meta])* $other:ident: $type:ty,)?
    })*) => {$(
        #[derive(Clone, Debug, PartialEq, Deserialize)]
        #[serde(deny_unknown_fields)]
        $(#[$about])*
        pub struct $name {
            $($(#[$about_field])* pub $field: f64,)* $($(#[$about_other])* pub $other: $type,)?
        }

        impl $name {
            /// Each number with its key and its condition.
            pub(super) fn rules(&self) -> Vec<(&'static str, f64, NumberRule)> {
                vec![$((stringify!($field), self.$field, $rule)),*]
            }
        }
    )*};
}

tables! {
    /// Moments of inertia about the body axes.
    pub struct Inertia {
        /// Roll moment I_xx.
        roll_kg_m2: POSITIVE,
        /// Pitch moment I_yy.
        pitch_kg_m2: POSITIVE,
        /// Yaw moment I_zz.
        yaw_kg_m2: POSITIVE,
    }

    /// A two-bladed rotor.
    pub struct RotorParameters {
        /// Radius R.
        radius_m: POSITIVE,
        /// Blade chord c.
        chord_m: POSITIVE,
        /// Lift slope a.
        lift_slope_per_rad: POSITIVE,
        /// Profile drag coefficient C_D0.
        profile_drag: NOT_NEGATIVE,
        /// Largest thrust coefficient C_Tmax.
        max_thrust_coefficient: POSITIVE,
        /// Inflow lag τ_λ.
        inflow_lag_s: LAG,
        /// Height h of the hub above the centre of gravity.
        height_m: ANY,
    }

    /// Hub, stabiliser bar and shaft of the main rotor.
    pub struct Head {
        /// Nominal rotor speed Ω_nom.
        nominal_speed_rad_s: POSITIVE,
        /// Hub stiffness K_β.
        hub_stiffness_n_m_per_rad: NOT_NEGATIVE,
        /// Lock number γ_fb of the stabiliser bar.
        flybar_lock_number: POSITIVE,
        /// Disc tilt per lateral cyclic at nominal speed, B_lat.
        lateral_flap_gain_rad_per_rad: NOT_NEGATIVE,
        /// Disc tilt per longitudinal cyclic at nominal speed, A_lon.
        longitudinal_flap_gain_rad_per_rad: NOT_NEGATIVE,
        /// Scaling K_μ of the flap response to airspeed.
        speed_flap_scaling: NOT_NEGATIVE,
        /// Moment of inertia I_rot of everything that turns with the shaft.
        rotational_inertia_kg_m2: POSITIVE,
    }

    /// Position and drive of the tail rotor.
    pub struct TailParameters {
        /// Ratio n_tr of tail rotor speed to main rotor speed.
        gear_ratio: POSITIVE,
        /// Distance l_tr of the hub behind the centre of gravity.
        arm_m: POSITIVE,
        /// Blade pitch θ_t at the lower stop.
        min_pitch_rad: ANY,
        /// Blade pitch θ_t at the upper stop.
        max_pitch_rad: ANY,
    }

    /// The vertical fin, at the tail rotor's hub.
    pub struct Fin {
        /// Area S_vf.
        area_m2: NOT_NEGATIVE,
        /// Lift slope C_Lα,vf.
        lift_slope_per_rad: NOT_NEGATIVE,
        /// Share ε_vf of the fin in the tail rotor's wake.
        tail_wake_share: NOT_NEGATIVE,
    }

    /// The horizontal stabiliser.
    pub struct Stabiliser {
        /// Area S_ht.
        area_m2: NOT_NEGATIVE,
        /// Lift slope C_Lα,ht.
        lift_slope_per_rad: NOT_NEGATIVE,
        /// Distance l_ht behind the centre of gravity.
        arm_m: NOT_NEGATIVE,
    }

    /// Drag areas of the fuselage.
    pub struct Fuselage {
        /// Drag area S_x in forward flow.
        forward_area_m2: NOT_NEGATIVE,
        /// Drag area S_y in sideways flow.
        side_area_m2: NOT_NEGATIVE,
        /// Drag area S_z in vertical flow.
        vertical_area_m2: NOT_NEGATIVE,
    }

    /// Engine or motor with zero idle power, and its governor.
    pub struct Engine {
        /// Maximum power P_max.
        max_power_w: POSITIVE,
        /// Throttle per rotor speed error, Kp_gov.
        governor_gain_s_per_rad: NOT_NEGATIVE,
        /// Throttle per integral of the rotor speed error, Ki_gov.
        governor_integral_gain_per_rad: POSITIVE,
    }

    /// The yaw gyro.
    pub struct Gyro {
        /// Tail blade pitch per yaw rate error.
        gain_s: NOT_NEGATIVE,
        /// Tail blade pitch per integral of the yaw rate error.
        integral_gain: NOT_NEGATIVE,
        /// Yaw rate at full pedal.
        max_rate_rad_s: POSITIVE,
    }

    /// Travel and lag of the servos.
    pub struct Servos {
        /// Cyclic blade pitch at full roll or pitch control.
        cyclic_throw_rad: POSITIVE,
        /// Collective blade pitch at collective control 0.
        min_collective_rad: ANY,
        /// Collective blade pitch at collective control 1.
        max_collective_rad: ANY,
        /// Lag τ_servo of each of the three servos.
        lag_s: LAG;
        /// Controls that work in the opposite direction; none if the table is missing.
        #[serde(default)]
        reversed: Reversed,
    }

    /// Four points of ground contact, at (±forward, ±right, down) from the centre of gravity.
    pub struct Skids {
        /// Distance before and behind the centre of gravity.
        forward_m: POSITIVE,
        /// Distance right and left of the centre of gravity.
        right_m: POSITIVE,
        /// Distance below the centre of gravity.
        down_m: POSITIVE,
        /// Stiffness k of each point.
        stiffness_n_m: POSITIVE,
        /// Damping c of each point.
        damping_n_s_m: NOT_NEGATIVE,
        /// Friction coefficient μ.
        friction: NOT_NEGATIVE,
    }
}

impl Parameters {
    /// Lateral cyclic blade pitch at full roll control, rad, positive right.
    pub fn lateral_throw_rad(&self) -> f64 {
        signed(self.servos.cyclic_throw_rad, self.servos.reversed.roll)
    }

    /// Longitudinal cyclic blade pitch at full pitch control, rad, positive aft.
    pub fn longitudinal_throw_rad(&self) -> f64 {
        signed(self.servos.cyclic_throw_rad, self.servos.reversed.pitch)
    }

    /// Yaw rate at full yaw control, rad/s, positive to the right.
    pub fn yaw_rate_rad_s(&self) -> f64 {
        signed(self.gyro.max_rate_rad_s, self.servos.reversed.yaw)
    }
}

fn signed(size: f64, is_reversed: bool) -> f64 {
    if is_reversed { -size } else { size }
}

/// Controls of an aircraft that work in the opposite direction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Reversed {
    /// A positive roll control rolls left.
    pub roll: bool,
    /// A positive pitch control lowers the nose.
    pub pitch: bool,
    /// A positive yaw control turns the nose left.
    pub yaw: bool,
}
