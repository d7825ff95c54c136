//! `skein node`: the part of the cluster's commands that runs on a node's host. It answers one [`super::protocol`] request over
//! ssh and works in the folder in which it is installed.
//!
//! | module | contents |
//! | --- | --- |
//! | `place` | the paths of all files |
//! | `files` | writing files so that an interruption at any moment does no harm |
//! | `install` | installing a node's files, switching between versions, removing them |
//! | `service` | starting and ending an agent |
//! | `systemd`, `supervisor` | the services that restart an agent |
//! | [`supervision`] | when a supervisor starts, kills and restarts its agent |
//! | `privileges` | what an agent started by root gives up |
//! | `logs` | the agent's log |
//! | `probe` | the host's addresses, and which peers it can reach |

mod files;
mod install;
mod logs;
mod node;
mod place;
mod privileges;
pub mod probe;
mod process;
mod service;
pub mod supervision;
mod supervisor;
mod systemd;
mod watchdog;

use std::io::{self, BufRead, Read};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;
use std::time::Duration;

use serde::Deserialize;
use skein_common::id::VehicleName;
use skein_host::clock;

use super::protocol::{Answer, Ask, Change, Request, Setup};
use crate::capacity::{self, Demand};
use crate::findings::Line;
use crate::os;
use crate::program::Program;
use node::{INSTALLS, LOG, NodeFolder, RUN, Settings};
use place::SwarmFolder;
pub(crate) use place::{LAUNCHER, LEFT};
pub(crate) use service::START_WITHIN;
pub use service::fly;
use skein_lab::error::Error;

/// `skein node`
#[derive(Clone, Debug, clap::Args)]
pub struct NodeArgs {
    /// Instead of answering a request: start this node's agent, and restart it whenever it has failed
    #[arg(long, value_name = "N", conflicts_with = "fly")]
    pub supervise: Option<VehicleName>,
    /// Instead of answering a request: become this node's agent
    #[arg(long, value_name = "N")]
    pub fly: Option<VehicleName>,
    /// Print marks of this name around the answer, on both outputs
    #[arg(long, value_name = "NAME", conflicts_with_all = ["supervise", "fly"])]
    pub marks: Option<String>,
}

/// Answers one request, supervises an agent, or becomes an agent, according to the options.
///
/// # Errors
/// If the request is invalid, or this program is not installed in a swarm's folder.
pub fn run(args: &NodeArgs) -> Result<(), Error> {
    let place = SwarmFolder::of_this_program().map_err(Error::Refused)?;
    if let Some(id) = args.fly {
        return service::become_agent(&place.node(id)).map_err(Error::Failed);
    }
    if let Some(id) = args.supervise {
        return supervisor::supervise(&place.node(id)).map_err(Error::Failed);
    }
    let Some(name) = &args.marks else { return serve(&place) };
    skein_lab::terminal::say(&format!("{name}-begin\n"));
    skein_lab::terminal::complain(&format!("{name}-begin"));
    let served = serve(&place);
    if let Err(error) = &served {
        skein_lab::terminal::complain(&error.to_string());
    }
    skein_lab::terminal::say(&format!("{name}-end {}.\n", u8::from(served.is_err())));
    skein_lab::terminal::complain(&format!("{name}-end"));
    served
}

/// Answers the request on standard input.
fn serve(place: &SwarmFolder) -> Result<(), Error> {
    let mut input = io::BufReader::new(io::stdin().lock());
    let request = read(&mut input).map_err(Error::Refused)?;
    if let Ask::Clock = request.ask {
        // The first of these lines ends the request.
        for _ in input.lines().skip(1).map_while(Result::ok) {
            let now_ns = clock::utc_nanoseconds();
            skein_lab::terminal::say(&format!("{}.{:09}\n", now_ns / 1_000_000_000, now_ns % 1_000_000_000));
        }
        return Ok(());
    }
    drop(input);
    if let Ask::Log { lines, follow } = request.ask {
        return show_log(place, &place.node(request.id), lines, follow).map_err(Error::Failed);
    }
    let answer = answer(place, request).unwrap_or_else(Answer::Failed);
    let answer = serde_json::to_string(&answer).map_err(|error| Error::Failed(error.to_string()))?;
    skein_lab::terminal::say(&format!("{answer}\n"));
    Ok(())
}

/// Reads the request, the first JSON value of the input. The input may stay open after it.
fn read(input: impl Read) -> Result<Request, String> {
    let mut input = serde_json::Deserializer::from_reader(input);
    Request::deserialize(&mut input).map_err(|error| format!("not a valid request: {error}"))
}

fn answer(place: &SwarmFolder, request: Request) -> Result<Answer, String> {
    let Request { swarm, id, ask } = request;
    if swarm != place.swarm {
        return Err(format!("the request is for swarm {swarm}, but this is swarm {}", place.swarm));
    }
    let node = place.node(id);
    match ask {
        Ask::Facts => return Ok(Answer::Facts(node.facts())),
        Ask::Program => {
            let program = Program::read(None).map_err(|error| error.to_string())?;
            let free_bytes = os::free_bytes(&place.folder).unwrap_or(0);
            return Ok(Answer::Program {
                platform: program.platform.unwrap_or_default(),
                sum: program.sum,
                free_bytes,
            });
        }
        Ask::Simulator { address } => {
            return Ok(Answer::Simulator(crate::simulators::ask(&address)));
        }
        Ask::Place { address } => {
            let scenario = node.scenario()?;
            let lines = crate::place::before_flight_of(&scenario, id.vehicle, &address);
            return Ok(Answer::Placed(lines.iter().map(Line::sentence).collect()));
        }
        Ask::Reach { endpoints } => return Ok(Answer::Reach(probe::reach(&endpoints))),
        Ask::Carries { agents, swarm } => {
            let demand = Demand { agents, swarm, traces: false };
            return Ok(Answer::Carries(capacity::exceeded_by(demand).map_err(|error| error.to_string())?));
        }
        Ask::Apply(_) | Ask::TakeOver(_) => node::make_folders(&[node.file(INSTALLS), node.file(RUN), node.file(LOG)])?,
        // The node was removed or never installed: only shared files may have to be removed.
        Ask::Remove { .. } if !node.path.exists() => {
            let changed = install::remove(place, &node)?;
            return Ok(Answer::Done(Change { changed, forced: false, facts: node.facts() }));
        }
        _ if !node.path.exists() => return Err(format!("nothing is installed for node {id}")),
        _ => node::make_folders(&[node.file(RUN)])?,
    }
    let _lock = node.lock()?;
    let mut forced = false;
    let mut stop = |within_s| {
        let ended = service::stop(place, &node, seconds(within_s)?)?;
        forced = ended.by_force;
        Ok::<_, String>(ended.was_busy)
    };
    let takes_over = matches!(ask, Ask::TakeOver(_));
    let changed = match ask {
        Ask::Apply(Setup { bundle, service, log }) | Ask::TakeOver(Setup { bundle, service, log }) => {
            node.check_owner(bundle.authority().as_deref(), takes_over)?;
            let settings = Settings { service: service::resolve(place, &node, service)?, log };
            // Do both in any case.
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
        Ask::Facts
        | Ask::Program
        | Ask::Clock
        | Ask::Simulator { .. }
        | Ask::Place { .. }
        | Ask::Reach { .. }
        | Ask::Carries { .. }
        | Ask::Log { .. } => false,
    };
    Ok(Answer::Done(Change { changed, forced, facts: node.facts() }))
}

fn seconds(seconds: f64) -> Result<Duration, String> {
    Duration::try_from_secs_f64(seconds).map_err(|_| format!("{seconds} is not a valid number of seconds"))
}

/// Writes a node's log to standard output. Following ends when the input closes, because standard output may have
/// nothing to write for long after its reader has gone.
fn show_log(place: &SwarmFolder, node: &NodeFolder, lines: usize, follow: bool) -> Result<(), String> {
    match node.settings().and_then(|settings| place.systemd(settings.service)) {
        Some(systemd) => Err(systemd.become_log(&place.swarm, node, lines, follow)),
        None => {
            let is_closed = Arc::new(AtomicBool::new(!follow));
            let watched = is_closed.clone();
            thread::spawn(move || {
                let _ = io::copy(&mut io::stdin().lock(), &mut io::sink());
                watched.store(true, Relaxed);
            });
            // A failed write means that the reader has gone.
            let _ = logs::show(&node.file(LOG), lines, || is_closed.load(Relaxed), &mut io::stdout());
            Ok(())
        }
    }
}

#[cfg(test)]
#[cfg(unix)]
mod tests;
