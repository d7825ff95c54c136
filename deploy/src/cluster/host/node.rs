//! One node's folder on its host: what is installed, what was started, which process flies it. [`place`](super::place) draws it.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use skein_agent::link::seal::runs::RunNote;
use skein_common::id::VehicleId;
use skein_common::scenario::{Source, load};
use skein_host::clock;

use super::files::{self, Lock, at};
use super::process::Process;
use crate::cluster::bundle::SCENARIO;
use crate::cluster::protocol::{Facts, Installed, RunningAgent, Service};
use crate::landing;
use crate::os;

/// A supervisor that has begun has said who it is within this time, and between two looks at its word.
const SUPERVISOR_START: Duration = Duration::from_secs(2);
const POLL_PERIOD: Duration = Duration::from_millis(5);
/// How long a request waits for another one to be done.
pub(super) const LOCK_TIMEOUT: Duration = Duration::from_secs(5);

/// One node's folder.
#[derive(Clone, Debug)]
pub(super) struct NodeFolder {
    pub(super) path: PathBuf,
    pub(super) id: VehicleId,
}

/// How a node is started; beside its configuration.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Settings {
    /// Who starts it again when it has died.
    pub(super) service: Service,
    /// As `RUST_LOG` takes it.
    pub(super) log: Option<String>,
}

/// What was started last. Agents that take the place of one that has died are the same in all of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Started {
    pub(super) installed: Installed,
    pub(super) run: u64,
    /// The operator's note of that run.
    #[serde(default)]
    pub(super) note: Option<RunNote>,
    /// When, on the clock that every process of this host reads, s.
    pub(super) at_s: f64,
}

/// The agent that was started last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct AgentProcess {
    pub(super) process: Process,
    /// How often it has died and was started again.
    pub(super) restarts: u32,
}

impl NodeFolder {
    pub(super) fn installs(&self) -> PathBuf {
        self.path.join("installs")
    }

    pub(super) fn install(&self, installed: &Installed) -> PathBuf {
        self.installs().join(install_name(installed))
    }

    pub(super) fn current(&self) -> PathBuf {
        self.path.join("current")
    }

    pub(super) fn previous(&self) -> PathBuf {
        self.path.join("previous")
    }

    pub(super) fn run(&self) -> PathBuf {
        self.path.join("run")
    }

    pub(super) fn active(&self) -> PathBuf {
        self.run().join("active")
    }

    pub(super) fn log(&self) -> PathBuf {
        self.path.join("log")
    }

    fn settings_path(&self) -> PathBuf {
        self.path.join("settings.json")
    }

    fn started_path(&self) -> PathBuf {
        self.run().join("started.json")
    }

    pub(super) fn agent_path(&self) -> PathBuf {
        self.run().join("agent.json")
    }

    pub(super) fn ended_path(&self) -> PathBuf {
        self.run().join("ended")
    }

    pub(super) fn supervisor_path(&self) -> PathBuf {
        self.run().join("supervisor")
    }

    /// Held by a request that changes something of this node.
    pub(super) fn lock(&self) -> Result<Lock, String> {
        let busy = || format!("another request is at work on node {}", self.id);
        Lock::take(&self.run().join("lock"), LOCK_TIMEOUT)?.ok_or_else(busy)
    }

    pub(super) fn settings(&self) -> Option<Settings> {
        read(&self.settings_path())
    }

    pub(super) fn set_settings(&self, settings: &Settings) -> Result<(), String> {
        write(&self.settings_path(), settings)
    }

    pub(super) fn started(&self) -> Option<Started> {
        read(&self.started_path())
    }

    pub(super) fn set_started(&self, started: &Started) -> Result<(), String> {
        write(&self.started_path(), started)
    }

    /// The agent that was started last, whether it runs or not.
    pub(super) fn last_agent(&self) -> Option<AgentProcess> {
        read(&self.agent_path())
    }

    pub(super) fn set_agent(&self, agent: &AgentProcess) -> Result<(), String> {
        write(&self.agent_path(), agent)
    }

    /// The agent that runs.
    pub(super) fn agent(&self) -> Option<AgentProcess> {
        self.last_agent().filter(|agent| agent.process.is_running())
    }

    /// The supervisor's process, if there is one.
    pub(super) fn supervisor(&self) -> Option<Process> {
        let (path, until) = (self.supervisor_path(), clock::now() + SUPERVISOR_START);
        while Lock::is_held(&path) && clock::now() < until {
            // Until it has said who it is, the word of the one before it stands there.
            if let Some(process) = read(&path).filter(Process::is_running) {
                return Some(process);
            }
            clock::sleep(POLL_PERIOD);
        }
        None
    }

    /// What is there.
    pub(super) fn facts(&self) -> Facts {
        let started = self.started();
        let note = started.as_ref().and_then(|started| started.note);
        let agent = self.agent().zip(started).map(|(agent, started)| RunningAgent {
            pid: agent.process.pid,
            landing_s: landing_s(&self.install(&started.installed)),
            installed: started.installed,
            run: started.run,
            restarts: agent.restarts,
        });
        Facts {
            current: linked(&self.current()),
            previous: linked(&self.previous()),
            service: self.settings().map(|settings| settings.service),
            agent,
            note,
            free_bytes: self.path.ancestors().find_map(|path| os::free_bytes(path).ok()).unwrap_or(0),
        }
    }
}

/// How long a landing may take of whoever flies what is installed here, s; 0 if it cannot be read.
fn landing_s(install: &Path) -> f64 {
    let text = fs::read_to_string(install.join(SCENARIO)).ok();
    let loaded = text.and_then(|text| load(&Source { name: SCENARIO, text: &text }, &[]).ok());
    loaded.map_or(0.0, |loaded| landing::limit_of(&loaded.scenario).as_secs_f64())
}

/// The name of an install's folder.
pub(super) fn install_name(installed: &Installed) -> String {
    format!("{}_{}", installed.release, installed.bundle)
}

/// What a folder of this name has installed.
pub(super) fn installed(folder: &Path) -> Option<Installed> {
    let (release, bundle) = files::name(folder).filter(|_| !files::is_draft(folder))?.rsplit_once('_')?;
    Some(Installed { release: release.to_owned(), bundle: bundle.to_owned() })
}

/// What a link leads to, if that is there.
pub(super) fn linked(link: &Path) -> Option<Installed> {
    let to = fs::read_link(link).ok()?;
    link.is_dir().then(|| installed(&to)).flatten()
}

/// A file of ours; none if it is not there, or not whole.
fn read<T: DeserializeOwned>(path: &Path) -> Option<T> {
    serde_json::from_slice(&fs::read(path).ok()?).ok()
}

fn write(path: &Path, value: &impl Serialize) -> Result<(), String> {
    files::write(path, skein_lab::terminal::json(value).as_bytes(), true)
}

/// Makes folders for nobody but this user.
pub(super) fn make_folders(folders: &[PathBuf]) -> Result<(), String> {
    folders.iter().try_for_each(|folder| os::make_private(folder).map_err(at(folder)))
}
