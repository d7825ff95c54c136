//! A swarm in the network of a test, observed through the logs of its agents and through an observer.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::Read;
use std::process::{Child, Stdio};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread::sleep;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use skein_cluster::mesh::observe::Observer;
use skein_cluster::mesh::reach::{Flown, Reach};
use skein_common::id::{SwarmName, VehicleId};
use tempfile::TempDir;

use super::network::{Network, Side};

const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");
/// Timeout of every wait.
const SOON: Duration = Duration::from_secs(60);
const DAY_S: f64 = 86_400.0;
/// Vehicles below this height do not count for the separation, m.
const AIRBORNE_M: f64 = 2.0;
/// Environment variable with the swarm's name and endpoints for the observer's process.
const WATCHED: &str = "SKEIN_WATCHED";
/// Beginning of the line that the observer's process prints at its end.
const ANSWER: &str = "least separation ";

/// A line of an agent's log.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Line {
    /// Time since the start of the swarm, by the computer's clock, s.
    pub(super) at_s: f64,
    pub(super) id: u8,
    pub(super) what: String,
}

pub(super) struct Swarm {
    agents: BTreeMap<u8, Child>,
    watcher: Child,
    began_s: f64,
    folder: TempDir,
    network: Network,
}

impl Swarm {
    /// Starts one agent on each of these sides, with ids from 1.
    pub(super) fn start(test: &str, scenario: &str, sides: &[Side]) -> Self {
        let network = Network::new(test, sides);
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("scenario.toml"), format!("name = \"{test}\"\n{scenario}")).unwrap();
        let ids = 1..=u8::try_from(sides.len()).unwrap();
        for id in ids.clone() {
            let dial: Vec<String> = (1..id).map(|other| format!("\"tcp/10.77.0.{other}:7447\"")).collect();
            let file = format!(
                "scenario = \"scenario.toml\"\nid = {id}\nlisten = [\"tcp/10.77.0.{id}:7447\", \"tcp/10.78.0.{id}:7447\"]\n\
                 dial = [{}]\n",
                dial.join(", ")
            );
            fs::write(folder.path().join(format!("{id}.toml")), file).unwrap();
        }
        let watched: Vec<String> = ids.clone().map(|id| format!("tcp/10.78.0.{id}:7447")).collect();
        let this = std::env::current_exe().unwrap();
        let mut watcher = network.command_of_watcher(this.to_str().unwrap());
        watcher
            .args(["--exact", "namespaces::watcher", "--ignored", "--nocapture"])
            .env(WATCHED, format!("{test} {}", watched.join(" ")));
        watcher.stdin(Stdio::piped()).stdout(Stdio::piped());
        let watcher = watcher.spawn().unwrap();
        let mut swarm = Self { agents: BTreeMap::new(), watcher, began_s: day_s(), folder, network };
        for id in ids {
            swarm.begin(id);
        }
        swarm
    }

    /// Kills an agent, and returns the time, s.
    pub(super) fn kill(&mut self, id: u8) -> f64 {
        let at_s = self.now_s();
        end(self.agents.get_mut(&id).unwrap());
        at_s
    }

    /// Restarts an agent, and returns the time, s.
    pub(super) fn restart(&mut self, id: u8) -> f64 {
        let at_s = self.now_s();
        self.begin(id);
        at_s
    }

    /// Cuts the left from the right side, or connects them again; returns the time, s.
    pub(super) fn cut(&self, cut: bool) -> f64 {
        let at_s = self.now_s();
        self.network.cut(cut);
        at_s
    }

    /// All lines of the agents' logs, in the order of time.
    pub(super) fn lines(&self) -> Vec<Line> {
        let text = |id: &u8| fs::read_to_string(self.log(*id)).unwrap();
        let mut lines: Vec<_> = self.agents.keys().map(text).flat_map(|text| self.parsed(&text)).collect();
        lines.sort_by(|one, other| one.at_s.total_cmp(&other.at_s));
        lines
    }

    /// Waits until `found` returns a value for the logged lines.
    pub(super) fn wait_for<T>(&self, what: &str, found: impl Fn(&[Line]) -> Option<T>) -> T {
        let until = Instant::now() + SOON;
        loop {
            let lines = self.lines();
            if let Some(found) = found(&lines) {
                return found;
            }
            assert!(Instant::now() < until, "timeout, they do not {what}: {lines:#?}");
            sleep(Duration::from_millis(50));
        }
    }

    /// The present step of each vehicle.
    pub(super) fn steps(&self) -> BTreeMap<u8, u32> {
        let mut steps = self.agents.keys().map(|id| (*id, 0)).collect();
        self.lines().iter().for_each(|line| take_step(&mut steps, line));
        steps
    }

    /// Time after `since_s` at which every vehicle had found all lost peers again and all were at the same step, s. One
    /// vehicle may be a step ahead: it left the step just before it received the others again, and waits for them at
    /// the next.
    pub(super) fn rejoined_s(lines: &[Line], since_s: f64) -> Option<f64> {
        let mut steps: BTreeMap<u8, u32> = lines.iter().map(|line| (line.id, 0)).collect();
        let mut lost = BTreeSet::new();
        for line in lines {
            take_step(&mut steps, line);
            if let Some(peer) = line.what.strip_prefix("lost contact with vehicle ") {
                lost.insert((line.id, peer.to_owned()));
            } else if let Some(peer) = line.what.strip_prefix("in contact with vehicle ") {
                lost.remove(&(line.id, peer.to_owned()));
            }
            let last = steps.values().copied().min().unwrap_or_default();
            let ahead: Vec<u32> = steps.values().map(|step| step - last).filter(|by| *by > 0).collect();
            if line.at_s >= since_s && lost.is_empty() && matches!(ahead[..], [] | [1]) {
                return Some(line.at_s);
            }
        }
        None
    }

    /// The least distance between two airborne vehicles so far, m. Ends the observer's process.
    pub(super) fn least_separation_m(&mut self) -> f64 {
        drop(self.watcher.stdin.take());
        let mut text = String::new();
        self.watcher.stdout.take().unwrap().read_to_string(&mut text).unwrap();
        let answer = text.lines().find_map(|line| line.strip_prefix(ANSWER));
        answer.unwrap_or_else(|| panic!("the observer printed {text:?}")).parse().unwrap()
    }

    fn begin(&mut self, id: u8) {
        let log = File::options().create(true).append(true).open(self.log(id)).unwrap();
        let mut command = self.network.command_of(id, PROGRAM);
        command.arg("agent").arg("--config").arg(self.folder.path().join(format!("{id}.toml")));
        command.env_remove("RUST_LOG");
        let agent = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(log).spawn().unwrap();
        self.agents.insert(id, agent);
    }

    fn log(&self, id: u8) -> std::path::PathBuf {
        self.folder.path().join(format!("{id}.log"))
    }

    fn now_s(&self) -> f64 {
        (day_s() - self.began_s).rem_euclid(DAY_S)
    }

    /// `2026-01-31T11:14:50.434371Z  INFO vehicle 2 reached step 1`
    fn parsed(&self, log: &str) -> Vec<Line> {
        let line = |line: &str| {
            let (stamp, rest) = line.split_once('Z')?;
            let (_, time) = stamp.split_once('T')?;
            let fields: Vec<f64> = time.split(':').map(str::parse).collect::<Result<_, _>>().ok()?;
            let &[hours, minutes, seconds] = fields.as_slice() else { return None };
            let at_s = (3600.0 * hours + 60.0 * minutes + seconds - self.began_s).rem_euclid(DAY_S);
            let (_severity, event) = rest.trim().split_once(' ')?;
            let (id, what) = event.trim().strip_prefix("vehicle ")?.split_once(' ')?;
            Some(Line { at_s, id: id.parse().ok()?, what: what.to_owned() })
        };
        log.lines().filter_map(line).collect()
    }
}

impl Drop for Swarm {
    /// Ends all processes before the network is removed, also of a failed test.
    fn drop(&mut self) {
        self.agents.values_mut().for_each(end);
        end(&mut self.watcher);
    }
}

fn end(process: &mut Child) {
    let _ = process.kill();
    let _ = process.wait();
}

/// Time since midnight by the computer's clock, s, as in the logs.
fn day_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64().rem_euclid(DAY_S)
}

fn take_step(steps: &mut BTreeMap<u8, u32>, line: &Line) {
    let forward = line.what.strip_prefix("skips forward").and_then(|rest| rest.rsplit_once("to step "));
    let to = forward.map(|(_, to)| to).or_else(|| line.what.strip_prefix("continues to step "));
    if let Some(to) = to.and_then(|to| to.split(' ').next()?.parse().ok()) {
        steps.insert(line.id, to);
    } else if line.what.starts_with("flies ") {
        // The agent was restarted.
        steps.insert(line.id, 0);
    }
}

/// The observer's process: observes until its input ends, then prints the least separation.
pub(super) fn watch() {
    let Ok(watched) = std::env::var(WATCHED) else { return };
    let mut fields = watched.split(' ').map(str::to_owned);
    let swarm = SwarmName::new(fields.next().unwrap()).unwrap();
    let agents = VehicleId::first(250).zip(fields).collect();
    let reach = Reach::plain(swarm, agents, Flown::Text(String::new()));
    let mut observer = Observer::open(&reach).unwrap();
    observer.subscribe_to_traces(true).unwrap();
    let is_over = std::sync::Arc::new(AtomicBool::new(false));
    let flag = is_over.clone();
    std::thread::spawn(move || {
        let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
        flag.store(true, Relaxed);
    });
    let mut least_m = f64::INFINITY;
    while !is_over.load(Relaxed) {
        sleep(Duration::from_millis(20));
        observer.poll();
        let now = Instant::now();
        let is_new = |at: Option<Instant>| at.is_some_and(|at| now.duration_since(at) < Duration::from_millis(200));
        let seen =
            observer.vehicles().values().filter(|seen| is_new(seen.trace_at)).filter_map(|seen| seen.trace.as_ref());
        let places: Vec<_> = seen.filter(|trace| trace.height_m > AIRBORNE_M).map(|trace| trace.position).collect();
        for (nth, one) in places.iter().enumerate() {
            let distances_m = places[nth + 1..].iter().map(|other| (*one - *other).norm());
            least_m = distances_m.fold(least_m, f64::min);
        }
    }
    println!("\n{ANSWER}{least_m}");
}
