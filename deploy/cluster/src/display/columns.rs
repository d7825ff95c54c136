//! The columns of the table that `fly` shows: a narrow set with abbreviations for 80 columns, and a full set for wide
//! terminals. Where a set does not fit, whole columns are left out, the least important first: a number that lacks digits would be
//! read as another number.

use skein_common::message::{FACTS, Fact, FactColumn};

use super::status::Row;

/// A column of the table.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    /// Its heading.
    pub title: &'static str,
    /// The least width of its cells; it is as wide as its heading and its widest cell.
    pub width: u16,
    /// Its place in the order of importance: of the columns of a set that do not fit, the one with the greatest is left out first.
    pub rank: u8,
    /// The meaning of its cells, their unit, and which values are bad.
    pub about: &'static str,
    content: Content,
}

/// The content of a column.
#[derive(Clone, Copy, Debug)]
enum Content {
    Text(fn(&Row) -> String),
    Number(&'static Fact),
}

impl Column {
    /// The text of a row in this column.
    pub fn cell(&self, row: &Row) -> String {
        match self.content {
            Content::Text(text) => text(row),
            Content::Number(fact) => number(row.facts.get(fact.key).map(|value| fact.factor * value), fact.decimals),
        }
    }
}

/// The columns for terminals of 80 columns, or for those of at least [`WIDE_COLUMNS`] columns.
pub fn set(is_wide: bool) -> Vec<Column> {
    let of_fact = |fact: &'static Fact| {
        let FactColumn { titles, width, rank, about } = fact.column?;
        Some((titles, width, rank, about, Content::Number(fact)))
    };
    let own = |&(titles, width, rank, about, text): &OwnColumn| (titles, width, rank, about, Content::Text(text));
    let facts = FACTS.iter().filter_map(of_fact);
    let all = FLIGHT.iter().map(own).chain(facts).chain(COUNTS.iter().map(own));
    all.map(|([narrow, wide], width, rank, about, content)| Column {
        title: if is_wide { wide } else { narrow },
        width,
        rank,
        about,
        content,
    })
    .filter(|column| !column.title.is_empty())
    .collect()
}

/// A column that is more than one fact: its narrow and its wide heading (none in a set that lacks it), width, rank, meaning, and
/// the text of a row.
type OwnColumn = ([&'static str; 2], u16, u8, &'static str, fn(&Row) -> String);

/// The columns before those of the facts.
const FLIGHT: &[OwnColumn] = &[
    (["id", ""], 3, 0, "number of the vehicle; in a fleet with its team, or of a team", |row| row.name.clone()),
    (["", "vehicle"], 7, 0, "its number; in a fleet with its team, or the number of a team", |row| row.name.clone()),
    (
        ["phase", "phase"],
        11,
        1,
        "what the vehicle does: formation (at its altitude and in its place), under way (not there); a red row: silent (no message for 1 s), blind or no frames (no data from its simulator), killed, lost",
        |row| row.shown_phase().to_owned(),
    ),
    (["step", "step"], 4, 4, "step of the mission, counted from 0", |row| optional(row.step)),
    (["alt m", "altitude m"], 5, 2, "altitude above the origin, m", |row| number(row.altitude_m, 1)),
    (["ρ m", "centre m"], 5, 7, "distance from the formation's centre, along the ellipse (ρ), m", |row| {
        number(row.from_centre_m, 1)
    }),
    (
        ["gap °", ""],
        11,
        5,
        "angle clockwise to the next vehicle, and by how much it is more than an even share, degrees; bad beyond ±10 once in formation",
        |row| row.gap_deg.map_or_else(none, |(gap, excess)| format!("{gap:.1} {excess:+.1}")),
    ),
    (["", "gap °"], 6, 5, "angle clockwise to the next vehicle, degrees", |row| {
        number(row.gap_deg.map(|(gap, _)| gap), 1)
    }),
    (
        ["", "off even °"],
        10,
        6,
        "by how much that gap is more than an even share, degrees; bad beyond ±10 once in formation",
        |row| row.gap_deg.map_or_else(none, |(_, excess)| format!("{excess:+.1}")),
    ),
    (["near m", "nearest m"], 6, 3, "distance to the nearest other vehicle, m; below 2 m is a collision", |row| {
        number(row.nearest_m, 1)
    }),
];

/// The columns after those of the facts.
const COUNTS: &[OwnColumn] = &[
    (
        ["late/dr", ""],
        7,
        10,
        "steps that ended after the next frame was due, and messages that were dropped; both grow if this PC is too slow",
        |row| row.late_dropped.map_or_else(none, |(late, dropped)| format!("{late}/{dropped}")),
    ),
    (["", "late"], 4, 10, "steps that ended after the next frame was due; if it grows, this PC is too slow", |row| {
        optional(row.late_dropped.map(|(late, _)| late))
    }),
    (["", "dropped"], 7, 11, "messages that were not understood, not believed or too old; bad if it grows", |row| {
        optional(row.late_dropped.map(|(_, dropped)| dropped))
    }),
];

/// The columns of a terminal that has room for the wide set.
pub const WIDE_COLUMNS: u16 = 120;

/// The columns of a set that fit into `room` with a space between them and every cell of these rows whole, as wide as they have to
/// be for that.
pub fn fitting(set: &[Column], rows: &[Row], room: u16) -> Vec<Column> {
    let fit = |column: &Column| {
        let cells = rows.iter().map(|row| column.cell(row).chars().count());
        let widest = cells.chain([column.title.chars().count()]).max().unwrap_or(0);
        Column { width: column.width.max(u16::try_from(widest).unwrap_or(u16::MAX)), ..*column }
    };
    let mut fitted: Vec<Column> = set.iter().map(fit).collect();
    while needed(&fitted) > usize::from(room) {
        let last = (0..fitted.len()).max_by_key(|at| fitted[*at].rank);
        last.map(|at| fitted.remove(at));
    }
    fitted
}

/// The width of these columns with a space between them.
pub fn needed(columns: &[Column]) -> usize {
    columns.iter().map(|column| usize::from(column.width)).sum::<usize>() + columns.len().saturating_sub(1)
}

fn none() -> String {
    "-".to_owned()
}

fn optional(value: Option<impl ToString>) -> String {
    value.map_or_else(none, |value| value.to_string())
}

fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(none, |value| format!("{value:.decimals$}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_set_fits_its_terminal() {
        for (columns, room) in [(set(false), 80), (set(true), WIDE_COLUMNS)] {
            let fitted = fitting(&columns, &[], room);
            assert_eq!(fitted.len(), columns.len(), "{}", needed(&fitted));
            let ranks: std::collections::BTreeSet<u8> = columns.iter().map(|column| column.rank).collect();
            assert_eq!(ranks.len(), columns.len(), "the order of importance is of all columns");
        }
    }
}
