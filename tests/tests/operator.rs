//! What the operator's commands believe, and show, of hosts and vehicles that are not to be trusted: the real program, with an
//! `ssh` that is a script.
#![cfg(unix)]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]
#![expect(clippy::unwrap_used, reason = "what a test cannot do has failed")]

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
/// What a terminal would obey: clear the screen, set its title, C1's introducer, turn the direction of writing.
const HOSTILE: &str = "\u{1b}[2J\u{1b}]0;all is well\u{7}\u{9b}31m\u{202e}";

/// An operator's PC: a cluster of vehicles 1 to N, whose hosts are answered for by a script.
struct Pc {
    folder: TempDir,
}

struct Ran {
    status: Option<i32>,
    out: String,
    err: String,
}

impl Pc {
    /// `network` is the part of 127.0.0.0/8 that the vehicles have for themselves.
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

    /// From now on hosts answer by this script: `$host` is which, `$asked` the request's line, which is kept in `asked`.
    fn answers(&self, script: &str) {
        let folder = self.folder.path().display();
        let text = format!(
            "#!/bin/sh\nfor command; do before=$host; host=$last; last=$command; done\nread -r asked\n\
             echo \"$host $asked\" >>{folder}/asked\ncd {folder}\n{script}\n"
        );
        fs::create_dir_all(self.path("bin")).unwrap();
        fs::write(self.path("bin/ssh"), text).unwrap();
        fs::set_permissions(self.path("bin/ssh"), fs::Permissions::from_mode(0o755)).unwrap();
        fs::write(self.path("asked"), "").unwrap();
    }

    fn asked(&self) -> String {
        fs::read_to_string(self.path("asked")).unwrap()
    }

    fn skein(&self, words: &str) -> Ran {
        let mut command = Command::new(PROGRAM);
        let path = format!("{}:{}", self.path("bin").display(), std::env::var("PATH").unwrap());
        command.args(words.split(' ')).current_dir(self.folder.path()).env("PATH", path);
        let output = command.env("XDG_RUNTIME_DIR", self.path("runtime")).output().unwrap();
        let text = |bytes| String::from_utf8(bytes).unwrap();
        Ran { status: output.status.code(), out: text(output.stdout), err: text(output.stderr) }
    }

    /// Facts of a host whose agent says that it flies in this run.
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

/// It is on one line and does nothing to a terminal, and can be seen.
fn is_shown_as_text(shown: &str) {
    assert!(!shown.contains(|c: char| c.is_control() && c != '\n' || c == '\u{202e}'), "{shown:?}");
    assert!(shown.contains("\\u001b[2J\\u001b]0;all is well\\u0007\\u009b31m\\u202e"), "{shown:?}");
}

#[test]
fn what_hosts_write_reaches_the_terminal_as_text() {
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

    // In an answer; and why ssh itself has failed.
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
fn what_vehicles_say_of_themselves_reaches_the_terminal_as_text() {
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
        plant: format!("x{HOSTILE}"),
        version: format!("1\nnode 9: good{HOSTILE}"),
        failures: Vec::new(),
        frame_rate_hz: 50.0,
        jitter_ms: 1.0,
        step_p50_us: 1.0,
        step_p99_us: 1.0,
        frame_overruns: 0,
        drops: Drops::default(),
        refused: Vec::new(),
        state_messages: 0,
        state_bytes: 0,
        peers: Vec::new(),
    };
    let is_over = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            for sequence in 1.. {
                line.say(health(sequence));
                thread::sleep(Duration::from_millis(50));
                if is_over.load(Relaxed) {
                    return;
                }
            }
        });
        let [text, json] =
            ["cluster status -f cluster.toml", "cluster status --json -f cluster.toml"].map(|w| pc.skein(w));
        is_over.store(true, Relaxed);
        is_shown_as_text(&text.out);
        assert!(text.out.contains("1\\u000anode 9: good\\u001b"), "one line: {}", text.out);
        assert_eq!(text.status, Some(0), "{}", text.err);
        assert!(!json.out.contains(|c: char| c.is_control() && c != '\n' || c == '\u{202e}'), "{:?}", json.out);
    });
}

#[test]
fn up_joins_no_run_on_one_hosts_word() {
    let pc = Pc::new(2, "127.77.3", "tls");
    let keys = pc.skein("cluster keys -f cluster.toml");
    assert_eq!(keys.status, Some(0), "{}", keys.err);
    let up = || pc.skein("cluster up -f cluster.toml --timeout 0.2");
    let refused = |why: &str| {
        let ran = up();
        assert!(ran.status == Some(2) && ran.err.contains(why), "{} {}", ran.out, ran.err);
        assert!(!pc.asked().contains("Start"), "nothing is started: {}", pc.asked());
    };
    let only_the_first =
        |facts: String, others: String| format!("if [ $host = heli1 ]; then {facts}; else {others}; fi");
    let idle = Pc::facts(None, &Value::Null);

    // The first host names a run that nobody has begun here.
    pc.answers(&only_the_first(Pc::facts(Some(42), &Value::Null), idle.clone()));
    refused("node 1 in run 42 reported to fly, but no run was begun from this PC");

    // Nothing flies: a new run, with the operator's note on every host and on this PC.
    pc.answers(&idle);
    let begun = up();
    assert_eq!(begun.status, Some(1), "the hosts only say that they start anything: {}", begun.err);
    let kept = || serde_json::from_str::<Value>(&fs::read_to_string(pc.path("keys/run.json")).unwrap()).unwrap();
    let note = kept()["note"].clone();
    let run = note["run"].as_u64().unwrap();
    let started = format!(
        "\"Start\":{{\"run\":{run},\"note\":{{\"run\":{run},\"began_ms\":{},\"seal\":{}}}}}",
        note["began_ms"], note["seal"]
    );
    assert_eq!(pc.asked().matches(&started).count(), 2, "{}", pc.asked());

    // One that is left of it is joined: it is known here that this run was begun, and it is not over.
    pc.answers(&only_the_first(Pc::facts(Some(run), &note), idle.clone()));
    let joined = up();
    assert!(joined.out.contains(&format!("(run {run})")), "{} {}", joined.out, joined.err);
    assert_eq!(pc.asked().matches(&started).count(), 2, "{}", pc.asked());

    // Yesterday's, which was ordered to abort, so that it is over: its host still has the note that the operator sealed.
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

    // As many in one run as in another.
    pc.answers(&only_the_first(Pc::facts(Some(5), &Value::Null), Pc::facts(Some(6), &Value::Null)));
    refused("no run has a majority of the 2 vehicles");
}
