//! One node's folder on its host: what is installed, what was started, and the agent's process. [`place`](super::place)
//! shows its files.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use skein_agent::link::signature::runs::RunNote;
use skein_common::id::VehicleName;
use skein_common::scenario::{Scenario, Source, load_any};
use skein_host::clock;

use super::files::{self, Lock, at};
use super::probe;
use super::process::Process;
use crate::bundle::{AUTHORITY_FILE, SCENARIO, authority_of};
use crate::landing;
use crate::os;
use crate::protocol::{Facts, Installed, RunningAgent, Service};

/// Time within which a new supervisor has written its process into its lock file.
const SUPERVISOR_START: Duration = Duration::from_secs(2);
/// Interval at which the supervisor's lock file is read.
const POLL_PERIOD: Duration = Duration::from_millis(5);
/// Time for which a request waits for the lock of another request.
pub(super) const LOCK_TIMEOUT: Duration = Duration::from_secs(5);

// The files of a node, below its folder, as `place` shows them.
pub(super) const INSTALLS: &str = "installs";
pub(super) const CURRENT: &str = "current";
pub(super) const PREVIOUS: &str = "previous";
pub(super) const SETTINGS: &str = "settings.json";
pub(super) const LOG: &str = "log";
pub(super) const RUN: &str = "run";
pub(super) const ACTIVE: &str = "run/active";
pub(super) const STARTED: &str = "run/started.json";
pub(super) const AGENT: &str = "run/agent.json";
pub(super) const ENDED: &str = "run/ended";
/// The socket on which the agent reports to its supervisor that its control thread runs.
pub(super) const NOTIFY: &str = "run/notify";
pub(super) const SUPERVISOR: &str = "run/supervisor";

/// One node's folder.
#[derive(Clone, Debug)]
pub(super) struct NodeFolder {
    pub(super) path: PathBuf,
    pub(super) id: VehicleName,
}

/// The settings with which a node is started, apart from its configuration.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Settings {
    /// The service that restarts its agent when it has failed.
    pub(super) service: Service,
    /// Log filter in the syntax of `RUST_LOG`.
    pub(super) log: Option<String>,
}

/// The start that was made last. An agent that is restarted after a failure runs with the same.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Started {
    /// The program and configuration.
    pub(super) installed: Installed,
    /// The run of the swarm.
    pub(super) run: u64,
    /// The operator's signed note of that run.
    #[serde(default)]
    pub(super) note: Option<RunNote>,
    /// Time of the start.
    #[serde(flatten)]
    pub(super) at: Moment,
}

impl Started {
    /// Time since then, s.
    pub(super) fn flown_s(&self, now: &Moment) -> f64 {
        let is_same_boot = self.at.boot == now.boot;
        let flown_s = if is_same_boot { now.at_s - self.at.at_s } else { now.utc_s - self.at.utc_s };
        flown_s.max(0.0)
    }
}

/// A time on the clocks of this host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Moment {
    /// On the clock that all processes of this host share and that cannot be set, s. It begins with each boot.
    pub(super) at_s: f64,
    /// UTC, s since 1970.
    #[serde(default)]
    pub(super) utc_s: f64,
    /// Identifies the boot; `None` where the system does not name it.
    #[serde(default)]
    pub(super) boot: Option<String>,
}

impl Moment {
    pub(super) fn now() -> Self {
        Self { at_s: os::uptime_s(), utc_s: clock::utc_nanoseconds() as f64 * 1e-9, boot: os::boot() }
    }
}

/// The agent that was started last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct AgentProcess {
    pub(super) process: Process,
    /// Number of times that it has failed and was restarted.
    pub(super) restarts: u32,
}

impl NodeFolder {
    /// Path of one of the node's files, such as [`CURRENT`].
    pub(super) fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Folder of an install.
    pub(super) fn install(&self, installed: &Installed) -> PathBuf {
        self.file(INSTALLS).join(install_name(installed))
    }

    /// Takes the lock for changes of this node.
    pub(super) fn lock(&self) -> Result<Lock, String> {
        let busy = || format!("another request is changing node {}; try again", self.id);
        Lock::take(&self.lock_path(), LOCK_TIMEOUT)?.ok_or_else(busy)
    }

    pub(super) fn lock_path(&self) -> PathBuf {
        self.file(RUN).join("lock")
    }

    pub(super) fn settings(&self) -> Option<Settings> {
        read(&self.file(SETTINGS))
    }

    pub(super) fn started(&self) -> Option<Started> {
        read(&self.file(STARTED))
    }

    /// The agent that was started last, running or not.
    pub(super) fn last_agent(&self) -> Option<AgentProcess> {
        read(&self.file(AGENT))
    }

    /// Writes one of the node's JSON files: [`SETTINGS`], [`STARTED`] or [`AGENT`].
    pub(super) fn write(&self, name: &str, value: &impl Serialize) -> Result<(), String> {
        files::write(&self.file(name), skein_lab::terminal::json(value).as_bytes(), true)
    }

    /// Writes the agent into the file of the one before. This needs no room on the disk, and a reader may see a mixture.
    pub(super) fn overwrite_agent(&self, agent: &AgentProcess) -> Result<(), String> {
        let (path, text) = (self.file(AGENT), skein_lab::terminal::json(agent));
        let overwrite = || {
            let mut file = File::options().write(true).open(&path)?;
            file.write_all(text.as_bytes())?;
            file.set_len(text.len() as u64)
        };
        overwrite().map_err(at(&path))
    }

    /// The running agent.
    pub(super) fn agent(&self) -> Option<AgentProcess> {
        self.last_agent().filter(|agent| agent.process.is_running())
    }

    /// The supervisor's process, if one is running.
    pub(super) fn supervisor(&self) -> Option<Process> {
        let (path, until) = (self.file(SUPERVISOR), clock::now() + SUPERVISOR_START);
        while Lock::is_held(&path) && clock::now() < until {
            // Until a new supervisor has written its process, the file contains the previous one's.
            if let Some(process) = read(&path).filter(Process::is_running) {
                return Some(process);
            }
            clock::sleep(POLL_PERIOD);
        }
        None
    }

    /// The authority of the running agent, else of what would run at the next start.
    fn authority(&self) -> Option<String> {
        let running = self.agent().and_then(|_| linked(&self.file(ACTIVE)));
        let installed = running.or_else(|| linked(&self.file(CURRENT)))?;
        fs::read(self.install(&installed).join(AUTHORITY_FILE)).ok().map(|certificate| authority_of(&certificate))
    }

    /// Checks that an operator whose files are of this authority may install them.
    ///
    /// # Errors
    /// If the node flies under another authority, or belongs to one and is not taken over on purpose.
    pub(super) fn check_owner(&self, given: Option<&str>, takes_over: bool) -> Result<(), String> {
        let Some(owner) = self.authority().filter(|owner| Some(owner.as_str()) != given) else { return Ok(()) };
        let id = self.id;
        match (self.agent().is_some(), takes_over) {
            (true, _) => Err(format!(
                "node {id} flies under another authority, {owner}; its operator lands it with `skein cluster down` before \
                 another authority can have the node"
            )),
            (false, false) => Err(format!(
                "node {id} belongs to another authority, {owner}; use the keys of that authority, give this swarm another \
                 name or `folder`, or take the node over with `skein cluster install --take-over`"
            )),
            (false, true) => Ok(()),
        }
    }

    /// Returns what is installed and running.
    pub(super) fn facts(&self) -> Facts {
        let started = self.started();
        let note = started.as_ref().and_then(|started| started.note);
        let agent = self.agent().zip(started).map(|(agent, started)| RunningAgent {
            pid: agent.process.pid,
            landing_s: self.landing_s(&started.installed),
            installed: started.installed,
            run: started.run,
            restarts: agent.restarts,
        });
        Facts {
            current: linked(&self.file(CURRENT)),
            previous: linked(&self.file(PREVIOUS)),
            service: self.settings().map(|settings| settings.service),
            agent,
            note,
            authority: self.authority(),
            addresses: probe::addresses(),
            free_bytes: self.path.ancestors().find_map(|path| os::free_bytes(path).ok()).unwrap_or(0),
        }
    }

    /// Time limit for a landing with this install, s; 0 if its scenario cannot be read.
    fn landing_s(&self, installed: &Installed) -> f64 {
        let loaded = self.scenario_of(installed);
        loaded.map_or(0.0, |scenario| landing::limit_of(&scenario).as_secs_f64())
    }

    /// The scenario that the next start flies: that of the vehicle's swarm or team.
    pub(super) fn scenario(&self) -> Result<Scenario, String> {
        let installed =
            linked(&self.file(CURRENT)).ok_or_else(|| format!("nothing is installed for node {}", self.id))?;
        self.scenario_of(&installed).ok_or_else(|| format!("the scenario of node {} cannot be read", self.id))
    }

    fn scenario_of(&self, installed: &Installed) -> Option<Scenario> {
        let text = fs::read_to_string(self.install(installed).join(SCENARIO)).ok()?;
        let described = load_any(&Source { name: SCENARIO, text: &text }, &[]).ok()?;
        described.into_team(self.id.team).map(|loaded| loaded.scenario)
    }
}

/// Name of an install's folder.
pub(super) fn install_name(installed: &Installed) -> String {
    format!("{}_{}", installed.release, installed.bundle)
}

/// Returns what is installed in a folder of this name.
pub(super) fn installed(folder: &Path) -> Option<Installed> {
    let (release, bundle) = files::name(folder).filter(|_| !files::is_draft(folder))?.rsplit_once('_')?;
    Some(Installed { release: release.to_owned(), bundle: bundle.to_owned() })
}

/// Returns the install that a link points to, if it exists.
pub(super) fn linked(link: &Path) -> Option<Installed> {
    let to = files::target(link).ok()?;
    to.is_dir().then(|| installed(&to)).flatten()
}

/// Reads a JSON file; `None` if it does not exist or is incomplete.
fn read<T: DeserializeOwned>(path: &Path) -> Option<T> {
    serde_json::from_slice(&fs::read(path).ok()?).ok()
}

/// Creates folders that only this user can access.
pub(super) fn make_folders(folders: &[PathBuf]) -> Result<(), String> {
    folders.iter().try_for_each(|folder| os::make_private(folder).map_err(at(folder)))
}
