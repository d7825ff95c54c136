//! `skein doctor`: checks whether this PC can fly a swarm, whatever the scenario.
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

use crate::cluster::nodes::is_seconds;
use crate::findings::{Line, as_table, verdict};

/// `skein doctor`
#[derive(Clone, Debug, clap::Args)]
#[command(
    long_about = "What of this PC would stop or disturb a flight: ports, firewall, cores, clock, limits, disk, X-Plane's \
                  beacon. Each line says what was found and, if it is not well, the remedy.\n\nThree commands look for \
                  trouble before a flight: `skein doctor` checks this PC, `skein check SCENARIO` what is to be flown, and \
                  `skein check -f CLUSTER.toml` a cluster's hosts. Exit status: 1 if a fault prevents a flight.",
    after_help = "Examples:\n  skein doctor\n  skein doctor --json --wait 0"
)]
pub struct DoctorArgs {
    /// How long to listen to X-Plane's beacon, s
    #[arg(long, value_name = "S", default_value_t = 2.0, value_parser = is_seconds)]
    pub wait: f64,
    /// Print it as JSON
    #[arg(long)]
    pub json: bool,
}

/// Prints a line for each check.
///
/// # Errors
/// If a fault prevents a flight.
pub fn run(args: &DoctorArgs) -> Result<(), Error> {
    let wait = Duration::from_secs_f64(args.wait);
    // Listening takes its time, and nothing else does.
    let lines: Vec<Line> = std::thread::scope(|scope| {
        let beacon = scope.spawn(|| network::beacon(wait));
        let others: Vec<Line> = machine::lines().into_iter().chain(network::lines()).collect();
        others.into_iter().chain(beacon.join()).collect()
    });
    say(&if args.json { json(&lines) } else { as_table(&lines) });
    verdict(&lines)
}

/// The result of a check of this PC.
fn line(what: &'static str, found: impl Into<String>) -> Line {
    Line::new("this PC", what, found)
}
