//! A live swarm on the page.

use std::fs;
use std::net::SocketAddr;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use skein_cluster::endpoints;
use skein_cluster::mesh::observe::{Observer, SwarmMessage};
use skein_cluster::mesh::reach::Reach;
use skein_common::id::SwarmName;
use skein_common::message::Trace;
use skein_common::topic::Branch;
use skein_tests::hostile_pages::HostileClients;
use skein_tests::page_client::{Received, Socket, request};
use skein_tests::share::Share;

use super::{Place, number};

/// A flight of four vehicles at low altitude; ended at the end.
pub(crate) struct Flight {
    child: Child,
}

impl Flight {
    fn begin(place: &Place, name: &str) -> Self {
        Self::of(place, name, 4)
    }

    pub(crate) fn of(place: &Place, name: &str, vehicles: usize) -> Self {
        Self::with(place, name, vehicles, &[])
    }

    /// With these further keys of the scenario.
    pub(crate) fn with(place: &Place, name: &str, vehicles: usize, more: &[&str]) -> Self {
        let mut command = place.command();
        command.arg("fly").arg("--out").arg(place.path("out"));
        let sets = [&format!("swarm.vehicles={vehicles}"), "formation.altitude_m=5", "formation.radius_m=40"];
        for set in sets.into_iter().chain(more.iter().copied()) {
            command.args(["--set", set]);
        }
        command.arg("--set").arg(format!("swarm.name={name}"));
        let log = fs::File::create(place.path("fly.log")).unwrap();
        command.stdout(Stdio::null()).stderr(log);
        Self { child: command.spawn().unwrap() }
    }

    pub(crate) fn end(mut self) {
        let pid = Pid::from_child(&self.child);
        kill_process(pid, Signal::INT).unwrap();
        let until = Instant::now() + Duration::from_secs(90);
        while self.child.try_wait().unwrap().is_none() {
            assert!(Instant::now() < until, "the flight does not end");
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

impl Drop for Flight {
    fn drop(&mut self) {
        // Twice: everything ends at once.
        for _ in 0..2 {
            let _ = kill_process(Pid::from_child(&self.child), Signal::INT);
            std::thread::sleep(Duration::from_millis(200));
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn vehicle<'a>(snapshot: &'a Value, id: &str) -> &'a Value {
    snapshot["vehicles"].as_array().unwrap().iter().find(|vehicle| vehicle["id"] == id).unwrap()
}

/// The process of this vehicle's agent.
fn agent(place: &Place, id: u8) -> Pid {
    let listed = std::process::Command::new("ps").args(["-axww", "-o", "pid=,args="]).output().unwrap();
    let folder = place.path("out").display().to_string();
    let listed = String::from_utf8_lossy(&listed.stdout).into_owned();
    let line =
        listed.lines().find(|line| line.contains(&folder) && line.contains(&format!("agents/{id}.toml --child")));
    Pid::from_raw(line.unwrap().trim().split_once(' ').unwrap().0.parse().unwrap()).unwrap()
}

#[test]
fn a_live_swarm_is_shown_where_it_is_and_a_killed_vehicle_becomes_a_ghost() {
    let _share = Share::of_flight(6);
    let place = Place::new();
    // The page is there before the swarm is, says what is missing, and shows the swarm as soon as it flies.
    let server = place.view(&["--swarm", "ghost"]);
    let mut page = Socket::open(server.address);
    let problem = page.wait_for("problem", |message| message["type"] == "problem" && message["text"].is_string());
    assert!(problem["text"].as_str().unwrap().contains("no swarm named ghost flies here"), "{problem}");
    assert!(problem["remedy"].as_str().unwrap().contains("skein fly"), "{problem}");
    let flight = Flight::begin(&place, "ghost");
    let hello = page.wait_for("hello", |message| message["type"] == "hello");
    assert_eq!((&hello["source"], &hello["swarm"], &hello["orders"]), (&"live".into(), &"ghost".into(), &false.into()));
    page.wait_for("end of the problem", |message| message["type"] == "problem" && message["text"].is_null());
    let is_formed = |message: &Value| {
        let vehicles = message["vehicles"].as_array();
        let is_placed = |one: &Value| one["phase"] == "formation" && one["in_place_s"].is_number();
        vehicles.is_some_and(|all| all.len() == 4 && all.iter().all(is_placed))
    };
    let formed = page.wait_for("formation of four", is_formed);
    assert!(
        formed["t_s"].is_number() && formed["status"]["text"].as_str().unwrap().contains("4/4 in formation"),
        "{formed}"
    );

    // Where the vehicles are by their own traces, within a metre.
    let runtime = place.path("runtime").join("skein");
    let there = endpoints::find(&runtime, Some(&SwarmName::new("ghost").unwrap())).unwrap();
    let mut observer = Observer::open(&Reach::here(&there, Branch::SWARM)).unwrap();
    observer.subscribe_to_traces(true).unwrap();
    // The page is behind by at most a second, and so is this test: every place that is shown is on the vehicle's recent track.
    let now_ms = || SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_millis() as f64;
    let (mut traced, mut worst_m, mut compared) = (Vec::new(), 0.0_f64, 0);
    let mut take = |traced: &mut Vec<(f64, Trace)>| {
        let received = observer.poll();
        traced.extend(received.into_iter().filter_map(|message| match message {
            SwarmMessage::Trace(trace) => Some((now_ms(), trace)),
            _ => None,
        }));
    };
    while compared < 80 {
        take(&mut traced);
        let snapshot = page.snapshot();
        take(&mut traced);
        let at_ms = number(&snapshot["at_ms"]);
        if traced.first().is_none_or(|(first_ms, _)| at_ms < first_ms + 1e3) {
            continue;
        }
        for shown in snapshot["vehicles"].as_array().unwrap() {
            let off_m = |trace: &Trace| {
                let ne_m = &shown["ne_m"];
                (number(&ne_m[0]) - trace.position.north_m()).hypot(number(&ne_m[1]) - trace.position.east_m())
            };
            let recent = traced.iter().filter(|(ms, trace)| {
                shown["id"] == trace.header.sender.to_string() && (at_ms - 1e3..at_ms + 1e3).contains(ms)
            });
            worst_m = worst_m.max(recent.map(|(_, trace)| off_m(trace)).fold(f64::INFINITY, f64::min));
            compared += 1;
        }
    }
    println!("worst distance between the page and the ground truth: {worst_m:.2} m");
    assert!(worst_m < 1.0, "{worst_m} m off");
    let peers = vehicle(&page.snapshot(), "1")["peers"].as_array().unwrap().clone();
    assert!(peers.len() == 3 && peers.iter().all(|peer| peer[2] == "fresh"), "{peers:?}");
    #[cfg(target_os = "linux")]
    {
        the_table_on_a_terminal_shows(&place, "ghost", 4);
        a_terminal_that_obeys_no_escape_sequences_gets_lines(&place, "ghost");
    }

    let mut other = Socket::open(server.address);
    other.wait_for("hello", |message| message["type"] == "hello");
    kill_process(agent(&place, 3), Signal::KILL).unwrap();
    let killed = Instant::now();
    let ghost =
        page.wait_for("ghost", |message| message["type"] == "snapshot" && vehicle(message, "3")["contact"] == false);
    println!("vehicle 3 is a ghost {:.2} s after its agent was killed", killed.elapsed().as_secs_f64());
    assert!(killed.elapsed() < Duration::from_secs(2), "{:?}", killed.elapsed());
    assert!(vehicle(&ghost, "3")["ne_m"][0].is_number(), "it stays where it was: {ghost}");
    let lost = page.wait_for("reason", |message| {
        let reasons = message["status"]["reasons"].as_array();
        reasons.is_some_and(|reasons| {
            reasons.iter().any(|reason| reason.as_str().unwrap().starts_with("vehicle 3: silent"))
        })
    });
    assert_eq!(lost["status"]["level"], "bad");
    other.wait_for("event", |message| message["type"] == "event" && message["text"] == "lost contact with vehicle 3");
    // A page that comes later receives what has happened since the server listens.
    let mut later = Socket::open(server.address);
    let events = later.wait_for("events", |message| message["type"] == "events");
    assert!(events["events"].as_array().unwrap().iter().any(|event| event["text"] == "lost contact with vehicle 3"));
    flight.end();
}

/// `skein view --terminal` on a terminal of its own: it shows so many vehicles in formation, and ends with the key q.
#[cfg(target_os = "linux")]
fn the_table_on_a_terminal_shows(place: &Place, swarm: &str, vehicles: usize) {
    use std::io::Write;
    let typed = place.path("terminal");
    let command = format!("stty rows 40 cols 200; exec {} view --terminal --swarm {swarm}", super::PROGRAM);
    let mut terminal = std::process::Command::new("script");
    terminal.args(["--quiet", "--return", "--flush", "--command", &command]).arg(&typed);
    terminal.env("XDG_RUNTIME_DIR", place.path("runtime")).env("TERM", "xterm-256color");
    let mut child = terminal.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let until = Instant::now() + Duration::from_secs(30);
    // The first picture is complete, and later ones have what is new in them.
    while String::from_utf8_lossy(&fs::read(&typed).unwrap_or_default()).matches("formation").count() < vehicles {
        assert!(Instant::now() < until, "{}", String::from_utf8_lossy(&fs::read(&typed).unwrap_or_default()));
        std::thread::sleep(Duration::from_millis(50));
    }
    child.stdin.as_mut().unwrap().write_all(b"q").unwrap();
    assert!(child.wait().unwrap().success(), "the key q ends it");
}

/// `skein view --terminal` on a terminal that names itself dumb: lines as in a file.
#[cfg(target_os = "linux")]
fn a_terminal_that_obeys_no_escape_sequences_gets_lines(place: &Place, swarm: &str) {
    let typed = place.path("dumb");
    let command = format!("exec {} view --terminal --swarm {swarm}", super::PROGRAM);
    let mut terminal = std::process::Command::new("script");
    terminal.args(["--quiet", "--return", "--flush", "--command", &command]).arg(&typed);
    terminal.env("XDG_RUNTIME_DIR", place.path("runtime")).env("TERM", "dumb");
    let mut child = terminal.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let until = Instant::now() + Duration::from_secs(30);
    let text = || String::from_utf8_lossy(&fs::read(&typed).unwrap_or_default()).into_owned();
    while !text().contains("/4 in formation") {
        assert!(Instant::now() < until, "{}", text());
        std::thread::sleep(Duration::from_millis(50));
    }
    assert!(!text().contains('\u{1b}'), "{:?}", text());
    child.kill().unwrap();
    child.wait().unwrap();
}

/// The lines that a process writes, as they come.
fn lines_of(output: impl std::io::Read + Send + 'static) -> std::sync::mpsc::Receiver<String> {
    let (sender, lines) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let all = std::io::BufRead::lines(std::io::BufReader::new(output)).map_while(Result::ok);
        all.into_iter().try_for_each(|line| sender.send(line))
    });
    lines
}

#[test]
fn a_page_that_opens_again_shows_no_vehicle_as_silent_and_a_missing_swarm_is_reported_with_those_that_fly() {
    let _share = Share::of_flight(6);
    let place = Place::new();
    let server = place.view(&["--swarm", "again"]);
    let flight = Flight::of(&place, "again", 2);
    let mut page = Socket::open(server.address);
    page.wait_for("formation", |message| is_formation_of(message, &["1", "2"]));
    drop(page);

    // Meanwhile: a swarm of another name is not there, and this one is named.
    let mut command = place.command();
    command.args(["view", "--swarm", "agian", "--listen", "127.0.0.1:0"]);
    let mut other = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let lines = lines_of(other.stderr.take().unwrap());
    let is_report = |line: &String| line.starts_with("no swarm named agian flies here");
    let report = std::iter::from_fn(|| lines.recv_timeout(Duration::from_secs(60)).ok()).find(is_report).unwrap();
    assert!(report.contains("; swarm again flies here: --swarm again names it; "), "{report}");
    assert!(other.try_wait().unwrap().is_none(), "it keeps waiting");
    other.kill().unwrap();
    other.wait().unwrap();

    let mut page = Socket::open(server.address);
    let past = page.wait_for("events", |message| message["type"] == "events");
    let past = past["events"].as_array().unwrap();
    assert!(!past.is_empty() && past.iter().all(|event| event["at_ms"].is_u64()), "{past:?}");
    for _ in 0..20 {
        let snapshot = page.snapshot();
        for id in ["1", "2"] {
            let shown = vehicle(&snapshot, id);
            assert!(shown["contact"] == true && number(&shown["silent_s"]) < 3.0, "{snapshot}");
        }
        assert!(!snapshot["status"].to_string().contains("silent"), "{snapshot}");
    }
    flight.end();
}

fn is_formation_of(message: &Value, ids: &[&str]) -> bool {
    message["type"] == "snapshot" && ids.iter().all(|id| vehicle(message, id)["phase"] == "formation")
}

#[test]
fn the_server_prints_addresses_that_others_can_use_and_blames_the_option_that_named_a_used_port() {
    let _share = Share::of_flight(6);
    let place = Place::new();
    let mut command = place.command();
    command.args(["view", "--swarm", "absent", "--listen", "0.0.0.0:0"]);
    let mut view = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let lines = lines_of(view.stdout.take().unwrap());
    let mut all = Vec::new();
    while all.last().is_none_or(|line: &String| !line.starts_with("http://127.0.0.1:")) {
        all.push(lines.recv_timeout(Duration::from_secs(60)).unwrap());
    }
    assert!(all.iter().all(|line| line.starts_with("http://") && !line.contains("0.0.0.0")), "{all:?}");
    let port = all.last().unwrap().rsplit_once(':').unwrap().1.to_owned();
    for line in &all {
        let address: SocketAddr = line.strip_prefix("http://").unwrap().parse().unwrap();
        Socket::open(address);
    }
    let used = format!("127.0.0.1:{port}");
    let refused = |args: &[&str]| {
        let output = place.command().args(args).output().unwrap();
        assert_eq!(output.status.code(), Some(2));
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let text = refused(&["view", "--swarm", "absent", "--listen", &used]);
    assert!(text.starts_with(&format!("--listen {used}: ")) && text.contains("choose another port"), "{text}");
    let out = place.path("out").display().to_string();
    let text = refused(&["fly", "--view", &used, "--set", "swarm.vehicles=1", "--out", &out]);
    assert!(text.contains(&format!("--view {used}: ")) && !text.contains("--listen"), "{text}");
    view.kill().unwrap();
    view.wait().unwrap();
}

#[test]
fn the_server_answers_under_its_names_in_every_spelling_and_names_the_option_for_others() {
    let _share = Share::of_flight(6);
    let place = Place::new();
    let server = place.view(&["--swarm", "absent", "--name", "swarm.example.com", "--name", "10.0.0.9"]);
    let get = |host: &str| request(server.address, &format!("GET / HTTP/1.1\r\nHost: {host}\r\n")).unwrap();
    let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let own = match host.trim() {
        "" => Vec::new(),
        host => vec![host.to_owned(), host.to_uppercase(), format!("{}.local", host.split('.').next().unwrap())],
    };
    let given = ["LOCALHOST:7480", "localhost.", "swarm.example.com", "Swarm.Example.Com.:443", "10.0.0.9"];
    for host in given.map(str::to_owned).into_iter().chain(own) {
        assert!(get(&host).starts_with("HTTP/1.1 200 "), "{host}: {}", get(&host));
    }
    let refused = get("other.example.com");
    assert!(refused.starts_with("HTTP/1.1 421 ") && refused.contains("--name other.example.com"), "{refused}");
    let foreign = Socket::open_with(server.address, "Origin: https://other.example.com\r\n").err().unwrap();
    assert!(foreign.starts_with("HTTP/1.1 403 "), "{foreign}");
    Socket::open_with(server.address, "Origin: https://swarm.example.com\r\n").unwrap();
    let ask = |origin: &str| {
        let lines = format!("POST /live HTTP/1.1\r\nHost: localhost\r\nOrigin: {origin}\r\nContent-Length: 0\r\n");
        request(server.address, &lines).unwrap()
    };
    let refused = ask("https://other.example.com");
    assert!(refused.starts_with("HTTP/1.1 403 ") && refused.contains("--name other.example.com"), "{refused}");
    assert!(ask("https://swarm.example.com").starts_with("HTTP/1.1 204 "));
}

#[test]
fn a_flight_serves_its_own_page_if_asked() {
    let _share = Share::of_flight(6);
    let place = Place::new();
    let mut command = place.command();
    command.args(["fly", "--view", "127.0.0.1:0", "--json", "--duration", "5", "--out"]).arg(place.path("out"));
    for set in ["swarm.vehicles=2", "formation.altitude_m=5", "formation.radius_m=40", "swarm.name=own-page"] {
        command.args(["--set", set]);
    }
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let lines = std::io::BufRead::lines(std::io::BufReader::new(child.stdout.take().unwrap()));
    let mut address = None;
    for line in lines {
        let line: Value = serde_json::from_str(&line.unwrap()).unwrap();
        let text = line["text"].as_str().unwrap_or_default();
        if let Some(at) = text.strip_prefix("live page: http://") {
            let at = at.parse().unwrap();
            let mut page = Socket::open(at);
            page.wait_for("hello", |message| message["type"] == "hello");
            let snapshot = page.wait_for("both vehicles", |message| {
                message["vehicles"].as_array().is_some_and(|all| all.iter().all(|one| one["contact"] == true))
            });
            assert_eq!(snapshot["vehicles"].as_array().unwrap().len(), 2);
            address = Some(at);
        }
    }
    assert!(address.is_some(), "no page was announced");
    assert!(child.wait().unwrap().success());
}

fn is_in_formation(message: &Value, id: &str) -> bool {
    message["type"] == "snapshot" && vehicle(message, id)["phase"] == "formation"
}

/// Attacks the server for some seconds, and checks that it refuses everything, that the page that is open is served meanwhile, and
/// that the vehicles keep contact and stay in formation.
fn attack(address: SocketAddr, page: &mut Socket) {
    let hostile = HostileClients::begin(address);
    let until = Instant::now() + Duration::from_secs(6);
    while Instant::now() < until {
        match page.receive() {
            Received::Json(message) => assert!(
                message["type"] != "event" || !message["text"].as_str().unwrap().contains("lost contact"),
                "{message}"
            ),
            other => panic!("{other:?}"),
        }
    }
    for (what, tally) in hostile.end().all() {
        println!("{what}: {} of {} refused", tally.refused, tally.tried);
        assert!(tally.tried > 0 && tally.refused == tally.tried, "{what}: {tally:?}");
    }
    let snapshot = page.snapshot();
    assert!(["1", "2"].iter().all(|id| is_in_formation(&snapshot, id)), "{snapshot}");
}

#[test]
fn hostile_clients_order_nothing_and_an_order_from_the_page_lands_one_vehicle() {
    let _share = Share::of_flight(6);
    const TOKEN: &str = "correct horse battery staple";
    let place = Place::new();
    let token = place.path("token");
    fs::write(&token, TOKEN).unwrap();
    rustix::fs::chmod(&token, rustix::fs::Mode::from_raw_mode(0o600)).unwrap();
    let server = place.view(&["--swarm", "ordered", "--orders", "--token", &token.display().to_string()]);
    let listener = place.view(&["--swarm", "ordered"]);
    let flight = Flight::of(&place, "ordered", 2);
    let mut page = Socket::open(server.address);
    let hello = page.wait_for("hello", |message| message["type"] == "hello");
    assert_eq!((&hello["orders"], &hello["needs_token"]), (&true.into(), &true.into()));
    page.wait_for("formation", |message| is_in_formation(message, "1") && is_in_formation(message, "2"));
    let order = |verb: &str, vehicles: &str, token: &str| {
        format!(r#"{{"type":"order","verb":"{verb}","vehicles":{vehicles},"teams":null,"token":"{token}"}}"#)
    };
    let ordered = |page: &mut Socket, text: &str| {
        page.send(text);
        let answer = page.wait_for("answer", |message| message["type"] == "ordered");
        (answer["text"].as_str().unwrap().to_owned(), answer["ok"].as_bool().unwrap())
    };

    // Without permission, without the token, from a foreign page: nothing is ordered.
    let mut other = Socket::open(listener.address);
    let hello = other.wait_for("hello", |message| message["type"] == "hello");
    assert_eq!(hello["orders"], false);
    let (text, is_done) = ordered(&mut other, &order("abort", "null", TOKEN));
    assert!(text.contains("start its server with --orders") && !is_done, "{text}");
    let (text, is_done) = ordered(&mut page, &order("abort", "null", "correct horse battery stapler"));
    assert!(text.starts_with("wrong token") && !is_done, "{text}");
    let foreign = Socket::open_with(server.address, "Origin: http://attacker.example\r\n").err().unwrap();
    assert!(foreign.starts_with("HTTP/1.1 403 "), "{foreign}");
    let (text, _) = ordered(&mut page, &order("land", r#"["9"]"#, TOKEN));
    assert!(text.contains("has no vehicle 9; its vehicles are 1, 2"), "{text}");
    let (text, _) = ordered(&mut page, &order("land", "[]", TOKEN));
    assert!(text.contains("names no vehicle"), "{text}");
    attack(server.address, &mut page);
    let snapshot = page.snapshot();
    assert!(["1", "2"].iter().all(|id| vehicle(&snapshot, id)["order"].is_null()), "{snapshot}");

    let (text, is_done) = ordered(&mut page, &order("land", r#"["2"]"#, TOKEN));
    assert!(text.starts_with("land: taken by 1 of 1; vehicle 2: ") && text.ends_with(" -> landing"), "{text}");
    assert!(is_done);
    page.wait_for("landing", |message| message["type"] == "snapshot" && vehicle(message, "2")["phase"] == "landed");
    assert_eq!(vehicle(&page.snapshot(), "1")["phase"], "formation", "the other one flies on");
    kill_process(agent(&place, 2), Signal::KILL).unwrap();
    page.wait_for("ghost", |message| message["type"] == "snapshot" && vehicle(message, "2")["contact"] == false);
    let (text, is_done) = ordered(&mut page, &order("hold", "null", TOKEN));
    assert!(text.starts_with("hold: taken by 1 of 2; 2 does not answer; vehicle 1: ") && !is_done, "{text}");
    let log = fs::read_to_string(place.path("view.log")).unwrap();
    assert!(!log.contains(TOKEN), "{log}");
    flight.end();
}
