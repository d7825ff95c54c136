//! `skein check --pc`: checks whether this PC can fly a swarm, with any scenario.
//!
//! | module | what it checks |
//! | --- | --- |
//! | `network` | ports, loopback, firewall, X-Plane's beacon |
//! | `machine` | processor, clock, limits of this user, disk, Python |

mod firewall;
mod machine;
mod network;

use std::time::Duration;

use skein_lab::error::Error;
use skein_lab::terminal::{json, say};

use skein_cluster::findings::{Line, as_table, verdict};

/// Prints a line for each check; listens to X-Plane's beacon for `wait`.
///
/// # Errors
/// If a fault prevents a flight.
pub(super) fn run(wait: Duration, as_json: bool) -> Result<(), Error> {
    // Listening takes its time, and nothing else does.
    let lines: Vec<Line> = std::thread::scope(|scope| {
        let beacon = scope.spawn(|| network::beacon(wait));
        let others: Vec<Line> = machine::lines().into_iter().chain(network::lines()).collect();
        others.into_iter().chain(beacon.join()).collect()
    });
    say(&if as_json { json(&lines) } else { as_table(&lines, false) });
    verdict(&lines)
}

/// The result of a check of this PC.
fn line(what: &'static str, found: impl Into<String>) -> Line {
    Line::new("this PC", what, found)
}
