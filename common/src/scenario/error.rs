//! What is wrong with a scenario, and where.

use std::fmt;
use std::ops::Range;

/// One fault of a scenario file or of a `--set`. Shown as one line: `hover.toml:9:1: unknown key ...; did you mean ...?`
///
/// The texts are boxed so that a `Result` stays small.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScenarioError {
    /// The file as the caller named it, or `--set key=value` as it was given.
    pub file: Box<str>,
    /// Counted from 1; none for a `--set`.
    pub line: Option<usize>,
    /// In characters, counted from 1.
    pub column: Option<usize>,
    /// The key concerned, dotted.
    pub key: Option<Box<str>>,
    /// What is wrong.
    pub message: Box<str>,
    /// What to do about it.
    pub help: Option<Box<str>>,
    /// Bytes of the file's text that are at fault.
    pub span: Option<Range<usize>>,
}

impl fmt::Display for ScenarioError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file)?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        if let Some(column) = self.column {
            write!(f, ":{column}")?;
        }
        write!(f, ": {}", self.message)?;
        match &self.help {
            Some(help) => write!(f, "; {help}"),
            None => Ok(()),
        }
    }
}

impl std::error::Error for ScenarioError {}
