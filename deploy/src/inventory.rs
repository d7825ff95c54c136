//! The cluster's file: who is where. It never says what flies; the scenario does.

mod read;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use skein_common::id::{SwarmName, VehicleId};
use skein_common::scenario::{Loaded, PlantKind};

use crate::landing;

/// A cluster's file and its scenario, both read and checked.
#[derive(Clone, Debug)]
pub struct Inventory {
    /// The file itself.
    pub path: PathBuf,
    /// Namespace of all traffic, name of the services.
    pub swarm: SwarmName,
    /// The scenario's file, relative to nothing.
    pub scenario_path: PathBuf,
    /// What flies, under this swarm's name.
    pub scenario: Loaded,
    /// The scenario's file as it was read.
    pub scenario_text: String,
    /// How links are secured.
    pub security: SecurityKind,
    /// Files and folders outside the scenario's folder that may be copied to the nodes, relative to nothing.
    pub files: Vec<PathBuf>,
    /// The folder of keys, relative to nothing.
    pub keys: PathBuf,
    /// Every vehicle's node.
    pub nodes: BTreeMap<VehicleId, Node>,
}

impl Inventory {
    /// Every agent's endpoint in Zenoh's notation.
    pub fn endpoints(&self) -> BTreeMap<VehicleId, String> {
        self.nodes.iter().map(|(id, node)| (*id, node.endpoint(self.security))).collect()
    }

    /// Whom this agent dials: of each pair the one with the higher id dials the other.
    pub fn dialled_by(&self, id: VehicleId) -> Vec<String> {
        self.nodes.range(..id).map(|(_, node)| node.endpoint(self.security)).collect()
    }

    /// Whoever flies the scenario has landed within this time, s.
    pub fn landing_s(&self) -> f64 {
        landing::limit_of(&self.scenario.scenario).as_secs_f64()
    }

    /// The folder that the scenario's paths start from.
    pub fn scenario_folder(&self) -> &Path {
        self.scenario_path.parent().unwrap_or(Path::new(""))
    }
}

/// How links are secured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SecurityKind {
    /// Mutual TLS, signed orders.
    #[default]
    Tls,
    /// Plain TCP: only when asked for by name.
    None,
}

/// One agent.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// Its vehicle.
    pub id: VehicleId,
    /// Where it runs: what `ssh` takes. `None` only if it is installed by hand.
    pub host: Option<String>,
    /// Who logs in there; `None`: as ssh's own configuration says.
    pub user: Option<String>,
    /// Where peers reach it: an IP address or a name; its certificate carries it.
    pub address: String,
    /// Its TCP port, 7446 + id.
    pub port: u16,
    /// What it flies.
    pub plant: PlantKind,
    /// `HOST[:PORT]` of its simulator as seen from its host.
    pub xplane: Option<String>,
    /// How it is installed.
    pub install: Install,
    /// The program for its platform, if not the one that runs here; relative to nothing.
    pub binary: Option<PathBuf>,
    /// Folder on its host for everything of Skein, below the home folder unless absolute. `.skein`.
    pub folder: String,
    /// Who starts it again when it has died.
    pub service: ServiceKind,
    /// What its agent logs, as `RUST_LOG` takes it.
    pub log: Option<String>,
}

/// How a node is installed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Install {
    /// Over ssh.
    #[default]
    Ssh,
    /// `install` writes a folder to carry there.
    Manual,
}

/// Who starts an agent again when it has died.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ServiceKind {
    /// systemd where it runs, else our own supervisor.
    #[default]
    Auto,
    /// systemd.
    Systemd,
    /// Our own supervisor.
    Own,
}

impl Node {
    /// Its endpoint, `tls/10.0.0.11:7447` or `tcp/...`.
    pub fn endpoint(&self, security: SecurityKind) -> String {
        let scheme = match security {
            SecurityKind::Tls => "tls",
            SecurityKind::None => "tcp",
        };
        let address = &self.address;
        // An IPv6 address stands in brackets.
        match address.contains(':') {
            true => format!("{scheme}/[{address}]:{}", self.port),
            false => format!("{scheme}/{address}:{}", self.port),
        }
    }
}

#[cfg(test)]
pub(super) mod tests;
