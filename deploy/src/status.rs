//! `skein status`: the status of a live swarm, on this PC or on a cluster.

use skein_lab::error::Error;

use skein_cluster::mesh::reach::SwarmArgs;
use skein_cluster::status::{ShownArgs, status};

/// `skein status`
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  skein status\n  skein status -w\n  skein status -f cluster.toml --json")]
pub struct StatusArgs {
    /// The swarm.
    #[command(flatten)]
    pub swarm: SwarmArgs,
    /// How to show it.
    #[command(flatten)]
    pub shown: ShownArgs,
}

/// Prints the status of every vehicle, as the vehicles report it.
///
/// # Errors
/// If no swarm flies, it cannot be observed, a vehicle does not report, or one is faulty.
pub fn run(args: &StatusArgs) -> Result<(), Error> {
    status(&args.swarm.choose()?, args.shown)
}
