//! Network namespaces of a test's own, and what joins them: made with `ip`, gone with their value. What a test that was killed
//! has left behind, the next one takes away.
//!
//! Needs Linux, root and `ip` (iproute2). Nothing is added to the namespace of the test itself, so that its addresses are
//! nobody else's business.
#![expect(clippy::unwrap_used, reason = "what a test cannot do has failed")]

use std::collections::BTreeSet;
use std::process::{Command, Output};
use std::sync::OnceLock;

/// The device that is a bridge, in the namespace of a bridge.
pub const BRIDGE: &str = "lan";
/// How all names begin; the number of the test's process follows.
const MARK: &str = "skein-";

/// What stands against making namespaces here.
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
    /// None yet.
    pub fn new(test: &str) -> Self {
        sweep();
        Self { prefix: format!("{MARK}{}-{test}", std::process::id()), names: BTreeSet::new() }
    }

    /// What `ip` calls this namespace.
    pub fn name(&self, namespace: &str) -> String {
        format!("{}-{namespace}", self.prefix)
    }

    /// Makes one with its loopback up. Gives its name.
    ///
    /// # Panics
    /// If it cannot be made.
    pub fn add(&mut self, namespace: &str) -> String {
        let name = self.name(namespace);
        ip(&["netns", "add", &name]);
        self.names.insert(name.clone());
        ip(&["-n", &name, "link", "set", "lo", "up"]);
        name
    }

    /// Makes one with a bridge in it. Gives its name.
    ///
    /// # Panics
    /// If it cannot be made.
    pub fn add_bridge(&mut self, namespace: &str) -> String {
        let name = self.add(namespace);
        ip(&["-n", &name, "link", "add", BRIDGE, "type", "bridge"]);
        ip(&["-n", &name, "link", "set", BRIDGE, "up"]);
        name
    }

    /// Takes one away, with whatever joins it to others. Its processes are the caller's business.
    pub fn remove(&mut self, namespace: &str) {
        let name = self.name(namespace);
        self.names.remove(&name);
        delete(&name);
    }

    /// `ip` becomes the program: its process is the program's.
    pub fn command(&self, namespace: &str, program: &str) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.name(namespace), program]);
        command
    }
}

impl Drop for Namespaces {
    /// What joins namespaces goes with them.
    fn drop(&mut self) {
        self.names.iter().for_each(|name| delete(name));
    }
}

/// Joins a namespace to a bridge: `device` in the one, `port` in the other, and this address, `10.0.0.1/24`.
///
/// # Panics
/// If it cannot be done.
pub fn join(namespace: &str, device: &str, address: &str, bridge: &str, port: &str) {
    ip(&["link", "add", device, "netns", namespace, "type", "veth", "peer", "name", port, "netns", bridge]);
    plug(bridge, port);
    ip(&["-n", namespace, "addr", "add", address, "dev", device]);
    ip(&["-n", namespace, "link", "set", device, "up"]);
}

/// Puts the end of a link that is in a bridge's namespace onto the bridge.
///
/// # Panics
/// If it cannot be done.
pub fn plug(bridge: &str, port: &str) {
    ip(&["-n", bridge, "link", "set", port, "master", BRIDGE]);
    ip(&["-n", bridge, "link", "set", port, "up"]);
}

/// Pulls it off, so that nothing comes through any more; nobody is told.
///
/// # Panics
/// If it cannot be done.
pub fn pull(bridge: &str, port: &str) {
    ip(&["-n", bridge, "link", "set", port, "nomaster"]);
}

/// Takes the link away that ends there. With its namespace it would go too, but nobody says when.
///
/// # Panics
/// If it cannot be done.
pub fn unplug(bridge: &str, port: &str) {
    ip(&["-n", bridge, "link", "del", port]);
}

/// Does it.
///
/// # Panics
/// If it cannot be done.
pub fn ip(arguments: &[&str]) {
    let Output { status, stderr, .. } = Command::new("ip").args(arguments).output().unwrap();
    assert!(status.success(), "ip {arguments:?}: {}", String::from_utf8_lossy(&stderr));
}

fn delete(name: &str) {
    let _ = Command::new("ip").args(["netns", "del", name]).output();
}

/// Whether there is such a process, and not only its number, kept for a parent that does not ask.
pub fn is_running(process: u32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    stat.rsplit_once(") ").is_some_and(|(_, rest)| !rest.starts_with('Z'))
}

/// Ends what is left of tests that did not come to their end: their processes in namespaces, and these.
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
            // One that is gone meanwhile is what is wanted.
            let _ = process.map(|process| rustix::process::kill_process(process, rustix::process::Signal::KILL));
        }
        delete(name);
    }
}
