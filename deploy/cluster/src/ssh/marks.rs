//! Marks around the output of a remote command. The shell of an account may print a greeting, a window title or a farewell
//! around it, with or without line ends: the command's own output lies between two marks that are drawn for each call.

use std::io::BufRead;

use super::quote;
use crate::inventory::System;
use crate::os;

/// Script that runs the command `$1` between the marks of `$0`, on both outputs. It is one argument for any login shell:
/// without `'`, line ends and csh's `!`. The marks are composed here, so that a shell that traces its commands prints none.
pub(super) const SCRIPT: &str = r#"printf "%s-begin\n" "$0"; printf "%s-begin\n" "$0" >&2; (eval "$1"); s=$?; printf "%s-end %d.\n" "$0" "$s"; printf "%s-end\n" "$0" >&2; exit "$s""#;

/// The marks of one call.
#[derive(Clone, Debug)]
pub struct Marks {
    begin: String,
    end: String,
    name: String,
}

/// Output of a call, divided by its marks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Divided<'a> {
    /// The text before the first mark.
    pub(super) before: &'a str,
    /// The command's own output.
    pub(super) own: &'a str,
    /// The text after the last mark, with the exit status of the command; `None` without that mark.
    pub(super) end: Option<(&'a str, i32)>,
}

impl Marks {
    /// Draws the marks of a call.
    ///
    /// # Errors
    /// If the system gives no random numbers.
    pub(super) fn draw() -> Result<Self, String> {
        let bytes = os::random_bytes().ok_or("the system gives no random numbers")?;
        Ok(Self::of(&format!("skein-{:032x}", u128::from_be_bytes(bytes))))
    }

    fn of(name: &str) -> Self {
        Self { begin: format!("{name}-begin\n"), end: format!("{name}-end"), name: name.to_owned() }
    }

    /// The command for the login shell that runs this command between the marks. On Windows it is one of Skein's own, which prints
    /// the marks itself: cmd.exe and PowerShell have no syntax in common.
    pub(super) fn around(&self, system: System, command: &str) -> String {
        match system {
            System::Unix => format!("sh -c {} {} {}", quote(SCRIPT), self.name, quote(command)),
            System::Windows => format!("{command} --marks {}", self.name),
        }
    }

    /// The mark behind everything that the command writes.
    pub(super) fn end(&self) -> &str {
        &self.end
    }

    /// Divides the standard output; `None` if the command did not begin.
    pub(super) fn divide<'a>(&self, stdout: &'a str) -> Option<Divided<'a>> {
        let (before, rest) = stdout.split_once(&self.begin)?;
        let (own, end) = self.ended(rest).map_or((rest, None), |(own, end)| (own, Some(end)));
        Some(Divided { before, own, end })
    }

    /// Splits a text at the last mark: what stands before it; what stands after it, and the exit status.
    pub(super) fn ended<'a>(&self, text: &'a str) -> Option<(&'a str, (&'a str, i32))> {
        let (own, rest) = text.split_once(&self.end)?;
        let (status, after) = rest.split_once('.')?;
        Some((own, (after.trim(), status.trim().parse().ok()?)))
    }

    /// The command's own standard error; all of it if the command did not begin.
    pub(super) fn error<'a>(&self, stderr: &'a str) -> &'a str {
        let own = stderr.rsplit_once(&self.begin).map_or(stderr, |(_, own)| own);
        own.split_once(&self.end).map_or(own, |(own, _)| own)
    }

    /// Reads over everything before the command's own output; `false` if the command did not begin.
    pub(crate) fn skip(&self, output: &mut impl BufRead) -> bool {
        let mut line = Vec::new();
        while output.read_until(b'\n', &mut line).is_ok_and(|read| read > 0) {
            // Something may stand before the mark on its line.
            if line.ends_with(self.begin.as_bytes()) {
                return true;
            }
            line.clear();
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_stands_between_the_marks_is_an_answer() {
        let marks = Marks::of("m");
        let whole = marks.divide("\u{1b}]0;title\u{7}m-begin\none\ntwom-end 3.\nbye\n").unwrap();
        assert_eq!(whole, Divided { before: "\u{1b}]0;title\u{7}", own: "one\ntwo", end: Some(("bye", 3)) });
        assert_eq!(marks.divide("m-begin\nhalf"), Some(Divided { before: "", own: "half", end: None }));
        assert_eq!(marks.divide("not a login shell\n"), None);
        assert_eq!(marks.error("noise\nm-begin\nreason\nm-end\nfarewell\n"), "reason\n");
        assert_eq!(marks.error("ssh: refused\n"), "ssh: refused\n");
        let mut output = &b"title\xffm-begin\nanswer\n"[..];
        assert!(marks.skip(&mut output) && output == b"answer\n");
        assert!(!marks.skip(&mut &b"nothing\n"[..]));
    }

    #[test]
    fn every_call_has_marks_of_its_own() {
        let (one, other) = (Marks::draw().unwrap(), Marks::draw().unwrap());
        assert_ne!(one.name, other.name);
        assert!(!one.around(System::Unix, "true").contains(&one.end), "a traced command holds no mark");
    }
}
