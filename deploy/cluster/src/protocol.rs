//! The requests of the operator's PC to a node's host over ssh, and the answers. A request is one JSON object on the
//! standard input of `skein node`; the answer is one JSON object on its standard output.

use std::net::IpAddr;

use serde::{Deserialize, Serialize};
use skein_agent::link::signature::runs::RunNote;
use skein_common::id::{SwarmName, VehicleName};

use super::bundle::Bundle;
use crate::inventory::ServiceKind;

/// A request to one node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Request {
    /// Name of the swarm.
    pub swarm: SwarmName,
    /// Id of the agent's vehicle.
    pub id: VehicleName,
    /// The task.
    pub ask: Ask,
}

/// The tasks of a node's host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Ask {
    /// Report what is installed and running.
    Facts,
    /// Report the platform and the checksum of the program that answers.
    Program,
    /// Answer each line of standard input with the time, seconds since 1970 with nine decimals, until it is closed.
    Clock,
    /// Install this configuration with the program that answers, for the next start. A running agent is not affected.
    Apply(Setup),
    /// Like `Apply`, also if the node belongs to another authority, but not while its agent runs under that authority.
    TakeOver(Setup),
    /// Start the agent in this run of the swarm. A running agent is not affected.
    Start {
        /// Id of the run, drawn by `up`: orders of other runs are void.
        run: u64,
        /// The operator's signed note of that run, which the host keeps.
        #[serde(default)]
        note: Option<RunNote>,
    },
    /// Land the vehicle and end its agent. After this time, end the agent wherever the vehicle is.
    Stop {
        /// Time limit of the landing, s.
        within_s: f64,
    },
    /// Go back to what was installed before the last `Apply` that changed something.
    Rollback,
    /// Like `Stop`; then remove everything of this node, and what no other node of this host needs.
    Remove {
        /// Time limit of the landing, s.
        within_s: f64,
    },
    /// Ask whether a simulator answers at this address within two seconds.
    Simulator {
        /// `HOST[:PORT]`
        address: String,
    },
    /// Put the aircraft of the simulator at this address to the start of the node's vehicle, in the weather of the scenario
    /// that is installed, as `skein fly` does before a flight.
    Place {
        /// `HOST[:PORT]`
        address: String,
    },
    /// Ask whether these endpoints of peers, `HOST:PORT`, can be reached within a second.
    Reach {
        /// The endpoints.
        endpoints: Vec<String>,
    },
    /// Measure whether the host has the processor time for these agents.
    Carries {
        /// Number of agents on this host.
        agents: usize,
        /// Number of vehicles in the swarm.
        swarm: usize,
    },
    /// Write the log to standard output as plain text, instead of an answer.
    Log {
        /// Number of last lines to write.
        lines: usize,
        /// Continue with new lines until standard input is closed.
        follow: bool,
    },
}

/// The configuration of a node, with what its host has to know of how it is started.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Setup {
    /// The node's files.
    pub bundle: Bundle,
    /// The service that restarts the agent when it has failed. The host resolves `Auto`; [`Facts::service`] reports the result.
    pub service: ServiceKind,
    /// Log filter of the agent, in the syntax of `RUST_LOG`.
    pub log: Option<String>,
}

/// The service that restarts an agent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Service {
    /// A unit of the user's systemd instance.
    SystemdUser,
    /// A unit of the system's systemd instance.
    SystemdSystem,
    /// Skein's own supervisor.
    Own,
}

/// Text for a [`Change`] with `forced`.
pub const FORCED: &str = "had not landed in time: its agent was ended wherever the vehicle was";

/// The answers to the tasks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Answer {
    /// Answer to [`Ask::Facts`].
    Facts(Facts),
    /// Answer to [`Ask::Program`].
    Program {
        /// Its platform in the format of [`crate::program::Program::platform`].
        platform: String,
        /// SHA-256, 64 hexadecimal digits.
        sum: String,
        /// Free space in the file system of its folder, bytes.
        free_bytes: u64,
    },
    /// Answer to a task that can change something.
    Done(Change),
    /// Answer to [`Ask::Simulator`]: a description of the simulator, or why it did not answer.
    Simulator(Result<String, String>),
    /// Answer to [`Ask::Place`]: a sentence for each thing that was done or found.
    Placed(Vec<String>),
    /// Answer to [`Ask::Carries`]: the reason with figures if the host cannot run the agents, else `None`.
    Carries(Option<String>),
    /// Answer to [`Ask::Reach`]: the result for each endpoint, in the order of the request.
    Reach(Vec<Reached>),
    /// The task failed, and nothing is left half done: the reason.
    Failed(String),
}

/// Result of a task that can change something.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// Whether anything was written, started or ended.
    pub changed: bool,
    /// Whether an agent was ended before its vehicle had landed, because the time was up.
    #[serde(default)]
    pub forced: bool,
    /// The state of the node afterwards.
    pub facts: Facts,
}

/// Result of connecting to an endpoint.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Reached {
    /// The connection was accepted.
    Taken,
    /// The host refused: no process listens there, as before `up`, or a firewall resets connections.
    Refused,
    /// No connection: the cause, and the reason as the caller's system gives it.
    No(Cause, String),
}

/// The reason why a connection cannot be made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Cause {
    /// The name of the host cannot be resolved.
    Name,
    /// The caller's network has no route to the address, or its router reports the host as absent.
    Route,
    /// The caller's system does not accept the address.
    Address,
    /// The caller's own system forbids it.
    Forbidden,
    /// No answer came in time.
    Silence,
    /// Anything else.
    Other,
}

/// The state of one node on its host: what is installed and what is running.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Facts {
    /// The program and configuration of the next start.
    pub current: Option<Installed>,
    /// The program and configuration that a rollback would restore.
    pub previous: Option<Installed>,
    /// The service that restarts the agent.
    pub service: Option<Service>,
    /// The agent's process, if it is running.
    pub agent: Option<RunningAgent>,
    /// The operator's note of the run that was started last, whether its agent is running or not.
    #[serde(default)]
    pub note: Option<RunNote>,
    /// The authority whose keys are installed, as [`Bundle::authority`] identifies it; `None` where links are plain.
    #[serde(default)]
    pub authority: Option<String>,
    /// The addresses of the host's network interfaces; none if the system does not report them.
    #[serde(default)]
    pub addresses: Vec<IpAddr>,
    /// Free space in the file system of its files, bytes.
    pub free_bytes: u64,
}

/// An installed program and configuration.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Installed {
    /// Version and checksum, `0.1.0-1f2e3d4c5b6a`.
    pub release: String,
    /// [`Bundle::id`]
    pub bundle: String,
}

/// A running agent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunningAgent {
    /// Process id.
    pub pid: u32,
    /// The program and configuration that it runs, which may have been installed before what is current.
    pub installed: Installed,
    /// The run of the swarm.
    pub run: u64,
    /// Number of times that it has failed and was restarted in this run.
    pub restarts: u32,
    /// Time limit for a landing in the scenario that it was started with, s; 0 if unknown.
    #[serde(default)]
    pub landing_s: f64,
}
