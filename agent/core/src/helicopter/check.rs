//! Checks of a helicopter's parameters: each number by itself, then all together.

use alloc::borrow::ToOwned;
use alloc::format;
use alloc::string::String;

use super::dynamics::Dynamics;
use super::parameters::Parameters;

/// Why the flight model refuses a set of parameters.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ParameterError {
    /// One number is outside its limits.
    #[error("`helicopter.{key}` is {value}, but has to be {rule}")]
    Value {
        /// The key within the `[helicopter]` table.
        key: &'static str,
        /// The refused value.
        value: f64,
        /// The condition the value violates.
        rule: &'static str,
    },
    /// Each number is within its limits, but together they do not allow a hover.
    #[error("`helicopter` cannot hover with these parameters: it lacks engine power or tail rotor thrust")]
    CannotHover,
}

impl ParameterError {
    /// The dotted key at fault, as spelled in an aircraft file.
    pub fn key(&self) -> String {
        match self {
            Self::Value { key, .. } => format!("helicopter.{key}"),
            Self::CannotHover => "helicopter".to_owned(),
        }
    }
}

/// A condition on a number: its wording in messages, and its test.
struct Rule(&'static str, fn(f64) -> bool);

const ANY: Rule = Rule("a finite number", f64::is_finite);
const POSITIVE: Rule = Rule("finite and greater than 0", |value| value.is_finite() && value > 0.0);
const NOT_NEGATIVE: Rule = Rule("finite and not negative", |value| value.is_finite() && value >= 0.0);
const LAG: Rule = Rule("finite and at least 0.01 s, or the integration step is too long for it", |value| {
    value.is_finite() && value >= 0.01
});

impl Parameters {
    /// Checks that every number is finite and has the sign and size that the model's equations and its integration step
    /// need, and that a helicopter with these parameters can hover.
    ///
    /// # Errors
    ///
    /// The first number outside its limits, or [`ParameterError::CannotHover`].
    pub fn check(&self) -> Result<(), ParameterError> {
        for (key, value, Rule(rule, holds)) in self.rules() {
            if !holds(value) {
                return Err(ParameterError::Value { key, value, rule });
            }
        }
        let ordered = [
            ("tail.max_pitch_rad", self.tail.min_pitch_rad, self.tail.max_pitch_rad),
            ("servos.max_collective_rad", self.servos.min_collective_rad, self.servos.max_collective_rad),
        ];
        if let Some((key, _, value)) = ordered.into_iter().find(|(_, min, max)| min >= max) {
            return Err(ParameterError::Value { key, value, rule: "greater than its lower end" });
        }
        if Dynamics::new(self, 0.0).can_hover() { Ok(()) } else { Err(ParameterError::CannotHover) }
    }

    /// Each number with its key and its condition.
    #[rustfmt::skip]
    fn rules(&self) -> [(&'static str, f64, Rule); 57] {
        let Self { inertia, main_rotor: main, tail_rotor, head, tail, fin, stabiliser, fuselage, .. } = self;
        let Self { engine, gyro, servos, skids, .. } = self;
        [
            ("mass_kg", self.mass_kg, POSITIVE),
            ("gravity_m_s2", self.gravity_m_s2, POSITIVE),
            ("air_density_kg_m3", self.air_density_kg_m3, POSITIVE),
            ("wake_contraction", self.wake_contraction, POSITIVE),
            ("inertia.roll_kg_m2", inertia.roll_kg_m2, POSITIVE),
            ("inertia.pitch_kg_m2", inertia.pitch_kg_m2, POSITIVE),
            ("inertia.yaw_kg_m2", inertia.yaw_kg_m2, POSITIVE),
            ("main_rotor.radius_m", main.radius_m, POSITIVE),
            ("main_rotor.chord_m", main.chord_m, POSITIVE),
            ("main_rotor.lift_slope_per_rad", main.lift_slope_per_rad, POSITIVE),
            ("main_rotor.profile_drag", main.profile_drag, NOT_NEGATIVE),
            ("main_rotor.max_thrust_coefficient", main.max_thrust_coefficient, POSITIVE),
            ("main_rotor.inflow_lag_s", main.inflow_lag_s, LAG),
            ("main_rotor.height_m", main.height_m, ANY),
            ("head.nominal_speed_rad_s", head.nominal_speed_rad_s, POSITIVE),
            ("head.hub_stiffness_n_m_per_rad", head.hub_stiffness_n_m_per_rad, NOT_NEGATIVE),
            ("head.flybar_lock_number", head.flybar_lock_number, POSITIVE),
            ("head.lateral_flap_gain_rad_per_rad", head.lateral_flap_gain_rad_per_rad, NOT_NEGATIVE),
            ("head.longitudinal_flap_gain_rad_per_rad", head.longitudinal_flap_gain_rad_per_rad, NOT_NEGATIVE),
            ("head.speed_flap_scaling", head.speed_flap_scaling, NOT_NEGATIVE),
            ("head.rotational_inertia_kg_m2", head.rotational_inertia_kg_m2, POSITIVE),
            ("tail_rotor.radius_m", tail_rotor.radius_m, POSITIVE),
            ("tail_rotor.chord_m", tail_rotor.chord_m, POSITIVE),
            ("tail_rotor.lift_slope_per_rad", tail_rotor.lift_slope_per_rad, POSITIVE),
            ("tail_rotor.profile_drag", tail_rotor.profile_drag, NOT_NEGATIVE),
            ("tail_rotor.max_thrust_coefficient", tail_rotor.max_thrust_coefficient, POSITIVE),
            ("tail_rotor.inflow_lag_s", tail_rotor.inflow_lag_s, LAG),
            ("tail_rotor.height_m", tail_rotor.height_m, POSITIVE),
            ("tail.gear_ratio", tail.gear_ratio, POSITIVE),
            ("tail.arm_m", tail.arm_m, POSITIVE),
            ("tail.min_pitch_rad", tail.min_pitch_rad, ANY),
            ("tail.max_pitch_rad", tail.max_pitch_rad, ANY),
            ("fin.area_m2", fin.area_m2, NOT_NEGATIVE),
            ("fin.lift_slope_per_rad", fin.lift_slope_per_rad, NOT_NEGATIVE),
            ("fin.tail_wake_share", fin.tail_wake_share, NOT_NEGATIVE),
            ("stabiliser.area_m2", stabiliser.area_m2, NOT_NEGATIVE),
            ("stabiliser.lift_slope_per_rad", stabiliser.lift_slope_per_rad, NOT_NEGATIVE),
            ("stabiliser.arm_m", stabiliser.arm_m, NOT_NEGATIVE),
            ("fuselage.forward_area_m2", fuselage.forward_area_m2, NOT_NEGATIVE),
            ("fuselage.side_area_m2", fuselage.side_area_m2, NOT_NEGATIVE),
            ("fuselage.vertical_area_m2", fuselage.vertical_area_m2, NOT_NEGATIVE),
            ("engine.max_power_w", engine.max_power_w, POSITIVE),
            ("engine.governor_gain_s_per_rad", engine.governor_gain_s_per_rad, NOT_NEGATIVE),
            ("engine.governor_integral_gain_per_rad", engine.governor_integral_gain_per_rad, POSITIVE),
            ("gyro.gain_s", gyro.gain_s, NOT_NEGATIVE),
            ("gyro.integral_gain", gyro.integral_gain, NOT_NEGATIVE),
            ("gyro.max_rate_rad_s", gyro.max_rate_rad_s, POSITIVE),
            ("servos.cyclic_throw_rad", servos.cyclic_throw_rad, POSITIVE),
            ("servos.min_collective_rad", servos.min_collective_rad, ANY),
            ("servos.max_collective_rad", servos.max_collective_rad, ANY),
            ("servos.lag_s", servos.lag_s, LAG),
            ("skids.forward_m", skids.forward_m, POSITIVE),
            ("skids.right_m", skids.right_m, POSITIVE),
            ("skids.down_m", skids.down_m, POSITIVE),
            ("skids.stiffness_n_m", skids.stiffness_n_m, POSITIVE),
            ("skids.damping_n_s_m", skids.damping_n_s_m, NOT_NEGATIVE),
            ("skids.friction", skids.friction, NOT_NEGATIVE),
        ]
    }
}

#[cfg(test)]
mod tests;
