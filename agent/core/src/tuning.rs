//! Tuning in flight: values of keys that an operator has set.
//!
//! The settings in force are registers of the orders ([`StandingOrders`]): every agent repeats them, the newest of a key wins, and
//! an agent that joins later learns them. Which of them take effect depends on nothing but the scenario and these registers
//! ([`Scenario::settings_in_effect`]), so agents that know the same settings fly the same formation.
//!
//! A value moves to its setting at the key's rate ([`TunableKey::rate_per_s`](skein_common::scenario::TunableKey::rate_per_s)), so
//! that no setpoint jumps, and agents that receive an order at different times are never far apart.

use alloc::boxed::Box;
use alloc::string::String;
use alloc::vec::Vec;

use skein_common::message::{EventKind, Order, StandingOrders};
use skein_common::scenario::{Scenario, Setting};

use crate::formation;

/// Longest time step that counts, s: after a pause of the plant no value jumps.
const LONGEST_STEP_S: f64 = 0.1;

/// The values of the keys of one vehicle that an operator has changed in flight.
#[derive(Clone, Debug)]
pub struct Tuning {
    /// The scenario as written, without the parts on which no formation depends.
    written: Box<Scenario>,
    tuned: Option<Box<Tuned>>,
}

/// What has been set.
#[derive(Clone, Debug, Default)]
struct Tuned {
    /// The settings in force when they were last looked at, with their orders.
    known: Vec<(Setting, Order)>,
    in_effect: Vec<Setting>,
    refused: Vec<Setting>,
    /// Present values of all keys that were ever set.
    present: Vec<Setting>,
}

impl Tuning {
    /// The tuning of a vehicle that flies this scenario as written.
    pub fn new(scenario: &Scenario) -> Self {
        let mut written = scenario.clone();
        (written.vehicle, written.mission.events) = (Vec::new(), Vec::new());
        Self { written: Box::new(written), tuned: None }
    }

    /// Takes the settings in force, and moves the present values towards them by `dt_s`. Returns the scenario to fly if a value
    /// has changed.
    pub fn step(&mut self, dt_s: f64, orders: &StandingOrders, happened: &mut Vec<EventKind>) -> Option<Scenario> {
        if orders.settings().is_empty() {
            return None;
        }
        let Self { written, tuned } = self;
        let tuned = tuned.get_or_insert_default();
        if tuned.known != orders.settings() {
            tuned.take(written, orders, happened);
        }
        tuned.advance(written, dt_s).then(|| written.with_settings(&tuned.present))
    }
}

impl Tuned {
    fn take(&mut self, written: &Scenario, orders: &StandingOrders, happened: &mut Vec<EventKind>) {
        self.known = orders.settings().to_vec();
        let found = written.settings_in_effect(&orders.settings_in_sequence(), |tuned| check(written, tuned));
        let refused: Vec<Setting> = found.refused.into_iter().map(|(setting, _)| setting).collect();
        let new = refused.iter().filter(|setting| !self.refused.contains(setting));
        happened.extend(new.map(|setting| EventKind::SettingRefused(*setting)));
        for Setting { key, .. } in &found.in_effect {
            if !self.present.iter().any(|present| present.key == *key) {
                self.present.push(Setting { key: *key, value: key.value(&written.formation) });
            }
        }
        (self.in_effect, self.refused) = (found.in_effect, refused);
    }

    /// Moves the present values towards those in effect, or back to those written. Returns whether one has changed.
    fn advance(&mut self, written: &Scenario, dt_s: f64) -> bool {
        let Self { in_effect, present, .. } = self;
        let mut has_changed = false;
        for Setting { key, value } in present {
            let set = in_effect.iter().find(|setting| setting.key == *key);
            let target = set.map_or_else(|| key.value(&written.formation), |setting| setting.value);
            let furthest = key.rate_per_s() * dt_s.clamp(0.0, LONGEST_STEP_S);
            let next = if (target - *value).abs() <= furthest {
                target
            } else {
                *value + (target - *value).clamp(-furthest, furthest)
            };
            has_changed |= next != *value;
            *value = next;
        }
        has_changed
    }
}

/// Checks that a tuned scenario can be flown in place of the written one.
///
/// # Errors
/// Why it cannot.
pub fn check(written: &Scenario, tuned: &Scenario) -> Result<(), String> {
    formation::check(tuned).map_err(|why| why.0)?;
    formation::check_airspace(tuned).map_err(|why| why.0)?;
    formation::check_area_of_team(written, tuned).map_err(|why| why.0)
}

#[cfg(test)]
mod tests {
    use skein_common::message::Verb;
    use skein_common::scenario::{Source, load};

    use super::*;

    fn scenario() -> Scenario {
        load(&Source { name: "test.toml", text: "swarm.vehicles = 4\nformation.radius_m = 60" }, &[]).unwrap().scenario
    }

    fn set(epoch: u64, text: &str) -> Order {
        Order { epoch, issuer: 1, verb: Verb::Set(text.parse().unwrap()), vehicles: None, signature: None }
    }

    #[test]
    fn a_value_moves_to_its_setting_at_the_rate_of_its_key_and_stays_there() {
        let (mut tuning, mut happened) = (Tuning::new(&scenario()), Vec::new());
        assert_eq!(tuning.step(0.02, &StandingOrders::default(), &mut happened), None);
        let mut orders: StandingOrders = [set(1, "formation.radius_m=80")].into_iter().collect();
        let mut radius_m = 60.0;
        for step in 0..1000 {
            if step == 500 {
                orders.merge(set(2, "formation.radius_m=75"));
            }
            // A pause of the plant is no reason for a jump.
            let dt_s = if step == 100 { 30.0 } else { 0.02 };
            if let Some(tuned) = tuning.step(dt_s, &orders, &mut happened) {
                let next_m = tuned.formation.radius_m;
                assert!((next_m - radius_m).abs() <= 0.1 + 1e-9, "{radius_m} to {next_m} m");
                assert_eq!(tuned.mission.steps[0].formation.radius_m, next_m);
                radius_m = next_m;
            }
        }
        assert_eq!(radius_m, 75.0);
        assert_eq!(happened, []);
    }

    #[test]
    fn settings_that_cannot_be_flown_are_reported_once_and_the_value_returns() {
        let (mut tuning, mut happened) = (Tuning::new(&scenario()), Vec::new());
        // 10 m are less than the width of the band.
        let mut orders: StandingOrders =
            [set(1, "formation.radius_m=10"), set(2, "formation.altitude_m=40")].into_iter().collect();
        let mut fly = |tuning: &mut Tuning, orders: &StandingOrders| {
            (0..4000).fold(None, |last, _| tuning.step(0.02, orders, &mut happened).or(last))
        };
        let tuned = fly(&mut tuning, &orders).unwrap();
        assert_eq!((tuned.formation.radius_m, tuned.formation.altitude_m), (60.0, 40.0));
        orders.merge(set(3, "formation.inner_width_m=5"));
        let tuned = fly(&mut tuning, &orders).unwrap();
        assert_eq!((tuned.formation.radius_m, tuned.formation.inner_width_m), (10.0, 5.0));
        assert_eq!(happened, [EventKind::SettingRefused("formation.radius_m=10".parse().unwrap())]);
    }
}
