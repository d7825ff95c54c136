//! Namespaces and what joins them: made with `ip`, gone with their value.
//!
//! ```text
//!   vehicle 1 -+                     +- vehicle 3      10.77.0.ID, where the agents find each other
//!              +- left ==== right ---+
//!   vehicle 2 -+    the cable        +- vehicle 4
//!
//!   all vehicles ---- watch                            10.78.0.ID, which is never cut
//! ```
//!
//! Nothing is added to the namespace of the test itself, so its addresses are nobody else's business.

use std::process::{Command, Output};
use std::sync::OnceLock;

/// On which side of the cable a vehicle is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    Left,
    Right,
}

/// A network of a test's own.
pub(super) struct Network {
    prefix: String,
    namespaces: Vec<String>,
}

/// What stands against making such a network here.
pub(super) fn missing() -> Option<String> {
    static MISSING: OnceLock<Option<String>> = OnceLock::new();
    MISSING.get_or_init(probe).clone()
}

fn probe() -> Option<String> {
    if !rustix::process::geteuid().is_root() {
        return Some("only root can make network namespaces".to_owned());
    }
    let probe = format!("skein-{}-probe", std::process::id());
    let made = match Command::new("ip").args(["netns", "add", &probe]).output() {
        Ok(made) => made,
        Err(error) => return Some(format!("no program `ip` (iproute2): {error}")),
    };
    let _ = Command::new("ip").args(["netns", "del", &probe]).output();
    (!made.status.success()).then(|| format!("`ip netns add`: {}", String::from_utf8_lossy(&made.stderr).trim()))
}

impl Network {
    /// A namespace for every vehicle, and three for the bridges.
    pub(super) fn new(test: &str, sides: &[Side]) -> Self {
        let mut network = Self { prefix: format!("skein-{}-{test}", std::process::id()), namespaces: Vec::new() };
        let bridges = [Side::Left, Side::Right].map(|side| network.bridge(&format!("{side:?}")));
        let [left, right] = &bridges;
        ip(&["link", "add", "cable", "netns", left, "type", "veth", "peer", "name", "cable", "netns", right]);
        bridges.iter().for_each(|bridge| plug(bridge, "cable"));
        let watch = network.bridge("watch");
        ip(&["-n", &watch, "addr", "add", "10.78.0.254/24", "dev", "lan"]);
        for (nth, side) in sides.iter().enumerate() {
            let (own, port) = (network.namespace(&format!("{}", nth + 1)), format!("to{}", nth + 1));
            for (device, bridge, net) in [("eth", &bridges[*side as usize], 77), ("eye", &watch, 78)] {
                ip(&["link", "add", device, "netns", &own, "type", "veth", "peer", "name", &port, "netns", bridge]);
                plug(bridge, &port);
                ip(&["-n", &own, "addr", "add", &format!("10.{net}.0.{}/24", nth + 1), "dev", device]);
                ip(&["-n", &own, "link", "set", device, "up"]);
            }
        }
        network
    }

    /// A command of vehicle `id`'s computer.
    pub(super) fn command_of(&self, id: u8, program: &str) -> Command {
        self.command(&id.to_string(), program)
    }

    /// A command of the computer that looks on.
    pub(super) fn command_of_watcher(&self, program: &str) -> Command {
        self.command("watch", program)
    }

    /// Pulls the cable, or puts it back.
    pub(super) fn cut(&self, cut: bool) {
        ip(&["-n", &self.name("Left"), "link", "set", "cable", if cut { "down" } else { "up" }]);
    }

    /// `ip` becomes the program: its process is the program's.
    fn command(&self, namespace: &str, program: &str) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.name(namespace), program]);
        command
    }

    fn name(&self, namespace: &str) -> String {
        format!("{}-{namespace}", self.prefix)
    }

    fn namespace(&mut self, name: &str) -> String {
        let name = self.name(name);
        ip(&["netns", "add", &name]);
        self.namespaces.push(name.clone());
        ip(&["-n", &name, "link", "set", "lo", "up"]);
        name
    }

    fn bridge(&mut self, name: &str) -> String {
        let namespace = self.namespace(name);
        ip(&["-n", &namespace, "link", "add", "lan", "type", "bridge"]);
        ip(&["-n", &namespace, "link", "set", "lan", "up"]);
        namespace
    }
}

impl Drop for Network {
    /// What joins namespaces goes with them.
    fn drop(&mut self) {
        for namespace in &self.namespaces {
            let _ = Command::new("ip").args(["netns", "del", namespace]).output();
        }
    }
}

/// Puts the end of a link that is in a bridge's namespace onto the bridge.
fn plug(bridge: &str, device: &str) {
    ip(&["-n", bridge, "link", "set", device, "master", "lan"]);
    ip(&["-n", bridge, "link", "set", device, "up"]);
}

fn ip(arguments: &[&str]) {
    let Output { status, stderr, .. } = Command::new("ip").args(arguments).output().unwrap();
    assert!(status.success(), "ip {arguments:?}: {}", String::from_utf8_lossy(&stderr));
}
