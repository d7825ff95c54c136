//! Untrusted hosts and vehicles: what the operator's commands accept from them and show. The real program runs with a
//! script as `ssh`.

use skein_tests::share::Share;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;
use std::time::Duration;

use serde_json::{Value, json};
use skein_agent::link::{Link, Security, Sessions, Trust};
use skein_common::id::{Incarnation, SwarmName, VehicleId};
use skein_common::message::{Drops, Header, Health};
use skein_common::scenario::{Source, load};
use skein_common::state::Activity;
use skein_common::time::SenderStamp;
use skein_host::clock::{LocalClock, utc_nanoseconds};
use tempfile::TempDir;

const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");
/// Control sequences of a terminal: clear the screen, set the title, the C1 introducer, reverse the writing direction.
const HOSTILE: &str = "\u{1b}[2J\u{1b}]0;all is well\u{7}\u{9b}31m\u{202e}";

/// An operator's PC with a cluster of vehicles 1 to N; a script answers for the hosts.
struct Pc {
    folder: TempDir,
}

struct Finished {
    status: Option<i32>,
    out: String,
    err: String,
}

impl Pc {
    /// `network` is the part of 127.0.0.0/8 that only these vehicles use.
    fn new(vehicles: u8, network: &str, security: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let nodes: String =
            (1..=vehicles).map(|id| format!("[node.{id}]\nhost = 'heli{id}'\naddress = '{network}.{id}'\n")).collect();
        let cluster = format!("swarm = 'lab'\nscenario = 'one.toml'\nsecurity = '{security}'\n{nodes}");
        fs::write(folder.path().join("one.toml"), format!("swarm.vehicles = {vehicles}\n")).unwrap();
        fs::write(folder.path().join("cluster.toml"), cluster).unwrap();
        let pc = Self { folder };
        pc.answers("exit 1");
        pc
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Sets the script by which hosts answer, between the marks of the call. `$host` is the host, `$asked` the line of the request, which the file
    /// `asked` keeps.
    fn answers(&self, script: &str) {
        let folder = self.folder.path().display();
        let text = format!(
            "#!/bin/sh\ncase \" $* \" in *\" -G \"*) exit 0;; esac\nfor command; do before=$host; host=$last; last=$command; done\n\
             name=$(echo \"$last\" | grep -o 'skein-[0-9a-f]\\{{32\\}}' | head -n 1)\n\
             printf '%s-begin\\n' \"$name\"; printf '%s-begin\\n' \"$name\" >&2\nread -r asked\n\
             echo \"$host $asked\" >>{folder}/asked\ncd {folder}\n({script}\n)\nstatus=$?\n\
             printf '%s-end %d.\\n' \"$name\" $status; printf '%s-end\\n' \"$name\" >&2\nexit $status\n"
        );
        fs::create_dir_all(self.path("bin")).unwrap();
        fs::write(self.path("bin/ssh"), text).unwrap();
        fs::set_permissions(self.path("bin/ssh"), fs::Permissions::from_mode(0o755)).unwrap();
        fs::write(self.path("asked"), "").unwrap();
    }

    fn asked(&self) -> String {
        fs::read_to_string(self.path("asked")).unwrap()
    }

    fn skein(&self, arguments: &str) -> Finished {
        let mut command = Command::new(PROGRAM);
        let path = format!("{}:{}", self.path("bin").display(), std::env::var("PATH").unwrap());
        command.args(arguments.split(' ')).current_dir(self.folder.path()).env("PATH", path);
        let output = command.env("XDG_RUNTIME_DIR", self.path("runtime")).output().unwrap();
        let text = |bytes| String::from_utf8(bytes).unwrap();
        Finished { status: output.status.code(), out: text(output.stdout), err: text(output.stderr) }
    }

    /// Script of a host that reports an agent flying in this run.
    fn facts(run: Option<u64>, note: &Value) -> String {
        let installed = json!({ "release": "r1", "bundle": "00" });
        let agent = run.map(|run| json!({ "pid": 7, "installed": installed, "run": run, "restarts": 0 }));
        let facts = json!({
            "current": installed, "previous": null, "service": "Own", "agent": agent, "note": note, "free_bytes": 1,
        });
        format!(
            "case \"$asked\" in *Start*) echo '{}';; *) echo '{}';; esac",
            json!({ "Done": { "changed": true, "forced": false, "facts": facts } }),
            json!({ "Facts": facts })
        )
    }
}

/// Checks that a hostile text is shown without control characters, with their numbers visible.
fn is_shown_as_text(shown: &str) {
    assert!(!shown.contains(|c: char| c.is_control() && c != '\n' || c == '\u{202e}'), "{shown:?}");
    assert!(shown.contains("\\u001b[2J\\u001b]0;all is well\\u0007\\u009b31m\\u202e"), "{shown:?}");
}

#[test]
fn output_of_hosts_is_shown_without_control_characters() {
    let _share = Share::of(20);
    let pc = Pc::new(2, "127.77.1", "none");
    pc.answers(&format!(
        "case $host in heli1) printf '%s\\n' 'one{HOSTILE}two';; *) printf '%s\\n' 'no log{HOSTILE}' >&2; exit 1;; esac"
    ));
    let logs = pc.skein("cluster logs --file cluster.toml");
    is_shown_as_text(&logs.out);
    is_shown_as_text(&logs.err);
    assert!(logs.out.contains("node-1 | one\\u001b"), "{}", logs.out);
    let json = pc.skein("cluster logs --json --file cluster.toml").out;
    assert!(!json.contains(|c: char| c.is_control() && c != '\n' || c == '\u{202e}'), "{json:?}");
    serde_json::from_str::<Value>(json.lines().next().unwrap()).unwrap();

    // In an answer of a host, and in the error of ssh itself.
    let failed = json!({ "Failed": format!("no room{HOSTILE}\nnode 2 installed") }).to_string();
    pc.answers(&format!("printf '%s\\n' '{failed}'"));
    let down = pc.skein("cluster down -f cluster.toml --timeout 1");
    for shown in [&down.out, &down.err] {
        assert!(!shown.contains(|c: char| c.is_control() && c != '\n' || c == '\u{202e}'), "{shown:?}");
    }
    assert!(
        down.err.contains("no room\\u001b[2J") && down.err.contains("\\u202e\\u000anode 2 installed"),
        "{}",
        down.err
    );
    pc.answers(&format!("printf '%s\\n' 'Bad port{HOSTILE}' >&2; exit 255"));
    is_shown_as_text(&pc.skein("cluster down -f cluster.toml --timeout 1").err);
}

#[test]
fn health_reports_of_vehicles_are_shown_without_control_characters() {
    let _share = Share::of(20);
    let pc = Pc::new(1, "127.77.2", "none");
    let swarm = SwarmName::new("lab").unwrap();
    let id = VehicleId::new(1).unwrap();
    let sessions = Sessions::open(&swarm, &["tcp/127.77.2.1:7447".to_owned()], &[], &Security::Plain).unwrap();
    let scenario = load(&Source { name: "x", text: "swarm.vehicles = 1" }, &[]).unwrap().scenario;
    let trust = Trust { swarm, ..Trust::of(&scenario) };
    let link = Link::new(sessions, id, LocalClock::start(), trust).unwrap();
    let mut line = link.health(utc_nanoseconds).unwrap();
    let health = |sequence| Health {
        header: Header { sender: id, incarnation: Incarnation(1), sequence, stamp: SenderStamp::ZERO },
        uptime_s: 1.0,
        activity: Activity::Formation,
        in_place_s: None,
        plant: format!("x{HOSTILE}"),
        version: format!("1\nnode 9: good{HOSTILE}"),
        failures: Vec::new(),
        simulator_faults: Vec::new(),
        frame_rate_hz: 50.0,
        jitter_ms: 1.0,
        step_p50_us: 1.0,
        step_p99_us: 1.0,
        frame_overruns: 0,
        drops: Drops::default(),
        unsent: 0,
        refused: Vec::new(),
        state_messages: 0,
        state_bytes: 0,
        links: 0,
        sent: Default::default(),
        received: Default::default(),
        peers: Vec::new(),
    };
    let is_over = AtomicBool::new(false);
    thread::scope(|scope| {
        scopeguard::defer! { is_over.store(true, Relaxed) }
        scope.spawn(|| {
            for sequence in 1.. {
                line.publish(health(sequence));
                thread::sleep(Duration::from_millis(50));
                if is_over.load(Relaxed) {
                    return;
                }
            }
        });
        let [text, json] = ["cluster status -f cluster.toml", "cluster status --json -f cluster.toml"]
            .map(|arguments| pc.skein(arguments));
        is_shown_as_text(&text.out);
        assert!(text.out.contains("1\\u000anode 9: good\\u001b"), "one line: {}", text.out);
        assert_eq!(text.status, Some(0), "{}", text.err);
        assert!(!json.out.contains(|c: char| c.is_control() && c != '\n' || c == '\u{202e}'), "{:?}", json.out);
    });
}

#[test]
fn up_does_not_join_a_run_that_only_one_host_reports() {
    let _share = Share::of(20);
    let pc = Pc::new(2, "127.77.3", "tls");
    let keys = pc.skein("cluster keys -f cluster.toml");
    assert_eq!(keys.status, Some(0), "{}", keys.err);
    let up = || pc.skein("cluster up -f cluster.toml --timeout 0.2");
    let refused = |why: &str| {
        let finished = up();
        assert!(finished.status == Some(2) && finished.err.contains(why), "{} {}", finished.out, finished.err);
        assert!(!pc.asked().contains("Start"), "no agent is started: {}", pc.asked());
    };
    let only_the_first =
        |facts: String, others: String| format!("if [ $host = heli1 ]; then {facts}; else {others}; fi");
    let idle = Pc::facts(None, &Value::Null);

    // The first host reports a run that was not started from this PC.
    pc.answers(&only_the_first(Pc::facts(Some(42), &Value::Null), idle.clone()));
    refused("node 1 in run 42 reported to fly, but no run was begun from this PC");

    // No agent flies: `up` starts a new run and leaves a signed note on every host and on this PC.
    pc.answers(&idle);
    let begun = up();
    assert_eq!(begun.status, Some(1), "the hosts only report a start, no agent runs: {}", begun.err);
    let kept = || serde_json::from_str::<Value>(&fs::read_to_string(pc.path("keys/run.json")).unwrap()).unwrap();
    let note = kept()["note"].clone();
    let run = note["run"].as_u64().unwrap();
    let started = format!(
        "\"Start\":{{\"run\":{run},\"note\":{{\"run\":{run},\"began_ms\":{},\"seal\":{}}}}}",
        note["began_ms"], note["seal"]
    );
    assert_eq!(pc.asked().matches(&started).count(), 2, "{}", pc.asked());

    // A host that still flies in that run is joined: this PC started the run, and the run is not over.
    pc.answers(&only_the_first(Pc::facts(Some(run), &note), idle.clone()));
    let joined = up();
    assert!(joined.out.contains(&format!("(run {run})")), "{} {}", joined.out, joined.err);
    assert_eq!(pc.asked().matches(&started).count(), 2, "{}", pc.asked());

    // An old run that was aborted and is over: its host still has the note that the operator signed.
    let mut over = kept();
    over["over"] = json!(true);
    fs::write(pc.path("keys/run.json"), over.to_string()).unwrap();
    pc.answers(&only_the_first(Pc::facts(Some(run), &note), idle.clone()));
    refused("was ordered to land, or has ended");
    pc.answers(&idle);
    up();
    let today = kept()["note"]["run"].as_u64().unwrap();
    assert!(today != run && kept()["note"]["began_ms"].as_u64() > note["began_ms"].as_u64());
    pc.answers(&only_the_first(Pc::facts(Some(run), &note), idle));
    refused(&format!("the run begun last from this PC is {today}"));

    // Two runs with equally many vehicles.
    pc.answers(&only_the_first(Pc::facts(Some(5), &Value::Null), Pc::facts(Some(6), &Value::Null)));
    refused("no run has a majority of the 2 vehicles");
}

#[test]
fn a_variable_names_the_cluster_file_in_every_folder() {
    let _share = Share::of(20);
    let pc = Pc::new(1, "127.77.9", "tls");
    fs::create_dir(pc.path("elsewhere")).unwrap();
    let keys = |variable: Option<PathBuf>| {
        let mut command = Command::new(PROGRAM);
        command.args(["cluster", "keys"]).current_dir(pc.path("elsewhere")).env_remove("SKEIN_CLUSTER");
        let output = command.envs(variable.map(|path| ("SKEIN_CLUSTER", path))).output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let (status, error) = keys(None);
    assert!(status == Some(2) && error.contains("SKEIN_CLUSTER"), "{error}");
    let (status, error) = keys(Some(pc.path("cluster.toml")));
    assert_eq!(status, Some(0), "{error}");
    assert!(error.contains("cluster.toml (named by SKEIN_CLUSTER)"), "{error}");
    assert!(pc.path("keys/authority.pem").is_file());
}

#[test]
fn a_check_of_the_pc_reports_a_fault_with_its_remedy() {
    let _share = Share::of(20);
    let pc = Pc::new(1, "127.77.10", "none");
    fs::write(pc.path("file"), "").unwrap();
    let check = |runs: &str, options: &[&str]| {
        let mut command = Command::new(PROGRAM);
        command.args(["check", "--pc", "--wait", "0"]).args(options).current_dir(pc.folder.path());
        command.env("XDG_RUNTIME_DIR", pc.path("runtime")).env("SKEIN_RUNS", pc.path(runs));
        let output = command.output().unwrap();
        (output.status.code(), String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap())
    };
    let (status, out, err) = check("runs", &["--json"]);
    let lines: Vec<Value> = serde_json::from_str(&out).unwrap();
    let line = |lines: &[Value], what: &str| lines.iter().find(|line| line["what"] == what).unwrap().clone();
    assert_eq!(status, Some(0), "{out}{err}");
    for what in ["processor", "clock", "priority", "memory", "open files", "loopback", "ports", "firewall", "X-Plane"] {
        let line = line(&lines, what);
        assert!(line["found"].as_str().is_some_and(|found| !found.is_empty()), "{line}");
        assert!(line["state"] != "warning" || line["remedy"].is_string(), "{line}");
    }
    assert_eq!(line(&lines, "runs")["state"], "good");
    assert!(!pc.path("runs").exists(), "a check writes nothing");

    let (status, out, err) = check("file/runs", &["--json"]);
    let runs = line(&serde_json::from_str::<Vec<Value>>(&out).unwrap(), "runs");
    assert_eq!((status, err.as_str(), &runs["state"]), (Some(1), "1 fault prevents a flight\n", &"fault".into()));
    assert!(runs["remedy"].as_str().unwrap().contains("SKEIN_RUNS"), "{runs}");
    let (_, table, _) = check("file/runs", &[]);
    assert!(table.contains("FAULT") && table.contains("SKEIN_RUNS"), "{table}");
}
