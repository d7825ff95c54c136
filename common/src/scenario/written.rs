//! Files other than a scenario, with keys of their own, read and checked in the same way.

use std::ops::Range;

use serde::de::DeserializeOwned;
use toml::Value as Toml;

use super::Source;
use super::error::ScenarioError;
use super::key::{Key, Literal};
use super::keys;
use super::kind::FileKind;
use super::tree::{Node, Part, Place, Texts, list_of_keys, shown};

/// The checked content of a file: every key is known, of the right kind and in its range.
pub struct Written<'a> {
    texts: Texts<'a>,
    root: Node,
}

impl<'a> Written<'a> {
    /// Reads a file of this kind that has these keys. `paper`, `flock` and `implied` of a [`Key`] have no effect here.
    ///
    /// # Errors
    /// The first error found: not TOML, an unknown key, a value of the wrong kind or out of its range, or a required
    /// key that is missing.
    pub fn read(source: &'a Source<'a>, kind: FileKind, keys: &'static [Key]) -> Result<Self, ScenarioError> {
        let texts = Texts { kind, keys, source, sets: &[], part: Part::Whole };
        let mut root = texts.parse()?;
        texts.check_kind(&root)?;
        texts.check_table(&mut root, "")?;
        let written = Self { texts, root };
        let lacks = |key: &&Key| key.default == Literal::Required && written.root.at(key.path).is_none();
        match keys.iter().find(lacks) {
            Some(key) => {
                let message = format!("`{}` is missing: {}", key.path, key.about);
                Err(written.fault(key.path, message, Some("add it to the file".to_owned())))
            }
            None => Ok(written),
        }
    }

    /// Reads a file of this kind whose keys are the fields of a type.
    ///
    /// # Errors
    /// The first error found: not TOML, or a value that the type refuses, with its position and the most similar field.
    pub fn typed<T: DeserializeOwned>(source: &'a Source<'a>, kind: FileKind) -> Result<(T, Self), ScenarioError> {
        let texts = Texts { kind, keys: &[], source, sets: &[], part: Part::Whole };
        let root = texts.parse()?;
        texts.check_kind(&root)?;
        let written = Self { texts, root };
        match toml::from_str(source.text) {
            Ok(value) => Ok((value, written)),
            Err(error) => Err(written.refused(&error)),
        }
    }

    /// The error for a value that the type refused, with the whole path of the key and a suggestion.
    fn refused<'e>(&self, error: &'e toml::de::Error) -> ScenarioError {
        let span = error.span().unwrap_or(0..0);
        let message = error.message();
        let (path, node) = place_of(&self.root, "", &span).unwrap_or_default();
        let place = Place::File(span);
        let quoted = |text: &'e str| text.split('`').skip(1).step_by(2);
        if message.starts_with("unknown field ") {
            let known = message.rsplit_once(", expected ").map_or("", |(_, known)| known);
            let (table, name) = path.rsplit_once('.').unwrap_or(("", &path));
            let help = match keys::nearest_of(quoted(known), name) {
                Some(near) => Some(format!("did you mean `{}`?", keys::join(table, near))),
                None => (!known.is_empty()).then(|| list_of_keys(quoted(known))),
            };
            let message = format!("unknown key `{}`", shown(&path));
            return ScenarioError { help: help.map(Into::into), ..self.texts.fault(&place, &path, message) };
        }
        if message.starts_with("missing field ")
            && let Some(field) = quoted(message).next()
        {
            let path = keys::join(&path, field);
            let help = Some(format!("add it to {}", if path == field { "the file" } else { "this table" }).into());
            return ScenarioError { help, ..self.texts.fault(&place, &path, format!("`{path}` is missing")) };
        }
        if let (Some((_, expected)), Some(node)) = (message.rsplit_once(", expected "), node)
            && message.starts_with("invalid type: ")
        {
            let expected = match expected {
                "f32" | "f64" => "a number",
                "a string" => "a text",
                "a sequence" => "a list",
                "a map" => "a table",
                other if other.starts_with("struct ") => "a table",
                other => other,
            };
            return self.texts.wrong(node, &path, expected);
        }
        // A rule of the type itself: the message begins with the key, or is about the value.
        let (key, rest) = message.split_once(' ').unwrap_or((message, ""));
        match node.and_then(Node::table).and_then(|table| table.get(key)) {
            Some((_, value)) => {
                let path = keys::join(&path, key);
                self.texts.fault(&value.place, &path, format!("`{path}` {rest}"))
            }
            None if path.is_empty() => self.texts.fault(&place, "", message.replace('\n', " ")),
            None => self.texts.fault(&place, &path, format!("`{}`: {}", shown(&path), message.replace('\n', " "))),
        }
    }

    /// Whether the file has no keys.
    pub fn is_empty(&self) -> bool {
        self.names("").is_empty()
    }

    /// The value at this path.
    pub fn get(&self, path: &str) -> Option<Toml> {
        Some(self.root.at(path)?.plain())
    }

    /// The text at this path.
    pub fn text(&self, path: &str) -> Option<String> {
        Some(self.get(path)?.as_str()?.to_owned())
    }

    /// Names of the keys of this table, sorted; `""` is the whole file.
    pub fn names(&self, table: &str) -> Vec<&str> {
        let node = if table.is_empty() { Some(&self.root) } else { self.root.at(table) };
        node.and_then(Node::table).into_iter().flat_map(|table| table.keys().map(String::as_str)).collect()
    }

    /// An error at the value of this path, or else at the table in which it would be.
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

/// The path and the node of the value at these bytes of a file.
fn place_of<'n>(node: &'n Node, path: &str, span: &Range<usize>) -> Option<(String, Option<&'n Node>)> {
    let is_at = |place: &Place| matches!(place, Place::File(at) if at == span);
    node.table()?.iter().find_map(|(name, (name_place, value))| {
        let path = keys::join(path, name);
        if is_at(name_place) || is_at(&value.place) {
            return Some((path, Some(value)));
        }
        match value.list().iter().find(|item| is_at(&item.place)) {
            Some(item) => Some((path, Some(item))),
            None => place_of(value, &path, span),
        }
    })
}
