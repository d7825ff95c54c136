//! Target: a cluster. One file names the nodes; these commands put an agent on each, start them, look at them, land them and
//! take them away again. None of it is in the loop: once the agents fly, the operator's PC can be unplugged.
//!
//! | module | what it knows |
//! | --- | --- |
//! | [`crate::inventory`] | the cluster's file: who is where |
//! | [`keys`] | the swarm's authority, and a certificate for each node, for observers and for the operator |
//! | [`bundle`] | everything that one node is given, but the program |
//! | [`protocol`] | what the operator's PC and a node's host say to each other over ssh |
//! | [`ssh`] | the system's OpenSSH, at most eight hosts at once |
//! | [`remote`] | what is asked of a node's host, in as few calls as it takes |
//! | [`nodes`] | which nodes a command is for, how far it is, what came of it |
//! | [`ready`] | waiting on the mesh until vehicles are ready, or gone |
//! | `flown` | which run of the swarm flies, and whose word proves it |
//! | [`program`] | the program that is put there: where it runs, which C library it wants |
//! | [`host`] | the side of it that runs on a node's host: files, service, supervisor, logs |
//! | the rest | one command each |

pub mod bundle;
pub mod check;
pub mod clocks;
pub mod down;
mod flown;
pub mod host;
pub mod install;
pub mod keys;
pub mod logs;
pub mod nodes;
pub mod program;
pub mod protocol;
pub mod ready;
pub mod remote;
pub mod ssh;
pub mod status;
pub mod uninstall;
pub mod up;

use std::path::PathBuf;

use clap::Subcommand;

use skein_lab::error::Error;

/// `skein cluster`
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  skein cluster keys\n  skein cluster install\n  skein cluster up\n  skein cluster status --watch\n  skein cluster down"
)]
pub struct ClusterArgs {
    /// What to do with the cluster
    #[command(subcommand)]
    pub command: ClusterCommand,
}

/// What can be done with a cluster.
#[derive(Clone, Debug, Subcommand)]
pub enum ClusterCommand {
    /// Make the swarm's authority and a certificate for each node, for observers and for the operator
    Keys(keys::KeysArgs),
    /// Put the program, its configuration and its keys on every node; a second time changes nothing
    Install(install::InstallArgs),
    /// Start every agent, and return when each has reported ready by itself
    Up(up::UpArgs),
    /// Show how every node does, as the swarm itself says
    Status(status::StatusArgs),
    /// Show what the agents have written, with the nodes' names
    Logs(logs::LogsArgs),
    /// Land every vehicle and stop its agent
    Down(down::DownArgs),
    /// Take everything away that `install` has put on the nodes
    Uninstall(uninstall::UninstallArgs),
}

/// What every command on a cluster is told.
#[derive(Clone, Debug, clap::Args)]
pub struct FileArgs {
    /// The cluster's file
    #[arg(short = 'f', long = "file", value_name = "CLUSTER.toml", default_value = "cluster.toml")]
    pub file: PathBuf,
}

/// Does it.
///
/// # Errors
/// As the command says.
pub fn run(args: &ClusterArgs) -> Result<(), Error> {
    match &args.command {
        ClusterCommand::Keys(args) => keys::run(args),
        ClusterCommand::Install(args) => install::run(args),
        ClusterCommand::Up(args) => up::run(args),
        ClusterCommand::Status(args) => status::run(args),
        ClusterCommand::Logs(args) => logs::run(args),
        ClusterCommand::Down(args) => down::run(args),
        ClusterCommand::Uninstall(args) => uninstall::run(args),
    }
}
