//! Tree of the written values, with the position of every value: the file, with `--set` options applied to it.

use std::collections::BTreeMap;
use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::error::ScenarioError;
use super::key::Key;
use super::keys::{self, REMOVED};
use super::kind::FileKind;
use super::{Layer, Source};
use crate::id::TeamId;

/// Position of a written value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// Byte range in the file.
    File(Range<usize>),
    /// Index of the `--set` option.
    Set(usize),
}

/// A value with its position.
#[derive(Clone, Debug)]
pub(super) struct Node {
    pub(super) place: Place,
    pub(super) value: Value,
}

/// A value whose parts have positions too.
#[derive(Clone, Debug)]
pub(super) enum Value {
    /// Text, number, true or false, or date.
    Plain(toml::Value),
    List(Vec<Node>),
    Table(Table),
}

/// A table: each name has a position of its own.
pub(super) type Table = BTreeMap<String, (Place, Node)>;

impl Node {
    /// The value without positions.
    pub(super) fn plain(&self) -> toml::Value {
        match &self.value {
            Value::Plain(value) => value.clone(),
            Value::List(items) => toml::Value::Array(items.iter().map(Self::plain).collect()),
            Value::Table(table) => {
                toml::Value::Table(table.iter().map(|(name, (_, node))| (name.clone(), node.plain())).collect())
            }
        }
    }

    pub(super) fn table(&self) -> Option<&Table> {
        match &self.value {
            Value::Table(table) => Some(table),
            Value::Plain(_) | Value::List(_) => None,
        }
    }

    pub(super) fn list(&self) -> &[Self] {
        match &self.value {
            Value::List(items) => items,
            Value::Plain(_) | Value::Table(_) => &[],
        }
    }

    /// The node at a path such as `mission.steps[1].name`.
    pub(super) fn at(&self, path: &str) -> Option<&Self> {
        steps(path)?.into_iter().try_fold(self, |node, step| match step {
            PathStep::Name(name) => Some(&node.table()?.get(name)?.1),
            PathStep::Index(index) => node.list().get(index),
        })
    }

    /// Whether a `--set` option wrote this value or a part of it.
    pub(super) fn is_set(&self) -> bool {
        matches!(self.place, Place::Set(_))
            || self.list().iter().any(Self::is_set)
            || self.table().is_some_and(|table| table.values().any(|(_, node)| node.is_set()))
    }
}

/// Largest number of keys that an error message lists.
const MAX_LISTED_KEYS: usize = 12;

/// The keys of a table, for an error message.
pub(super) fn list_of_keys<'k>(names: impl Iterator<Item = &'k str>) -> String {
    format!("the keys here are {}", names.map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", "))
}

/// The file and the `--set` options, with the keys that are allowed in them.
#[derive(Clone, Copy)]
pub(super) struct Texts<'a> {
    pub(super) kind: FileKind,
    pub(super) keys: &'static [Key],
    pub(super) source: &'a Source<'a>,
    pub(super) sets: &'a [String],
    pub(super) part: Part,
}

/// The part of a file that is read.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    /// The whole file. It has to describe one swarm.
    Whole,
    /// The scenario that all teams of a fleet have in common.
    Common,
    /// The scenario of one team of a fleet.
    Team(TeamId),
}

impl Texts<'_> {
    /// The path of a `--set` option, without the team that it is for.
    pub(super) fn path_of(&self, index: usize) -> Option<&str> {
        let path = self.sets[index].split_once('=')?.0.trim();
        let (_, rest) = without_team(path).filter(|_| self.part != Part::Whole).unwrap_or(("", path));
        Some(rest)
    }

    /// Whether a `--set` option is for the scenario that is read: not for the fleet, and not for another team.
    pub(super) fn is_for_scenario(&self, index: usize) -> bool {
        let path = self.sets[index].split_once('=').map_or("", |(path, _)| path.trim());
        match (self.part, without_team(path)) {
            (Part::Whole, _) => true,
            (Part::Common, Some(_)) => false,
            (Part::Team(own), Some((team, _))) => own.get().to_string() == team,
            (_, None) => !path.starts_with("fleet."),
        }
    }

    /// The team that a `--set` option is for, as written.
    pub(super) fn team_of(&self, index: usize) -> Option<&str> {
        Some(without_team(self.sets[index].split_once('=')?.0.trim())?.0)
    }

    /// An error at a position.
    pub(super) fn fault(&self, place: &Place, key: &str, message: impl Into<String>) -> ScenarioError {
        let (file, position, span) = match place {
            Place::File(span) => {
                (self.source.name.to_owned(), Some(self.source.position(span.start)), Some(span.clone()))
            }
            Place::Set(index) => (format!("--set {}", shown(&self.sets[*index])), None, None),
        };
        ScenarioError {
            file: file.into(),
            line: position.map(|(line, _)| line),
            column: position.map(|(_, column)| column),
            key: (!key.is_empty()).then(|| key.into()),
            message: message.into().into(),
            help: None,
            span,
        }
    }

    /// Refuses a file whose keys show that it is of another kind.
    pub(super) fn check_kind(&self, root: &Node) -> Result<(), ScenarioError> {
        let Some(table) = root.table() else { return Ok(()) };
        let is_text = |node: &Node| matches!(&node.value, Value::Plain(toml::Value::String(_)));
        let kind = |name: &str, node: &Node| FileKind::of_key(name, node.table().is_some(), is_text(node));
        let signs = table.iter().filter_map(|(name, (place, node))| Some((place, kind(name, node)?)));
        let first = |place: &Place| match place {
            Place::File(span) => span.start,
            Place::Set(_) => usize::MAX,
        };
        let Some((place, found)) = signs.clone().min_by_key(|(place, _)| first(place)) else { return Ok(()) };
        if found == self.kind || signs.clone().any(|(_, other)| other != found) {
            return Ok(());
        }
        Err(ScenarioError {
            help: Some(found.remedy(self.kind, self.source.name).into()),
            ..self.fault(place, "", format!("this is {}, not {}", found.name(), self.kind.name()))
        })
    }

    /// The error for an unknown key. It names the reason if the key was removed, or else the most similar key, or else
    /// all keys of the table.
    pub(super) fn unknown(&self, place: &Place, path: &str) -> ScenarioError {
        let removed = REMOVED.iter().find(|(removed, _)| self.kind == FileKind::Scenario && *removed == path);
        if let Some((_, reason)) = removed {
            let help = match place {
                Place::File(_) => "remove the line",
                Place::Set(_) => "leave this `--set` out",
            };
            let message = format!("`{path}` was removed: {reason}");
            return ScenarioError { help: Some(help.into()), ..self.fault(place, path, message) };
        }
        let nearest = keys::nearest(self.keys, path).map(|nearest| format!("did you mean `{nearest}`?"));
        ScenarioError {
            help: nearest.or_else(|| self.choices(path)).map(Into::into),
            ..self.fault(place, path, format!("unknown key `{}`", shown(path)))
        }
    }

    /// The keys of the table in which this path is not a key.
    fn choices(&self, path: &str) -> Option<String> {
        let (table, _) = path.rsplit_once('.').unwrap_or_default();
        let names = keys::siblings(self.keys, table);
        match names.len() {
            1..=MAX_LISTED_KEYS => Some(list_of_keys(names.into_iter())),
            0 => None,
            _ if self.kind == FileKind::Scenario => {
                Some(format!("`{}` lists the keys", format!("skein files explain {table}").trim_end()))
            }
            _ => None,
        }
    }

    /// Origin of a value.
    pub(super) fn origin(&self, node: &Node) -> Layer {
        match &node.place {
            Place::File(span) if !node.is_set() => {
                Layer::File { name: self.source.name.to_owned(), line: self.source.position(span.start).0 }
            }
            _ => Layer::Set,
        }
    }

    /// The file's tree.
    pub(super) fn parse(&self) -> Result<Node, ScenarioError> {
        let text = self.source.text;
        let root = DeTable::parse(text).map_err(|error| {
            let span = error.span().unwrap_or(0..0);
            let is_double = error.message() == "duplicate key";
            ScenarioError {
                help: is_double.then(|| "remove one of the two".into()),
                ..self.fault(&Place::File(span), "", format!("not TOML: {}", error.message()))
            }
        })?;
        let mut read = Reader { texts: self, place: Place::File };
        Ok(Node { place: Place::File(0..0), value: read.table(root.into_inner())? })
    }

    /// Checks a tree, and after each `--set` option that is meant for it and applied to it checks it again.
    pub(super) fn complete(&self, root: &mut Node, is_meant: impl Fn(usize) -> bool) -> Result<(), ScenarioError> {
        self.check_table(root, "")?;
        for index in (0..self.sets.len()).filter(|&index| is_meant(index)) {
            self.set(root, index)?;
            self.check_table(root, "")?;
        }
        Ok(())
    }

    /// Applies the `--set` option number `index` to a checked tree.
    fn set(&self, root: &mut Node, index: usize) -> Result<(), ScenarioError> {
        let place = Place::Set(index);
        let (Some(path), Some((_, text))) = (self.path_of(index), self.sets[index].split_once('=')) else {
            return Err(self.fault(&place, "", "not of the form key=value"));
        };
        let text = text.trim();
        let spelling = "not the path of a key; paths look like formation.radius_m and mission.steps[0].name";
        let steps = steps(path).ok_or_else(|| self.fault(&place, path, spelling))?;
        if keys::meaning(self.keys, path).is_none() {
            return Err(self.unknown(&place, path));
        }
        let value = self.set_value(text, index, path)?;
        let mut node = root;
        let mut so_far = String::new();
        for step in steps {
            node = self.enter(node, &step, &so_far, &place)?;
            so_far = match step {
                PathStep::Name(name) => keys::join(&so_far, name),
                PathStep::Index(index) => format!("{so_far}[{index}]"),
            };
        }
        *node = value;
        Ok(())
    }

    /// Descends one step of a path; a missing table is made.
    fn enter<'n>(
        &self,
        node: &'n mut Node,
        step: &PathStep<'_>,
        so_far: &str,
        place: &Place,
    ) -> Result<&'n mut Node, ScenarioError> {
        let empty = || Node { place: place.clone(), value: Value::Table(Table::new()) };
        match (step, &mut node.value) {
            (PathStep::Name(name), Value::Table(table)) => {
                Ok(&mut table.entry((*name).to_owned()).or_insert_with(|| (place.clone(), empty())).1)
            }
            (PathStep::Index(index), Value::List(items)) => {
                let count = items.len();
                let message = format!("`{so_far}[{index}]` is beyond the end: `{so_far}` has {count}, counted from 0");
                items.get_mut(*index).ok_or_else(|| self.fault(place, so_far, message))
            }
            (PathStep::Index(_), Value::Table(table)) if table.is_empty() => {
                Err(self.fault(place, so_far, format!("`{so_far}` has no entries in {}", self.source.name)))
            }
            (PathStep::Index(_), _) => Err(self.fault(place, so_far, format!("`{so_far}` is not a list"))),
            (PathStep::Name(_), _) => Err(self.fault(place, so_far, format!("`{so_far}` is not a table"))),
        }
    }

    /// The value of a `--set` option: TOML, or else the text itself.
    fn set_value(&self, text: &str, index: usize, path: &str) -> Result<Node, ScenarioError> {
        let place = Place::Set(index);
        if text.is_empty() {
            return Err(self.fault(&place, path, format!("`{path}` has no value")));
        }
        match DeValue::parse(text) {
            Ok(value) => Reader { texts: self, place: |_| Place::Set(index) }.node(value),
            Err(error) if text.starts_with(['[', '{', '"', '\'']) => {
                Err(self.fault(&place, path, format!("not TOML: {}", error.message())))
            }
            Err(_) => Ok(Node { place, value: Value::Plain(toml::Value::String(text.to_owned())) }),
        }
    }
}

/// The team of a path such as `team.3.formation.radius_m`, and the rest.
fn without_team(path: &str) -> Option<(&str, &str)> {
    path.strip_prefix("team.")?.split_once('.')
}

/// Conversion of the parser's tree to [`Node`]s.
struct Reader<'a, P> {
    texts: &'a Texts<'a>,
    place: P,
}

impl<P: Fn(Range<usize>) -> Place> Reader<'_, P> {
    fn node(&mut self, value: Spanned<DeValue<'_>>) -> Result<Node, ScenarioError> {
        let place = (self.place)(value.span());
        let value = match value.into_inner() {
            DeValue::String(text) => Value::Plain(toml::Value::String(text.into_owned())),
            DeValue::Integer(integer) => match i64::from_str_radix(integer.as_str(), integer.radix()) {
                Ok(integer) => Value::Plain(toml::Value::Integer(integer)),
                Err(_) => return Err(self.texts.fault(&place, "", format!("{integer} is too large an integer"))),
            },
            DeValue::Float(float) => match float.as_str().parse::<f64>() {
                // Adding zero turns -0.0 into 0.0: equal values, equal bits, equal hashes.
                Ok(number) if number.is_finite() => Value::Plain(toml::Value::Float(number + 0.0)),
                _ => return Err(self.texts.fault(&place, "", format!("{float} is not a finite number"))),
            },
            DeValue::Boolean(truth) => Value::Plain(toml::Value::Boolean(truth)),
            DeValue::Datetime(date) => Value::Plain(toml::Value::Datetime(date)),
            DeValue::Array(items) => {
                Value::List(items.into_iter().map(|item| self.node(item)).collect::<Result<_, _>>()?)
            }
            DeValue::Table(table) => self.table(table)?,
        };
        Ok(Node { place, value })
    }

    fn table(&mut self, table: DeTable<'_>) -> Result<Value, ScenarioError> {
        let mut read = Table::new();
        for (name, value) in table {
            let place = (self.place)(name.span());
            read.insert(name.into_inner().into_owned(), (place, self.node(value)?));
        }
        Ok(Value::Table(read))
    }
}

/// One step of a `--set` path.
enum PathStep<'a> {
    Name(&'a str),
    Index(usize),
}

/// Splits a path such as `mission.steps[1].name` or `node."3/7".host` into steps; `None` if it is not a path.
fn steps(path: &str) -> Option<Vec<PathStep<'_>>> {
    let mut steps = Vec::new();
    for segment in path.split('.') {
        if let Some(quoted) = keys::unquoted(segment) {
            steps.push(PathStep::Name(quoted));
            continue;
        }
        let (name, places) = segment.split_at(segment.find('[').unwrap_or(segment.len()));
        if !keys::is_bare(name) {
            return None;
        }
        steps.push(PathStep::Name(name));
        if !places.is_empty() {
            for place in places.strip_prefix('[')?.strip_suffix(']')?.split("][") {
                steps.push(PathStep::Index(place.parse().ok()?));
            }
        }
    }
    Some(steps)
}

/// A foreign text, cut and without control characters, for an error message.
pub(super) fn shown(text: &str) -> String {
    let short: String = text.chars().take(80).map(|c| if c.is_control() { ' ' } else { c }).collect();
    if short.len() < text.len() { short + "..." } else { short }
}
