//! What goes to the terminal: text of other hosts with its control characters made visible, and JSON.

use std::io::IsTerminal;

use comfy_table::Table;
use serde::Serialize;
use skein_common::printable::printable_lines;

/// A file's worth of JSON.
pub fn json(value: &impl Serialize) -> String {
    // Our reports are structs of numbers and texts, whose keys are texts.
    #[expect(clippy::expect_used, reason = "a report always has a JSON form")]
    let text = serde_json::to_string_pretty(value).expect("a report is JSON");
    text + "\n"
}

/// Lines of at most so many columns, broken between words. A word that is longer than a line has a line of its own.
pub fn wrapped(text: &str, columns: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= columns => *line += &format!(" {word}"),
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// The text, or as many of its first words as fit into so many columns, and `…`. A first word that does not fit is cut.
pub fn shortened(text: &str, columns: usize) -> String {
    if text.chars().count() <= columns {
        return text.to_owned();
    }
    let room: String = text.chars().take(columns).collect();
    let words = room.rfind(' ').map_or("", |end| room[..end].trim_end_matches([' ', ',', ';', ':']));
    match words.is_empty() {
        true => text.chars().take(columns.saturating_sub(1)).chain(['…']).take(columns).collect(),
        false => format!("{words}…"),
    }
}

/// What to do next: each command below what it is for. On a terminal a long command is broken as a shell takes it.
pub fn what_next(commands: &[(String, &str)]) -> String {
    let columns =
        if std::io::stdout().is_terminal() { Table::new().width().map_or(80, usize::from) } else { usize::MAX };
    let step = |(command, what): &(String, &str)| format!("next, {what}:\n  {}\n", shell_lines(command, columns));
    commands.iter().map(step).collect()
}

/// A command in lines of so many columns with an indent of two, as a shell takes it. One with quotes stays as it is.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_broken_and_shortened_between_words() {
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
