//! The description of one aircraft type: its hover trim, the parameters of its flight model, its controls in X-Plane.

mod profile;

use alloc::boxed::Box;
use alloc::format;
use alloc::string::ToString;

use serde::Deserialize;
use skein_common::scenario::{FileKind, ScenarioError, Source, Written};

use crate::control::{Gains, Trim};
use crate::helicopter::Parameters;
pub use profile::{BadDataref, Dataref, Profile, name_and_element};

/// An aircraft that can be flown: the contents of an aircraft file, `deploy/aircraft/*.toml`.
#[derive(Clone, Debug)]
pub struct Aircraft {
    /// Controls and attitude in a hover without wind.
    pub trim: Trim,
    /// Factors on the movement of each control about its trim.
    pub gains: Gains,
    /// Main rotor speed in flight, rad/s, for an aircraft without a flight model. If neither is given, the agent takes
    /// off without waiting for the rotor.
    pub rotor_speed_rad_s: Option<f64>,
    /// Parameters of the built-in flight model; absent for an aircraft that only X-Plane flies.
    pub helicopter: Option<Parameters>,
    /// Its battery or its tank.
    pub battery: Option<Battery>,
    /// The datarefs of its controls.
    pub xplane: Profile,
}

/// The battery of an aircraft, or its tank. For displays only: a simulated vehicle flies on when it is empty.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Battery {
    /// Energy of a full battery at the main rotor's shaft, Wh.
    pub capacity_wh: f64,
}

/// An aircraft file as written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AircraftFile {
    fit: Option<FitState>,
    trim: Option<Trim>,
    #[serde(default)]
    gains: Gains,
    rotor_speed_rad_s: Option<f64>,
    helicopter: Option<Parameters>,
    battery: Option<Battery>,
    #[serde(default)]
    xplane: Profile,
}

/// Mark of a file without trim, which `skein xplane fit` has to complete.
#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum FitState {
    Required,
}

/// A fault in an aircraft file, with its place: invalid TOML, an unknown key, or parameters that the flight model
/// refuses.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(transparent)]
pub struct AircraftError(pub Box<ScenarioError>);

impl From<ScenarioError> for AircraftError {
    fn from(fault: ScenarioError) -> Self {
        Self(Box::new(fault))
    }
}

/// Share of the flight rotor speed that is required for take-off.
const TAKE_OFF_SHARE: f64 = 0.9;

impl Aircraft {
    /// Rotor speed required for take-off, rad/s, if it is known.
    pub fn take_off_rotor_rad_s(&self) -> Option<f64> {
        let of_model = self.helicopter.as_ref().map(|helicopter| helicopter.head.nominal_speed_rad_s);
        self.rotor_speed_rad_s.or(of_model).map(|speed_rad_s| TAKE_OFF_SHARE * speed_rad_s)
    }

    /// The aircraft files compiled into the program, by name.
    pub const SHIPPED: [(&'static str, &'static str); 1] =
        [("xcell60", include_str!("../../../deploy/aircraft/xcell60.toml"))];

    /// The aircraft files compiled into the program that name the controls of an aircraft of X-Plane, and which
    /// `skein xplane fit` has to complete, by name.
    pub const TO_FIT: [(&'static str, &'static str); 2] = [
        ("r22", include_str!("../../../deploy/aircraft/r22.toml")),
        ("rc-helicopter", include_str!("../../../deploy/aircraft/rc-helicopter.toml")),
    ];

    /// The text of the file of this name, if it is compiled into the program.
    pub fn shipped_text(name: &str) -> Option<&'static str> {
        let mut all = Self::SHIPPED.iter().chain(&Self::TO_FIT);
        all.find(|(shipped, _)| *shipped == name).map(|(_, text)| *text)
    }

    /// The aircraft of this name, if it is compiled into the program.
    pub fn shipped(name: &str) -> Option<Result<Self, AircraftError>> {
        let (name, text) = Self::SHIPPED.iter().find(|(shipped, _)| *shipped == name)?;
        Some(Self::from_text(name, text))
    }

    /// Reads an aircraft from this text; `name` is for messages.
    ///
    /// # Errors
    ///
    /// The first fault in the text, with its line; a file that `skein xplane fit` has to complete first.
    pub fn from_text(name: &str, text: &str) -> Result<Self, AircraftError> {
        let source = Source { name, text };
        let (file, written) = Written::typed::<AircraftFile>(&source, FileKind::Aircraft)?;
        if file.fit.is_some() {
            let stem = name.rsplit(['/', '\\']).next().unwrap_or(name).trim_end_matches(".toml");
            let message = "this aircraft has no trim and no gains yet";
            let remedy = format!(
                "`skein xplane fit my-{stem} --base {stem} --xplane HOST` flies it once and writes my-{stem}.toml, which can be \
                 flown"
            );
            return Err(written.fault("fit", message, Some(remedy)).into());
        }
        let Some(trim) = file.trim else {
            let remedy = Some("add it to the file".to_string());
            return Err(written.fault("trim", "`trim` is missing", remedy).into());
        };
        if let Some(parameters) = &file.helicopter {
            parameters.check().map_err(|error| written.fault(&error.key(), error.to_string(), None))?;
        }
        if let Some(Battery { capacity_wh }) = file.battery
            && !(capacity_wh.is_finite() && capacity_wh > 0.0)
        {
            let message = format!("`battery.capacity_wh` is {capacity_wh}, but has to be finite and greater than 0");
            return Err(written.fault("battery.capacity_wh", message, None).into());
        }
        let AircraftFile { gains, rotor_speed_rad_s, helicopter, battery, xplane, .. } = file;
        Ok(Self { trim, gains, rotor_speed_rad_s, helicopter, battery, xplane })
    }
}

impl Profile {
    /// Reads the datarefs of an aircraft file, whether or not it has been fitted; `name` is for messages.
    ///
    /// # Errors
    ///
    /// The first fault in the text, with its line.
    pub fn from_text(name: &str, text: &str) -> Result<Self, AircraftError> {
        let (file, _) = Written::typed::<AircraftFile>(&Source { name, text }, FileKind::Aircraft)?;
        Ok(file.xplane)
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
    fn an_aircraft_that_was_never_fitted_names_its_controls_and_is_refused_with_the_remedy() {
        for (name, text) in Aircraft::TO_FIT {
            let profile = Profile::from_text(name, text).unwrap();
            assert!(!profile.collective.is_empty() && profile.acf.is_none(), "{name}");
            let refusal = Aircraft::from_text(&format!("lab/{name}.toml"), text).unwrap_err().to_string();
            let remedy = format!("`skein xplane fit my-{name} --base {name} --xplane HOST`");
            assert!(refusal.contains("has no trim") && refusal.contains(&remedy), "{refusal}");
            assert_eq!(Aircraft::shipped_text(name), Some(text));
        }
        let (_, fitted) = Aircraft::SHIPPED[0];
        assert_eq!(Profile::from_text("xcell60", fitted).unwrap(), Profile::default());
        let wrong = Aircraft::from_text("x.toml", "fit = \"later\"").unwrap_err().to_string();
        assert!(wrong.starts_with("x.toml:1:7: `fit`: unknown variant `later`"), "{wrong}");
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
        let rule = "`helicopter.mass_kg` is -8.2, but has to be finite and greater than 0";
        assert_eq!(weightless, format!("my/x.toml:{line}:11: {rule}"));
        let (unknown, line) = refusal("[trim]", "[trim]\nwings = 2");
        let keys = "`roll_stick`, `pitch_stick`, `yaw_stick`, `collective`, `roll_deg`, `pitch_deg`";
        assert_eq!(unknown, format!("my/x.toml:{line}:1: unknown key `trim.wings`; the keys here are {keys}"));
        let (misspelt, line) = refusal("arm_m = 0.91", "amr_m = 0.91");
        let meant = "unknown key `helicopter.tail.amr_m`; did you mean `helicopter.tail.arm_m`?";
        assert_eq!(misspelt, format!("my/x.toml:{line}:1: {meant}"));
        let (no_number, line) = refusal("mass_kg = 8.2", "mass_kg = 'heavy'");
        let no_number_it_is = "`helicopter.mass_kg` has to be a number, not \"heavy\"";
        assert_eq!(no_number, format!("my/x.toml:{line}:11: {no_number_it_is}"));
        let (tilted, line) = refusal("roll_deg = 4.61", "roll_deg = 461");
        assert_eq!(tilted, format!("my/x.toml:{line}:12: `trim.roll_deg` is 461, but has to be within -45 to 45"));
        let (empty, line) = refusal("capacity_wh = 600.0", "capacity_wh = 0.0");
        assert_eq!(
            empty,
            format!("my/x.toml:{line}:15: `battery.capacity_wh` is 0, but has to be finite and greater than 0")
        );
        let (dataref, line) = refusal("[trim]", "[xplane]\nroll = 'a b'\n[trim]");
        assert!(dataref.starts_with(&format!("my/x.toml:{}:8: `xplane.roll`: a dataref is", line - 1)), "{dataref}");
        let no_mass = refusal("mass_kg = 8.2", "# mass_kg = 8.2").0;
        assert!(no_mass.ends_with("`helicopter.mass_kg` is missing; add it to this table"), "{no_mass}");
        let no_yaw = refusal("yaw_kg_m2 = 0.28", "# yaw_kg_m2 = 0.28").0;
        assert!(no_yaw.ends_with("`helicopter.inertia.yaw_kg_m2` is missing; add it to this table"), "{no_yaw}");
        let no_toml = Aircraft::from_text("x.toml", "\n\n[trim").unwrap_err();
        assert!(no_toml.0.line == Some(3) && !no_toml.to_string().contains('\n'), "{no_toml}");
        let without_trim = Aircraft::from_text("x.toml", "").unwrap_err().to_string();
        assert_eq!(without_trim, "x.toml:1:1: `trim` is missing; add it to the file");
        let scenario = Aircraft::from_text("hover.toml", "name = 'x'\n[formation]\n").unwrap_err().to_string();
        let place = "hover.toml:1:1: this is a scenario, not an aircraft file; ";
        assert!(scenario.starts_with(place), "{scenario}");
    }
}
