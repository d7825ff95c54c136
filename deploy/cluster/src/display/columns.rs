//! The columns of the table that `fly` shows: a narrow set with abbreviations for 80 columns, and a full set for wide
//! terminals. Where a set does not fit, whole columns are left out, the least important first: a number that lacks digits would be
//! read as another number.

use super::status::Row;

/// A column of the table.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    /// Its heading.
    pub title: &'static str,
    /// Its least width; it is as wide as its widest cell.
    pub width: u16,
    /// Its place in the order of importance: of the columns of a set that do not fit, the one with the greatest is left out first.
    pub rank: u8,
    /// What it shows, in which unit, and which values are bad.
    pub about: &'static str,
    /// What a vehicle has there.
    pub cell: fn(&Row) -> String,
}

const PHASE: &str = "what the vehicle does: formation (at its altitude and in its place), under way (not there); a red row: silent (no message for 1 s), blind or no frames (no data from its simulator), killed, lost";
const STEP: &str = "step of the mission, counted from 0";
const ALTITUDE: &str = "altitude above the origin, m";
const CENTRE: &str = "distance from the formation's centre, along the ellipse (ρ), m";
const NEAREST: &str = "distance to the nearest other vehicle, m; below 2 m is a collision";
const FRAMES: &str = "simulator frames per second; bad if far below 50 (below the simulator's own rate)";
const AGE: &str = "age of the oldest state of a peer in contact, with delay, ms; above 500 is stale";
const STEP_TIME: &str = "99th percentile of the time from a frame to its control, µs; bad above 20000";

/// For terminals of 80 columns.
pub const NARROW: [Column; 11] = [
    Column {
        title: "id",
        width: 3,
        rank: 0,
        about: "number of the vehicle; in a fleet with its team, or of a team",
        cell: |row| row.name.clone(),
    },
    Column { title: "phase", width: 11, rank: 1, about: PHASE, cell: |row| row.shown_phase().to_owned() },
    Column { title: "step", width: 4, rank: 4, about: STEP, cell: |row| optional(row.step) },
    Column { title: "alt m", width: 5, rank: 2, about: ALTITUDE, cell: |row| number(row.altitude_m, 1) },
    Column { title: "ρ m", width: 5, rank: 7, about: CENTRE, cell: |row| number(row.from_centre_m, 1) },
    Column {
        title: "gap °",
        width: 11,
        rank: 5,
        about: "angle clockwise to the next vehicle, and by how much it is more than an even share, degrees; bad beyond ±10 once in formation",
        cell: |row| row.gap_deg.map_or_else(none, |(gap, excess)| format!("{gap:.1} {excess:+.1}")),
    },
    Column { title: "near m", width: 6, rank: 3, about: NEAREST, cell: |row| number(row.nearest_m, 1) },
    Column { title: "Hz", width: 4, rank: 8, about: FRAMES, cell: |row| number(row.frame_rate_hz, 1) },
    Column { title: "peer ms", width: 7, rank: 9, about: AGE, cell: |row| number(row.peer_age_ms, 0) },
    Column { title: "p99 µs", width: 6, rank: 12, about: STEP_TIME, cell: |row| number(row.step_p99_us, 0) },
    Column {
        title: "late/dr",
        width: 7,
        rank: 10,
        about: "steps that ended after the next frame was due, and messages that were dropped; both grow if this PC is too slow",
        cell: |row| row.late_dropped.map_or_else(none, |(late, dropped)| format!("{late}/{dropped}")),
    },
];

/// For terminals of at least [`WIDE_COLUMNS`] columns.
pub const WIDE: [Column; 13] = [
    Column {
        title: "vehicle",
        width: 7,
        rank: 0,
        about: "its number; in a fleet with its team, or the number of a team",
        cell: |row| row.name.clone(),
    },
    Column { title: "phase", width: 11, rank: 1, about: PHASE, cell: |row| row.shown_phase().to_owned() },
    Column { title: "step", width: 4, rank: 4, about: STEP, cell: |row| optional(row.step) },
    Column { title: "altitude m", width: 10, rank: 2, about: ALTITUDE, cell: |row| number(row.altitude_m, 1) },
    Column { title: "centre m", width: 8, rank: 7, about: CENTRE, cell: |row| number(row.from_centre_m, 1) },
    Column {
        title: "gap °",
        width: 6,
        rank: 5,
        about: "angle clockwise to the next vehicle, degrees",
        cell: |row| number(row.gap_deg.map(|(gap, _)| gap), 1),
    },
    Column {
        title: "off even °",
        width: 10,
        rank: 6,
        about: "by how much that gap is more than an even share, degrees; bad beyond ±10 once in formation",
        cell: |row| row.gap_deg.map_or_else(none, |(_, excess)| format!("{excess:+.1}")),
    },
    Column { title: "nearest m", width: 9, rank: 3, about: NEAREST, cell: |row| number(row.nearest_m, 1) },
    Column { title: "frames/s", width: 8, rank: 8, about: FRAMES, cell: |row| number(row.frame_rate_hz, 1) },
    Column { title: "peer age ms", width: 11, rank: 9, about: AGE, cell: |row| number(row.peer_age_ms, 0) },
    Column { title: "p99 step µs", width: 11, rank: 12, about: STEP_TIME, cell: |row| number(row.step_p99_us, 0) },
    Column {
        title: "late",
        width: 4,
        rank: 10,
        about: "steps that ended after the next frame was due; if it grows, this PC is too slow",
        cell: |row| optional(row.late_dropped.map(|(late, _)| late)),
    },
    Column {
        title: "dropped",
        width: 7,
        rank: 11,
        about: "messages that were not understood, not believed or too old; bad if it grows",
        cell: |row| optional(row.late_dropped.map(|(_, dropped)| dropped)),
    },
];

/// The columns of a terminal that has room for [`WIDE`].
pub const WIDE_COLUMNS: u16 = 120;

/// A column as a table shows it.
#[derive(Clone, Copy, Debug)]
pub struct Fitted {
    /// The column.
    pub column: Column,
    /// Its width: that of its heading or of its widest cell.
    pub width: u16,
}

/// The columns of a set that fit into `room` with a space between them and every cell of these rows whole.
pub fn fitting(set: &[Column], rows: &[Row], room: u16) -> Vec<Fitted> {
    let fit = |column: &Column| {
        let cells = rows.iter().map(|row| (column.cell)(row).chars().count());
        let widest = cells.chain([column.title.chars().count()]).max().unwrap_or(0);
        Fitted { column: *column, width: column.width.max(u16::try_from(widest).unwrap_or(u16::MAX)) }
    };
    let mut fitted: Vec<Fitted> = set.iter().map(fit).collect();
    while needed(&fitted) > usize::from(room) {
        let last = (0..fitted.len()).max_by_key(|at| fitted[*at].column.rank);
        last.map(|at| fitted.remove(at));
    }
    fitted
}

/// The width of these columns with a space between them.
pub fn needed(columns: &[Fitted]) -> usize {
    columns.iter().map(|fitted| usize::from(fitted.width)).sum::<usize>() + columns.len().saturating_sub(1)
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
    fn every_set_fits_its_terminal_and_every_heading_its_column() {
        for (columns, room) in [(&NARROW[..], 80), (&WIDE[..], WIDE_COLUMNS)] {
            let widths: u16 = columns.iter().map(|column| column.width).sum();
            assert!(widths + columns.len() as u16 - 1 <= room, "{widths}");
            assert!(columns.iter().all(|column| column.title.chars().count() <= usize::from(column.width)));
            let ranks: std::collections::BTreeSet<u8> = columns.iter().map(|column| column.rank).collect();
            assert_eq!(ranks.len(), columns.len(), "the order of importance is of all columns");
        }
    }
}
