//! The datarefs of an aircraft's controls and read-backs: the `[xplane]` table of an aircraft file.

use alloc::borrow::ToOwned;
use alloc::collections::BTreeMap;
use alloc::string::String;
use alloc::vec;
use alloc::vec::Vec;

use serde::Deserialize;

/// The path of one dataref, or of one element of an array: `path[n]`. 1 to 399 printable ASCII characters, so that it
/// fits every message.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(try_from = "String")]
pub struct Dataref(String);

/// A text that is not a dataref.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a dataref is 1 to 399 printable ASCII characters without spaces, an array's element `path[n]`; {0:?} is not")]
pub struct BadDataref(pub String);

impl Dataref {
    /// Checks a path.
    ///
    /// # Errors
    ///
    /// A path that is not a dataref.
    pub fn new(path: impl Into<String>) -> Result<Self, BadDataref> {
        let path = path.into();
        let fits = (1..=399).contains(&path.len()) && path.bytes().all(|byte| byte.is_ascii_graphic());
        if fits && name_and_element(&path).is_some() { Ok(Self(path)) } else { Err(BadDataref(path)) }
    }

    /// The path as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// Name and element of `name[element]`; a scalar is its own element 0. `None` if the brackets do not hold a number.
pub fn name_and_element(path: &str) -> Option<(&str, usize)> {
    let Some(inner) = path.strip_suffix(']') else { return Some((path, 0)) };
    let (name, index) = inner.rsplit_once('[')?;
    let digits = !index.is_empty() && index.bytes().all(|byte| byte.is_ascii_digit());
    if name.is_empty() || !digits { None } else { Some((name, index.parse().ok()?)) }
}

impl TryFrom<String> for Dataref {
    type Error = BadDataref;
    fn try_from(path: String) -> Result<Self, BadDataref> {
        Self::new(path)
    }
}

/// The datarefs through which one aircraft is flown over UDP. Keys missing in a file have the values of
/// [`Profile::default`].
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Profile {
    /// Set to 1 while the agent flies, refreshed, and set to 0 when it releases the controls.
    pub overrides: Vec<Dataref>,
    /// Lateral cyclic, −1 to 1, positive right.
    pub roll: Dataref,
    /// Longitudinal cyclic, −1 to 1, positive aft, nose up.
    pub pitch: Dataref,
    /// Pedals, −1 to 1, positive right.
    pub yaw: Dataref,
    /// Collective, 0 down to 1 up; all of them are written.
    pub collective: Vec<Dataref>,
    /// Held at these values while the agent flies and refreshed with the overrides; not changed afterwards.
    pub hold: BTreeMap<Dataref, f32>,
    /// Main rotor speed in revolutions per minute.
    pub rotor_speed_rpm: Dataref,
    /// A part of the path of the aircraft's file as X-Plane reports it in `acf_relative_path`, by which a check recognises
    /// the aircraft; `None`: any aircraft.
    pub acf: Option<String>,
}

impl Profile {
    /// All datarefs of the profile, each once: overrides, controls, those held, the rotor speed.
    pub fn datarefs(&self) -> Vec<&Dataref> {
        let controls = [&self.roll, &self.pitch, &self.yaw];
        let moved = self.overrides.iter().chain(controls).chain(&self.collective);
        let mut all = Vec::new();
        for dataref in moved.chain(self.hold.keys()).chain([&self.rotor_speed_rpm]) {
            if !all.contains(&dataref) {
                all.push(dataref);
            }
        }
        all
    }
}

impl Default for Profile {
    /// A helicopter of X-Plane 11 or 12 whose own governor keeps the rotor speed once its engine runs. The cyclic is
    /// driven as in ArduPilot (three yoke ratios under `override_joystick`, collective on the propeller lever). The
    /// agent holds the throttle lever open: X-Plane's governor then regulates the rotor speed.
    fn default() -> Self {
        let dataref = |path: &str| Dataref(path.to_owned());
        Self {
            overrides: vec![dataref("sim/operation/override/override_joystick")],
            roll: dataref("sim/joystick/yoke_roll_ratio"),
            pitch: dataref("sim/joystick/yoke_pitch_ratio"),
            yaw: dataref("sim/joystick/yoke_heading_ratio"),
            collective: vec![dataref("sim/cockpit2/engine/actuators/prop_ratio[0]")],
            hold: BTreeMap::from([
                (dataref("sim/cockpit2/engine/actuators/governor_on[0]"), 1.0),
                (dataref("sim/cockpit2/engine/actuators/throttle_ratio_all"), 1.0),
            ]),
            rotor_speed_rpm: dataref("sim/cockpit2/engine/indicators/prop_speed_rpm[0]"),
            acf: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_overrides_only_what_it_names() {
        let profile: Profile = toml::from_str(
            r#"
            collective = ["sim/cockpit2/engine/actuators/prop_ratio[0]", "laminar/r22/rotor_collective_ratio"]
            [hold]
            "sim/cockpit2/switches/clutch_engage" = 1
            "#,
        )
        .unwrap();
        assert_eq!(profile.collective[1].as_str(), "laminar/r22/rotor_collective_ratio");
        assert_eq!(profile.hold.len(), 1);
        assert_eq!(
            Profile { collective: Profile::default().collective, hold: Profile::default().hold, ..profile },
            Profile::default()
        );
    }

    #[test]
    fn invalid_datarefs_and_keys_are_refused() {
        for bad in
            ["rol = 'a'", "roll = ''", "roll = 'a b'", "roll = 'a[x]'", "collective = 'a'", "hold = 3", "roll = 'a[]'"]
        {
            assert!(toml::from_str::<Profile>(bad).is_err(), "{bad}");
        }
        assert!(Dataref::new("x".repeat(399)).is_ok());
        assert!(Dataref::new("x".repeat(400)).is_err());
        assert!(Dataref::new("ü").is_err());
    }

    #[test]
    fn every_default_is_a_dataref() {
        let Profile { overrides, roll, pitch, yaw, collective, hold, rotor_speed_rpm, acf: _ } = Profile::default();
        let all =
            overrides.into_iter().chain([roll, pitch, yaw, rotor_speed_rpm]).chain(collective).chain(hold.into_keys());
        for dataref in all {
            assert_eq!(Dataref::new(dataref.as_str()), Ok(dataref));
        }
    }

    #[test]
    fn a_scalar_may_be_called_its_own_first_element() {
        assert_eq!(name_and_element("a/b"), Some(("a/b", 0)));
        assert_eq!(name_and_element("a/b[0]"), Some(("a/b", 0)));
        assert_eq!(name_and_element("a/b[12]"), Some(("a/b", 12)));
        for nonsense in ["a]", "a[]", "a[-1]", "[1]", "a[+1]", "a[99999999999999999999999]"] {
            assert!(name_and_element(nonsense).is_none(), "{nonsense}");
        }
    }
}
