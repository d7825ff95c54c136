//! Text from the network, from another host or from another program, made fit for a terminal and for a log.
//!
//! Every character that a terminal obeys instead of showing it is replaced by its number as JSON writes it, `\u001b`: visible,
//! without effect, and still the same text where the whole is JSON.

/// Foreign text on one line of at most `most` characters; a longer one ends with `…`.
pub fn printable(text: &str, most: usize) -> String {
    let shown = with_visible_controls(text, |_| false);
    match shown.char_indices().nth(most) {
        Some(_) => shown.chars().take(most.saturating_sub(1)).chain(['…']).collect(),
        None => shown,
    }
}

/// A whole text on its way to a terminal: it keeps its lines and tabs.
pub fn printable_lines(text: &str) -> String {
    with_visible_controls(text, |c| matches!(c, '\n' | '\t'))
}

fn with_visible_controls(text: &str, is_kept: impl Fn(char) -> bool) -> String {
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        if acts_unseen(c) && !is_kept(c) {
            let mut units = [0; 2];
            shown.extend(c.encode_utf16(&mut units).iter().map(|unit| format!("\\u{unit:04x}")));
        } else {
            shown.push(c);
        }
    }
    shown
}

/// Whether a terminal obeys this character, or shows nothing of it: C0 and C1 controls, marks that change the direction of
/// writing, separators of lines, and what is invisible.
fn acts_unseen(c: char) -> bool {
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
    fn what_a_terminal_obeys_is_replaced_by_its_number() {
        let shown = |text| printable(text, 100);
        assert_eq!(shown("a\u{1b}[2J\u{1b}]0;title\u{7}b"), "a\\u001b[2J\\u001b]0;title\\u0007b");
        assert_eq!(shown("one\r\ntwo\tthree\u{0}"), "one\\u000d\\u000atwo\\u0009three\\u0000");
        assert_eq!(shown("\u{9b}31m \u{7f} \u{202e}gnp.exe"), "\\u009b31m \\u007f \\u202egnp.exe");
        assert_eq!(shown("a\u{200b}b\u{2066}c\u{feff}d\u{e0041}"), "a\\u200bb\\u2066c\\ufeffd\\udb40\\udc41");
        let plain = "0.1.0-1f2e3d4c5b6a: größe ρ 10 °, \"it's\" \\ e\u{301} 日本 🚁";
        assert_eq!(shown(plain), plain);
    }

    #[test]
    fn no_control_character_is_left_whatever_comes() {
        let all: String = (0..0x0011_0000).filter_map(char::from_u32).collect();
        for shown in [printable(&all, usize::MAX), printable_lines(&all).replace(['\n', '\t'], "")] {
            assert!(!shown.chars().any(acts_unseen));
        }
    }

    #[test]
    fn a_line_is_no_longer_than_it_may_be() {
        assert_eq!(printable("12345", 5), "12345");
        assert_eq!(printable("123456", 5), "1234…");
        assert_eq!(printable(&"\u{1b}".repeat(1000), 8), "\\u001b\\…");
        assert_eq!(printable("12", 0), "…");
    }

    #[test]
    fn a_text_of_json_says_the_same() {
        let said = "\u{1b}[2J\u{9b}\u{202e}\u{e0041}".to_owned();
        // As a writer does that escapes no more than it has to.
        let json = format!("{{\n\t\"said\": \"\\u001b[2J{}\"\n}}", &said[4..]);
        let expected = "{\n\t\"said\": \"\\u001b[2J\\u009b\\u202e\\udb40\\udc41\"\n}";
        assert_eq!(printable_lines(&json), expected);
    }
}
