use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

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
        assert!(matches!(api.start_flight(&json!({})), Err(WebError::Refused(400, _))));
    });
}

#[test]
fn refusal_and_absence_differ() {
    with(&["--incoming", "false"], |at| {
        let error = WebApi::open(at).unwrap_err();
        assert!(error.to_string().contains("\"Accept incoming connections\" is off"), "{error}");
    });
    let nobody = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let error = WebApi::open(&nobody.to_string().parse().unwrap()).unwrap_err();
    assert!(matches!(error, WebError::Absent(..)), "{error}");
}

#[test]
fn the_web_api_is_looked_for_on_this_pc_only() {
    let of = |given: Option<&str>, simulator: &str| {
        let given = given.map(|text| text.parse().unwrap());
        match WebChoice::or_of(given.as_ref(), &simulator.parse().unwrap()) {
            WebChoice::Off => "off".to_owned(),
            WebChoice::At(HostPort { host, port }) => format!("{host}:{port}"),
        }
    };
    assert_eq!(of(None, "127.0.0.1:49010"), "127.0.0.1:8086");
    assert_eq!(of(None, "localhost"), "localhost:8086");
    assert_eq!(of(None, "10.0.0.7"), "off");
    assert_eq!(of(Some("127.0.0.1:9000"), "10.0.0.7"), "127.0.0.1:9000");
    assert_eq!(of(Some("off"), "127.0.0.1"), "off");
    assert!("a:b".parse::<WebChoice>().is_err());
}
