//! A recording on the page, and what hostile clients can do to the server.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use skein_common::id::VehicleId;
use skein_lab::record;
use skein_tests::page_client::{Received, Socket, request};
use skein_tests::share::Share;

use super::{Place, Server, number};

/// A flight of four vehicles in virtual time, recorded.
fn flight(place: &Place) -> PathBuf {
    let out = place.path("out");
    let mut study = place.command();
    study.args([
        "study",
        "--seed",
        "1",
        "--set",
        "swarm.vehicles=4",
        "--set",
        "duration_s=20",
        "--set",
        "record.runs=all",
    ]);
    let done = study.arg("--out").arg(&out).output().unwrap();
    assert!(done.status.success(), "{done:?}");
    let found = recordings(&out);
    assert_eq!(found.len(), 1, "{found:?}");
    found[0].clone()
}

fn recordings(folder: &std::path::Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(recordings(&path));
        } else if path.ends_with(record::FILE) {
            found.push(path);
        }
    }
    found
}

fn served() -> (Place, Server, PathBuf) {
    let place = Place::new();
    let path = flight(&place);
    let server = place.view(&[path.to_str().unwrap()]);
    (place, server, path)
}

#[test]
fn a_recording_is_played_at_any_time_as_it_was_recorded() {
    let _share = Share::of(60);
    let (_place, server, path) = served();
    let whole = record::read(&path).unwrap();
    let mut page = Socket::open(server.address);
    let hello = page.wait_for("hello", |message| message["type"] == "hello");
    assert_eq!((&hello["source"], hello["vehicles"].as_array().unwrap().len()), (&"recording".into(), 4));
    assert!((number(&hello["to_s"]) - 20.0).abs() < 0.2, "{hello}");
    assert_eq!(hello["scenario"]["steps"][0]["formation"]["radius_m"], whole.scenario.formation.radius_m);
    let events = page.wait_for("events", |message| message["type"] == "events");
    assert_eq!(events["events"].as_array().unwrap().len(), whole.noted.len());

    for at_s in [15.0, 2.5, 19.9, 0.5] {
        page.send(&format!(r#"{{"type":"play","at_s":{at_s},"speed":0}}"#));
        let snapshot = page.wait_for("that time", |message| {
            message["type"] == "snapshot" && (number(&message["t_s"]) - at_s).abs() < 1e-3
        });
        for (nth, track) in whole.tracks.iter().enumerate() {
            let shown = &snapshot["vehicles"][nth];
            let newest = track.steps.iter().rev().find(|step| step.t_s <= at_s).unwrap();
            let place = newest.trace.position;
            let expected = [place.north_m(), place.east_m(), place.altitude_m()];
            let got = [&shown["ne_m"][0], &shown["ne_m"][1], &shown["altitude_m"]].map(number);
            assert!(expected.iter().zip(got).all(|(one, other)| (one - other).abs() < 1e-3), "{expected:?} {got:?}");
            assert_eq!((&shown["contact"], shown["id"].as_str()), (&true.into(), Some(&*track.id.to_string())));
            assert_eq!(shown["peers"].as_array().unwrap().len(), newest.trace.peers.len());
        }
    }

    // At 8 times the speed ten snapshots span about eight seconds, and the end is not passed.
    page.send(r#"{"type":"play","at_s":1,"speed":8}"#);
    page.wait_for("the beginning", |message| message["type"] == "snapshot" && number(&message["t_s"]) < 3.0);
    let begin = Instant::now();
    let snapshot = page.wait_for("the end", |message| message["type"] == "snapshot" && number(&message["t_s"]) > 19.5);
    assert!(number(&snapshot["t_s"]) <= number(&hello["to_s"]));
    assert!((1.0..12.0).contains(&begin.elapsed().as_secs_f64()), "{:?}", begin.elapsed());

    // The field of a vehicle that is shown.
    page.send(r#"{"type":"field","vehicle":"3"}"#);
    let snapshot = page.wait_for("field", |message| message["field"].is_object());
    assert_eq!((&snapshot["field"]["vehicle"], snapshot["field"]["ne"].as_array().unwrap().len()), (&"3".into(), 441));
    page.send(r#"{"type":"field","vehicle":"9"}"#);
    page.wait_for("no field", |message| message["type"] == "snapshot" && message["field"].is_null());
    let id = VehicleId::new(3).unwrap();
    assert_eq!(snapshot["vehicles"][2]["id"], id.to_string());
}

#[test]
fn every_answer_has_a_strict_policy_and_foreign_names_and_pages_are_refused() {
    let _share = Share::of(60);
    let (_place, server, _) = served();
    let at = server.address;
    let get = |path: &str, host: &str, more: &str| {
        request(at, &format!("GET {path} HTTP/1.1\r\nHost: {host}\r\n{more}")).unwrap()
    };
    for (path, kind) in [("/", "text/html"), ("/main.js", "text/javascript"), ("/style.css", "text/css")] {
        let answer = get(path, &at.to_string(), "");
        assert!(answer.starts_with("HTTP/1.1 200 ") && answer.contains(&format!("content-type: {kind}")), "{answer}");
        assert!(answer.contains("content-security-policy: default-src 'none'; script-src 'self';"), "{answer}");
        assert!(
            answer.contains("x-content-type-options: nosniff") && answer.contains("cache-control: no-store"),
            "{answer}"
        );
    }
    for path in ["/../page.rs", "/none.js", "/%2e%2e/Cargo.toml", "/page/main.js"] {
        assert!(get(path, "localhost", "").starts_with("HTTP/1.1 404 "), "{path}");
    }
    let port = at.port();
    for host in [format!("localhost:{port}"), format!("127.0.0.1:{port}"), "[::1]:7480".to_owned()] {
        assert!(get("/", &host, "").starts_with("HTTP/1.1 200 "), "{host}");
    }
    // DNS rebinding: a foreign name that resolves to this PC.
    for host in
        ["attacker.example", "attacker.example:7480", "10.0.0.9", "localhost.attacker.example", "127.0.0.1.nip.io"]
    {
        let answer = get("/", host, "");
        assert!(answer.starts_with("HTTP/1.1 421 ") && answer.contains("content-security-policy"), "{host}: {answer}");
    }
    for origin in ["http://attacker.example", "null", "https://localhost", "http://127.0.0.1:1"] {
        let refused = Socket::open_with(at, &format!("Origin: {origin}\r\n")).err().unwrap();
        assert!(refused.starts_with("HTTP/1.1 403 "), "{origin}: {refused}");
    }
    // A program that is no page has no origin.
    assert!(Socket::open_with(at, "").is_ok());
    let rebound = "GET /live HTTP/1.1\r\nHost: attacker.example\r\nOrigin: http://attacker.example\r\nUpgrade: websocket\r\n\
                   Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    assert!(request(at, rebound).unwrap().starts_with("HTTP/1.1 421 "));
}

#[test]
fn what_a_page_sends_is_bounded_and_garbage_changes_nothing() {
    let _share = Share::of(60);
    let (_place, server, _) = served();
    let mut page = Socket::open(server.address);
    page.wait_for("hello", |message| message["type"] == "hello");
    for garbage in [
        "",
        "{",
        "null",
        r#"{"type":"order","verb":"abort"}"#,
        r#"{"type":"play","at_s":1e999,"speed":1}"#,
        r#"{"type":"play","at_s":-1e300,"speed":-5}"#,
        r#"{"type":"play","at_s":"1","speed":1}"#,
        r#"{"type":"detail","vehicles":["\u001b[2J",""]}"#,
        r#"{"type":"field","vehicle":7}"#,
    ] {
        page.send(garbage);
    }
    page.wait_for("refusal of the order", |message| message["type"] == "ordered" && message["ok"] == false);
    page.send(r#"{"type":"play","at_s":10,"speed":0}"#);
    page.wait_for("snapshot after garbage", |message| message["type"] == "snapshot" && number(&message["t_s"]) > 9.9);
    page.send(&format!(r#"{{"type":"detail","vehicles":["{}"]}}"#, "3".repeat(5_000)));
    let until = Instant::now() + Duration::from_secs(30);
    while !matches!(page.receive(), Received::Closed) {
        assert!(Instant::now() < until, "an oversized message does not close the connection");
    }
    Socket::open(server.address).wait_for("hello after that", |message| message["type"] == "hello");
}

/// Whether the server answers on this connection at all.
fn is_served(stream: &mut TcpStream, address: SocketAddr) -> bool {
    let sent = stream.write_all(format!("GET / HTTP/1.1\r\nHost: {address}\r\n\r\n").as_bytes());
    sent.is_ok() && stream.read(&mut [0; 16]).is_ok_and(|read| read > 0)
}

#[test]
fn two_hundred_connections_and_pages_that_take_nothing_in_neither_block_nor_fill_the_server() {
    let _share = Share::of(60);
    let (_place, server, _) = served();
    let memory_kb = || {
        let status = std::fs::read_to_string(format!("/proc/{}/status", server.child.id())).unwrap();
        let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
        line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap()
    };
    let before_kb = memory_kb();
    // Ten pages that play fast and take nothing in.
    let slow: Vec<Socket> = (0..10)
        .map(|_| {
            let mut page = Socket::open(server.address);
            page.send(r#"{"type":"play","at_s":0,"speed":0.25}"#);
            page
        })
        .collect();
    let mut connections: Vec<TcpStream> = (0..200).map(|_| TcpStream::connect(server.address).unwrap()).collect();
    for stream in &connections {
        stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    }
    let served = connections.iter_mut().filter_map(|stream| is_served(stream, server.address).then_some(())).count();
    assert!(served <= 64, "{served} connections at once");
    std::thread::sleep(Duration::from_secs(10));
    let grown_kb = memory_kb().saturating_sub(before_kb);
    assert!(grown_kb < 100_000, "{grown_kb} kB more");
    drop(connections);
    drop(slow);
    let until = Instant::now() + Duration::from_secs(20);
    while !TcpStream::connect(server.address).is_ok_and(|mut stream| is_served(&mut stream, server.address)) {
        assert!(Instant::now() < until, "the server does not recover");
        std::thread::sleep(Duration::from_millis(100));
    }
}

#[test]
fn what_cannot_be_played_is_refused_with_the_reason() {
    let _share = Share::of(60);
    let place = Place::new();
    std::fs::write(place.path("text.mcap"), "no recording").unwrap();
    std::fs::create_dir(place.path("empty")).unwrap();
    for (what, why) in [("none.mcap", "none.mcap: "), ("text.mcap", "not an MCAP file"), ("empty", "no run.mcap")] {
        let done = place.command().args(["view", what]).output().unwrap();
        let printed = String::from_utf8_lossy(&done.stderr).into_owned();
        assert_eq!(done.status.code(), Some(2), "{printed}");
        assert!(printed.contains(why) && printed.contains(what), "{printed}");
    }
}
