//! Checks of tables in which only some combinations of keys are allowed: steps, events, links, obstacles, UDP addresses of a law.

use super::error::ScenarioError;
use super::model::{FAULT_RULES, ORDER_RULES};
use super::tree::{Node, Place, Table, Texts};

/// The goals of a step, each with the keys that are allowed beside it.
const TARGETS: [(&str, &[&str]); 4] =
    [("centre_ne_m", &["dwell_s"]), ("hold_s", &[]), ("path_ne_m", &["dwell_s", "speed_m_s"]), ("land", &[])];

/// Largest number of steps of a mission: each has a law with its memory in every agent.
const MOST_STEPS: usize = 1000;

/// Checks the combinations of keys that the types do not exclude.
pub(super) fn check(texts: &Texts<'_>, written: &Node) -> Result<(), ScenarioError> {
    let steps = written.at("mission.steps").map(Node::list).unwrap_or_default();
    if let Some(first_above) = steps.get(MOST_STEPS) {
        let message = format!("`mission.steps` has {} steps; a mission has at most {MOST_STEPS}", steps.len());
        return Err(texts.fault(&first_above.place, "mission.steps", message));
    }
    let at = |path: String, node| Some(Checked { texts, path, node, table: Node::table(node)? });
    // The tables of a list, each with its place in the list. Another check refuses values that are not tables.
    let items = |list: &'static str| {
        let nodes = written.at(list).map(Node::list).unwrap_or_default();
        nodes.iter().enumerate().filter_map(move |(index, node)| Some((index, at(format!("{list}[{index}]"), node)?)))
    };
    items("mission.steps").try_for_each(|(index, step)| step.is_step(index + 1 == steps.len()))?;
    items("mission.events").try_for_each(|(_, event)| event.is_event())?;
    items("network.links").try_for_each(|(_, link)| link.is_link())?;
    items("airspace.obstacles").try_for_each(|(_, obstacle)| obstacle.is_obstacle())?;
    let udp = "formation.external.udp";
    match written.at(udp).and_then(|node| at(udp.to_owned(), node)) {
        Some(udp) if udp.table.len() != 2 => Err(udp.fault(None, " needs both `ask` and `answer`")),
        _ => Ok(()),
    }
}

/// A table with its path.
struct Checked<'a> {
    texts: &'a Texts<'a>,
    path: String,
    node: &'a Node,
    table: &'a Table,
}

impl Checked<'_> {
    /// The error at this place in the table, or of the table itself. `why` continues after the path.
    fn fault(&self, place: Option<&Place>, why: &str) -> ScenarioError {
        self.texts.fault(place.unwrap_or(&self.node.place), &self.path, format!("`{}`{why}", self.path))
    }

    fn has(&self, name: &str) -> bool {
        self.table.contains_key(name)
    }

    /// Checks an entry of `network.links`: it names its links and changes something about them.
    fn is_link(&self) -> Result<(), ScenarioError> {
        if !self.has("from") && !self.has("to") {
            return Err(self.fault(None, " does not name its links: add `from` or `to`"));
        }
        if self.table.keys().all(|name| ["from", "to", "both_ways"].contains(&name.as_str())) {
            return Err(self.fault(None, " changes nothing about its links: add `loss` or another key"));
        }
        Ok(())
    }

    fn is_obstacle(&self) -> Result<(), ScenarioError> {
        if !self.has("centre_ne_m") {
            return Err(self.fault(None, " needs `centre_ne_m`"));
        }
        self.one_of(&[("radius_m", ()), ("size_ne_m", ())]).map(|_| ())
    }

    fn is_step(&self, is_last: bool) -> Result<(), ScenarioError> {
        let (target, besides) = self.one_of(&TARGETS)?;
        for name in ["dwell_s", "speed_m_s"] {
            if let (Some((place, _)), false) = (self.table.get(name), besides.contains(&name)) {
                return Err(self.fault(Some(place), &format!(": `{name}` has no effect beside `{target}`")));
            }
        }
        if target == "land" && !is_last {
            return Err(self.fault(None, ": `land` is allowed only in the last step"));
        }
        Ok(())
    }

    fn is_event(&self) -> Result<(), ScenarioError> {
        let (sort, rules) = self.one_of(&[("fault", &FAULT_RULES[..]), ("order", &ORDER_RULES)])?;
        let kind = self.table.get(sort).map(|(_, node)| node.plain()).unwrap_or(false.into());
        let Some((kind, needed, optional)) = rules.iter().find(|(name, ..)| kind.as_str() == Some(name)) else {
            return Ok(());
        };
        if let Some(name) = ["at_s"].iter().chain(*needed).find(|name| !self.has(name)) {
            return Err(self.fault(None, &format!(": {sort} = \"{kind}\" needs `{name}`")));
        }
        let lasts = sort == "fault" || matches!(*kind, "hold" | "release");
        let is_allowed = |name: &str| {
            name == "at_s"
                || name == sort
                || (name == "for_s" && lasts)
                || needed.contains(&name)
                || optional.contains(&name)
        };
        match self.table.iter().find(|(name, _)| !is_allowed(name)) {
            Some((name, (place, _))) => {
                Err(self.fault(Some(place), &format!(": `{name}` has no effect beside {sort} = \"{kind}\"")))
            }
            None => Ok(()),
        }
    }

    /// The only one of these names that the table has.
    fn one_of<T: Copy>(&self, choices: &[(&'static str, T)]) -> Result<(&'static str, T), ScenarioError> {
        let mut found = choices.iter().filter(|(name, _)| self.has(name));
        let names = || choices.iter().map(|(name, _)| format!("`{name}`")).collect::<Vec<_>>().join(", ");
        let first = found.next().ok_or_else(|| self.fault(None, &format!(" needs one of {}", names())))?;
        match found.next().and_then(|(name, _)| self.table.get(*name)) {
            Some((place, _)) => Err(self.fault(Some(place), &format!(" takes only one of {}", names()))),
            None => Ok(*first),
        }
    }
}
