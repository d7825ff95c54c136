//! The findings of a check, line by line, each fault with its remedy; and tables of such lines.

use comfy_table::{CellAlignment, ContentArrangement, Table, presets};
use serde::Serialize;
use skein_lab::error::Error;

/// Result of one check.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Line {
    /// The node or host.
    pub place: String,
    /// The thing that was checked: `clock`, `keys`.
    pub what: &'static str,
    /// The verdict.
    pub state: State,
    /// The finding.
    pub found: String,
    /// The remedy, if it is a fault or a warning.
    pub remedy: Option<String>,
}

/// Verdict of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Nothing is wrong.
    Good,
    /// It does not prevent a flight.
    Warning,
    /// It prevents a flight.
    Fault,
    /// It could not be checked.
    Unknown,
}

impl State {
    /// The state as the tables show it.
    pub fn label(self) -> &'static str {
        match self {
            Self::Good => "ok",
            Self::Warning => "warning",
            Self::Fault => "FAULT",
            Self::Unknown => "?",
        }
    }
}

impl Line {
    /// A check of this place without a fault.
    pub fn new(place: impl Into<String>, what: &'static str, found: impl Into<String>) -> Self {
        Self { place: place.into(), what, state: State::Good, found: found.into(), remedy: None }
    }

    /// Makes it a fault, with its remedy.
    pub fn fault(self, remedy: impl Into<String>) -> Self {
        Self { state: State::Fault, remedy: Some(remedy.into()), ..self }
    }

    /// Makes it a warning, with its remedy.
    pub fn warning(self, remedy: impl Into<String>) -> Self {
        Self { state: State::Warning, ..self.fault(remedy) }
    }

    /// Makes it a check that could not be made.
    pub fn unknown(self) -> Self {
        Self { state: State::Unknown, ..self }
    }

    /// The line as a sentence, without its place.
    pub fn sentence(&self) -> String {
        let Self { what, state, found, remedy, .. } = self;
        let remedy = remedy.as_ref().map_or_else(String::new, |remedy| format!("; {remedy}"));
        format!("{what} {}: {found}{remedy}", state.label())
    }
}

/// Counts the faults.
///
/// # Errors
/// If there is one.
pub fn verdict(lines: &[Line]) -> Result<(), Error> {
    match lines.iter().filter(|line| line.state == State::Fault).count() {
        0 => Ok(()),
        1 => Err(Error::Failed("1 fault prevents a flight".to_owned())),
        faults => Err(Error::Failed(format!("{faults} faults prevent a flight"))),
    }
}

/// The lines as a table, with or without their places.
pub fn as_table(lines: &[Line], has_places: bool) -> String {
    let first = usize::from(!has_places);
    let row = |Line { place, what, state, found, remedy }: &Line| {
        let cells = [place, *what, state.label(), found, remedy.as_deref().unwrap_or_default()];
        cells[first..].iter().map(|cell| (*cell).to_owned()).collect()
    };
    table(&["where", "what", "", "found", "remedy"][first..], lines.iter().map(row))
}

/// Formats a table, fitted to the terminal's width. Columns whose header ends in a unit are right-aligned numbers.
pub fn table(header: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_header(header.iter().copied());
    table.set_content_arrangement(ContentArrangement::Dynamic);
    table.add_rows(rows);
    let is_number = |name: &str| name == "node" || [" s", " MB"].iter().any(|unit| name.ends_with(unit));
    let columns = table.column_iter_mut().zip(header).filter(|(_, name)| is_number(name));
    columns.for_each(|(column, _)| column.set_cell_alignment(CellAlignment::Right));
    let text = table.to_string();
    text.lines().map(|line| line.trim_end().to_owned() + "\n").collect()
}
