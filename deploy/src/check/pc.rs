//! `skein check --pc`: checks whether this PC can fly a swarm, with any scenario.
//!
//! | module | what it checks |
//! | --- | --- |
//! | `network` | ports, loopback, firewall, X-Plane's beacon |
//! | `installed` | X-Planes that do not run |
//! | `machine` | processor, clock, limits of this user, disk, Python |
//! | `windows` | what only Windows has |

mod firewall;
mod installed;
mod machine;
mod network;
mod windows;

use std::process::{Command, Stdio};
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

/// The one of two remedies that names programs of this PC's operating system.
const fn remedy(unix: &'static str, windows: &'static str) -> &'static str {
    if cfg!(windows) { windows } else { unix }
}

/// Text that a program prints; `None` if it fails.
fn printed(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// The result of a check of this PC.
fn line(what: &'static str, found: impl Into<String>) -> Line {
    Line::new("this PC", what, found)
}
