//! What the operator's PC asks of a node's host over ssh, and what is answered: one JSON object on the standard input of
//! `skein node` there, JSON lines on its standard output, the last of them an [`Answer`].

use serde::{Deserialize, Serialize};
use skein_agent::link::seal::runs::RunNote;
use skein_common::id::{SwarmName, VehicleId};

use super::bundle::Bundle;
use crate::inventory::ServiceKind;

/// What is asked of one node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Request {
    /// The swarm.
    pub swarm: SwarmName,
    /// Whose agent.
    pub id: VehicleId,
    /// What to do with it.
    pub ask: Ask,
}

/// What to do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Ask {
    /// Tell what is there.
    Facts,
    /// Have this configuration and the program that is asked, as the next to run; what runs goes on running.
    Apply {
        /// The configuration.
        bundle: Bundle,
        /// Who is to start it again when it has died. `Auto` is resolved there; [`Facts::service`] tells what it became.
        service: ServiceKind,
        /// What its agent logs, as `RUST_LOG` takes it.
        log: Option<String>,
    },
    /// Start the agent, in this run of the swarm. One that runs already goes on.
    Start {
        /// Drawn by `up`: orders of another run are void.
        run: u64,
        /// The operator's note of that run, kept with what was started.
        #[serde(default)]
        note: Option<RunNote>,
    },
    /// Land the vehicle and end its agent, within so many seconds; then end it wherever the vehicle is.
    Stop {
        /// s
        within_s: f64,
    },
    /// Have what was there before the last `Apply` that changed something.
    Rollback,
    /// As `Stop`; then take away everything of this node, and what no other node of this host needs.
    Remove {
        /// s
        within_s: f64,
    },
    /// Whether a simulator answers at this address within two seconds.
    Simulator {
        /// `HOST[:PORT]`
        address: String,
    },
    /// Whether these endpoints of peers, `HOST:PORT`, can be reached; each is given a second.
    Reach {
        /// Which.
        endpoints: Vec<String>,
    },
    /// Whether the host carries these agents of the swarm, measured there.
    Carries {
        /// That many of them run there.
        agents: usize,
        /// The vehicles of the swarm.
        swarm: usize,
    },
    /// Write the log to standard output, raw, instead of an answer.
    Log {
        /// So many of the last lines.
        lines: usize,
        /// And then what comes, until the input that the request came by is closed.
        follow: bool,
    },
}

/// Who starts an agent again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Service {
    /// A unit of the user's systemd.
    SystemdUser,
    /// A unit of the system's.
    SystemdSystem,
    /// Our supervisor.
    Own,
}

/// What is said where an answer is [`Answer::Done`] with `forced`.
pub const FORCED: &str = "had not landed in time: its agent was ended wherever the vehicle was";

/// What is answered.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Answer {
    /// To [`Ask::Facts`].
    Facts(Facts),
    /// To what changes something: whether it did, and what is there now.
    Done {
        /// Anything was written, started or ended.
        changed: bool,
        /// An agent that had not landed in time was ended wherever its vehicle was.
        #[serde(default)]
        forced: bool,
        /// What is there now.
        facts: Facts,
    },
    /// To [`Ask::Simulator`]: what was heard of it, or why nothing was.
    Simulator(Result<String, String>),
    /// To [`Ask::Carries`]: why it does not, with figures; nothing if it does.
    Carries(Option<String>),
    /// To [`Ask::Reach`]: each endpoint, in the order in which they were asked.
    Reach(Vec<Reached>),
    /// It could not be done, and nothing is half done.
    Failed(String),
}

/// What became of a call to an endpoint.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Reached {
    /// Somebody takes calls there.
    Taken,
    /// The host is reached and refuses: nobody listens there, as before `up`; or a firewall resets.
    Refused,
    /// Nothing came back, or the host cannot be found: why.
    No(String),
}

/// What there is of one node on its host.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Facts {
    /// What would run at the next start.
    pub current: Option<Installed>,
    /// What a rollback would bring.
    pub previous: Option<Installed>,
    /// Who starts it again.
    pub service: Option<Service>,
    /// The agent's process, if it runs.
    pub agent: Option<RunningAgent>,
    /// The operator's note of the run that was started last, whether its agent runs or not.
    #[serde(default)]
    pub note: Option<RunNote>,
    /// Free space where its files are, bytes.
    pub free_bytes: u64,
}

/// A program and a configuration.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Installed {
    /// Version and checksum, `0.1.0-1f2e3d4c5b6a`.
    pub release: String,
    /// [`Bundle::id`]
    pub bundle: String,
}

/// An agent's process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunningAgent {
    /// Its number.
    pub pid: u32,
    /// What it runs: it may have been installed before what is current.
    pub installed: Installed,
    /// In which run of the swarm.
    pub run: u64,
    /// How often it has died and was started again in this run.
    pub restarts: u32,
    /// Whoever flies the scenario that it was started with has landed within this time, s; 0 if that is not known.
    #[serde(default)]
    pub landing_s: f64,
}
