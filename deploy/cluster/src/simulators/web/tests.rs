use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex};

use clap::Parser;
use skein_agent::plant::xplane::standin::{Standin, StandinOptions};

use super::*;

#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    options: StandinOptions,
}

/// Lets a stand-in with these options run while a client asks it.
fn with(arguments: &[&str], ask: impl FnOnce(&HostPort)) {
    let given = ["standin", "--port", "0", "--beacon", "false", "--web", "0"].iter().chain(arguments);
    let mut standin = Standin::open(&Cli::parse_from(given).options).unwrap();
    let at = standin.web_address().unwrap().to_string().parse().unwrap();
    let stop = Arc::new(AtomicBool::new(false));
    let of_thread = Arc::clone(&stop);
    let thread = std::thread::spawn(move || standin.run(&of_thread));
    ask(&at);
    stop.store(true, Relaxed);
    thread.join().unwrap();
}

#[test]
fn numbers_are_exact_texts_whole_and_elements_found() {
    with(&["--lon", "8.123456789"], |at| {
        let api = WebApi::open(at).unwrap();
        assert_eq!((api.simulator.as_str(), api.starts_flights()), ("12.4.0", true));
        assert!(
            (api.read("sim/flightmodel/position/longitude").unwrap().as_f64().unwrap() - 8.123_456_789).abs() < 1e-9
        );
        assert_eq!(api.text("sim/aircraft/view/acf_relative_path").unwrap(), "Aircraft/Skein/xcell60/xcell60.acf");
        let throttle = api.find("sim/cockpit2/engine/actuators/throttle_ratio[3]").unwrap();
        assert_eq!(throttle.value_type, "float_array");
        assert!(matches!(api.read("sim/none"), Err(WebError::Refused(404, _))));
        assert_eq!((api.number("sim/time/paused"), api.number("sim/none")), (Some(0.0), None));
        assert_eq!(api.number("sim/aircraft/view/acf_relative_path"), None, "a text");
        assert_eq!(api.has_command("sim/operation/reset_flight"), Some(true));
        assert_eq!(api.has_command("sim/operation/none"), Some(false));
        assert!(matches!(api.start_flight(&json!({})), Err(WebError::Refused(400, _))));
    });
}

#[test]
fn refusal_and_absence_differ() {
    with(&["--incoming", "false"], |at| {
        let error = WebApi::open(at).unwrap_err();
        assert!(error.to_string().contains("\"Accept incoming connections\" is off"), "{error}");
    });
    let error = WebApi::open(&"127.0.0.1:1".parse().unwrap()).unwrap_err();
    assert!(matches!(error, WebError::Absent(..)), "{error}");
}

#[test]
fn the_web_api_is_looked_for_where_the_scenario_says_or_on_this_pc() {
    let with = |given: Option<&str>, written: Option<&str>, simulator: &str| {
        let given = given.map(|text| text.parse().unwrap());
        match WebChoice::or_of(given.as_ref(), written, &simulator.parse().unwrap()) {
            WebChoice::Off => "off".to_owned(),
            WebChoice::At(HostPort { host, port }) => format!("{host}:{port}"),
        }
    };
    let of = |given, simulator| with(given, None, simulator);
    let written = Some("127.0.0.1:8096");
    assert_eq!(with(None, written, "10.0.0.7"), "127.0.0.1:8096");
    assert_eq!(with(Some("off"), written, "10.0.0.7"), "off");
    assert_eq!(of(None, "127.0.0.1:49010"), "127.0.0.1:8086");
    assert_eq!(of(None, "localhost"), "localhost:8086");
    assert_eq!(of(None, "10.0.0.7"), "off");
    assert_eq!(of(Some("127.0.0.1:9000"), "10.0.0.7"), "127.0.0.1:9000");
    assert_eq!(of(Some("off"), "127.0.0.1"), "off");
    assert!("a:b".parse::<WebChoice>().is_err());
}

/// A reply of a program that is not X-Plane: its status, and its body.
type HostileReply = (u16, Vec<u8>);

/// Whether this is a whole request, with the body that its head announces.
fn is_complete(request: &[u8]) -> bool {
    let text = String::from_utf8_lossy(request).to_lowercase();
    let Some((head, body)) = text.split_once("\r\n\r\n") else { return false };
    let length = head.lines().find_map(|line| line.strip_prefix("content-length:")?.trim().parse().ok());
    body.len() >= length.unwrap_or(0)
}

/// Serves one connection: the reply depends on the address that is asked for.
fn serve(mut stream: TcpStream, reply: impl Fn(&str) -> HostileReply) {
    let mut request = Vec::new();
    let mut part = [0; 4096];
    // A connection that is closed before its request was read is reset, and the reply lost with it.
    while !is_complete(&request) {
        match stream.read(&mut part) {
            Ok(count @ 1..) => request.extend(&part[..count]),
            _ => return,
        }
    }
    let request = String::from_utf8_lossy(&request).into_owned();
    let (status, body) = reply(request.split(' ').nth(1).unwrap_or_default());
    let head = format!(
        "HTTP/1.1 {status} X\r\nContent-Length: {}\r\nLocation: /api/again\r\nConnection: close\r\n\r\n",
        body.len()
    );
    // The client may have enough before the end.
    let _ = stream.write_all(head.as_bytes()).and_then(|()| stream.write_all(&body));
}

/// Opens the Web API of a program that gives these replies, and asks it for everything.
fn ask_all(of: &HostPort) -> Result<(), WebError> {
    let api = WebApi::open(of)?;
    let (_, _) = (api.text("a"), api.find("a[2]"));
    let (_, _) = (api.number("a"), api.has_command("b"));
    api.read("a")?;
    api.change_flight(&json!({}))?;
    api.start_flight(&json!({}))
}

#[test]
fn hostile_replies_are_errors_of_one_sentence_or_without_effect() {
    let good = |path: &str| match path {
        "/api/capabilities" => json!({ "api": { "versions": ["v1", "v2", "v3"] }, "x-plane": { "version": "12.4.0" } }),
        "/api/v3/datarefs" => json!({ "data": [{ "id": 7, "name": "a", "value_type": "data" }] }),
        _ => json!({ "data": "QQ==" }),
    };
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let at: HostPort = listener.local_addr().unwrap().to_string().parse().unwrap();
    let hostile = Arc::new(Mutex::new(("", (200, Vec::new()))));
    let of_thread = Arc::clone(&hostile);
    std::thread::spawn(move || {
        for stream in listener.incoming().map_while(Result::ok) {
            let (at, hostile) = of_thread.lock().unwrap().clone();
            serve(stream, |path| {
                if path.ends_with(at) { hostile.clone() } else { (200, good(path).to_string().into_bytes()) }
            });
        }
    });
    *hostile.lock().unwrap() = ("nowhere", (200, Vec::new()));
    ask_all(&at).unwrap();

    let deep = |open: &str, close: &str| (open.repeat(100_000) + &close.repeat(100_000)).into_bytes();
    let texts = [
        "",
        " ",
        "null",
        "true",
        "-1",
        "1e999",
        "\"x\"",
        "[]",
        "{}",
        "{\"data\"",
        "{\"data\":null}",
        "{\"data\":{}}",
        "{\"data\":[]}",
        "{\"data\":-1}",
        "{\"data\":\"no base64\"}",
        "{\"data\":[null,1,\"x\",[],{},[{}]]}",
        "{\"data\":[{\"id\":-1,\"name\":\"a\",\"value_type\":\"int\"}]}",
        "{\"data\":[{\"id\":1e30,\"name\":\"a\",\"value_type\":\"int\"}]}",
        "{\"data\":[{\"id\":18446744073709551616,\"name\":\"a\",\"value_type\":\"int\"}]}",
        "{\"data\":[{\"id\":7,\"name\":7,\"value_type\":7}]}",
        "{\"api\":{\"versions\":\"v3\"}}",
        "{\"api\":{\"versions\":[null,3,\"v9\"]}}",
        "{\"api\":7,\"x-plane\":[1]}",
        "{\"x-plane\":{\"version\":{}}}",
        "{\"data\":\"\\u0000\\u001b[2J\"}",
        "<html>",
        "{\"error_code\":7,\"error_message\":[]}",
        "{\"error_message\":\"\\u001b[2J\"}",
    ];
    let bodies = texts.map(|text| text.as_bytes().to_vec()).into_iter();
    let long = json!({ "error_message": "no ".repeat(100_000) }).to_string().into_bytes();
    let bodies = bodies.chain([
        long,
        b"\xff\xfe{".to_vec(),
        vec![0; 1000],
        deep("[", "]"),
        deep("{\"data\":", "}"),
        vec![b' '; LARGEST as usize + 1],
    ]);
    for body in bodies {
        for path in ["/capabilities", "/datarefs", "/value", "/flight", "/commands?filter%5Bname%5D=b"] {
            let is_huge = body.len() > 1 << 20;
            for status in [200, 302, 403, 404, 500].into_iter().take(if is_huge { 1 } else { 5 }) {
                *hostile.lock().unwrap() = (path, (status, body.clone()));
                if let Err(error) = ask_all(&at) {
                    let text = error.to_string();
                    let is_shown_safely = text.len() < 1000 && !text.contains(char::is_control);
                    assert!(!text.is_empty() && is_shown_safely, "{text:.1000?}");
                }
            }
        }
    }
}
