//! The commands on a cluster, whose nodes are listed in one file: they install an agent on each node, start the agents, show
//! their status, land them and uninstall them. None is in the control loop: the swarm flies on without the operator's PC.
//!
//! | module | contents |
//! | --- | --- |
//! | [`crate::inventory`] | the cluster file: which agent runs on which host |
//! | [`keys`] | the swarm's authority, and the certificates of the nodes, the observers and the operator |
//! | [`bundle`] | the files of one node, except the program |
//! | [`protocol`] | the requests of the operator's PC to a node's host over ssh, and the answers |
//! | [`ssh`] | the system's OpenSSH, at most eight hosts at once |
//! | [`remote`] | the requests to a node's host, in as few ssh calls as possible |
//! | [`nodes`] | the nodes that a command is for, its progress and its results |
//! | [`ready`] | waiting until vehicles report on the mesh that they are ready, or have left it |
//! | `flown` | which run the swarm flies in, and the evidence for it |
//! | [`program`] | the program to install: its platform and the C library that it needs |
//! | [`host`] | the part that runs on a node's host: files, service, supervisor, logs |
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

use crate::inventory::find;
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

/// The commands on a cluster.
#[derive(Clone, Debug, Subcommand)]
pub enum ClusterCommand {
    /// Make the swarm's authority and a certificate for each node, for observers and for the operator
    Keys(keys::KeysArgs),
    /// Put the program, its configuration and its keys on every node; a second time changes nothing
    Install(install::InstallArgs),
    /// Start every agent, and return when each has reported ready by itself
    Up(up::UpArgs),
    /// Show the status of every node, as the vehicles report it
    Status(status::ClusterStatusArgs),
    /// Show what the agents have written, with the nodes' names
    Logs(logs::LogsArgs),
    /// Land every vehicle and stop its agent
    Down(down::DownArgs),
    /// Take everything away that `install` has put on the nodes
    Uninstall(uninstall::UninstallArgs),
}

/// Options of every command on a cluster.
#[derive(Clone, Debug, clap::Args)]
pub struct FileArgs {
    /// The cluster's file; without it the one that the environment variable SKEIN_CLUSTER names, else cluster.toml of this
    /// folder
    #[arg(short = 'f', long = "file", value_name = "CLUSTER.toml")]
    pub file: Option<PathBuf>,
}

impl FileArgs {
    /// Path of the cluster file.
    pub fn path(&self) -> PathBuf {
        find::of_option(self.file.as_deref())
    }
}

/// Runs a command on a cluster.
///
/// # Errors
/// The errors of the command.
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
