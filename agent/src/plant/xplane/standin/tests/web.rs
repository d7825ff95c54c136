//! The Web API, asked by raw HTTP and a raw WebSocket: what the documentation of X-Plane's interface says.

use std::io::{Read, Write as _};
use std::net::TcpStream;
use std::sync::atomic::AtomicBool;
use std::thread::JoinHandle;

use serde_json::{Value, json};

use super::*;
use crate::plant::xplane::server::COMMANDS;

/// A stand-in with a Web API that runs until it is dropped.
struct Running {
    web: SocketAddr,
    udp: SocketAddr,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Running {
    fn with(arguments: &[&str]) -> Self {
        let arguments: Vec<&str> = ["--web", "0"].iter().chain(arguments).copied().collect();
        let mut standin = Standin::open(&options(&arguments)).unwrap();
        let (web, udp) = (standin.web_address().unwrap(), standin.address);
        let stop = Arc::new(AtomicBool::new(false));
        let of_thread = Arc::clone(&stop);
        let thread = Some(thread::spawn(move || standin.run(&of_thread)));
        Self { web, udp, stop, thread }
    }

    /// Sends a request; the status and the body.
    fn ask(&self, method: &str, path: &str, body: &Value) -> (u16, Value) {
        let body = if body.is_null() { String::new() } else { body.to_string() };
        let mut stream = TcpStream::connect(self.web).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        let length = body.len();
        let head = format!("{method} {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n");
        write!(stream, "{head}Content-Type: application/json\r\nContent-Length: {length}\r\n\r\n{body}").unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        let (head, body) = text.split_once("\r\n\r\n").unwrap();
        (head.split(' ').nth(1).unwrap().parse().unwrap(), serde_json::from_str(body).unwrap_or_default())
    }

    fn get(&self, path: &str) -> Value {
        let (status, body) = self.ask("GET", path, &Value::Null);
        assert_eq!(status, 200, "{path}: {body}");
        body["data"].clone()
    }

    fn id(&self, name: &str) -> u64 {
        let kind = if name.starts_with("sim/operation/pause") { "commands" } else { "datarefs" };
        self.get(&format!("/api/v3/{kind}?filter[name]={name}"))[0]["id"].as_u64().unwrap()
    }

    fn value(&self, name: &str) -> Value {
        self.get(&format!("/api/v3/datarefs/{}/value", self.id(name)))
    }

    /// Waits until the dataref has this value: what is written counts from the next frame on.
    fn until(&self, name: &str, is_reached: impl Fn(&Value) -> bool) {
        for _ in 0..100 {
            if is_reached(&self.value(name)) {
                return;
            }
            skein_host::clock::sleep(Duration::from_millis(20));
        }
        panic!("{name} is {}", self.value(name));
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop.store(true, Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

/// A client of the WebSocket.
struct Socket(TcpStream);

impl Socket {
    fn open(running: &Running) -> Self {
        let mut stream = TcpStream::connect(running.web).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        write!(
            stream,
            "GET /api/v3 HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        )
        .unwrap();
        let mut head = Vec::new();
        while !head.ends_with(b"\r\n\r\n") {
            let mut byte = [0];
            stream.read_exact(&mut byte).unwrap();
            head.push(byte[0]);
        }
        assert!(head.starts_with(b"HTTP/1.1 101"), "{}", String::from_utf8_lossy(&head));
        Self(stream)
    }

    /// Sends a text; its mask is all zeros.
    fn send(&mut self, message: &Value) {
        let text = message.to_string();
        let length = u16::try_from(text.len()).unwrap().to_be_bytes();
        let frame = [&[0x81, 0x80 | 126][..], &length, &[0; 4], text.as_bytes()].concat();
        self.0.write_all(&frame).unwrap();
    }

    fn receive(&mut self) -> Option<Value> {
        let mut head = [0; 2];
        self.0.read_exact(&mut head).ok()?;
        let length = match head[1] {
            126 => {
                let mut long = [0; 2];
                self.0.read_exact(&mut long).ok()?;
                u16::from_be_bytes(long).into()
            }
            short => usize::from(short),
        };
        let mut text = vec![0; length];
        self.0.read_exact(&mut text).ok()?;
        (head[0] == 0x81).then(|| serde_json::from_slice(&text).unwrap())
    }

    /// The next message of this type.
    fn next(&mut self, kind: &str) -> Value {
        loop {
            let message = self.receive().unwrap_or_else(|| panic!("no {kind}"));
            if message["type"] == kind {
                return message;
            }
        }
    }
}

const LATITUDE: &str = "sim/flightmodel/position/latitude";
const WIND_X: &str = "sim/weather/aircraft/wind_now_x_msc";

#[test]
fn lists_have_names_types_pages_and_fields() {
    let running = Running::with(&[]);
    let (status, capabilities) = running.ask("GET", "/api/capabilities", &Value::Null);
    assert_eq!(status, 200);
    assert_eq!(capabilities, json!({"api": {"versions": ["v1", "v2", "v3"]}, "x-plane": {"version": "12.4.0"}}));
    let all = running.get("/api/v1/datarefs");
    assert_eq!(running.get("/api/v3/datarefs/count"), all.as_array().unwrap().len());
    let page = running.get("/api/v2/datarefs?start=2&limit=3&fields=name,value_type");
    assert_eq!(page.as_array().unwrap().len(), 3);
    assert_eq!(page[0], json!({"name": all[2]["name"], "value_type": all[2]["value_type"]}));
    let two =
        format!("/api/v3/datarefs?filter%5Bname%5D={LATITUDE}&filter%5Bname%5D=sim/time/paused&fields=value_type");
    assert_eq!(running.get(&two), json!([{"value_type": "double"}, {"value_type": "int"}]));
    assert_eq!(running.get("/api/v2/commands/count"), COMMANDS.len());
    for (path, status, code) in [
        ("/api/v3/datarefs?filter[name]=none", 404, "invalid_dataref_name"),
        ("/api/v3/datarefs?start=100000", 400, "start_out_of_range"),
        ("/api/v3/datarefs?limit=x", 400, "limit_out_of_range"),
        ("/api/v3/datarefs?fields=colour", 400, "invalid_field"),
        ("/api/v3/datarefs/1/value", 404, "invalid_dataref_id"),
        ("/api/v1/commands", 404, "not_found"),
        ("/api/v4/datarefs", 404, "not_found"),
        ("/api/v3/commands?filter[name]=none", 404, "invalid_command_name"),
    ] {
        let (found, body) = running.ask("GET", path, &Value::Null);
        assert_eq!((found, body["error_code"].as_str()), (status, Some(code)), "{path}");
    }
}

#[test]
fn values_are_exact_and_written_whole_or_by_element() {
    let latitude = "28.123456789012345";
    let running = Running::with(&["--lat", latitude]);
    let there = running.value(LATITUDE).as_f64().unwrap();
    assert!((there - latitude.parse::<f64>().unwrap()).abs() < 1e-9, "not rounded to single precision: {there}");
    let acf = running.value("sim/aircraft/view/acf_relative_path");
    use base64::Engine;
    let bytes = base64::engine::general_purpose::STANDARD.decode(acf.as_str().unwrap()).unwrap();
    assert!(bytes.starts_with(b"Aircraft/Skein/xcell60/xcell60.acf\0"));

    let throttle = "sim/cockpit2/engine/actuators/throttle_ratio";
    let address = |name: &str| format!("/api/v3/datarefs/{}/value", running.id(name));
    let element = format!("{}?index=2", address(throttle));
    assert_eq!(running.ask("PATCH", &element, &json!({"data": 0.25})), (200, Value::Null));
    running.until(throttle, |value| value[2] == 0.25 && value[1] == 1.0 && value.as_array().unwrap().len() == 16);
    assert_eq!(running.get(&element), 0.25);
    let whole: Vec<f64> = (0..16).map(|nth| f64::from(nth) / 16.0).collect();
    assert_eq!(running.ask("PATCH", &address(throttle), &json!({ "data": whole })).0, 200);
    running.until(throttle, |value| *value == json!(whole));
    for (path, body, status, code) in [
        (address(throttle), json!({"data": [1.0, 2.0]}), 400, "incompatible_data"),
        (format!("{}?index=16", address(throttle)), json!({"data": 1.0}), 400, "index_out_of_range"),
        (format!("{}?index=0", address("sim/time/paused")), json!({"data": 1}), 400, "not_an_array"),
        (address(LATITUDE), json!({"data": 1.0}), 403, "dataref_is_readonly"),
        (address(throttle), json!("text"), 400, "invalid_body"),
    ] {
        let (found, reply) = running.ask("PATCH", &path, &body);
        assert_eq!((found, reply["error_code"].as_str()), (status, Some(code)), "{path}");
    }
}

#[test]
fn commands_pause_and_a_flight_is_placed_with_its_weather() {
    let running = Running::with(&[]);
    let pause = format!("/api/v3/command/{}/activate", running.id("sim/operation/pause_on"));
    assert_eq!(running.ask("POST", &pause, &json!({"duration": 11})).1["error_code"], "duration_out_of_range");
    assert_eq!(running.ask("POST", &pause, &json!({})).1["error_code"], "duration_missing");
    assert_eq!(running.ask("POST", &pause, &json!({"duration": 0})), (200, Value::Null));
    running.until("sim/time/paused", |value| *value == 1);

    let wind = json!([{
        "altitude_in_feet_msl": 0.0, "speed_in_knots": 10.0, "direction_in_degrees_true": 270.0, "turbulence_ratio": 0.1
    }]);
    let definition = json!({
        "latitude_in_degrees": 47.0, "longitude_in_degrees": 8.0, "elevation_in_meters": 400.0,
        "visibility_in_kilometers": 50.0, "wind": wind,
    });
    let weather = json!({"definition": definition, "variation_across_region_percentage": 0.0});
    let aircraft = json!({"path": "Aircraft/Skein/xcell60/xcell60.acf"});
    let start = json!({"latitude": 47.25, "longitude": 8.5, "heading_true": 90.0});
    let flight = json!({"data": {"aircraft": aircraft, "lle_ground_start": start, "weather": weather}});
    assert_eq!(running.ask("POST", "/api/v2/flight", &flight).0, 404, "flights came with version 3");
    assert_eq!(running.ask("POST", "/api/v3/flight", &flight), (200, json!({"error_code": "success"})));
    running.until(LATITUDE, |value| (value.as_f64().unwrap() - 47.25).abs() < 1e-6);
    running.until(WIND_X, |value| (value.as_f64().unwrap() - 5.144_444).abs() < 1e-3);

    let mut wrong = flight.clone();
    wrong["data"]["lle_ground_start"]["latitude"] = json!(47);
    assert_eq!(running.ask("POST", "/api/v3/flight", &wrong).1["error_code"], "invalid_value", "no decimals");
    let mut wrong = flight.clone();
    wrong["data"]["aircraft"]["path"] = json!("Aircraft/other.acf");
    assert_eq!(running.ask("POST", "/api/v3/flight", &wrong).1["error_code"], "missing_aircraft");
    assert_eq!(running.ask("PATCH", "/api/v3/flight", &flight).1["error_code"], "invalid_value", "place stays");
    let calm = json!({"data": {"weather": {"definition": {}, "variation_across_region_percentage": 0.0}}});
    assert_eq!(running.ask("PATCH", "/api/v3/flight", &calm).0, 200);
    running.until(WIND_X, |value| *value == 0.0);
}

#[test]
fn a_change_of_a_flight_sets_time_and_weight_and_leaves_the_aircraft_where_it_is() {
    let running = Running::with(&[]);
    let latitude_deg = || running.value(LATITUDE).as_f64().unwrap();
    let before_deg = latitude_deg();
    let change = json!({"data": {
        "local_time": {"day_of_year": 32, "time_in_24_hours": 7.25},
        "weight": {"payload_weight_in_kilograms": [80.5, 1.5], "fueltank_weight_in_kilograms": [20.0]},
    }});
    assert_eq!(running.ask("PATCH", "/api/v3/flight", &change), (200, json!({"error_code": "success"})));
    for (name, expected) in [
        ("sim/time/local_time_sec", 26_100.0),
        ("sim/time/local_date_days", 31.0),
        ("sim/flightmodel/weight/m_fixed", 82.0),
        ("sim/flightmodel/weight/m_fuel_total", 20.0),
    ] {
        running.until(name, |value| value.as_f64() == Some(expected));
    }
    assert!((latitude_deg() - before_deg).abs() < 1e-6);
    for wrong in [
        json!({"local_time": {"day_of_year": 32, "time_in_24_hours": 7}}),
        json!({"local_time": {"day_of_year": 0, "time_in_24_hours": 7.0}}),
        json!({"local_time": {"day_of_year": 32, "time_in_24_hours": 24.5}}),
        json!({"local_time": {"day_of_year": 32, "time_in_24_hours": 7.5}, "time_enum": "day"}),
        json!({"local_time": 7.5}),
        json!({"weight": {"payload_weight_in_kilograms": [80]}}),
        json!({"weight": {"payload_weight_in_kilograms": []}}),
        json!({"weight": {"fueltank_weight_in_kilograms": [-1.0]}}),
        json!({"weight": {"fueltank_weight_in_kilograms": 20.0}}),
    ] {
        let (_, reply) = running.ask("PATCH", "/api/v3/flight", &json!({"data": wrong}));
        assert_eq!(reply["error_code"], "invalid_value", "{wrong}");
    }
}

#[test]
fn a_web_socket_sends_what_changes_and_holds_commands() {
    let running = Running::with(&[]);
    let (roll, running_s) = (running.id("sim/joystick/yoke_roll_ratio"), running.id("sim/time/total_running_time_sec"));
    let joystick = running.id("sim/operation/override/override_joystick");
    let mut socket = Socket::open(&running);
    let request = |kind: &str, params: Value| json!({"req_id": 7, "type": kind, "params": params});
    let both = json!({"datarefs": [{"id": roll}, {"id": running_s}]});
    socket.send(&request("dataref_subscribe_values", both));
    assert_eq!(socket.next("result"), json!({"req_id": 7, "type": "result", "success": true}));
    let first = socket.next("dataref_update_values");
    assert!(first["data"].as_object().unwrap().len() == 2, "the first update is whole: {first}");
    let second = socket.next("dataref_update_values");
    assert!(second["data"][roll.to_string()].is_null(), "the roll has not changed: {second}");
    let set = json!({"datarefs": [{"id": joystick, "value": 1}, {"id": roll, "value": 0.5}]});
    socket.send(&request("dataref_set_values", set));
    assert_eq!(socket.next("result")["success"], true);
    let changed = (0..50).any(|_| socket.next("dataref_update_values")["data"][roll.to_string()] == 0.5);
    assert!(changed, "the roll was written");
    socket.send(&request("dataref_unsubscribe_values", json!({"datarefs": "all"})));
    assert_eq!(socket.next("result")["success"], true);

    let pause = running.id("sim/operation/pause_on");
    socket.send(&request("command_subscribe_is_active", json!({"commands": [{"id": pause}]})));
    assert_eq!(socket.next("command_update_is_active")["data"][pause.to_string()], false);
    socket.send(&request("command_set_is_active", json!({"commands": [{"id": pause, "is_active": true}]})));
    assert_eq!(socket.next("command_update_is_active")["data"][pause.to_string()], true);
    running.until("sim/time/paused", |value| *value == 1);
    socket.send(&request("command_set_is_active", json!({"commands": [{"id": pause, "is_active": false}]})));
    assert_eq!(socket.next("command_update_is_active")["data"][pause.to_string()], false);

    for (kind, params, code) in [
        ("dance", json!({}), "unknown_type"),
        ("dataref_subscribe_values", json!({"datarefs": [{"id": 5}]}), "invalid_dataref_id"),
        ("dataref_subscribe_values", json!({"datarefs": [{"id": roll, "index": 0}]}), "not_an_array"),
        ("command_set_is_active", json!({"commands": [{"id": 999_999_999}]}), "invalid_command_id"),
    ] {
        socket.send(&request(kind, params));
        assert_eq!(socket.next("result")["error_code"], code, "{kind}");
    }
}

#[test]
fn numbers_change_when_the_simulator_starts_anew_and_sockets_end() {
    let running = Running::with(&[]);
    let before = running.id(LATITUDE);
    let mut socket = Socket::open(&running);
    let client = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let mut datagram = Vec::new();
    Write { value: 0.3, path: "skein/standin/restart_s" }.encode(&mut datagram).unwrap();
    client.send_to(&datagram, running.udp).unwrap();
    while socket.receive().is_some() {}
    assert_ne!(running.id(LATITUDE), before);
}

#[test]
fn incoming_connections_can_be_off() {
    let running = Running::with(&["--incoming", "false"]);
    for path in ["/api/capabilities", "/api/v3/datarefs"] {
        assert_eq!(running.ask("GET", path, &Value::Null).0, 403, "{path}");
    }
    let client = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    client.set_read_timeout(Some(Duration::from_millis(300))).unwrap();
    let mut datagram = Vec::new();
    encode_rate(&rpos::TAG, 50, &mut datagram);
    client.send_to(&datagram, running.udp).unwrap();
    assert!(client.recv(&mut [0; MAX_DATAGRAM]).is_err(), "datagrams are ignored too");
}

#[test]
fn connections_are_bounded_and_large_bodies_refused() {
    let running = Running::with(&[]);
    let (status, _) = running.ask("POST", "/api/v3/flight", &json!({"data": "x".repeat(300_000)}));
    assert_eq!(status, 413);
    let idle: Vec<TcpStream> = (0..32).map(|_| TcpStream::connect(running.web).unwrap()).collect();
    skein_host::clock::sleep(Duration::from_millis(100));
    let mut further = TcpStream::connect(running.web).unwrap();
    further.set_read_timeout(Some(Duration::from_secs(2))).unwrap();
    assert!(matches!(further.read(&mut [0]), Ok(0) | Err(_)), "closed at once");
    drop(idle);
    skein_host::clock::sleep(Duration::from_millis(100));
    assert_eq!(running.ask("GET", "/api/capabilities", &Value::Null).0, 200);
}

#[test]
fn x_plane_11_has_none_and_takes_its_own_weather() {
    assert!(Standin::open(&options(&["--version", "11", "--web", "0"])).unwrap().web_address().is_none());
    for (version, writes) in [
        ("11", &[("sim/weather/wind_speed_kt[0]", 10.0), ("sim/weather/wind_direction_degt[0]", 270.0)][..]),
        (
            "12",
            &[
                ("sim/weather/region/wind_speed_msc[0]", 5.144_444),
                ("sim/weather/region/wind_direction_degt[0]", 270.0),
                ("sim/weather/region/update_immediately", 1.0),
            ][..],
        ),
    ] {
        let mut simulator = Simulator::new(&options(&["--version", version])).unwrap();
        let client = SocketAddr::from(([127, 0, 0, 1], 5));
        for &(path, value) in writes {
            let mut datagram = Vec::new();
            Write { value, path }.encode(&mut datagram).unwrap();
            assert!(simulator.receive(&datagram, client));
        }
        let (frame_s, _) = simulator.begin_frame();
        simulator.end_frame(frame_s, |_, _| ());
        let wind = crate::plant::xplane::server::DATAREFS.iter().position(|dataref| dataref.path == WIND_X);
        simulator.begin_frame();
        simulator.end_frame(frame_s, |_, _| ());
        let values = simulator.serve(&crate::plant::xplane::server::Task::Read(vec![(wind.unwrap(), None)])).unwrap();
        let east_m_s = values[0].as_f64().unwrap();
        assert!((east_m_s - 5.144_444).abs() < 1e-3, "version {version}: {east_m_s}");
    }
}
