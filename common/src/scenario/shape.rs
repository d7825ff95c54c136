//! Checks of tables in which only some combinations of keys are allowed: steps, events, links, obstacles, UDP addresses of a law.

use super::error::ScenarioError;
use super::model::{FAULT_RULES, ORDER_RULES};
use super::tree::{Node, Table, Texts};

/// The goals of a step, each with the keys that are allowed beside it.
const TARGETS: &[(&str, &[&str])] =
    &[("centre_ne_m", &["dwell_s"]), ("hold_s", &[]), ("path_ne_m", &["dwell_s", "speed_m_s"]), ("land", &[])];

/// Largest number of steps of a mission: each has a law with its memory in every agent.
const MOST_STEPS: usize = 1000;

/// Checks the combinations of keys that the types do not exclude.
pub(super) fn check(texts: &Texts<'_>, written: &Node) -> Result<(), ScenarioError> {
    let steps = written.at("mission.steps").map(Node::list).unwrap_or_default();
    if let Some(first_above) = steps.get(MOST_STEPS) {
        let message = format!("`mission.steps` has {} steps; a mission has at most {MOST_STEPS}", steps.len());
        return Err(texts.fault(&first_above.place, "mission.steps", message));
    }
    for (index, step) in steps.iter().enumerate() {
        check_step(texts, step, &format!("mission.steps[{index}]"), index + 1 == steps.len())?;
    }
    let events = written.at("mission.events").map(Node::list).unwrap_or_default();
    for (index, event) in events.iter().enumerate() {
        check_event(texts, event, &format!("mission.events[{index}]"))?;
    }
    let links = written.at("network.links").map(Node::list).unwrap_or_default();
    for (index, link) in links.iter().enumerate() {
        check_link(texts, link, &format!("network.links[{index}]"))?;
    }
    let obstacles = written.at("airspace.obstacles").map(Node::list).unwrap_or_default();
    for (index, obstacle) in obstacles.iter().enumerate() {
        let path = format!("airspace.obstacles[{index}]");
        let Some(table) = obstacle.table() else { continue };
        if !table.contains_key("centre_ne_m") {
            return Err(texts.fault(&obstacle.place, &path, format!("`{path}` needs `centre_ne_m`")));
        }
        one_of(texts, obstacle, table, &path, [("radius_m", ()), ("size_ne_m", ())].into_iter())?;
    }
    check_udp(texts, written)
}

/// Checks that an entry of `network.links` names its links and changes something about them.
fn check_link(texts: &Texts<'_>, link: &Node, path: &str) -> Result<(), ScenarioError> {
    let Some(table) = link.table() else { return Ok(()) };
    let (which, what) = (["from", "to"], |name: &&String| !["from", "to", "both_ways"].contains(&name.as_str()));
    let problem = if !which.iter().any(|name| table.contains_key(*name)) {
        "does not name its links: add `from` or `to`"
    } else if !table.keys().any(|name| what(&name)) {
        "changes nothing about its links: add `loss` or another key"
    } else {
        return Ok(());
    };
    Err(texts.fault(&link.place, path, format!("`{path}` {problem}")))
}

fn check_step(texts: &Texts<'_>, step: &Node, path: &str, is_last: bool) -> Result<(), ScenarioError> {
    let Some(table) = step.table() else { return Ok(()) };
    let (target, besides) = one_of(texts, step, table, path, TARGETS.iter().map(|(name, besides)| (*name, *besides)))?;
    for name in ["dwell_s", "speed_m_s"] {
        if let (Some((place, _)), false) = (table.get(name), besides.contains(&name)) {
            return Err(texts.fault(place, path, format!("`{path}`: `{name}` has no effect beside `{target}`")));
        }
    }
    if target == "land" && !is_last {
        return Err(texts.fault(&step.place, path, format!("`{path}`: `land` is allowed only in the last step")));
    }
    Ok(())
}

fn check_event(texts: &Texts<'_>, event: &Node, path: &str) -> Result<(), ScenarioError> {
    let Some(table) = event.table() else { return Ok(()) };
    let (sort, rules) =
        one_of(texts, event, table, path, [("fault", &FAULT_RULES[..]), ("order", &ORDER_RULES)].into_iter())?;
    let kind = table.get(sort).map(|(_, node)| node.plain()).unwrap_or(false.into());
    let Some((kind, needed, optional)) = rules.iter().find(|(name, ..)| kind.as_str() == Some(name)) else {
        return Ok(());
    };
    if let Some(name) = ["at_s"].iter().chain(*needed).find(|name| !table.contains_key(**name)) {
        return Err(texts.fault(&event.place, path, format!("`{path}`: {sort} = \"{kind}\" needs `{name}`")));
    }
    let lasts = sort == "fault" || matches!(*kind, "hold" | "release");
    let is_allowed = |name: &str| {
        name == "at_s"
            || name == sort
            || (name == "for_s" && lasts)
            || needed.contains(&name)
            || optional.contains(&name)
    };
    match table.iter().find(|(name, _)| !is_allowed(name)) {
        Some((name, (place, _))) => {
            Err(texts.fault(place, path, format!("`{path}`: `{name}` has no effect beside {sort} = \"{kind}\"")))
        }
        None => Ok(()),
    }
}

/// The only one of these names that the table has.
fn one_of<T>(
    texts: &Texts<'_>,
    node: &Node,
    table: &Table,
    path: &str,
    choices: impl Iterator<Item = (&'static str, T)> + Clone,
) -> Result<(&'static str, T), ScenarioError> {
    let mut found = choices.clone().filter(|(name, _)| table.contains_key(*name));
    let names = || choices.clone().map(|(name, _)| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    let Some(first) = found.next() else {
        return Err(texts.fault(&node.place, path, format!("`{path}` needs one of {}", names())));
    };
    match found.next().and_then(|(name, _)| table.get(name)) {
        Some((place, _)) => Err(texts.fault(place, path, format!("`{path}` takes only one of {}", names()))),
        None => Ok(first),
    }
}

fn check_udp(texts: &Texts<'_>, written: &Node) -> Result<(), ScenarioError> {
    let path = "formation.external.udp";
    match written.at(path).and_then(|node| Some((node, node.table()?))) {
        Some((node, table)) if table.len() != 2 => {
            Err(texts.fault(&node.place, path, format!("`{path}` needs both `ask` and `answer`")))
        }
        _ => Ok(()),
    }
}
