//! A swarm on independent ground stations: pymavlink, and MAVSDK. Both are Python packages of `tests/requirements.txt`.

use skein_tests::share::Share;
use std::io::Write;
use std::net::UdpSocket;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::{SystemTime, UNIX_EPOCH};

use serde_json::Value;
use skein_cluster::endpoints;
use skein_cluster::mesh::observe::{Observer, SwarmMessage};
use skein_cluster::mesh::reach::Reach;
use skein_common::frame::{Geodetic, Origin};
use skein_common::id::SwarmName;
use skein_common::message::Trace;
use skein_common::topic::Branch;

use super::live::Flight;
use super::{Place, number};

const STATION: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/src/ground_station.py");

/// A UDP port that is free now.
fn free_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// The Python that has this package; `None` without it, unless it is required.
fn python(package: &str) -> Option<PathBuf> {
    let python = std::env::var_os("SKEIN_PYTHON").map_or_else(|| PathBuf::from("python3"), PathBuf::from);
    let found = Command::new(&python).args(["-c", &format!("import {package}")]).output();
    if found.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    let why = format!("{} has no package {package}: pip install -r tests/requirements.txt", python.display());
    assert_ne!(std::env::var("SKEIN_MCAP").as_deref(), Ok("required"), "{why}");
    let _ = writeln!(std::io::stdout(), "skipped: {why}");
    None
}

fn now_ms() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64() * 1e3
}

/// A flight on a ground station: what that has received, and the worst errors against the ground truth.
struct Watched {
    received: Value,
    /// Distance, m.
    place_m: f64,
    /// Speed, m/s.
    speed_m_s: f64,
    /// Attitude angle, rad.
    angle_rad: f64,
    compared: usize,
}

/// Flies vehicles, watches them on a ground station of this kind for some seconds, and lands vehicle 2 with it. With a key messages
/// are signed, and the station gives vehicle 1 further commands.
fn watch(kind: &str, vehicles: usize, seconds: u32, key: Option<[u8; 32]>) -> Option<Watched> {
    let python = python(kind)?;
    let place = Place::new();
    let (port, key_file) = (free_port(), place.path("mavlink.key").display().to_string());
    let mut options = vec!["--orders"];
    let mut arguments: Vec<String> =
        [kind, &port.to_string(), &vehicles.to_string(), &seconds.to_string(), "2"].map(str::to_owned).into();
    if let Some(key) = key {
        std::fs::write(&key_file, key).unwrap();
        rustix::fs::chmod(&key_file, rustix::fs::Mode::from_raw_mode(0o600)).unwrap();
        options.extend(["--mavlink-key", &key_file]);
        arguments.push(key_file.clone());
    }
    let _server =
        place.view(&[&["--swarm", "station", "--mavlink", &format!("127.0.0.1:{port}")][..], &options].concat());
    let flight = Flight::with(&place, "station", vehicles, &["mission.steps=[{ hold_s = 900 }, { land = true }]"]);
    let mut station = Command::new(python);
    let station = station.arg(STATION).args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();

    let runtime = place.path("runtime").join("skein");
    let swarm = SwarmName::new("station").unwrap();
    let until = std::time::Instant::now() + std::time::Duration::from_secs(60);
    let there = loop {
        match endpoints::find(&runtime, Some(&swarm)) {
            Ok(there) => break there,
            Err(_) if std::time::Instant::now() < until => std::thread::sleep(std::time::Duration::from_millis(100)),
            Err(error) => panic!("{error}"),
        }
    };
    let mut observer = Observer::open(&Reach::here(&there, Branch::SWARM)).unwrap();
    observer.subscribe_to_traces(true).unwrap();
    let ended = std::thread::spawn(move || station.wait_with_output().unwrap());
    let mut traces: Vec<(f64, Trace)> = Vec::new();
    while !ended.is_finished() {
        std::thread::sleep(std::time::Duration::from_millis(5));
        let at_ms = now_ms();
        let received = observer.poll().into_iter();
        traces.extend(received.filter_map(|message| match message {
            SwarmMessage::Trace(trace) => Some((at_ms, trace)),
            _ => None,
        }));
    }
    let output = ended.join().unwrap();
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{error}\n{}", std::fs::read_to_string(place.path("view.log")).unwrap());
    let received: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|why| panic!("{why}: {error}"));
    flight.end();
    Some(compared(received, &traces))
}

/// What was received against the traces around that time: the station is behind by at most a second.
fn compared(received: Value, traces: &[(f64, Trace)]) -> Watched {
    let scenario = skein_tests::scenario("hover.toml", &[]);
    let origin = Origin::new(scenario.origin.geodetic());
    let (mut place_m, mut speed_m_s, mut angle_rad, mut compared) = (0.0_f64, 0.0_f64, 0.0_f64, 0);
    for seen in received["seen"].as_array().unwrap() {
        let at_ms = number(&seen["at_ms"]);
        let of_system = |trace: &Trace| seen["system"] == trace.header.sender.get();
        let recent: Vec<&Trace> = traces
            .iter()
            .filter(|(ms, trace)| (at_ms - 1e3..at_ms + 2e2).contains(ms) && of_system(trace))
            .map(|(_, trace)| trace)
            .collect();
        assert!(!recent.is_empty(), "no trace around {seen}");
        let least = |off: &dyn Fn(&Trace) -> f64| recent.iter().map(|trace| off(trace)).fold(f64::INFINITY, f64::min);
        let three = |key: &str| seen[key].as_array().map(|all| [number(&all[0]), number(&all[1]), number(&all[2])]);
        if let Some([latitude_deg, longitude_deg, altitude_m]) = three("place") {
            let shown = Geodetic {
                latitude_rad: latitude_deg.to_radians(),
                longitude_rad: longitude_deg.to_radians(),
                altitude_m,
            };
            let ned = origin.ned_from_geodetic(&shown);
            place_m = place_m.max(least(&|trace| (trace.position.0 - ned.0).norm()));
            let relative_m = number(&seen["relative_m"]);
            place_m = place_m.max(least(&|trace| (trace.position.altitude_m() - relative_m).abs()));
        }
        if let Some(velocity) = three("velocity_ned_m_s") {
            speed_m_s = speed_m_s.max(least(&|trace| (trace.velocity.0 - nalgebra::Vector3::from(velocity)).norm()));
        }
        if let Some([roll_rad, pitch_rad, yaw_rad]) = three("attitude_rad") {
            let off = |trace: &Trace| {
                let yaw_off = (trace.attitude.heading_rad - yaw_rad).sin().abs();
                let is_opposite = (trace.attitude.heading_rad - yaw_rad).cos() < 0.0;
                let yaw_off = if is_opposite { f64::INFINITY } else { yaw_off };
                let tilt_off =
                    (trace.attitude.roll_rad - roll_rad).abs().max((trace.attitude.pitch_rad - pitch_rad).abs());
                yaw_off.max(tilt_off)
            };
            angle_rad = angle_rad.max(least(&off));
        }
        compared += 1;
    }
    println!(
        "{compared} messages: worst position error {place_m:.2} m, velocity {speed_m_s:.2} m/s, attitude {angle_rad:.3} rad"
    );
    Watched { received, place_m, speed_m_s, angle_rad, compared }
}

impl Watched {
    /// Checks that positions, velocities and attitudes were right.
    fn check(&self, least: usize) {
        assert!(self.compared >= least, "{} of {least} messages", self.compared);
        let Self { place_m, speed_m_s, angle_rad, .. } = self;
        assert!(
            *place_m < 1.0 && *speed_m_s < 0.5 && *angle_rad < 0.05,
            "{place_m} m, {speed_m_s} m/s, {angle_rad} rad"
        );
    }

    /// Checks that every number followed the one before.
    fn check_complete(&self) {
        let lost = self.received["lost"].as_object().unwrap();
        println!("messages of each vehicle: {}, lost: {}", self.received["counts"], self.received["lost"]);
        assert!(lost.values().all(|lost| *lost == 0), "{lost:?}");
    }
}

#[test]
fn an_independent_ground_station_sees_four_vehicles_without_loss_and_lands_one() {
    let _share = Share::of_flight(8);
    let Some(watched) = watch("pymavlink", 4, 10, None) else { return };
    let received = &watched.received;
    watched.check(4 * 40);
    watched.check_complete();
    assert_eq!(received["results"], serde_json::json!([5, 0]), "in progress, then accepted");
    assert_eq!(received["modes"]["2"], "LAND");
    assert_eq!(received["parameter"], serde_json::json!(["MAV_SYS_ID", 2.0, 1]));
    assert_eq!(received["mission"], serde_json::json!([0, 1]), "no fence");
    let texts = received["texts"].to_string();
    assert!(texts.contains("vehicle 2: landing") && texts.contains("vehicle 2: landed"), "{texts}");
}

#[test]
fn a_ground_station_with_the_key_holds_a_vehicle_lets_it_fly_on_and_sends_it_to_land() {
    let _share = Share::of_flight(8);
    let Some(watched) = watch("pymavlink", 2, 3, Some(*b"0123456789abcdef0123456789abcdef")) else { return };
    let received = &watched.received;
    watched.check(2 * 10);
    assert_eq!(received["commanded"], serde_json::json!([[0, "LOITER"], [0, "MISSION"], [0, "LAND"]]));
    assert_eq!((&received["modes"]["2"], &received["unsigned"]), (&"LAND".into(), &0.into()));
}

#[test]
#[ignore = "two flights of minutes: `.ci/long`"]
fn ground_stations_see_eight_vehicles_without_loss_in_a_minute_and_land_one() {
    let _share = Share::of_flight(8);
    let watched = watch("pymavlink", 8, 60, None).unwrap();
    watched.check(8 * 400);
    watched.check_complete();
    assert_eq!(watched.received["modes"]["2"], "LAND");
    let watched = watch("mavsdk", 8, 60, None).unwrap();
    watched.check(8 * 100);
    assert_eq!((&watched.received["armed"], &watched.received["modes"]["2"]), (&true.into(), &"LAND".into()));
}
