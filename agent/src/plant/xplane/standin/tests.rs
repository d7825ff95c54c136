use std::thread;

use clap::Parser;

use super::*;
use crate::plant::xplane::server::Version;
use crate::plant::xplane::wire::aircraft::{Move, VEHS, VEHX};
use crate::plant::xplane::wire::dref::Write;
use crate::plant::xplane::wire::operation::Command;
use crate::plant::xplane::wire::prel::Placement;
use crate::plant::xplane::wire::rpos::{self, Position};
use crate::plant::xplane::wire::{MAX_DATAGRAM, Tag, encode_rate, rref};

mod faults;
mod web;

#[derive(Parser)]
#[command(args_override_self = true)]
struct Cli {
    #[command(flatten)]
    options: StandinOptions,
}

/// Options with a port chosen by the system and without a beacon.
fn options(arguments: &[&str]) -> StandinOptions {
    let given = ["xplane-standin", "--port", "0", "--beacon", "false"].iter().chain(arguments);
    Cli::try_parse_from(given).unwrap().options
}

/// A client and a stand-in whose frames the test runs.
struct Bench {
    standin: Standin,
    client: UdpSocket,
}

impl Bench {
    fn new(arguments: &[&str]) -> Self {
        let standin = Standin::open(&options(arguments)).unwrap();
        let client = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        client.set_read_timeout(Some(Duration::from_secs(2))).unwrap();
        Self { standin, client }
    }

    fn send(&self, write: impl FnOnce(&mut Vec<u8>)) {
        let mut datagram = Vec::new();
        write(&mut datagram);
        self.client.send_to(&datagram, self.standin.address).unwrap();
    }

    fn set(&self, path: &str, value: f32) {
        self.send(|out| Write { value, path }.encode(out).unwrap());
    }

    fn position_after(&mut self, frames: u32) -> Position {
        self.send(|out| encode_rate(&rpos::TAG, 50, out));
        let mut buffer = [0; MAX_DATAGRAM];
        let mut newest = None;
        for _ in 0..frames {
            self.standin.frame();
            let size = self.client.recv(&mut buffer).unwrap();
            newest = Some(Position::decode(&buffer[..size]).unwrap());
        }
        newest.unwrap()
    }
}

#[test]
fn the_helicopter_rests_at_its_start_until_a_client_flies_it() {
    let mut bench = Bench::new(&["--lat", "-28", "--lon=-82.5", "--alt", "-3.5", "--heading", "90"]);
    let standing = bench.position_after(100);
    assert!((standing.latitude_deg + 28.0).abs() < 1e-9 && (standing.longitude_deg + 82.5).abs() < 1e-9);
    assert!((standing.heading_deg - 90.0).abs() < 1e-3 && (standing.elevation_m + 3.5 - 0.242).abs() < 0.01);
    assert!((standing.height_m - 0.242).abs() < 0.01);

    bench.set("sim/operation/override/override_joystick", 1.0);
    bench.set("sim/joystick/yoke_roll_ratio", 0.0185);
    bench.set("sim/cockpit2/engine/actuators/prop_ratio[0]", 0.7);
    let risen = bench.position_after(50);
    assert!(risen.height_m > 0.5 && risen.velocity_up_m_s > 0.5, "{risen:?}");

    bench.set("sim/operation/override/override_joystick", 0.0);
    bench.position_after(1);
    assert_eq!(bench.standin.simulator.server.take_controls(), None);
}

#[test]
fn four_hundred_datarefs_that_are_asked_for_between_two_frames_are_all_answered() {
    let mut bench = Bench::new(&["--rate", "50"]);
    for index in 0..400 {
        let path = ["sim/flightmodel/position/psi", "sim/weather/barometer_current_inhg"][index as usize % 2];
        bench.send(|out| rref::DatarefRequest { frequency_hz: 50, index, path }.encode(out).unwrap());
        // As while it waits for the frame: the system's queue holds 166 requests.
        if index % 100 == 99 {
            bench.standin.collect();
        }
    }
    bench.standin.frame();
    let (mut values, mut sizes, mut buffer) = (std::collections::BTreeMap::new(), Vec::new(), [0; MAX_DATAGRAM]);
    while values.len() < 400 {
        let size = bench.client.recv(&mut buffer).unwrap_or_else(|error| panic!("{} values: {error}", values.len()));
        let pairs = rref::decode_values(&buffer[..size]).unwrap();
        sizes.push(pairs.len());
        values.extend(pairs);
    }
    assert_eq!(sizes, [183, 183, 34], "as many as a datagram holds");
    assert!((values[&1] - 29.92).abs() < 0.01, "{values:?}");
}

#[test]
fn a_client_holds_the_users_own_aircraft_in_a_pose_and_gives_it_back() {
    let mut bench = Bench::new(&["--lat", "28", "--lon=-82.5", "--alt", "10"]);
    bench.position_after(5);
    let moved = |tag: Tag| Move {
        tag,
        aircraft: 0,
        latitude_deg: 28.001,
        longitude_deg: -82.499,
        elevation_m: 60.0,
        heading_deg: 120.0,
        pitch_deg: 5.0,
        roll_deg: -3.0,
    };
    bench.send(|out| moved(VEHX).encode(out));
    let held = bench.position_after(20);
    assert!((held.latitude_deg - 28.001).abs() < 1e-9 && (held.longitude_deg + 82.499).abs() < 1e-9, "{held:?}");
    assert!((held.elevation_m - 60.0).abs() < 1e-6 && (held.height_m - 50.0).abs() < 1e-4, "{held:?}");
    for (shown, given) in [(held.heading_deg, 120.0), (held.pitch_deg, 5.0), (held.roll_deg, -3.0)] {
        assert!((shown - given).abs() < 1e-2, "{held:?}");
    }
    assert_eq!((held.velocity_up_m_s, held.roll_rate_rad_s), (0.0, 0.0), "a pose has no speed");
    bench.set("sim/operation/override/override_planepath[0]", 0.0);
    let standing = bench.position_after(50);
    assert!((standing.height_m - 0.242).abs() < 0.01, "the flight model continues, from the ground: {standing:?}");
    assert!(
        (standing.latitude_deg - 28.001).abs() < 1e-6 && (standing.heading_deg - 120.0).abs() < 0.1,
        "{standing:?}"
    );
    bench.send(|out| Move { latitude_deg: 28.002, ..moved(VEHS) }.encode(out));
    let standing = bench.position_after(10);
    assert!((standing.latitude_deg - 28.002).abs() < 1e-6 && standing.height_m < 1.0, "{standing:?}");
}

#[test]
fn a_pause_holds_the_helicopter_in_the_air_and_a_reset_returns_it_to_its_start() {
    let mut bench = Bench::new(&["--lat", "28", "--lon=-82.5", "--heading", "90"]);
    let fly = |bench: &Bench| {
        bench.set("sim/operation/override/override_joystick", 1.0);
        bench.set("sim/joystick/yoke_roll_ratio", 0.0185);
        bench.set("sim/cockpit2/engine/actuators/prop_ratio[0]", 0.7);
    };
    let run = |bench: &Bench, path: &str| bench.send(|out| Command { path }.encode(out).unwrap());
    fly(&bench);
    bench.position_after(50);
    run(&bench, "sim/operation/pause_on");
    let held = bench.position_after(1);
    assert!(held.height_m > 0.5, "{held:?}");
    assert_eq!(bench.position_after(50), held);
    run(&bench, "sim/operation/pause_off");
    assert!(bench.position_after(10).height_m > held.height_m + 0.1);

    run(&bench, "sim/operation/reset_flight");
    let standing = bench.position_after(50);
    assert!((standing.height_m - 0.242).abs() < 0.01 && (standing.longitude_deg + 82.5).abs() < 1e-9, "{standing:?}");
    fly(&bench);
    assert!(bench.position_after(50).height_m > 0.5, "a client takes the controls again");
}

#[test]
fn a_placement_puts_the_helicopter_on_the_ground_elsewhere() {
    let mut bench = Bench::new(&["--alt", "10"]);
    let placement = Placement {
        aircraft: 0,
        latitude_deg: 47.0,
        longitude_deg: 8.0,
        elevation_m: 500.0,
        heading_deg: 180.0,
        speed_m_s: 20.0,
    };
    bench.send(|out| placement.encode(out));
    let placed = bench.position_after(5);
    assert!((placed.latitude_deg - 47.0).abs() < 1e-9 && (placed.longitude_deg - 8.0).abs() < 1e-9);
    assert!((placed.elevation_m - 10.242).abs() < 0.01 && (placed.heading_deg - 180.0).abs() < 1e-3);
}

#[test]
fn a_frame_simulates_its_length_but_no_more_than_x_plane_does() {
    let running_s = |arguments: &[&str]| {
        let mut bench = Bench::new(arguments);
        for _ in 0..10 {
            bench.standin.frame();
        }
        bench.standin.simulator.truth().time.seconds()
    };
    assert!((running_s(&[]) - 0.2).abs() < 1e-9);
    for (rate, expected_s) in [("20", 0.5), ("30", 1.0 / 3.0), ("100", 0.1), ("15", 10.0 / 19.0), ("1", 10.0 / 19.0)] {
        assert!((running_s(&["--rate", rate]) - expected_s).abs() < 1e-9, "{rate}");
    }
    let irregular_s = running_s(&["--rate", "20", "--jitter", "0.5"]);
    assert!((irregular_s - 0.5).abs() > 1e-3 && (0.3..0.7).contains(&irregular_s), "{irregular_s}");
}

#[test]
fn vehicles_listen_ten_ports_apart() {
    let port = |arguments: &[&str]| {
        Some(options(arguments)).and_then(|options| port_of("port", options.port, options.id).ok())
    };
    assert_eq!(port(&["--port", "49000"]), Some(49000));
    assert_eq!(port(&["--port", "49000", "--id", "10"]), Some(49090));
    assert_eq!(port(&["--port", "65000", "--id", "250"]), None);
    assert_eq!(port(&["--id", "250"]), Some(0));
}

#[test]
fn defaults_are_a_field_in_florida_and_the_port_of_x_plane() {
    let defaults = Cli::try_parse_from(["xplane-standin"]).unwrap().options;
    assert_eq!((defaults.port, defaults.lat_deg, defaults.lon_deg, defaults.rate), (49000, 28.0, -82.0, 50));
    assert_eq!((defaults.version, defaults.beacon, defaults.until_unused), (Version::V12, true, false));
}

#[test]
fn options_out_of_range_are_refused_by_name() {
    for (arguments, named) in [
        (["--rate", "201"], "--rate 201"),
        (["--rate", "0"], "--rate 0"),
        (["--jitter", "1"], "--jitter 1"),
        (["--drop", "NaN"], "--drop NaN"),
        (["--acf", "ü"], "--acf ü"),
        (["--lat", "91"], "--lat 91"),
        (["--lon", "NaN"], "--lon NaN"),
        (["--alt", "inf"], "--alt inf"),
        (["--heading", "1e9"], "--heading"),
        (["--wind-m-s", "NaN"], "--wind-m-s NaN"),
        (["--gust-w20-m-s", "1e3"], "--gust-w20-m-s 1000"),
        (["--aircraft", "no/such.toml"], "cannot read no/such.toml"),
    ] {
        let message = Standin::open(&options(&arguments)).err().map(|error| error.to_string()).unwrap_or_default();
        assert!(message.contains(named), "{arguments:?}: {message}");
    }
    for arguments in [["--version", "10"], ["--id", "0"], ["--id", "251"]] {
        assert!(Cli::try_parse_from(["x"].iter().chain(&arguments)).is_err(), "{arguments:?}");
    }
}

#[test]
fn an_error_names_a_port_in_use() {
    let first = Standin::open(&options(&[])).unwrap();
    let again = StandinOptions { port: first.address.port(), ..options(&[]) };
    let message = Standin::open(&again).err().unwrap().to_string();
    assert!(message.contains(&first.address.to_string()), "{message}");
}

#[test]
fn small_delays_do_not_add_up_and_large_ones_start_a_new_grid() {
    let (start, period) = (now(), Duration::from_millis(20));
    let late = |frames: u32| start + frames * period;
    assert_eq!(next_deadline(start, period, start), start + period);
    assert_eq!(next_deadline(start, period, late(4)), start + period);
    assert_eq!(next_deadline(start, period, late(50)), late(50));
}

#[test]
fn the_stand_in_keeps_its_pace_and_stops_on_request() {
    let Bench { mut standin, client } = Bench::new(&[]);
    let to = standin.address;
    let stop = AtomicBool::new(false);
    let mut request = Vec::new();
    rref::DatarefRequest { frequency_hz: 50, index: 1, path: "sim/time/total_running_time_sec" }
        .encode(&mut request)
        .unwrap();
    thread::scope(|scope| {
        scopeguard::defer! { stop.store(true, Relaxed) }
        scope.spawn(|| standin.run(&stop));
        client.send_to(&request, to).unwrap();
        let mut buffer = [0; MAX_DATAGRAM];
        let mut running_s = || {
            let size = client.recv(&mut buffer).unwrap();
            f64::from(rref::decode_values(&buffer[..size]).unwrap().next().unwrap().1)
        };
        let (began, first_s) = (now(), running_s());
        let last_s = (0..50).map(|_| running_s()).last().unwrap();
        let local_s = (now() - began).as_secs_f64();
        assert!((last_s - first_s - 1.0).abs() < 1e-4);
        assert!(local_s > 0.9, "a simulated second took {local_s} s");
    });
}
