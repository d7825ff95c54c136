//! The error of a scenario file, with its position.

use std::fmt;
use std::ops::Range;

/// Error of a scenario file or of a `--set` option. Its text is one line:
/// `hover.toml:9:1: unknown key ...; did you mean ...?`
///
/// The texts are boxed so that a `Result` stays small.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScenarioError {
    /// Name of the file as the caller gave it, or the `--set key=value` option.
    pub file: Box<str>,
    /// Line, counted from 1; `None` for a `--set` option.
    pub line: Option<usize>,
    /// Column in characters, counted from 1; `None` for a `--set` option.
    pub column: Option<usize>,
    /// Path of the key.
    pub key: Option<Box<str>>,
    /// The fault.
    pub message: Box<str>,
    /// Suggestion how to correct the error.
    pub help: Option<Box<str>>,
    /// The bytes of the file's text that the error is about.
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
