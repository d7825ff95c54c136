//! The keys of a scenario file in order, and their look-up by path. `keys!` declares every key once, with the
//! field that holds its value.
//!
//! The loader, the presets, `--set`, the error messages and the complete file all use that list; a test compares it
//! with the fields of [`Scenario`]. The look-up functions take a list, because other files have their own.

mod nearest;

use super::key::{Implied, Key, Kind, Literal};
use super::model::{
    Airspace, Control, DisplacementConsensus, EVENT_KEYS, External, Formation, LinkChange, Mission, Network,
    OlfatiSaber, OriginSettings, PointMassLimits, Record, SENSOR_ERROR_KEYS, STEP_KEYS, Scenario, Sensing, Slots,
    Start, StaticObstacle, Swarm, Udp, Vasarhelyi, Vehicle, VehicleModel, World,
};

use Kind::{Edges, Free, Id, Ids, Integer, Path, Point, Points, Texts};

pub use nearest::{NEVER_SUGGESTED, matching, most_similar, nearest_of};
pub(super) use nearest::{nearest, siblings};

/// The keys of all tables of a scenario file, in the order in which the complete file is written.
const TABLES: &[&[Key]] = &[
    Scenario::KEYS,
    Swarm::KEYS,
    VehicleModel::KEYS,
    PointMassLimits::KEYS,
    Start::KEYS,
    OriginSettings::KEYS,
    Formation::KEYS,
    Slots::KEYS,
    DisplacementConsensus::KEYS,
    OlfatiSaber::KEYS,
    Vasarhelyi::KEYS,
    External::KEYS,
    Udp::KEYS,
    Mission::KEYS,
    STEP_KEYS,
    EVENT_KEYS,
    Control::KEYS,
    Sensing::KEYS,
    SENSOR_ERROR_KEYS,
    Airspace::KEYS,
    StaticObstacle::KEYS,
    World::KEYS,
    Network::KEYS,
    LinkChange::KEYS,
    Record::KEYS,
    Vehicle::KEYS,
];

/// Every key of a scenario file, the keys of one table together.
pub const KEYS: &[Key] = &{
    let mut keys = [TABLES[0][0]; COUNT];
    let (mut count, mut table, mut nth) = (0, 0, 0);
    while count < COUNT {
        if nth < TABLES[table].len() {
            keys[count] = TABLES[table][nth];
            (count, nth) = (count + 1, nth + 1);
        } else {
            (table, nth) = (table + 1, 0);
        }
    }
    keys
};

const COUNT: usize = {
    let (mut count, mut table) = (0, 0);
    while table < TABLES.len() {
        count += TABLES[table].len();
        table += 1;
    }
    count
};

/// Keys of earlier versions, each with why it was removed, or what replaces it. A file that still has one is refused with
/// that reason.
pub(super) const REMOVED: &[(&str, &str)] =
    &[("network.state_json_hz", "the state for people will be published as `summary`")];

impl Key {
    /// Default under `preset = "paper"`, if it differs: the preset's own, or one that depends on another key of the
    /// preset.
    pub fn on_paper(&self) -> Option<Literal> {
        let follows = |implied: &Implied| find(implied.by)?.paper.filter(|paper| *paper == Literal::Text(implied.is));
        self.paper.or_else(|| self.implied.filter(|implied| follows(implied).is_some()).map(|implied| implied.value))
    }
}

/// The thing to which a path in a file refers.
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

/// Finds to what this path refers; `None` if it is unknown.
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
