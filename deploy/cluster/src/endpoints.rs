//! Finds a live swarm on this PC, through the small file that `fly` writes into the user's runtime folder.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{self, Read};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use skein_common::id::{SwarmName, VehicleName};
use skein_common::topic::Branch;
use skein_host::atomic_file::{self, Durability};

use crate::os;
use skein_lab::error::Error;

/// Time limit for an agent on this PC to accept a connection.
const ANSWER: Duration = Duration::from_millis(200);

/// Size limit of an endpoints file, bytes.
const MAX_FILE: u64 = 1 << 20;

/// The endpoints of a swarm's agents.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Endpoints {
    /// The swarm's name.
    pub swarm: SwarmName,
    /// Id of the process that started it.
    pub pid: u32,
    /// The folder of the run's files.
    pub out: PathBuf,
    /// Every agent's endpoint in Zenoh's notation, `tcp/127.0.0.1:7447`.
    pub agents: BTreeMap<VehicleName, String>,
}

/// An endpoints file. Dropping this value deletes the file.
#[derive(Debug)]
pub struct EndpointsFile(PathBuf);

impl EndpointsFile {
    /// Keeps the file, because the swarm outlives this process.
    pub fn stay(self) {
        std::mem::forget(self);
    }
}

impl Drop for EndpointsFile {
    fn drop(&mut self) {
        // A file left behind does no harm: its reader finds that no agent answers.
        let _ = fs::remove_file(&self.0);
    }
}

impl Endpoints {
    /// Writes the file into `folder`, atomically: a reader sees all of it or nothing.
    ///
    /// # Errors
    /// If the folder or the file cannot be written, or the folder belongs to another user.
    pub fn leave(&self, folder: &Path) -> io::Result<EndpointsFile> {
        os::private_folder(folder)?;
        let path = path(folder, &self.swarm);
        atomic_file::write(&path, skein_lab::terminal::json(self).as_bytes(), Durability::Secret)?;
        Ok(EndpointsFile(path))
    }

    /// The swarm's branch, or those of the teams of a fleet, in order.
    pub fn branches(&self) -> Vec<Branch> {
        let teams: BTreeSet<Branch> = self.agents.keys().map(|name| Branch::of(name.team)).collect();
        teams.into_iter().collect()
    }

    /// The folder of the files of the swarm or team with this branch.
    pub fn folder(&self, branch: Branch) -> PathBuf {
        branch.team().map_or_else(|| self.out.clone(), |team| self.out.join(format!("team-{team}")))
    }

    /// Whether at least one agent accepts a connection.
    pub fn any_agent_answers(&self) -> bool {
        let addresses = self.agents.values().filter_map(|agent| agent.strip_prefix("tcp/")?.parse::<SocketAddr>().ok());
        addresses.into_iter().any(|address| TcpStream::connect_timeout(&address, ANSWER).is_ok())
    }
}

/// Path of the endpoints file of this swarm.
pub fn path(folder: &Path, swarm: &SwarmName) -> PathBuf {
    folder.join(format!("{swarm}.json"))
}

/// The user's folder for endpoints files: `$XDG_RUNTIME_DIR/skein`, else a folder in the system's temporary folder.
pub fn folder() -> PathBuf {
    match std::env::var_os("XDG_RUNTIME_DIR").filter(|folder| !folder.is_empty()) {
        Some(folder) => PathBuf::from(folder).join("skein"),
        None => std::env::temp_dir().join(format!("skein-{}", os::user_name())),
    }
}

/// Reads the endpoints file of this swarm, if it exists.
///
/// # Errors
/// If the file is not an endpoints file, or another user owns or can write the file or its folder: such a file could
/// send orders anywhere.
pub fn read(folder: &Path, swarm: &SwarmName) -> Result<Option<Endpoints>, Error> {
    let path = path(folder, swarm);
    let opened = os::check_own_folder(folder).and_then(|()| os::open_own(&path));
    match opened.and_then(|file| io::read_to_string(file.take(MAX_FILE))) {
        Ok(text) => serde_json::from_str(&text)
            .map(Some)
            .map_err(|error| Error::Refused(format!("{}: not a file of endpoints: {error}", path.display()))),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) if error.kind() == io::ErrorKind::PermissionDenied => Err(Error::Refused(error.to_string())),
        Err(error) => Err(Error::Refused(format!("{}: {error}", path.display()))),
    }
}

/// Finds the swarm of this name, or without a name the only swarm on this PC.
///
/// # Errors
/// If this swarm does not fly here, or several do and no name is given, or another user can write the file.
pub fn find(folder: &Path, swarm: Option<&SwarmName>) -> Result<Endpoints, Error> {
    match os::check_own_folder(folder) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(Error::Refused(error.to_string())),
        _ => {}
    }
    let mut names = match swarm {
        Some(name) => vec![name.clone()],
        None => names(folder),
    };
    if names.len() > 1 {
        names.retain(|name| flies(folder, name));
    }
    let title = swarm.map_or_else(|| "swarm".to_owned(), |name| format!("swarm named {name}"));
    let no_swarm = || {
        Error::Failed(format!(
            "no {title} flies here (looked in {}); {}`skein fly` starts one, and -f CLUSTER.toml names a cluster",
            folder.display(),
            swarm.and_then(|swarm| others(folder, swarm)).map_or_else(String::new, |others| format!("{others}; "))
        ))
    };
    match names.as_slice() {
        [] => Err(no_swarm()),
        [name] => read(folder, name)?.ok_or_else(no_swarm),
        several => {
            let list = several.iter().map(SwarmName::as_str).collect::<Vec<_>>().join(", ");
            Err(Error::Refused(format!("several swarms fly here: {list}; choose one with --swarm NAME")))
        }
    }
}

/// Names of the swarms of which at least one agent accepts a connection, sorted.
pub fn flying(folder: &Path) -> Vec<SwarmName> {
    let mut names = names(folder);
    names.retain(|name| flies(folder, name));
    names
}

/// The swarms that fly here besides this one, as a sentence for the operator who asked for it; `None` if no other flies.
pub fn others(folder: &Path, swarm: &SwarmName) -> Option<String> {
    let mut names = flying(folder);
    names.retain(|name| name != swarm);
    let list = names.iter().map(SwarmName::as_str).collect::<Vec<_>>().join(", ");
    match names.as_slice() {
        [] => None,
        [only] => Some(format!("swarm {only} flies here: --swarm {only} names it")),
        _ => Some(format!("swarms that fly here: {list}; --swarm NAME names one")),
    }
}

/// Whether an agent of this swarm accepts a connection: an ended swarm can leave its file behind.
fn flies(folder: &Path, name: &SwarmName) -> bool {
    read(folder, name).is_ok_and(|there| there.is_some_and(|there| there.any_agent_answers()))
}

/// Names of the swarms that have an endpoints file, sorted.
fn names(folder: &Path) -> Vec<SwarmName> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let name = |entry: fs::DirEntry| SwarmName::new(entry.file_name().to_str()?.strip_suffix(".json")?).ok();
    let mut names: Vec<_> = entries.filter_map(name).collect();
    names.sort_unstable_by(|one, other| one.as_str().cmp(other.as_str()));
    names
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use skein_common::id::VehicleId;

    use super::*;
    use crate::tests::{LEFT_ALONE, close};

    fn endpoints(name: &str, agent: &str) -> Endpoints {
        Endpoints {
            swarm: SwarmName::new(name).unwrap(),
            pid: 7,
            out: PathBuf::from("runs/x"),
            agents: BTreeMap::from([(VehicleId::new(1).unwrap().into(), agent.to_owned())]),
        }
    }

    #[test]
    fn the_file_reads_back_and_is_deleted_with_its_owner() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("skein");
        let left = endpoints("lab", "tcp/127.0.0.1:7447");
        let file = left.leave(&folder).unwrap();
        assert_eq!(find(&folder, None).unwrap(), left);
        assert_eq!(find(&folder, Some(&left.swarm)).unwrap(), left);
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1, "no draft is left");
        drop(file);
        let error = find(&folder, Some(&left.swarm)).unwrap_err();
        assert!(error.to_string().starts_with("no swarm named lab flies here"), "{error}");
        assert_eq!(error.exit_code(), 1, "as on a cluster of which no vehicle answers");
    }

    #[cfg(unix)]
    #[test]
    fn a_file_that_another_user_can_write_is_not_trusted() {
        use std::os::unix::fs::{chown, symlink};

        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("skein");
        let left = endpoints("lab", "tcp/127.0.0.1:7447");
        let _file = left.leave(&folder).unwrap();
        let path = path(&folder, &left.swarm);
        assert!(os::has_mode(&path, 0o600));
        let refused = |why: &str| {
            for swarm in [None, Some(&left.swarm)] {
                let error = find(&folder, swarm).unwrap_err();
                assert!(error.to_string().contains(why) && error.to_string().contains("it is not trusted"), "{error}");
                assert_eq!(error.exit_code(), 2);
            }
        };
        for (mode, why) in [(0o666, "mode 666"), (0o620, "mode 620")] {
            os::set_mode(&path, mode).unwrap();
            refused(why);
        }
        os::set_mode(&path, 0o600).unwrap();
        for (mode, why) in [(0o777, "mode 777"), (0o770, "mode 770")] {
            os::set_mode(&folder, mode).unwrap();
            refused(why);
            assert!(left.leave(&folder).is_err(), "nothing is left in it either");
        }
        os::set_mode(&folder, 0o700).unwrap();
        if os::is_root() {
            chown(&path, Some(65534), None).unwrap();
            refused("belongs to user 65534");
            chown(&path, Some(0), None).unwrap();
            chown(&folder, Some(65534), None).unwrap();
            refused("belongs to user 65534");
            chown(&folder, Some(0), None).unwrap();
        }
        assert_eq!(find(&folder, None).unwrap(), left);
        let elsewhere = place.path().join("lab.json");
        fs::rename(&path, &elsewhere).unwrap();
        symlink(&elsewhere, &path).unwrap();
        refused("is a link");
        fs::remove_file(&path).unwrap();
        fs::rename(&elsewhere, &path).unwrap();
        let moved = place.path().join("moved");
        fs::rename(&folder, &moved).unwrap();
        symlink(&moved, &folder).unwrap();
        refused("is not a folder");
    }

    #[test]
    fn of_two_swarms_one_has_to_be_named() {
        let folder = tempfile::tempdir().unwrap();
        os::set_mode(folder.path(), 0o700).unwrap();
        let agents = [(); 2].map(|()| TcpListener::bind(LEFT_ALONE).unwrap());
        let [b, a] = agents.each_ref().map(|agent| format!("tcp/{}", agent.local_addr().unwrap()));
        let _b = endpoints("b", &b).leave(folder.path()).unwrap();
        let _a = endpoints("a", &a).leave(folder.path()).unwrap();
        let _gone = endpoints("gone", "tcp/127.0.0.1:1").leave(folder.path()).unwrap();
        let error = find(folder.path(), None).unwrap_err().to_string();
        assert_eq!(error, "several swarms fly here: a, b; choose one with --swarm NAME");
        assert_eq!(find(folder.path(), Some(&SwarmName::new("b").unwrap())).unwrap().swarm.as_str(), "b");
        let missing = find(folder.path(), Some(&SwarmName::new("gon").unwrap())).unwrap_err().to_string();
        assert!(
            missing.contains("; swarms that fly here: a, b; --swarm NAME names one; `skein fly` starts one"),
            "{missing}"
        );
        fs::write(folder.path().join("c.json"), "{}").unwrap();
        assert!(find(folder.path(), Some(&SwarmName::new("c").unwrap())).is_err());
        let [_, last] = agents;
        close(last);
        let missing = find(folder.path(), Some(&SwarmName::new("gon").unwrap())).unwrap_err().to_string();
        assert!(missing.contains("; swarm b flies here: --swarm b names it; `skein fly`"), "{missing}");
        assert_eq!(others(folder.path(), &SwarmName::new("b").unwrap()), None);
        assert_eq!(find(folder.path(), None).unwrap().swarm.as_str(), "b", "the only one that answers");
    }

    #[test]
    fn an_agent_that_listens_is_found() {
        let listener = TcpListener::bind(LEFT_ALONE).unwrap();
        let there = endpoints("a", &format!("tcp/{}", listener.local_addr().unwrap()));
        assert!(there.any_agent_answers());
        close(listener);
        assert!(!there.any_agent_answers());
    }
}
