//! The operator's and researcher's command: flies a swarm on this PC, studies it in virtual time, looks at it. It is never
//! in the loop: kill it and the swarm flies on.

pub mod capacity;
pub mod check;
pub mod cli;
pub mod clock;
pub mod cluster;
pub mod compare;
pub mod endpoints;
pub mod error;
pub mod explain;
pub mod fly;
pub mod landing;
pub mod law;
pub mod metrics;
pub mod observe;
pub mod order;
pub mod os;
pub mod out;
pub mod prepare;
pub mod reach;
pub mod record;
pub mod recording;
pub mod report;
pub mod scenario;
pub mod simulators;
pub mod study;

use serde::Serialize;
use skein_common::printable::printable_lines;

/// A file's worth of JSON.
pub fn json(value: &impl Serialize) -> String {
    // Our reports are structs of numbers and texts, whose keys are texts.
    #[expect(clippy::expect_used, reason = "a report always has a JSON form")]
    let text = serde_json::to_string_pretty(value).expect("a report is JSON");
    text + "\n"
}

/// Writes to stdout, with what a terminal would obey made visible: every text of another host or process that is shown passes
/// here or through [`complain`]. A reader that is gone (`| head`) ends nothing.
pub fn say(text: &str) {
    draw(&printable_lines(text));
}

/// Writes a line to stderr, as [`say`] does.
pub fn complain(line: &str) {
    use std::io::Write;
    let _ = writeln!(std::io::stderr(), "{}", printable_lines(line));
}

/// Writes to stdout with escape sequences of our own; foreign text in it has to be [`printable`](skein_common::printable)
/// already.
pub(crate) fn draw(text: &str) {
    use std::io::Write;
    let _ = std::io::stdout().write_all(text.as_bytes());
}
