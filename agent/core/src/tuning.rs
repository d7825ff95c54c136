//! Tuning in flight: values of keys that an operator has set.
//!
//! The settings in force are registers of the orders ([`StandingOrders`]): every agent repeats them, the newest of a key wins, and
//! an agent that joins later learns them. Which of them take effect depends on nothing but the scenario and these registers
//! ([`Scenario::settings_in_effect`]), so agents that know the same settings fly the same formation.
//!
//! New settings wait until every member in contact has repeated them in its heartbeat, so that all begin within the delay of one
//! message; a member that does not repeat them delays them for [`Deadline::SettingBegins`] only. A value then moves to its setting
//! at the key's rate ([`TunableKey::rate_per_s`](skein_common::scenario::TunableKey::rate_per_s)), so that no setpoint jumps.

use alloc::boxed::Box;
use alloc::string::String;
use alloc::vec::Vec;

use skein_common::message::{EventKind, Order, StandingOrders};
use skein_common::scenario::{Scenario, Setting};

use crate::deadlines::Deadline;
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

/// The settings of an operator, and how far they have begun.
#[derive(Clone, Debug, Default)]
struct Tuned {
    /// The settings that have begun.
    begun: StandingOrders,
    /// Time since the first of the others was received, s.
    waited_s: f64,
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

    /// Takes the settings in force, of which `all_know` returns whether all other members know it, and moves the present values
    /// towards them by `dt_s`. Returns the scenario to fly if a value has changed.
    pub fn step(
        &mut self,
        dt_s: f64,
        orders: &StandingOrders,
        all_know: impl Fn(&Order) -> bool,
        happened: &mut Vec<EventKind>,
    ) -> Option<Scenario> {
        if orders.settings().is_empty() {
            return None;
        }
        let Self { written, tuned } = self;
        let tuned = tuned.get_or_insert_default();
        if tuned.begin(dt_s, orders, all_know) {
            tuned.take(written, happened);
        }
        tuned.advance(written, dt_s).then(|| written.with_settings(&tuned.present))
    }

    /// The present values of all keys that were ever set.
    pub fn present(&self) -> &[Setting] {
        self.tuned.as_ref().map_or(&[], |tuned| &tuned.present)
    }
}

impl Tuned {
    /// Begins the new settings, all of them at once, if all know them or have had the time. Returns whether any has begun.
    fn begin(&mut self, dt_s: f64, orders: &StandingOrders, all_know: impl Fn(&Order) -> bool) -> bool {
        let begun = self.begun.settings();
        if begun == orders.settings() {
            self.waited_s = 0.0;
            return false;
        }
        self.waited_s += dt_s.clamp(0.0, LONGEST_STEP_S);
        let mut new = orders.settings().iter().filter(|setting| !begun.contains(setting));
        if !Deadline::SettingBegins.is_past(self.waited_s) && !new.all(|(_, order)| all_know(order)) {
            return false;
        }
        orders.settings().iter().for_each(|(_, order)| _ = self.begun.merge(*order));
        true
    }

    fn take(&mut self, written: &Scenario, happened: &mut Vec<EventKind>) {
        let given = self.begun.settings_in_sequence();
        let found = written.settings_in_effect(&given, |tuned| check(written, tuned));
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
        assert_eq!(tuning.step(0.02, &StandingOrders::default(), |_| true, &mut happened), None);
        let mut orders: StandingOrders = [set(1, "formation.radius_m=80")].into_iter().collect();
        let mut radius_m = 60.0;
        for step in 0..1000 {
            if step == 500 {
                orders.merge(set(2, "formation.radius_m=75"));
            }
            // A pause of the plant is no reason for a jump.
            let dt_s = if step == 100 { 30.0 } else { 0.02 };
            if let Some(tuned) = tuning.step(dt_s, &orders, |_| true, &mut happened) {
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
            (0..4000).fold(None, |last, _| tuning.step(0.02, orders, |_| true, &mut happened).or(last))
        };
        let tuned = fly(&mut tuning, &orders).unwrap();
        assert_eq!((tuned.formation.radius_m, tuned.formation.altitude_m), (60.0, 40.0));
        orders.merge(set(3, "formation.inner_width_m=5"));
        let tuned = fly(&mut tuning, &orders).unwrap();
        assert_eq!((tuned.formation.radius_m, tuned.formation.inner_width_m), (10.0, 5.0));
        assert_eq!(happened, [EventKind::SettingRefused("formation.radius_m=10".parse().unwrap())]);
    }

    #[test]
    fn new_settings_begin_together_when_all_know_them_and_a_silent_member_delays_them_for_a_while_only() {
        let mut happened = Vec::new();
        // The band has to become narrower before the ring can: the first without the second would be refused.
        let [width, radius] = [set(1, "formation.inner_width_m=5"), set(2, "formation.radius_m=15")];
        let orders: StandingOrders = [width, radius].into_iter().collect();
        let mut tuning = Tuning::new(&scenario());
        assert_eq!(tuning.step(0.02, &orders, |order| *order == radius, &mut happened), None);
        assert_eq!(tuning.present(), []);
        let tuned = tuning.step(0.02, &orders, |_| true, &mut happened).unwrap();
        assert!(tuned.formation.radius_m < 60.0 && tuned.formation.inner_width_m < 20.0);
        assert_eq!(happened, []);

        let mut tuning = Tuning::new(&scenario());
        let steps = (1..).find(|_| tuning.step(0.02, &orders, |_| false, &mut happened).is_some()).unwrap();
        assert!((100..=101).contains(&steps), "{steps} steps of 0.02 s");
    }
}
