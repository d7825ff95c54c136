//! Text from the network, another host or another program, made safe to show on a terminal and to write to a log.
//!
//! Every character that controls a terminal is replaced by its number as JSON writes it, `\u001b`. The number is
//! visible and has no effect, and a JSON text keeps its meaning.

/// Foreign text as one line of at most `most` characters; a longer text is cut and ends with `…`.
pub fn printable(text: &str, most: usize) -> String {
    let shown = with_visible_controls(text, |_| false);
    match shown.char_indices().nth(most) {
        Some(_) => shown.chars().take(most.saturating_sub(1)).chain(['…']).collect(),
        None => shown,
    }
}

/// Foreign text of several lines: line ends and tabs are kept.
pub fn printable_lines(text: &str) -> String {
    with_visible_controls(text, |c| matches!(c, '\n' | '\t'))
}

fn with_visible_controls(text: &str, is_kept: impl Fn(char) -> bool) -> String {
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        if is_control_or_invisible(c) && !is_kept(c) {
            let mut units = [0; 2];
            shown.extend(c.encode_utf16(&mut units).iter().map(|unit| format!("\\u{unit:04x}")));
        } else {
            shown.push(c);
        }
    }
    shown
}

/// Whether this character controls a terminal or is invisible: C0 and C1 controls, marks of the writing direction, line
/// separators, and characters without width.
fn is_control_or_invisible(c: char) -> bool {
    c.is_control()
        || matches!(
            c,
            '\u{ad}'
                | '\u{61c}'
                | '\u{180e}'
                | '\u{200b}'..='\u{200f}'
                | '\u{2028}'..='\u{202e}'
                | '\u{2060}'..='\u{206f}'
                | '\u{feff}'
                | '\u{fff9}'..='\u{fffb}'
                | '\u{e0000}'..='\u{e007f}'
        )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn characters_that_control_a_terminal_are_replaced_by_their_numbers() {
        let shown = |text| printable(text, 100);
        assert_eq!(shown("a\u{1b}[2J\u{1b}]0;title\u{7}b"), "a\\u001b[2J\\u001b]0;title\\u0007b");
        assert_eq!(shown("one\r\ntwo\tthree\u{0}"), "one\\u000d\\u000atwo\\u0009three\\u0000");
        assert_eq!(shown("\u{9b}31m \u{7f} \u{202e}gnp.exe"), "\\u009b31m \\u007f \\u202egnp.exe");
        assert_eq!(shown("a\u{200b}b\u{2066}c\u{feff}d\u{e0041}"), "a\\u200bb\\u2066c\\ufeffd\\udb40\\udc41");
        let plain = "0.1.0-1f2e3d4c5b6a: größe ρ 10 °, \"it's\" \\ e\u{301} 日本 🚁";
        assert_eq!(shown(plain), plain);
    }

    #[test]
    fn no_control_character_is_left_of_any_text() {
        let all: String = (0..0x0011_0000).filter_map(char::from_u32).collect();
        for shown in [printable(&all, usize::MAX), printable_lines(&all).replace(['\n', '\t'], "")] {
            assert!(!shown.chars().any(is_control_or_invisible));
        }
    }

    #[test]
    fn a_long_line_is_cut() {
        assert_eq!(printable("12345", 5), "12345");
        assert_eq!(printable("123456", 5), "1234…");
        assert_eq!(printable(&"\u{1b}".repeat(1000), 8), "\\u001b\\…");
        assert_eq!(printable("12", 0), "…");
    }

    #[test]
    fn a_json_text_keeps_its_meaning() {
        let value = "\u{1b}[2J\u{9b}\u{202e}\u{e0041}".to_owned();
        // A writer that escapes only the characters that JSON requires.
        let json = format!("{{\n\t\"text\": \"\\u001b[2J{}\"\n}}", &value[4..]);
        let expected = "{\n\t\"text\": \"\\u001b[2J\\u009b\\u202e\\udb40\\udc41\"\n}";
        assert_eq!(printable_lines(&json), expected);
    }
}
