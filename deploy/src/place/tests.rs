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
    let (udp, web) = (standin.address(), standin.web_address());
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
    let scenario = windy();
    let start = start_of(&scenario, VehicleId::new(1).unwrap()).unwrap();
    assert!(!whole(&flight("Aircraft/x.acf", &scenario, &start)));
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
