//! The scenario file: one file describes a swarm, for live flights and for studies.
//!
//! ```
//! use skein_common::scenario::{Source, load};
//!
//! let text = "[swarm]\nvehicles = 4\n[formation]\nraduis_m = 80\n";
//! let error = load(&Source { name: "my.toml", text }, &[]).unwrap_err();
//! assert_eq!(error.to_string(), "my.toml:4:1: unknown key `formation.raduis_m`; did you mean `formation.radius_m`?");
//!
//! let loaded = load(&Source { name: "my.toml", text: "swarm.vehicles = 4" }, &["formation.radius_m=80".into()])?;
//! assert_eq!(loaded.scenario.formation.radius_m, 80.0);
//! # Ok::<(), skein_common::scenario::ScenarioError>(())
//! ```
//!
//! A file is read in these steps: `tree` parses the text, with the position of every value, and applies `--set`;
//! `check` and `shape` compare every key with [`KEYS`], and the keys of one table with each other; `layers` adds the
//! preset and the defaults; `across` checks combinations of keys; the result is a [`Scenario`].

mod across;
mod check;
mod error;
mod fleet;
mod key;
mod keys;
mod kind;
mod law;
mod layers;
mod model;
mod plan;
mod shape;
mod tree;
mod tuning;
mod written;

use std::collections::BTreeMap;
use std::fmt;

pub use error::ScenarioError;
pub use fleet::{Described, FLEET_KEYS, load_any};
pub use key::{Implied, Key, Kind, Literal, Range, split_unit};
pub use keys::{KEYS, NEVER_SUGGESTED, matching, most_similar, nearest_of, takes_whole_numbers};
pub use kind::FileKind;
pub use law::{LawNameError, OwnLaw, add_laws};
pub use model::*;
pub use tuning::{SettingError, Settings};
pub use written::Written;

use layers::Layers;
use tree::{Part, Texts};

/// Name and text of a file.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    /// Name of the file for error messages.
    pub name: &'a str,
    /// The whole text of the file.
    pub text: &'a str,
}

impl Source<'_> {
    /// Line and column of a byte, both counted from 1, the column in characters; a byte order mark has no width.
    pub fn position(&self, byte: usize) -> (usize, usize) {
        let before = self.text.get(..byte).unwrap_or(self.text);
        let line = before.matches('\n').count() + 1;
        let start = before.rfind('\n').map_or(0, |end| end + 1);
        (line, before[start..].chars().filter(|&c| c != '\u{feff}').count() + 1)
    }
}

/// Reads a scenario. A value in `sets` overrides the file, the file overrides the preset, and the preset overrides the
/// default. Each entry of `sets` is `key=value` as `--set` takes it; a later one overrides an earlier one. Its value is
/// TOML, or else a text without quotes: `vehicle.3.aircraft=r22`. Lists count from 0:
/// `mission.steps[1].formation.radius_m=50`.
///
/// # Errors
/// The first error found: not TOML, an unknown key, a value of the wrong kind or out of its range, or values that
/// contradict each other.
pub fn load(source: &Source<'_>, sets: &[String]) -> Result<Loaded, ScenarioError> {
    let texts = Texts { kind: FileKind::Scenario, keys: KEYS, source, sets, part: Part::Whole };
    let written = texts.parse()?;
    texts.check_kind(&written)?;
    if let Some(fleet) = written.at("fleet") {
        return Err(texts.fault(&fleet.place, "fleet", "this is a fleet of several teams, not one swarm"));
    }
    finish(&texts, written)
}

/// Checks the written values and adds the preset and the defaults.
fn finish(texts: &Texts<'_>, mut written: tree::Node) -> Result<Loaded, ScenarioError> {
    texts.complete(&mut written, |index| texts.is_for_scenario(index))?;
    shape::check(texts, &written)?;
    let layers = Layers::new(texts, &written)?;
    let scenario = layers.scenario()?;
    across::check(texts, &written, &scenario)?;
    Ok(Loaded { scenario, notes: layers.notes(), lines: layers.lines() })
}

/// A valid scenario, with the origin of every value.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The scenario.
    pub scenario: Scenario,
    /// Notes for the author of the file, a line each: keys of the file that override the preset.
    pub notes: Vec<String>,
    lines: Vec<Explained>,
}

/// One value of the complete scenario.
#[derive(Clone, Debug, PartialEq)]
pub struct Explained {
    /// Path of the key, as `--set` takes it.
    pub key: String,
    /// The value as TOML; `None` for an absent value that TOML cannot express.
    pub value: Option<String>,
    /// Origin of the value.
    pub origin: Layer,
    /// Meaning of the key, and the reason for its default.
    pub about: &'static str,
}

/// Origin of a value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Layer {
    /// The default of the key.
    Default,
    /// The preset.
    Preset,
    /// The default that follows from this other key.
    Implied(&'static str),
    /// The file.
    File {
        /// Name of the file, as the caller gave it.
        name: String,
        /// Line, counted from 1.
        line: usize,
    },
    /// A `--set` option.
    Set,
}

impl fmt::Display for Layer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Default => f.write_str("default"),
            Self::Preset => f.write_str("preset"),
            Self::Implied(key) => write!(f, "from {key}"),
            Self::File { name, line } => write!(f, "{name}:{line}"),
            Self::Set => f.write_str("--set"),
        }
    }
}

impl Loaded {
    /// All keys with their values and origins, in the order of the complete file.
    pub fn explain(&self) -> &[Explained] {
        &self.lines
    }

    /// Every value as TOML by its key; a list is one value.
    fn values(&self) -> BTreeMap<String, String> {
        let mut values: BTreeMap<String, String> = BTreeMap::new();
        for line in &self.lines {
            let Some(value) = &line.value else { continue };
            match line.key.find('[') {
                None => _ = values.insert(line.key.clone(), value.clone()),
                Some(end) => {
                    let list = values.entry(line.key[..end].to_owned()).or_insert_with(|| "[]".to_owned());
                    let separator = if list == "[]" { "" } else { ", " };
                    list.replace_range(list.len() - 1.., &format!("{separator}{value}]"));
                }
            }
        }
        values
    }

    /// Replaces a value by one that follows from the fleet.
    fn override_with(&mut self, path: &str, value: toml::Value) {
        if let Some(line) = self.lines.iter_mut().find(|line| line.key == path) {
            (line.value, line.origin) = (Some(value.to_string()), Layer::Implied("fleet"));
        }
    }

    /// The complete scenario as a file, with the origin of each value as a comment. Reading it gives the same
    /// [`Scenario`], even with a version of Skein that has other defaults.
    pub fn to_toml(&self) -> String {
        let mut file = String::new();
        let mut open_table = "";
        let mut lines = self.lines.iter().filter_map(|line| Some((line, line.value.as_deref()?))).peekable();
        while let Some((line, value)) = lines.next() {
            let (path, index) = line.key.split_at(line.key.find('[').unwrap_or(line.key.len()));
            let (table, name) = path.rsplit_once('.').unwrap_or(("", path));
            if table != open_table {
                file += &format!("\n[{table}]\n");
                open_table = table;
            }
            let last = lines.peek().is_none_or(|(next, _)| !next.key.starts_with(&format!("{path}[")));
            file += &match index {
                "" => with_comment(&format!("{name} = {value}"), &line.origin),
                "[0]" => format!("{name} = [\n") + &with_comment(&format!("  {value},"), &line.origin),
                _ => with_comment(&format!("  {value},"), &line.origin),
            };
            if !index.is_empty() && last {
                file += "]\n";
            }
        }
        file
    }
}

fn with_comment(line: &str, origin: &Layer) -> String {
    format!("{line:<48} # {}\n", origin.to_string().escape_debug())
}

#[cfg(test)]
mod tests;
