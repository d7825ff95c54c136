//! Starts and stops a node's agent, under either service.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::time::{Duration, Instant};

use skein_agent::config::AgentOptions;
use skein_agent::link::signature::runs::RunNote;
use skein_agent::run::{INCARNATION_FILE, RELEASE};

use super::files::{self, at};
use super::logs;
use super::node::{
    ACTIVE, AGENT, AgentProcess, CURRENT, ENDED, LOG, Moment, NodeFolder, RUN, STARTED, Settings, Started,
    install_name, linked,
};
use super::place::{PROGRAM, SwarmFolder};
use super::privileges;
use super::process::Process;
use super::supervision::note_agent;
use super::systemd::Systemd;
use crate::inventory::ServiceKind;
use crate::os;
use crate::protocol::Service;
use skein_host::{clock, process};

/// Environment variable with the path of the file that an agent writes when it has ended successfully.
const MARK: &str = "SKEIN_ENDED";
/// Environment variable with the folder that systemd has created for a service.
const RUNTIME_DIRECTORY: &str = "RUNTIME_DIRECTORY";
/// Interval at which a process is checked.
const POLL_PERIOD: Duration = Duration::from_millis(20);
/// Time limit for a process to appear after its start, or to end after a kill.
const PROCESS_TIMEOUT: Duration = Duration::from_secs(10);
/// Time within which an agent that cannot start has ended.
const EARLY_EXIT: Duration = Duration::from_millis(400);
/// Time that a start waits for the supervisor, for the agent, and for an agent that ends at once.
pub(crate) const START_WITHIN: Duration = PROCESS_TIMEOUT.saturating_mul(2).saturating_add(EARLY_EXIT);
/// Time limit for an agent to end after a second request, on which it gives its controls back without landing.
const FORCED_END: Duration = Duration::from_secs(3);

/// Result of stopping a node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Ended {
    /// Whether an agent was running, or a supervisor that would start one.
    pub(super) was_busy: bool,
    /// Whether the agent had to be ended before its vehicle had landed.
    pub(super) by_force: bool,
}

/// Determines the service that restarts this node's agent. With `Auto`, an earlier choice is kept.
pub(super) fn resolve(place: &SwarmFolder, node: &NodeFolder, kind: ServiceKind) -> Result<Service, String> {
    let systemd = &place.systemd;
    match (kind, node.settings()) {
        (ServiceKind::Own, _) => Ok(Service::Own),
        (ServiceKind::Systemd, _) => systemd.ready().map(|()| systemd.service()),
        (ServiceKind::Auto, Some(settings)) => Ok(settings.service),
        (ServiceKind::Auto, None) if Systemd::is_booted() && systemd.ready().is_ok() => Ok(systemd.service()),
        (ServiceKind::Auto, None) => Ok(Service::Own),
    }
}

/// Prepares the service to start the node. Returns whether anything was written.
pub(super) fn install_service(place: &SwarmFolder, node: &NodeFolder, settings: &Settings) -> Result<bool, String> {
    let old = node.settings().map(|settings| settings.service);
    if old.is_some_and(|old| old != settings.service) {
        if is_busy(node) {
            return Err(format!(
                "node {} runs under another service; stop it first with `skein cluster down`",
                node.id
            ));
        }
        remove_service(place, node)?;
    }
    match place.systemd(settings.service) {
        Some(systemd) => systemd.install_service(&place.swarm, node),
        None => Ok(false),
    }
}

/// Removes the node's service.
pub(super) fn remove_service(place: &SwarmFolder, node: &NodeFolder) -> Result<(), String> {
    match node.settings().and_then(|settings| place.systemd(settings.service)) {
        Some(systemd) => systemd.remove_service(&place.swarm, node),
        None => Ok(()),
    }
}

/// Starts the current install in this run of the swarm, and waits until the agent's process exists. A running agent is
/// not affected. Returns whether anything was started.
pub(super) fn start(place: &SwarmFolder, node: &NodeFolder, run: u64, note: Option<RunNote>) -> Result<bool, String> {
    let (Some(installed), Some(settings)) = (linked(&node.file(CURRENT)), node.settings()) else {
        return Err(format!("nothing is installed for node {}", node.id));
    };
    let systemd = place.systemd(settings.service);
    match (node.agent(), systemd) {
        (Some(_), Some(_)) => return Ok(false),
        (Some(_), None) if node.supervisor().is_some() => return Ok(false),
        // Its supervisor has died: a new one takes it over.
        (Some(_), None) => return supervise(node).map(|()| true),
        // A supervisor that waits to restart a failing agent is replaced.
        (None, None) => drop(end(node, None, Duration::ZERO)?),
        (None, Some(_)) => {}
    }
    let to = Path::new("../installs").join(install_name(&installed));
    // The mark would keep the agent on the ground.
    for path in [node.file(AGENT), node.file(ENDED)] {
        files::remove(&path).map_err(at(&path))?;
    }
    files::link(&node.file(ACTIVE), &to)?;
    node.write(STARTED, &Started { installed, run, note, at: Moment::now() })?;
    match systemd {
        Some(systemd) => systemd.start(&place.swarm, node)?,
        None => supervise(node)?,
    }
    if !wait(PROCESS_TIMEOUT, || node.last_agent().is_some()) {
        return Err(format!("the agent of node {} was not started{}", node.id, last_line(node)));
    }
    // An agent reports faults of its files or its port at once, and restarting does not help.
    if wait(EARLY_EXIT, || node.agent().is_none()) {
        stop(place, node, Duration::ZERO)?;
        return Err(format!("the agent of node {} ended at once{}", node.id, last_line(node)));
    }
    Ok(true)
}

/// Asks the agent to land and end. After `within` it is ended wherever the vehicle is.
pub(super) fn stop(place: &SwarmFolder, node: &NodeFolder, within: Duration) -> Result<Ended, String> {
    let systemd = node.settings().and_then(|settings| place.systemd(settings.service));
    end(node, systemd.map(|systemd| (systemd, place)), within)
}

fn end(node: &NodeFolder, systemd: Option<(&Systemd, &SwarmFolder)>, within: Duration) -> Result<Ended, String> {
    let was_busy = is_busy(node);
    let agent = node.agent().map(|agent| agent.process);
    match (systemd, node.supervisor()) {
        // This also stops an agent that is about to be restarted.
        (Some((systemd, place)), _) => systemd.stop(&place.swarm, node)?,
        (None, Some(supervisor)) => supervisor.end(false),
        (None, None) => agent.iter().for_each(|agent| agent.end(false)),
    }
    let is_over = || !is_busy(node);
    let mut by_force = false;
    if !wait(within, is_over) {
        by_force = node.agent().is_some();
        agent.iter().for_each(|agent| agent.end(false));
        if !wait(FORCED_END, is_over) {
            // Kill the supervisor first, because it would restart the agent.
            node.supervisor().iter().for_each(|supervisor| supervisor.end(true));
            node.agent().iter().for_each(|agent| agent.process.end(true));
            if !wait(PROCESS_TIMEOUT, is_over) {
                return Err(format!("the agent of node {} cannot be ended", node.id));
            }
        }
    }
    Ok(Ended { was_busy, by_force })
}

/// Whether an agent is running, or a supervisor that would start one.
fn is_busy(node: &NodeFolder) -> bool {
    node.agent().is_some() || node.supervisor().is_some()
}

/// Starts a supervisor that outlives this process and its session.
fn supervise(node: &NodeFolder) -> Result<(), String> {
    let active = files::target(&node.file(ACTIVE)).map_err(at(&node.file(ACTIVE)))?;
    let program = match os::CAN_BECOME {
        true => node.file(ACTIVE).join(PROGRAM),
        false => files::target(&active.join(PROGRAM)).map_err(at(&active))?,
    };
    let mut command = Command::new(&program);
    command.args(["node", "--supervise"]).arg(node.id.to_string()).current_dir("/");
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    process::outlives_session(&mut command);
    let mut supervisor = command.spawn().map_err(at(&program))?;
    let is_there =
        wait(PROCESS_TIMEOUT, || node.supervisor().is_some() || matches!(supervisor.try_wait(), Ok(Some(_)) | Err(_)));
    match supervisor.try_wait() {
        Ok(Some(status)) => Err(format!("the supervisor of node {} {}", node.id, os::how_it_ended(status))),
        _ if !is_there => Err(format!("the supervisor of node {} did not start", node.id)),
        _ => Ok(()),
    }
}

/// Replaces this process with the node's agent, under the same process id, so that the parent process is the agent's
/// parent.
pub(super) fn become_agent(node: &NodeFolder) -> Result<(), String> {
    if node.file(ENDED).exists() {
        // Its host has started again.
        eprintln!("vehicle {} has landed and its agent has ended: `skein cluster up` starts it again", node.id);
        return Ok(());
    }
    let mut command = agent(node)?;
    note(node, Process::own())?;
    if node.settings().is_some_and(|settings| settings.service == Service::Own)
        && os::is_root()
        && let Err(error) = privileges::give_up()
    {
        eprintln!("the agent keeps root's capabilities: {error}; to avoid it, let another user install the node");
    }
    let error = os::become_program(&mut command);
    Err(format!("{}: {error}", command.get_program().display()))
}

/// The command of the node's agent, in the run that was started last.
pub(super) fn agent(node: &NodeFolder) -> Result<Command, String> {
    let (Some(started), Some(settings)) = (node.started(), node.settings()) else {
        return Err(format!("node {} was not started by a request", node.id));
    };
    // Remove the folders of sockets that an earlier agent has left, as its links name them.
    let is_of_sockets = |path: &PathBuf| files::name(path).is_some_and(|name| name.starts_with("skein-"));
    for path in files::entries(&node.file(RUN)).into_iter().filter(is_of_sockets) {
        files::remove(&path).map_err(at(&path))?;
    }
    let program = std::env::current_exe().map_err(|error| error.to_string())?;
    let mut command = Command::new(&program);
    command.args(["agent", "--config"]).arg(node.install(&started.installed).join("agent.toml"));
    command.arg("--run").arg(started.run.to_string()).arg("--inputs").arg(node.file(RUN));
    if node.last_agent().is_some() {
        // The scenario's events continue from this time.
        command.arg("--flown-s").arg(format!("{:.3}", started.flown_s(&Moment::now())));
    }
    command.env(RELEASE, &started.installed.release).env(INCARNATION_FILE, node.file(RUN).join("life"));
    command.env(MARK, node.file(ENDED));
    // The folder of its sockets, and a backtrace after a panic.
    let given = std::env::var_os(RUNTIME_DIRECTORY);
    command.env(RUNTIME_DIRECTORY, sockets(node, settings.service, given)).env("RUST_BACKTRACE", "1");
    if let Some(log) = &settings.log {
        command.env("RUST_LOG", log);
    }
    Ok(command)
}

/// Notes the process of the node's agent, which was restarted if there was one before it in this run.
pub(super) fn note(node: &NodeFolder, process: Process) -> Result<(), String> {
    let restarts = node.last_agent().map_or(0, |last| last.restarts + 1);
    let agent = AgentProcess { process, restarts };
    if let Some(error) = note_agent(|| node.write(AGENT, &agent), || node.overwrite_agent(&agent))? {
        eprintln!("{error}; the agent starts, and its process is noted over that of the agent before");
    }
    Ok(())
}

/// Runs `skein agent`: flies one vehicle. An agent that has ended successfully writes a mark file, if asked to: a supervisor that
/// has taken it over cannot read its exit status.
pub fn fly(options: &AgentOptions) -> ExitCode {
    let status = skein_agent::run::program(options);
    if let Some(mark) = std::env::var_os(MARK).filter(|_| status == ExitCode::SUCCESS) {
        // If this fails, the agent is restarted.
        let _ = fs::write(mark, "");
    }
    status
}

/// Returns the folder for the agent's sockets: the folder of its service, if it has one.
pub(super) fn sockets(node: &NodeFolder, service: Service, given: Option<OsString>) -> PathBuf {
    let given = given.filter(|_| service != Service::Own);
    given.map_or_else(|| node.file(RUN), PathBuf::from)
}

/// Returns the last line that the agent wrote, as the end of a sentence.
fn last_line(node: &NodeFolder) -> String {
    let mut tail =
        logs::tail(&node.file(LOG), 10).into_iter().map(|line| String::from_utf8_lossy(&line).trim().to_owned());
    let last = tail.rfind(|line| !line.is_empty() && !logs::is_ours(line));
    last.map(|line| format!(": {line}")).unwrap_or_default()
}

/// Waits until the condition is true, at most `within`. Returns whether it became true.
pub(super) fn wait(within: Duration, mut condition: impl FnMut() -> bool) -> bool {
    let until: Option<Instant> = clock::now().checked_add(within);
    loop {
        if condition() {
            return true;
        }
        if until.is_some_and(|until| clock::now() >= until) {
            return false;
        }
        clock::sleep(POLL_PERIOD);
    }
}
