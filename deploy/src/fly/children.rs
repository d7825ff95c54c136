//! The processes that a flight consists of: this program itself, once for each agent and once for each stand-in.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::{Child as Process, ChildStdin, Command, ExitStatus, Stdio};

use skein_common::id::{VehicleId, VehicleSet};

use skein_cluster::os;

/// The role of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProcessRole {
    /// It flies a vehicle.
    Agent,
    /// It is the vehicle's simulator.
    Standin,
}

/// All processes of a flight; those that still run when this value goes are killed, except those that were left to themselves.
#[derive(Debug, Default)]
pub struct Children(Vec<Child>);

#[derive(Debug)]
struct Child {
    role: ProcessRole,
    id: VehicleId,
    /// The arguments with which it was started the first time.
    arguments: Vec<OsString>,
    process: Process,
    /// Open for as long as the process is wanted.
    stdin: Option<ChildStdin>,
    log: PathBuf,
    ended: Option<ExitStatus>,
}

/// A process that has ended by itself.
#[derive(Clone, Debug)]
pub struct Ended {
    /// Its role.
    pub role: ProcessRole,
    /// Its vehicle.
    pub id: VehicleId,
    /// Its exit status.
    pub status: ExitStatus,
    /// The last thing it wrote, if it failed by itself.
    pub last_words: Option<String>,
}

impl Children {
    /// Starts this program with these arguments; what it writes goes to the end of `log`.
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn start(&mut self, role: ProcessRole, id: VehicleId, arguments: Vec<OsString>, log: &Path) -> io::Result<()> {
        let mut process = spawn(&arguments, log)?;
        let stdin = process.stdin.take();
        self.0.push(Child { role, id, arguments, process, stdin, log: log.to_owned(), ended: None });
        Ok(())
    }

    /// Starts a process again that has ended, with `more` arguments than the first time.
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn restart(&mut self, role: ProcessRole, id: VehicleId, more: [OsString; 2]) -> io::Result<()> {
        let Some(child) = self.child(role, id).filter(|child| child.ended.is_some()) else { return Ok(()) };
        let arguments = [child.arguments.as_slice(), &more].concat();
        let mut process = spawn(&arguments, &child.log)?;
        (child.stdin, child.process, child.ended) = (process.stdin.take(), process, None);
        Ok(())
    }

    /// Ends one process and waits for it; `None` if it has ended before.
    pub fn kill_one(&mut self, role: ProcessRole, id: VehicleId) -> Option<Ended> {
        let child = self.child(role, id).filter(|child| child.ended.is_none())?;
        let _ = child.process.kill();
        let status = child.process.wait().ok()?;
        Some(child.end(status))
    }

    /// Freezes one process, or resumes it.
    ///
    /// # Errors
    /// If the system cannot, or the process is gone.
    pub fn freeze(&mut self, role: ProcessRole, id: VehicleId, frozen: bool) -> io::Result<()> {
        match self.child(role, id) {
            Some(child) if child.ended.is_none() => os::freeze(&child.process, frozen),
            _ => Err(io::ErrorKind::NotFound.into()),
        }
    }

    fn child(&mut self, role: ProcessRole, id: VehicleId) -> Option<&mut Child> {
        self.0.iter_mut().find(|child| child.role == role && child.id == id)
    }

    /// Processes that have ended since the last call.
    pub fn reap(&mut self) -> Vec<Ended> {
        let mut ended = Vec::new();
        for child in self.0.iter_mut().filter(|child| child.ended.is_none()) {
            if let Ok(Some(status)) = child.process.try_wait() {
                ended.push(child.end(status));
            }
        }
        ended
    }

    /// The exit status of this process, if it has ended.
    pub fn how_ended(&self, role: ProcessRole, id: VehicleId) -> Option<ExitStatus> {
        self.0.iter().find(|child| child.role == role && child.id == id)?.ended
    }

    /// Whether any process of this kind still runs.
    pub fn any(&self, role: ProcessRole) -> bool {
        self.0.iter().any(|child| child.role == role && child.ended.is_none())
    }

    /// Asks every agent to end.
    pub fn ask_agents_to_end(&mut self) {
        for child in self.0.iter_mut().filter(|child| child.role == ProcessRole::Agent) {
            if let Some(mut stdin) = child.stdin.take() {
                // One that is gone needs no asking.
                let _ = stdin.write_all(b"stop\n");
            }
        }
    }

    /// Leaves the processes of these vehicles to themselves: agents land and end, and their simulators with them.
    pub fn leave(&mut self, vehicles: VehicleSet) {
        self.0.retain(|child| !vehicles.contains(child.id));
    }

    /// Ends whatever still runs, and waits for it.
    pub fn kill(&mut self) {
        for child in self.0.iter_mut().filter(|child| child.ended.is_none()) {
            let _ = child.process.kill();
            child.ended = child.process.wait().ok();
        }
    }
}

impl Child {
    fn end(&mut self, status: ExitStatus) -> Ended {
        self.ended = Some(status);
        let has_failed = status.code().is_some_and(|code| code != 0);
        let last_words = has_failed.then(|| last_line(&self.log)).flatten();
        Ended { role: self.role, id: self.id, status, last_words }
    }
}

impl Drop for Children {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Starts this program with these arguments; what it writes goes to the end of `log`.
fn spawn(arguments: &[OsString], log: &Path) -> io::Result<Process> {
    let mut command = Command::new(std::env::current_exe()?);
    skein_host::process::in_own_group(&mut command);
    command.args(arguments);
    let log = File::options().create(true).append(true).open(log)?;
    command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(log).spawn()
}

/// The last line of a log that is not empty.
fn last_line(log: &Path) -> Option<String> {
    let text = String::from_utf8_lossy(&fs::read(log).ok()?).into_owned();
    text.lines().rev().map(str::trim).find(|line| !line.is_empty()).map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_line_that_is_not_empty() {
        let folder = tempfile::tempdir().unwrap();
        let log = folder.path().join("log");
        assert_eq!(last_line(&log), None);
        fs::write(&log, "one\n two \n\n").unwrap();
        assert_eq!(last_line(&log).as_deref(), Some("two"));
    }
}
