//! Writes to the terminal: text with its control characters made visible, and JSON.

use std::ffi::OsStr;
use std::io::{self, ErrorKind, IsTerminal, Write};
use std::sync::OnceLock;

use comfy_table::Table;
use serde::Serialize;
use skein_common::printable::printable_lines;

/// Whether this stream is a terminal that obeys escape sequences. Programs that are not quite a terminal, such as a shell in an
/// editor, name themselves by `TERM=dumb`; without a name a terminal of Unix is not known to obey.
pub fn obeys_escapes(stream: &impl IsTerminal) -> bool {
    stream.is_terminal() && is_able(std::env::var_os("TERM").as_deref(), cfg!(unix))
}

/// Whether this stream is a terminal that shows colours, and the user wants them: `NO_COLOR` refuses them on every terminal.
pub fn shows_colours(stream: &impl IsTerminal) -> bool {
    obeys_escapes(stream) && wants_colours()
}

/// Whether the user wants colours, where there can be any: not with a `NO_COLOR` that is not empty.
pub fn wants_colours() -> bool {
    std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

/// Whether a terminal of this name obeys escape sequences; on Windows terminals have no name.
fn is_able(name: Option<&OsStr>, needs_name: bool) -> bool {
    name.map_or(!needs_name, |name| !name.is_empty() && name != "dumb" && name != "unknown")
}

/// Formats a value as indented JSON with a newline at the end.
pub fn json(value: &impl Serialize) -> String {
    // Reports are structs of numbers and texts, and their keys are texts: serialising them cannot fail.
    #[expect(clippy::expect_used, reason = "a report always has a JSON form")]
    let text = serde_json::to_string_pretty(value).expect("a report serialises to JSON");
    text + "\n"
}

/// Wraps a text at spaces into lines of at most this many columns. A piece longer than a line gets its own line.
pub fn wrapped(text: &str, columns: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for piece in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + piece.chars().count() <= columns => *line += &format!(" {piece}"),
            _ => lines.push(piece.to_owned()),
        }
    }
    lines
}

/// Shortens a text to this many columns at a space, and adds `…`. A text whose first space is too far is cut.
pub fn shortened(text: &str, columns: usize) -> String {
    if text.chars().count() <= columns {
        return text.to_owned();
    }
    let room: String = text.chars().take(columns).collect();
    let whole = room.rfind(' ').map_or("", |end| room[..end].trim_end_matches([' ', ',', ';', ':']));
    match whole.is_empty() {
        true => text.chars().take(columns.saturating_sub(1)).chain(['…']).take(columns).collect(),
        false => format!("{whole}…"),
    }
}

/// The commands to run next, each below its purpose. On a terminal, a long command is broken into lines for a shell.
pub fn what_next(commands: &[(String, &str)]) -> String {
    let columns = if io::stdout().is_terminal() { Table::new().width().map_or(80, usize::from) } else { usize::MAX };
    let step = |(command, what): &(String, &str)| format!("next, {what}:\n  {}\n", shell_lines(command, columns));
    commands.iter().map(step).collect()
}

/// Breaks a command into lines of this many columns for a shell, with an indent of two. A command with quotes stays on one line.
fn shell_lines(command: &str, columns: usize) -> String {
    match command.contains('\'') {
        true => command.to_owned(),
        false => {
            // An option and its value stay together.
            let joined = command.replace("--set ", "--set\u{1}");
            wrapped(&joined, columns.saturating_sub(6)).join(" \\\n    ").replace('\u{1}', " ")
        }
    }
}

/// The reason why a text did not reach stdout, for the first that did not.
static LOST: OnceLock<String> = OnceLock::new();

/// Keeps the first error of stdout for [`lost`]. A closed pipe is left out: its reader has what it wanted.
pub(crate) fn note(written: io::Result<()>) {
    if let Err(error) = written
        && error.kind() != ErrorKind::BrokenPipe
    {
        // An earlier error is the one to report.
        let _ = LOST.set(of_writing(&error));
    }
}

/// Hands over what waits for stdout. Returns why something that was printed did not reach it, as on a full disk, if it did not.
pub fn lost() -> Option<&'static str> {
    note(io::stdout().flush());
    LOST.get().map(String::as_str)
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
    let _ = writeln!(io::stderr(), "{}", printable_lines(line));
}

/// Writes text with our own escape sequences to stdout; text from elsewhere in it must already be
/// [`printable`](skein_common::printable).
pub fn draw(text: &str) {
    note(io::stdout().write_all(text.as_bytes()));
}

/// The text of an error of writing, with the remedy for a limit on file sizes, which any command that writes can meet.
pub fn of_writing(error: &io::Error) -> String {
    match error.kind() {
        ErrorKind::FileTooLarge => {
            format!("{error}; `ulimit -f unlimited` in this shell raises the limit on the sizes of files")
        }
        _ => error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_on_file_sizes_has_its_remedy() {
        let text = of_writing(&ErrorKind::FileTooLarge.into());
        assert_eq!(text, "file too large; `ulimit -f unlimited` in this shell raises the limit on the sizes of files");
        let other = io::Error::other("a text with (os error 27)");
        assert_eq!(of_writing(&other), "a text with (os error 27)");
    }

    #[test]
    fn a_terminal_obeys_escape_sequences_unless_its_name_tells_that_it_does_not() {
        let is_able = |name: Option<&str>, needs_name| is_able(name.map(OsStr::new), needs_name);
        assert!(is_able(Some("xterm-256color"), true) && is_able(Some("linux"), true) && is_able(None, false));
        assert!(!is_able(Some("dumb"), true) && !is_able(Some("dumb"), false));
        assert!(!is_able(Some(""), true) && !is_able(Some("unknown"), true) && !is_able(None, true));
    }

    #[test]
    fn lines_are_wrapped_and_shortened_at_spaces() {
        assert_eq!(wrapped("one two  three", 8), ["one two", "three"]);
        assert_eq!(wrapped("incomprehensible it is", 5), ["incomprehensible", "it is"]);
        assert_eq!(shortened("one, two three", 14), "one, two three");
        assert_eq!(shortened("one, two three", 13), "one, two…");
        assert_eq!(shortened("one, two three", 7), "one…");
        assert_eq!(shortened("incomprehensible", 5), "inco…");
        assert_eq!(shortened("no", 0), "");
        assert_eq!(shell_lines("skein fly --set a=1", 16), "skein fly \\\n    --set a=1");
        assert_eq!(shell_lines("skein fly 'a b.toml'", 10), "skein fly 'a b.toml'");
    }
}
