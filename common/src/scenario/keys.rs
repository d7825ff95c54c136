//! Keys of configuration files and their look-up by path. `table` defines every key of a scenario once: kind, range,
//! unit, defaults, meaning.
//!
//! The loader, the presets, `--set`, the error messages and the complete file all use that table; a test compares it
//! with the fields of [`Scenario`](super::Scenario). The look-up functions take a table, because other files have their
//! own.

mod nearest;
mod table;

use std::fmt;

use crate::id::VehicleId;
use crate::scenario::law;

use Kind::{Edges, Free, Id, Ids, Integer, Path, Point, Points, Texts};

pub use nearest::{NEVER_SUGGESTED, matching, most_similar, nearest_of};
pub(super) use nearest::{nearest, siblings};
pub use table::KEYS;
pub(super) use table::{FAULT_KEYS, ORDER_KEYS, REMOVED};

/// A key: its path, kind, defaults and meaning.
#[derive(Clone, Copy, Debug)]
pub struct Key {
    /// Path of the key: `N` is an id, `"T/N"` a vehicle of a fleet, `[N]` an index of a list. A step takes the keys of
    /// `formation` too.
    pub path: &'static str,
    /// Kind of the value.
    pub kind: Kind,
    /// Unit of the numbers, if the key's name does not end in it; see [`Key::unit`].
    pub own_unit: Option<&'static str>,
    /// Default of the key.
    pub default: Literal,
    /// Default under `preset = "paper"`, if it differs.
    pub paper: Option<Literal>,
    /// Default under `law = "flock"`, if it differs; it is the same in both presets.
    pub flock: Option<Literal>,
    /// Default that depends on another key.
    pub implied: Option<Implied>,
    /// Meaning of the key and reason for its default, for a reader without knowledge of the code.
    pub about: &'static str,
}

/// A default that applies when another key has a certain text.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Implied {
    /// The other key.
    pub by: &'static str,
    /// The text of the other key for which [`Self::value`] is the default.
    pub is: &'static str,
    /// The default in that case.
    pub value: Literal,
}

/// A key of earlier versions. A file that still has it is refused with the reason.
#[derive(Clone, Copy, Debug)]
pub(super) struct Removed {
    /// Path of the removed key.
    pub(super) path: &'static str,
    /// Why the key was removed, or what replaces it.
    pub(super) reason: &'static str,
}

/// Kind of a key's value.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    /// A finite number.
    Number(Range),
    /// A finite number or this text.
    NumberOr(&'static str, Range),
    /// A whole number, both ends included.
    Integer(i64, i64),
    /// true or false.
    Bool,
    /// true; the key cannot be set to false.
    True,
    /// One of these texts.
    OneOf(&'static [&'static str]),
    /// The name of a control law.
    Law,
    /// 1 to 64 letters, digits, '-' or '_'.
    Name,
    /// The name of a TOML file, 1 to 64 letters, digits, '-' or '_', with or without its ending.
    TomlName,
    /// A text that is not empty.
    Text,
    /// HOST:PORT after this prefix.
    Address(&'static str),
    /// A list of one text or more.
    Texts,
    /// A vehicle's id.
    Id,
    /// A list of one vehicle id or more.
    Ids,
    /// A list of pairs of vehicle ids, sender and receiver.
    Edges,
    /// A point: north and east, m.
    Point,
    /// A list of one point or more.
    Points,
    /// A line through two points or more; no two in a row are equal.
    Path,
    /// A list of tables; their keys are in [`KEYS`] with `[N]`.
    Tables,
    /// A table with any keys and any values that JSON can represent.
    Free,
}

impl Kind {
    /// Whether the key takes numbers that measure or count something; an id does neither.
    pub fn has_numbers(self) -> bool {
        matches!(
            self,
            Self::Number(_) | Self::NumberOr(..) | Self::Integer(..) | Self::Point | Self::Points | Self::Path
        )
    }

    /// The range of the numbers, as text.
    pub fn range(self) -> Option<String> {
        match self {
            Self::Number(range) | Self::NumberOr(_, range) => Some(range.to_string()),
            Self::Integer(min, max) => Some(format!("{min} to {max}")),
            Self::Id | Self::Ids | Self::Edges => Some(format!("1 to {}", VehicleId::MAX)),
            Self::Point | Self::Points | Self::Path => Some(COORDINATES_M.to_string()),
            _ => None,
        }
    }

    /// The texts that the key accepts; empty if it accepts any text or none.
    pub fn choices(self) -> Vec<&'static str> {
        match self {
            Self::OneOf(choices) => choices.to_vec(),
            Self::Law => law::names().collect(),
            _ => Vec::new(),
        }
    }
}

/// The kind as text.
impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(_) => f.write_str("number"),
            Self::NumberOr(choice, _) => write!(f, "number or \"{choice}\""),
            Self::Integer(..) => f.write_str("whole number"),
            Self::Bool => f.write_str("true or false"),
            Self::True => f.write_str("true, or left out"),
            Self::OneOf(_) | Self::Law => {
                let choices: Vec<_> = self.choices().into_iter().map(|choice| format!("\"{choice}\"")).collect();
                write!(f, "one of {}", choices.join(", "))
            }
            Self::Name => f.write_str("name of 1 to 64 letters, digits, '-' or '_'"),
            Self::TomlName => f.write_str("name of a TOML file, with or without \".toml\""),
            Self::Text => f.write_str("text"),
            Self::Address(prefix) => write!(f, "address {prefix}HOST:PORT"),
            Self::Texts => f.write_str("list of texts"),
            Self::Id => f.write_str("vehicle id"),
            Self::Ids => f.write_str("list of vehicle ids"),
            Self::Edges => f.write_str("list of pairs of vehicle ids, [[1, 2], [2, 3]]"),
            Self::Point => f.write_str("point [north, east]"),
            Self::Points | Self::Path => f.write_str("list of points, [[north, east], [north, east]]"),
            Self::Tables => f.write_str("list of tables"),
            Self::Free => f.write_str("table with any keys"),
        }
    }
}

/// Range of the coordinates of points, m. At its end the local plane is already 800 m above the ellipsoid.
pub(super) const COORDINATES_M: Range = Range { min: -1e5, max: 1e5, min_included: true };

/// A range of numbers; the upper end is included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Lower end.
    pub min: f64,
    /// Upper end.
    pub max: f64,
    /// Whether the lower end is included.
    pub min_included: bool,
}

impl Range {
    /// Whether the number is in the range; NaN is not.
    pub fn contains(self, number: f64) -> bool {
        (if self.min_included { self.min <= number } else { self.min < number }) && number <= self.max
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.min_included {
            write!(f, "{} to {}", self.min, self.max)
        } else {
            write!(f, "above {}, at most {}", self.min, self.max)
        }
    }
}

/// A default value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Literal {
    /// No default: the key has to be written.
    Required,
    /// No value.
    Nothing,
    /// The value of this other key.
    Same(&'static str),
    /// A number.
    Number(f64),
    /// A whole number.
    Integer(i64),
    /// true or false.
    Bool(bool),
    /// A text.
    Text(&'static str),
    /// Any other value, as TOML.
    Toml(&'static str),
}

/// The value as TOML, or a description of it.
impl fmt::Display for Literal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Required => f.write_str("none: the key is required"),
            Self::Nothing => f.write_str("none"),
            Self::Same(path) => write!(f, "the value of {path}"),
            Self::Number(number) => write!(f, "{number}"),
            Self::Integer(number) => write!(f, "{number}"),
            Self::Bool(truth) => write!(f, "{truth}"),
            Self::Text(text) => write!(f, "{text:?}"),
            Self::Toml(text) => f.write_str(text),
        }
    }
}

/// Units by the endings of keys' names; a longer ending is before the shorter ones that it ends in.
const UNITS: &[(&str, &str)] = &[
    ("bit_s", "bit/s"),
    ("m_s2", "m/s²"),
    ("m_s", "m/s"),
    ("per_s2", "1/s²"),
    ("per_s", "1/s"),
    ("per_m", "1/m"),
    ("deg_s", "°/s"),
    ("m", "m"),
    ("s", "s"),
    ("hz", "Hz"),
    ("deg", "°"),
    ("ppm", "ppm"),
];

impl Key {
    /// A key with one default.
    pub const fn new(path: &'static str, kind: Kind, default: Literal, about: &'static str) -> Self {
        Self { path, kind, own_unit: None, default, paper: None, flock: None, implied: None, about }
    }

    const fn unit_is(self, unit: &'static str) -> Self {
        Self { own_unit: Some(unit), ..self }
    }

    const fn paper(self, value: Literal) -> Self {
        Self { paper: Some(value), ..self }
    }

    const fn flock(self, value: Literal) -> Self {
        Self { flock: Some(value), ..self }
    }

    const fn implied(self, by: &'static str, is: &'static str, value: Literal) -> Self {
        Self { implied: Some(Implied { by, is, value }), ..self }
    }

    /// Name of the key: the last part of its path.
    pub fn name(&self) -> &'static str {
        self.path.rsplit('.').next().unwrap_or(self.path)
    }

    /// Unit of the numbers, "1" for pure numbers; `None` for a key without numbers.
    pub fn unit(&self) -> Option<&'static str> {
        self.own_unit.or_else(|| self.unit_in_name()).filter(|_| self.kind.has_numbers())
    }

    /// Unit in which the key's name ends.
    pub(super) fn unit_in_name(&self) -> Option<&'static str> {
        let ends = |end: &str| self.name().strip_suffix(end).is_some_and(|rest| rest.is_empty() || rest.ends_with('_'));
        UNITS.iter().find(|(end, _)| ends(end)).map(|(_, unit)| *unit)
    }

    /// Default under `preset = "paper"`, if it differs: the preset's own, or one that depends on another key of the
    /// preset.
    pub fn on_paper(&self) -> Option<Literal> {
        let follows = |implied: &Implied| find(implied.by)?.paper.filter(|paper| *paper == Literal::Text(implied.is));
        self.paper.or_else(|| self.implied.filter(|implied| follows(implied).is_some()).map(|implied| implied.value))
    }
}

/// What a path in a file refers to.
#[derive(Clone, Copy, Debug)]
pub(super) enum Meaning {
    /// A key.
    Key(&'static Key),
    /// A table that has keys below it.
    Table,
    /// A value inside a list or a free table, which the key of that list or table checks.
    Inside,
}

/// Whether this path is a key that takes whole numbers.
pub fn takes_whole_numbers(path: &str) -> bool {
    matches!(meaning(KEYS, path), Some(Meaning::Key(key)) if matches!(key.kind, Integer(..) | Id))
}

/// What this path refers to; `None` if it is unknown.
pub(super) fn meaning(known: &'static [Key], path: &str) -> Option<Meaning> {
    let pattern = pattern(known, path);
    let table = formation_table_of_step(&pattern).unwrap_or(&pattern);
    let below = |key: &Key| key.path.strip_prefix(table).is_some_and(|rest| rest.starts_with(['.', '[']));
    if let Some(key) = key_at(known, &pattern) {
        return Some(Meaning::Key(key));
    }
    if known.iter().any(below) {
        return Some(Meaning::Table);
    }
    let mut around = pattern.as_str();
    while let Some(end) = around.rfind(['.', '[']) {
        around = &around[..end];
        match key_at(known, around) {
            Some(key) if matches!(key.kind, Free) => return Some(Meaning::Inside),
            Some(key) if pattern[around.len()..].replace("[N]", "").is_empty() && is_list(key.kind) => {
                return Some(Meaning::Inside);
            }
            _ => {}
        }
    }
    None
}

fn is_list(kind: Kind) -> bool {
    matches!(kind, Texts | Ids | Edges | Point | Points | Path)
}

/// The path of the formation's table that corresponds to this table of a step's formation.
fn formation_table_of_step(pattern: &str) -> Option<&str> {
    let table = pattern.strip_prefix("mission.steps[N].").filter(|table| table.split('.').next() == Some("formation"));
    // A step has no `formation.external`: one program flies the whole mission.
    table.filter(|table| table.split('.').nth(1) != Some("external"))
}

/// The key of this pattern, including the keys of a step's formation.
fn key_at(known: &'static [Key], pattern: &str) -> Option<&'static Key> {
    match pattern.strip_prefix("mission.steps[N].formation.") {
        Some(rest) => known.iter().find(|key| key.path.strip_prefix("formation.") == Some(rest)),
        None => known.iter().find(|key| key.path == pattern),
    }
}

/// The name of a table in the path of a [`Key`] if the table is named by a vehicle of a fleet.
const IN_TEAM: &str = "\"T/N\"";

/// The scenario's key with this path.
pub(super) fn find(path: &str) -> Option<&'static Key> {
    KEYS.iter().find(|key| key.path == path)
}

/// The path with `N` for ids and indices: `mission.steps[3].name` becomes `mission.steps[N].name`, `vehicle.3.aircraft`
/// becomes `vehicle.N.aircraft`, and `node."3/7".host` becomes `node."T/N".host`.
fn pattern(known: &[Key], path: &str) -> String {
    let mut pattern = String::with_capacity(path.len());
    for (nth, segment) in path.split('.').enumerate() {
        if nth > 0 {
            pattern.push('.');
        }
        if nth == 1 && has_ids(known, &pattern) {
            // A name that is not an id matches no key, not even a literal N.
            let is_id = |text: &str| text.parse::<u32>().is_ok_and(|id| id.to_string() == text);
            let of_team = unquoted(segment).and_then(|name| name.split_once('/'));
            pattern.push_str(match of_team {
                None if is_id(segment) => "N",
                Some((team, vehicle)) if is_id(team) && is_id(vehicle) => IN_TEAM,
                _ => "?",
            });
            continue;
        }
        let mut parts = segment.split('[');
        pattern.push_str(parts.next().unwrap_or_default());
        for _ in parts {
            pattern.push_str("[N]");
        }
    }
    pattern
}

/// Whether the subtables of this table are named by ids, as those of `vehicle.` are.
fn has_ids(known: &[Key], table: &str) -> bool {
    known.iter().any(|key| key.path.strip_prefix(table).is_some_and(|rest| rest.starts_with("N.")))
}

/// The table whose subtables are named by ids, if this path names a subtable that is not an id.
pub(super) fn table_with_wrong_id<'p>(known: &[Key], path: &'p str) -> Option<&'p str> {
    let (table, name) = path.split_once('.')?;
    (!name.contains('.') && has_ids(known, &format!("{table}."))).then_some(table)
}

/// Joins the path of a table and a name in it. The name is quoted if necessary, so that it cannot look like a path.
pub(super) fn join(table: &str, name: &str) -> String {
    let name = if is_bare(name) { name.to_owned() } else { format!("{name:?}") };
    if table.is_empty() { name } else { format!("{table}.{name}") }
}

/// The name in a quoted part of a path that [`join`] made.
pub(super) fn unquoted(part: &str) -> Option<&str> {
    part.strip_prefix('"')?.strip_suffix('"')
}

/// Whether a name needs no quotes in TOML.
pub(super) fn is_bare(name: &str) -> bool {
    !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_')
}
