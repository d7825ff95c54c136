//! Finds the cluster file of a command: the one that `-f` names, else the one that the environment variable
//! `SKEIN_CLUSTER` names, else `cluster.toml` of the current folder.

use std::env;
use std::fmt;
use std::path::{Path, PathBuf};

/// The environment variable that names the cluster file of commands without `-f`.
pub const VARIABLE: &str = "SKEIN_CLUSTER";
/// The cluster file of a folder.
const IN_FOLDER: &str = "cluster.toml";

/// A cluster file that no option names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unnamed {
    /// Its path.
    pub path: PathBuf,
    /// Whether the environment variable names it; otherwise it lies in the current folder.
    pub by_variable: bool,
}

impl fmt::Display for Unnamed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.by_variable {
            true => write!(f, "the cluster of {} (named by {VARIABLE})", self.path.display()),
            false => write!(f, "the cluster of {} in this folder", self.path.display()),
        }
    }
}

/// The cluster file of a command without `-f`; `None` if the variable is not set and the current folder has none.
pub fn unnamed() -> Option<Unnamed> {
    let named = env::var_os(VARIABLE).filter(|path| !path.is_empty());
    let there = || Path::new(IN_FOLDER).exists().then(|| Unnamed { path: IN_FOLDER.into(), by_variable: false });
    named.map(|path| Unnamed { path: path.into(), by_variable: true }).or_else(there)
}

/// The cluster file of a command that always concerns a cluster. A file that the variable names is announced on stderr,
/// because nothing on the command line shows which cluster it is.
pub fn of_option(option: Option<&Path>) -> PathBuf {
    match (option, unnamed()) {
        (Some(path), _) => path.to_owned(),
        (None, Some(found)) => {
            if found.by_variable {
                skein_lab::terminal::complain(&found.to_string());
            }
            found.path
        }
        (None, None) => IN_FOLDER.into(),
    }
}
