//! `skein node`: the side of the cluster's commands that runs on a node's host. Asked over ssh, one [`super::protocol`] request
//! at a time; it works in the place that it is installed in.
//!
//! | module | what it knows |
//! | --- | --- |
//! | `place` | where everything is |
//! | `files` | writing so that no moment is a bad one to be broken off at |
//! | `install` | putting a node's files there, switching, taking away |
//! | `service` | starting and ending an agent |
//! | `systemd`, `supervisor` | who starts it again |
//! | `logs` | what the agent wrote |
//! | `probe` | what the host can reach |

mod files;
mod install;
mod logs;
mod node;
mod place;
pub(crate) mod probe;
mod process;
mod service;
mod supervisor;
mod systemd;

use std::io::{self, Read};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;
use std::time::Duration;

use serde::Deserialize;
use skein_agent::config::AgentOptions;
use skein_common::id::VehicleId;

use super::protocol::{Answer, Ask, Request};
use crate::capacity::{self, Demand};
use node::{NodeFolder, Settings};
use place::Place;
use skein_lab::error::Error;

/// `skein node`
#[derive(Clone, Debug, clap::Args)]
pub struct NodeArgs {
    /// Instead of answering a request: start this node's agent again whenever it has died
    #[arg(long, value_name = "N", conflicts_with = "fly")]
    pub supervise: Option<VehicleId>,
    /// Instead of answering a request: become this node's agent
    #[arg(long, value_name = "N")]
    pub fly: Option<VehicleId>,
}

/// Answers one request.
///
/// # Errors
/// If the request is none, or this program is not installed.
pub fn run(args: &NodeArgs) -> Result<(), Error> {
    let place = Place::of_this_program().map_err(Error::Refused)?;
    if let Some(id) = args.fly {
        return service::become_agent(&place.node(id)).map_err(Error::Failed);
    }
    if let Some(id) = args.supervise {
        return supervisor::supervise(&place.node(id)).map_err(Error::Failed);
    }
    let request = read(io::stdin().lock()).map_err(Error::Refused)?;
    if let Ask::Log { lines, follow } = request.ask {
        return show_log(&place, &place.node(request.id), lines, follow).map_err(Error::Failed);
    }
    let answer = answer(&place, request).unwrap_or_else(Answer::Failed);
    let answer = serde_json::to_string(&answer).map_err(|error| Error::Failed(error.to_string()))?;
    skein_lab::terminal::say(&format!("{answer}\n"));
    Ok(())
}

/// `skein agent`: flies one vehicle.
pub fn fly(options: &AgentOptions) -> ExitCode {
    service::fly(options)
}

/// The first value of the input, which need not end after it.
fn read(input: impl Read) -> Result<Request, String> {
    let mut input = serde_json::Deserializer::from_reader(io::BufReader::new(input));
    Request::deserialize(&mut input).map_err(|error| format!("this is no request: {error}"))
}

fn answer(place: &Place, request: Request) -> Result<Answer, String> {
    let Request { swarm, id, ask } = request;
    if swarm != place.swarm {
        return Err(format!("this is swarm {}, and {swarm} was asked", place.swarm));
    }
    let node = place.node(id);
    match ask {
        Ask::Facts => return Ok(Answer::Facts(node.facts())),
        Ask::Simulator { address } => {
            return Ok(Answer::Simulator(crate::simulators::ask(&address).map_err(|error| error.to_string())));
        }
        Ask::Reach { endpoints } => return Ok(Answer::Reach(probe::reach(&endpoints))),
        Ask::Carries { agents, swarm } => {
            let demand = Demand { agents, swarm, traces: false };
            return Ok(Answer::Carries(capacity::exceeded_by(demand).map_err(|error| error.to_string())?));
        }
        Ask::Apply { .. } => node::make_folders(&[node.installs(), node.run(), node.log()])?,
        // Nothing is left of it, or never was: the rest of its request is done below.
        Ask::Remove { .. } if !node.path.exists() => {
            let changed = install::remove(place, &node)?;
            return Ok(Answer::Done { changed, forced: false, facts: node.facts() });
        }
        _ if !node.path.exists() => return Err(format!("nothing is installed for node {id}")),
        _ => node::make_folders(&[node.run()])?,
    }
    let _lock = node.lock()?;
    let mut forced = false;
    let mut stop = |within_s| {
        let ended = service::stop(place, &node, seconds(within_s)?)?;
        forced = ended.by_force;
        Ok::<_, String>(ended.was_busy)
    };
    let changed = match ask {
        Ask::Apply { bundle, service, log } => {
            let settings = Settings { service: service::resolve(place, &node, service)?, log };
            // Both in any case.
            let of_service = service::install_service(place, &node, &settings)?;
            install::apply(place, &node, &bundle, &settings)? || of_service
        }
        Ask::Start { run, note } => service::start(place, &node, run, note)?,
        Ask::Stop { within_s } => stop(within_s)?,
        Ask::Rollback => install::rollback(&node).map(|()| true)?,
        Ask::Remove { within_s } => {
            stop(within_s)?;
            service::remove_service(place, &node)?;
            install::remove(place, &node)?
        }
        Ask::Facts | Ask::Simulator { .. } | Ask::Reach { .. } | Ask::Carries { .. } | Ask::Log { .. } => false,
    };
    Ok(Answer::Done { changed, forced, facts: node.facts() })
}

fn seconds(seconds: f64) -> Result<Duration, String> {
    Duration::try_from_secs_f64(seconds).map_err(|_| format!("{seconds} is no number of seconds"))
}

/// Writes a node's log to standard output. One that is followed ends with the input: standard output may be silent for long
/// after whoever read it has gone.
fn show_log(place: &Place, node: &NodeFolder, lines: usize, follow: bool) -> Result<(), String> {
    match node.settings().and_then(|settings| place.systemd(settings.service)) {
        Some(systemd) => Err(systemd.become_log(&place.swarm, node, lines, follow)),
        None => {
            let is_closed = Arc::new(AtomicBool::new(!follow));
            let watched = is_closed.clone();
            thread::spawn(move || {
                let _ = io::copy(&mut io::stdin().lock(), &mut io::sink());
                watched.store(true, Relaxed);
            });
            // If it cannot be written, nobody reads any more.
            let _ = logs::show(&node.log(), lines, || is_closed.load(Relaxed), &mut io::stdout());
            Ok(())
        }
    }
}

#[cfg(test)]
#[cfg(unix)]
mod tests;
