//! Skein's own supervisor, for hosts without systemd: restarts an agent that has failed, and writes its log. If the
//! supervisor is killed, the log and the next restart are lost, but the flight continues; a new supervisor takes over
//! the running agent.

use std::io;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use super::files::{Lock, at};
use super::logs::{self, Log};
use super::node::NodeFolder;
use super::place::PROGRAM;
use super::process::Process;
use super::watchdog::Watchdog;
use crate::os::{self, Interrupts, Notifications};
use skein_host::clock;

/// The first pause before an agent is restarted; each further pause is twice as long.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
/// The longest pause before an agent is restarted.
const LONGEST_PAUSE: Duration = Duration::from_secs(10);
/// An agent that has run for this long did not fail at its start: pauses begin with the shortest again.
const STABLE: Duration = Duration::from_secs(60);
/// Interval at which the agent is checked.
const POLL_PERIOD: Duration = Duration::from_millis(50);
/// Time limit for the supervisor's lock: a process that only checks for a supervisor holds it for an instant.
const LOCK_WITHIN: Duration = Duration::from_secs(2);
/// Time limit for reading the agent's last output.
const LAST_LINES: Duration = Duration::from_secs(1);

/// Keeps the node's agent running until it has ended successfully, or this process is asked to end: then it asks the
/// agent to end.
pub(super) fn supervise(node: &NodeFolder) -> Result<(), String> {
    os::leave_session();
    let interrupts = Interrupts::listen().map_err(|error| error.to_string())?;
    let path = node.supervisor_path();
    let another = || format!("node {} already has a supervisor", node.id);
    let mut lock = Lock::take(&path, LOCK_WITHIN)?.ok_or_else(another)?;
    lock.set_text(&skein_lab::terminal::json(&Process::own())).map_err(at(&path))?;
    Supervisor { node, interrupts, passed_on: 0, log: Arc::new(Mutex::new(Log::new(&node.log()))) }.run();
    Ok(())
}

struct Supervisor<'a> {
    node: &'a NodeFolder,
    interrupts: Interrupts,
    /// Number of requests to end that were passed on to the agent.
    passed_on: u32,
    log: Arc<Mutex<Log>>,
}

/// The supervised agent.
enum Agent {
    /// Started by this process; the receiver reports that its output has been read to the end.
    Own(Child, Receiver<()>),
    /// Started by a supervisor that has died. Only the mark file shows whether it has ended successfully.
    Found(Process),
}

impl Agent {
    fn kill(&self) {
        match self {
            Self::Own(child, _) => os::kill(child.id()),
            Self::Found(process) => process.kill(),
        }
    }

    fn ask_to_end(&self) {
        match self {
            Self::Own(child, _) => os::ask_to_end(child.id()),
            Self::Found(process) => process.ask_to_end(),
        }
    }

    /// Returns `None` while the agent runs, else its exit status as far as known. For an agent of another supervisor,
    /// `mark` exists if it has ended successfully.
    fn ended(&mut self, mark: &Path) -> Option<Option<ExitStatus>> {
        match self {
            Self::Own(child, _) => child.try_wait().ok()?.map(Some),
            Self::Found(process) if process.is_running() => None,
            Self::Found(_) => Some(mark.exists().then(ExitStatus::default)),
        }
    }
}

impl Supervisor<'_> {
    fn run(mut self) {
        let mut pause = Duration::ZERO;
        let mut found = self.node.agent().map(|agent| Agent::Found(agent.process));
        if found.is_some() {
            self.note("takes over the running agent");
        }
        loop {
            let begun = clock::now();
            // Before the agent starts, because its reports need the socket.
            let dog = Watchdog::listen(&self.node.notify_path(), begun);
            if let Err(error) = &dog {
                self.note(&format!(
                    "an agent that hangs is not noticed: {}: {error}",
                    self.node.notify_path().display()
                ));
            }
            let ended = match found.take().map_or_else(|| self.start(), Ok) {
                Ok(agent) => self.watch(agent, dog.ok()),
                Err(error) => {
                    self.note(&format!("the agent cannot be started: {error}"));
                    None
                }
            };
            if ended.is_some_and(|status| status.success()) || self.interrupts.count() > 0 {
                return self.note("ending");
            }
            pause = next_pause(pause, clock::now().duration_since(begun));
            self.note(&format!("restarting the agent in {} s", pause.as_secs_f64()));
            if super::service::wait(pause, || self.interrupts.count() > 0) {
                return self.note("ending");
            }
        }
    }

    /// Starts the agent. Its output comes through a pipe, because a file of its own would grow without limit.
    fn start(&self) -> io::Result<Agent> {
        let (output, input) = io::pipe()?;
        let mut command = Command::new(self.node.active().join(PROGRAM));
        command.args(["node", "--fly"]).arg(self.node.id.to_string()).stdin(Stdio::null());
        // What systemd does for its services.
        command.env("NOTIFY_SOCKET", self.node.notify_path());
        let child = command.stdout(input.try_clone()?).stderr(input).spawn()?;
        // The command holds the other end of the pipe.
        drop(command);
        let (log, (done, is_done)) = (self.log.clone(), mpsc::channel());
        thread::spawn(move || {
            logs::lines(output, |line| log.lock().unwrap_or_else(PoisonError::into_inner).add(line));
            done.send(())
        });
        Ok(Agent::Own(child, is_done))
    }

    /// Waits until the agent has ended, passes on requests to end, and kills an agent that hangs.
    fn watch(&mut self, mut agent: Agent, mut dog: Option<Watchdog<Notifications>>) -> Option<ExitStatus> {
        let mark = self.node.ended_path();
        let status = loop {
            let asked = self.interrupts.count();
            for _ in self.passed_on..asked {
                agent.ask_to_end();
            }
            self.passed_on = asked;
            if let Some(status) = agent.ended(&mark) {
                break status;
            }
            if let Some(silent) = dog.as_mut().and_then(|dog| dog.silent_for(clock::now())) {
                self.note(&format!("the agent hangs: silent for {:.0} s; it is killed", silent.as_secs_f64()));
                agent.kill();
                dog = None;
            }
            clock::sleep(POLL_PERIOD);
        };
        if let Agent::Own(_, is_done) = agent {
            // A child process of the agent may still hold the pipe.
            let _ = is_done.recv_timeout(LAST_LINES);
        }
        let how = status.map_or("has disappeared".to_owned(), os::how_it_ended);
        self.note(&format!("the agent {}", how.replace("killed", "was killed")));
        status
    }

    fn note(&self, what: &str) {
        self.log.lock().unwrap_or_else(PoisonError::into_inner).note(what);
    }
}

/// Returns the pause before the next restart, from the last pause and the time that the agent has run.
fn next_pause(last: Duration, flown: Duration) -> Duration {
    if flown > STABLE { FIRST_PAUSE } else { (2 * last).clamp(FIRST_PAUSE, LONGEST_PAUSE) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_while_agents_fail_soon_after_their_start() {
        let young = Duration::from_secs(1);
        let mut pause = Duration::ZERO;
        let mut pauses_s = Vec::new();
        for _ in 0..7 {
            pause = next_pause(pause, young);
            pauses_s.push(pause.as_secs_f64());
        }
        assert_eq!(pauses_s, [0.5, 1.0, 2.0, 4.0, 8.0, 10.0, 10.0]);
        assert_eq!(next_pause(pause, Duration::from_secs(61)), FIRST_PAUSE);
    }
}
