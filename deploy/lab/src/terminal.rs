//! Writes to the terminal: text with its control characters made visible, and JSON.

use serde::Serialize;
use skein_common::printable::printable_lines;

/// Formats a value as indented JSON with a newline at the end.
pub fn json(value: &impl Serialize) -> String {
    // Reports are structs of numbers and texts, and their keys are texts: serialising them cannot fail.
    #[expect(clippy::expect_used, reason = "a report always has a JSON form")]
    let text = serde_json::to_string_pretty(value).expect("a report serialises to JSON");
    text + "\n"
}

/// Writes text to stdout and makes its control characters visible.
///
/// Every text from another host or process passes through this function or [`complain`], because a terminal would obey
/// its escape sequences. A closed pipe (`| head`) is not an error.
pub fn say(text: &str) {
    draw(&printable_lines(text));
}

/// Writes a line to stderr and makes its control characters visible.
pub fn complain(line: &str) {
    use std::io::Write;
    let _ = writeln!(std::io::stderr(), "{}", printable_lines(line));
}

/// Writes text with our own escape sequences to stdout; text from elsewhere in it must already be
/// [`printable`](skein_common::printable).
pub fn draw(text: &str) {
    use std::io::Write;
    let _ = std::io::stdout().write_all(text.as_bytes());
}
