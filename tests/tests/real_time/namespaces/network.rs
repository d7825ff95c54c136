//! The network of a test: two bridges that a cable connects, and a third one for the observer.
//!
//! ```text
//!   vehicle 1 -+                     +- vehicle 3      10.77.0.ID, the network between the agents
//!              +- left ==== right ---+
//!   vehicle 2 -+    the cable        +- vehicle 4
//!
//!   all vehicles ---- watch                            10.78.0.ID, which is never cut
//! ```

use std::process::Command;

use skein_tests::namespaces::{BRIDGE, Namespaces, ip, join, plug};

/// Side of the cable on which a vehicle is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    Left,
    Right,
}

/// The network of one test.
pub(super) struct Network {
    namespaces: Namespaces,
}

impl Network {
    /// Makes a namespace for every vehicle, and three for the bridges.
    pub(super) fn new(test: &str, sides: &[Side]) -> Self {
        let mut namespaces = Namespaces::new(test);
        let bridges = [Side::Left, Side::Right].map(|side| namespaces.add_bridge(&format!("{side:?}")));
        let [left, right] = &bridges;
        ip(&["link", "add", "cable", "netns", left, "type", "veth", "peer", "name", "cable", "netns", right]);
        bridges.iter().for_each(|bridge| plug(bridge, "cable"));
        let watch = namespaces.add_bridge("watch");
        ip(&["-n", &watch, "addr", "add", "10.78.0.254/24", "dev", BRIDGE]);
        for (nth, side) in sides.iter().enumerate() {
            let (own, port) = (namespaces.add(&format!("{}", nth + 1)), format!("to{}", nth + 1));
            for (device, bridge, net) in [("eth", &bridges[*side as usize], 77), ("eye", &watch, 78)] {
                join(&own, device, &format!("10.{net}.0.{}/24", nth + 1), bridge, &port);
            }
        }
        Self { namespaces }
    }

    /// A command on the computer of vehicle `id`.
    pub(super) fn command_of(&self, id: u8, program: &str) -> Command {
        self.namespaces.command(&id.to_string(), program)
    }

    /// A command on the computer of the observer.
    pub(super) fn command_of_watcher(&self, program: &str) -> Command {
        self.namespaces.command("watch", program)
    }

    /// Disconnects the cable, or connects it again.
    pub(super) fn cut(&self, cut: bool) {
        ip(&["-n", &self.namespaces.name("Left"), "link", "set", "cable", if cut { "down" } else { "up" }]);
    }
}
