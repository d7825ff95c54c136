use std::collections::BTreeMap;

use proptest::prelude::*;
use skein_common::frame::{Attitude, BodyRates, Geodetic, VelocityNed};
use skein_common::time::PlantTime;

use super::clients::{MAX_CLIENTS, MAX_CLIENTS_OF_ONE_HOST, MAX_SUBSCRIPTIONS};
use super::*;
use crate::plant::xplane::wire::rpos::Position;
use skein_core::plant::{GroundTruth, Measurement};

mod simulation;

const RATE_HZ: u32 = 50;
const JOYSTICK: &str = "sim/operation/override/override_joystick";
const ROLL: &str = "sim/joystick/yoke_roll_ratio";
const PITCH: &str = "sim/joystick/yoke_pitch_ratio";
const COLLECTIVE: &str = "sim/cockpit2/engine/actuators/prop_ratio[0]";
const COLLECTIVE_ALL: &str = "sim/cockpit2/engine/actuators/prop_ratio_all";
const RUNNING: &str = "sim/time/total_running_time_sec";

fn client(port: u16) -> SocketAddr {
    SocketAddr::from(([127, 0, 0, 1], port))
}

fn flying() -> Frame {
    Frame {
        time: PlantTime::from_seconds(4.0),
        measurement: Measurement {
            position: Geodetic::from_degrees(28.25, -82.5, 100.0),
            height_m: 12.0,
            velocity: VelocityNed::new(3.0, 4.0, -1.0),
            attitude: Attitude { roll_rad: 0.1, pitch_rad: -0.05, heading_rad: -1.0 },
            rates: BodyRates { roll_rad_s: 0.1, pitch_rad_s: 0.2, yaw_rad_s: -0.3 },
            rotor_speed_rad_s: Some(167.0),
        },
        truth: GroundTruth::default(),
    }
}

/// A server and the datagrams that it has sent.
struct Bench {
    server: Server,
    sent: Vec<(SocketAddr, Vec<u8>)>,
}

impl Bench {
    fn new() -> Self {
        Self { server: Server::new(Version::V12, RATE_HZ, Surroundings::default()), sent: Vec::new() }
    }

    fn send(&mut self, from: SocketAddr, write: impl FnOnce(&mut Vec<u8>)) {
        let mut datagram = Vec::new();
        write(&mut datagram);
        assert_eq!(self.server.handle(&datagram, from), None);
    }

    fn subscribe_position(&mut self, from: SocketAddr, rate_hz: u32) {
        self.send(from, |out| wire::encode_rate(&rpos::TAG, rate_hz, out));
    }

    fn subscribe_value(&mut self, from: SocketAddr, frequency_hz: u32, index: i32, path: &str) {
        self.send(from, |out| rref::DatarefRequest { frequency_hz, index, path }.encode(out).unwrap());
    }

    fn set(&mut self, path: &str, value: f32) {
        self.send(client(1), |out| Write { value, path }.encode(out).unwrap());
    }

    fn frame(&mut self) -> Option<Controls> {
        let controls = self.server.take_controls();
        self.server
            .publish(&flying(), 1.0 / f64::from(RATE_HZ), |to, datagram| self.sent.push((to, datagram.to_vec())));
        controls
    }

    fn frames(&mut self, count: u32) {
        for _ in 0..count {
            self.frame();
        }
    }

    fn positions(&self, to: SocketAddr) -> usize {
        self.sent.iter().filter(|(client, datagram)| *client == to && datagram.starts_with(b"RPOS")).count()
    }

    /// All values sent to a client, by index.
    fn values(&self, to: SocketAddr) -> BTreeMap<i32, Vec<f32>> {
        let mut values: BTreeMap<i32, Vec<f32>> = BTreeMap::new();
        for (_, datagram) in
            self.sent.iter().filter(|(client, datagram)| *client == to && datagram.starts_with(b"RREF"))
        {
            for (index, value) in rref::decode_values(datagram).unwrap() {
                values.entry(index).or_default().push(value);
            }
        }
        values
    }

    /// Value of a dataref in the next frame.
    fn read(&mut self, path: &str) -> Option<f32> {
        let reader = client(60_000);
        self.subscribe_value(reader, RATE_HZ, 0, path);
        self.sent.clear();
        self.frame();
        self.subscribe_value(reader, 0, 0, "");
        self.values(reader).remove(&0).map(|values| values[0])
    }
}

#[test]
fn positions_come_at_the_rate_asked_for_and_never_faster_than_frames() {
    for (asked, expected) in [(50, 50), (100, 50), (25, 25), (20, 20), (7, 7), (1, 1)] {
        let mut bench = Bench::new();
        bench.subscribe_position(client(1), asked);
        bench.frame();
        assert_eq!(bench.positions(client(1)), 1, "the first is sent at once");
        bench.frames(49);
        assert_eq!(bench.positions(client(1)), expected, "{asked} Hz");
    }
}

#[test]
fn a_rate_of_zero_ends_the_positions() {
    let mut bench = Bench::new();
    bench.subscribe_position(client(1), 50);
    bench.frames(3);
    bench.subscribe_position(client(1), 0);
    bench.frames(3);
    assert_eq!(bench.positions(client(1)), 3);
    assert!(!bench.server.is_used());
}

#[test]
fn the_position_is_in_x_planes_axes_and_degrees() {
    let mut bench = Bench::new();
    bench.subscribe_position(client(1), 50);
    bench.frame();
    let (_, datagram) = &bench.sent[0];
    assert_eq!(datagram.len(), 69);
    let position = Position::decode(datagram).unwrap();
    assert!((position.longitude_deg + 82.5).abs() < 1e-12 && (position.latitude_deg - 28.25).abs() < 1e-12);
    assert_eq!((position.velocity_east_m_s, position.velocity_up_m_s, position.velocity_south_m_s), (4.0, 1.0, -3.0));
    assert!((position.heading_deg - (360.0 - 1_f32.to_degrees())).abs() < 1e-4);
    assert!((position.roll_deg - 0.1_f32.to_degrees()).abs() < 1e-5);
    assert_eq!(position.yaw_rate_rad_s, -0.3);
}

#[test]
fn clients_differ_by_address_port_and_index_each_with_its_own_rate() {
    let mut bench = Bench::new();
    bench.subscribe_value(client(1), 50, 7, RUNNING);
    bench.subscribe_value(client(1), 10, 8, RUNNING);
    bench.subscribe_value(client(2), 25, 7, "sim/time/paused");
    let elsewhere = SocketAddr::from(([127, 0, 0, 2], 1));
    bench.subscribe_value(elsewhere, 5, 7, RUNNING);
    bench.frames(50);
    let count = |to, index| bench.values(to)[&index].len();
    assert_eq!((count(client(1), 7), count(client(1), 8), count(client(2), 7), count(elsewhere, 7)), (50, 10, 25, 5));
    assert_eq!(bench.values(client(2))[&7][0], 0.0);
}

#[test]
fn the_same_index_again_replaces_path_and_rate() {
    let mut bench = Bench::new();
    bench.subscribe_value(client(1), 50, 7, RUNNING);
    bench.subscribe_value(client(1), 25, 7, "sim/version/xplane_internal_version");
    bench.frames(50);
    let values = &bench.values(client(1))[&7];
    assert_eq!((values.len(), values[0]), (25, 124_000.0));
}

#[test]
fn frequency_zero_ends_a_value_whatever_the_path() {
    for path in ["", RUNNING, "another/one"] {
        let mut bench = Bench::new();
        bench.subscribe_value(client(1), 50, 7, RUNNING);
        bench.subscribe_value(client(2), 50, 7, RUNNING);
        bench.frame();
        bench.subscribe_value(client(1), 0, 7, path);
        bench.frames(5);
        assert_eq!((bench.values(client(1))[&7].len(), bench.values(client(2))[&7].len()), (1, 6));
    }
}

#[test]
fn values_due_together_share_datagrams_of_at_most_183() {
    let mut bench = Bench::new();
    for index in 0..400 {
        bench.subscribe_value(client(1), 50, index, RUNNING);
    }
    bench.frame();
    let sizes: Vec<_> = bench.sent.iter().map(|(_, datagram)| datagram.len()).collect();
    assert_eq!(sizes, [5 + 8 * 183, 5 + 8 * 183, 5 + 8 * 34]);
    assert!(bench.sent.iter().all(|(_, datagram)| datagram.starts_with(b"RREF,")));
    assert_eq!(bench.values(client(1)).len(), 400);
}

#[test]
fn unknown_datarefs_and_elements_are_ignored() {
    let mut bench = Bench::new();
    for (index, path) in
        ["no/such/thing", "sim/time/paused[1]", "sim/cockpit2/engine/actuators/prop_ratio[16]", "", "a]"]
            .into_iter()
            .enumerate()
    {
        bench.subscribe_value(client(1), 50, index as i32, path);
    }
    bench.frames(3);
    assert!(bench.sent.is_empty());
    assert!(bench.read("sim/time/paused[0]").is_some(), "a scalar may be read as its own first element");
    assert!(bench.read("sim/cockpit2/engine/actuators/prop_ratio[15]").is_some());
    bench.server = Server::new(Version::V11, RATE_HZ, Surroundings::default());
    assert!(bench.read("sim/cockpit2/engine/actuators/prop_ratio[8]").is_none(), "X-Plane 11 has eight engines");
    assert_eq!(bench.read("sim/version/xplane_internal_version"), Some(115_501.0));
}

#[test]
fn the_aircrafts_motion_can_be_read() {
    let mut bench = Bench::new();
    let rpm = bench.read("sim/cockpit2/engine/indicators/prop_speed_rpm[0]").unwrap();
    assert!((rpm - 1594.7).abs() < 0.1, "{rpm}");
    assert_eq!(bench.read("sim/cockpit2/engine/indicators/prop_speed_rpm[1]"), Some(0.0));
    assert_eq!(bench.read("sim/flightmodel/position/latitude"), Some(28.25));
    assert_eq!(bench.read("sim/flightmodel/position/y_agl"), Some(12.0));
    assert_eq!(bench.read("sim/flightmodel/position/groundspeed"), Some(5.0));
    assert!((bench.read("sim/flightmodel/position/P").unwrap() - 5.73).abs() < 0.01);
    assert_eq!(bench.read("sim/time/total_flight_time_sec"), Some(4.0));
    assert_eq!(bench.read("sim/operation/misc/frame_rate_period"), Some(0.02));
    let before = bench.read(RUNNING).unwrap();
    bench.frames(49);
    assert!((bench.read(RUNNING).unwrap() - before - 1.0).abs() < 1e-6);
}

#[test]
fn no_client_holds_the_controls_before_an_override_and_a_collective() {
    let mut bench = Bench::new();
    bench.set(ROLL, 0.5);
    assert_eq!(bench.frame(), None);
    assert_eq!(bench.read(ROLL), Some(0.0), "the pilot's centred axis overwrites it in the next frame");
    bench.set(JOYSTICK, 1.0);
    bench.set(ROLL, 0.5);
    assert_eq!(bench.frame(), None);
    assert_eq!(bench.read(ROLL), Some(0.5));
    bench.set(COLLECTIVE, 0.6);
    let controls = bench.frame().unwrap();
    assert_eq!(controls, Controls { roll: 0.5, pitch: 0.0, yaw: 0.0, collective: f64::from(0.6_f32) });
    bench.frames(100);
    assert_eq!(bench.frame(), Some(controls), "an overridden axis keeps its value");
}

#[test]
fn a_released_override_frees_the_axes_and_keeps_the_collective() {
    let mut bench = Bench::new();
    for (path, value) in [(JOYSTICK, 1.0), (ROLL, 0.5), (COLLECTIVE, 0.6)] {
        bench.set(path, value);
    }
    assert!(bench.frame().is_some());
    bench.set(JOYSTICK, 0.0);
    assert_eq!(bench.frame(), None);
    assert_eq!((bench.read(ROLL), bench.read(COLLECTIVE)), (Some(0.0), Some(0.6)));
}

#[test]
fn one_axis_alone_can_be_overridden() {
    let mut bench = Bench::new();
    for (path, value) in
        [("sim/operation/override/override_joystick_pitch", 1.0), (PITCH, 0.3), (ROLL, 0.4), (COLLECTIVE, 0.5)]
    {
        bench.set(path, value);
    }
    let controls = bench.frame().unwrap();
    assert_eq!((controls.roll, controls.pitch), (0.0, f64::from(0.3_f32)));
}

#[test]
fn integers_are_truncated_and_travel_is_limited() {
    let mut bench = Bench::new();
    bench.set(COLLECTIVE, 0.5);
    bench.set(JOYSTICK, 0.9);
    assert_eq!(bench.frame(), None);
    assert_eq!(bench.read(JOYSTICK), Some(0.0));
    bench.set(JOYSTICK, 1.9);
    bench.set(ROLL, -7.0);
    bench.set(COLLECTIVE, 3.0);
    let controls = bench.frame().unwrap();
    assert_eq!((bench.read(JOYSTICK), controls.roll, controls.collective), (Some(1.0), -1.0, 1.0));
}

#[test]
fn the_collective_is_set_for_all_engines_or_for_each() {
    let mut bench = Bench::new();
    bench.set(JOYSTICK, 1.0);
    bench.set(COLLECTIVE_ALL, 0.25);
    assert_eq!(bench.frame().unwrap().collective, 0.25);
    assert_eq!(bench.read("sim/cockpit2/engine/actuators/prop_ratio[3]"), Some(0.25));
    bench.set("sim/cockpit2/engine/actuators/prop_ratio", 0.75);
    assert_eq!((bench.read(COLLECTIVE_ALL), bench.read(COLLECTIVE)), (Some(0.75), Some(0.75)));
}

#[test]
fn read_only_and_unknown_datarefs_cannot_be_written() {
    let mut bench = Bench::new();
    for path in ["sim/time/paused", "sim/flightmodel/position/latitude", "no/such/thing", "sim/time/paused[3]"] {
        bench.set(path, 1.0);
    }
    assert_eq!(
        (bench.read("sim/time/paused"), bench.read("sim/flightmodel/position/latitude")),
        (Some(0.0), Some(28.25))
    );
}

#[test]
fn only_the_users_own_aircraft_is_placed_and_only_at_coordinates() {
    let mut bench = Bench::new();
    let placement = Placement {
        aircraft: 0,
        latitude_deg: 47.0,
        longitude_deg: 8.0,
        elevation_m: 400.0,
        heading_deg: 90.0,
        speed_m_s: 0.0,
    };
    let mut datagram = Vec::new();
    placement.encode(&mut datagram);
    assert_eq!(bench.server.handle(&datagram, client(1)), Some(Order::Place(placement)));
    bench.send(client(1), |out| Placement { aircraft: 1, ..placement }.encode(out));
    datagram[5] = 11;
    assert_eq!(bench.server.handle(&datagram, client(1)), None);
    assert_eq!(bench.server.malformed, 1);
}

#[test]
fn wrong_sizes_are_counted_and_unknown_messages_are_ignored() {
    let mut bench = Bench::new();
    let wrong = [
        &b"RREF\0short"[..],
        b"DREF\0short",
        b"RPOS\0",
        b"RPOS\0abc\0",
        b"PREL\0",
        b"RREF",
        b"",
        b"RP",
        b"CMND\0",
        b"DATA\0short",
        b"DSEL\0a",
        b"ISE4\0",
        b"RADR\0x",
        b"VEHX\0",
        b"VEHS\0",
        b"ACFN\0",
    ];
    for (nth, datagram) in wrong.into_iter().enumerate() {
        bench.send(client(1), |out| out.extend_from_slice(datagram));
        assert_eq!(bench.server.malformed, nth as u64 + 1, "{datagram:?}");
    }
    for datagram in [&b"CMND\0sim/no/such/command"[..], b"QUIT\0", b"hello"] {
        bench.send(client(1), |out| out.extend_from_slice(datagram));
    }
    assert_eq!(bench.server.malformed, wrong.len() as u64);
}

#[test]
fn aircraft_are_moved_and_loaded() {
    let mut bench = Bench::new();
    let moved = |aircraft: u8| Move {
        tag: VEHX,
        aircraft,
        latitude_deg: 28.0,
        longitude_deg: -82.0,
        elevation_m: 30.0,
        heading_deg: 90.0,
        pitch_deg: 0.0,
        roll_deg: 0.0,
    };
    for aircraft in [3, 19] {
        bench.send(client(1), |out| moved(aircraft).encode(out));
    }
    // The caller holds the user's own until a client gives it back.
    let mut datagram = Vec::new();
    moved(0).encode(&mut datagram);
    assert_eq!(
        (bench.server.handle(&datagram, client(1)), bench.server.holds_own()),
        (Some(Order::Move(moved(0))), true)
    );
    bench.set("sim/operation/override/override_planepath[0]", 0.0);
    assert!(!bench.server.holds_own());
    let numbers: Vec<u8> = (0..=20).filter(|number| bench.server.other(*number).is_some()).collect();
    assert_eq!(numbers, [3, 19]);
    assert_eq!(bench.server.other(3), Some(&moved(3)));
    bench.send(client(1), |out| Load { aircraft: 3, path: "Aircraft/heli.acf", livery: 0 }.encode(out).unwrap());
    assert_eq!(bench.server.loaded, BTreeMap::from([(3, "Aircraft/heli.acf".to_owned())]));
    assert_eq!(bench.server.malformed, 0);
}

#[test]
fn the_beacon_comes_once_a_second() {
    let mut bench = Bench::new();
    let mut received = Vec::new();
    for frame in 0..150 {
        if let Some(datagram) = bench.server.beacon(49010, "lab") {
            received.push(frame);
            let beacon = Beacon::decode(datagram).unwrap();
            assert!(beacon.is_master());
            assert_eq!((beacon.minor, beacon.port, beacon.version, beacon.name.as_str()), (2, 49010, 124_000, "lab"));
            assert_eq!(datagram.len(), 21 + 3 + 1 + 2);
        }
        bench.frame();
    }
    assert_eq!(received, [0, 50, 100]);
}

#[test]
fn tables_are_bounded_and_only_long_silent_clients_are_replaced() {
    let mut bench = Bench::new();
    let of_another_host = |port| SocketAddr::from(([127, 0, 0, 2], port));
    for port in 1..=MAX_CLIENTS as u16 {
        bench.subscribe_position(client(port), 50);
    }
    bench.frame();
    assert_eq!(bench.sent.len(), MAX_CLIENTS_OF_ONE_HOST, "one computer has not all places");
    for port in 1..=MAX_CLIENTS as u16 {
        bench.subscribe_position(of_another_host(port), 50);
    }
    bench.sent.clear();
    bench.frame();
    assert_eq!(bench.sent.len(), MAX_CLIENTS);

    bench.frames(13 * RATE_HZ);
    for port in 2..=MAX_CLIENTS_OF_ONE_HOST as u16 {
        bench.subscribe_position(client(port), 50);
    }
    bench.sent.clear();
    bench.subscribe_position(client(5000), 50);
    bench.subscribe_position(client(5001), 50);
    bench.frame();
    assert_eq!((bench.positions(client(1)), bench.positions(client(5000)), bench.positions(client(5001))), (0, 1, 0));

    let mut bench = Bench::new();
    for index in 0..=MAX_SUBSCRIPTIONS as i32 {
        bench.subscribe_value(client(1), 50, index, RUNNING);
    }
    bench.frame();
    assert_eq!(bench.values(client(1)).len(), MAX_SUBSCRIPTIONS);
}

#[test]
fn a_subscriber_that_has_gone_is_removed() {
    let mut bench = Bench::new();
    bench.subscribe_position(client(1), 50);
    bench.subscribe_position(client(2), 50);
    bench.server.forget(client(1));
    bench.frame();
    assert_eq!((bench.positions(client(1)), bench.positions(client(2))), (0, 1));
}

#[test]
fn a_long_silent_subscriber_still_gets_positions_but_does_not_keep_the_server_in_use() {
    let mut bench = Bench::new();
    bench.subscribe_position(client(1), 50);
    bench.frames(11 * RATE_HZ);
    assert!(bench.server.is_used());
    bench.frames(2 * RATE_HZ);
    assert!(!bench.server.is_used());
    assert_eq!(bench.positions(client(1)), 13 * 50);
    bench.set(ROLL, 0.0);
    assert!(bench.server.is_used(), "any datagram from a subscriber suffices");
}

proptest! {
    #[test]
    fn malformed_datagrams_are_counted_one_by_one_and_the_control_stays_within_its_travel(
        tag in prop::sample::select(vec![&b"RPOS\0"[..], b"RREF\0", b"DREF\0", b"PREL\0", b"BECN\0", b""]),
        bodies in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..520), 1..20),
        path in prop::sample::select(vec![JOYSTICK, ROLL, PITCH, COLLECTIVE, COLLECTIVE_ALL]),
        value in any::<f32>(),
    ) {
        let mut bench = Bench::new();
        let mut write = Vec::new();
        Write { value, path }.encode(&mut write).unwrap();
        let mut malformed = 0;
        for datagram in bodies.iter().map(|body| [tag, body].concat()).chain([write]) {
            let placed = bench.server.handle(&datagram, client(1));
            let error = match datagram.first_chunk::<4>() {
                Some(&rpos::TAG) => wire::decode_rate(&datagram, &rpos::TAG).err(),
                Some(&rref::TAG) => rref::DatarefRequest::decode(&datagram).err(),
                Some(&dref::TAG) => Write::decode(&datagram).err(),
                Some(&prel::TAG) => Placement::decode(&datagram).err(),
                Some(_) => None,
                None => Some(WireError::WrongSize),
            };
            malformed += u64::from(error.is_some());
            prop_assert_eq!(bench.server.malformed, malformed);
            let placement = Placement::decode(&datagram).ok().filter(|placement| placement.aircraft == 0);
            prop_assert_eq!(placed, placement.map(Order::Place));
            if let Some(controls) = bench.frame() {
                prop_assert!(controls.is_within_limits());
            }
        }
        bench.set(JOYSTICK, 1.0);
        bench.set(COLLECTIVE, 0.5);
        prop_assert!(bench.frame().is_some_and(|controls| controls.is_within_limits()));
    }
}
