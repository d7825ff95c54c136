use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use clap::Parser;
use skein_agent::plant::xplane::standin::{Standin, StandinOptions};
use skein_common::scenario::{Source, load};

use super::*;

#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    options: StandinOptions,
}

/// Lets a stand-in with these options run meanwhile.
fn with(arguments: &[&str], act: impl FnOnce(SocketAddr, Option<SocketAddr>)) {
    let given = ["standin", "--port", "0", "--beacon", "false"].iter().chain(arguments);
    let mut standin = Standin::open(&Cli::parse_from(given).options).unwrap();
    let (udp, web) = (standin.address, standin.web_address());
    let stop = Arc::new(AtomicBool::new(false));
    let of_thread = Arc::clone(&stop);
    let thread = thread::spawn(move || standin.run(&of_thread));
    act(udp, web);
    stop.store(true, Relaxed);
    thread.join().unwrap();
}

fn windy() -> Scenario {
    let text = "name = \"windy\"\n[origin]\nlatitude_deg = 47.0\nlongitude_deg = 8.0\nelevation_m = 0\n[swarm]\n\
                vehicles = 1\n[world]\nwind_m_s = 4.0\nwind_from_deg = 300.0\ngust_w20_m_s = 5.0\n";
    load(&Source { name: "windy.toml", text }, &[]).unwrap().scenario
}

fn found<'a>(lines: &'a [Line], what: &str) -> &'a Line {
    lines.iter().find(|line| line.what == what).unwrap_or_else(|| panic!("{what}: {lines:#?}"))
}

#[test]
fn every_x_plane_is_placed_and_has_the_scenarios_wind() {
    let scenario = windy();
    let start = start_of(&scenario, VehicleId::new(1).unwrap()).unwrap();
    for (arguments, how) in [
        (&["--web", "0"][..], "by its Web API"),
        (&["--version", "12"][..], "by UDP"),
        (&["--version", "11"][..], "by UDP"),
    ] {
        with(arguments, |udp, web| {
            let surveyor = Surveyor::open(&udp.to_string()).unwrap();
            let web = web.map(|web| WebApi::open(&web.to_string().parse().unwrap()));
            let lines = placed(&surveyor, web, &scenario, |_| Some(start)).unwrap();
            let line = found(&lines, "place");
            assert!(line.state == State::Good && line.found.ends_with(how), "{lines:#?}");
            let wind = found(&lines, "wind");
            assert!(wind.state == State::Good && wind.found.starts_with("4.0 m/s from 300°"), "{lines:#?}");
            assert!(found(&lines, "gusts").found.starts_with("W20 5.0 m/s becomes 2.2 of"), "{lines:#?}");
            verdict(&lines).unwrap();
        });
    }
}

#[test]
fn a_flight_begins_where_its_vehicles_start_unless_they_fly_or_are_left_where_they_are() {
    const OVERRIDE: &str = "sim/operation/override/override_joystick";
    const COLLECTIVE: &str = "sim/cockpit2/engine/actuators/prop_ratio_all";
    with(&["--lat", "47.01", "--lon", "8.0"], |udp, _| {
        let surveyor = Surveyor::open(&udp.to_string()).unwrap();
        let position = || surveyor.survey(&[], 10, Duration::from_millis(300), false).unwrap().position.unwrap();
        let begins = |scenario: &Scenario| {
            let lines = before_flight(scenario, &[udp.to_string()], || false);
            assert_eq!(found(&lines, "wind").state, State::Good, "{lines:#?}");
            lines.into_iter().find(|line| line.what == "place")
        };
        let mut as_is = windy();
        as_is.start.pattern = StartPattern::AsIs;
        assert_eq!((begins(&as_is), position().latitude_deg > 47.009), (None, true), "it was left where it is");
        let line = begins(&windy()).unwrap();
        assert!(line.state == State::Good && line.found.ends_with("by UDP"), "{line:?}");
        assert!(position().latitude_deg < 47.002);
        surveyor.write(OVERRIDE, 1.0);
        surveyor.write(COLLECTIVE, 0.9);
        let mut height_m = 0.0;
        while height_m < 10.0 {
            height_m = position().height_m;
        }
        assert_eq!(begins(&windy()), None, "it flies");
        assert!(position().height_m > height_m);
    });
}

#[test]
fn every_number_of_a_flight_has_decimals() {
    fn whole(value: &Value) -> bool {
        match value {
            Value::Number(number) => !number.is_f64(),
            Value::Array(values) => values.iter().any(whole),
            Value::Object(object) => object.values().any(whole),
            _ => false,
        }
    }
    let mut scenario = windy();
    (scenario.plant.payload_kg, scenario.plant.fuel_kg) = (Some(80.0), Some(20.0));
    let start = start_of(&scenario, VehicleId::new(1).unwrap()).unwrap();
    with(&["--web", "0"], |_, web| {
        let web = WebApi::open(&web.unwrap().to_string().parse().unwrap()).unwrap();
        let mut new = flight(&web, "Aircraft/x.acf", &scenario, &start);
        assert!(!whole(&new) && new["time_enum"] == "day" && new["weight"].is_object(), "{new}");
        scenario.plant.local_time_h = Some(7.0);
        new = flight(&web, "Aircraft/x.acf", &scenario, &start);
        assert_eq!((new["local_time"]["time_in_24_hours"].is_f64(), new.get("time_enum")), (true, None), "{new}");
        assert_eq!(new["local_time"]["day_of_year"], 172, "its date stays");
    });
}

#[test]
fn time_and_weight_are_set_by_the_web_api_and_read_back_and_differences_are_warnings() {
    let mut scenario = windy();
    let plant = &mut scenario.plant;
    (plant.local_time_h, plant.payload_kg, plant.fuel_kg) = (Some(7.5), Some(80.0), Some(20.0));
    let start = start_of(&scenario, VehicleId::new(1).unwrap()).unwrap();
    let states = |lines: &[Line]| ["time of day", "payload", "fuel"].map(|what| found(lines, what).state);
    with(&["--web", "0"], |udp, web| {
        let surveyor = Surveyor::open(&udp.to_string()).unwrap();
        let open = || web.map(|web| WebApi::open(&web.to_string().parse().unwrap()));
        let lines = placed(&surveyor, open(), &scenario, |_| Some(start)).unwrap();
        assert_eq!(states(&lines), [State::Good; 3], "{lines:#?}");
        assert_eq!(found(&lines, "time of day").found, "07:30 local time");
        // It stands at its start now: its flight is changed, and does not begin anew.
        let position = || surveyor.survey(&[], 10, Duration::from_millis(300), false).unwrap().position.unwrap();
        let before = position();
        surveyor.write("skein/standin/crash", 1.0);
        scenario.world.wind_m_s = 8.0;
        scenario.plant.payload_kg = Some(60.0);
        let lines = placed(&surveyor, open(), &scenario, |_| Some(start)).unwrap();
        assert!(found(&lines, "place").found.ends_with("its flight changed by its Web API"), "{lines:#?}");
        assert!(found(&lines, "wind").found.starts_with("8.0 m/s from 300°"), "{lines:#?}");
        assert_eq!(found(&lines, "payload").found, "60.0 kg");
        let crashed = ["sim/flightmodel2/misc/has_crashed".to_owned()];
        let survey = surveyor.survey(&crashed, 0, Duration::from_secs(2), false).unwrap();
        assert_eq!(survey.value(&crashed[0]), Some(1.0), "a new flight would have ended the crash");
        assert!((position().latitude_deg - before.latitude_deg).abs() < 1e-7);
        // Without a placement the weather and the time change, and nothing of the aircraft.
        scenario.plant.local_time_h = Some(0.0);
        (scenario.world.wind_m_s, scenario.plant.payload_kg) = (2.0, Some(10.0));
        let lines = placed(&surveyor, open(), &scenario, |_| None).unwrap();
        assert!(found(&lines, "wind").found.starts_with("2.0 m/s from 300°"), "{lines:#?}");
        assert_eq!(states(&lines), [State::Good, State::Warning, State::Good], "{lines:#?}");
        assert_eq!(found(&lines, "payload").found, "60.0 kg; the scenario has 10.0 kg");
    });
    with(&["--version", "11"], |udp, _| {
        let surveyor = Surveyor::open(&udp.to_string()).unwrap();
        let lines = placed(&surveyor, None, &scenario, |_| Some(start)).unwrap();
        assert_eq!(states(&lines), [State::Warning; 3], "UDP does not set them: {lines:#?}");
        verdict(&lines).unwrap();
    });
}

#[test]
fn a_web_api_that_agrees_and_does_nothing_is_not_believed() {
    use std::io::{Read, Write};
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let at: HostPort = listener.local_addr().unwrap().to_string().parse().unwrap();
    thread::spawn(move || {
        for mut stream in listener.incoming().map_while(Result::ok) {
            let mut request = vec![0; 65_536];
            let size = stream.read(&mut request).unwrap_or_default();
            let body = match &request[..size] {
                capabilities if capabilities.starts_with(b"GET /api/cap") => {
                    r#"{"api":{"versions":["v3"]},"x-plane":{"version":"12.4.0"}}"#
                }
                datarefs if datarefs.starts_with(b"GET ") => r#"{"data":[]}"#,
                _ => r#"{"error_code":"success"}"#,
            };
            let head = format!("HTTP/1.1 200 OK\r\nContent-Length: {}\r\nConnection: close\r\n\r\n", body.len());
            let _ = stream.write_all((head + body).as_bytes());
        }
    });
    with(&[], |udp, _| {
        let surveyor = Surveyor::open(&udp.to_string()).unwrap();
        let lines = placed(&surveyor, Some(WebApi::open(&at)), &windy(), |_| None).unwrap();
        assert!(found(&lines, "wind").found.starts_with("4.0 m/s from 300°"), "written by UDP then: {lines:#?}");
    });
}

#[test]
fn an_x_plane_that_does_not_answer_is_a_fault() {
    let silent = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let surveyor = Surveyor::open(&silent.local_addr().unwrap().to_string()).unwrap();
    let lines = placed(&surveyor, None, &windy(), |_| None).unwrap();
    assert!(matches!(&lines[..], [line] if line.state == State::Fault), "{lines:#?}");
}

#[test]
fn weather_is_written_with_the_names_and_units_of_its_version() {
    let world = windy().world;
    let of = |is_12: bool, path: &str| {
        let writes = weather::writes(&world, is_12);
        writes.iter().find(|(name, _)| name == path).map(|(_, value)| *value)
    };
    assert_eq!(of(true, "sim/weather/region/wind_speed_msc[12]"), Some(4.0));
    assert_eq!(of(true, "sim/weather/region/change_mode"), Some(3.0));
    assert_eq!(of(false, "sim/weather/wind_speed_kt[2]"), Some((4.0 * 3600.0 / 1852.0) as f32));
    assert_eq!(of(false, "sim/weather/wind_speed_kt[3]"), None);
    assert_eq!(of(false, "sim/weather/use_real_weather_bool"), Some(0.0));
    assert_eq!(weather::writes(&world, true).last().unwrap().0, "sim/weather/region/update_immediately");
}
