//! Ten X-Planes and the ten agents of them on one PC, with a process of a stand-in for each X-Plane. The stand-ins are on
//! this PC too, because a stand-in answers only programs of its own PC.
#![expect(clippy::unwrap_used, reason = "what a test cannot do has failed")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use crate::processes::{children_of, processor_time_s};

/// Number of X-Planes.
pub const X_PLANES: u16 = 10;
/// UDP port of the first stand-in, outside the range from which the system chooses ports. The others are not in the row that
/// `--xplane` makes of one port.
const FIRST_PORT: u16 = 17_800;
const PORTS_APART: u16 = 7;
/// Time from the start of the flight until the load is measured: all vehicles are in the air, s.
const BEFORE: Duration = Duration::from_secs(25);
/// Time until all agents have ended, beyond the duration of the flight.
const ENDS_WITHIN: Duration = Duration::from_secs(180);

/// The cores on which the processes run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cores {
    /// All processes on all cores.
    Shared,
    /// The stand-ins on core 0, `skein fly` and the agents on core 1, as if the stand-ins were on another PC. Needs `taskset`.
    Apart,
}

impl Cores {
    /// The command that runs the program on this core.
    fn command(self, program: &Path, core: u8) -> Command {
        match self {
            Self::Shared => Command::new(program),
            Self::Apart => {
                // It replaces itself by the program, so that the process id is the program's.
                let mut command = Command::new("taskset");
                command.args(["--cpu-list", &core.to_string()]).arg(program);
                command
            }
        }
    }
}

/// The PC's processes.
#[derive(Debug)]
pub struct OnePc {
    program: PathBuf,
    cores: Cores,
    folder: PathBuf,
    simulators: Vec<Child>,
    fly: Option<Child>,
    agents: Vec<u32>,
}

/// What a flight took of its PC.
#[derive(Clone, Copy, Debug)]
pub struct Load {
    /// Cores that the ten agents use.
    pub agents_cores: f64,
    /// Cores that `skein fly` uses, which observes them.
    pub fly_cores: f64,
}

impl OnePc {
    /// Starts the stand-ins. All aircraft stand at one place. `folder` is for what is written.
    ///
    /// # Panics
    /// If a process cannot be had.
    pub fn start(program: &Path, folder: &Path, cores: Cores) -> Self {
        let simulator = |nth: u16| {
            let port = (FIRST_PORT + PORTS_APART * nth).to_string();
            let mut command = cores.command(program, 0);
            command.args(["xplane", "standin", "--port", &port, "--beacon", "false"]).env_remove("RUST_LOG");
            command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
        };
        let simulators = (0..X_PLANES).map(simulator).collect();
        let (program, folder) = (program.to_owned(), folder.to_owned());
        Self { program, cores, folder, simulators, fly: None, agents: Vec::new() }
    }

    /// The addresses of the X-Planes.
    pub fn x_planes() -> Vec<String> {
        (0..X_PLANES).map(|nth| format!("127.0.0.1:{}", FIRST_PORT + PORTS_APART * nth)).collect()
    }

    /// A command of `skein` on the PC.
    pub fn command(&self, verb: &str) -> Command {
        let mut command = self.cores.command(&self.program, 1);
        command.env("XDG_RUNTIME_DIR", self.folder.join("runtime")).env_remove("RUST_LOG");
        command.current_dir(&self.folder).arg(verb).stdin(Stdio::null());
        command
    }

    /// Flies the ring of ten for this time, and measures the load until the flight is over. The landing has then begun.
    ///
    /// # Panics
    /// If the flight does not begin, or ends otherwise.
    pub fn fly(&mut self, duration_s: u64) -> (Load, Value) {
        let mut command = self.command("fly");
        command.args(["--xplane", &Self::x_planes().join(","), "--duration", &duration_s.to_string(), "--out", "out"]);
        command.args(["--set", &format!("swarm.vehicles={X_PLANES}"), "--set", "swarm.name=onepc"]);
        let log = File::create(self.folder.join("fly.log")).unwrap();
        let fly = command.stdout(log.try_clone().unwrap()).stderr(log).spawn().unwrap();
        let pid = fly.id();
        self.fly = Some(fly);
        sleep(BEFORE);
        self.agents = children_of(pid);
        assert_eq!(self.agents.len(), usize::from(X_PLANES), "{}", self.log());
        let used_s = |pids: &[u32]| pids.iter().filter_map(|&pid| processor_time_s(pid)).sum::<f64>();
        let (begin, before) = (Instant::now(), [used_s(&self.agents), used_s(&[pid])]);
        let figures = self.folder.join("out/metrics.json");
        let until = begin + Duration::from_secs(duration_s) + ENDS_WITHIN;
        let metrics = loop {
            assert!(Instant::now() < until && self.runs(), "{}", self.log());
            let read = fs::read_to_string(&figures).ok().and_then(|text| serde_json::from_str(&text).ok());
            if let Some(metrics) = read {
                break metrics;
            }
            sleep(Duration::from_millis(100));
        };
        let seconds = begin.elapsed().as_secs_f64();
        let load = Load {
            agents_cores: (used_s(&self.agents) - before[0]) / seconds,
            fly_cores: (used_s(&[pid]) - before[1]) / seconds,
        };
        (load, metrics)
    }

    /// The PC dies: `fly` and all agents end at once, in the air.
    ///
    /// # Panics
    /// If nothing flies.
    pub fn die(&mut self) {
        let mut fly = self.fly.take().expect("a flight");
        fly.kill().unwrap();
        self.agents.drain(..).for_each(kill);
        fly.wait().unwrap();
    }

    /// Waits until all vehicles have landed and all agents have ended; the exit status and the output of the flight.
    ///
    /// # Panics
    /// If nothing flies.
    pub fn end(&mut self) -> (Option<i32>, String) {
        let status = self.fly.take().expect("a flight").wait().unwrap();
        self.agents.clear();
        (status.code(), self.log())
    }

    fn runs(&mut self) -> bool {
        self.fly.as_mut().is_some_and(|fly| fly.try_wait().is_ok_and(|ended| ended.is_none()))
    }

    fn log(&self) -> String {
        fs::read_to_string(self.folder.join("fly.log")).unwrap_or_default()
    }
}

impl Drop for OnePc {
    fn drop(&mut self) {
        if let Some(mut fly) = self.fly.take() {
            self.agents.extend(children_of(fly.id()));
            let _ = fly.kill();
            let _ = fly.wait();
        }
        self.agents.drain(..).for_each(kill);
        for simulator in &mut self.simulators {
            let _ = simulator.kill();
            let _ = simulator.wait();
        }
    }
}

fn kill(pid: u32) {
    // An error means that the process has ended meanwhile.
    let _ = pid.try_into().ok().and_then(Pid::from_raw).map(|pid| kill_process(pid, Signal::KILL));
}

/// The output of a command, as text.
pub fn printed(output: &Output) -> String {
    [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned()).concat()
}

/// Flies the ring of ten for 130 s on a core of this PC, with the stand-ins on another one, and prints its figures and what
/// the agents took.
///
/// # Panics
/// If the flight fails.
pub fn table() -> String {
    const FLOWN_S: u64 = 130;
    let folder = std::env::temp_dir().join(format!("skein-one-pc-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    let program = std::env::current_exe().unwrap();
    let mut pc = OnePc::start(&program, &folder, Cores::Apart);
    let (load, metrics) = pc.fly(FLOWN_S);
    let (status, log) = pc.end();
    assert_eq!(status, Some(0), "{log}");
    let figure = |key: &str, digits: usize| {
        metrics[key].as_f64().map_or_else(|| "never".to_owned(), |value| format!("{value:.digits$}"))
    };
    let load_average = skein_cluster::os::load().map_or_else(|| "-".to_owned(), |load| format!("{load:.1}"));
    let rows = [
        ("agents, on one core", X_PLANES.to_string()),
        ("stand-ins, on another core", X_PLANES.to_string()),
        ("load of the PC, with all that runs on it", load_average),
        ("cores that the ten agents use", format!("{:.2}", load.agents_cores)),
        ("cores that skein fly uses", format!("{:.2}", load.fly_cores)),
        ("steps", format!("{:.0}", f64::from(X_PLANES) * 50.0 * FLOWN_S as f64)),
        ("late steps (frame_overruns)", figure("frame_overruns", 0)),
        ("step_p99_us", figure("step_p99_us", 0)),
        ("peer_age_p99_ms", figure("peer_age_p99_ms", 0)),
        ("at_altitude_s", figure("at_altitude_s", 1)),
        ("in_band_s", figure("in_band_s", 1)),
        ("even_10deg_s", figure("even_10deg_s", 1)),
        ("radial_rms_m", figure("radial_rms_m", 2)),
        ("min_separation_m", figure("min_separation_m", 1)),
        ("collisions", figure("collisions", 0)),
    ];
    drop(pc);
    let _ = fs::remove_dir_all(&folder);
    let lines: Vec<String> = rows.iter().map(|(name, value)| format!("{name:<54}  {value:>6}")).collect();
    lines.join("\n")
}
