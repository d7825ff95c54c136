//! The paths of all files on a node's host:
//!
//! ```text
//! <folder>/<swarm>/releases/<release>/skein                  the program, shared by the agents of this host
//!                  node-<id>/installs/<release>_<bundle>/    one node's configuration; `skein` in it links to the program;
//!                                                            of vehicle 3/7 of a fleet node-3-7
//!                            current, previous               links to installs
//!                            settings.json                   the service that restarts it, its log filter
//!                            log/agent.log, .1, ...          the agent's log, under Skein's own supervisor
//!                            run/active                      link to the install that was started last
//!                                started.json, agent.json    the run; the agent's process
//!                                ended                       written by an agent that has ended successfully
//!                                skein-*                     the agent's sockets, if its service has no folder for them
//!                                lock, supervisor            locks of a request and of the supervisor
//!                  left/                                     on Windows: what a removal has open, until it has ended
//! ```

use std::fs;
use std::path::{Path, PathBuf};

use skein_common::id::{SwarmName, VehicleName};

use super::files::{self, Lock};
use super::node::{LOCK_TIMEOUT, NodeFolder};
use super::systemd::Systemd;
use crate::os;
use crate::protocol::Service;

/// Name of the program file in a release, and of the link to it in an install.
pub(super) const PROGRAM: &str = if cfg!(windows) { "skein.exe" } else { "skein" };

/// Name of the file in the swarm's folder that passes its arguments to the program of the newest install, on Windows: elsewhere a
/// script of the operator's PC finds it.
pub(crate) const LAUNCHER: &str = "skein.cmd";

/// Name of the folder in the swarm's folder with the files of a removed node that a process of its removal has open, on Windows. The
/// operator's PC deletes them when that process has ended.
pub(crate) const LEFT: &str = "left";

/// One swarm's folder on this host, and the release of the program that answers.
#[derive(Clone, Debug)]
pub(super) struct SwarmFolder {
    /// `<folder>/<swarm>`
    pub(super) folder: PathBuf,
    /// Name of the swarm: the last component of the folder.
    pub(super) swarm: SwarmName,
    /// Release of the program that answers.
    pub(super) release: String,
    /// The systemd instance of this host.
    pub(super) systemd: Systemd,
}

impl SwarmFolder {
    /// Finds the swarm's folder from the path of this program.
    pub(super) fn of_this_program() -> Result<Self, String> {
        let program = std::env::current_exe().and_then(fs::canonicalize);
        let program = program.map_err(|error| format!("the path of this program is unknown: {error}"))?;
        Self::of(&program).ok_or_else(|| {
            let is = program.display();
            format!("{is} is not installed: it has to be <folder>/<swarm>/releases/<release>/{PROGRAM}")
        })
    }

    pub(super) fn of(program: &Path) -> Option<Self> {
        let release = program.parent()?;
        let releases = release.parent().filter(|folder| folder.ends_with("releases"))?;
        let folder = releases.parent()?;
        let swarm = SwarmName::new(files::name(folder)?).ok()?;
        Some(Self {
            folder: folder.to_owned(),
            swarm,
            release: files::name(release)?.to_owned(),
            systemd: Systemd::here(),
        })
    }

    /// Returns systemd, unless the service is Skein's own supervisor.
    pub(super) fn systemd(&self, service: Service) -> Option<&Systemd> {
        (service != Service::Own).then_some(&self.systemd)
    }

    /// Returns the folder of one node.
    pub(super) fn node(&self, id: VehicleName) -> NodeFolder {
        NodeFolder { path: self.folder.join(format!("node-{}", id.dashed())), id }
    }

    pub(super) fn releases(&self) -> PathBuf {
        self.folder.join("releases")
    }

    /// Takes the lock for changes of files that the nodes of this host share.
    pub(super) fn lock(&self) -> Result<Lock, String> {
        let busy = || "another request is changing the shared files of this host; try again".to_owned();
        Lock::take(&self.lock_path(), LOCK_TIMEOUT)?.ok_or_else(busy)
    }

    pub(super) fn lock_path(&self) -> PathBuf {
        self.folder.join("lock")
    }

    /// Moves a file that this process has open out of a folder that is to go, where open files cannot be deleted.
    pub(super) fn set_aside(&self, path: &Path) -> Result<(), String> {
        if os::DELETES_OPEN_FILES || !path.exists() {
            return Ok(());
        }
        let left = self.folder.join(LEFT);
        let parent = path.parent().and_then(files::name).unwrap_or_default();
        let name = format!("{}-{parent}-{}", std::process::id(), files::name(path).unwrap_or_default());
        fs::create_dir_all(&left).and_then(|()| fs::rename(path, left.join(name))).map_err(files::at(path))
    }
}

#[cfg(test)]
mod tests {
    use crate::host::node::installed;
    use crate::protocol::Installed;

    use super::*;

    #[test]
    fn a_program_finds_the_swarms_folder_from_its_own_path() {
        let place = SwarmFolder::of(Path::new("/home/lab/.skein/lab/releases/0.1.0-1f2e3d4c5b6a/skein")).unwrap();
        assert_eq!(place.folder, Path::new("/home/lab/.skein/lab"));
        assert_eq!((place.swarm.as_str(), place.release.as_str()), ("lab", "0.1.0-1f2e3d4c5b6a"));
        let node = place.node("3".parse().unwrap());
        let of = Installed { release: place.release.clone(), bundle: "00ff".to_owned() };
        assert_eq!(node.install(&of), place.folder.join("node-3/installs/0.1.0-1f2e3d4c5b6a_00ff"));
        assert_eq!(installed(&node.install(&of)), Some(of));
        assert_eq!(place.node("3/7".parse().unwrap()).path, place.folder.join("node-3-7"));
        for elsewhere in ["/usr/bin/skein", "/skein", "/home/a b/releases/x/skein", "/lab/release/x/skein"] {
            assert!(SwarmFolder::of(Path::new(elsewhere)).is_none(), "{elsewhere}");
        }
        assert_eq!(installed(Path::new("installs/0.1.0-1f2e3d4c5b6a_00ff.draft")), None);
    }
}
