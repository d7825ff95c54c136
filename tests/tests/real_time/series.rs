//! `skein fly --runs N` as a user runs it: flights that follow each other, interrupted, failed and resumed; and one flight
//! whose X-Planes are paused and restarted.

use std::fs;
use std::io::{BufRead, BufReader};
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use clap::{Args, FromArgMatches};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use skein_agent::plant::xplane::standin::{Standin, StandinOptions};
use skein_agent::plant::xplane::wire::dref::Write;
use skein_agent::plant::xplane::wire::operation::Command as SimulatorCommand;
use skein_agent::plant::xplane::wire::rref::{DatarefRequest, decode_values};
use skein_common::id::VehicleId;
use skein_host::clock;
use skein_tests::processes::children_of;
use skein_tests::share::Share;
use tempfile::TempDir;

const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");

/// The folders of a test, in which series of two vehicles fly at low altitude.
struct Place {
    name: &'static str,
    folder: TempDir,
}

impl Place {
    fn new(name: &'static str) -> Self {
        Self { name, folder: tempfile::tempdir().unwrap() }
    }

    fn out(&self) -> PathBuf {
        self.folder.path().join("out")
    }

    fn command(&self, verb: &str, arguments: &[&str]) -> Command {
        let mut command = Command::new(PROGRAM);
        command.env("XDG_RUNTIME_DIR", self.folder.path().join("runtime")).env_remove("RUST_LOG");
        command.current_dir(self.folder.path()).arg(verb).args(arguments).stdin(Stdio::null());
        command
    }

    fn scenario(&self, verb: &str, arguments: &[&str]) -> Command {
        let mut command = self.command(verb, arguments);
        for set in ["swarm.vehicles=2", "formation.altitude_m=5", "formation.radius_m=60"] {
            command.args(["--set", set]);
        }
        command.args(["--set", &format!("swarm.name={}", self.name)]);
        command
    }

    fn fly(&self, arguments: &[&str]) -> Command {
        let mut command = self.scenario("fly", &["--duration", "8", "--out", "out"]);
        command.args(arguments);
        command
    }

    fn files(&self, seed: u64) -> Vec<String> {
        let files = fs::read_dir(self.out().join(format!("seed-{seed}"))).unwrap();
        let names = files.map(|file| file.unwrap().file_name().into_string().unwrap());
        // The file by which a command claims the folder stays, empty.
        let mut files: Vec<String> = names.filter(|name| name != ".skein-lock").collect();
        files.sort();
        files
    }

    fn rows(&self) -> Vec<String> {
        fs::read_to_string(self.out().join("runs.csv")).unwrap().lines().map(str::to_owned).collect()
    }
}

fn printed(output: &Output) -> (Option<i32>, String, String) {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

/// A series that runs; if its test fails, its processes are killed.
struct Series(Child);

impl Series {
    fn start(mut command: Command) -> Self {
        Self(command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap())
    }

    /// Reads its output up to the end of the first lines with these texts, one after the other. The rest of it is read at
    /// its end.
    fn wait_for(&mut self, texts: &[&str]) -> BufReader<std::process::ChildStdout> {
        let mut lines = BufReader::new(self.0.stdout.take().unwrap());
        for text in texts {
            let mut line = String::new();
            while !line.contains(text) {
                line.clear();
                assert!(lines.read_line(&mut line).unwrap() > 0, "ended without {text:?}");
            }
        }
        lines
    }

    fn end(mut self) -> (Option<i32>, String) {
        let stderr = std::io::read_to_string(self.0.stderr.take().unwrap()).unwrap();
        (self.0.wait().unwrap().code(), stderr)
    }
}

impl Drop for Series {
    fn drop(&mut self) {
        if self.0.try_wait().unwrap().is_none() {
            let children =
                children_of(self.0.id()).into_iter().filter_map(|pid| Pid::from_raw(pid.try_into().unwrap()));
            children.for_each(|pid| _ = kill_process(pid, Signal::KILL));
            let _ = self.0.kill();
            let _ = self.0.wait();
        }
    }
}

#[test]
fn an_interrupted_series_lands_and_is_resumed_and_read_as_a_study() {
    let _share = Share::of_flight(4);
    let place = Place::new("night");
    let arguments = ["--runs", "3", "--seed", "5", "--plant", "standin"];
    let mut series = Series::start(place.fly(&arguments));
    let active = "all vehicles active";
    let lines = series.wait_for(&["flight 1 of 3, seed 5", active, "flight 2 of 3, seed 6", active]);
    kill_process(Pid::from_child(&series.0), Signal::INT).unwrap();
    let text = std::io::read_to_string(lines).unwrap();
    let (status, stderr) = series.end();
    assert_eq!(status, Some(1), "{stderr}");
    assert!(text.contains("2 of 2 landed") && text.contains("min_separation_m"), "{text}");
    let why = "ended by Ctrl-C in the flight of seed 6: 1 of 3 flights are there; the same command with --out ";
    assert!(stderr.contains(why), "{stderr}");
    assert!(place.files(5).contains(&"run.mcap".to_owned()) && place.files(5).contains(&"metrics.json".to_owned()));
    assert!(!place.files(6).contains(&"metrics.json".to_owned()), "an interrupted flight is not a run");
    assert!(!place.out().join("runs.csv").exists() && !place.out().join("seed-7").exists());

    let (status, stdout, stderr) = printed(&place.fly(&arguments).arg("--json").output().unwrap());
    assert_eq!(status, Some(0), "{stderr}");
    assert!(
        stderr.contains("1 of 3 flights are there already") && stderr.contains("flight 2 of 3, seed 6"),
        "{stderr}"
    );
    let lines: Vec<Value> = stdout.lines().map(|line| serde_json::from_str(line).expect("an object a line")).collect();
    let of =
        |kind: &str| lines.iter().filter(|line| line["kind"] == kind).map(|line| &line["seed"]).collect::<Vec<_>>();
    assert_eq!((of("began"), of("result")), (vec![&6.into(), &7.into()], vec![&6.into(), &7.into()]));
    let last = lines.last().unwrap();
    assert_eq!((&last["kind"], &last["runs"], &last["flown"]), (&"series".into(), &3.into(), &3.into()));
    assert_eq!((&last["error"], &last["failed"]), (&Value::Null, &serde_json::json!([])));
    let summary: Value = serde_json::from_slice(&fs::read(place.out().join("summary.json")).unwrap()).unwrap();
    assert_eq!(last["figures"], summary);
    assert_eq!(summary["collisions"]["n"], 3);
    let seeds: Vec<_> = place.rows().iter().map(|row| row.split(',').next().unwrap().to_owned()).collect();
    assert_eq!(seeds, ["seed", "5", "6", "7"]);
    for seed in 5..8 {
        let metrics = fs::read_to_string(place.out().join(format!("seed-{seed}/metrics.json"))).unwrap();
        let metrics: Value = serde_json::from_str(&metrics).unwrap();
        assert_eq!((&metrics["seed"], &metrics["plant"]), (&seed.into(), &"standin".into()));
        assert!(metrics["duration_s"].as_f64() == Some(8.0) && metrics["collisions"] == 0, "{metrics:#}");
    }

    let (status, _, stderr) = printed(&place.fly(&arguments).output().unwrap());
    assert!(status == Some(2) && stderr.contains("this study is there already, and finished"), "{stderr}");
    reads_as_a_study(&place);
}

/// `compare` pairs the flights with runs in virtual time, and `report` draws them.
fn reads_as_a_study(place: &Place) {
    let study = ["--seeds", "5..8", "--set", "duration_s=8", "--no-record", "--out", "virtual"];
    assert!(place.scenario("study", &study).output().unwrap().status.success());
    let compared = place.command("compare", &["virtual", "out", "--json"]).output().unwrap();
    let (status, stdout, stderr) = printed(&compared);
    assert_eq!(status, Some(0), "{stderr}");
    let compared: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!((&compared["b"], &compared["pairs"]), (&"fly standin".into(), &3.into()));
    let reported = place.command("report", &["out", "--out", "page"]).output().unwrap();
    assert!(reported.status.success(), "{}", printed(&reported).2);
    let page = fs::read_to_string(place.folder.path().join("page/index.html")).unwrap();
    assert!(page.contains("3 runs") && page.contains("the worst run"));
}

/// X-Planes of the test, which run on between flights.
struct XPlanes {
    first_port: u16,
    stops: Vec<Arc<AtomicBool>>,
    threads: Vec<JoinHandle<()>>,
}

/// Port of the first, outside the range from which the system chooses ports.
const FIRST_PORT: u16 = 17_600;
/// The same of the flight whose X-Planes are paused and restarted.
const LIFE_PORT: u16 = 17_650;

impl XPlanes {
    fn start(first_port: u16) -> Self {
        let mut all = Self { first_port, stops: Vec::new(), threads: Vec::new() };
        (1..=2).for_each(|id| all.begin(id));
        all
    }

    fn begin(&mut self, id: u8) {
        let defaults = StandinOptions::augment_args(clap::Command::new("standin")).get_matches_from(["standin"]);
        let defaults = StandinOptions::from_arg_matches(&defaults).unwrap();
        let id = VehicleId::new(id).unwrap();
        let options = StandinOptions { port: self.first_port, id, beacon: false, ..defaults };
        let mut simulator = Standin::open(&options).unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        self.stops.push(stop.clone());
        self.threads.push(std::thread::spawn(move || simulator.run(&stop)));
    }

    fn stop(&mut self, nth: usize) {
        self.stops.remove(nth).store(true, Ordering::Relaxed);
        self.threads.remove(nth).join().unwrap();
    }
}

impl Drop for XPlanes {
    fn drop(&mut self) {
        (0..self.stops.len()).for_each(|_| self.stop(0));
    }
}

#[test]
fn x_planes_stay_a_crashed_aircraft_is_reset_and_a_silent_one_costs_its_flights_only() {
    let _share = Share::of_flight(4);
    let place = Place::new("simulators");
    let mut simulators = XPlanes::start(FIRST_PORT);
    let mut crash = Vec::new();
    Write { value: 1.0, path: "skein/standin/crash" }.encode(&mut crash).unwrap();
    let client = UdpSocket::bind("127.0.0.1:0").unwrap();
    client.send_to(&crash, ("127.0.0.1", FIRST_PORT + 10)).unwrap();

    let named = format!("127.0.0.1:{FIRST_PORT},127.0.0.1:{}", FIRST_PORT + 10);
    let arguments = ["--runs", "3", "--seed", "0", "--timeout", "20", "--xplane", &named];
    let mut series = Series::start(place.fly(&arguments));
    let lines = series.wait_for(&["flight 1 of 3, seed 0", "all vehicles active", "2 of 2 ended"]);
    simulators.stop(1);
    let text = std::io::read_to_string(lines).unwrap();
    let (status, stderr) = series.end();
    assert_eq!(status, Some(1), "{stderr}");
    assert!(text.contains("2 of 3 runs not flown to the end, seeds 1 and 2"), "{text}");
    assert!(stderr.contains("seed 2: 127.0.0.1:17610: no answer within 2 s"), "{stderr}");
    assert!(stderr.contains("2 of 3 flights failed; the same command with --out "), "{stderr}");
    let rows = place.rows();
    assert!(rows.len() == 4 && rows[0].ends_with(",failure"), "{rows:?}");
    assert!(rows[1].ends_with(',') && rows[3].contains(",,,") && rows[3].contains("no answer within 2 s"), "{rows:?}");

    simulators.begin(2);
    let (status, stdout, stderr) = printed(&place.fly(&arguments).output().unwrap());
    assert_eq!(status, Some(0), "{stderr}");
    assert!(
        stderr.contains("1 of 3 flights are there already") && stdout.contains("flight 3 of 3, seed 2"),
        "{stdout}"
    );
    let rows = place.rows();
    assert!(rows.len() == 4 && !rows[0].contains("failure"), "{rows:?}");
    starts_are_those_of_the_seeds(&place.out());
}

/// Waits until an X-Plane reports such a value, and returns how long it took.
fn reported(port: u16, path: &str, is_such: impl Fn(f32) -> bool) -> Duration {
    let client = UdpSocket::bind("127.0.0.1:0").unwrap();
    client.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
    let (mut request, mut buffer, begin) = (Vec::new(), [0; 2048], clock::now());
    DatarefRequest { frequency_hz: 50, index: 7, path }.encode(&mut request).unwrap();
    loop {
        client.send_to(&request, ("127.0.0.1", port)).unwrap();
        // On some systems the port of a simulator that has ended makes a receive fail.
        let size = client.recv(&mut buffer).unwrap_or_default();
        let after = clock::now().duration_since(begin);
        if decode_values(&buffer[..size]).is_ok_and(|mut values| values.any(|(_, value)| is_such(value))) {
            return after;
        }
        assert!(after < Duration::from_secs(20), "{path} is never such at port {port}");
    }
}

/// Reads up to the end of the first line with this text, and returns how long it took.
fn read_until(lines: &mut impl BufRead, text: &str) -> Duration {
    let (mut line, begin) = (String::new(), clock::now());
    while !line.contains(text) {
        line.clear();
        assert!(lines.read_line(&mut line).unwrap() > 0, "ended without {text:?}");
    }
    clock::now().duration_since(begin)
}

#[test]
fn an_x_plane_that_is_paused_for_10_s_and_then_killed_and_started_again_is_flown_on_and_the_other_never_stops() {
    let _share = Share::of_flight(4);
    const OVERRIDE: &str = "sim/operation/override/override_joystick";
    const HEIGHT: &str = "sim/flightmodel/position/y_agl";
    let place = Place::new("returned");
    let mut simulators = XPlanes::start(LIFE_PORT);
    let other = LIFE_PORT + 10;
    let named = format!("127.0.0.1:{LIFE_PORT},127.0.0.1:{other}");
    let mut flight = Series::start(
        place.scenario("fly", &["--duration", "60", "--out", "out", "--timeout", "30", "--xplane", &named]),
    );
    let mut lines = flight.wait_for(&["all vehicles active"]);
    let client = UdpSocket::bind("127.0.0.1:0").unwrap();
    let command = |path: &str| {
        let mut datagram = Vec::new();
        SimulatorCommand { path }.encode(&mut datagram).unwrap();
        client.send_to(&datagram, ("127.0.0.1", LIFE_PORT)).unwrap();
    };

    reported(LIFE_PORT, HEIGHT, |height_m| height_m > 3.0);
    command("sim/operation/pause_on");
    read_until(&mut lines, "vehicle 1: simulator paused, waits for it");
    clock::sleep(Duration::from_secs(10));
    command("sim/operation/pause_off");
    let rejoined = read_until(&mut lines, "vehicle 1: active");
    println!("paused 10 s: active {:.1} s after its end", rejoined.as_secs_f64());
    // It holds its place for 2 s, and then joins.
    assert!(rejoined < Duration::from_secs(6), "{rejoined:?}");

    simulators.stop(0);
    read_until(&mut lines, "vehicle 1: ");
    clock::sleep(Duration::from_secs(2));
    simulators.begin(1);
    let controlled = reported(LIFE_PORT, OVERRIDE, |value| value == 1.0);
    let lifted = reported(LIFE_PORT, HEIGHT, |height_m| height_m > 3.0);
    println!(
        "killed: controls {:.1} s after its return, in the air {:.1} s later",
        controlled.as_secs_f64(),
        lifted.as_secs_f64()
    );
    assert!(controlled < Duration::from_secs(2), "{controlled:?}");
    read_until(&mut lines, "vehicle 1: active");
    assert!(reported(other, HEIGHT, |height_m| height_m > 3.0) < Duration::from_secs(1), "the other has landed");
}

/// Each flight began at its own places: the recordings of two seeds differ in the first positions.
fn starts_are_those_of_the_seeds(out: &Path) {
    let first = |seed: u64| {
        let recording =
            skein_lab::record::read(&out.join(format!("seed-{seed}")).join(skein_lab::record::FILE)).unwrap();
        assert_eq!(recording.run.seed, seed);
        let starts = skein_core::start::starts(&recording.scenario).unwrap();
        for (track, start) in recording.tracks.iter().zip(&starts) {
            let place = track.steps[0].trace.position;
            let away_m = skein_common::math::hypot(place.north_m() - start.north_m, place.east_m() - start.east_m);
            assert!(away_m < 5.0, "seed {seed}: {away_m} m from its start when the clock begins");
        }
        starts[0]
    };
    assert_ne!(first(0).north_m.to_bits(), first(1).north_m.to_bits());
}

#[test]
fn a_series_that_would_never_end_or_is_a_fleet_is_refused() {
    let _share = Share::of_flight(4);
    let place = Place::new("refused-series");
    let endless = place.folder.path().join("endless.toml");
    fs::write(&endless, "swarm.vehicles = 2\n").unwrap();
    let (status, _, stderr) = printed(&place.command("fly", &["endless.toml", "--runs", "2"]).output().unwrap());
    assert_eq!((status, place.out().exists()), (Some(2), false), "{stderr}");
    let why = "endless.toml: nothing ends a flight of this scenario, so --runs would never begin the second; add --duration S";
    assert!(stderr.contains(why), "{stderr}");
    let (status, _, stderr) = printed(&place.fly(&["--runs", "0"]).output().unwrap());
    assert_eq!(status, Some(2), "{stderr}");
}
