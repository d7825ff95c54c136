//! Checks of a helicopter's parameters: each number by itself, then all together.

use alloc::borrow::ToOwned;
use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use super::dynamics::Dynamics;
use super::parameters::{NumberRule, POSITIVE, Parameters};

/// The reason why the flight model refuses a set of parameters.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ParameterError {
    /// One number is outside its limits.
    #[error("`helicopter.{key}` is {value}, but has to be {rule}")]
    Value {
        /// The key within the `[helicopter]` table.
        key: String,
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

impl Parameters {
    /// Checks that every number is finite and has the sign and size that the model's equations and its integration step
    /// need, and that a helicopter with these parameters can hover.
    ///
    /// # Errors
    ///
    /// The first number outside its limits, or [`ParameterError::CannotHover`].
    pub fn check(&self) -> Result<(), ParameterError> {
        for (key, value, NumberRule(rule, holds)) in self.rules() {
            if !holds(value) {
                return Err(ParameterError::Value { key, value, rule });
            }
        }
        let ordered = [
            ("tail.max_pitch_rad", self.tail.min_pitch_rad, self.tail.max_pitch_rad),
            ("servos.max_collective_rad", self.servos.min_collective_rad, self.servos.max_collective_rad),
        ];
        if let Some((key, _, value)) = ordered.into_iter().find(|(_, min, max)| min >= max) {
            return Err(ParameterError::Value { key: key.to_owned(), value, rule: "greater than its lower end" });
        }
        if Dynamics::new(self, 0.0).can_hover() { Ok(()) } else { Err(ParameterError::CannotHover) }
    }

    /// Each number with its key and its condition.
    fn rules(&self) -> Vec<(String, f64, NumberRule)> {
        let own = [
            ("mass_kg", self.mass_kg),
            ("gravity_m_s2", self.gravity_m_s2),
            ("air_density_kg_m3", self.air_density_kg_m3),
            ("wake_contraction", self.wake_contraction),
        ];
        let tables = [
            ("inertia", self.inertia.rules()),
            ("main_rotor", self.main_rotor.rules()),
            ("head", self.head.rules()),
            ("tail_rotor", self.tail_rotor.rules()),
            ("tail", self.tail.rules()),
            ("fin", self.fin.rules()),
            ("stabiliser", self.stabiliser.rules()),
            ("fuselage", self.fuselage.rules()),
            ("engine", self.engine.rules()),
            ("gyro", self.gyro.rules()),
            ("servos", self.servos.rules()),
            ("skids", self.skids.rules()),
        ];
        let of_table = |(table, rules): (&'static str, Vec<(&'static str, f64, NumberRule)>)| {
            rules.into_iter().map(move |(key, value, rule)| {
                let is_tail_height = (table, key) == ("tail_rotor", "height_m");
                (format!("{table}.{key}"), value, if is_tail_height { POSITIVE } else { rule })
            })
        };
        let own = own.map(|(key, value)| (key.to_owned(), value, POSITIVE));
        own.into_iter().chain(tables.into_iter().flat_map(of_table)).collect()
    }
}

#[cfg(test)]
mod tests;
