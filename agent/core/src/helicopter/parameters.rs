//! The parameters of one helicopter type: the `[helicopter]` table of an aircraft file.

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
    pub main_rotor: Rotor,
    /// Hub, stabiliser bar and shaft of the main rotor.
    pub head: Head,
    /// Tail rotor, which pushes the tail to the left.
    pub tail_rotor: Rotor,
    /// Position and drive of the tail rotor.
    pub tail: Tail,
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

/// Moments of inertia about the body axes.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Inertia {
    /// Roll moment I_xx.
    pub roll_kg_m2: f64,
    /// Pitch moment I_yy.
    pub pitch_kg_m2: f64,
    /// Yaw moment I_zz.
    pub yaw_kg_m2: f64,
}

/// A two-bladed rotor.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rotor {
    /// Radius R.
    pub radius_m: f64,
    /// Blade chord c.
    pub chord_m: f64,
    /// Lift slope a.
    pub lift_slope_per_rad: f64,
    /// Profile drag coefficient C_D0.
    pub profile_drag: f64,
    /// Largest thrust coefficient C_Tmax.
    pub max_thrust_coefficient: f64,
    /// Inflow lag τ_λ.
    pub inflow_lag_s: f64,
    /// Height h of the hub above the centre of gravity.
    pub height_m: f64,
}

/// Hub, stabiliser bar and shaft of the main rotor.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Head {
    /// Nominal rotor speed Ω_nom.
    pub nominal_speed_rad_s: f64,
    /// Hub stiffness K_β.
    pub hub_stiffness_n_m_per_rad: f64,
    /// Lock number γ_fb of the stabiliser bar.
    pub flybar_lock_number: f64,
    /// Disc tilt per lateral cyclic at nominal speed, B_lat.
    pub lateral_flap_gain_rad_per_rad: f64,
    /// Disc tilt per longitudinal cyclic at nominal speed, A_lon.
    pub longitudinal_flap_gain_rad_per_rad: f64,
    /// Scaling K_μ of the flap response to airspeed.
    pub speed_flap_scaling: f64,
    /// Moment of inertia I_rot of everything that turns with the shaft.
    pub rotational_inertia_kg_m2: f64,
}

/// Position and drive of the tail rotor.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tail {
    /// Ratio n_tr of tail rotor speed to main rotor speed.
    pub gear_ratio: f64,
    /// Distance l_tr of the hub behind the centre of gravity.
    pub arm_m: f64,
    /// Blade pitch θ_t at the lower stop.
    pub min_pitch_rad: f64,
    /// Blade pitch θ_t at the upper stop.
    pub max_pitch_rad: f64,
}

/// The vertical fin, at the tail rotor's hub.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fin {
    /// Area S_vf.
    pub area_m2: f64,
    /// Lift slope C_Lα,vf.
    pub lift_slope_per_rad: f64,
    /// Share ε_vf of the fin in the tail rotor's wake.
    pub tail_wake_share: f64,
}

/// The horizontal stabiliser.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stabiliser {
    /// Area S_ht.
    pub area_m2: f64,
    /// Lift slope C_Lα,ht.
    pub lift_slope_per_rad: f64,
    /// Distance l_ht behind the centre of gravity.
    pub arm_m: f64,
}

/// Drag areas of the fuselage.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fuselage {
    /// Drag area S_x in forward flow.
    pub forward_area_m2: f64,
    /// Drag area S_y in sideways flow.
    pub side_area_m2: f64,
    /// Drag area S_z in vertical flow.
    pub vertical_area_m2: f64,
}

/// Engine or motor with zero idle power, and its governor.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Engine {
    /// Maximum power P_max.
    pub max_power_w: f64,
    /// Throttle per rotor speed error, Kp_gov.
    pub governor_gain_s_per_rad: f64,
    /// Throttle per integral of the rotor speed error, Ki_gov.
    pub governor_integral_gain_per_rad: f64,
}

/// The yaw gyro.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gyro {
    /// Tail blade pitch per yaw rate error.
    pub gain_s: f64,
    /// Tail blade pitch per integral of the yaw rate error.
    pub integral_gain: f64,
    /// Yaw rate at full pedal.
    pub max_rate_rad_s: f64,
}

/// Travel and lag of the servos.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Servos {
    /// Cyclic blade pitch at full roll or pitch control.
    pub cyclic_throw_rad: f64,
    /// Collective blade pitch at collective control 0.
    pub min_collective_rad: f64,
    /// Collective blade pitch at collective control 1.
    pub max_collective_rad: f64,
    /// Lag τ_servo of each of the three servos.
    pub lag_s: f64,
    /// Controls that work in the opposite direction; none if the table is missing.
    #[serde(default)]
    pub reversed: Reversed,
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

/// Four points of ground contact, at (±forward, ±right, down) from the centre of gravity.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Skids {
    /// Distance before and behind the centre of gravity.
    pub forward_m: f64,
    /// Distance right and left of the centre of gravity.
    pub right_m: f64,
    /// Distance below the centre of gravity.
    pub down_m: f64,
    /// Stiffness k of each point.
    pub stiffness_n_m: f64,
    /// Damping c of each point.
    pub damping_n_s_m: f64,
    /// Friction coefficient μ.
    pub friction: f64,
}
