//! Keys that an operator can change in flight: `skein order set formation.radius_m=80`.
//!
//! A key is here if a vehicle can follow its change without a jump. Every agent moves the value from the present one to the
//! ordered one at a bounded rate.

use std::borrow::Cow;
use std::str::FromStr;

use super::key::{Kind, Range};
use super::keys;
use super::model::{EventAction, Formation, Scenario, ScriptedEvent, ScriptedOrder, ScriptedVerb, Setting, TunableKey};

impl TunableKey {
    /// Range of the value.
    pub fn range(self) -> Range {
        match keys::find(self.path()).map(|key| key.kind) {
            Some(Kind::Number(range) | Kind::NumberOr(_, range)) => range,
            // A test excludes this.
            _ => Range { min: 0.0, max: 0.0, min_included: false },
        }
    }
}

impl Setting {
    /// Whether the value is in the key's range; NaN is not.
    pub fn is_in_range(&self) -> bool {
        self.key.range().contains(self.value)
    }
}

/// The reason why a text is not a setting.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SettingError {
    /// It is not KEY=VALUE.
    #[error("a setting is KEY=VALUE, such as formation.radius_m=80")]
    NoValue,
    /// The key cannot change in flight.
    #[error("`{0}` cannot change in flight; the keys that can: {keys}", keys = paths())]
    NotTunable(String),
    /// No scenario has such a key.
    #[error("unknown key `{0}`; did you mean `{1}`?")]
    Unknown(String, &'static str),
    /// The value is not a number in the key's range.
    #[error("`{0}` is a number, {1}")]
    OutOfRange(&'static str, String),
}

fn paths() -> String {
    TunableKey::PATHS.join(", ")
}

impl FromStr for Setting {
    type Err = SettingError;
    fn from_str(text: &str) -> Result<Self, SettingError> {
        let (path, value) = text.split_once('=').ok_or(SettingError::NoValue)?;
        let (path, value) = (path.trim(), value.trim());
        let key = TunableKey::find(path).ok_or_else(|| {
            let near = keys::nearest_of(TunableKey::PATHS.iter().copied(), path);
            match near.filter(|_| keys::find(path).is_none()) {
                Some(near) => SettingError::Unknown(path.to_owned(), near),
                None => SettingError::NotTunable(path.to_owned()),
            }
        })?;
        let setting = value.parse().ok().map(|value| Self { key, value }).filter(Self::is_in_range);
        setting.ok_or_else(|| SettingError::OutOfRange(key.path(), key.range().to_string()))
    }
}

/// The settings of a swarm that take effect, and those that do not.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Settings {
    /// Those that take effect.
    pub in_effect: Vec<Setting>,
    /// Those that do not, each with the reason.
    pub refused: Vec<(Setting, String)>,
}

impl Scenario {
    /// This scenario with these values. A step whose formation has another value of such a key than `[formation]` keeps its
    /// own.
    #[must_use]
    pub fn with_settings(&self, settings: &[Setting]) -> Self {
        let mut tuned = self.clone();
        for &Setting { key, value } in settings {
            let common = key.value(&self.formation);
            *key.field(&mut tuned.formation) = value;
            for (step, written) in tuned.mission.steps.iter_mut().zip(&self.mission.steps) {
                if key.value(&written.formation) == common {
                    *key.field(&mut step.formation) = value;
                }
            }
        }
        tuned
    }

    /// The formation of this step of the mission, counted from 0, with these values, as [`Self::with_settings`] gives it; `None`
    /// if the mission has no such step.
    pub fn formation_with(&self, step: u32, settings: &[Setting]) -> Option<Cow<'_, Formation>> {
        let written = &self.mission.steps.get(usize::try_from(step).ok()?)?.formation;
        let mut formation = Cow::Borrowed(written);
        for &Setting { key, value } in settings {
            if key.value(written) == key.value(&self.formation) {
                *key.field(formation.to_mut()) = value;
            }
        }
        Some(formation)
    }

    /// The settings that the scenario's events order, each with the index of its event, in the order of their times.
    pub fn scripted_settings(&self) -> Vec<(usize, Setting)> {
        let setting = |(index, event): (usize, &ScriptedEvent)| match event.what {
            EventAction::Order(ScriptedOrder { verb: ScriptedVerb::Set(setting), .. }) => {
                Some((event.at_s, index, setting))
            }
            _ => None,
        };
        let mut all: Vec<_> = self.mission.events.iter().enumerate().filter_map(setting).collect();
        all.sort_by(|(one_s, ..), (other_s, ..)| one_s.total_cmp(other_s));
        all.into_iter().map(|(_, index, setting)| (index, setting)).collect()
    }

    /// Checks each setting that the scenario's events order, together with those in force at that time. `check` returns why a
    /// scenario cannot be flown.
    ///
    /// # Errors
    /// The index of the event and its setting that cannot be flown, and the reason.
    pub fn check_scripted_settings(
        &self,
        check: impl Fn(&Self) -> Result<(), String>,
    ) -> Result<(), (usize, Setting, String)> {
        let mut in_force: Vec<Setting> = Vec::new();
        for (index, setting) in self.scripted_settings() {
            in_force.retain(|earlier| earlier.key != setting.key);
            in_force.push(setting);
            check(&self.with_settings(&in_force)).map_err(|why| (index, setting, why))?;
        }
        Ok(())
    }

    /// Finds the settings that take effect: all of them if they can be flown together. Otherwise they are tried one after the
    /// other, and each that cannot be flown together with those before it is refused. The answer depends on nothing but the
    /// scenario and the settings, so that all agents find the same one. `check` returns why a scenario cannot be flown.
    pub fn settings_in_effect(&self, given: &[Setting], check: impl Fn(&Self) -> Result<(), String>) -> Settings {
        let try_all = |settings: &[Setting]| {
            let tuned = self.with_settings(settings);
            tuned.check_formations().and_then(|()| check(&tuned))
        };
        if given.is_empty() || try_all(given).is_ok() {
            return Settings { in_effect: given.to_vec(), refused: Vec::new() };
        }
        given.iter().fold(Settings::default(), |mut all, setting| {
            all.in_effect.push(*setting);
            if let Err(why) = try_all(&all.in_effect) {
                all.in_effect.pop();
                all.refused.push((*setting, why));
            }
            all
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::{Source, load};
    use super::*;

    fn scenario(text: &str) -> Scenario {
        load(&Source { name: "test.toml", text: &format!("swarm.vehicles = 4\n{text}") }, &[]).unwrap().scenario
    }

    fn set(text: &str) -> Setting {
        text.parse().unwrap()
    }

    #[test]
    fn every_tunable_key_is_a_number_of_the_table_and_its_field() {
        let written = scenario("");
        for &key in TunableKey::ALL {
            let path = key.path();
            assert_eq!(TunableKey::find(path), Some(key));
            assert_eq!(serde_json::to_value(key).unwrap(), path, "its name in recordings");
            assert!(key.rate_per_s() > 0.0 && key.range().max > key.range().min, "{path}");
            let value = key.value(&written.formation) * 1.01 + 0.01;
            let tuned = written.with_settings(&[Setting { key, value }]);
            let loaded = scenario(&format!("{path} = {value}"));
            assert_eq!((&tuned.formation, &tuned.mission), (&loaded.formation, &loaded.mission), "{path}");
        }
    }

    #[test]
    fn a_setting_is_a_key_that_can_change_with_a_number_in_its_range() {
        assert_eq!(set("formation.radius_m=80").to_string(), "formation.radius_m=80");
        assert_eq!(set(" formation.altitude_m = 35.5 ").value, 35.5);
        let refused = |text: &str| text.parse::<Setting>().unwrap_err().to_string();
        assert!(refused("formation.radius_m").starts_with("a setting is KEY=VALUE"));
        assert!(
            refused("formation.law=ring").starts_with("`formation.law` cannot change in flight; the keys that can: ")
        );
        assert_eq!(
            refused("formation.raduis_m=8"),
            "unknown key `formation.raduis_m`; did you mean `formation.radius_m`?"
        );
        for value in ["0", "-3", "1e9", "NaN", "inf", "80m", ""] {
            let why = refused(&format!("formation.radius_m={value}"));
            assert_eq!(why, "`formation.radius_m` is a number, above 0, at most 100000", "{value}");
        }
    }

    #[test]
    fn a_step_with_a_value_of_its_own_keeps_it() {
        let steps = "mission.steps = [{ centre_ne_m = [0, 0] }, { hold_s = 9, formation = { radius_m = 50 } }]";
        let tuned = scenario(steps).with_settings(&[set("formation.radius_m=80"), set("formation.altitude_m=40")]);
        let of = |step: usize| {
            (tuned.mission.steps[step].formation.radius_m, tuned.mission.steps[step].formation.altitude_m)
        };
        assert_eq!((of(0), of(1), tuned.formation.radius_m), ((80.0, 40.0), (50.0, 40.0), 80.0));
        let settings = [set("formation.radius_m=80"), set("formation.altitude_m=40")];
        for (step, flown) in tuned.mission.steps.iter().enumerate() {
            let written = scenario(steps);
            assert_eq!(written.formation_with(step as u32, &settings).as_deref(), Some(&flown.formation));
            assert_eq!(
                written.formation_with(step as u32, &[]).as_deref(),
                Some(&written.mission.steps[step].formation)
            );
        }
        assert_eq!(scenario(steps).formation_with(2, &[]), None);
    }

    #[test]
    fn scripted_settings_are_checked_in_the_order_of_their_times() {
        let event = |at_s: u32, setting: &str| {
            let (key, value) = setting.split_once('=').unwrap();
            format!("{{ at_s = {at_s}, order = \"set\", key = \"{key}\", value = {value} }}")
        };
        let [wide, narrow] = [event(20, "formation.radius_m=15"), event(10, "formation.inner_width_m=5")];
        let written = scenario(&format!("mission.events = [{wide}, {narrow}]"));
        let order: Vec<usize> = written.scripted_settings().into_iter().map(|(index, _)| index).collect();
        assert_eq!(order, [1, 0]);
        let small =
            |scenario: &Scenario| if scenario.formation.radius_m < 20.0 { Err("small".to_owned()) } else { Ok(()) };
        assert_eq!(written.check_scripted_settings(small), Err((0, set("formation.radius_m=15"), "small".to_owned())));
    }

    #[test]
    fn settings_that_cannot_be_flown_together_are_refused_one_after_the_other() {
        let written = scenario("");
        let flyable = |_: &Scenario| Ok(());
        // The band has to be narrower than the ring: the second setting makes the first possible.
        let both = [set("formation.radius_m=15"), set("formation.inner_width_m=5")];
        assert_eq!(written.settings_in_effect(&both, flyable).in_effect, both);
        let found = written.settings_in_effect(&[set("formation.altitude_m=40"), both[0]], flyable);
        assert_eq!(found.in_effect, [set("formation.altitude_m=40")]);
        assert_eq!((found.refused.len(), found.refused[0].0), (1, both[0]));
        assert!(found.refused[0].1.contains("`formation.inner_width_m` is 20, but has to be below"), "{found:?}");
        let none = written.settings_in_effect(&both, |_| Err("no".to_owned()));
        assert_eq!((none.in_effect.len(), none.refused.len()), (0, 2));
    }

    proptest! {
        #[test]
        fn what_takes_effect_can_be_flown_and_depends_on_the_settings_only(
            values in proptest::collection::vec((proptest::sample::select(TunableKey::ALL), 0.0..1.0_f64), 0..8),
        ) {
            let written = scenario("");
            let given: Vec<Setting> = values.iter().map(|&(key, share)| {
                let Range { min, max, .. } = key.range();
                Setting { key, value: min + (max.min(200.0) - min) * (share * 0.999 + 0.001) }
            }).collect();
            let check = |scenario: &Scenario| if scenario.formation.radius_m > 150.0 { Err("far".to_owned()) } else { Ok(()) };
            let found = written.settings_in_effect(&given, check);
            prop_assert_eq!(&written.settings_in_effect(&given, check), &found);
            prop_assert_eq!(found.in_effect.len() + found.refused.len(), given.len());
            let tuned = written.with_settings(&found.in_effect);
            prop_assert!(tuned.check_formations().is_ok() && check(&tuned).is_ok());
        }
    }
}
