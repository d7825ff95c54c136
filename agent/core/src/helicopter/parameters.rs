//! What distinguishes one helicopter from another: the `[helicopter]` table of an aircraft file.

use serde::Deserialize;

/// Everything the flight model needs to know of a helicopter. Symbols: Gavrilets, Mettler and Feron (2003).
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Parameters {
    /// m.
    pub mass_kg: f64,
    /// g.
    pub gravity_m_s2: f64,
    /// ρ.
    pub air_density_kg_m3: f64,
    /// η_w, of both rotors' wakes.
    pub wake_contraction: f64,
    /// Moments of inertia; the products are zero.
    pub inertia: Inertia,
    /// Main rotor, clockwise seen from above.
    pub main_rotor: Rotor,
    /// Hub, stabiliser bar and shaft of the main rotor.
    pub head: Head,
    /// Tail rotor, pushing the tail left.
    pub tail_rotor: Rotor,
    /// Where the tail rotor sits and how it is driven.
    pub tail: Tail,
    /// Vertical fin.
    pub fin: Fin,
    /// Horizontal stabiliser.
    pub stabiliser: Stabiliser,
    /// Fuselage.
    pub fuselage: Fuselage,
    /// Engine or motor, and the governor that keeps the rotor speed.
    pub engine: Engine,
    /// Yaw gyro.
    pub gyro: Gyro,
    /// From stick to blade.
    pub servos: Servos,
    /// Contact with the ground.
    pub skids: Skids,
}

/// Moments of inertia about the body axes.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Inertia {
    /// I_xx.
    pub roll_kg_m2: f64,
    /// I_yy.
    pub pitch_kg_m2: f64,
    /// I_zz.
    pub yaw_kg_m2: f64,
}

/// A rotor of two blades.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rotor {
    /// R.
    pub radius_m: f64,
    /// c.
    pub chord_m: f64,
    /// a.
    pub lift_slope_per_rad: f64,
    /// C_D0.
    pub profile_drag: f64,
    /// C_Tmax.
    pub max_thrust_coefficient: f64,
    /// τ_λ.
    pub inflow_lag_s: f64,
    /// h, hub above the centre of gravity.
    pub height_m: f64,
}

/// Hub, stabiliser bar and shaft of the main rotor.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Head {
    /// Ω_nom.
    pub nominal_speed_rad_s: f64,
    /// K_β.
    pub hub_stiffness_n_m_per_rad: f64,
    /// γ_fb, Lock number of the stabiliser bar.
    pub flybar_lock_number: f64,
    /// B_lat, lateral cyclic to disc tilt at nominal speed.
    pub lateral_flap_gain_rad_per_rad: f64,
    /// A_lon, longitudinal cyclic to disc tilt at nominal speed.
    pub longitudinal_flap_gain_rad_per_rad: f64,
    /// K_μ, scaling of the flap response to speed.
    pub speed_flap_scaling: f64,
    /// I_rot, everything that turns with the shaft.
    pub rotational_inertia_kg_m2: f64,
}

/// Where the tail rotor sits and how it is driven.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tail {
    /// n_tr, tail rotor speed over main rotor speed.
    pub gear_ratio: f64,
    /// l_tr, hub behind the centre of gravity.
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
    /// S_vf.
    pub area_m2: f64,
    /// C_Lα,vf.
    pub lift_slope_per_rad: f64,
    /// ε_vf, part of the fin in the tail rotor's wake.
    pub tail_wake_share: f64,
}

/// The horizontal stabiliser.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stabiliser {
    /// S_ht.
    pub area_m2: f64,
    /// C_Lα,ht.
    pub lift_slope_per_rad: f64,
    /// l_ht, behind the centre of gravity.
    pub arm_m: f64,
}

/// Drag areas of the fuselage.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fuselage {
    /// S_x.
    pub forward_area_m2: f64,
    /// S_y.
    pub side_area_m2: f64,
    /// S_z.
    pub vertical_area_m2: f64,
}

/// Engine or motor, idle power zero, and the governor.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Engine {
    /// P_max.
    pub max_power_w: f64,
    /// Kp_gov, throttle over rotor speed error.
    pub governor_gain_s_per_rad: f64,
    /// Ki_gov, throttle over the integral of the rotor speed error.
    pub governor_integral_gain_per_rad: f64,
}

/// The yaw gyro.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gyro {
    /// Tail blade pitch over yaw rate error.
    pub gain_s: f64,
    /// Tail blade pitch over the integral of the yaw rate error.
    pub integral_gain: f64,
    /// Yaw rate at full stick.
    pub max_rate_rad_s: f64,
}

/// From stick to blade.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Servos {
    /// Cyclic blade pitch at full roll or pitch stick.
    pub cyclic_throw_rad: f64,
    /// Collective blade pitch at stick 0.
    pub min_collective_rad: f64,
    /// Collective blade pitch at stick 1.
    pub max_collective_rad: f64,
    /// τ_servo, of each of the three servos.
    pub lag_s: f64,
}

/// Four points of contact with the ground, at (±forward, ±right, down) of the centre of gravity.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Skids {
    /// Before and behind the centre of gravity.
    pub forward_m: f64,
    /// Right and left of it.
    pub right_m: f64,
    /// Below it.
    pub down_m: f64,
    /// k, each point.
    pub stiffness_n_m: f64,
    /// c, each point.
    pub damping_n_s_m: f64,
    /// μ.
    pub friction: f64,
}
