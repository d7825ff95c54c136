//! Compares what every vehicle did before an order and does after it, according to the heartbeats.

use std::collections::BTreeMap;
use std::fmt;

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::{Order, Verb};
use skein_common::scenario::{Scenario, Target};
use skein_common::state::Membership;

use crate::mesh::observe::Observer;

/// Longest list of steps that is printed in full.
const MAX_LISTED: usize = 12;

/// The activity of a vehicle, as far as an order can change it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Activity {
    /// It is joining: not an active member yet.
    Joining,
    /// It flies this step of the mission.
    Step(u32),
    /// It holds position at this step.
    Held(u32),
    /// It lands or has landed because of an order, which another order can undo.
    Landing,
    /// It lands or has landed because of an abort, which no order can undo.
    Aborted,
    /// A human pilot flies it by an order.
    Released,
    /// It lands or has landed because its mission has ended or part of it has failed.
    Out,
}

impl Activity {
    /// The activity that a heartbeat with this membership and step shows of a vehicle that obeys this order.
    pub(super) fn of(membership: Membership, step: u32, order: Option<Order>) -> Self {
        let is_alone = order.is_some_and(|order| order.vehicles.is_some());
        match (membership, order.map(|order| order.verb)) {
            (_, Some(Verb::Release)) => Self::Released,
            (_, Some(Verb::Abort)) => Self::Aborted,
            (_, Some(Verb::Land)) => Self::Landing,
            (Membership::Left, _) => Self::Out,
            (Membership::Joining, Some(Verb::Hold)) if is_alone => Self::Held(step),
            (Membership::Joining, _) => Self::Joining,
            (Membership::Active, Some(Verb::Hold)) => Self::Held(step),
            (Membership::Active, _) => Self::Step(step),
        }
    }
}

impl fmt::Display for Activity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Joining => f.write_str("joining"),
            Self::Step(step) => write!(f, "step {step}"),
            Self::Held(step) => write!(f, "held at step {step}"),
            Self::Landing => f.write_str("landing"),
            Self::Aborted => f.write_str("aborted"),
            Self::Released => f.write_str("released"),
            Self::Out => f.write_str("landing on its own"),
        }
    }
}

/// The present activity of each of these vehicles that is in contact; without a set, of all vehicles.
pub(super) fn activities(observer: &Observer, vehicles: Option<VehicleSet>) -> BTreeMap<VehicleId, Activity> {
    let is_asked = |id: VehicleId| vehicles.is_none_or(|vehicles| vehicles.contains(id));
    let there = observer.vehicles().iter().filter(|(id, view)| view.alive && is_asked(**id));
    let activity = there.filter_map(|(id, view)| {
        let mission = view.mission.as_ref()?;
        Some((*id, Activity::of(mission.membership, mission.step, view.orders.obeyed_by(*id))))
    });
    activity.collect()
}

/// The effect of an order.
#[derive(Default)]
pub(super) struct Effect {
    /// For each vehicle in contact after the order: what it did before, if that is known, and what it does now.
    changes: BTreeMap<VehicleId, (Option<Activity>, Activity)>,
}

impl Effect {
    pub(super) fn of(before: &BTreeMap<VehicleId, Activity>, after: BTreeMap<VehicleId, Activity>) -> Self {
        Self { changes: after.into_iter().map(|(id, after)| (id, (before.get(&id).copied(), after))).collect() }
    }

    /// The activity of each vehicle in contact before the order, if that is known, and now.
    pub(super) fn as_texts(&self) -> impl Iterator<Item = (VehicleId, Option<String>, String)> {
        let text = |(id, (before, after)): (&VehicleId, &(Option<Activity>, Activity))| {
            (*id, before.map(|before| before.to_string()), after.to_string())
        };
        self.changes.iter().map(text)
    }

    /// Whether any vehicle does something else than before the order.
    pub(super) fn is_any(&self) -> bool {
        self.changes.values().any(|(before, after)| *before != Some(*after))
    }

    /// Whether every vehicle does something else than before the order.
    pub(super) fn is_all(&self) -> bool {
        self.changes.values().all(|(before, after)| *before != Some(*after))
    }
}

impl fmt::Display for Effect {
    /// `vehicle 1-4: step 2 -> step 5; vehicle 5: landing on its own, as before`
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut groups = BTreeMap::<_, Vec<VehicleId>>::new();
        for (id, change) in &self.changes {
            groups.entry(change).or_default().push(*id);
        }
        let mut groups: Vec<_> = groups.into_iter().collect();
        groups.sort_by(|(_, one), (_, other)| one.cmp(other));
        let parts = groups.iter().map(|((before, after), ids)| {
            let ids = ranges(ids);
            match before {
                Some(before) if before == after => format!("vehicle {ids}: {after}, as before"),
                Some(before) => format!("vehicle {ids}: {before} -> {after}"),
                None => format!("vehicle {ids}: {after}"),
            }
        });
        f.write_str(&parts.collect::<Vec<_>>().join("; "))
    }
}

/// Formats sorted ids as ranges: `1-4, 6`.
pub fn ranges(ids: &[VehicleId]) -> String {
    let runs = ids.chunk_by(|one, next| next.get() - one.get() == 1);
    let parts = runs.map(|run| match run {
        [first, .., last] if run.len() > 2 => format!("{first}-{last}"),
        few => few.iter().map(VehicleId::to_string).collect::<Vec<_>>().join(", "),
    });
    parts.collect::<Vec<_>>().join(", ")
}

/// The error text if the mission has no such step, with the steps that it has.
pub(super) fn missing_step(scenario: &Scenario, step: u32) -> Option<String> {
    let steps = &scenario.mission.steps;
    if (step as usize) < steps.len() {
        return None;
    }
    let name = |(nth, step): (usize, &skein_common::scenario::Step)| match (&step.name, &step.target) {
        (Some(name), _) => format!("{nth} ({name})"),
        (None, Target::Land(_)) => format!("{nth} (land)"),
        (None, _) => nth.to_string(),
    };
    let which = match steps.len() {
        1 => format!("its only step is {}", name((0, steps.first()?))),
        few if few <= MAX_LISTED => {
            format!("its steps are {}", steps.iter().enumerate().map(name).collect::<Vec<_>>().join(", "))
        }
        many => format!("its steps are 0 to {}", many - 1),
    };
    Some(format!("the mission has no step {step}: {which}"))
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::{Source, load};

    use super::*;

    fn ids(numbers: &[u8]) -> Vec<VehicleId> {
        numbers.iter().map(|number| VehicleId::new(*number).unwrap()).collect()
    }

    #[test]
    fn vehicles_with_the_same_change_are_printed_together() {
        let all =
            |activity: &[Activity]| (1..).map(|id| VehicleId::new(id).unwrap()).zip(activity.iter().copied()).collect();
        let before = all(&[Activity::Step(2), Activity::Step(2), Activity::Step(2), Activity::Held(2), Activity::Out]);
        let after = all(&[
            Activity::Step(5),
            Activity::Step(5),
            Activity::Step(5),
            Activity::Step(5),
            Activity::Out,
            Activity::Joining,
        ]);
        let effect = Effect::of(&before, after);
        let expected = "vehicle 1-3: step 2 -> step 5; vehicle 4: held at step 2 -> step 5; \
                        vehicle 5: landing on its own, as before; vehicle 6: joining";
        assert_eq!(effect.to_string(), expected);
        assert!(effect.is_any() && !effect.is_all());
        let none = Effect::of(&before, before.clone());
        assert!(!none.is_any() && none.to_string().contains("vehicle 1-3: step 2, as before"), "{none}");
    }

    #[test]
    fn an_order_determines_what_a_vehicle_does() {
        let order = |verb, vehicles| Order { epoch: 1, issuer: 1, verb, vehicles, signature: None };
        let named = |verb| Some(order(verb, Some([VehicleId::new(1).unwrap()].into_iter().collect())));
        let of = |membership, order| Activity::of(membership, 3, order).to_string();
        let activity = |membership, verb: Option<Verb>| of(membership, verb.map(|verb| order(verb, None)));
        assert_eq!(activity(Membership::Active, None), "step 3");
        assert_eq!(activity(Membership::Active, Some(Verb::Goto(1))), "step 3");
        assert_eq!(activity(Membership::Active, Some(Verb::Hold)), "held at step 3");
        assert_eq!(activity(Membership::Joining, Some(Verb::Hold)), "joining");
        assert_eq!(activity(Membership::Left, Some(Verb::Hold)), "landing on its own");
        assert_eq!(activity(Membership::Left, Some(Verb::Land)), "landing");
        assert_eq!(activity(Membership::Left, Some(Verb::Abort)), "aborted");
        assert_eq!(of(Membership::Joining, named(Verb::Hold)), "held at step 3");
        assert_eq!(of(Membership::Joining, named(Verb::Release)), "released");
        assert_eq!(of(Membership::Joining, named(Verb::Goto(0))), "joining");
    }

    #[test]
    fn consecutive_ids_are_printed_as_a_range() {
        assert_eq!(ranges(&ids(&[1, 2, 3, 4, 6, 8, 9])), "1-4, 6, 8, 9");
        assert_eq!((ranges(&ids(&[7])), ranges(&[])), ("7".to_owned(), String::new()));
    }

    #[test]
    fn the_error_for_a_missing_step_lists_the_steps() {
        let missing = |steps: &str, step| {
            let text = format!("swarm.vehicles = 1\n{steps}");
            missing_step(&load(&Source { name: "x", text: &text }, &[]).unwrap().scenario, step)
        };
        assert_eq!(
            (missing("", 0), missing("", 5).unwrap().as_str()),
            (None, "the mission has no step 5: its only step is 0")
        );
        let tour = "[mission]\nsteps = [{ name = 'gate', centre_ne_m = [0, 0] }, { hold_s = 1 }, { land = true }]";
        assert_eq!(missing(tour, 2), None);
        assert_eq!(missing(tour, 3).unwrap(), "the mission has no step 3: its steps are 0 (gate), 1, 2 (land)");
        let long = format!("[mission]\nsteps = [{}]", "{ hold_s = 1 }, ".repeat(400));
        assert_eq!(missing(&long, 400).unwrap(), "the mission has no step 400: its steps are 0 to 399");
    }
}
