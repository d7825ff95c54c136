//! The result of an order in one swarm, for people and for programs.

use serde_json::{Value, json};
use skein_common::id::{SwarmName, VehicleId, VehicleName, VehicleSet};

use super::effect::{Effect, ranges};
use super::recipients::Recipients;
use skein_lab::error::Error;

/// The result of an order in one swarm, or in one team of a fleet.
#[derive(Default)]
pub(super) struct Given {
    /// Vehicles that have accepted it.
    pub(super) accepted: Vec<VehicleId>,
    /// Vehicles in contact that have not accepted it.
    pub(super) unresponsive: Vec<VehicleId>,
    /// Vehicles out of contact that have not accepted it.
    pub(super) silent: Vec<VehicleId>,
    /// Its effect.
    pub(super) effect: Effect,
    /// Whether it sets keys: it then changes nothing that [`Self::effect`] could show.
    pub(super) is_setting: bool,
    /// The reason why it was not sent; `None` if it was sent.
    pub(super) error: Option<Error>,
}

impl Given {
    /// The sentence for people.
    ///
    /// # Errors
    /// If it was not sent, a vehicle in contact has not accepted it, or it has changed nothing.
    pub(super) fn verdict(self, title: &str) -> Result<String, Error> {
        let Self { accepted, unresponsive, silent, effect, is_setting, error } = self;
        if let Some(error) = error {
            return Err(error);
        }
        if !unresponsive.is_empty() {
            let unresponsive = ranges(&unresponsive);
            return Err(Error::Failed(format!(
                "{title}: not accepted by vehicle {unresponsive}; of those in contact {effect}"
            )));
        }
        if is_setting {
            let missing = match ranges(&silent) {
                silent if silent.is_empty() => String::new(),
                silent => format!("; vehicle {silent} does not answer"),
            };
            return Ok(format!("{title}: accepted by vehicle {}{missing}", ranges(&accepted)));
        }
        if !effect.is_any() {
            return Err(Error::Failed(format!("{title}: no effect: {effect}")));
        }
        Ok(format!("{title}: accepted by vehicle {}; {effect}", ranges(&accepted)))
    }
}

/// The result of the order in all swarms that it was sent to, and whether every vehicle has accepted it and it has changed
/// something everywhere: `land: taken by 7 of 8; 3 does not answer; vehicle 1-2, 4-8: step 0 -> landing`.
pub(super) fn in_one_line(title: &str, recipients: &[Recipients], results: &[Given]) -> (String, bool) {
    let all = || recipients.iter().map(|to| &to.reach).zip(results);
    let names = |ids| -> Vec<String> { names(recipients, results, ids).iter().map(VehicleName::to_string).collect() };
    let accepted = names(|given| &given.accepted).len();
    let (unresponsive, silent) = (names(|given| &given.unresponsive), names(|given| &given.silent));
    let mut parts = vec![format!("{title}: taken by {accepted} of {}", accepted + unresponsive.len() + silent.len())];
    let mut name_all = |names: &[String], one: &str, several: &str| match names {
        [] => {}
        [only] => parts.push(format!("{only} {one}")),
        names => parts.push(format!("{} {several}", names.join(", "))),
    };
    name_all(&silent, "does not answer", "do not answer");
    name_all(&unresponsive, "is in contact and has not taken it", "are in contact and have not taken it");
    let mut has_effect = true;
    for (reach, given) in all() {
        let team = reach.branch.team().map_or_else(String::new, |team| format!("team {team}: "));
        match (&given.error, given.effect.is_any()) {
            (Some(error), _) => parts.push(format!("{team}{error}")),
            (None, true) => parts.push(format!("{team}{}", given.effect)),
            (None, false) => parts.push(format!("{team}no effect: {}", given.effect)),
        }
        has_effect &= given.error.is_none() && given.effect.is_any();
    }
    (parts.join("; "), has_effect && unresponsive.is_empty() && silent.is_empty())
}

/// One object about the order in all swarms that it was sent to: in a fleet, one for each team.
pub(super) fn as_json(
    swarm: &SwarmName,
    title: &str,
    vehicles: Option<VehicleSet>,
    recipients: &[Recipients],
    results: &[Given],
) -> Value {
    let all = || recipients.iter().map(|to| &to.reach).zip(results);
    let names = |ids| names(recipients, results, ids);
    let changes = all().flat_map(|(reach, given)| {
        let change =
            |(id, before, after)| json!({ "vehicle": reach.branch.name(id), "before": before, "after": after });
        given.effect.as_texts().map(change)
    });
    json!({
        "order": title,
        "swarm": swarm,
        "vehicles": vehicles.map(|vehicles| vehicles.iter().collect::<Vec<_>>()),
        "accepted": names(|given| &given.accepted),
        "unresponsive": names(|given| &given.unresponsive),
        "silent": names(|given| &given.silent),
        "changes": changes.collect::<Vec<_>>(),
        "errors": all().filter_map(|(_, given)| Some(given.error.as_ref()?.to_string())).collect::<Vec<_>>(),
    })
}

/// The names of these vehicles of all swarms.
fn names(recipients: &[Recipients], results: &[Given], ids: fn(&Given) -> &[VehicleId]) -> Vec<VehicleName> {
    let all = recipients.iter().zip(results);
    all.flat_map(|(to, given)| ids(given).iter().map(|id| to.reach.branch.name(*id))).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use skein_common::id::TeamId;
    use skein_common::topic::Branch;

    use super::*;
    use crate::mesh::order::effect::Activity;
    use crate::mesh::reach::{Flown, Reach};

    #[test]
    fn one_object_names_who_accepted_an_order_and_who_did_not_answer() {
        let swarm = SwarmName::new("lab").unwrap();
        let ids = |numbers: &[u8]| numbers.iter().map(|id| VehicleId::new(*id).unwrap()).collect::<Vec<_>>();
        let all = |activity| ids(&[1, 2]).into_iter().map(|id| (id, activity)).collect::<BTreeMap<_, _>>();
        let given = || Given {
            accepted: ids(&[1]),
            unresponsive: ids(&[2]),
            silent: ids(&[3]),
            effect: Effect::of(&all(Activity::Step(0)), all(Activity::Held(0))),
            is_setting: false,
            error: None,
        };
        let reach = Reach::plain(swarm.clone(), BTreeMap::new(), Flown::Text(String::new()));
        let to = |reach: &Reach| Recipients { reach: reach.clone(), vehicles: None };
        let one = as_json(&swarm, "goto 3", None, &[to(&reach)], &[given()]);
        assert_eq!((&one["order"], &one["swarm"]), (&json!("goto 3"), &json!("lab")));
        assert_eq!((&one["accepted"], &one["unresponsive"], &one["silent"]), (&json!([1]), &json!([2]), &json!([3])));
        assert_eq!(one["changes"][1], json!({ "vehicle": 2, "before": "step 0", "after": "held at step 0" }));
        assert!(given().verdict("hold").unwrap_err().to_string().contains("not accepted by vehicle 2"));

        let tuned = Given { unresponsive: Vec::new(), is_setting: true, effect: Effect::default(), ..given() };
        let expected = "set formation.radius_m=80: accepted by vehicle 1; vehicle 3 does not answer";
        assert_eq!(tuned.verdict("set formation.radius_m=80").unwrap(), expected);

        let team = |number| Reach { branch: Branch::of(TeamId::new(number).ok()), ..reach.clone() };
        let teams = [to(&team(1)), to(&team(2))];
        let lost = Given { error: Some(Error::Failed("no vehicle answered".to_owned())), ..Given::default() };
        let fleet = as_json(&swarm, "hold", "1-2".parse().ok(), &teams, &[given(), lost]);
        assert_eq!((&one["vehicles"], &fleet["vehicles"]), (&json!(null), &json!([1, 2])));
        assert_eq!((&fleet["accepted"], &fleet["errors"]), (&json!(["1/1"]), &json!(["no vehicle answered"])));
        let (text, is_done) = in_one_line("hold", &[to(&reach)], &[given()]);
        let expected = "hold: taken by 1 of 3; 3 does not answer; 2 is in contact and has not taken it; \
                        vehicle 1, 2: step 0 -> held at step 0";
        assert_eq!((text.as_str(), is_done), (expected, false));
        let all_there = Given { unresponsive: Vec::new(), silent: Vec::new(), ..given() };
        let without_effect = Given { accepted: ids(&[2]), ..Given::default() };
        let (text, is_done) = in_one_line("hold", &[to(&reach)], std::slice::from_ref(&all_there));
        assert_eq!((text.as_str(), is_done), ("hold: taken by 1 of 1; vehicle 1, 2: step 0 -> held at step 0", true));
        let (text, is_done) = in_one_line("hold", &teams, &[all_there, without_effect]);
        assert!(text.starts_with("hold: taken by 2 of 2; team 1: vehicle") && !is_done, "{text}");
        assert!(text.ends_with("; team 2: no effect: "), "{text}");
    }
}
