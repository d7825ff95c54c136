//! What an order has changed: what every vehicle did before it and does after it, as heartbeats tell.

use std::collections::BTreeMap;
use std::fmt;

use skein_common::id::VehicleId;
use skein_common::message::Verb;
use skein_common::scenario::{Scenario, Target};
use skein_common::state::Membership;

use crate::observe::Observer;

/// Longer lists of steps are not written out.
const MAX_LISTED: usize = 12;

/// What a vehicle does, as far as an order can change it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Doing {
    /// It does not take part yet.
    Joining,
    /// It flies this step of the mission.
    Step(u32),
    /// It holds its place at this step.
    Held(u32),
    /// It lands, or has landed, by order.
    Landing,
    /// The same, and no order calls it back.
    Aborted,
    /// It lands, or has landed, because its mission ends or something of it has failed.
    Out,
}

impl Doing {
    /// Of a heartbeat with this order in it.
    pub(super) fn of(membership: Membership, step: u32, order: Option<Verb>) -> Self {
        match (membership, order) {
            (_, Some(Verb::Abort)) => Self::Aborted,
            (_, Some(Verb::Land)) => Self::Landing,
            (Membership::Left, _) => Self::Out,
            (Membership::Joining, _) => Self::Joining,
            (Membership::Active, Some(Verb::Hold)) => Self::Held(step),
            (Membership::Active, _) => Self::Step(step),
        }
    }
}

impl fmt::Display for Doing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Joining => f.write_str("joining"),
            Self::Step(step) => write!(f, "step {step}"),
            Self::Held(step) => write!(f, "held at step {step}"),
            Self::Landing => f.write_str("landing"),
            Self::Aborted => f.write_str("aborted"),
            Self::Out => f.write_str("landing on its own"),
        }
    }
}

/// What every vehicle in contact does.
pub(super) fn doing(observer: &Observer) -> BTreeMap<VehicleId, Doing> {
    let there = observer.vehicles().iter().filter(|(_, seen)| seen.alive);
    let doing = there.filter_map(|(id, seen)| {
        let mission = seen.mission.as_ref()?;
        Some((*id, Doing::of(mission.membership, mission.step, observer.order_of(seen).map(|order| order.verb))))
    });
    doing.collect()
}

/// What has become of vehicles.
pub(super) struct Effect {
    /// Each vehicle in contact after the order: what it did before, if that was known, and what it does.
    changes: BTreeMap<VehicleId, (Option<Doing>, Doing)>,
}

impl Effect {
    pub(super) fn of(before: &BTreeMap<VehicleId, Doing>, after: BTreeMap<VehicleId, Doing>) -> Self {
        Self { changes: after.into_iter().map(|(id, after)| (id, (before.get(&id).copied(), after))).collect() }
    }

    /// Whether any vehicle does something else than before.
    pub(super) fn is_any(&self) -> bool {
        self.changes.values().any(|(before, after)| *before != Some(*after))
    }

    /// Whether every vehicle does.
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
        let words = groups.iter().map(|((before, after), ids)| {
            let ids = ranges(ids);
            match before {
                Some(before) if before == after => format!("vehicle {ids}: {after}, as before"),
                Some(before) => format!("vehicle {ids}: {before} -> {after}"),
                None => format!("vehicle {ids}: {after}"),
            }
        });
        f.write_str(&words.collect::<Vec<_>>().join("; "))
    }
}

/// `1-4, 6`, of sorted ids.
pub(crate) fn ranges(ids: &[VehicleId]) -> String {
    let runs = ids.chunk_by(|one, next| next.get() - one.get() == 1);
    let words = runs.map(|run| match run {
        [first, .., last] if run.len() > 2 => format!("{first}-{last}"),
        few => few.iter().map(VehicleId::to_string).collect::<Vec<_>>().join(", "),
    });
    words.collect::<Vec<_>>().join(", ")
}

/// Why a mission cannot go to this step, with the steps that it has.
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
    fn what_changed_is_told_by_groups() {
        let all = |doing: &[Doing]| (1..).map(|id| VehicleId::new(id).unwrap()).zip(doing.iter().copied()).collect();
        let before = all(&[Doing::Step(2), Doing::Step(2), Doing::Step(2), Doing::Held(2), Doing::Out]);
        let after = all(&[Doing::Step(5), Doing::Step(5), Doing::Step(5), Doing::Step(5), Doing::Out, Doing::Joining]);
        let effect = Effect::of(&before, after);
        let expected = "vehicle 1-3: step 2 -> step 5; vehicle 4: held at step 2 -> step 5; \
                        vehicle 5: landing on its own, as before; vehicle 6: joining";
        assert_eq!(effect.to_string(), expected);
        assert!(effect.is_any() && !effect.is_all());
        let none = Effect::of(&before, before.clone());
        assert!(!none.is_any() && none.to_string().contains("vehicle 1-3: step 2, as before"), "{none}");
    }

    #[test]
    fn an_order_shows_in_what_a_vehicle_does() {
        let doing = |membership, order| Doing::of(membership, 3, order).to_string();
        assert_eq!(doing(Membership::Active, None), "step 3");
        assert_eq!(doing(Membership::Active, Some(Verb::Goto(1))), "step 3");
        assert_eq!(doing(Membership::Active, Some(Verb::Hold)), "held at step 3");
        assert_eq!(doing(Membership::Joining, Some(Verb::Hold)), "joining");
        assert_eq!(doing(Membership::Left, Some(Verb::Hold)), "landing on its own");
        assert_eq!(doing(Membership::Left, Some(Verb::Land)), "landing");
        assert_eq!(doing(Membership::Left, Some(Verb::Abort)), "aborted");
    }

    #[test]
    fn ids_in_a_row_are_a_range() {
        assert_eq!(ranges(&ids(&[1, 2, 3, 4, 6, 8, 9])), "1-4, 6, 8, 9");
        assert_eq!((ranges(&ids(&[7])), ranges(&[])), ("7".to_owned(), String::new()));
    }

    #[test]
    fn a_step_that_is_not_there_is_told_with_those_that_are() {
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
