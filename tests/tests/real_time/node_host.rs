//! `skein node` as the operator's PC uses it on a host without systemd: the installed program reads requests from its
//! standard input, and starts a supervisor and an agent. All files are in one temporary folder, and no process is left
//! behind.

use skein_tests::share::Share;
use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process, test_kill_process};
use skein_cluster::bundle::{Bundle, BundleFile};
use skein_cluster::inventory::ServiceKind;
use skein_cluster::protocol::{Answer, Ask, Change, Facts, Request, Service, Setup};
use skein_common::id::{SwarmName, VehicleId};
use tempfile::TempDir;

const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");
/// Timeout of every wait; a test that passes needs a tenth of it.
const TIMEOUT: Duration = Duration::from_secs(60);

/// A host with one node, and release `r1` of the program.
struct Host {
    folder: TempDir,
}

impl Host {
    fn new() -> Self {
        let host = Self { folder: tempfile::tempdir().unwrap() };
        host.copy("r1");
        host
    }

    /// A host with a disk of its own, of this size. Needs root.
    fn with_disk(megabytes: u64) -> Self {
        let host = Self { folder: tempfile::tempdir().unwrap() };
        let size = format!("size={megabytes}m");
        assert!(mount(&["mount", "-t", "tmpfs", "-o", &size, "tmpfs"], host.folder.path()));
        host.copy("r1");
        host
    }

    /// Writes until nothing more fits; returns the file.
    fn fill_disk(&self) -> PathBuf {
        let path = self.folder.path().join("large");
        let mut file = fs::File::create(&path).unwrap();
        for size in [1 << 20, 4096, 1] {
            while file.write_all(&vec![7; size]).is_ok() {}
        }
        path
    }

    fn copy(&self, release: &str) {
        let program = self.program(release);
        fs::create_dir_all(program.parent().unwrap()).unwrap();
        // The program derives its release from its path.
        fs::hard_link(PROGRAM, &program).or_else(|_| fs::copy(PROGRAM, &program).map(drop)).unwrap();
    }

    fn swarm(&self) -> PathBuf {
        self.folder.path().join(".skein/lab")
    }

    fn program(&self, release: &str) -> PathBuf {
        self.swarm().join("releases").join(release).join("skein")
    }

    fn log(&self) -> String {
        fs::read_to_string(self.swarm().join("node-1/log/agent.log")).unwrap_or_default()
    }

    fn request(ask: Ask) -> Vec<u8> {
        let request = Request { swarm: SwarmName::new("lab").unwrap(), id: VehicleId::new(1).unwrap().into(), ask };
        serde_json::to_vec(&request).unwrap()
    }

    fn node(&self, release: &str) -> Child {
        let mut command = Command::new(self.program(release));
        command.arg("node").env_remove("RUST_LOG");
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap()
    }

    fn ask(&self, release: &str, ask: Ask) -> Answer {
        let mut node = self.node(release);
        node.stdin.take().unwrap().write_all(&Self::request(ask)).unwrap();
        // The output ends only if neither supervisor nor agent keeps it open.
        let output = node.wait_with_output().unwrap();
        assert!(output.status.success());
        let text = String::from_utf8(output.stdout).unwrap();
        serde_json::from_str(text.lines().last().unwrap()).unwrap()
    }

    fn done(&self, release: &str, ask: Ask) -> (bool, Facts) {
        match self.ask(release, ask) {
            Answer::Done(Change { changed, facts, .. }) => (changed, facts),
            other => panic!("{other:?}\n{}", self.log()),
        }
    }

    fn facts(&self) -> Facts {
        match self.ask("r1", Ask::Facts) {
            Answer::Facts(facts) => facts,
            other => panic!("{other:?}"),
        }
    }

    /// Waits for the agent that replaces `old`; returns its process id and the number of restarts.
    fn restarted(&self, old: u32) -> (u32, u32) {
        let mut agent = None;
        wait_until("another agent", || {
            agent = self.facts().agent.map(|agent| (agent.pid, agent.restarts)).filter(|(pid, _)| *pid != old);
            agent.is_some()
        });
        agent.unwrap()
    }

    fn supervisor(&self) -> u32 {
        let bytes = fs::read(self.swarm().join("node-1/run/supervisor")).unwrap();
        let value: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
        u32::try_from(value["pid"].as_u64().unwrap()).unwrap()
    }
}

impl Drop for Host {
    /// Ends all processes, also of a failed test, whose log is shown.
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("{}", self.log());
        }
        let folder = self.folder.path().to_str().unwrap();
        for id in processes(folder) {
            let _ = kill_process(pid(id), Signal::KILL);
        }
        // Only a folder that is a disk.
        mount(&["umount", "--lazy", "--quiet"], self.folder.path());
    }
}

fn mount(command: &[&str], folder: &Path) -> bool {
    Command::new(command[0])
        .args(&command[1..])
        .arg(folder)
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|done| done.success())
}

/// The processes whose command line contains this folder.
fn processes(folder: &str) -> Vec<u32> {
    let listed = Command::new("ps").args(["-axww", "-o", "pid=,args="]).output().unwrap();
    let listed = String::from_utf8_lossy(&listed.stdout).into_owned();
    let ours = listed.lines().filter(|line| line.contains(folder) && !line.contains("<defunct>"));
    ours.filter_map(|line| line.split_ascii_whitespace().next()?.parse().ok()).collect()
}

fn pid(id: u32) -> Pid {
    Pid::from_raw(i32::try_from(id).unwrap()).unwrap()
}

fn runs(id: u32) -> bool {
    let is_dead = fs::read_to_string(format!("/proc/{id}/stat")).is_ok_and(|stat| stat.contains(") Z "));
    test_kill_process(pid(id)).is_ok() && !is_dead
}

fn kill(id: u32) {
    kill_process(pid(id), Signal::KILL).unwrap();
    wait_until("the end of a process", || !runs(id));
}

fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let deadline = Instant::now() + TIMEOUT;
    while !is_so() {
        assert!(Instant::now() < deadline, "waited for {what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// The files of a swarm of one vehicle that flies low on the built-in plant.
fn bundle(port: u16, altitude_m: f64) -> Bundle {
    let scenario = format!(
        "swarm.vehicles = 1\nswarm.name = \"lab\"\nformation.altitude_m = {altitude_m}\nformation.radius_m = 60\n"
    );
    let agent = format!("scenario = \"scenario.toml\"\nid = 1\nlisten = [\"tcp/127.0.0.1:{port}\"]\ndial = []\n");
    let file = |text: String| BundleFile { is_secret: false, is_executable: false, content: text.into_bytes() };
    let files = [("agent.toml", agent), ("scenario.toml", scenario)];
    Bundle { files: files.map(|(name, text)| (name.to_owned(), file(text))).into() }
}

fn apply(bundle: &Bundle) -> Ask {
    Ask::Apply(Setup { bundle: bundle.clone(), service: ServiceKind::Own, log: None })
}

fn entries(folder: &Path) -> usize {
    fs::read_dir(folder).map_or(0, Iterator::count)
}

#[test]
fn a_node_is_installed_started_kept_alive_landed_and_removed() {
    let _share = Share::of_flight(2);
    let host = Host::new();
    // A port that was free just now.
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let (first, second) = (bundle(port, 4.0), bundle(port, 5.0));
    assert!(host.facts().current.is_none());
    let (changed, facts) = host.done("r1", apply(&first));
    assert!(changed && facts.service == Some(Service::Own));
    assert!(!host.done("r1", apply(&first)).0);

    // Several start requests start one agent.
    let (changed, facts) = host.done("r1", Ask::Start { run: 7, note: None });
    let agent = facts.agent.unwrap();
    assert!(changed && (agent.run, agent.restarts) == (7, 0));
    assert_eq!(agent.landing_s, 68.0, "a minute, and 4 m at half a metre a second");
    let (changed, facts) = host.done("r1", Ask::Start { run: 8, note: None });
    assert!(!changed && facts.agent == Some(agent.clone()), "the running agent keeps its run");

    // A killed agent is restarted, and a killed supervisor with the next request. The agent's old sockets are removed.
    let sockets = host.swarm().join("node-1/run/skein-1-0");
    fs::create_dir(&sockets).unwrap();
    kill(agent.pid);
    let (agent, restarts) = host.restarted(agent.pid);
    assert_eq!(restarts, 1);
    assert!(!sockets.exists());
    kill(host.supervisor());
    assert!(runs(agent), "the agent runs on without its supervisor");
    let (changed, facts) = host.done("r1", Ask::Start { run: 9, note: None });
    assert!(changed && facts.agent.map(|agent| (agent.pid, agent.run)) == Some((agent, 7)));
    assert!(!host.done("r1", Ask::Start { run: 9, note: None }).0);
    kill(agent);
    let (agent, restarts) = host.restarted(agent);
    assert_eq!(restarts, 2);

    // An upgrade does not stop a flying agent. `stop` lands it before it ends, and it is not restarted.
    host.copy("r2");
    let (changed, facts) = host.done("r2", apply(&second));
    assert!(changed && facts.current.unwrap().release == "r2" && facts.previous.unwrap().release == "r1");
    let running = facts.agent.unwrap();
    assert!(running.pid == agent && running.installed.release == "r1");
    wait_until("the vehicle flies", || host.log().contains("vehicle 1 at altitude"));
    let stopped = host.ask("r2", Ask::Stop { within_s: 40.0 });
    let Answer::Done(Change { changed: true, forced: false, facts }) = stopped else { panic!("{stopped:?}") };
    assert!(facts.agent.is_none());
    let log = host.log();
    assert!(
        log.contains("vehicle 1 landed")
            && log.contains("vehicle 1 ends")
            && log.contains("supervisor: the agent ended\n"),
        "{log}"
    );
    assert!(log.contains("supervisor: the agent was killed by signal 9\n"), "{log}");
    wait_until("the supervisor's end", || processes(host.folder.path().to_str().unwrap()).is_empty());

    // An agent that cannot start is not restarted again and again.
    let occupied = TcpListener::bind(("127.0.0.1", port)).unwrap();
    // On a busy PC the agent may end only after the request was answered: the next request then starts it again.
    let mut why = String::new();
    wait_until("the reason why the agent cannot start", || match host.ask("r2", Ask::Start { run: 10, note: None }) {
        Answer::Failed(reason) => {
            why = reason;
            true
        }
        _ => false,
    });
    assert!(why.contains("ended at once: ") && why.contains(&port.to_string()), "{why}");
    assert!(processes(host.folder.path().to_str().unwrap()).is_empty());
    drop(occupied);

    // A rollback restores the earlier release and starts an agent again.
    let (_, facts) = host.done("r2", Ask::Rollback);
    assert_eq!(facts.current.unwrap().bundle, first.id());
    let (_, facts) = host.done("r2", Ask::Start { run: 10, note: None });
    let agent = facts.agent.unwrap();
    assert_eq!((agent.installed.release.as_str(), agent.run, agent.restarts), ("r1", 10, 0));
    // An agent that landed by itself is not restarted, not even by a supervisor that did not start it. A signal that comes before
    // the agent catches signals would end it without a landing, and the new supervisor does not receive its output.
    wait_until("the vehicle flies again", || host.log().matches("vehicle 1 at altitude").count() == 2);
    kill(host.supervisor());
    assert!(host.done("r2", Ask::Start { run: 10, note: None }).0);
    kill_process(pid(agent.pid), Signal::TERM).unwrap();
    wait_until("the end of agent and supervisor", || processes(host.folder.path().to_str().unwrap()).is_empty());
    assert!(host.log().ends_with("supervisor: ending\n"), "{}", host.log());
    assert!(host.done("r2", Ask::Start { run: 11, note: None }).1.agent.is_some_and(|agent| agent.restarts == 0));
    let mut follower = host.node("r1");
    let mut follower_input = follower.stdin.take().unwrap();
    follower_input.write_all(&Host::request(Ask::Log { lines: 1, follow: true })).unwrap();
    let mut lines = BufReader::new(follower.stdout.take().unwrap()).lines();
    lines.next().unwrap().unwrap();
    let stopped = host.ask("r2", Ask::Stop { within_s: 0.0 });
    assert!(matches!(stopped, Answer::Done(Change { changed: true, forced: true, .. })), "{stopped:?}");
    // The forced end may kill the supervisor before it has written its last line. So the test waits for no particular line: it
    // closes the follower's input, which ends the follower, and reads what it has shown.
    std::thread::sleep(Duration::from_secs(1));
    drop(follower_input);
    assert!(lines.next().is_some(), "the log is followed");
    wait_until("the follower's end", || follower.try_wait().unwrap().is_some());

    assert!(host.done("r2", Ask::Remove { within_s: 20.0 }).0);
    assert_eq!(entries(host.folder.path()), 0, "nothing is left");
    assert!(processes(host.folder.path().to_str().unwrap()).is_empty());
}

/// Needs root, for a small disk.
#[test]
fn an_agent_that_hangs_is_restarted_and_so_is_one_on_a_full_disk() {
    let _share = Share::of_flight(2);
    if !rustix::process::geteuid().is_root() {
        assert_ne!(std::env::var("SKEIN_NAMESPACES").as_deref(), Ok("required"), "this test needs root");
        return eprintln!("skipped: it needs root");
    }
    let size = fs::metadata(PROGRAM).unwrap().len();
    let host = Host::with_disk(size / 1_000_000 + 16);
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    host.done("r1", apply(&bundle(port, 4.0)));
    let agent = host.done("r1", Ask::Start { run: 1, note: None }).1.agent.unwrap();

    let file = host.fill_disk();
    assert!(fs::write(host.swarm().join("node-1/run/another"), [7; 8192]).is_err(), "the disk is full");
    kill(agent.pid);
    let (agent, restarts) = host.restarted(agent.pid);
    assert_eq!(restarts, 1, "it starts where nothing can be written");
    fs::remove_file(file).unwrap();

    wait_until("the vehicle flies", || host.log().contains("vehicle 1 at altitude"));
    kill_process(pid(agent), Signal::STOP).unwrap();
    let (_, restarts) = host.restarted(agent);
    assert_eq!(restarts, 2);
    let log = host.log();
    assert!(log.contains("supervisor: the agent hangs: silent for 10 s; it is killed\n"), "{log}");
    let stopped = host.ask("r1", Ask::Stop { within_s: 60.0 });
    assert!(matches!(stopped, Answer::Done(Change { changed: true, forced: false, .. })), "{stopped:?}");
}

/// What `/proc` says of a process in this line of a file, such as `CapEff:` of `status`.
#[cfg(target_os = "linux")]
fn of_process(id: u32, file: &str, line: &str) -> String {
    let text = fs::read_to_string(format!("/proc/{id}/{file}")).unwrap();
    let found = text.lines().find_map(|found| found.strip_prefix(line));
    found.unwrap_or_else(|| panic!("{line} in {text}")).split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The bit of `CAP_SYS_RESOURCE`.
#[cfg(target_os = "linux")]
const SYS_RESOURCE: u64 = 1 << 24;

/// Needs root, which alone has capabilities to give up.
#[test]
#[cfg(target_os = "linux")]
fn an_agent_that_root_has_installed_gives_up_roots_capabilities() {
    let _share = Share::of_flight(2);
    if !rustix::process::geteuid().is_root() {
        assert_ne!(std::env::var("SKEIN_NAMESPACES").as_deref(), Ok("required"), "this test needs root");
        return eprintln!("skipped: it needs root");
    }
    let host = Host::new();
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    host.done("r1", apply(&bundle(port, 4.0)));
    let agent = host.done("r1", Ask::Start { run: 1, note: None }).1.agent.unwrap();
    let own = of_process(std::process::id(), "status", "CapEff:");
    assert_ne!(own, "0000000000000000", "this test has some");
    // A container's root may lack the capability to raise limits.
    let can_raise_limits = u64::from_str_radix(&own, 16).unwrap() & SYS_RESOURCE != 0;
    let is_powerless = |id: u32| {
        // A process that has just been started gives them up before it becomes the agent.
        wait_until("it gives up its capabilities", || of_process(id, "status", "CapPrm:") == "0000000000000000");
        for set in ["CapInh:", "CapPrm:", "CapEff:", "CapBnd:", "CapAmb:"] {
            assert_eq!(of_process(id, "status", set), "0000000000000000", "{set}");
        }
        assert_eq!(of_process(id, "status", "NoNewPrivs:"), "1");
        if can_raise_limits {
            assert_eq!(of_process(id, "limits", "Max realtime priority"), "50 50");
            assert_eq!(of_process(id, "limits", "Max locked memory"), "unlimited unlimited bytes");
        }
    };
    is_powerless(agent.pid);
    // The supervisor keeps them, and the agent that it starts next has none either.
    assert_eq!(of_process(host.supervisor(), "status", "CapEff:"), own);
    kill(agent.pid);
    let (agent, _) = host.restarted(agent.pid);
    is_powerless(agent);
    wait_until("the vehicle flies", || host.log().contains("vehicle 1 at altitude"));
    assert!(!host.log().contains("root's capabilities"), "{}", host.log());
    let stopped = host.ask("r1", Ask::Stop { within_s: 60.0 });
    assert!(matches!(stopped, Answer::Done(Change { changed: true, forced: false, .. })), "{stopped:?}");
}

/// Runs a command of the program in this folder; returns its exit status and stderr.
fn skein(folder: &Path, line: &str) -> (Option<i32>, String) {
    let mut command = Command::new(PROGRAM);
    command.args(line.split_whitespace()).current_dir(folder).env("XDG_RUNTIME_DIR", folder.parent().unwrap());
    let done = command.output().unwrap();
    let text = [done.stdout, done.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).concat();
    (done.status.code(), text)
}

/// A folder with a disk of this size in it, until it is dropped.
struct Disk(TempDir);

impl Disk {
    fn new(kilobytes: u64) -> Option<Self> {
        if std::env::var_os("SKEIN_NAMESPACES").is_none() {
            eprintln!("not tested: a disk of its own needs root and SKEIN_NAMESPACES");
            return None;
        }
        let disk = Self(tempfile::tempdir().unwrap());
        fs::create_dir(disk.path()).unwrap();
        let size = format!("size={kilobytes}k");
        assert!(mount(&["mount", "-t", "tmpfs", "-o", &size, "tmpfs"], &disk.path()));
        Some(disk)
    }

    fn path(&self) -> PathBuf {
        self.0.path().join("disk")
    }

    fn grow(&self) {
        assert!(mount(&["mount", "-o", "remount,size=64m"], &self.path()));
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        mount(&["umount", "-l"], &self.path());
    }
}

/// Asserts that no file in this folder is empty, except those whose names say that something is so, or torn.
fn assert_whole(folder: &Path) {
    for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap()) {
        let (path, name) = (entry.path(), entry.file_name().into_string().unwrap());
        if path.is_dir() {
            assert_whole(&path);
        } else if name.ends_with(".json") {
            serde_json::from_slice::<serde_json::Value>(&fs::read(&path).unwrap())
                .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        } else {
            assert!(!name.ends_with(".draft"), "{}", path.display());
        }
    }
}

#[test]
fn a_study_on_a_full_disk_keeps_its_figures_and_goes_on_with_its_recordings() {
    let _share = Share::of(100);
    for (scenario, recording) in [
        ("duration_s = 60\nswarm.vehicles = 4\nformation.radius_m = 40\n", "seed-0/run.mcap"),
        (
            "duration_s = 300\nswarm.vehicles = 4\nformation.radius_m = 40\nfleet.teams = 9\nfleet.record_hz = 10\n",
            "seed-0/fleet.mcap",
        ),
    ] {
        let Some(disk) = Disk::new(400) else { return };
        let out = disk.path().join("o");
        fs::write(disk.path().join("s.toml"), scenario).unwrap();
        let line = "study s.toml --seeds 0..2 --jobs 1 --set record.runs=\"all\" --out o";
        let (status, said) = skein(&disk.path(), line);
        assert_eq!(status, Some(1), "{said}");
        assert!(said.contains("No space left on device") && said.contains("continues with the recordings"), "{said}");
        assert!(said.contains(" of 2 runs: no collision"), "the figures are on the screen: {said}");
        assert!(!out.join(recording).exists(), "{said}");
        for file in ["summary.json", "runs.csv", "seed-0/metrics.json", "seed-1/metrics.json"] {
            assert!(out.join(file).metadata().unwrap().len() > 0, "{file}");
        }
        assert_whole(&out);
        disk.grow();
        let (status, said) = skein(&disk.path(), line);
        assert_eq!(status, Some(0), "{said}");
        assert!(out.join(recording).exists(), "{said}");
        let (status, said) = skein(&disk.path(), line);
        assert!(status == Some(2) && said.contains("finished"), "{said}");
    }
}

#[test]
fn a_flight_on_a_full_disk_keeps_its_figures() {
    let _share = Share::of_flight(2);
    let Some(disk) = Disk::new(600) else { return };
    let line = "fly --set swarm.name=small-disk --set swarm.vehicles=2 --set formation.radius_m=40 --set formation.altitude_m=5 \
                --set record.hz=50 --duration 15 --out o";
    let (status, said) = skein(&disk.path(), line);
    println!("{status:?}: {said}");
    let out = disk.path().join("o");
    assert!(said.contains("No space left on device"), "{said}");
    let figures: serde_json::Value = serde_json::from_slice(&fs::read(out.join("metrics.json")).unwrap()).unwrap();
    assert_eq!(figures["collisions"], 0);
    assert_whole(&out);
}
