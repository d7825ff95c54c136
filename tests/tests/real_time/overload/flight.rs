//! A flight of `skein fly` with real processes.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use skein_cluster::endpoints;
use skein_cluster::mesh::observe::Observer;
use skein_cluster::mesh::reach::Reach;
use skein_common::state::Activity;
use skein_common::topic::Branch;
use tempfile::TempDir;

const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");
/// Timeout for steps that take a second on an idle PC.
const SOON: Duration = Duration::from_secs(60);

/// A flight with its own folder.
pub(super) struct Flight {
    pub(super) folder: TempDir,
    vehicles: u8,
    pub(super) process: Child,
}

impl Flight {
    /// A flight of three vehicles at 20 m.
    pub(super) fn start(name: &str, arguments: &[&str]) -> Self {
        let low = ["--set", "swarm.vehicles=3", "--set", "formation.altitude_m=20", "--set", "formation.radius_m=60"];
        Self::of(name, 3, &[&low, arguments].concat())
    }

    /// A flight of so many vehicles.
    pub(super) fn of(name: &str, vehicles: u8, arguments: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut command = command(folder.path());
        command.arg("fly").arg("--out").arg(folder.path().join("out"));
        command.args(["--set", &format!("swarm.name={name}")]).args(arguments);
        let process = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        Self { folder, vehicles, process }
    }

    pub(super) fn agents(&self) -> Vec<(Pid, String)> {
        let listed = Command::new("ps").args(["-axww", "-o", "pid=,args="]).output().unwrap();
        let folder = self.folder.path().to_str().unwrap();
        let listed = String::from_utf8_lossy(&listed.stdout).into_owned();
        let ours = listed.lines().filter(|line| line.contains(folder) && line.contains("--child"));
        let split = |line: &str| {
            let (pid, arguments) = line.trim().split_once(' ').unwrap();
            (Pid::from_raw(pid.parse().unwrap()).unwrap(), arguments.to_owned())
        };
        ours.map(split).collect()
    }

    /// Waits for the agent of this vehicle.
    pub(super) fn agent(&self, id: u8) -> Pid {
        let file = format!("agents/{id}.toml");
        wait_for(|| self.agents().into_iter().find(|(_, arguments)| arguments.contains(&file))).0
    }

    /// Waits for the agent of this vehicle, and stops or continues it.
    pub(super) fn signal(&self, id: u8, signal: Signal) {
        kill_process(self.agent(id), signal).unwrap();
    }

    /// An observer of the flight, which receives every step.
    pub(super) fn observer(&self) -> Observer {
        let runtime = self.folder.path().join("runtime/skein");
        let endpoints = wait_for(|| endpoints::find(&runtime, None).ok());
        let mut observer = Observer::open(&Reach::here(&endpoints, Branch::SWARM)).unwrap();
        observer.subscribe_to_traces(true).unwrap();
        observer
    }

    /// Waits until every vehicle has this activity; returns the observer.
    pub(super) fn wait_until_all(&self, activity: Activity) -> Observer {
        let mut observer = self.observer();
        wait_for(|| {
            observer.poll();
            let is_so = |id: &u8| {
                let seen = observer.vehicles().iter().find(|(vehicle, _)| vehicle.get() == *id);
                seen.and_then(|(_, seen)| seen.trace.as_ref()).is_some_and(|step| step.activity == activity)
            };
            (1..=self.vehicles).all(|id| is_so(&id)).then_some(())
        });
        observer
    }

    /// Waits for the end, and returns the exit status and the text on stderr.
    pub(super) fn end(&mut self) -> (Option<i32>, String) {
        let status = wait_for(|| self.process.try_wait().unwrap());
        let mut stderr = String::new();
        std::io::Read::read_to_string(&mut self.process.stderr.take().unwrap(), &mut stderr).unwrap();
        (status.code(), stderr)
    }
}

impl Drop for Flight {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
        self.agents().into_iter().for_each(|(pid, _)| _ = kill_process(pid, Signal::KILL));
    }
}

pub(super) fn command(folder: &Path) -> Command {
    let mut command = Command::new(PROGRAM);
    command.env("XDG_RUNTIME_DIR", folder.join("runtime")).env_remove("RUST_LOG").current_dir(folder);
    command
}

pub(super) fn wait_for<T>(mut found: impl FnMut() -> Option<T>) -> T {
    let until = Instant::now() + SOON;
    loop {
        if let Some(found) = found() {
            return found;
        }
        assert!(Instant::now() < until, "timeout");
        sleep(Duration::from_millis(50));
    }
}
