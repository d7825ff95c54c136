//! Agents on this PC in real time, all to all over Zenoh, flown by `skein fly`. The bench reads their health reports and
//! their processor times.

#![expect(clippy::disallowed_methods, reason = "a flight in real time takes real time")]

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use serde_json::Value;
use skein_cluster::endpoints;
use skein_cluster::mesh::observe::Observer;
use skein_cluster::mesh::reach::Reach;
use skein_cluster::os;
use skein_common::id::VehicleId;
use skein_common::message::Health;
use skein_common::state::Activity;
use skein_common::statistics::quantile;
use skein_common::topic::Branch;
use skein_tests::processes::{children_of, processor_time_s};

use crate::{one_ring, print_table, row};

pub(super) const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");
/// Numbers of agents.
const SIZES: [usize; 5] = [4, 16, 32, 48, 64];
/// How long each flight lasts, and its last part that is measured: by then all vehicles are in the air, s.
const FLIGHT_S: u64 = 40;
const MEASURED_S: u64 = 20;
/// How long the vehicles may take to find each other, and to land and end afterwards, s.
const GATHER_S: u64 = 60;
const LAND_S: u64 = 60;

/// Processor time and counters at one instant.
#[derive(Clone, Debug)]
struct Sample {
    at: Instant,
    agents_s: f64,
    fly_s: f64,
    states: u64,
    overruns: u64,
}

/// What was measured of a flight.
#[derive(Debug, Default)]
struct Measured {
    first: Option<Sample>,
    last: Option<Sample>,
    /// Of each vehicle and second: the largest excess of the time between two frames, ms, and the slowest steps, us.
    jitter_ms: Vec<f64>,
    step_p99_us: Vec<f64>,
    /// The figures that `fly` writes.
    figures: Option<Value>,
}

/// Prints the table, and the cost of a message without agents.
pub(super) fn print() {
    println!(
        "Agents on this PC ({} cores), all to all over Zenoh without keys, 50 Hz, built-in plant, one ring.\n\
         {FLIGHT_S} s as `skein fly` flies them; processor time, jitter and steps of the last {MEASURED_S} s.\n",
        os::cores()
    );
    let head = [
        "agents",
        "overruns",
        "jitter p50 ms",
        "p99 ms",
        "step p99 us",
        "states/s each",
        "us per state delivered",
        "cores, agents",
        "cores, fly",
        "peer age p50 ms",
        "p99 ms",
        "losses",
    ];
    let mut rows = vec![row(head)];
    let mut failed = Vec::new();
    for vehicles in SIZES {
        eprintln!("{vehicles} agents, a minute and a half");
        match fly(vehicles) {
            Ok(measured) => rows.push(measured.row(vehicles)),
            Err(why) => failed.push(format!("{vehicles} agents: {why}")),
        }
    }
    print_table(&rows);
    failed.iter().for_each(|why| println!("{why}\n"));
    println!(
        "Overruns: steps that ended after the next frame was due, of all agents.\n\
         Jitter: the largest excess of the time between two frames, of each agent and second.\n\
         us per state delivered: all processor time of the agents, flight models, control and heartbeats included, \
         by the states sent times N - 1.\n\
         Losses: of peers that lived.\n"
    );
    match message_us() {
        Ok(message_us) => println!("A state delivered as `skein report --capacity` measures it: {message_us:.1} us.\n"),
        Err(why) => println!("skein report --capacity: {why}\n"),
    }
}

/// Flies once. Takes no longer than its deadlines.
///
/// # Errors
/// What the flight printed if it did not end well.
fn fly(vehicles: usize) -> Result<Measured, String> {
    let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
    let mut flight = Flight::start(folder.path(), vehicles, FLIGHT_S);
    let deadline = Instant::now() + Duration::from_secs(GATHER_S + FLIGHT_S + LAND_S);
    let measured = flight.observe(vehicles, deadline);
    let ended = flight.end(deadline);
    let figures = fs::read_to_string(folder.path().join("out/metrics.json")).ok();
    let figures = figures.and_then(|figures| serde_json::from_str(&figures).ok());
    let said = fs::read_to_string(folder.path().join("stderr")).unwrap_or_default();
    if measured.last.is_none() || figures.is_none() {
        let reason = said.lines().rfind(|line| !line.trim().is_empty()).unwrap_or("it printed no reason");
        return Err(if ended { reason.to_owned() } else { format!("the flight did not end in time; {reason}") });
    }
    Ok(Measured { figures, ..measured })
}

/// Processor time of a state between two of four sessions, us.
fn message_us() -> Result<f64, String> {
    let output = Command::new(PROGRAM).args(["report", "--capacity", "--json"]).stdin(Stdio::null()).output();
    let output = output.map_err(|error| error.to_string())?;
    let report: Value = serde_json::from_slice(&output.stdout).map_err(|error| error.to_string())?;
    report["measured"]["time"]["word_us"].as_f64().ok_or_else(|| "it measured no processor time".to_owned())
}

/// Whether the vehicle has left the ground.
pub(super) fn flies(health: &Health) -> bool {
    health.activity != Activity::Joining
}

/// A flight with all its processes, of which none outlives this value.
pub(super) struct Flight {
    fly: Child,
    folder: String,
    agents: BTreeSet<u32>,
}

impl Flight {
    /// Starts the flight of one ring.
    pub(super) fn start(folder: &Path, vehicles: usize, duration_s: u64) -> Self {
        let errors = File::create(folder.join("stderr")).expect("a file in the flight's folder");
        let mut command = Command::new(PROGRAM);
        command.args(["fly", "--anyway", "--json", "--out", "out", "--timeout", &GATHER_S.to_string()]);
        command.args(["--duration", &duration_s.to_string()]);
        one_ring(vehicles).iter().for_each(|set| _ = command.args(["--set", set]));
        // A runtime folder of its own keeps other swarms of this PC away.
        command.current_dir(folder).env("XDG_RUNTIME_DIR", folder.join("runtime")).env_remove("RUST_LOG");
        let fly = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(errors).spawn().expect("the flight starts");
        Self { fly, folder: folder.display().to_string(), agents: BTreeSet::new() }
    }

    /// Notes the agents' processes, until there is one for each vehicle.
    pub(super) fn find_agents(&mut self, vehicles: usize) {
        if self.agents.len() < vehicles {
            self.agents.extend(children_of(self.fly.id()));
        }
    }

    /// An observer of the swarm, as soon as there is one.
    pub(super) fn observer(&self) -> Option<Observer> {
        let found = endpoints::find(&Path::new(&self.folder).join("runtime/skein"), None).ok()?;
        Observer::open(&Reach::here(&found, Branch::SWARM)).ok()
    }

    /// Observes the flight until its measured part is over, it has ended, or the deadline has passed.
    fn observe(&mut self, vehicles: usize, deadline: Instant) -> Measured {
        let mut measured = Measured::default();
        let mut observer = None;
        let mut airborne = None;
        let mut reported = BTreeMap::new();
        while Instant::now() < deadline && self.fly.try_wait().is_ok_and(|ended| ended.is_none()) {
            sleep(Duration::from_millis(200));
            self.find_agents(vehicles);
            if observer.is_none() {
                observer = self.observer();
            }
            let Some(observer) = &mut observer else { continue };
            observer.poll();
            let ids = VehicleId::first(vehicles);
            let health: Vec<(&Health, Instant)> = ids.filter_map(|id| observer.health_of(id)).collect();
            if airborne.is_none() && health.len() == vehicles && health.iter().all(|(health, _)| flies(health)) {
                airborne = Some(Instant::now());
            }
            let Some(airborne) = airborne else { continue };
            let flown_s = airborne.elapsed().as_secs_f64();
            // The last second is left to the beginning of the landing.
            let end_s = (FLIGHT_S - 1) as f64;
            if flown_s < end_s - MEASURED_S as f64 {
                reported = health.iter().map(|(health, at)| (health.header.sender, *at)).collect();
                continue;
            }
            for (health, at) in &health {
                if reported.insert(health.header.sender, *at) != Some(*at) {
                    measured.jitter_ms.push(health.jitter_ms);
                    measured.step_p99_us.push(health.step_p99_us);
                }
            }
            let sample = self.sample(health.iter().map(|(health, _)| *health));
            measured.first.get_or_insert_with(|| sample.clone());
            measured.last = Some(sample);
            if flown_s > end_s {
                break;
            }
        }
        measured
    }

    fn sample<'a>(&self, health: impl Iterator<Item = &'a Health> + Clone) -> Sample {
        Sample {
            at: Instant::now(),
            agents_s: self.agents.iter().filter_map(|&pid| processor_time_s(pid)).sum(),
            fly_s: processor_time_s(self.fly.id()).unwrap_or(0.0),
            states: health.clone().map(|health| health.state_messages).sum(),
            overruns: health.map(|health| health.frame_overruns).sum(),
        }
    }

    /// Waits for the end; false if the deadline passed.
    fn end(&mut self, deadline: Instant) -> bool {
        while Instant::now() < deadline {
            if self.fly.try_wait().is_ok_and(|ended| ended.is_some()) {
                return true;
            }
            sleep(Duration::from_millis(100));
        }
        false
    }
}

impl Drop for Flight {
    fn drop(&mut self) {
        let _ = self.fly.kill();
        let _ = self.fly.wait();
        // `fly` leaves agents in the air to themselves. An agent's command line names a file in the flight's folder.
        let is_ours = |pid: &&u32| {
            fs::read_to_string(format!("/proc/{pid}/cmdline")).is_ok_and(|line| line.contains(&self.folder))
        };
        self.agents.iter().filter(is_ours).for_each(|&pid| os::end(pid, true));
    }
}

impl Measured {
    fn row(mut self, vehicles: usize) -> Vec<String> {
        let (Some(first), Some(last)) = (self.first, self.last) else { return vec![vehicles.to_string()] };
        let figure = |key: &str, digits: usize| {
            let value = self.figures.as_ref().and_then(|figures| figures[key].as_f64());
            value.map_or("-".to_owned(), |value| format!("{value:.digits$}"))
        };
        let seconds = last.at.duration_since(first.at).as_secs_f64();
        let (agents_s, states) = (last.agents_s - first.agents_s, (last.states - first.states) as f64);
        let share =
            |values: &mut Vec<f64>, part| quantile(values, part).map_or("-".to_owned(), |value| format!("{value:.1}"));
        vec![
            vehicles.to_string(),
            (last.overruns - first.overruns).to_string(),
            share(&mut self.jitter_ms, 0.5),
            share(&mut self.jitter_ms, 0.99),
            share(&mut self.step_p99_us, 0.99),
            format!("{:.1}", states / seconds / vehicles as f64),
            format!("{:.0}", agents_s * 1e6 / (states * (vehicles - 1) as f64)),
            format!("{:.2}", agents_s / seconds),
            format!("{:.2}", (last.fly_s - first.fly_s) / seconds),
            figure("peer_age_p50_ms", 0),
            figure("peer_age_p99_ms", 0),
            figure("false_suspicions", 0),
        ]
    }
}
