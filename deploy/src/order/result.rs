//! What became of an order in one swarm, for people and for programs.

use serde_json::{Value, json};
use skein_common::id::{FleetVehicle, SwarmName, VehicleId, VehicleName};
use skein_common::message::Verb;

use super::effect::{Effect, ranges};
use crate::reach::Reach;
use skein_lab::error::Error;

/// What became of an order in one swarm, or in one team of a fleet.
#[derive(Default)]
pub(super) struct Given {
    /// Vehicles that have accepted it.
    pub(super) accepted: Vec<VehicleId>,
    /// Vehicles in contact that have not accepted it.
    pub(super) unresponsive: Vec<VehicleId>,
    /// Vehicles from which no heartbeat arrived.
    pub(super) silent: Vec<VehicleId>,
    /// What it has changed.
    pub(super) effect: Effect,
    /// Why it was not sent.
    pub(super) error: Option<Error>,
}

impl Given {
    /// An order that was not sent.
    pub(super) fn failed(error: Error) -> Self {
        Self { error: Some(error), ..Self::default() }
    }

    /// The sentence for people.
    ///
    /// # Errors
    /// If it was not sent, a vehicle in contact has not accepted it, or it has changed nothing.
    pub(super) fn verdict(self, verb: Verb) -> Result<String, Error> {
        let Self { accepted, unresponsive, effect, error, .. } = self;
        if let Some(error) = error {
            return Err(error);
        }
        if !unresponsive.is_empty() {
            let unresponsive = ranges(&unresponsive);
            return Err(Error::Failed(format!(
                "{verb}: not accepted by vehicle {unresponsive}; of those in contact {effect}"
            )));
        }
        if !effect.is_any() {
            return Err(Error::Failed(format!("{verb}: no effect: {effect}")));
        }
        Ok(format!("{verb}: accepted by vehicle {}; {effect}", ranges(&accepted)))
    }
}

/// One object about the order in all swarms that it was sent to: in a fleet, one for each team.
pub(super) fn as_json(swarm: &SwarmName, verb: Verb, reaches: &[Reach], results: &[Given]) -> Value {
    let all = || reaches.iter().zip(results);
    let names = |ids: fn(&Given) -> &[VehicleId]| -> Vec<VehicleName> {
        all().flat_map(|(reach, given)| ids(given).iter().map(|id| name(reach, *id))).collect()
    };
    let changes = all().flat_map(|(reach, given)| {
        let change = |(id, before, after)| json!({ "vehicle": name(reach, id), "before": before, "after": after });
        given.effect.as_texts().map(change)
    });
    json!({
        "order": verb.to_string(),
        "swarm": swarm,
        "accepted": names(|given| &given.accepted),
        "unresponsive": names(|given| &given.unresponsive),
        "silent": names(|given| &given.silent),
        "changes": changes.collect::<Vec<_>>(),
        "errors": all().filter_map(|(_, given)| Some(given.error.as_ref()?.to_string())).collect::<Vec<_>>(),
    })
}

fn name(reach: &Reach, vehicle: VehicleId) -> VehicleName {
    match reach.branch.team() {
        Some(team) => FleetVehicle { team, vehicle }.into(),
        None => vehicle.into(),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use skein_common::id::TeamId;
    use skein_common::topic::Branch;

    use super::*;
    use crate::order::effect::Activity;
    use crate::reach::Flown;

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
            error: None,
        };
        let reach = Reach::plain(swarm.clone(), BTreeMap::new(), Flown::Text(String::new()));
        let one = as_json(&swarm, Verb::Goto(3), std::slice::from_ref(&reach), &[given()]);
        assert_eq!((&one["order"], &one["swarm"]), (&json!("goto 3"), &json!("lab")));
        assert_eq!((&one["accepted"], &one["unresponsive"], &one["silent"]), (&json!([1]), &json!([2]), &json!([3])));
        assert_eq!(one["changes"][1], json!({ "vehicle": 2, "before": "step 0", "after": "held at step 0" }));
        assert!(given().verdict(Verb::Hold).unwrap_err().to_string().contains("not accepted by vehicle 2"));

        let team = |number| Reach { branch: Branch::of(TeamId::new(number).ok()), ..reach.clone() };
        let lost = Given::failed(Error::Failed("no vehicle answered".to_owned()));
        let fleet = as_json(&swarm, Verb::Hold, &[team(1), team(2)], &[given(), lost]);
        assert_eq!((&fleet["accepted"], &fleet["errors"]), (&json!(["1/1"]), &json!(["no vehicle answered"])));
    }
}
