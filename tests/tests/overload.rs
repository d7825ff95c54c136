//! `skein fly` on an overloaded PC. The test stops agents with SIGSTOP: to all others a stopped agent looks like an
//! agent without computing time.
#![cfg(unix)]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]
#![expect(clippy::unwrap_used, reason = "what a test cannot do has failed")]

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use skein::endpoints;
use skein::observe::{Observer, TraceSubscription};
use skein::reach::Reach;
use skein_common::state::Activity;
use skein_common::topic::Branch;
use tempfile::TempDir;

const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");
/// Timeout for steps that take a second on an idle PC.
const SOON: Duration = Duration::from_secs(60);

/// A flight of three vehicles at 20 m, with its own folder.
struct Flight {
    folder: TempDir,
    process: Child,
}

impl Flight {
    fn start(name: &str, arguments: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut command = command(folder.path());
        command.arg("fly").arg("--out").arg(folder.path().join("out"));
        command.args(["--set", &format!("swarm.name={name}"), "--set", "swarm.vehicles=3"]);
        command.args(["--set", "formation.altitude_m=20", "--set", "formation.radius_m=60"]).args(arguments);
        let process = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        Self { folder, process }
    }

    fn agents(&self) -> Vec<(Pid, String)> {
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

    /// Waits for the agent of this vehicle, and stops or continues it.
    fn signal(&self, id: u8, signal: Signal) {
        let file = format!("agents/{id}.toml");
        let found = wait_for(|| self.agents().into_iter().find(|(_, arguments)| arguments.contains(&file)));
        kill_process(found.0, signal).unwrap();
    }

    /// Waits until every vehicle flies in formation.
    fn wait_until_it_flies(&self) {
        let runtime = self.folder.path().join("runtime/skein");
        let endpoints = wait_for(|| endpoints::find(&runtime, None).ok());
        let mut observer = Observer::open(&Reach::here(&endpoints, Branch::SWARM), TraceSubscription::On).unwrap();
        wait_for(|| {
            observer.poll();
            let flies = |id: &u8| {
                let seen = observer.vehicles().iter().find(|(vehicle, _)| vehicle.get() == *id);
                seen.and_then(|(_, seen)| seen.trace.as_ref()).is_some_and(|step| step.activity == Activity::Formation)
            };
            [1, 2, 3].iter().all(flies).then_some(())
        });
    }

    /// Waits for the end, and returns the exit status and the text on stderr.
    fn end(&mut self) -> (Option<i32>, String) {
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

fn command(folder: &Path) -> Command {
    let mut command = Command::new(PROGRAM);
    command.env("XDG_RUNTIME_DIR", folder.join("runtime")).env_remove("RUST_LOG").current_dir(folder);
    command
}

fn wait_for<T>(mut found: impl FnMut() -> Option<T>) -> T {
    let until = Instant::now() + SOON;
    loop {
        if let Some(found) = found() {
            return found;
        }
        assert!(Instant::now() < until, "timeout");
        sleep(Duration::from_millis(50));
    }
}

#[test]
fn airborne_agents_without_computing_time_are_not_killed_and_land_later() {
    let mut flight = Flight::start("starved", &[]);
    flight.wait_until_it_flies();
    [2, 3].into_iter().for_each(|id| flight.signal(id, Signal::STOP));
    kill_process(Pid::from_child(&flight.process), Signal::INT).unwrap();
    // The first has landed and ended; the others are silent and were asked to end.
    wait_for(|| flight.agents().iter().all(|(_, arguments)| !arguments.contains("agents/1.toml")).then_some(()));
    // They continue two seconds before `fly` ends: too late to land by then.
    sleep(Duration::from_secs(13));
    [2, 3].into_iter().for_each(|id| flight.signal(id, Signal::CONT));
    let (status, stderr) = flight.end();
    println!("{stderr}");
    assert_eq!(status, Some(1), "{stderr}");
    assert!(stderr.contains("vehicle 2, 3: still in the air as far as is known"), "{stderr}");
    let left = flight.agents();
    assert_eq!(left.len(), 2, "{left:?}");
    wait_for(|| flight.agents().is_empty().then_some(()));
    let log = std::fs::read_to_string(flight.folder.path().join("out/agents/3.log")).unwrap();
    assert!(log.contains("vehicle 3 landed"), "{log}");
}

#[test]
fn a_swarm_that_is_not_active_in_time_is_ended_with_a_reason() {
    let mut flight = Flight::start("apart", &["--timeout", "6"]);
    flight.signal(2, Signal::STOP);
    let (status, stderr) = flight.end();
    println!("{stderr}");
    assert_eq!(status, Some(1), "{stderr}");
    assert!(stderr.contains("only 2 of 3 vehicles became active within 6 s (not vehicle 2)"), "{stderr}");
    assert_eq!(flight.agents(), [], "agents on the ground are ended");
}

#[test]
fn a_swarm_too_large_for_any_pc_is_refused_before_any_process_starts() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = command(folder.path());
    command.args(["fly", "--out", "out", "--set", "swarm.vehicles=250", "--set", "formation.radius_m=1000"]);
    command.args(["--set", "start.square_m=400"]);
    let Output { status, stderr, .. } = command.stdin(Stdio::null()).output().unwrap();
    let stderr = String::from_utf8_lossy(&stderr).into_owned();
    println!("{stderr}");
    assert_eq!(status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("250 agents need ") && stderr.contains(": it can fly "), "{stderr}");
    assert!(!folder.path().join("out").exists() && !folder.path().join("runtime").exists());
}
