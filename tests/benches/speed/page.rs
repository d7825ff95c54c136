//! What the page of `skein view` costs the agents that it shows: their steps without a page, with five pages and under hostile
//! clients, by turns in one flight. And what the page's server takes of a processor.

#![expect(clippy::disallowed_methods, reason = "a flight in real time takes real time")]

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread::{self, JoinHandle, sleep};
use std::time::{Duration, Instant};

use skein_cluster::mesh::observe::Observer;
use skein_cluster::os;
use skein_common::id::VehicleId;
use skein_common::message::Health;
use skein_common::statistics::quantile;
use skein_tests::hostile_pages::HostileClients;
use skein_tests::page_client::{Received, Socket};
use skein_tests::processes::processor_time_s;

use crate::live::{Flight, PROGRAM, flies};
use crate::{print_table, row};

/// Number of agents whose steps are compared, and of those that the server of the page shows while it is measured.
const COMPARED: usize = 8;
const SHOWN: usize = 50;
/// Number of pages.
const PAGES: usize = 5;
/// Number of times that each spell is measured.
const REPEATS: usize = 10;
/// How long the agents may take to be in the air, and how long they fly before the first spell, s.
const GATHER_S: u64 = 90;
const WARM_UP_S: u64 = 15;
/// Length of a spell, and of its beginning that is not measured: reports then still are of the time before, s.
const SPELL_S: u64 = 8;
const SETTLE_S: u64 = 2;
/// Longest flight, s: it is ended when everything has been measured.
const FLIGHT_S: u64 = 3600;
/// Largest difference of the steps' 99th percentile with five pages: the larger of this share and this time.
const STEP_SHARE: f64 = 0.1;
const STEP_US: f64 = 100.0;
/// Largest share of a core that the server of the page takes.
const SERVER_SHARE: f64 = 0.15;

/// What is connected to the server of the page.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Clients {
    None,
    Pages,
    Hostile,
}

impl Clients {
    const ALL: [Self; 3] = [Self::None, Self::Pages, Self::Hostile];

    fn name(self) -> String {
        match self {
            Self::None => "none".to_owned(),
            Self::Pages => format!("{PAGES} pages"),
            Self::Hostile => "hostile clients".to_owned(),
        }
    }
}

/// What was measured in one spell.
#[derive(Clone, Copy, Debug)]
struct Spell {
    /// Median of the 99th percentiles of the steps of each agent and second, us.
    step_p99_us: f64,
    /// Steps of all agents that ended after the next frame was due.
    overruns: u64,
    /// Share of a core that the server of the page took.
    server: f64,
}

/// Prints the table, and whether the limits are kept.
pub(super) fn print() {
    println!(
        "The page of `skein view` on this PC ({} cores). Agents at 50 Hz, built-in plant, one ring; the server runs all the time.\n\
         {REPEATS} spells of {SPELL_S} s each, by turns; medians of the spells.\n",
        os::cores()
    );
    let mut rows = vec![row([
        "agents",
        "clients of the page",
        "step p99 us",
        "more than without us",
        "late steps",
        "server, cores",
    ])];
    let spells = measure(COMPARED, &Clients::ALL, REPEATS);
    let without = spells.get(&Clients::None).cloned().unwrap_or_default();
    let mut more_us = BTreeMap::new();
    for (clients, spells) in &spells {
        let differences = spells.iter().zip(&without).map(|(one, other)| one.step_p99_us - other.step_p99_us);
        more_us.insert(*clients, median(differences));
        rows.push(cells(COMPARED, *clients, spells, more_us[clients]));
    }
    let shown = measure(SHOWN, &[Clients::Pages], 3);
    shown.iter().for_each(|(clients, spells)| rows.push(cells(SHOWN, *clients, spells, None)));
    print_table(&rows);
    println!("Step p99: of each agent and second, the median of all. Late steps: of all agents in all spells.\n");

    let step_us = median(without.iter().map(|spell| spell.step_p99_us)).unwrap_or(f64::NAN);
    let allowed_us = STEP_US.max(STEP_SHARE * step_us);
    let pages_us = more_us.get(&Clients::Pages).copied().flatten().unwrap_or(f64::NAN);
    let server = shown.get(&Clients::Pages).and_then(|spells| median(spells.iter().map(|spell| spell.server)));
    let server = server.unwrap_or(f64::NAN);
    let is_kept = pages_us < allowed_us && server < SERVER_SHARE;
    println!(
        "Limits: step p99 with {PAGES} pages at most {allowed_us:.0} us more; server of {SHOWN} agents below {SERVER_SHARE} of a core: \
         {}",
        if is_kept { "kept" } else { "NOT kept" }
    );
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    quantile(&mut values.collect::<Vec<f64>>(), 0.5)
}

fn cells(agents: usize, clients: Clients, spells: &[Spell], more_us: Option<f64>) -> Vec<String> {
    let middle = |figure: fn(&Spell) -> f64| median(spells.iter().map(figure)).unwrap_or(f64::NAN);
    let more = match (clients, more_us) {
        (Clients::None, _) | (_, None) => "-".to_owned(),
        (_, Some(more_us)) => format!("{more_us:+.1}"),
    };
    vec![
        agents.to_string(),
        clients.name(),
        format!("{:.1}", middle(|spell| spell.step_p99_us)),
        more,
        spells.iter().map(|spell| spell.overruns).sum::<u64>().to_string(),
        format!("{:.3}", middle(|spell| spell.server)),
    ]
}

/// Flies this many agents and measures each kind of clients `repeats` times, by turns.
fn measure(agents: usize, kinds: &[Clients], repeats: usize) -> BTreeMap<Clients, Vec<Spell>> {
    let folder = tempfile::tempdir().expect("a folder for the flight");
    let mut flight = Flight::start(folder.path(), agents, FLIGHT_S);
    let mut observer = in_the_air(&mut flight, agents);
    let server = PageServer::start(folder.path());
    sleep(Duration::from_secs(WARM_UP_S));
    let mut measured: BTreeMap<Clients, Vec<Spell>> = BTreeMap::new();
    for repeat in 0..repeats {
        eprintln!("{agents} agents, spell {} of {repeats}", repeat + 1);
        // Another one is first each time: what drifts affects all alike.
        for nth in 0..kinds.len() {
            let clients = kinds[(nth + repeat) % kinds.len()];
            measured.entry(clients).or_default().push(spell(agents, clients, &server, &mut observer));
        }
    }
    measured
}

/// Waits until all vehicles have left the ground.
fn in_the_air(flight: &mut Flight, agents: usize) -> Observer {
    let until = Instant::now() + Duration::from_secs(GATHER_S);
    let mut observer = None;
    loop {
        assert!(Instant::now() < until, "the vehicles do not take off");
        sleep(Duration::from_millis(200));
        flight.find_agents(agents);
        if observer.is_none() {
            observer = flight.observer();
        }
        let Some(mut found) = observer.take() else { continue };
        found.poll();
        let flying = VehicleId::first(agents).filter_map(|id| found.health_of(id)).filter(|(health, _)| flies(health));
        if flying.count() == agents {
            return found;
        }
        observer = Some(found);
    }
}

fn spell(agents: usize, clients: Clients, server: &PageServer, observer: &mut Observer) -> Spell {
    let connected = Connected::begin(clients, server.address);
    let begin = Instant::now();
    let mut reported: BTreeMap<VehicleId, Instant> = BTreeMap::new();
    let mut steps_us = Vec::new();
    let (mut first, mut last) = (None, None);
    while begin.elapsed() < Duration::from_secs(SPELL_S) {
        sleep(Duration::from_millis(100));
        observer.poll();
        let health: Vec<(&Health, Instant)> =
            VehicleId::first(agents).filter_map(|id| observer.health_of(id)).collect();
        let is_settled = begin.elapsed() >= Duration::from_secs(SETTLE_S);
        for (health, at) in &health {
            if reported.insert(health.header.sender, *at) != Some(*at) && is_settled {
                steps_us.push(health.step_p99_us);
            }
        }
        if is_settled {
            let overruns: u64 = health.iter().map(|(health, _)| health.frame_overruns).sum();
            let sample = (Instant::now(), overruns, server.processor_time_s());
            first.get_or_insert(sample);
            last = Some(sample);
        }
    }
    connected.end();
    let (Some(first), Some(last)) = (first, last) else { unreachable!("a spell is longer than its beginning") };
    Spell {
        step_p99_us: median(steps_us.into_iter()).expect("reports of the agents"),
        overruns: last.1 - first.1,
        server: (last.2 - first.2) / last.0.duration_since(first.0).as_secs_f64(),
    }
}

/// The clients of a spell.
enum Connected {
    None,
    Pages { is_over: Arc<AtomicBool>, pages: Vec<JoinHandle<()>> },
    Hostile(HostileClients),
}

impl Connected {
    fn begin(clients: Clients, address: SocketAddr) -> Self {
        match clients {
            Clients::None => Self::None,
            Clients::Hostile => Self::Hostile(HostileClients::begin(address)),
            Clients::Pages => {
                let is_over = Arc::new(AtomicBool::new(false));
                let page = || {
                    let ends = Arc::clone(&is_over);
                    thread::spawn(move || {
                        let mut page = Socket::open(address);
                        while !ends.load(Relaxed) {
                            assert!(!matches!(page.receive(), Received::Closed), "the server has closed a page");
                        }
                    })
                };
                let pages = (0..PAGES).map(|_| page()).collect();
                Self::Pages { is_over, pages }
            }
        }
    }

    fn end(self) {
        match self {
            Self::None => {}
            Self::Hostile(clients) => _ = clients.end(),
            Self::Pages { is_over, pages } => {
                is_over.store(true, Relaxed);
                pages.into_iter().for_each(|page| page.join().expect("a page that is served to the end"));
            }
        }
    }
}

/// A running `skein view`, killed at the end.
struct PageServer {
    child: Child,
    address: SocketAddr,
}

impl PageServer {
    fn start(folder: &Path) -> Self {
        let log = File::create(folder.join("view.log")).expect("a file in the flight's folder");
        let mut command = Command::new(PROGRAM);
        command.args(["view", "--listen", "127.0.0.1:0"]).current_dir(folder).env_remove("RUST_LOG");
        command.env("XDG_RUNTIME_DIR", folder.join("runtime")).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(log);
        let mut child = command.spawn().expect("the page is served");
        let mut line = String::new();
        let printed = child.stdout.take().expect("a pipe");
        BufReader::new(printed).read_line(&mut line).expect("the address of the page");
        let address =
            line.trim().strip_prefix("http://").and_then(|at| at.parse().ok()).expect("the address of the page");
        Self { child, address }
    }

    fn processor_time_s(&self) -> f64 {
        processor_time_s(self.child.id()).expect("the page is served to the end")
    }
}

impl Drop for PageServer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
