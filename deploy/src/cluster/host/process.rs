//! Another process, known well enough not to be taken for a later one of the same number.

use std::fs;

use serde::{Deserialize, Serialize};

use crate::os;

/// A process that runs or has run on this host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Process {
    pub(super) pid: u32,
    /// When it began, in the kernel's count; `None` where that is not told.
    began: Option<u64>,
}

impl Process {
    /// This one. It stays the same if it becomes another program.
    pub(super) fn own() -> Self {
        let pid = std::process::id();
        Self { pid, began: stat(pid).map(|(_, began)| began) }
    }

    /// A dead one that nobody has buried does not run.
    pub(super) fn is_running(&self) -> bool {
        let is_it = |(state, began)| state != 'Z' && self.began.is_none_or(|own| own == began);
        os::is_running(self.pid) && stat(self.pid).map_or(self.began.is_none(), is_it)
    }

    /// SIGTERM, if it still runs.
    pub(super) fn ask_to_end(&self) {
        if self.is_running() {
            os::ask_to_end(self.pid);
        }
    }

    /// SIGKILL, if it still runs.
    pub(super) fn kill(&self) {
        if self.is_running() {
            os::kill(self.pid);
        }
    }
}

/// Its state and when it began, from Linux's table.
fn stat(pid: u32) -> Option<(char, u64)> {
    parse(&fs::read_to_string(format!("/proc/{pid}/stat")).ok()?)
}

/// The second field is the program's name in parentheses, which may hold anything.
fn parse(stat: &str) -> Option<(char, u64)> {
    let mut fields = stat.rsplit_once(')')?.1.split_ascii_whitespace();
    let state = fields.next()?.chars().next()?;
    // The 22nd of all.
    Some((state, fields.nth(18)?.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use std::process::{Command, Stdio};

    use super::*;
    use skein_host::clock;

    #[test]
    fn a_name_with_parentheses_and_spaces_is_passed_over() {
        let stat = "77 (a) b) S 1 77 77 0 -1 4194560 1 2 3 4 5 6 7 8 20 0 1 0 424242 1000 5";
        assert_eq!(parse(stat), Some(('S', 424_242)));
    }

    #[test]
    #[cfg(unix)]
    fn another_process_of_the_same_number_is_another() {
        let own = Process::own();
        assert!(own.is_running());
        if let Some(began) = own.began {
            assert!(!Process { began: Some(began + 1), ..own }.is_running(), "began at another time");
        }
        let mut child = Command::new("sleep").arg("60").stdin(Stdio::null()).spawn().unwrap();
        let process = Process { pid: child.id(), began: stat(child.id()).map(|(_, began)| began) };
        assert!(process.is_running());
        process.kill();
        if process.began.is_some() {
            // Dead before it is waited for.
            let until = clock::now() + std::time::Duration::from_secs(10);
            while process.is_running() && clock::now() < until {
                clock::sleep(std::time::Duration::from_millis(5));
            }
            assert!(!process.is_running());
        }
        child.wait().unwrap();
        assert!(!process.is_running());
    }
}
