//! The cluster file: which vehicle's agent runs on which host. The scenario, not the cluster file, determines what
//! flies.

pub mod find;
mod read;
mod reserved;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use skein_agent::config::fleet;
use skein_common::id::{SwarmName, VehicleName};
use skein_common::scenario::{Described, PlantKind};

use crate::landing;
use crate::ports::HostPort;
use skein_lab::error::Error;

/// A cluster file and its scenario, both read and checked.
#[derive(Clone, Debug)]
pub struct Inventory {
    /// Path of the cluster file.
    pub path: PathBuf,
    /// Name of the swarm or fleet: the namespace of all its traffic and part of the services' names.
    pub swarm: SwarmName,
    /// Absolute path of the scenario file.
    pub scenario_path: PathBuf,
    /// The scenario, with the name of this swarm.
    pub scenario: Described,
    /// Text of the scenario file.
    pub scenario_text: String,
    /// The security of the links.
    pub security: SecurityKind,
    /// Absolute paths of files and folders outside the scenario's folder that may be copied to the nodes.
    pub files: Vec<PathBuf>,
    /// Absolute path of the folder of keys.
    pub keys: PathBuf,
    /// The node of each vehicle.
    pub nodes: BTreeMap<VehicleName, Node>,
}

impl Inventory {
    /// Endpoints that this agent dials: one of each pair of linked agents dials the other.
    pub fn dialled_by(&self, id: VehicleName) -> Vec<String> {
        let dialled = fleet::dialled(id, self.scenario.all()).filter_map(|id| self.nodes.get(&id));
        dialled.map(|node| node.endpoint(self.security)).collect()
    }

    /// Checks that no host, address or simulator is one that is reserved for documentation, as in the example file. Every
    /// command does so before it connects to a host of the cluster.
    ///
    /// # Errors
    /// If one is: the node and the name.
    pub fn check_hosts(&self) -> Result<(), Error> {
        for node in self.nodes.values() {
            let simulator = node.xplane.as_ref().and_then(|text| text.parse::<HostPort>().ok()).map(|at| at.host);
            let names = [node.host.as_ref(), Some(&node.address), simulator.as_ref()];
            if let Some(name) = names.into_iter().flatten().find(|name| reserved::is_for_documentation(name)) {
                return Err(Error::Refused(format!(
                    "{}: node {} has {name}, which is reserved for documentation: no host is called; put your hosts in",
                    self.path.display(),
                    node.id
                )));
            }
        }
        Ok(())
    }

    /// Time limit for the landing of any vehicle that flies the scenario, s.
    pub fn landing_s(&self) -> f64 {
        let limits = self.scenario.all().iter().map(|loaded| landing::limit_of(&loaded.scenario).as_secs_f64());
        limits.fold(0.0, f64::max)
    }

    /// The folder that relative paths in the scenario start from.
    pub fn scenario_folder(&self) -> &Path {
        self.scenario_path.parent().unwrap_or(Path::new(""))
    }
}

/// The security of a cluster's links.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SecurityKind {
    /// Mutual TLS and signed messages.
    #[default]
    Tls,
    /// Plain TCP without signatures: only if the cluster file asks for it.
    None,
}

/// A node: one vehicle's agent and its host.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// Its vehicle: the id, in a fleet with the team.
    pub id: VehicleName,
    /// Its host, as given to `ssh`. `None` only if it is installed by hand.
    pub host: Option<String>,
    /// User who logs in there; `None`: according to ssh's own configuration.
    pub user: Option<String>,
    /// The system of its host.
    pub system: System,
    /// Address at which peers reach it: an IP address or a name. It is part of the node's certificate.
    pub address: String,
    /// TCP port of the agent: 7446 + id, in a fleet 7446 + number of the vehicle among those of all teams.
    pub port: u16,
    /// The kind of plant that it flies.
    pub plant: PlantKind,
    /// `HOST[:PORT]` of its simulator as seen from its host.
    pub xplane: Option<String>,
    /// The method of its installation.
    pub install: Install,
    /// Absolute path of the program for its platform, if it is not the program that runs here.
    pub binary: Option<PathBuf>,
    /// Folder for all files of Skein on its host, below the home folder unless absolute. Default `.skein`.
    pub folder: String,
    /// Service that restarts the agent when it has failed.
    pub service: ServiceKind,
    /// Log filter of its agent, in the syntax of `RUST_LOG`.
    pub log: Option<String>,
}

/// The kind of operating system of a host, which decides what its login shell understands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum System {
    /// With a POSIX shell besides the login shell: Linux, macOS.
    #[default]
    Unix,
    /// Windows, with the login shell cmd.exe or PowerShell.
    Windows,
}

/// The method of a node's installation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Install {
    /// By this program, over ssh.
    #[default]
    Ssh,
    /// By hand: `install` writes a folder to carry to the host.
    Manual,
}

/// The service that restarts an agent when it has failed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ServiceKind {
    /// systemd where it is available, else Skein's own supervisor.
    #[default]
    Auto,
    /// Always systemd.
    Systemd,
    /// Always Skein's own supervisor.
    Own,
}

impl Node {
    /// Returns its endpoint, `tls/10.0.0.11:7447` or `tcp/...`.
    pub fn endpoint(&self, security: SecurityKind) -> String {
        let scheme = match security {
            SecurityKind::Tls => "tls",
            SecurityKind::None => "tcp",
        };
        format!("{scheme}/{}", self.host_port())
    }

    /// Returns `HOST:PORT` of its agent; an IPv6 address is in brackets.
    pub fn host_port(&self) -> String {
        match self.address.contains(':') {
            true => format!("[{}]:{}", self.address, self.port),
            false => format!("{}:{}", self.address, self.port),
        }
    }
}

#[cfg(test)]
pub(super) mod tests;
