//! The kinds of files that Skein reads: by what each is recognised, and what to do with one in another's place.

use super::keys::KEYS;

/// A kind of file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// What flies.
    Scenario,
    /// Where each vehicle's agent runs.
    Cluster,
    /// A type of helicopter.
    Aircraft,
    /// One agent's own file.
    Agent,
}

impl FileKind {
    /// With its article.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Scenario => "a scenario",
            Self::Cluster => "a cluster file",
            Self::Aircraft => "an aircraft file",
            Self::Agent => "an agent's file",
        }
    }

    /// The kind that a top-level key of a file points to, if only one kind has it.
    pub(super) fn of_key(name: &str, is_table: bool, is_text: bool) -> Option<Self> {
        match name {
            "trim" | "helicopter" => Some(Self::Aircraft),
            "listen" | "dial" => Some(Self::Agent),
            "node" | "defaults" | "files" | "keys" => Some(Self::Cluster),
            // A cluster file has a text there: the swarm's name, the kind of security.
            "swarm" | "security" if is_text => Some(Self::Cluster),
            "swarm" => is_table.then_some(Self::Scenario),
            "security" => is_table.then_some(Self::Agent),
            _ => KEYS.iter().any(|key| key.path.split(['.', '[']).next() == Some(name)).then_some(Self::Scenario),
        }
    }

    /// What to do with a file of this kind, called `file`, where one of the `wanted` kind is needed.
    pub(super) fn remedy(self, wanted: Self, file: &str) -> String {
        let stem = file.rsplit(['/', '\\']).next().unwrap_or(file);
        let stem = stem.strip_suffix(".toml").unwrap_or(stem);
        match (self, wanted) {
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
