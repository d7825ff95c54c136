//! What is particular to one type of aircraft: its hover trim, its flight model's parameters, its controls in X-Plane.

mod profile;

use alloc::borrow::ToOwned;
use alloc::string::String;
use alloc::string::ToString;
use core::ops::Range;

use serde::Deserialize;
use skein_common::scenario::Source;
use toml::de::{DeTable, DeValue};

use crate::control::Trim;
use crate::helicopter::Parameters;
pub use profile::{BadDataref, Dataref, Profile, name_and_element};

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

/// What is wrong with an aircraft file, and where: not TOML, not the keys of an aircraft, or parameters that no helicopter
/// can have.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}:{line}:{column}: {message}")]
pub struct AircraftError {
    /// The file as the caller named it.
    pub file: String,
    /// Counted from 1.
    pub line: usize,
    /// In characters, counted from 1.
    pub column: usize,
    /// What is wrong, in one line.
    pub message: String,
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
        [("xcell60", include_str!("../../../deploy/aircraft/xcell60.toml"))];

    /// The aircraft of this name, if it comes with the program.
    pub fn shipped(name: &str) -> Option<Result<Self, AircraftError>> {
        let (name, text) = Self::SHIPPED.iter().find(|(shipped, _)| *shipped == name)?;
        Some(Self::from_text(name, text))
    }

    /// The aircraft in this text; `name` is for messages.
    pub fn from_text(name: &str, text: &str) -> Result<Self, AircraftError> {
        let fault = |at: usize, message: String| {
            let (line, column) = Source { name, text }.position(at);
            AircraftError { file: name.to_owned(), line, column, message }
        };
        let aircraft: Self = toml::from_str(text).map_err(|error| {
            let at = error.span().map_or(0, |span| span.start);
            fault(at, error.message().replace('\n', " "))
        })?;
        if let Some(parameters) = &aircraft.helicopter {
            parameters.check().map_err(|error| {
                let at = span_of(text, &error.key()).map_or(0, |span| span.start);
                fault(at, error.to_string())
            })?;
        }
        Ok(aircraft)
    }
}

/// Where the value of this dotted key stands in a TOML text; `None` if it is not there.
fn span_of(text: &str, key: &str) -> Option<Range<usize>> {
    let root = DeTable::parse(text).ok()?;
    let mut table = root.get_ref();
    let mut span = None;
    for name in key.split('.') {
        let (_, value) = table.iter().find(|(known, _)| known.get_ref() == name)?;
        span = Some(value.span());
        match value.get_ref() {
            DeValue::Table(inner) => table = inner,
            _ => return span,
        }
    }
    span
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
        let shipped = Aircraft::SHIPPED[0].1;
        let refusal = |from: &str, to: &str| {
            let broken = shipped.replacen(from, to, 1);
            assert_ne!(broken, shipped);
            let line = 1 + broken.lines().position(|line| line.contains(to.lines().last().unwrap())).unwrap();
            (Aircraft::from_text("my/x.toml", &broken).unwrap_err().to_string(), line)
        };
        let (weightless, line) = refusal("mass_kg = 8.2", "mass_kg = -8.2");
        let rule = "helicopter.mass_kg = -8.2: must be finite and greater than 0";
        assert_eq!(weightless, format!("my/x.toml:{line}:11: {rule}"));
        let (unknown, line) = refusal("[trim]", "[trim]\nwings = 2");
        assert!(unknown.starts_with(&format!("my/x.toml:{line}:1: unknown field `wings`")), "{unknown}");
        let (no_number, line) = refusal("mass_kg = 8.2", "mass_kg = 'heavy'");
        assert!(no_number.starts_with(&format!("my/x.toml:{line}:11: invalid type")), "{no_number}");
        let no_toml = Aircraft::from_text("x.toml", "\n\n[trim").unwrap_err();
        assert!(no_toml.line == 3 && !no_toml.to_string().contains('\n'), "{no_toml}");
        let without_trim = Aircraft::from_text("x.toml", "").unwrap_err().to_string();
        assert_eq!(without_trim, "x.toml:1:1: missing field `trim`");
    }
}
