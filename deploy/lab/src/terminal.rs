//! What goes to the terminal: text of other hosts with its control characters made visible, and JSON.

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
pub fn draw(text: &str) {
    use std::io::Write;
    let _ = std::io::stdout().write_all(text.as_bytes());
}
