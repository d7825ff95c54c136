//! What a key is, and what a path in a file stands for. The keys of a scenario stand in `table`, once: kind, range, unit,
//! defaults, meaning.
//!
//! The loader, the presets, `--set`, the messages and the complete file all read this table; a test holds it against the
//! fields of [`Scenario`](super::Scenario). What looks keys up takes the table: other files have their own.

mod nearest;
mod table;

use std::fmt;

use crate::id::VehicleId;
use crate::scenario::law;

use Kind::{Edges, Free, Id, Ids, Integer, Path, Point, Texts};

pub use nearest::{matching, meant, nearest_of};
pub(super) use nearest::{nearest, siblings};
pub use table::KEYS;
pub(super) use table::{FAULT_KEYS, ORDER_KEYS, REMOVED};

/// A key: how it is spelled, what it takes, what it is when it is not written, what it means.
#[derive(Clone, Copy, Debug)]
pub struct Key {
    /// Dotted; `N` stands for an id, `[N]` for a place in a list. A step takes the keys of `formation` too.
    pub path: &'static str,
    /// What it takes.
    pub kind: Kind,
    /// Unit of its numbers, where the key's name does not end in it; see [`Key::unit`].
    pub own_unit: Option<&'static str>,
    /// Value below everything.
    pub default: Literal,
    /// Value under `preset = "paper"`, where it differs.
    pub paper: Option<Literal>,
    /// Value under `law = "flock"`, where it differs; the same in both presets.
    pub flock: Option<Literal>,
    /// Value that follows from another key, where it differs.
    pub implied: Option<Implied>,
    /// What it means, and why the default is what it is: for a reader who does not know the code.
    pub about: &'static str,
}

/// A default that follows from the text that another key has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Implied {
    /// The other key.
    pub by: &'static str,
    /// What it has to be.
    pub is: &'static str,
    /// The default then.
    pub value: Literal,
}

/// A key that earlier versions knew. A file that still has it is refused with the reason.
#[derive(Clone, Copy, Debug)]
pub(super) struct Removed {
    /// As it was spelled.
    pub(super) path: &'static str,
    /// Why it is gone, or what takes its place.
    pub(super) reason: &'static str,
}

/// What a key takes.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    /// A finite number.
    Number(Range),
    /// A finite number or this word.
    NumberOr(&'static str, Range),
    /// A whole number, both ends included.
    Integer(i64, i64),
    /// true or false.
    Bool,
    /// Nothing but true.
    True,
    /// One of these texts.
    OneOf(&'static [&'static str]),
    /// A law's name.
    Law,
    /// 1 to 64 letters, digits, '-' or '_'.
    Name,
    /// The same as the name of a TOML file, whose ending may stand behind it and is cut off.
    TomlName,
    /// A text that is not empty.
    Text,
    /// HOST:PORT, behind this prefix.
    Address(&'static str),
    /// One text or more.
    Texts,
    /// A vehicle's id.
    Id,
    /// One vehicle id or more.
    Ids,
    /// Pairs of vehicle ids.
    Edges,
    /// North and east.
    Point,
    /// Two points or more.
    Path,
    /// One table or more; their keys stand in the table with `[N]`.
    Tables,
    /// A table of anything that JSON can say.
    Free,
}

impl Kind {
    /// Whether it takes numbers that measure or count something: ids do not.
    pub fn has_numbers(self) -> bool {
        matches!(self, Self::Number(_) | Self::NumberOr(..) | Self::Integer(..) | Self::Point | Self::Path)
    }

    /// The range of its numbers, in words.
    pub fn range(self) -> Option<String> {
        match self {
            Self::Number(range) | Self::NumberOr(_, range) => Some(range.to_string()),
            Self::Integer(min, max) => Some(format!("{min} to {max}")),
            Self::Id | Self::Ids | Self::Edges => Some(format!("1 to {}", VehicleId::MAX)),
            Self::Point | Self::Path => Some(COORDINATES_M.to_string()),
            _ => None,
        }
    }

    /// The texts that it takes and no others; empty if others are free.
    pub fn words(self) -> Vec<&'static str> {
        match self {
            Self::OneOf(words) => words.to_vec(),
            Self::Law => law::names().collect(),
            _ => Vec::new(),
        }
    }
}

/// What it takes, in words.
impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(_) => f.write_str("number"),
            Self::NumberOr(word, _) => write!(f, "number or \"{word}\""),
            Self::Integer(..) => f.write_str("whole number"),
            Self::Bool => f.write_str("true or false"),
            Self::True => f.write_str("true, or left out"),
            Self::OneOf(_) | Self::Law => {
                let words: Vec<_> = self.words().into_iter().map(|word| format!("\"{word}\"")).collect();
                write!(f, "one of {}", words.join(", "))
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
            Self::Path => f.write_str("list of points, [[north, east], [north, east]]"),
            Self::Tables => f.write_str("list of tables"),
            Self::Free => f.write_str("table with any keys"),
        }
    }
}

/// Coordinates of points, m: farther out, the plane that touches the ellipsoid is 800 m above it.
pub(super) const COORDINATES_M: Range = Range { min: -1e5, max: 1e5, min_included: true };

/// Of numbers; the upper end is included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Lower end.
    pub min: f64,
    /// Upper end.
    pub max: f64,
    /// Whether the lower end belongs to it.
    pub min_included: bool,
}

impl Range {
    /// Whether the number lies in it; NaN does not.
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

/// A default.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Literal {
    /// The file has to say it.
    Required,
    /// Absent.
    Nothing,
    /// Whatever this other key is.
    Same(&'static str),
    /// A number.
    Number(f64),
    /// A whole number.
    Integer(i64),
    /// true or false.
    Bool(bool),
    /// A text.
    Text(&'static str),
    /// Anything else, as TOML.
    Toml(&'static str),
}

/// As a file spells it; what no file can spell, in words.
impl fmt::Display for Literal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Required => f.write_str("none, it has to be written"),
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

/// Units by the ends of keys' names, longer ends before those that they end in.
const UNITS: &[(&str, &str)] = &[
    ("bit_s", "bit/s"),
    ("m_s2", "m/s²"),
    ("m_s", "m/s"),
    ("per_s2", "1/s²"),
    ("per_s", "1/s"),
    ("per_m", "1/m"),
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

    /// The last part of the path.
    pub fn name(&self) -> &'static str {
        self.path.rsplit('.').next().unwrap_or(self.path)
    }

    /// The unit of its numbers, "1" for pure numbers; `None` for a key without numbers.
    pub fn unit(&self) -> Option<&'static str> {
        self.own_unit.or_else(|| self.unit_in_name()).filter(|_| self.kind.has_numbers())
    }

    /// The unit that the name ends in.
    pub(super) fn unit_in_name(&self) -> Option<&'static str> {
        let ends = |end: &str| self.name().strip_suffix(end).is_some_and(|rest| rest.is_empty() || rest.ends_with('_'));
        UNITS.iter().find(|(end, _)| ends(end)).map(|(_, unit)| *unit)
    }

    /// The default under `preset = "paper"`, where it differs: the preset's own, or one that follows from another key's.
    pub fn on_paper(&self) -> Option<Literal> {
        let follows = |implied: &Implied| find(implied.by)?.paper.filter(|paper| *paper == Literal::Text(implied.is));
        self.paper.or_else(|| self.implied.filter(|implied| follows(implied).is_some()).map(|implied| implied.value))
    }
}

/// What a name in a file stands for.
#[derive(Clone, Copy, Debug)]
pub(super) enum Meaning {
    /// A key.
    Key(&'static Key),
    /// A table that has keys below it.
    Table,
    /// Inside a list or a free table: the key around it knows what it takes.
    Inside,
}

/// Whether this dotted path is a key that takes whole numbers.
pub fn is_whole(path: &str) -> bool {
    matches!(meaning(KEYS, path), Some(Meaning::Key(key)) if matches!(key.kind, Integer(..) | Id))
}

/// What this dotted path stands for, if anything.
pub(super) fn meaning(known: &'static [Key], path: &str) -> Option<Meaning> {
    let pattern = pattern(known, path);
    let table = in_step(&pattern).unwrap_or(&pattern);
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
    matches!(kind, Texts | Ids | Edges | Point | Path)
}

/// The table of the formation that is meant by one inside a step.
fn in_step(pattern: &str) -> Option<&str> {
    let table = pattern.strip_prefix("mission.steps[N].").filter(|table| table.split('.').next() == Some("formation"));
    // A step has no `formation.external`: one program flies the whole mission.
    table.filter(|table| table.split('.').nth(1) != Some("external"))
}

/// The key of this pattern, those of `formation` inside a step included.
fn key_at(known: &'static [Key], pattern: &str) -> Option<&'static Key> {
    match pattern.strip_prefix("mission.steps[N].formation.") {
        Some(rest) => known.iter().find(|key| key.path.strip_prefix("formation.") == Some(rest)),
        None => known.iter().find(|key| key.path == pattern),
    }
}

/// The key with this path, which stands in the scenario's table.
pub(super) fn find(path: &str) -> Option<&'static Key> {
    KEYS.iter().find(|key| key.path == path)
}

/// `mission.steps[3].name` to `mission.steps[N].name`, `vehicle.3.aircraft` to `vehicle.N.aircraft`.
fn pattern(known: &[Key], path: &str) -> String {
    let mut pattern = String::with_capacity(path.len());
    for (place, segment) in path.split('.').enumerate() {
        if place > 0 {
            pattern.push('.');
        }
        if place == 1 && has_ids(known, &pattern) {
            // What is not an id matches nothing, not even a literal N.
            let is_id = segment.parse::<u32>().is_ok_and(|id| id.to_string() == segment);
            pattern.push(if is_id { 'N' } else { '?' });
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

/// Whether tables of ids stand below this one, `vehicle.`.
fn has_ids(known: &[Key], table: &str) -> bool {
    known.iter().any(|key| key.path.strip_prefix(table).is_some_and(|rest| rest.starts_with("N.")))
}

/// The table of ids that this path goes into with something that is no id.
pub(super) fn no_id<'p>(known: &[Key], path: &'p str) -> Option<&'p str> {
    let (table, name) = path.split_once('.')?;
    (!name.contains('.') && has_ids(known, &format!("{table}."))).then_some(table)
}

/// A table's path and a name in it, quoted where it has to be: so that no name passes for a path.
pub(super) fn join(table: &str, name: &str) -> String {
    let name = if is_bare(name) { name.to_owned() } else { format!("{name:?}") };
    if table.is_empty() { name } else { format!("{table}.{name}") }
}

/// Whether a name needs no quotes in TOML.
pub(super) fn is_bare(name: &str) -> bool {
    !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_')
}
