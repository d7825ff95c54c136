//! Starting and stopping a node's agent, whoever it is that starts it again when it has died.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::time::{Duration, Instant};

use skein_agent::config::AgentOptions;
use skein_agent::link::seal::runs::RunNote;
use skein_agent::run::{INCARNATION_FILE, RELEASE};

use super::files::{self, at};
use super::logs;
use super::node::{AgentProcess, NodeFolder, Settings, Started, install_name, linked};
use super::place::{PROGRAM, Place};
use super::process::Process;
use super::systemd::Systemd;
use crate::cluster::protocol::Service;
use crate::inventory::ServiceKind;
use crate::os;
use skein_host::clock;

/// Environment variable that names the file which an agent leaves when it has ended well.
const ENDED: &str = "SKEIN_ENDED";
/// Environment variable that names the folder which systemd has made for a service.
const RUNTIME_DIRECTORY: &str = "RUNTIME_DIRECTORY";
/// Between two looks at a process.
const LOOK: Duration = Duration::from_millis(20);
/// A process that was started is there within this time, and one that was killed is gone.
const SOON: Duration = Duration::from_secs(10);
/// An agent that cannot begin has ended within this time.
const HASTY: Duration = Duration::from_millis(400);
/// An agent that was asked a second time gives its controls back and ends.
const AT_ONCE: Duration = Duration::from_secs(3);

/// What there was to end, and how it has ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Ended {
    /// An agent ran, or somebody was there to start one.
    pub(super) was_busy: bool,
    /// The agent did not land in time.
    pub(super) by_force: bool,
}

/// Who will start this node's agent again. What was chosen once stays.
pub(super) fn resolve(place: &Place, node: &NodeFolder, kind: ServiceKind) -> Result<Service, String> {
    let systemd = &place.systemd;
    match (kind, node.settings()) {
        (ServiceKind::Own, _) => Ok(Service::Own),
        (ServiceKind::Systemd, _) => systemd.ready().map(|()| systemd.service()),
        (ServiceKind::Auto, Some(settings)) => Ok(settings.service),
        (ServiceKind::Auto, None) if Systemd::is_booted() && systemd.ready().is_ok() => Ok(systemd.service()),
        (ServiceKind::Auto, None) => Ok(Service::Own),
    }
}

/// Makes it so that this service can start the node. Whether anything was written.
pub(super) fn put(place: &Place, node: &NodeFolder, settings: &Settings) -> Result<bool, String> {
    let old = node.settings().map(|settings| settings.service);
    if old.is_some_and(|old| old != settings.service) {
        if is_busy(node) {
            return Err(format!("node {} runs under another service: end it first", node.id));
        }
        take_away(place, node)?;
    }
    match place.systemd(settings.service) {
        Some(systemd) => systemd.put(&place.swarm, node),
        None => Ok(false),
    }
}

/// Takes the node's service away.
pub(super) fn take_away(place: &Place, node: &NodeFolder) -> Result<(), String> {
    match node.settings().and_then(|settings| place.systemd(settings.service)) {
        Some(systemd) => systemd.take_away(&place.swarm, node),
        None => Ok(()),
    }
}

/// Starts what is current, in this run of the swarm, and waits until the agent's process is there. Whether anything was
/// started; what runs goes on.
pub(super) fn start(place: &Place, node: &NodeFolder, run: u64, note: Option<RunNote>) -> Result<bool, String> {
    let (Some(installed), Some(settings)) = (linked(&node.current()), node.settings()) else {
        return Err(format!("nothing is installed for node {}", node.id));
    };
    let systemd = place.systemd(settings.service);
    match (node.agent(), systemd) {
        (Some(_), Some(_)) => return Ok(false),
        (Some(_), None) if node.supervisor().is_some() => return Ok(false),
        // Its supervisor has died; a new one takes it on.
        (Some(_), None) => return supervise(node).map(|()| true),
        // What dies again and again, and waits to be started once more, is given up for what is asked now.
        (None, None) => drop(end(node, None, Duration::ZERO)?),
        (None, Some(_)) => {}
    }
    let to = Path::new("../installs").join(install_name(&installed));
    files::remove(&node.agent_path()).map_err(at(&node.agent_path()))?;
    files::link(&node.active(), &to)?;
    node.set_started(&Started { installed, run, note, at_s: os::uptime_s() })?;
    match systemd {
        Some(systemd) => systemd.start(&place.swarm, node)?,
        None => supervise(node)?,
    }
    if !wait(SOON, || node.last_agent().is_some()) {
        return Err(format!("the agent of node {} was not started{}", node.id, last_words(node)));
    }
    // What is wrong with its files or its port it says at once; no patience mends that.
    if wait(HASTY, || node.agent().is_none()) {
        stop(place, node, Duration::ZERO)?;
        return Err(format!("the agent of node {} has ended at once{}", node.id, last_words(node)));
    }
    Ok(true)
}

/// Lets the agent land and end; after `within` it is ended wherever the vehicle is.
pub(super) fn stop(place: &Place, node: &NodeFolder, within: Duration) -> Result<Ended, String> {
    let systemd = node.settings().and_then(|settings| place.systemd(settings.service));
    end(node, systemd.map(|systemd| (systemd, place)), within)
}

fn end(node: &NodeFolder, systemd: Option<(&Systemd, &Place)>, within: Duration) -> Result<Ended, String> {
    let was_busy = is_busy(node);
    let agent = node.agent().map(|agent| agent.process);
    match (systemd, node.supervisor()) {
        // Also one that is about to be started again.
        (Some((systemd, place)), _) => systemd.stop(&place.swarm, node)?,
        (None, Some(supervisor)) => supervisor.ask_to_end(),
        (None, None) => agent.iter().for_each(Process::ask_to_end),
    }
    let is_over = || !is_busy(node);
    let mut by_force = false;
    if !wait(within, is_over) {
        by_force = node.agent().is_some();
        agent.iter().for_each(Process::ask_to_end);
        if !wait(AT_ONCE, is_over) {
            // The supervisor first: it would be the one to start another.
            node.supervisor().iter().for_each(Process::kill);
            node.agent().iter().for_each(|agent| agent.process.kill());
            if !wait(SOON, is_over) {
                return Err(format!("the agent of node {} cannot be ended", node.id));
            }
        }
    }
    Ok(Ended { was_busy, by_force })
}

/// Whether an agent runs, or somebody is there to start one.
fn is_busy(node: &NodeFolder) -> bool {
    node.agent().is_some() || node.supervisor().is_some()
}

/// Starts a supervisor that outlives this process and the session it was started in.
fn supervise(node: &NodeFolder) -> Result<(), String> {
    let program = node.active().join(PROGRAM);
    let mut command = Command::new(&program);
    command.args(["node", "--supervise"]).arg(node.id.to_string()).current_dir("/");
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let mut supervisor = command.spawn().map_err(at(&program))?;
    let is_there = wait(SOON, || node.supervisor().is_some() || matches!(supervisor.try_wait(), Ok(Some(_)) | Err(_)));
    match supervisor.try_wait() {
        Ok(Some(status)) => Err(format!("the supervisor of node {} {}", node.id, os::how_it_ended(status))),
        _ if !is_there => Err(format!("the supervisor of node {} does not begin", node.id)),
        _ => Ok(()),
    }
}

/// Becomes the node's agent, under this process's number: whoever started this process has started the agent.
pub(super) fn become_agent(node: &NodeFolder) -> Result<(), String> {
    let (Some(started), Some(settings)) = (node.started(), node.settings()) else {
        return Err(format!("node {} was not started by a request", node.id));
    };
    let restarts = node.last_agent().map(|last| last.restarts + 1);
    // Of one that has died: its sockets, and that an earlier one had ended well.
    let left = files::entries(&node.run()).into_iter().filter(|path| is_socket_folder(path));
    for path in left.chain([node.ended_path()]) {
        files::remove(&path).map_err(at(&path))?;
    }
    let agent = AgentProcess { process: Process::own(), restarts: restarts.unwrap_or(0) };
    node.set_agent(&agent)?;
    let program = std::env::current_exe().map_err(|error| error.to_string())?;
    let mut command = Command::new(&program);
    command.args(["agent", "--config"]).arg(node.install(&started.installed).join("agent.toml"));
    command.arg("--run").arg(started.run.to_string());
    if restarts.is_some() {
        // The scenario's events go on from there.
        let flown_s = (os::uptime_s() - started.at_s).max(0.0);
        command.arg("--flown-s").arg(format!("{flown_s:.3}"));
    }
    command.env(RELEASE, &started.installed.release).env(INCARNATION_FILE, node.run().join("life"));
    command.env(ENDED, node.ended_path());
    // Where its sockets are, and what a crash of it is to tell.
    let given = std::env::var_os(RUNTIME_DIRECTORY);
    command.env(RUNTIME_DIRECTORY, sockets(node, settings.service, given)).env("RUST_BACKTRACE", "1");
    if let Some(log) = &settings.log {
        command.env("RUST_LOG", log);
    }
    Err(at(&program)(os::become_program(&mut command)))
}

/// Flies one vehicle. An agent that has ended well leaves a mark, if whoever started it wants one: a supervisor that was not
/// there yet is not told how it ends.
pub(super) fn fly(options: &AgentOptions) -> ExitCode {
    let status = skein_agent::run::program(options);
    if let Some(mark) = std::env::var_os(ENDED).filter(|_| status == ExitCode::SUCCESS) {
        // Without it the agent is started again.
        let _ = fs::write(mark, "");
    }
    status
}

/// Where an agent has the folder of its sockets: in the one that goes with its service, if it was given one.
pub(super) fn sockets(node: &NodeFolder, service: Service, given: Option<OsString>) -> PathBuf {
    let given = given.filter(|_| service != Service::Own);
    given.map_or_else(|| node.run(), PathBuf::from)
}

/// As the agent's links name it.
fn is_socket_folder(path: &Path) -> bool {
    files::name(path).is_some_and(|name| name.starts_with("skein-"))
}

/// The last that the agent wrote, as the end of a sentence.
fn last_words(node: &NodeFolder) -> String {
    let mut tail = logs::tail(&node.log(), 10).into_iter().map(|line| String::from_utf8_lossy(&line).trim().to_owned());
    let last = tail.rfind(|line| !line.is_empty() && !logs::is_ours(line));
    last.map(|line| format!(": {line}")).unwrap_or_default()
}

/// Whether it came true in time.
pub(super) fn wait(within: Duration, mut is_so: impl FnMut() -> bool) -> bool {
    let until: Option<Instant> = clock::now().checked_add(within);
    loop {
        if is_so() {
            return true;
        }
        if until.is_some_and(|until| clock::now() >= until) {
            return false;
        }
        clock::sleep(LOOK);
    }
}
