//! The hosts of a swarm: installs an agent on each, starts the agents, shows their status, lands them and uninstalls them.
//! Programs beside a swarm also use it to reach, observe and order the vehicles. The control loop uses nothing of this crate, so
//! the swarm flies on without the operator's PC.
//!
//! | module | contents |
//! | --- | --- |
//! | [`inventory`] | the cluster file: which agent runs on which host |
//! | [`keys`] | the swarm's authority, and the certificates of the nodes, the observers and the operator |
//! | [`mesh`] | a live swarm: where it is reached, what its vehicles send, orders to them, and waiting until they are ready |
//! | [`endpoints`] | the file with the endpoints of a swarm on this PC |
//! | [`display`] | a flight as people look at it: table, journal, status |
//! | [`simulators`], [`place`] | the X-Planes of a flight: whether they answer, and where their aircraft stand |
//! | [`capacity`] | what a message and a step cost on this PC, and how many agents it can fly |
//! | [`findings`] | what a check has found, each fault with its remedy |
//! | [`bundle`], [`pack`] | the files of one node, except the program, and how they are made |
//! | [`protocol`] | the requests of the operator's PC to a node's host over ssh, and the answers |
//! | [`ssh`] | the system's OpenSSH, at most eight hosts at once |
//! | [`remote`] | the requests to a node's host, in as few ssh calls as possible |
//! | [`nodes`] | the nodes that a command is for, its progress and its results |
//! | `flown` | which run the swarm flies in, and the evidence for it |
//! | [`program`] | the program to install: its platform and the C library that it needs |
//! | [`host`] | the part that runs on a node's host: files, service, supervisor, logs |
//! | [`os`], [`ports`], [`landing`] | the operating system, free ports, time limits of landings |
//! | the rest | one command each |

pub mod bundle;
pub mod capacity;
pub mod check;
pub mod clocks;
pub mod display;
pub mod down;
pub mod endpoints;
pub mod findings;
mod flown;
pub mod host;
pub mod install;
pub mod inventory;
pub mod keys;
pub mod landing;
pub mod logs;
pub mod mesh;
pub mod nodes;
pub mod os;
pub mod pack;
pub mod place;
pub mod ports;
pub mod program;
pub mod protocol;
pub mod remote;
pub mod simulators;
pub mod ssh;
pub mod status;
pub mod uninstall;
pub mod up;

use std::path::PathBuf;

use clap::Subcommand;

use inventory::find;
use skein_lab::error::Error;

/// `skein cluster`
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  skein cluster keys\n  skein cluster install\n  skein cluster up\n  skein cluster status --watch\n  skein cluster down"
)]
pub struct ClusterArgs {
    /// The command for the cluster
    #[command(subcommand)]
    pub command: ClusterCommand,
}

/// The commands on a cluster.
#[derive(Clone, Debug, Subcommand)]
pub enum ClusterCommand {
    /// Make the swarm's authority and a certificate for each node, for observers and for the operator
    Keys(keys::command::KeysArgs),
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
        ClusterCommand::Keys(args) => keys::command::run(args),
        ClusterCommand::Install(args) => install::run(args),
        ClusterCommand::Up(args) => up::run(args),
        ClusterCommand::Status(args) => status::run(args),
        ClusterCommand::Logs(args) => logs::run(args),
        ClusterCommand::Down(args) => down::run(args),
        ClusterCommand::Uninstall(args) => uninstall::run(args),
    }
}

#[cfg(test)]
mod tests;
