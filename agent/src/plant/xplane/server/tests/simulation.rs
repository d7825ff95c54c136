//! Pause, reset, rows and radar.

use std::collections::BTreeSet;

use super::*;
use crate::plant::xplane::wire::radr::{RadarPoint, RadarPoint11};
use crate::plant::xplane::wire::rows::{DATA_OUTPUT, Destination, Row, Selection, decode_rows, encode_rows};

const PAUSED: &str = "sim/time/paused";

/// Runs a command, which gives no order to the caller.
fn run(bench: &mut Bench, path: &str) {
    bench.send(client(1), |out| Command { path }.encode(out).unwrap());
}

#[test]
fn while_paused_time_stands_still_and_messages_go_on() {
    let mut bench = Bench::new();
    bench.subscribe_position(client(1), 50);
    bench.frames(50);
    let before_s = bench.read(RUNNING).unwrap();
    run(&mut bench, "sim/operation/pause_toggle");
    assert!(bench.server.is_paused);
    bench.sent.clear();
    bench.frames(50);
    assert_eq!(bench.positions(client(1)), 50);
    assert_eq!([PAUSED, "sim/time/sim_speed_actual"].map(|path| bench.read(path)), [Some(1.0), Some(0.0)]);
    assert_eq!(bench.read(RUNNING), Some(before_s));
    for (path, paused) in [("sim/operation/pause_on", 1.0), ("sim/operation/pause_off", 0.0)] {
        run(&mut bench, path);
        assert_eq!(bench.read(PAUSED), Some(paused), "{path}");
    }
    assert!(bench.read(RUNNING).unwrap() > before_s);
    run(&mut bench, "sim/operation/no_such_command");
    assert_eq!(bench.server.malformed, 0);
}

#[test]
fn a_reset_gives_the_controls_back_and_tells_the_caller() {
    let mut bench = Bench::new();
    bench.set(JOYSTICK, 1.0);
    bench.set(COLLECTIVE, 0.5);
    assert!(bench.frame().is_some());
    let mut datagram = Vec::new();
    Command { path: "sim/operation/reset_flight" }.encode(&mut datagram).unwrap();
    assert_eq!(bench.server.handle(&datagram, client(1)), Some(Order::Reset));
    assert_eq!((bench.frame(), bench.read(JOYSTICK)), (None, Some(0.0)));
}

#[test]
fn nobody_ends_the_simulator() {
    let mut bench = Bench::new();
    operation::ENDS.into_iter().for_each(|end| bench.send(client(1), |out| out.extend([&end[..], b"\0"].concat())));
    assert_eq!((bench.server.refused_ends, bench.server.malformed), (2, 0));
}

fn destination(address: [u8; 4], port: u16, is_on: bool) -> Destination {
    Destination { target: DATA_OUTPUT, address: address.into(), port, is_on }
}

#[test]
fn selected_rows_go_to_the_one_receiver_at_its_rate() {
    let mut bench = Bench::new();
    let select = |bench: &mut Bench, tag, rows: &[i32]| {
        bench.send(client(1), |out| Selection { tag, rows: rows.to_vec() }.encode(out));
    };
    select(&mut bench, *b"DSEL", &[20, 16, 17, 16, 3, 9_999, -1, 77]);
    bench.frames(50);
    assert_eq!(bench.sent.len(), 0, "no receiver is set");
    bench.send(client(1), |out| destination([127, 0, 0, 1], 49_005, true).encode(out));
    bench.frames(50);
    assert!(bench.sent.iter().all(|(to, _)| *to == client(49_005)));
    assert_eq!(bench.sent.len(), 20, "the rate at the start");
    let rows = decode_rows(&bench.sent[0].1).unwrap();
    assert_eq!(rows.iter().map(|row| row.index).collect::<Vec<_>>(), [3, 16, 17, 20]);
    let near = |row: &Row, expected: &[f32]| {
        expected.iter().zip(row.values).all(|(expected, value)| (value.unwrap() - expected).abs() < 1e-3)
    };
    assert!(near(&rows[1], &[5.72958, 11.45916, -17.18873]), "{:?}", rows[1]);
    assert!(near(&rows[2], &[-2.86479, 5.72958, 302.70422]), "{:?}", rows[2]);
    assert!(near(&rows[3], &[28.25, -82.5, 328.08398, 39.37008]), "{:?}", rows[3]);
    assert!((rows[0].values[3].unwrap() - 9.71922).abs() < 1e-3, "{:?}", rows[0]);
    assert!(rows[0].values[4].is_none(), "a slot without a value: {:?}", rows[0]);

    bench.set("sim/network/dataout/network_data_rate", 1000.0);
    select(&mut bench, *b"USEL", &[3, 16, 17]);
    bench.sent.clear();
    bench.frames(50);
    assert_eq!(bench.sent.len(), 50, "never faster than frames");
    assert_eq!(decode_rows(&bench.sent[0].1).unwrap().len(), 1);
    // Not towards another computer, and not any more.
    bench.send(client(1), |out| destination([10, 0, 0, 7], 49_005, true).encode(out));
    bench.send(client(1), |out| destination([127, 0, 0, 1], 49_005, false).encode(out));
    bench.sent.clear();
    bench.frames(50);
    assert_eq!(bench.sent.len(), 0);
}

#[test]
fn rates_of_rotation_have_the_order_and_unit_of_the_version() {
    let mut bench = Bench { server: Server::new(Version::V11, RATE_HZ, Surroundings::default()), sent: Vec::new() };
    bench.send(client(1), |out| Selection { tag: *b"DSEL", rows: vec![16] }.encode(out));
    bench.send(client(1), |out| destination([127, 0, 0, 1], 49_005, true).encode(out));
    bench.frames(50);
    let row = decode_rows(&bench.sent[0].1).unwrap()[0];
    assert_eq!(row.values[..4], [Some(0.2), Some(0.1), Some(-0.3), None]);
}

#[test]
fn rows_set_the_controls_and_leave_out_what_has_no_value() {
    let mut bench = Bench::new();
    bench.set(JOYSTICK, 1.0);
    bench.set(ROLL, 0.25);
    let mut stick = Row { index: 8, values: [None; 8] };
    stick.values[0] = Some(7.0);
    let collective = Row { index: 28, values: [Some(0.5); 8] };
    let unknown = Row { index: 77, values: [Some(1.0); 8] };
    bench.send(client(1), |out| encode_rows(&[stick, collective, unknown], out).unwrap());
    let controls = bench.frame().unwrap();
    let expected = Controls { roll: 0.25, pitch: 1.0, yaw: 0.0, collective: 0.5 };
    assert_eq!(controls, expected);
}

#[test]
fn the_radar_has_one_client_and_the_layout_of_the_version() {
    for version in [Version::V11, Version::V12] {
        let mut bench = Bench { server: Server::new(version, RATE_HZ, Surroundings::default()), sent: Vec::new() };
        let ask = |bench: &mut Bench, port, rate_hz| {
            bench.send(client(port), |out| wire::encode_rate(&radr::TAG, rate_hz, out));
        };
        ask(&mut bench, 1, 10);
        ask(&mut bench, 2, 10);
        bench.frames(50);
        assert!(bench.sent.len() == 10 && bench.sent.iter().all(|(to, _)| *to == client(1)));
        let reply = &bench.sent[0].1;
        let latitudes_deg: Vec<f32> = match version {
            Version::V11 => RadarPoint11::decode(reply).unwrap().iter().map(|point| point.latitude_deg).collect(),
            Version::V12 => RadarPoint::decode(reply).unwrap().iter().map(|point| point.latitude_deg).collect(),
        };
        assert_eq!(latitudes_deg, [28.25]);
        ask(&mut bench, 1, 0);
        ask(&mut bench, 2, 10);
        bench.sent.clear();
        bench.frames(50);
        assert!(bench.sent.len() == 10 && bench.sent.iter().all(|(to, _)| *to == client(2)));
    }
}

#[test]
fn the_rows_and_datarefs_of_public_clients_have_values() {
    let mut server = Server::new(Version::V12, RATE_HZ, Surroundings::default());
    let mut level = flying();
    level.measurement.attitude = Attitude { roll_rad: 0.0, pitch_rad: 0.0, heading_rad: -1.0 };
    server.publish(&level, 0.02, |_, _| {});
    let situation = server.situation.unwrap();
    let settings = Settings::new();
    for path in [
        "sim/flightmodel/position/true_airspeed",
        "sim/flightmodel/position/hpath",
        "sim/flightmodel/forces/g_axil",
        "sim/flightmodel/forces/g_side",
        "sim/flightmodel/forces/g_nrml",
        "sim/weather/barometer_current_inhg",
    ] {
        assert!(
            Handle::find(path, 16, DEFAULT_ACF).is_some_and(|it| it.read(&situation, &settings).is_finite()),
            "{path}"
        );
    }
    let of = |row: i32| output::read(row, &situation, &settings, Version::V12).unwrap().values;
    assert_eq!(
        [4, 5, 6].map(|at| of(4)[at]),
        [Some(1.0), Some(0.0), Some(0.0)],
        "without acceleration the seat pushes up"
    );
    for (row, given) in [(3, 7), (4, 5), (17, 4), (18, 5), (19, 2), (21, 6)] {
        assert_eq!(of(row).iter().flatten().count(), given, "row {row}");
    }
}

#[test]
fn every_dataref_has_a_path_of_its_own() {
    let paths: BTreeSet<_> = DATAREFS.iter().map(|dataref| dataref.path).collect();
    assert_eq!(paths.len(), DATAREFS.len());
}
