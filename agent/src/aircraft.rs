//! What is particular to one type of aircraft: its hover trim, its flight model's parameters, its controls in X-Plane.

use serde::Deserialize;

use crate::control::Trim;
use crate::plant::helicopter::{ParameterError, Parameters};
use crate::plant::xplane::Profile;

/// An aircraft file, `deploy/aircraft/*.toml`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Aircraft {
    /// Controls and attitude in a hover without wind.
    pub trim: Trim,
    /// Main rotor speed in flight, rad/s, for an aircraft without a flight model here; without it the agent does not wait
    /// for the rotor before it takes off.
    pub rotor_speed_rad_s: Option<f64>,
    /// The built-in flight model. An aircraft that only X-Plane flies has none.
    pub helicopter: Option<Parameters>,
    /// Which datarefs are its controls.
    #[serde(default)]
    pub xplane: Profile,
}

/// Why a text is no aircraft.
#[derive(Debug, thiserror::Error)]
pub enum AircraftError {
    /// Not TOML, or not the keys of an aircraft.
    #[error("{0}: {1}")]
    Text(String, Box<toml::de::Error>),
    /// Parameters that no helicopter can have.
    #[error("{0}: {1}")]
    Parameters(String, ParameterError),
}

/// Share of its speed in flight at which a rotor lifts.
const TAKE_OFF_SHARE: f64 = 0.9;

impl Aircraft {
    /// Rotor speed below which nobody takes off, rad/s, if it is known.
    pub fn take_off_rotor_rad_s(&self) -> Option<f64> {
        let of_model = self.helicopter.as_ref().map(|helicopter| helicopter.head.nominal_speed_rad_s);
        self.rotor_speed_rad_s.or(of_model).map(|speed_rad_s| TAKE_OFF_SHARE * speed_rad_s)
    }

    /// The aircraft that come with the program.
    pub const SHIPPED: [(&'static str, &'static str); 1] =
        [("xcell60", include_str!("../../deploy/aircraft/xcell60.toml"))];

    /// The aircraft of this name, if it comes with the program.
    pub fn shipped(name: &str) -> Option<Result<Self, AircraftError>> {
        let (name, text) = Self::SHIPPED.iter().find(|(shipped, _)| *shipped == name)?;
        Some(Self::from_text(name, text))
    }

    /// The aircraft in this text; `name` is for messages.
    pub fn from_text(name: &str, text: &str) -> Result<Self, AircraftError> {
        let aircraft: Self =
            toml::from_str(text).map_err(|error| AircraftError::Text(name.to_owned(), Box::new(error)))?;
        if let Some(parameters) = &aircraft.helicopter {
            parameters.check().map_err(|error| AircraftError::Parameters(name.to_owned(), error))?;
        }
        Ok(aircraft)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_aircraft_loads() {
        for (name, _) in Aircraft::SHIPPED {
            let aircraft = Aircraft::shipped(name).unwrap().unwrap();
            assert!((0.0..1.0).contains(&aircraft.trim.collective), "{name}");
        }
        assert!(Aircraft::shipped("concorde").is_none());
    }

    #[test]
    fn a_wrong_aircraft_is_refused() {
        assert!(Aircraft::from_text("x", "wings = 2").unwrap_err().to_string().contains("wings"));
        let shipped = Aircraft::SHIPPED[0].1;
        let weightless = shipped.replacen("mass_kg = 8.2", "mass_kg = -8.2", 1);
        assert_ne!(weightless, shipped);
        assert!(matches!(Aircraft::from_text("x", &weightless), Err(AircraftError::Parameters(..))));
    }
}
