//! Kinds of files that Skein reads: how each is recognised, and the advice when a file of another kind is needed.

use super::keys::KEYS;

/// A kind of file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// Scenario: the vehicles, their mission and the flight conditions.
    Scenario,
    /// Cluster file: the hosts on which the agents run.
    Cluster,
    /// Aircraft file: the parameters of a type of helicopter.
    Aircraft,
    /// Configuration file of one agent.
    Agent,
}

impl FileKind {
    /// Name of the kind, with its article.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Scenario => "a scenario",
            Self::Cluster => "a cluster file",
            Self::Aircraft => "an aircraft file",
            Self::Agent => "an agent's file",
        }
    }

    /// The kind of file that has this top-level key, if only one kind has it.
    pub(super) fn of_key(name: &str, is_table: bool, is_text: bool) -> Option<Self> {
        match name {
            "fit" | "trim" | "helicopter" => Some(Self::Aircraft),
            "listen" | "dial" => Some(Self::Agent),
            "node" | "defaults" | "files" | "keys" => Some(Self::Cluster),
            // In a cluster file these are texts: the name of the swarm, the kind of security.
            "swarm" | "security" if is_text => Some(Self::Cluster),
            "swarm" => is_table.then_some(Self::Scenario),
            "security" => is_table.then_some(Self::Agent),
            _ => KEYS.iter().any(|key| key.path.split(['.', '[']).next() == Some(name)).then_some(Self::Scenario),
        }
    }

    /// Advice for a file of this kind, called `file`, where one of the `needed` kind is expected.
    pub(super) fn remedy(self, needed: Self, file: &str) -> String {
        let stem = file.rsplit(['/', '\\']).next().unwrap_or(file);
        let stem = stem.strip_suffix(".toml").unwrap_or(stem);
        match (self, needed) {
            (Self::Aircraft, _) => format!("name it in a scenario: `swarm.aircraft = \"{stem}\"`"),
            (_, Self::Aircraft) => {
                "`swarm.aircraft` and `vehicle.N.aircraft` name aircraft files, which have a table `[trim]`".to_owned()
            }
            (Self::Scenario, Self::Agent) => format!("run `skein agent --scenario {file} --id N`"),
            (Self::Scenario, _) => format!("run `skein fly {file}`, or name it in a cluster file as `scenario`"),
            (Self::Cluster, _) => format!("run `skein cluster up -f {file}`"),
            (Self::Agent, _) => format!("run `skein agent --config {file}`"),
        }
    }
}
