//! A swarm that flies for hours over stand-ins while agents are killed and restarted, links are cut, simulators freeze, orders
//! are given and observers come and go. What must stay constant is measured: memory, descriptors and threads of every process,
//! and the ages of the messages that the agents act on.
#![expect(clippy::unwrap_used, reason = "what a test cannot do has failed")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use rand_chacha::ChaCha8Rng;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use skein_core::random::{self, Purpose};

use crate::processes::{Resources, children_of, command_of, resources};

/// Commands that the program `soak` passes on to `skein`: the flight starts this program again.
pub const SKEIN_COMMANDS: [&str; 5] = ["fly", "agent", "xplane", "status", "view"];

const VEHICLES: u8 = 8;
/// Vehicles from 1 to this one keep their agents: a process that is never killed shows what grows.
const NEVER_KILLED: u8 = 2;
/// Time from one event to the next, s.
const EVENTS_APART_S: [f64; 2] = [15.0, 40.0];
/// Time without events at the beginning and at the end of the flight, s.
const QUIET_S: f64 = 60.0;
/// Time from one measurement to the next.
const MEASURED_EVERY: Duration = Duration::from_secs(20);
/// Time that the landing and the figures take beyond the flight.
const ENDS_WITHIN: Duration = Duration::from_secs(300);
/// Growth of memory below which a process counts as constant, MB an hour, over the second half of the flight.
const MOST_MB_PER_H: f64 = 2.0;
/// The same of `fly`, whose recording keeps its index in memory until its end.
const MOST_OF_FLY_MB_PER_H: f64 = 20.0;
/// Descriptors and threads by which the last quarter's most may exceed those of the first half.
const MOST_MORE: usize = 4;

/// One measurement of one process.
#[derive(Clone, Copy, Debug)]
struct Sample {
    t_s: f64,
    of: Resources,
}

/// The flight and what was measured of it.
#[derive(Debug)]
struct Soak {
    folder: PathBuf,
    program: PathBuf,
    fly: Child,
    draws: ChaCha8Rng,
    observers: Vec<(Child, Instant)>,
    /// By the name of the process: `fly`, `agent 3`, `stand-in 3`; with its process, because a restarted agent begins anew.
    samples: BTreeMap<(String, u32), Vec<Sample>>,
    /// Time, s, and greatest age of a message, ms, as `skein status` prints it.
    ages: Vec<(f64, f64)>,
    counts: BTreeMap<&'static str, usize>,
}

fn between(draws: &mut ChaCha8Rng, [from, to]: [f64; 2]) -> f64 {
    from + (to - from) * random::uniform(draws)
}

fn whole(draws: &mut ChaCha8Rng, from: u8, to: u8) -> u8 {
    between(draws, [f64::from(from), f64::from(to) + 1.0]) as u8
}

/// One random event of the scenario at this time.
fn event(draws: &mut ChaCha8Rng, at_s: f64) -> String {
    let vehicle = whole(draws, NEVER_KILLED + 1, VEHICLES);
    let what = match whole(draws, 0, 6) {
        0 | 1 => format!("fault = \"kill\", vehicle = {vehicle}, for_s = {:.0}", between(draws, [5.0, 20.0])),
        2 => format!("fault = \"simulator_freeze\", vehicle = {vehicle}, for_s = {:.1}", between(draws, [0.5, 4.0])),
        3 => {
            let (some, rest): (Vec<u8>, Vec<u8>) =
                (1..=VEHICLES).partition(|&id| id == vehicle || between(draws, [0.0, 1.0]) < 0.3);
            let both_ways = between(draws, [0.0, 1.0]) < 0.7;
            let for_s = between(draws, [3.0, 20.0]);
            format!("fault = \"cut\", from = {some:?}, to = {rest:?}, both_ways = {both_ways}, for_s = {for_s:.0}")
        }
        4 => format!("order = \"hold\", for_s = {:.0}", between(draws, [5.0, 15.0])),
        5 => format!("order = \"set\", key = \"formation.radius_m\", value = {:.0}", between(draws, [80.0, 110.0])),
        _ => format!("order = \"set\", key = \"formation.altitude_m\", value = {:.0}", between(draws, [25.0, 45.0])),
    };
    format!("  {{ at_s = {at_s:.1}, {what} }},\n")
}

/// The scenario of a flight of this many seconds.
fn scenario(seed: u64, duration_s: f64, draws: &mut ChaCha8Rng) -> String {
    let mut events = String::new();
    let mut at_s = QUIET_S;
    while at_s < duration_s - QUIET_S {
        events += &event(draws, at_s);
        at_s += between(draws, EVENTS_APART_S);
    }
    format!(
        "name = \"soak\"\nseed = {seed}\nduration_s = {duration_s}\nswarm.name = \"soak\"\nswarm.vehicles = {VEHICLES}\n\
         swarm.plant = \"standin\"\nformation.radius_m = 95\n[mission]\nevents = [\n{events}]\n"
    )
}

/// Flies for so many hours, and returns the table and whether everything stayed constant. `folder` is for what is written.
///
/// # Panics
/// If the flight cannot begin, or ends before its time.
pub fn fly(program: &Path, folder: &Path, hours: f64, seed: u64) -> (String, bool) {
    let mut draws = random::generator(seed, None, Purpose::Study);
    let duration_s = (hours * 3600.0).round();
    fs::write(folder.join("soak.toml"), scenario(seed, duration_s, &mut draws)).unwrap();
    let log = File::create(folder.join("fly.log")).unwrap();
    let mut command = skein(program, folder);
    command.args(["fly", "soak.toml", "--out", "out", "--no-view"]).stdout(log.try_clone().unwrap()).stderr(log);
    let mut soak = Soak {
        folder: folder.to_owned(),
        program: program.to_owned(),
        fly: command.spawn().unwrap(),
        draws,
        observers: Vec::new(),
        samples: BTreeMap::new(),
        ages: Vec::new(),
        counts: BTreeMap::new(),
    };
    let begin = Instant::now();
    let end = begin + Duration::from_secs_f64(duration_s);
    sleep(Duration::from_secs_f64(QUIET_S / 2.0));
    let mut reported = begin;
    while Instant::now() < end {
        assert!(
            soak.fly.try_wait().unwrap().is_none(),
            "the flight ended early: see {}",
            folder.join("fly.log").display()
        );
        soak.measure(begin.elapsed().as_secs_f64());
        soak.observe();
        if reported.elapsed() > Duration::from_secs(600) {
            reported = Instant::now();
            eprintln!("{}", soak.line(begin.elapsed().as_secs_f64() - 600.0));
        }
        sleep(MEASURED_EVERY);
    }
    soak.observers.iter_mut().for_each(|(child, _)| end_now(child));
    let status = loop {
        if let Some(status) = soak.fly.try_wait().unwrap() {
            break status;
        }
        assert!(end.elapsed() < ENDS_WITHIN, "the flight does not end: see {}", folder.join("fly.log").display());
        sleep(Duration::from_secs(1));
    };
    soak.table(duration_s, status.code())
}

/// A command of `skein` in the folder of the flight.
fn skein(program: &Path, folder: &Path) -> Command {
    let mut command = Command::new(program);
    command.env("XDG_RUNTIME_DIR", folder.join("runtime")).env_remove("RUST_LOG").current_dir(folder);
    command.stdin(Stdio::null());
    command
}

fn end_now(child: &mut Child) {
    let _ = child.kill();
    let _ = child.wait();
}

impl Soak {
    fn count(&mut self, what: &'static str) {
        *self.counts.entry(what).or_default() += 1;
    }

    /// Measures every process, and what `skein status` prints.
    fn measure(&mut self, t_s: f64) {
        let fly = self.fly.id();
        let named = children_of(fly).into_iter().filter_map(|pid| Some((name(&command_of(pid)?)?, pid)));
        for (name, pid) in named.chain([("fly".to_owned(), fly)]) {
            if let Some(of) = resources(pid) {
                self.samples.entry((name, pid)).or_default().push(Sample { t_s, of });
            }
        }
        let printed =
            skein(&self.program, &self.folder).args(["status", "--json"]).stderr(Stdio::null()).output().unwrap();
        self.count("status");
        let Ok(status) = serde_json::from_slice::<Value>(&printed.stdout) else {
            return self.count("status without an answer");
        };
        let ages =
            status["nodes"].as_array().into_iter().flatten().filter_map(|node| node["said"]["peer_age_ms"].as_f64());
        self.ages.push((t_s, ages.fold(0.0, f64::max)));
    }

    /// Starts an observer now and then, and ends others: some at once, and some do not read for a while before.
    fn observe(&mut self) {
        if self.observers.len() < 3 && between(&mut self.draws, [0.0, 1.0]) < 0.5 {
            let mut command = skein(&self.program, &self.folder);
            command.args(["view", "--listen", "127.0.0.1:7490"]).stdout(Stdio::null()).stderr(Stdio::null());
            let stays_s = between(&mut self.draws, [10.0, 120.0]);
            self.observers.push((command.spawn().unwrap(), Instant::now() + Duration::from_secs_f64(stays_s)));
            self.count("page served");
            sleep(Duration::from_secs(2));
            if let Ok(mut page) = TcpStream::connect("127.0.0.1:7490") {
                let _ = page.set_read_timeout(Some(Duration::from_secs(2)));
                let _ = page.write_all(b"GET / HTTP/1.1\r\nHost: 127.0.0.1:7490\r\nConnection: close\r\n\r\n");
                let mut text = Vec::new();
                let _ = page.take(1 << 20).read_to_end(&mut text);
                if text.starts_with(b"HTTP/1.1 200") {
                    self.count("page opened");
                }
            }
            if between(&mut self.draws, [0.0, 1.0]) < 0.3 {
                let stopped = self.observers.last().map(|(child, _)| child.id());
                let pid = stopped.and_then(|pid| Pid::from_raw(i32::try_from(pid).ok()?));
                let _ = pid.map(|pid| kill_process(pid, Signal::STOP));
                self.count("observer stopped");
            }
        }
        let now = Instant::now();
        let (mut gone, staying): (Vec<_>, Vec<_>) = self.observers.drain(..).partition(|(_, until)| *until < now);
        self.observers = staying;
        for (child, _) in &mut gone {
            end_now(child);
            *self.counts.entry("observer killed").or_default() += 1;
        }
    }

    /// Processes of one kind, such as `agent`, that were measured after this time.
    fn of(&self, kind: &str, after_s: f64) -> impl Iterator<Item = &Sample> {
        let of_kind = self.samples.iter().filter(move |((name, _), _)| name.starts_with(kind));
        of_kind.flat_map(|(_, samples)| samples).filter(move |sample| sample.t_s >= after_s)
    }

    /// Ten minutes of the flight: the most that a process of each kind had.
    fn line(&self, from_s: f64) -> String {
        let mut line = format!("{:>6.0} min", from_s / 60.0);
        for kind in ["agent", "fly", "stand-in"] {
            let until_s = from_s + 600.0;
            let samples = || self.of(kind, from_s).filter(move |sample| sample.t_s < until_s);
            let most = |value: fn(&Resources) -> f64| samples().map(|sample| value(&sample.of)).fold(0.0, f64::max);
            let [memory_mb, descriptors, threads] =
                [most(|of| of.memory_mb), most(|of| of.descriptors as f64), most(|of| of.threads as f64)];
            line += &format!("  {memory_mb:>9.1} {descriptors:>5.0} {threads:>5.0}");
        }
        let ages = self.ages.iter().filter(|(t_s, _)| (from_s..from_s + 600.0).contains(t_s));
        line + &format!("  {:>8.0}", ages.map(|(_, age_ms)| *age_ms).fold(0.0, f64::max))
    }

    /// Writes every measurement into `resources.csv`.
    fn write_samples(&self) {
        let mut csv = "t_s,process,pid,memory_mb,descriptors,threads\n".to_owned();
        for ((name, pid), samples) in &self.samples {
            for Sample { t_s, of: Resources { memory_mb, descriptors, threads } } in samples {
                csv += &format!("{t_s:.0},{name},{pid},{memory_mb:.1},{descriptors},{threads}\n");
            }
        }
        fs::write(self.folder.join("resources.csv"), csv).unwrap();
    }

    /// The table of the whole flight, and whether everything stayed constant.
    fn table(&self, duration_s: f64, status: Option<i32>) -> (String, bool) {
        let mut text = format!(
            "{:>10}  {:>9} {:>5} {:>5}  {:>9} {:>5} {:>5}  {:>9} {:>5} {:>5}  {:>8}\n",
            "from",
            "agent MB",
            "files",
            "threads",
            "fly MB",
            "files",
            "threads",
            "stand-in",
            "files",
            "threads",
            "age ms"
        );
        for tenth in 0..(duration_s / 600.0).ceil() as u32 {
            text += &(self.line(f64::from(tenth) * 600.0) + "\n");
        }
        self.write_samples();
        let mut faults = Vec::new();
        // A status, a page and an agent that is killed had one session with each agent, of which Zenoh keeps some kB.
        let script = fs::read_to_string(self.folder.join("soak.toml")).unwrap();
        let given = |what: &str| script.matches(&format!("= \"{what}\"")).count();
        let sessions =
            given("kill") + ["status", "page served"].iter().filter_map(|what| self.counts.get(what)).sum::<usize>();
        let all_the_time = |samples: &[Sample]| samples.first().is_some_and(|first| first.t_s < duration_s / 4.0);
        let lasting = self.samples.iter().filter(|(_, samples)| {
            all_the_time(samples) && samples.last().is_some_and(|last| last.t_s > duration_s * 0.9)
        });
        text += "\nprocesses from the beginning to the end: growth in the second half\n";
        for ((name, _), samples) in lasting {
            let growth = mb_per_h(samples.iter().filter(|sample| sample.t_s > duration_s / 2.0));
            text += &format!("{name:<12} {growth:>7.2} MB/h\n");
            let most = |range: [f64; 2], value: fn(&Resources) -> usize| {
                let within = samples.iter().filter(|sample| (range[0]..range[1]).contains(&(sample.t_s / duration_s)));
                within.map(|sample| value(&sample.of)).max().unwrap_or(0)
            };
            if growth > if name == "fly" { MOST_OF_FLY_MB_PER_H } else { MOST_MB_PER_H } {
                faults.push(format!("{name}: memory grows by {growth:.2} MB/h"));
            }
            for (what, value) in
                [("descriptors", (|of| of.descriptors) as fn(&Resources) -> usize), ("threads", |of| of.threads)]
            {
                let (first, last) = (most([0.0, 0.5], value), most([0.75, 1.0], value));
                if last > first + MOST_MORE {
                    faults.push(format!("{name}: {first} {what} in the first half, {last} at the end"));
                }
            }
        }
        text += "\n";
        for what in ["kill", "simulator_freeze", "cut", "hold", "set"] {
            text += &format!("{what:<26} {:>5}\n", given(what));
        }
        text += &format!("{:<26} {sessions:>5}\n", "sessions ended");
        for (what, count) in &self.counts {
            text += &format!("{what:<26} {count:>5}\n");
        }
        let metrics: Value = fs::read_to_string(self.folder.join("out/metrics.json"))
            .ok()
            .and_then(|text| serde_json::from_str(&text).ok())
            .unwrap_or_default();
        for figure in ["collisions", "min_separation_m", "frame_overruns", "step_p99_us", "peer_age_p99_ms"] {
            text += &format!("{figure:<26} {:>5}\n", metrics[figure]);
        }
        if metrics["collisions"].as_f64() != Some(0.0) {
            faults.push(format!("collisions: {}", metrics["collisions"]));
        }
        if status != Some(0) {
            faults.push(format!("skein fly ended with {status:?}"));
        }
        let is_constant = faults.is_empty();
        text += &if is_constant { "\nconstant\n".to_owned() } else { format!("\nFAILED\n{}\n", faults.join("\n")) };
        (text, is_constant)
    }
}

impl Drop for Soak {
    fn drop(&mut self) {
        self.observers.iter_mut().for_each(|(child, _)| end_now(child));
        for pid in children_of(self.fly.id()) {
            let _ = pid.try_into().ok().and_then(Pid::from_raw).map(|pid| kill_process(pid, Signal::KILL));
        }
        end_now(&mut self.fly);
    }
}

/// The name of a process that `fly` has started.
fn name(command: &[String]) -> Option<String> {
    let after = |option: &str| Some(command.get(command.iter().position(|argument| argument == option)? + 1)?.clone());
    match command.get(1)?.as_str() {
        "agent" => Some(format!("agent {}", Path::new(&after("--config")?).file_stem()?.to_str()?)),
        "xplane" => Some(format!("stand-in {}", after("--id")?)),
        _ => None,
    }
}

/// Growth of memory by the line of least squares, MB an hour.
fn mb_per_h<'a>(samples: impl Iterator<Item = &'a Sample> + Clone) -> f64 {
    let count = samples.clone().count().max(1) as f64;
    let mean = |value: fn(&Sample) -> f64| samples.clone().map(value).sum::<f64>() / count;
    let (mean_s, mean_mb) = (mean(|sample| sample.t_s), mean(|sample| sample.of.memory_mb));
    let sum = |value: &dyn Fn(f64, f64) -> f64| {
        samples.clone().map(|sample| value(sample.t_s - mean_s, sample.of.memory_mb - mean_mb)).sum::<f64>()
    };
    let spread = sum(&|s, _| s * s);
    if spread > 0.0 { sum(&|s, mb| s * mb) / spread * 3600.0 } else { 0.0 }
}
