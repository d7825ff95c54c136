//! Layers of values: the written values override the preset, the preset overrides the defaults.

use toml::Value as Toml;

use super::error::ScenarioError;
use super::key::{Implied, Key, Kind, Literal};
use super::keys::{self, KEYS};
use super::model::{FAULT_RULES, ORDER_RULES, Scenario};
use super::tree::{Node, Place, Texts};
use super::{Explained, Layer};
use crate::id::VehicleId;

/// A checked tree of written values, with the preset and the defaults below it.
pub(super) struct Layers<'a> {
    texts: &'a Texts<'a>,
    written: &'a Node,
    paper: bool,
    law: String,
}

impl<'a> Layers<'a> {
    /// Reads the keys on which other defaults depend.
    pub(super) fn new(texts: &'a Texts<'a>, written: &'a Node) -> Result<Self, ScenarioError> {
        if written.at("swarm.vehicles").is_none() {
            let place = written.at("swarm").map_or(Place::File(0..0), |node| node.place.clone());
            let place = if matches!(place, Place::Set(_)) { Place::File(0..0) } else { place };
            return Err(ScenarioError {
                help: Some("add the number of vehicles: `[swarm]`, `vehicles = 4`".into()),
                ..texts.fault(&place, "swarm.vehicles", "`swarm.vehicles` is missing")
            });
        }
        let value = |path| written.at(path).map(Node::plain);
        let paper = value("preset").is_some_and(|preset| preset.as_str() == Some("paper"));
        let law = value("formation.law").and_then(|law| law.as_str().map(str::to_owned)).unwrap_or("ring".to_owned());
        Ok(Self { texts, written, paper, law })
    }

    /// The value of a key outside lists, and its origin.
    fn value(&self, key: &Key) -> (Option<Toml>, Layer) {
        match self.written.at(key.path) {
            Some(node) => (Some(node.plain()), self.texts.origin(node)),
            None => self.below(key, &self.law),
        }
    }

    /// The value under this law of a key that is not written, and its origin.
    fn below(&self, key: &Key, law: &str) -> (Option<Toml>, Layer) {
        if let Some(value) = key.flock.filter(|_| law == "flock") {
            return (literal(value), Layer::Default);
        }
        if let Some(Implied { by, is, value }) = key.implied
            && self.named(by).as_ref().and_then(Toml::as_str) == Some(is)
        {
            return (literal(value), Layer::Implied(by));
        }
        match (key.paper.filter(|_| self.paper), key.default) {
            (Some(value), _) => (literal(value), Layer::Preset),
            (None, Literal::Same(other)) => (self.named(other), Layer::Implied(other)),
            (None, value) => (literal(value), Layer::Default),
        }
    }

    fn named(&self, path: &str) -> Option<Toml> {
        self.value(keys::find(path)?).0
    }

    /// The scenario as typed values.
    pub(super) fn scenario(&self) -> Result<Scenario, ScenarioError> {
        let mut root = toml::Table::new();
        for key in KEYS.iter().filter(|key| !key.path.contains('N') && !matches!(key.kind, Kind::Tables)) {
            put(&mut root, Some(key), key.path, self.value(key).0);
        }
        let lists: [(&str, &dyn Fn(toml::Table) -> toml::Table); 4] = [
            ("mission.steps", &|step| self.step(step)),
            ("mission.events", &event_in_full),
            ("network.links", &link_in_full),
            ("airspace.obstacles", &|obstacle| obstacle),
        ];
        for (path, in_full) in lists {
            let entries = self.entries(path).into_iter().map(|entry| Toml::Table(in_full(entry))).collect();
            put(&mut root, None, path, Some(Toml::Array(entries)));
        }
        let vehicles = self.named("swarm.vehicles").and_then(|count| count.as_integer()).unwrap_or(0);
        let vehicles = (1..=vehicles).map(|id| Toml::Table(self.vehicle(id))).collect();
        put(&mut root, None, "vehicle", Some(Toml::Array(vehicles)));
        // Every key was checked: an error here means that the table and the types disagree about a key, which the tests
        // exclude.
        root.try_into().map_err(|error: toml::de::Error| self.texts.fault(&Place::File(0..0), "", error.message()))
    }

    /// The tables of a list, written or by default.
    fn entries(&self, path: &str) -> Vec<toml::Table> {
        let list = self.named(path).and_then(|value| value.as_array().cloned()).unwrap_or_default();
        list.into_iter().filter_map(|entry| entry.as_table().cloned()).collect()
    }

    /// A step with all values that it inherits.
    fn step(&self, mut step: toml::Table) -> toml::Table {
        let changes = self.changes(&step);
        for key in KEYS {
            if let (Some(name), Literal::Same(other)) = (key.path.strip_prefix("mission.steps[N]."), key.default)
                && let Some(value) = self.named(other)
            {
                step.entry(name).or_insert(value);
            }
        }
        let mut formation = toml::Table::new();
        for key in formation_keys() {
            let name = key.path.trim_start_matches("formation.");
            put(&mut formation, Some(key), name, at(&changes, name).cloned().or_else(|| self.value(key).0));
        }
        step.insert("formation".to_owned(), Toml::Table(formation));
        step
    }

    /// The values that a step changes in the formation: the written ones, and the defaults of its law if it names
    /// another.
    fn changes(&self, step: &toml::Table) -> toml::Table {
        let mut changes = step.get("formation").and_then(Toml::as_table).cloned().unwrap_or_default();
        if let Some(law) = changes.get("law").and_then(Toml::as_str).map(str::to_owned) {
            for key in formation_keys().filter(|key| key.flock.is_some() && self.written.at(key.path).is_none()) {
                let name = key.path.trim_start_matches("formation.");
                if let Some(value) = self.below(key, &law).0 {
                    changes.entry(name).or_insert(value);
                }
            }
        }
        changes
    }

    fn vehicle(&self, id: i64) -> toml::Table {
        let mut vehicle = toml::Table::new();
        vehicle.insert("id".to_owned(), Toml::Integer(id));
        for key in KEYS {
            if let Some(name) = key.path.strip_prefix("vehicle.N.") {
                let written = self.written.at(&format!("vehicle.{id}.{name}")).map(Node::plain);
                put(&mut vehicle, Some(key), name, written.or_else(|| self.below(key, &self.law).0));
            }
        }
        vehicle
    }

    /// Notes on keys of the file that override the preset.
    pub(super) fn notes(&self) -> Vec<String> {
        let overrides = |key: &&Key| {
            let (value, origin) = self.value(key);
            let preset = self.below(key, &self.law);
            self.paper && matches!(origin, Layer::File { .. }) && preset.1 == Layer::Preset && value != preset.0
        };
        let name = self.texts.source.name;
        KEYS.iter()
            .filter(overrides)
            .map(|key| format!("{} in {name} overrides the preset \"paper\"", key.path))
            .collect()
    }

    /// All values of the complete file, with their origins.
    pub(super) fn lines(&self) -> Vec<Explained> {
        let mut lines = Vec::new();
        for key in KEYS.iter().filter(|key| !key.path.contains('N')) {
            if matches!(key.kind, Kind::Tables) {
                lines.extend(self.list_lines(key));
                continue;
            }
            let (value, origin) = self.value(key);
            let value = value.map(|value| value.to_string());
            lines.push(Explained { key: key.path.to_owned(), value, origin, about: key.about });
        }
        lines.extend((1..=VehicleId::MAX).flat_map(|id| self.vehicle_lines(id)));
        lines
    }

    fn list_lines(&self, key: &Key) -> Vec<Explained> {
        let nodes = self.written.at(key.path).map(Node::list).unwrap_or_default();
        let line = |(index, mut entry): (usize, toml::Table)| {
            let changes = self.changes(&entry);
            if !changes.is_empty() {
                entry.insert("formation".to_owned(), Toml::Table(changes));
            }
            Explained {
                key: format!("{}[{index}]", key.path),
                value: Some(Toml::Table(entry).to_string()),
                origin: nodes.get(index).map_or(Layer::Default, |node| self.texts.origin(node)),
                about: key.about,
            }
        };
        self.entries(key.path).into_iter().enumerate().map(line).collect()
    }

    /// The values of `[vehicle.N]` for this vehicle.
    fn vehicle_lines(&self, id: u8) -> impl Iterator<Item = Explained> {
        KEYS.iter().filter_map(move |key| {
            let path = format!("vehicle.{id}.{}", key.path.strip_prefix("vehicle.N.")?);
            let node = self.written.at(&path)?;
            let origin = self.texts.origin(node);
            Some(Explained { key: path, value: Some(node.plain().to_string()), origin, about: key.about })
        })
    }
}

/// The value at a path, if there is one.
fn at<'t>(table: &'t toml::Table, path: &str) -> Option<&'t Toml> {
    match path.split_once('.') {
        Some((name, rest)) => at(table.get(name)?.as_table()?, rest),
        None => table.get(path),
    }
}

fn formation_keys() -> impl Iterator<Item = &'static Key> {
    KEYS.iter().filter(|key| key.path.starts_with("formation."))
}

/// An event with the defaults of the keys that its kind takes.
fn event_in_full(mut event: toml::Table) -> toml::Table {
    let kind = ["fault", "order"].iter().find_map(|key| event.get(*key)?.as_str());
    let rules = FAULT_RULES.iter().chain(&ORDER_RULES).find(|(name, ..)| Some(*name) == kind);
    for name in rules.map_or(&[][..], |(_, _, optional)| *optional) {
        if let Some(value) = keys::find(&format!("mission.events[N].{name}")).and_then(|key| literal(key.default)) {
            event.entry(*name).or_insert(value);
        }
    }
    event
}

/// An entry of `network.links` with the defaults of its own keys.
fn link_in_full(mut link: toml::Table) -> toml::Table {
    for key in KEYS {
        if let Some((name, value)) = key.path.strip_prefix("network.links[N].").zip(literal(key.default)) {
            link.entry(name).or_insert(value);
        }
    }
    link
}

/// Puts a value of this key where the types expect it. A text that means "no number" is left out.
fn put(root: &mut toml::Table, key: Option<&Key>, path: &str, value: Option<Toml>) {
    let Some(value) = value else { return };
    if matches!(key.map(|key| key.kind), Some(Kind::NumberOr("none" | "from_widths", _))) && value.is_str() {
        return;
    }
    let mut table = root;
    let mut names = path.split('.').peekable();
    while let Some(name) = names.next() {
        if names.peek().is_none() {
            table.insert(name.to_owned(), value);
            return;
        }
        match table.entry(name).or_insert_with(|| Toml::Table(toml::Table::new())) {
            Toml::Table(inner) => table = inner,
            _ => return,
        }
    }
}

fn literal(literal: Literal) -> Option<Toml> {
    match literal {
        Literal::Required | Literal::Nothing | Literal::Same(_) => None,
        Literal::Number(number) => Some(Toml::Float(number)),
        Literal::Integer(number) => Some(Toml::Integer(number)),
        Literal::Bool(truth) => Some(Toml::Boolean(truth)),
        Literal::Text(text) => Some(Toml::String(text.to_owned())),
        Literal::Toml(text) => text.parse().ok(),
    }
}
