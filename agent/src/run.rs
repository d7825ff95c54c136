//! Runs one agent in real time: its threads, its clocks, its shutdown.
//!
//! | thread | what it does |
//! | --- | --- |
//! | control | waits for the plant's frame, steps the [`Station`], writes the controls, hands over the messages to send |
//! | publisher | sends the messages; may block on the network |
//! | Zenoh's | store received messages ([`crate::link`]) |
//! | inputs | keeps what enters and leaves the station ([`crate::inputs`]); may block on the disk |
//! | law's | queries an external law, if the scenario has one ([`crate::external`]) |
//! | Tokio's | health and clock comparison once a second, signals |
//! | log, standard input | may block; one thread each |
//!
//! The control thread never waits for another thread: it never calls Zenoh, it takes two locks that are held only for a
//! copy (the inbox and the outgoing messages) and only tries a third, and everything it hands over may be dropped.

mod control;
mod log;
pub mod simulated;
mod timing;

use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};
use std::sync::mpsc::Receiver;
use std::thread;
use std::time::Duration;

use skein_common::frame::Origin;
use skein_common::id::Incarnation;
use skein_common::message::{Health, Refused};
use skein_common::printable::printable_lines;
use skein_common::topic::Branch;
use tokio::runtime::{Builder, Handle};
use tokio::sync::mpsc;
use tokio::time::MissedTickBehavior;

use crate::config::{AgentOptions, InputsFolder, Node};
use crate::external::LiveLaw;
use crate::inputs::{FINISH_TIMEOUT, Flown, Recorder};
use crate::link::{
    CLOCK_QUERY_PERIOD, HealthPublisher, Link, LinkError, Sessions, Trust, ZENOH_ON_TWO_THREADS, ZENOH_RUNTIME,
};
use crate::plant::{PlantError, PlantVehicle};
use crate::unix;
use control::{Control, LoopState};
use skein_core::energy::Energy;
use skein_core::formation::UnsupportedScenario;
use skein_core::neighbourhood::Neighbourhood;
use skein_core::station::{Clocks, Station};
use skein_host::clock::{LocalClock, new_incarnation, next_incarnation, now, sleep, utc_nanoseconds};
use skein_host::external::ExternalError;
use timing::Timing;

/// Environment variable with the name of the installed release.
pub const RELEASE: &str = "SKEIN_RELEASE";

/// Environment variable with the file in which an agent keeps its incarnation number. The file makes the next
/// incarnation larger even if the clock was set back; peers would otherwise discard its messages as those of an earlier
/// incarnation.
pub const INCARNATION_FILE: &str = "SKEIN_LIFE";

/// Time for which an agent whose launcher has ended flies beyond the stated duration of its flight: the launcher counts that
/// duration from when all agents were ready.
const UNATTENDED: Duration = Duration::from_secs(30);

/// Requests that an agent end.
#[derive(Debug, Default)]
pub struct Stop {
    requests: AtomicU32,
    abandoned: AtomicBool,
}

impl Stop {
    /// Requests the end. First call: land, release the controls, end. Second call: release the controls and end at
    /// once.
    pub fn request(&self) {
        self.requests.fetch_add(1, Relaxed);
    }

    /// Marks the agent as unattended: no launcher can end it. It flies on, and ends after an order has landed it.
    pub fn abandon(&self) {
        self.abandoned.store(true, Relaxed);
    }

    fn is_requested(&self) -> bool {
        self.requests.load(Relaxed) > 0
    }

    fn is_urgent(&self) -> bool {
        self.requests.load(Relaxed) > 1
    }

    fn is_abandoned(&self) -> bool {
        self.abandoned.load(Relaxed)
    }
}

/// The reason why an agent could not start, or stopped early.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The network could not be opened.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The plant could not be opened.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The scenario uses a feature that agents do not support.
    #[error(transparent)]
    UnsupportedScenario(#[from] UnsupportedScenario),
    /// The external law could not be started.
    #[error(transparent)]
    Law(#[from] ExternalError),
    /// A thread could not be started.
    #[error("a thread cannot be started: {0}")]
    Threads(#[from] io::Error),
    /// The control thread panicked: a bug in Skein.
    #[error("the control thread panicked (a bug in Skein); the controls were released")]
    Panicked,
}

/// Runs a whole agent process: reads its files, opens the network, flies, ends. `skein-agent` and `skein agent` call
/// it.
///
/// Exit codes: 0 after landing or after a requested end, 1 after a failure, 2 if a file or an argument is wrong.
pub fn program(options: &AgentOptions) -> ExitCode {
    let node = match options.node() {
        Ok(node) => node,
        Err(error) => return failed(&error, 2),
    };
    unix::restart_with((ZENOH_RUNTIME, ZENOH_ON_TWO_THREADS));
    if !options.child {
        // The parent process has printed a child's notes.
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
        let stated = node.scenario.duration_s.and_then(|duration_s| Duration::try_from_secs_f64(duration_s).ok());
        stop_on_input(io::stdin(), stop.clone(), stated.map(|stated| stated + UNATTENDED));
    } else if node.run != 0 {
        // On a cluster no launcher watches the agent, so it ends by itself after an order has landed it.
        stop.abandon();
    }
    let flown = run(&node, &stop, runtime.handle());
    runtime.shutdown_background();
    match flown {
        Ok(()) => ExitCode::SUCCESS,
        Err(RunError::Link(error)) if error.is_user_error() => failed(&error, 2),
        Err(error) => failed(&error, 1),
    }
}

/// Flies the node's vehicle until it has landed after `stop` was requested. Blocks: do not call it on a Tokio thread.
///
/// # Errors
/// If the network, plant or law cannot be opened, or if the control thread panics.
pub fn run(node: &Node, stop: &Arc<Stop>, tokio: &Handle) -> Result<(), RunError> {
    let sessions = Sessions::open(&node.scenario.swarm.name, &node.listen, &node.dial, &node.security)?;
    fly(node, sessions, stop, tokio)
}

/// Flies as [`run`] does, over sessions that are already open.
///
/// # Errors
/// The same as [`run`].
pub fn fly(node: &Node, sessions: impl Into<Sessions>, stop: &Arc<Stop>, tokio: &Handle) -> Result<(), RunError> {
    let clock = LocalClock::start();
    let incarnation = incarnation();
    let &Node { ref scenario, id, ref aircraft, ref rules, flown_s, ref security, .. } = node;
    let team = scenario.team.as_ref();
    let clocks = Clocks::new(scenario, id).after(flown_s);
    let station = Station::new(scenario, id, incarnation, (aircraft, rules.clone()), clocks)?;
    let plant = node.plant.open(&PlantVehicle { scenario, id, aircraft, rules, flown_s })?;
    let signing_key = security.signing_key(Branch::of(team.map(|team| team.id)).name(id))?;
    let trust = Trust {
        orders: node.orders_key,
        run: node.run,
        key_ring: security.key_ring(&scenario.swarm.name),
        signing_key: signing_key.map(Arc::new),
        ..Trust::of(scenario)
    };
    let link = Link::new(sessions, id, clock, trust)?;
    let (health, reports) = mpsc::channel(2);
    let kept = node.inputs.as_ref().map(|folder| keep_inputs(folder, node, incarnation));
    let (recorder, keeper) = kept.transpose()?.unzip();
    tokio.spawn(publish_health(link.health(utc_nanoseconds)?, reports));
    let period = Duration::from_secs_f64(plant.frame_period_s());
    let control = Control {
        station,
        plant,
        plant_name: node.plant.kind().spec().name,
        release: release(),
        link,
        law: LiveLaw::start(scenario, id)?,
        clock,
        origin: Origin::new(team.map_or(&scenario.origin, |team| &team.origin).geodetic()),
        own_origin: Origin::new(scenario.origin.geodetic()),
        neighbourhood: team.map(|_| Neighbourhood::default()),
        own: id,
        incarnation,
        stop: stop.clone(),
        health,
        recorder,
        energy: Energy::new(aircraft.battery.map(|battery| battery.capacity_wh)),
        timing: Timing::new(period, now()),
        kept: LoopState::default(),
    };
    let plant = node.plant.kind().spec().name;
    let thread = thread::Builder::new().name("control".to_owned()).spawn(move || {
        let (priority, memory) = (unix::raise_thread_priority(), unix::lock_memory());
        tracing::info!("vehicle {id} flies {plant}: {priority}, {memory}");
        control.run()
    })?;
    unix::notify_service_manager("READY=1");
    let ended = thread.join();
    if let Some(keeper) = keeper {
        let _ = keeper.recv_timeout(FINISH_TIMEOUT);
    }
    let link = ended.map_err(|_| RunError::Panicked)?;
    unix::notify_service_manager("STOPPING=1");
    link.close();
    tracing::info!("vehicle {id} ends");
    Ok(())
}

/// Begins to keep the inputs of the agent.
fn keep_inputs(folder: &InputsFolder, node: &Node, incarnation: Incarnation) -> io::Result<(Recorder, Receiver<()>)> {
    let flown = Flown {
        release: release(),
        scenario: folder.scenario.clone(),
        vehicle: folder.vehicle.to_string(),
        incarnation,
        flown_s: node.flown_s,
        aircraft: folder.aircraft.clone(),
        rules: folder.rules.clone(),
    };
    Recorder::start(folder, &flown, node.scenario.record.inputs)
}

/// Publishes each health message and queries the peers' clocks until the control thread has ended.
async fn publish_health(mut publisher: HealthPublisher, mut reports: mpsc::Receiver<Health>) {
    let mut ticks = tokio::time::interval(CLOCK_QUERY_PERIOD);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            health = reports.recv() => {
                let Some(health) = health else { return };
                publisher.publish(health);
            }
            _ = ticks.tick() => publisher.query_next_clock(),
        }
    }
}

/// Incarnation number of this process.
fn incarnation() -> Incarnation {
    let Some(file) = std::env::var_os(INCARNATION_FILE) else { return new_incarnation() };
    let (incarnation, fault) = next_incarnation(Path::new(&file));
    fault.iter().for_each(|fault| tracing::warn!("cannot save the incarnation number: {fault}"));
    incarnation
}

/// Release that runs here: named by the installer in the environment, otherwise the package version.
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
                stop.request();
            },
            Err(error) => tracing::warn!("cannot catch signals; a signal ends this agent in flight: {error}"),
        }
    });
}

/// Requests the end once for each line "stop". The end of the input, as of a killed launcher, requests the end only when
/// the agent has run for this time, that of a flight with a stated duration.
fn stop_on_input(input: impl Read + Send + 'static, stop: Arc<Stop>, within: Option<Duration>) {
    let began = now();
    thread::spawn(move || {
        for line in BufReader::new(input).lines().map_while(Result::ok) {
            if line.trim() == "stop" {
                stop.request();
            }
        }
        stop.abandon();
        let Some(within) = within else { return };
        sleep(within.saturating_sub(now() - began));
        if !stop.is_requested() {
            tracing::warn!("the stated duration of the flight is over, and its launcher has ended: landing");
            stop.request();
        }
    });
}

fn failed(error: &dyn std::error::Error, code: u8) -> ExitCode {
    eprintln!("{}", printable_lines(&error.to_string()));
    ExitCode::from(code)
}

#[cfg(test)]
mod tests;
