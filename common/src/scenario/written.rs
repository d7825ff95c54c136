//! Other files than a scenario's, with keys of their own: read, checked and refused in the same way.

use toml::Value as Toml;

use super::Source;
use super::error::ScenarioError;
use super::keys::{Key, Literal};
use super::tree::{Node, Place, Texts};

/// What stands in a file, every key of it known, of its kind and in its range.
pub struct Written<'a> {
    texts: Texts<'a>,
    root: Node,
}

impl<'a> Written<'a> {
    /// Reads a file whose keys are these. `paper` and `flock` of a [`Key`] mean nothing here.
    ///
    /// # Errors
    /// The first fault found: not TOML, an unknown key, a value of the wrong kind or out of its range, or one that the file
    /// has to say and does not.
    pub fn read(source: &'a Source<'a>, keys: &'static [Key]) -> Result<Self, ScenarioError> {
        let texts = Texts { keys, source, sets: &[] };
        let mut root = texts.parse()?;
        texts.check_table(&mut root, "")?;
        let written = Self { texts, root };
        let lacks = |key: &&Key| key.default == Literal::Required && written.root.at(key.path).is_none();
        match keys.iter().find(lacks) {
            Some(key) => Err(written.fault(key.path, format!("`{}` is missing: {}", key.path, key.about), None)),
            None => Ok(written),
        }
    }

    /// Whether nothing is written at all.
    pub fn is_empty(&self) -> bool {
        self.names("").is_empty()
    }

    /// What stands at this path.
    pub fn get(&self, path: &str) -> Option<Toml> {
        Some(self.root.at(path)?.plain())
    }

    /// The text at this path.
    pub fn text(&self, path: &str) -> Option<String> {
        Some(self.get(path)?.as_str()?.to_owned())
    }

    /// Names of what stands in this table, sorted; `""` is the whole file.
    pub fn names(&self, table: &str) -> Vec<&str> {
        let node = if table.is_empty() { Some(&self.root) } else { self.root.at(table) };
        node.and_then(Node::table).into_iter().flat_map(|table| table.keys().map(String::as_str)).collect()
    }

    /// A fault of what stands at this path, or else of the table that it would stand in.
    pub fn fault(&self, path: &str, message: impl Into<String>, help: Option<String>) -> ScenarioError {
        let mut around = path;
        let place = loop {
            match (self.root.at(around), around.rsplit_once('.')) {
                (Some(node), _) => break node.place.clone(),
                (None, Some((table, _))) => around = table,
                (None, None) => break Place::File(0..0),
            }
        };
        ScenarioError { help: help.map(Into::into), ..self.texts.fault(&place, path, message) }
    }
}
