//! Network namespaces of a test and the links between them, made with `ip` and removed when the value is dropped. A
//! test removes what a killed test left behind.
//!
//! Needs Linux, root and `ip` (iproute2). Nothing is added to the namespace of the test itself, so that its addresses
//! cannot conflict with others.
#![expect(clippy::unwrap_used, reason = "what a test cannot do has failed")]

use std::collections::BTreeSet;
use std::process::{Command, Output};
use std::sync::OnceLock;

/// Name of the bridge device in the namespace of a bridge.
pub const BRIDGE: &str = "lan";
/// Beginning of all names; the process id of the test follows.
const MARK: &str = "skein-";

/// Reason why this host cannot make namespaces; `None` if it can.
pub fn missing() -> Option<String> {
    static MISSING: OnceLock<Option<String>> = OnceLock::new();
    MISSING.get_or_init(probe).clone()
}

fn probe() -> Option<String> {
    if !rustix::process::geteuid().is_root() {
        return Some("only root can make network namespaces".to_owned());
    }
    let probe = format!("{MARK}{}-probe", std::process::id());
    let made = match Command::new("ip").args(["netns", "add", &probe]).output() {
        Ok(made) => made,
        Err(error) => return Some(format!("no program `ip` (iproute2): {error}")),
    };
    let _ = Command::new("ip").args(["netns", "del", &probe]).output();
    (!made.status.success()).then(|| format!("`ip netns add`: {}", String::from_utf8_lossy(&made.stderr).trim()))
}

/// The namespaces of one test.
#[derive(Debug)]
pub struct Namespaces {
    prefix: String,
    names: BTreeSet<String>,
}

impl Namespaces {
    /// Starts without namespaces.
    pub fn new(test: &str) -> Self {
        sweep();
        Self { prefix: format!("{MARK}{}-{test}", std::process::id()), names: BTreeSet::new() }
    }

    /// Name of this namespace for `ip`.
    pub fn name(&self, namespace: &str) -> String {
        format!("{}-{namespace}", self.prefix)
    }

    /// Makes a namespace with its loopback up, and returns its name.
    ///
    /// # Panics
    /// If the namespace cannot be made.
    pub fn add(&mut self, namespace: &str) -> String {
        let name = self.name(namespace);
        ip(&["netns", "add", &name]);
        self.names.insert(name.clone());
        ip(&["-n", &name, "link", "set", "lo", "up"]);
        name
    }

    /// Makes a namespace with a bridge in it, and returns its name.
    ///
    /// # Panics
    /// If the namespace cannot be made.
    pub fn add_bridge(&mut self, namespace: &str) -> String {
        let name = self.add(namespace);
        ip(&["-n", &name, "link", "add", BRIDGE, "type", "bridge"]);
        ip(&["-n", &name, "link", "set", BRIDGE, "up"]);
        name
    }

    /// Removes a namespace with its links to others. The caller has to end its processes.
    pub fn remove(&mut self, namespace: &str) {
        let name = self.name(namespace);
        self.names.remove(&name);
        delete(&name);
    }

    /// The command that runs a program in the namespace. `ip` replaces itself by the program, so that the process id is
    /// the program's.
    pub fn command(&self, namespace: &str, program: &str) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.name(namespace), program]);
        command
    }
}

impl Drop for Namespaces {
    /// Deletes the namespaces, which deletes their links too.
    fn drop(&mut self) {
        self.names.iter().for_each(|name| delete(name));
    }
}

/// Links a namespace to a bridge: `device` in the namespace with this address, such as `10.0.0.1/24`, and `port` at the
/// bridge.
///
/// # Panics
/// If `ip` fails.
pub fn join(namespace: &str, device: &str, address: &str, bridge: &str, port: &str) {
    ip(&["link", "add", device, "netns", namespace, "type", "veth", "peer", "name", port, "netns", bridge]);
    plug(bridge, port);
    ip(&["-n", namespace, "addr", "add", address, "dev", device]);
    ip(&["-n", namespace, "link", "set", device, "up"]);
}

/// Connects the port of a link to the bridge.
///
/// # Panics
/// If `ip` fails.
pub fn plug(bridge: &str, port: &str) {
    ip(&["-n", bridge, "link", "set", port, "master", BRIDGE]);
    ip(&["-n", bridge, "link", "set", port, "up"]);
}

/// Disconnects a port from the bridge: no packet passes any more, and neither end notices.
///
/// # Panics
/// If `ip` fails.
pub fn pull(bridge: &str, port: &str) {
    ip(&["-n", bridge, "link", "set", port, "nomaster"]);
}

/// Deletes the link of a port at once. Deleting its namespace would delete the link too, but at an unknown time.
///
/// # Panics
/// If `ip` fails.
pub fn unplug(bridge: &str, port: &str) {
    ip(&["-n", bridge, "link", "del", port]);
}

/// Runs `ip` with these arguments.
///
/// # Panics
/// If `ip` fails.
pub fn ip(arguments: &[&str]) {
    let Output { status, stderr, .. } = Command::new("ip").args(arguments).output().unwrap();
    assert!(status.success(), "ip {arguments:?}: {}", String::from_utf8_lossy(&stderr));
}

fn delete(name: &str) {
    let _ = Command::new("ip").args(["netns", "del", name]).output();
}

/// Whether the process runs; a zombie, whose parent has not read its exit status, does not.
pub fn is_running(process: u32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    stat.rsplit_once(") ").is_some_and(|(_, rest)| !rest.starts_with('Z'))
}

/// Removes what interrupted tests left behind: their processes in namespaces, and the namespaces.
fn sweep() {
    let Ok(list) = Command::new("ip").args(["netns", "list"]).output() else { return };
    for line in String::from_utf8_lossy(&list.stdout).lines() {
        let name = line.split(' ').next().unwrap_or_default();
        let owner = name.strip_prefix(MARK).and_then(|rest| rest.split('-').next());
        if owner.and_then(|owner| owner.parse().ok()).is_none_or(is_running) {
            continue;
        }
        let Ok(processes) = Command::new("ip").args(["netns", "pids", name]).output() else { continue };
        for process in String::from_utf8_lossy(&processes.stdout).split_whitespace() {
            let process = process.parse().ok().and_then(rustix::process::Pid::from_raw);
            // An error means that the process has ended meanwhile.
            let _ = process.map(|process| rustix::process::kill_process(process, rustix::process::Signal::KILL));
        }
        delete(name);
    }
}
