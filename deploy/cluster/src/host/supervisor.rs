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
use super::node::{ACTIVE, ENDED, LOG, NOTIFY, NodeFolder, SUPERVISOR};
use super::place::PROGRAM;
use super::process::Process;
use super::service;
use super::supervision::{AgentEnd, POLL_PERIOD, Supervised, Supervision};
use crate::os::{self, Interrupts, Notifications};
use skein_host::clock;

/// Time limit for the supervisor's lock: a process that only checks for a supervisor holds it for an instant.
const LOCK_WITHIN: Duration = Duration::from_secs(2);
/// Time limit for reading the agent's last output.
const LAST_LINES: Duration = Duration::from_secs(1);

/// Keeps the node's agent running until it has ended successfully, or this process is asked to end: then it asks the
/// agent to end.
pub(super) fn supervise(node: &NodeFolder) -> Result<(), String> {
    os::leave_session();
    let interrupts = Interrupts::listen().map_err(|error| error.to_string())?;
    let path = node.file(SUPERVISOR);
    let another = || format!("node {} already has a supervisor", node.id);
    let mut lock = Lock::take(&path, LOCK_WITHIN)?.ok_or_else(another)?;
    lock.set_text(&skein_lab::terminal::json(&Process::own())).map_err(at(&path))?;
    let agent = node.agent().map(|agent| Agent::Found(agent.process));
    let log = Arc::new(Mutex::new(Log::new(&node.file(LOG))));
    let mut supervised = NodeAgent { node, interrupts, agent, reports: None, log };
    let mut supervision = match &supervised.agent {
        Some(_) => Supervision::taking_over(&mut supervised, clock::now()),
        None => Supervision::default(),
    };
    while !supervision.poll(&mut supervised, clock::now()) {
        clock::sleep(POLL_PERIOD);
    }
    Ok(())
}

/// The agent of a node, with what its supervisor needs.
struct NodeAgent<'a> {
    node: &'a NodeFolder,
    interrupts: Interrupts,
    /// The agent that was started or found last.
    agent: Option<Agent>,
    /// The socket for the agent's reports.
    reports: Option<Notifications>,
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
    fn end(&self, by_force: bool) {
        match self {
            Self::Own(child, _) => os::end(child.id(), by_force),
            Self::Found(process) => process.end(by_force),
        }
    }

    /// Returns `None` while the agent runs, else its exit status as far as known. For an agent of another supervisor,
    /// `mark` exists if it has ended successfully.
    fn ended(&mut self, mark: &Path) -> Option<Option<ExitStatus>> {
        match self {
            Self::Own(child, is_done) => {
                let status = child.try_wait().ok()??;
                // A child process of the agent may still hold the pipe.
                let _ = is_done.recv_timeout(LAST_LINES);
                Some(Some(status))
            }
            Self::Found(process) if process.is_running() => None,
            Self::Found(_) => Some(mark.exists().then(ExitStatus::default)),
        }
    }
}

impl Supervised for NodeAgent<'_> {
    fn listen(&mut self) -> Result<(), String> {
        let path = self.node.file(NOTIFY);
        self.reports = None;
        self.reports = Some(Notifications::listen(&path).map_err(at(&path))?);
        Ok(())
    }

    /// Its output comes through a pipe, because a file of its own would grow without limit.
    fn start(&mut self) -> Result<(), String> {
        self.agent = None;
        self.agent = Some(self.spawn().map_err(|error| error.to_string())?);
        Ok(())
    }

    fn ended(&mut self) -> Option<AgentEnd> {
        let status = self.agent.as_mut()?.ended(&self.node.file(ENDED))?;
        let how = status.map_or("has disappeared".to_owned(), os::how_it_ended).replace("killed", "was killed");
        Some(AgentEnd { is_success: status.is_some_and(|status| status.success()), how })
    }

    fn has_reported(&mut self) -> bool {
        self.reports.as_ref().is_some_and(Notifications::take)
    }

    fn kill(&mut self) {
        self.agent.iter().for_each(|agent| agent.end(true));
    }

    fn ask_to_end(&mut self) {
        self.agent.iter().for_each(|agent| agent.end(false));
    }

    fn requests(&self) -> u32 {
        self.interrupts.count()
    }

    fn note(&mut self, what: &str) {
        self.log.lock().unwrap_or_else(PoisonError::into_inner).note(what);
    }
}

impl NodeAgent<'_> {
    fn spawn(&self) -> io::Result<Agent> {
        let (output, input) = io::pipe()?;
        let mut command = match os::CAN_BECOME {
            true => Command::new(self.node.file(ACTIVE).join(PROGRAM)),
            false => service::agent(self.node).map_err(io::Error::other)?,
        };
        if os::CAN_BECOME {
            command.args(["node", "--fly"]).arg(self.node.id.to_string());
        }
        // What systemd does for its services.
        if let Some(reports) = &self.reports {
            command.env("NOTIFY_SOCKET", reports.address(&self.node.file(NOTIFY))?);
        }
        let child = command.stdin(Stdio::null()).stdout(input.try_clone()?).stderr(input).spawn()?;
        if !os::CAN_BECOME {
            service::note(self.node, Process::of(child.id())).map_err(io::Error::other)?;
        }
        // The command holds the other end of the pipe.
        drop(command);
        let (log, (done, is_done)) = (self.log.clone(), mpsc::channel());
        thread::spawn(move || {
            logs::lines(output, |line| log.lock().unwrap_or_else(PoisonError::into_inner).add(line));
            done.send(())
        });
        Ok(Agent::Own(child, is_done))
    }
}
