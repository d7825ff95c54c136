//! The first message to a page: the swarm, its vehicles, and the scenario that they fly.

use serde_json::{Value, json};
use skein_common::id::VehicleName;
use skein_common::message::{FACTS, Fact, FactLine};
use skein_common::scenario::{Scenario, Step, Target};
use skein_core::deadlines::Deadline;
use skein_lab::metrics::{COLLISION_M, Run};

use super::snapshot::{Team, drawn_formation, safety_distance_m};
use skein_cluster::display::status;

/// Version of the protocol between page and server.
const VERSION: u32 = 1;

/// The message. `teams` are the swarm, or the teams of the fleet; `span_s` are the first and the last time of a recording. The page
/// may give orders if `needs_token` says whether they need a token.
pub(super) fn hello(teams: &[Team], title: &str, span_s: Option<(f64, f64)>, needs_token: Option<bool>) -> String {
    let first = teams.first();
    let scenarios: Vec<Value> = teams.iter().map(|team| scenario(&team.scenario)).collect();
    let common = scenarios.first();
    let of_team = |(team, own): (&Team, &Value)| {
        let id = team.id()?;
        let place_ne_m = team.scenario.team.map(|team| team.place_ne_m);
        let mut about = json!({ "id": id, "name": format!("team {id}"), "place_ne_m": place_ne_m });
        if let (true, Some(about)) = (Some(own) != common, about.as_object_mut()) {
            about.insert("scenario".to_owned(), own.clone());
        }
        Some(about)
    };
    let vehicle = |name: VehicleName| json!({ "id": name.to_string(), "team": name.team, "number": name.vehicle });
    let vehicles = teams.iter().flat_map(|team| team.scenario.ids().map(|id| vehicle(team.name(id))));
    json!({
        "type": "hello",
        "version": VERSION,
        "source": if span_s.is_some() { "recording" } else { "live" },
        "swarm": first.map(|team| team.scenario.swarm.name.as_str()),
        "title": title,
        "orders": needs_token.is_some(),
        "needs_token": needs_token == Some(true),
        "duration_s": first.and_then(|team| team.scenario.duration_s),
        "from_s": span_s.map(|(from_s, _)| from_s),
        "to_s": span_s.map(|(_, to_s)| to_s),
        "scenario": common,
        "facts": FACTS.iter().filter_map(card_line).collect::<Vec<_>>(),
        "vehicles": vehicles.collect::<Vec<_>>(),
        "teams": teams.iter().zip(&scenarios).filter_map(of_team).collect::<Vec<_>>(),
    })
    .to_string()
}

/// The presentation of a fact on the page's card of a vehicle; `None` if the card does not show it.
fn card_line(Fact { key, factor, decimals, line, .. }: &Fact) -> Option<Value> {
    let FactLine { name, unit, about } = (*line)?;
    Some(json!({ "key": key, "name": name, "about": about, "factor": factor, "decimals": decimals, "unit": unit }))
}

/// The part of a scenario that the page draws. Places are relative to the swarm's origin, in a fleet to the team's.
fn scenario(scenario: &Scenario) -> Value {
    let origin = scenario.team.map_or(scenario.origin, |team| team.origin);
    json!({
        "name": scenario.name,
        "law": scenario.formation.law.name(),
        "plant": Run::new(scenario, "fly").plant,
        "vehicles": scenario.swarm.vehicles,
        "origin": origin,
        "safety_distance_m": safety_distance_m(&scenario.formation),
        "collision_distance_m": COLLISION_M,
        "even": status::has_gaps(scenario, None),
        "airspace": scenario.airspace,
        "network": { "stale_s": Deadline::StateOld.after_s(), "lost_s": scenario.network.peer_stale_s },
        "steps": scenario.mission.steps.iter().map(step).collect::<Vec<_>>(),
    })
}

fn step(step: &Step) -> Value {
    let (kind, centre_ne_m, path_ne_m, hold_s) = match &step.target {
        Target::Centre(centre_ne_m) => ("centre", Some(centre_ne_m), None, None),
        Target::Path(path_ne_m) => ("path", None, Some(path_ne_m), None),
        Target::Hold(hold_s) => ("hold", None, None, Some(hold_s)),
        Target::Land(_) => ("land", None, None, None),
    };
    json!({
        "name": step.name,
        "kind": kind,
        "centre_ne_m": centre_ne_m,
        "path_ne_m": path_ne_m,
        "hold_s": hold_s,
        "formation": drawn_formation(&step.formation),
    })
}
