//! The one file that describes a swarm, for every target.
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
//! The way of a file: text, `tree` (every word with its place; `--set` on top), `check` and `shape` (every key against
//! [`KEYS`], keys of one table), `layers` (defaults and preset below), `across` (what keys mean together),
//! [`Scenario`].

mod across;
mod check;
mod error;
mod keys;
mod kind;
mod law;
mod layers;
mod model;
mod plan;
mod shape;
mod tree;
mod written;

use std::fmt;

pub use error::ScenarioError;
pub use keys::{Implied, KEYS, Key, Kind, Literal, Range, is_whole, matching, meant, nearest_of};
pub use kind::FileKind;
pub use law::{LawName, OwnLaw, add_laws};
pub use model::*;
pub use written::Written;

use layers::Layers;
use tree::Texts;

/// A file as it was read.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    /// For messages.
    pub name: &'a str,
    /// All of it.
    pub text: &'a str,
}

impl Source<'_> {
    /// Line and column of a byte, both from 1, the column in characters; a byte order mark has no width.
    pub fn position(&self, byte: usize) -> (usize, usize) {
        let before = self.text.get(..byte).unwrap_or(self.text);
        let line = before.matches('\n').count() + 1;
        let start = before.rfind('\n').map_or(0, |end| end + 1);
        (line, before[start..].chars().filter(|&c| c != '\u{feff}').count() + 1)
    }
}

/// Reads a scenario: built-in default < `preset` < file < `sets`, each `key=value` as `--set` takes it, the last one
/// winning. A value in `sets` is TOML, or else a text without quotes: `vehicle.3.aircraft=r22`. Lists count from 0:
/// `mission.steps[1].formation.radius_m=50`.
///
/// # Errors
/// The first fault found: not TOML, an unknown key, a value of the wrong kind or out of its range, or values that do
/// not go together.
pub fn load(source: &Source<'_>, sets: &[String]) -> Result<Loaded, ScenarioError> {
    let texts = Texts { kind: FileKind::Scenario, keys: KEYS, source, sets };
    let mut written = texts.parse()?;
    texts.check_kind(&written)?;
    texts.check_table(&mut written, "")?;
    for index in 0..sets.len() {
        texts.set(&mut written, index)?;
        texts.check_table(&mut written, "")?;
    }
    shape::check(&texts, &written)?;
    let layers = Layers::new(&texts, &written)?;
    let scenario = layers.scenario()?;
    across::check(&texts, &written, &scenario)?;
    Ok(Loaded { scenario, notes: layers.notes(), lines: layers.lines() })
}

/// A scenario that may fly, and how it came about.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// What flies.
    pub scenario: Scenario,
    /// What the reader of the file should know, a line each: keys of the file that override the preset.
    pub notes: Vec<String>,
    lines: Vec<Explained>,
}

/// One value of the complete file.
#[derive(Clone, Debug, PartialEq)]
pub struct Explained {
    /// Dotted, as `--set` takes it.
    pub key: String,
    /// As TOML; `None` for what is absent and has no word for it.
    pub value: Option<String>,
    /// Who said so.
    pub origin: Layer,
    /// What the key means, and why its default is what it is.
    pub about: &'static str,
}

/// Who gave a key its value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Layer {
    /// Nobody.
    Default,
    /// The preset.
    Preset,
    /// Another key.
    Implied(&'static str),
    /// The file.
    File {
        /// As the caller named it.
        name: String,
        /// Counted from 1.
        line: usize,
    },
    /// A `--set`.
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
    /// Every key with its value and origin, in the order of the complete file.
    pub fn explain(&self) -> &[Explained] {
        &self.lines
    }

    /// The complete file, with the origin of each value as a comment. Read back, alone, it gives the same [`Scenario`],
    /// whatever the defaults of the reader are.
    pub fn to_toml(&self) -> String {
        let mut file = String::new();
        let mut open_table = "";
        let mut lines = self.lines.iter().filter_map(|line| Some((line, line.value.as_deref()?))).peekable();
        while let Some((line, value)) = lines.next() {
            let (path, place) = line.key.split_at(line.key.find('[').unwrap_or(line.key.len()));
            let (table, name) = path.rsplit_once('.').unwrap_or(("", path));
            if table != open_table {
                file += &format!("\n[{table}]\n");
                open_table = table;
            }
            let last = lines.peek().is_none_or(|(next, _)| !next.key.starts_with(&format!("{path}[")));
            file += &match place {
                "" => with_comment(&format!("{name} = {value}"), &line.origin),
                "[0]" => format!("{name} = [\n") + &with_comment(&format!("  {value},"), &line.origin),
                _ => with_comment(&format!("  {value},"), &line.origin),
            };
            if !place.is_empty() && last {
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
