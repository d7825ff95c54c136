//! `skein fly` as a user runs it: processes, signals, files. Every test has its own swarm, runtime folder and output
//! folder, and leaves no process behind.

use skein_tests::share::Share;
use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader};
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use skein_cluster::endpoints;
use skein_cluster::mesh::observe::{Observer, SwarmMessage};
use skein_cluster::mesh::reach::Reach;
use skein_common::message::{EventKind, Trace};
use skein_common::scenario::{Source, load};
use skein_common::time::SenderStamp;
use skein_common::topic::Branch;
use skein_lab::record;
use skein_lab::recording::{NotedKind, Track};
use tempfile::TempDir;

const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");
/// Timeout for the start and the end of a small swarm.
const SOON: Duration = Duration::from_secs(60);

/// Least share of a flight's frames on a busy PC.
const AT_LEAST: f64 = 0.7;

/// Folders of a test's swarm.
pub(crate) struct Place {
    name: &'static str,
    folder: TempDir,
}

impl Place {
    pub(crate) fn new(name: &'static str) -> Self {
        Self { name, folder: tempfile::tempdir().unwrap() }
    }

    pub(crate) fn out(&self) -> PathBuf {
        self.folder.path().join("out")
    }

    fn runtime(&self) -> PathBuf {
        self.folder.path().join("runtime")
    }

    pub(crate) fn command(&self) -> Command {
        let mut command = Command::new(PROGRAM);
        command.env("XDG_RUNTIME_DIR", self.runtime()).env_remove("RUST_LOG").current_dir(self.folder.path());
        command
    }

    /// A flight of three vehicles at low altitude, which take off and land quickly.
    fn fly(&self) -> Command {
        self.fly_into("out")
    }

    fn fly_into(&self, out: &str) -> Command {
        let mut command = self.command();
        command.arg("fly").arg("--out").arg(self.folder.path().join(out));
        for set in ["swarm.vehicles=3", "formation.altitude_m=5", "formation.radius_m=60"] {
            command.args(["--set", set]);
        }
        command.arg("--set").arg(format!("swarm.name={}", self.name));
        command
    }

    fn order(&self, verb: &str) -> Output {
        self.command().args(["order", verb]).output().unwrap()
    }

    /// Processes of this swarm, as `(pid, command line)`.
    pub(crate) fn processes(&self) -> Vec<(Pid, String)> {
        let listed = Command::new("ps").args(["-axww", "-o", "pid=,args="]).output().unwrap();
        let folder = self.folder.path().to_str().unwrap();
        let listed = String::from_utf8_lossy(&listed.stdout).into_owned();
        let ours = listed.lines().filter(|line| line.contains(folder) && line.contains("skein-under-test"));
        let split = |line: &str| {
            let (pid, arguments) = line.trim().split_once(' ').unwrap();
            (Pid::from_raw(pid.parse().unwrap()).unwrap(), arguments.to_owned())
        };
        ours.map(split).collect()
    }

    fn agent(&self, id: u8) -> Option<Pid> {
        self.process(&format!("agents/{id}.toml --child"))
    }

    fn standin(&self, id: u8) -> Option<Pid> {
        self.process(&format!("--id {id} --lat"))
    }

    fn process(&self, arguments: &str) -> Option<Pid> {
        self.processes().into_iter().find(|(_, line)| line.contains(arguments)).map(|(pid, _)| pid)
    }

    /// Opens an observer of the swarm, as `fly` does.
    fn observer(&self) -> Observer {
        let endpoints = endpoints::find(&self.runtime().join("skein"), None).unwrap();
        let mut observer = Observer::open(&Reach::here(&endpoints, Branch::SWARM)).unwrap();
        observer.subscribe_to_traces(true).unwrap();
        observer
    }

    fn wait_until_all_processes_ended(&self) {
        let until = Instant::now() + SOON;
        while !self.processes().is_empty() {
            assert!(Instant::now() < until, "still there: {:#?}", self.processes());
            std::thread::sleep(Duration::from_millis(200));
        }
    }

    pub(crate) fn metrics(&self) -> Value {
        serde_json::from_str(&fs::read_to_string(self.out().join("metrics.json")).unwrap()).unwrap()
    }

    /// Number of files with the endpoints of a swarm.
    fn endpoint_files(&self) -> usize {
        fs::read_dir(self.runtime().join("skein")).map_or(0, Iterator::count)
    }
}

impl Drop for Place {
    /// Ends all processes, also of a failed test.
    fn drop(&mut self) {
        for (pid, _) in self.processes() {
            let _ = kill_process(pid, Signal::KILL);
        }
    }
}

#[test]
fn without_an_x_plane_fly_and_check_fail_within_3_s() {
    let _share = Share::of(10);
    let place = Place::new("no-x-plane");
    let silent = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = silent.local_addr().unwrap().to_string();
    let output = |command: &mut Command| {
        let begin = Instant::now();
        let output = command.output().unwrap();
        let took = begin.elapsed();
        assert!(took < Duration::from_secs(3), "{took:?}");
        let text = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
        (output.status.code(), text)
    };
    let check = output(place.command().args(["xplane", "check", "--xplane", &address]));
    let fly = output(place.fly().args(["--set", "swarm.vehicles=1", "--plant", "xplane", "--xplane", &address]));
    assert!(fly.0 == Some(1) && fly.1[1].contains("no answer within 2 s; is X-Plane running"), "{fly:?}");
    assert!(check.0 == Some(1) && check.1[0].contains("FAULT  no answer within 2 s"), "{check:?}");
    assert!(!place.out().exists() && place.processes().is_empty() && place.endpoint_files() == 0);
}

/// A running `skein fly`, whose output is read line by line.
struct Flight {
    process: Child,
    lines: Receiver<(Instant, String)>,
}

impl Flight {
    fn start(place: &Place, arguments: &[&str]) -> Self {
        let mut command = place.fly();
        command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut process = command.spawn().unwrap();
        let stdout = BufReader::new(process.stdout.take().unwrap());
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            for line in stdout.lines().map_while(Result::ok) {
                let _ = sender.send((Instant::now(), line));
            }
        });
        Self { process, lines }
    }

    fn pid(&self) -> Pid {
        Pid::from_child(&self.process)
    }

    /// Waits until each of these texts was in some line, in any order, and returns the time of the last one.
    fn wait_for_all(&self, texts: &[&str]) -> Instant {
        let (mut missing, until) = (texts.to_vec(), Instant::now() + SOON);
        loop {
            match self.lines.recv_timeout(until.saturating_duration_since(Instant::now())) {
                Ok((at, line)) => {
                    missing.retain(|text| !line.contains(text));
                    if missing.is_empty() {
                        return at;
                    }
                }
                Err(RecvTimeoutError::Timeout) => panic!("timeout without {missing:?}"),
                Err(RecvTimeoutError::Disconnected) => panic!("ended without {missing:?}"),
            }
        }
    }

    fn wait_for(&self, text: &str) -> Instant {
        self.wait_for_all(&[text])
    }

    fn interrupt(&self) {
        kill_process(self.pid(), Signal::INT).unwrap();
    }

    /// Waits for the end, and returns the exit status and the text on stderr.
    fn end(self) -> (Option<i32>, String) {
        let output = self.process.wait_with_output().unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    }
}

/// Checks the lines of `--json`: each has its kind and times, in order, and the last has the figures.
fn streams_the_flight(lines: &[Value], metrics: &Value, out: &Path) {
    let of = |kind: &str| lines.iter().filter(|line| line["kind"] == kind).collect::<Vec<_>>();
    let first = |kind: &str| lines.iter().position(|line| line["kind"] == kind).unwrap_or_else(|| panic!("no {kind}"));
    let places = ["began", "active", "window", "landing", "landed", "result"].map(first);
    assert!(places.is_sorted() && places[0] == 0 && places[5] == lines.len() - 1, "{places:?} of {}", lines.len());
    assert_eq!((&lines[0]["ids"], &lines[0]["duration_s"]), (&serde_json::json!([1, 2, 3]), &20.0.into()));
    assert_eq!((of("active").len(), of("landed").len(), of("window").len()), (3, 3, 1));
    assert!(
        of("window")[0]["t_s"] == 0.0
            && of("active")[0]["t_s"].is_null()
            && of("landed")[0]["t_s"].as_f64() > Some(20.0)
    );
    let progress = of("progress");
    assert!((2..=6).contains(&progress.len()), "{progress:?}");
    assert!(
        progress.iter().all(|line| line["vehicles"].as_array().is_some_and(|rows| rows.len() == 3)),
        "{progress:?}"
    );
    assert!(progress[1]["vehicles"][0]["altitude_m"].as_f64().is_some_and(|high_m| high_m > 1.0), "{progress:?}");
    let mut result = lines[lines.len() - 1].as_object().unwrap().clone();
    let own = ["kind", "at_s", "t_s", "error", "notes", "out"].map(|key| result.remove(key).unwrap());
    assert_eq!((&own[3], &own[4], own[5].as_str()), (&Value::Null, &serde_json::json!([]), out.to_str()));
    assert_eq!(&Value::Object(result), metrics);
}

#[test]
fn a_flight_of_twenty_seconds_leaves_its_files_and_no_process() {
    let _share = Share::of_flight(4);
    let place = Place::new("whole");
    let flown = place.fly().args(["--duration", "20", "--seed", "5", "--plant", "builtin", "--json"]).output().unwrap();
    let stderr = String::from_utf8_lossy(&flown.stderr).into_owned();
    assert!(flown.status.success(), "{stderr}");
    assert_eq!(place.processes(), []);
    assert_eq!(place.endpoint_files(), 0);

    let metrics = place.metrics();
    let lines = String::from_utf8(flown.stdout).unwrap();
    let lines: Vec<Value> =
        lines.lines().map(|line| serde_json::from_str(line).expect("only JSON on stdout, an object a line")).collect();
    streams_the_flight(&lines, &metrics, &place.out());
    assert_eq!(
        (&metrics["plant"], &metrics["target"], &metrics["seed"]),
        (&"builtin".into(), &"fly".into(), &5.into())
    );
    assert_eq!((&metrics["vehicles"], &metrics["collisions"]), (&3.into(), &0.into()));
    assert_eq!(metrics["duration_s"].as_f64(), Some(20.0));
    assert!(metrics["at_altitude_s"].as_f64().is_some_and(|at_s| at_s > 1.0), "{metrics:#}");
    assert!(metrics["in_band_s"].as_f64().is_some(), "{metrics:#}");
    assert!(metrics["step_p99_us"].as_f64().is_some_and(|step_us| step_us > 0.0), "{metrics:#}");
    let real_time = metrics["real_time_factor"].as_f64().unwrap();
    assert!((AT_LEAST..1.05).contains(&real_time), "{real_time}");

    let flown_as = fs::read_to_string(place.out().join("scenario.toml")).unwrap();
    let scenario = load(&Source { name: "scenario.toml", text: &flown_as }, &[]).unwrap().scenario;
    assert_eq!((scenario.seed, scenario.duration_s, scenario.swarm.vehicles), (5, Some(20.0), 3));
    let recording = record::read(&place.out().join(record::FILE)).unwrap();
    assert_eq!((recording.run.seed, recording.run.target.as_str(), &recording.scenario), (5, "fly", &scenario));
    for Track { id, steps } in &recording.tracks {
        let all = steps.len() as f64 / (20.0 * 50.0);
        assert!((AT_LEAST..1.005).contains(&all), "vehicle {id}: {} steps of 20 s at 50 Hz", steps.len());
        assert!(steps[0].t_s < 0.5 && steps[steps.len() - 1].t_s > 19.5);
        let high =
            recording.noted.iter().filter(|noted| noted.what == NotedKind::Event(*id, EventKind::AtAltitude)).count();
        assert_eq!(high, 1, "vehicle {id} reached its altitude once: {:#?}", recording.noted);
    }
    for phrase in [
        "all vehicles active",
        "all vehicles are ordered to land",
        "landing from 5 m: about",
        "3 of 3 landed",
        "3 of 3 ended",
    ] {
        assert!(stderr.contains(phrase), "{phrase:?} is missing in\n{stderr}");
    }
}

#[test]
fn control_c_lands_all_vehicles() {
    let _share = Share::of_flight(4);
    let place = Place::new("stopped");
    let flight = Flight::start(&place, &["--plant", "standin"]);
    flight.wait_for("all vehicles active");
    std::thread::sleep(Duration::from_secs(5));
    flight.interrupt();
    flight.wait_for("3 of 3 landed");
    flight.wait_for("files");
    flight.wait_for_all(&["  skein report ", "  skein fly --set swarm.vehicles=3 ", "  skein study "]);
    assert_eq!(flight.end(), (Some(0), String::new()));
    assert_eq!(place.processes(), []);
    assert_eq!(place.endpoint_files(), 0);
    let metrics = place.metrics();
    assert!(metrics["duration_s"].as_f64().is_some_and(|flown_s| (5.0..12.0).contains(&flown_s)), "{metrics:#}");
    assert_eq!(metrics["plant"], "standin");
}

#[test]
fn control_c_twice_ends_at_once() {
    let _share = Share::of_flight(4);
    let place = Place::new("urgent");
    let flight = Flight::start(&place, &[]);
    flight.wait_for("all vehicles active");
    std::thread::sleep(Duration::from_secs(4));
    flight.interrupt();
    flight.wait_for("all vehicles are ordered to land");
    std::thread::sleep(Duration::from_millis(300));
    let asked = Instant::now();
    flight.interrupt();
    let (status, stderr) = flight.end();
    assert!(asked.elapsed() < Duration::from_secs(10));
    assert_eq!(status, Some(1));
    assert_eq!(stderr, "vehicle 1, 2, 3: ended by Ctrl-C\n");
    assert_eq!(place.processes(), []);
    assert!(place.metrics()["duration_s"].is_number(), "the measured time ended before");
}

#[test]
fn a_vehicle_that_is_killed_is_named_and_the_others_fly_on() {
    let _share = Share::of_flight(4);
    let place = Place::new("bereft");
    let flight = Flight::start(&place, &[]);
    flight.wait_for("all vehicles active");
    std::thread::sleep(Duration::from_secs(3));
    let killed = Instant::now();
    kill_process(place.agent(2).unwrap(), Signal::KILL).unwrap();
    let named = ["vehicle 2: killed by signal 9", "2 of 2 lost contact with vehicle 2"];
    let after = flight.wait_for_all(&named).duration_since(killed);
    assert!(after < Duration::from_secs(5), "named after {after:?}");
    std::thread::sleep(Duration::from_secs(3));
    let status = place.command().args(["status", "--json"]).output().unwrap();
    let shown: Value = serde_json::from_slice(&status.stdout).unwrap();
    let reports = shown["nodes"].as_array().unwrap().iter().map(|node| node["said"]["phase"].is_string());
    assert_eq!(reports.collect::<Vec<_>>(), [true, false, true], "{shown:#}");
    let stderr = String::from_utf8_lossy(&status.stderr).into_owned();
    assert_eq!((status.status.code(), stderr.as_str()), (Some(1), "swarm bereft on this PC\nnot in contact: node 2\n"));
    assert!(place.agent(1).is_some() && place.agent(3).is_some() && place.agent(2).is_none());
    flight.interrupt();
    flight.wait_for("files");
    let (status, stderr) = flight.end();
    assert_eq!(status, Some(0), "the others' flight counts");
    assert!(stderr.starts_with("lost after ") && stderr.contains("vehicle 2: killed by signal 9"), "{stderr}");
    assert_eq!(place.processes(), []);
}

#[test]
fn a_swarm_whose_launcher_is_killed_flies_on_until_it_is_ordered_to_land() {
    let _share = Share::of_flight(4);
    let place = Place::new("orphaned");
    let mut flight = Flight::start(&place, &["--plant", "standin"]);
    flight.wait_for("all vehicles active");
    std::thread::sleep(Duration::from_secs(2));
    flight.process.kill().unwrap();
    flight.process.wait().unwrap();
    std::thread::sleep(Duration::from_secs(7));
    assert_eq!(place.processes().len(), 6, "three agents and three stand-ins fly on: {:#?}", place.processes());

    let second = place.fly_into("second").output().unwrap();
    let refusal = String::from_utf8_lossy(&second.stderr).into_owned();
    assert_eq!(second.status.code(), Some(2));
    assert!(refusal.contains("a swarm named orphaned flies here already"), "{refusal}");
    assert!(!place.folder.path().join("second").exists());

    orders_report_their_effect(&place);
    place.wait_until_all_processes_ended();

    let refused = place.order("hold");
    assert_eq!(refused.status.code(), Some(1));
    assert_eq!(
        String::from_utf8_lossy(&refused.stderr),
        "swarm orphaned on this PC\nno vehicle of swarm orphaned answered\n"
    );
}

/// Gives orders to three vehicles whose mission has one step; at the end they land.
fn orders_report_their_effect(place: &Place) {
    let order = |line: &str| {
        let output = place.command().arg("order").args(line.split(' ')).output().unwrap();
        let errors = String::from_utf8(output.stderr).unwrap();
        let errors = errors.strip_prefix("swarm orphaned on this PC\n").expect("the swarm that was chosen");
        (output.status.code(), String::from_utf8(output.stdout).unwrap() + errors)
    };
    let printed = |code, text: &str| (Some(code), format!("{text}\n"));
    assert_eq!(order("goto 5"), printed(2, "the mission has no step 5: its only step is 0"));
    assert_eq!(order("goto 0"), printed(1, "goto 0: no effect: vehicle 1-3: step 0, as before"));
    let held = "hold: accepted by vehicle 1-3; vehicle 1-3: step 0 -> held at step 0";
    assert_eq!(order("hold"), printed(0, held));
    assert_eq!(order("hold"), printed(1, "hold: no effect: vehicle 1-3: held at step 0, as before"));
    let on = "goto 0: accepted by vehicle 1-3; vehicle 1-3: held at step 0 -> step 0";
    assert_eq!(order("goto 0"), printed(0, on));
    let (status, object) = order("hold --json");
    let object: Value = serde_json::from_str(&object).expect("one object and nothing else");
    assert_eq!((status, &object["order"], &object["swarm"]), (Some(0), &"hold".into(), &"orphaned".into()));
    assert_eq!((&object["accepted"], &object["silent"]), (&serde_json::json!([1, 2, 3]), &serde_json::json!([])));
    assert_eq!(
        object["changes"][2],
        serde_json::json!({ "vehicle": 3, "before": "step 0", "after": "held at step 0" })
    );
    assert_eq!(order("goto 0"), printed(0, on));
    one_vehicle_is_ordered_alone(order);
    assert_eq!(order("abort"), printed(0, "abort: accepted by vehicle 1-3; vehicle 1-3: step 0 -> aborted"));
    assert_eq!(
        order("hold"),
        printed(1, "hold: refused, because swarm orphaned was ordered to abort and no order can undo that")
    );
}

/// Orders vehicle 3 of three alone: it is held, joins again, and is released to a pilot for a moment.
fn one_vehicle_is_ordered_alone(order: impl Fn(&str) -> (Option<i32>, String)) {
    let refused = |line, why: &str| assert_eq!(order(line), (Some(2), format!("{why}\n")), "{line}");
    refused("release", "release: name the vehicles that human pilots are to fly, such as --vehicles 3");
    refused("hold --vehicles 2-4", "hold: swarm orphaned has no vehicle 4; its vehicles are 1-3");
    let changes = |line: &str, change: &str| {
        let verb = line.strip_suffix(" --vehicles 3").unwrap();
        assert_eq!(order(line), (Some(0), format!("{verb}: accepted by vehicle 3; vehicle 3: {change}\n")));
    };
    changes("hold --vehicles 3", "step 0 -> held at step 0");
    changes("goto 0 --vehicles 3", "held at step 0 -> joining");
    std::thread::sleep(Duration::from_secs(4));
    changes("release --vehicles 3", "step 0 -> released");
    changes("goto 0 --vehicles 3", "released -> joining");
    std::thread::sleep(Duration::from_secs(4));
}

/// All traces that arrive within this time.
fn steps(observer: &mut Observer, within: Duration) -> Vec<Trace> {
    std::thread::sleep(within);
    let received = observer.poll().into_iter().filter_map(|received| match received {
        SwarmMessage::Trace(trace) => Some(trace),
        _ => None,
    });
    received.collect()
}

/// Longest time without a step of each vehicle, by its own clock, s, from the traces of a `window`.
fn pauses_s(steps: &[Trace], window: Duration) -> BTreeMap<u8, f64> {
    let mut stamps: BTreeMap<u8, Vec<SenderStamp>> = BTreeMap::new();
    steps.iter().for_each(|step| stamps.entry(step.header.sender.get()).or_default().push(step.header.stamp));
    let pause_s = |stamps: Vec<SenderStamp>| {
        let span_s = stamps[stamps.len() - 1].seconds_since(stamps[0]);
        let between = stamps.windows(2).map(|pair| pair[1].seconds_since(pair[0]));
        between.fold(window.as_secs_f64() - span_s, f64::max)
    };
    stamps.into_iter().map(|(id, stamps)| (id, pause_s(stamps))).collect()
}

#[test]
fn a_kill_of_any_process_never_stops_the_others() {
    let _share = Share::of_flight(4);
    let place = Place::new("survivors");
    let mut flight = Flight::start(&place, &["--plant", "standin", "--set", "swarm.vehicles=4"]);
    flight.wait_for("all vehicles active");
    let mut observer = place.observer();
    steps(&mut observer, Duration::from_secs(3));
    let window = Duration::from_millis(1500);
    let victims: [(&str, Option<Pid>, &[u8]); 7] = [
        ("agent 1", place.agent(1), &[2, 3, 4]),
        ("stand-in 1", place.standin(1), &[2, 3, 4]),
        ("fly", Some(flight.pid()), &[2, 3, 4]),
        ("stand-in 2", place.standin(2), &[3, 4]),
        ("agent 2", place.agent(2), &[3, 4]),
        ("agent 3", place.agent(3), &[4]),
        ("stand-in 3", place.standin(3), &[4]),
    ];
    for (victim, pid, others) in victims {
        observer.poll();
        kill_process(pid.unwrap(), Signal::KILL).unwrap();
        let pauses_s = pauses_s(&steps(&mut observer, window), window);
        println!("{victim} killed: longest pause of each vehicle in contact, s: {pauses_s:.3?}");
        for other in others {
            assert!(pauses_s.get(other).is_some_and(|pause_s| *pause_s <= 0.2), "{victim}: {other} in {pauses_s:?}");
        }
    }
    flight.process.wait().unwrap();
    assert!(place.order("land").status.success());
    place.wait_until_all_processes_ended();
}

#[test]
fn a_scenario_kills_and_restarts_an_agent_whose_helicopter_flies_on() {
    let _share = Share::of_flight(4);
    let place = Place::new("relieved");
    let file = place.folder.path().join("relieved.toml");
    let mission = r#"
        swarm.plant = "standin"
        [mission]
        steps = [{ hold_s = 14 }, { land = true }]
        events = [
            { at_s = 9, fault = "kill", vehicle = 2, for_s = 1.5 },
            { at_s = 13, order = "hold", for_s = 2 },
            { at_s = 14, fault = "simulator_freeze", vehicle = 3, for_s = 0.4 },
            { at_s = 15, fault = "gyro_off", vehicle = 3 },
        ]
    "#;
    fs::write(&file, mission).unwrap();
    let flight = Flight::start(&place, &[file.to_str().unwrap(), "--set", "formation.altitude_m=10"]);
    flight.wait_for("event: kills vehicle 2");
    flight.wait_for("2 of 2 lost contact with vehicle 2");
    let restarted = flight.wait_for("event: restarts vehicle 2");
    let mut observer = place.observer();
    let joined = flight.wait_for("vehicle 2: active").duration_since(restarted);
    assert!(joined < Duration::from_secs(10), "{joined:?}");
    flight.wait_for_all(&[
        "event: orders hold",
        "event: freezes the simulator of vehicle 3",
        "vehicle 3: simulator data stale",
        "event: resumes the simulator of vehicle 3",
        "vehicle 3: simulator data available again",
        "event: orders goto 0",
        "continue to step 1",
    ]);
    let lowest_m = steps(&mut observer, Duration::ZERO).iter().map(|step| step.height_m).fold(f64::INFINITY, f64::min);
    assert!(lowest_m > 5.0, "down to {lowest_m} m");
    flight.wait_for_all(&["all vehicles are ordered to land", "3 of 3 landed"]);
    flight.wait_for("files");
    let (status, stderr) = flight.end();
    let skipped = "at 15 s: gyro_off of vehicle 3: skipped by `fly`: the stand-in cannot simulate this failure\n";
    assert_eq!((status, stderr.as_str()), (Some(0), skipped), "a mission that ends ends the flight");
    assert_eq!(place.processes(), []);
    let metrics = place.metrics();
    let figure = |key: &str| metrics[key].as_f64().unwrap_or_else(|| panic!("{key} in {metrics:#}"));
    assert!(figure("detection_s") < 0.5 && (2.0..4.0).contains(&figure("rejoin_s")), "{metrics:#}");
    assert_eq!((figure("collisions"), figure("false_suspicions")), (0.0, 0.0));
}

#[test]
fn an_invalid_flight_is_refused_before_any_process_starts() {
    let _share = Share::of(20);
    let place = Place::new("refused");
    let file = place.folder.path().join("my.toml");
    fs::write(&file, "[swarm]\nvehicles = 3\n[formation]\nraduis_m = 80\n").unwrap();
    let my = file.to_str().unwrap();
    let gone = "--set network.state_json_hz=1: `network.state_json_hz` was removed: the state for people will be published as \
                `summary`; leave this `--set` out\n";
    let cases: [(&[&str], String); 5] = [
        (&[my], format!("{my}:4:1: unknown key `formation.raduis_m`; did you mean `formation.radius_m`?\n")),
        (&["--set", "seed=x"], "--set seed=x: `seed` has to be a whole number, not \"x\"\n".to_owned()),
        (&["--duration", "-4"], String::new()),
        (&["--set", "network.state_json_hz=1"], gone.to_owned()),
        (&["--plant", "builtin", "--xplane", "heli:49000"], String::new()),
    ];
    for (arguments, expected) in cases {
        let refused = place.fly().args(arguments).output().unwrap();
        let stderr = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert_eq!(refused.status.code(), Some(2), "{arguments:?}: {stderr}");
        assert!(refused.stdout.is_empty() && !stderr.is_empty());
        assert!(expected.is_empty() || stderr == expected, "{arguments:?}: {stderr}");
        assert!(!place.out().exists() && !place.runtime().exists(), "{arguments:?} wrote something");
    }
}
