//! Our own supervisor, for hosts without systemd: starts an agent again when it has died, and keeps its log. Killed, it
//! costs the log and the next restart, never the flight; the next one takes the agent on that it finds.

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
use crate::os::{self, Interrupts};
use skein_host::clock;

/// The first pause before an agent is started again, and the longest: each is twice the one before.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
const LONGEST_PAUSE: Duration = Duration::from_secs(10);
/// One that has flown for so long has not died of its start: pauses begin anew.
const STABLE: Duration = Duration::from_secs(60);
/// Between two looks at the agent.
const POLL_PERIOD: Duration = Duration::from_millis(50);
/// Whoever only asks whether there is a supervisor holds its lock for an instant.
const LOCK_WITHIN: Duration = Duration::from_secs(2);
/// What an agent wrote before its end is read within this time.
const LAST_LINES: Duration = Duration::from_secs(1);

/// Keeps the node's agent alive until it has ended well, or this process is asked to end: then the agent is asked to.
pub(super) fn supervise(node: &NodeFolder) -> Result<(), String> {
    os::leave_session();
    let interrupts = Interrupts::listen().map_err(|error| error.to_string())?;
    let path = node.supervisor_path();
    let another = || format!("node {} has a supervisor already", node.id);
    let mut lock = Lock::take(&path, LOCK_WITHIN)?.ok_or_else(another)?;
    lock.note(&skein_lab::terminal::json(&Process::own())).map_err(at(&path))?;
    Supervisor { node, interrupts, passed_on: 0, log: Arc::new(Mutex::new(Log::new(&node.log()))) }.run();
    Ok(())
}

struct Supervisor<'a> {
    node: &'a NodeFolder,
    interrupts: Interrupts,
    /// How often this process was asked to end, as far as the agent knows.
    passed_on: u32,
    log: Arc<Mutex<Log>>,
}

/// The agent that is looked after.
enum Agent {
    /// Started by this process; what it writes is told to be read to its end.
    Own(Child, Receiver<()>),
    /// Of a supervisor that has died. Only a mark tells whether it has ended well.
    Found(Process),
}

impl Agent {
    fn ask_to_end(&self) {
        match self {
            Self::Own(child, _) => os::ask_to_end(child.id()),
            Self::Found(process) => process.ask_to_end(),
        }
    }

    /// How it has ended, as far as that is known, if it has; `mark` is there then, if it has ended well.
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
            self.note("takes on the agent that it finds");
        }
        loop {
            let begun = clock::now();
            let ended = match found.take().map_or_else(|| self.start(), Ok) {
                Ok(agent) => self.watch(agent),
                Err(error) => {
                    self.note(&format!("the agent cannot be started: {error}"));
                    None
                }
            };
            if ended.is_some_and(|status| status.success()) || self.interrupts.count() > 0 {
                return self.note("ends");
            }
            pause = next_pause(pause, clock::now().duration_since(begun));
            self.note(&format!("starts it again in {} s", pause.as_secs_f64()));
            if super::service::wait(pause, || self.interrupts.count() > 0) {
                return self.note("ends");
            }
        }
    }

    /// Starts the agent. Its output comes by a pipe: one file of its own would have no end.
    fn start(&self) -> io::Result<Agent> {
        let (output, input) = io::pipe()?;
        let mut command = Command::new(self.node.active().join(PROGRAM));
        command.args(["node", "--fly"]).arg(self.node.id.to_string()).stdin(Stdio::null());
        let child = command.stdout(input.try_clone()?).stderr(input).spawn()?;
        // The command holds the pipe's other end.
        drop(command);
        let (log, (done, is_done)) = (self.log.clone(), mpsc::channel());
        thread::spawn(move || {
            logs::lines(output, |line| log.lock().unwrap_or_else(PoisonError::into_inner).add(line));
            done.send(())
        });
        Ok(Agent::Own(child, is_done))
    }

    /// Waits for the agent's end. Being asked to end is passed on.
    fn watch(&mut self, mut agent: Agent) -> Option<ExitStatus> {
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
            clock::sleep(POLL_PERIOD);
        };
        if let Agent::Own(_, is_done) = agent {
            // A process that it has left behind may still hold the pipe.
            let _ = is_done.recv_timeout(LAST_LINES);
        }
        let how = status.map_or("is gone".to_owned(), os::how_it_ended);
        self.note(&format!("the agent {}", how.replace("killed", "was killed")));
        status
    }

    fn note(&self, what: &str) {
        self.log.lock().unwrap_or_else(PoisonError::into_inner).note(what);
    }
}

/// Before an agent is started again that has flown for so long, and had to wait for so long the last time.
fn next_pause(last: Duration, flown: Duration) -> Duration {
    if flown > STABLE { FIRST_PAUSE } else { (2 * last).clamp(FIRST_PAUSE, LONGEST_PAUSE) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_while_agents_die_young() {
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
