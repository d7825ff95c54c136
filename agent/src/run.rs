//! The real node around the core: threads, clocks, the end.
//!
//! | thread | what it does |
//! | --- | --- |
//! | control | waits for the plant's frame, steps the [`Station`], writes the controls; hands over what is to be sent |
//! | publisher | sends it, and may have to wait for the network |
//! | Zenoh's | file what is heard ([`crate::link`]) |
//! | law's | asks an external law, if one flies ([`crate::external`]) |
//! | Tokio's | health once a second, how far clocks are apart, signals |
//! | log, standard input | may block, each alone |
//!
//! Nothing that the control thread does can wait for another of them: it never calls Zenoh, it takes two locks that are held
//! for a copy (the inbox and what is to be sent; another one it only tries), and everything it hands over may be dropped.

mod control;
mod log;
mod silence;
mod timing;

use std::io::{self, BufRead};
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};
use std::thread;

use skein_common::frame::Origin;
use skein_common::id::Incarnation;
use skein_common::message::{Health, Refused};
use skein_common::printable::printable_lines;
use tokio::runtime::{Builder, Handle};
use tokio::sync::mpsc;
use tokio::time::MissedTickBehavior;

use crate::config::{AgentOptions, Node};
use crate::external::LiveLaw;
use crate::link::{ASK_EVERY, HealthLine, Link, LinkError, Sessions, Trust, ZENOH_ON_TWO_THREADS, ZENOH_RUNTIME};
use crate::plant::xplane;
use crate::unix;
use control::Control;
use skein_core::formation::NotFlown;
use skein_core::station::{Clocks, Station};
use skein_host::clock::{LocalClock, new_incarnation, next_incarnation, utc_nanoseconds};
use skein_host::external::ExternalError;

/// Environment variable that says which release was installed here.
pub const RELEASE: &str = "SKEIN_RELEASE";

/// Environment variable that names a file in which an agent keeps its life's number, so that the next one's is larger even if
/// the clock was set back: to its peers it would be speaking in an earlier life else, and not be heard.
pub const LIFE: &str = "SKEIN_LIFE";

/// How an agent is asked to end.
#[derive(Debug, Default)]
pub struct Stop {
    times: AtomicU32,
    forsaken: AtomicBool,
}

impl Stop {
    /// The first time: land, give the controls back, end. The second time: give the controls back and end at once.
    pub fn ask(&self) {
        self.times.fetch_add(1, Relaxed);
    }

    /// Whoever started this agent is gone, or never stood by: fly on, and end once an order has brought it down.
    pub fn forsake(&self) {
        self.forsaken.store(true, Relaxed);
    }

    fn is_asked(&self) -> bool {
        self.times.load(Relaxed) > 0
    }

    fn is_urgent(&self) -> bool {
        self.times.load(Relaxed) > 1
    }

    fn is_forsaken(&self) -> bool {
        self.forsaken.load(Relaxed)
    }
}

/// Why an agent could not fly, or did not fly to its end.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// No network.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// No simulator.
    #[error(transparent)]
    Plant(#[from] xplane::LinkError),
    /// A scenario that asks for what is not flown yet.
    #[error(transparent)]
    NotFlown(#[from] NotFlown),
    /// No law.
    #[error(transparent)]
    Law(#[from] ExternalError),
    /// No threads.
    #[error("the system gives no threads: {0}")]
    Threads(#[from] io::Error),
    /// A fault of ours.
    #[error("the control thread has panicked; the controls were given back")]
    Panicked,
}

/// A whole agent process: files, network, flight, end. `skein-agent` and `skein agent` are this.
///
/// Exit codes: 0 it has landed or was ended, 1 it failed, 2 a file or an argument is wrong.
pub fn program(options: &AgentOptions) -> ExitCode {
    let node = match options.node() {
        Ok(node) => node,
        Err(error) => return failed(&error, 2),
    };
    unix::restart_with((ZENOH_RUNTIME, ZENOH_ON_TWO_THREADS));
    if !options.child {
        // Who starts a child has read them.
        node.notes.iter().for_each(|note| eprintln!("{note}"));
    }
    let _log = log::start();
    let runtime = match Builder::new_multi_thread().worker_threads(1).enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => return failed(&error, 1),
    };
    let stop = Arc::new(Stop::default());
    stop_on_signals(runtime.handle(), stop.clone());
    if options.child {
        stop_on_stdin(stop.clone());
    } else if node.run != 0 {
        // On a cluster nobody stands beside it who could end it: whom an order has landed ends.
        stop.forsake();
    }
    let flown = run(&node, &stop, runtime.handle());
    runtime.shutdown_background();
    match flown {
        Ok(()) => ExitCode::SUCCESS,
        Err(RunError::Link(error)) if error.is_the_users() => failed(&error, 2),
        Err(error) => failed(&error, 1),
    }
}

/// Flies a node's vehicle until it is down after `stop` was asked for. Blocks; not for a Tokio thread.
///
/// # Errors
/// If it cannot begin, or if the control thread has panicked.
pub fn run(node: &Node, stop: &Arc<Stop>, tokio: &Handle) -> Result<(), RunError> {
    let sessions = Sessions::open(&node.scenario.swarm.name, &node.listen, &node.dial, &node.security)?;
    fly(node, sessions, stop, tokio)
}

/// [`run`] over sessions that are already open.
///
/// # Errors
/// As [`run`].
pub fn fly(node: &Node, sessions: impl Into<Sessions>, stop: &Arc<Stop>, tokio: &Handle) -> Result<(), RunError> {
    let clock = LocalClock::start();
    let incarnation = incarnation();
    let clocks = Clocks::new(&node.scenario, node.id).after(node.flown_s);
    let craft = (&node.aircraft, node.rules.clone());
    let station = Station::new(&node.scenario, node.id, incarnation, craft, clocks)?;
    let plant = node.open_plant()?;
    let trust = Trust {
        orders: node.orders_key,
        run: node.run,
        voices: node.security.voices(&node.scenario.swarm.name),
        sealer: node.security.sealer(node.id)?.map(Arc::new),
        ..Trust::of(&node.scenario)
    };
    let link = Link::new(sessions, node.id, clock, trust)?;
    let (health, healths) = mpsc::channel(2);
    tokio.spawn(publish(link.health(utc_nanoseconds)?, healths));
    let control = Control {
        station,
        plant,
        plant_name: node.plant.name(),
        release: release(),
        link,
        law: LiveLaw::start(&node.scenario, node.id)?,
        clock,
        origin: Origin::new(node.scenario.origin.geodetic()),
        own: node.id,
        incarnation,
        stop: stop.clone(),
        health,
    };
    let (id, plant) = (node.id, node.plant.name());
    let thread = thread::Builder::new().name("control".to_owned()).spawn(move || {
        let (priority, memory) = (unix::raise_this_thread(), unix::lock_memory());
        tracing::info!("vehicle {id} flies {plant}: {priority}, {memory}");
        control.run()
    })?;
    unix::tell_service("READY=1");
    let link = thread.join().map_err(|_| RunError::Panicked)?;
    unix::tell_service("STOPPING=1");
    link.close();
    tracing::info!("vehicle {id} ends");
    Ok(())
}

/// Says health as it comes, and asks for the others' time, until the control thread is gone. Health comes only while that
/// thread goes round: whoever watches over this process hears of it too.
async fn publish(mut line: HealthLine, mut healths: mpsc::Receiver<Health>) {
    let mut turns = tokio::time::interval(ASK_EVERY);
    turns.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            health = healths.recv() => {
                let Some(health) = health else { return };
                line.say(health);
                unix::tell_service("WATCHDOG=1");
            }
            _ = turns.tick() => line.ask_a_clock(),
        }
    }
}

/// The number of this life.
fn incarnation() -> Incarnation {
    let Some(file) = std::env::var_os(LIFE) else { return new_incarnation() };
    let (incarnation, fault) = next_incarnation(Path::new(&file));
    fault.iter().for_each(|fault| tracing::warn!("this life's number cannot be kept: {fault}"));
    incarnation
}

/// What runs here: who has installed it says so in the environment.
fn release() -> String {
    let installed = std::env::var(RELEASE).ok().filter(|release| !release.is_empty());
    let release = installed.unwrap_or_else(|| env!("CARGO_PKG_VERSION").to_owned());
    Refused::printable(&release)
}

fn stop_on_signals(tokio: &Handle, stop: Arc<Stop>) {
    tokio.spawn(async move {
        match unix::Signals::catch() {
            Ok(mut signals) => loop {
                signals.next().await;
                stop.ask();
            },
            Err(error) => tracing::warn!("signals cannot be caught, and end this agent in the air: {error}"),
        }
    });
}

/// Each line "stop" asks once. The end of the input is no order: the launcher may have been killed.
fn stop_on_stdin(stop: Arc<Stop>) {
    thread::spawn(move || {
        for line in io::stdin().lock().lines().map_while(Result::ok) {
            if line.trim() == "stop" {
                stop.ask();
            }
        }
        stop.forsake();
    });
}

fn failed(error: &dyn std::error::Error, code: u8) -> ExitCode {
    eprintln!("{}", printable_lines(&error.to_string()));
    ExitCode::from(code)
}

#[cfg(test)]
mod tests;
