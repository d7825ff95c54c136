//! Identifies another process, so that a later process with the same id is not mistaken for it.

use std::fs;

use serde::{Deserialize, Serialize};

use crate::os;

/// A process that runs or has run on this host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Process {
    /// Process id.
    pub(super) pid: u32,
    /// Start time in a unit of the system, on Linux the kernel's clock ticks; `None` where the system does not report it.
    began: Option<u64>,
}

impl Process {
    /// This process. It stays the same when it becomes another program.
    pub(super) fn own() -> Self {
        Self::of(std::process::id())
    }

    /// The process that has this id now.
    pub(super) fn of(pid: u32) -> Self {
        Self { pid, began: stat(pid).map(|(_, began)| began) }
    }

    /// Whether it is running. A zombie is not.
    pub(super) fn is_running(&self) -> bool {
        let is_it = |(state, began)| state != 'Z' && self.began.is_none_or(|own| own == began);
        os::is_running(self.pid) && stat(self.pid).map_or(self.began.is_none(), is_it)
    }

    /// Asks it to end, or ends it by force, if it is running.
    pub(super) fn end(&self, by_force: bool) {
        if self.is_running() {
            os::end(self.pid, by_force);
        }
    }
}

/// The state of a process as Linux's `/proc` has it, and its start time; elsewhere every process runs.
fn stat(pid: u32) -> Option<(char, u64)> {
    // Where Windows' programs run on Linux, `/proc` has other processes under their ids.
    match fs::read_to_string(format!("/proc/{pid}/stat")).ok().filter(|_| cfg!(unix)) {
        Some(text) => parse(&text),
        None => Some(('R', os::began(pid)?)),
    }
}

/// Parses a line of `/proc/PID/stat`. The second field is the program's name in parentheses, which may contain any
/// character.
fn parse(stat: &str) -> Option<(char, u64)> {
    let mut fields = stat.rsplit_once(')')?.1.split_ascii_whitespace();
    let state = fields.next()?.chars().next()?;
    // The 22nd field of the line.
    Some((state, fields.nth(18)?.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use std::process::{Command, Stdio};

    use super::*;
    use skein_host::clock;

    #[test]
    fn a_program_name_with_parentheses_and_spaces_is_skipped() {
        let stat = "77 (a) b) S 1 77 77 0 -1 4194560 1 2 3 4 5 6 7 8 20 0 1 0 424242 1000 5";
        assert_eq!(parse(stat), Some(('S', 424_242)));
    }

    #[test]
    #[cfg(unix)]
    fn a_process_with_the_same_id_and_another_start_is_another_process() {
        let own = Process::own();
        assert!(own.is_running());
        if let Some(began) = own.began {
            assert!(!Process { began: Some(began + 1), ..own }.is_running(), "began at another time");
        }
        let mut child = Command::new("sleep").arg("60").stdin(Stdio::null()).spawn().unwrap();
        let process = Process { pid: child.id(), began: stat(child.id()).map(|(_, began)| began) };
        assert!(process.is_running());
        process.end(true);
        if process.began.is_some() {
            // A zombie until it is waited for.
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
