//! Faults on order.

use super::*;
use crate::plant::xplane::wire::rref::DatarefRequest;

impl Bench {
    /// Runs frames and returns the positions that the client received.
    fn positions(&mut self, frames: u32) -> Vec<Position> {
        self.send(|out| encode_rate(&rpos::TAG, 200, out));
        (0..frames).for_each(|_| {
            self.standin.frame();
        });
        self.received().iter().filter_map(|datagram| Position::decode(datagram).ok()).collect()
    }

    /// All datagrams that wait at the client.
    fn received(&self) -> Vec<Vec<u8>> {
        self.client.set_nonblocking(true).unwrap();
        let mut buffer = [0; MAX_DATAGRAM];
        let mut all = Vec::new();
        while let Ok(size) = self.client.recv(&mut buffer) {
            all.push(buffer[..size].to_vec());
        }
        self.client.set_nonblocking(false).unwrap();
        all
    }

    /// Value of a dataref in the next frame.
    fn read(&mut self, path: &str) -> Option<f32> {
        self.send(|out| DatarefRequest { frequency_hz: 200, index: 7, path }.encode(out).unwrap());
        self.standin.frame();
        self.send(|out| DatarefRequest { frequency_hz: 0, index: 7, path }.encode(out).unwrap());
        self.standin.frame();
        let received = self.received();
        let values = received.iter().filter_map(|datagram| rref::decode_values(datagram).ok()).flatten();
        values.filter(|&(index, _)| index == 7).map(|(_, value)| value).last()
    }

    fn climb(&mut self, frames: u32) -> Position {
        self.set("sim/operation/override/override_joystick", 1.0);
        self.set("sim/joystick/yoke_roll_ratio", 0.0185);
        self.set("sim/cockpit2/engine/actuators/prop_ratio[0]", 0.7);
        *self.positions(frames).last().unwrap()
    }
}

#[test]
fn a_frozen_simulator_sends_nothing_and_continues_where_it_was() {
    let mut bench = Bench::new(&[]);
    let before = bench.climb(50);
    bench.set("skein/standin/freeze_s", 0.19);
    bench.standin.frame();
    bench.received();
    assert_eq!(bench.positions(10), []);
    let after = *bench.positions(1).last().unwrap();
    assert!((0.0..0.3).contains(&(after.height_m - before.height_m)), "{after:?}");
}

#[test]
fn a_restarted_simulator_has_forgotten_its_clients_and_stands_at_its_start() {
    let mut bench = Bench::new(&[]);
    assert!(bench.climb(50).height_m > 0.5);
    bench.set("skein/standin/restart_s", 0.5);
    assert_eq!(bench.positions(25), [], "what is sent to it meanwhile is lost");
    bench.standin.frame();
    assert_eq!(bench.received(), Vec::<Vec<u8>>::new(), "no one has subscribed");
    let standing = *bench.positions(1).last().unwrap();
    assert!((standing.height_m - 0.242).abs() < 0.01, "{standing:?}");
    assert_eq!(bench.read("sim/operation/override/override_joystick"), Some(0.0));
    assert!(bench.read("sim/time/total_running_time_sec").unwrap() < 0.2);
}

#[test]
fn a_replay_shows_the_past_and_the_flight_continues_afterwards() {
    let mut bench = Bench::new(&[]);
    let before = bench.climb(100);
    bench.set("skein/standin/replay", 1.0);
    let shown = bench.positions(50);
    assert!(shown[0].height_m < 0.3 && shown[49].height_m < before.height_m, "{:?} {:?}", shown[0], shown[49]);
    assert_eq!(bench.read("sim/time/is_in_replay"), Some(1.0));
    bench.set("sim/time/is_in_replay", 0.0);
    assert_eq!(bench.read("sim/time/is_in_replay"), Some(1.0), "the dataref is read-only");
    bench.set("skein/standin/replay", 0.0);
    let after = bench.positions(1)[0];
    assert!((0.0..0.3).contains(&(after.height_m - before.height_m)), "{before:?} {after:?}");
}

#[test]
fn a_client_that_dies_leaves_its_overrides_and_its_last_controls() {
    let mut bench = Bench::new(&[]);
    let last = bench.climb(50);
    // Five seconds without a datagram from it.
    let later = *bench.positions(250).last().unwrap();
    assert!(later.height_m > last.height_m + 1.0, "it climbs with the controls that it has: {last:?} {later:?}");
    assert_eq!(bench.read("sim/operation/override/override_joystick"), Some(1.0));
    let pitch = bench.read("sim/cockpit2/engine/actuators/prop_ratio[0]").unwrap();
    assert!((pitch - 0.7).abs() < 1e-6, "{pitch}");
}

#[test]
fn a_crashed_aircraft_lies_still_until_a_reset() {
    let mut bench = Bench::new(&[]);
    bench.climb(50);
    bench.set("skein/standin/crash", 1.0);
    let crashed = bench.positions(50);
    assert_eq!(crashed[0], crashed[49]);
    assert_eq!(bench.read("sim/flightmodel2/misc/has_crashed"), Some(1.0));
    bench.send(|out| Command { path: "sim/operation/reload_aircraft" }.encode(out).unwrap());
    assert_eq!(bench.read("sim/flightmodel2/misc/has_crashed"), Some(0.0));
    assert!(bench.climb(50).height_m > 0.5);
}

#[test]
fn a_slow_simulator_has_fewer_simulated_seconds_and_says_so() {
    let mut bench = Bench::new(&[]);
    bench.set("skein/standin/speed", 0.5);
    bench.standin.frame();
    assert_eq!(bench.read("sim/time/sim_speed_actual"), Some(0.5));
    let before_s = bench.standin.simulator.truth().time.seconds();
    bench.positions(100);
    assert!((bench.standin.simulator.truth().time.seconds() - before_s - 1.0).abs() < 1e-9);
    let slow = Bench::new(&["--rate", "15"]).read("sim/time/sim_speed_actual").unwrap();
    assert!((slow - 15.0 / 19.0).abs() < 1e-6, "{slow}");
}

#[test]
fn a_share_of_the_datagrams_is_lost() {
    let mut bench = Bench::new(&["--drop", "0.5"]);
    for _ in 0..10 {
        bench.send(|out| encode_rate(&rpos::TAG, 200, out));
    }
    let arrived = bench.positions(200).len();
    assert!((70..130).contains(&arrived), "{arrived} of 200");
}

#[test]
fn the_local_origin_moves_to_the_aircraft_and_the_position_does_not_jump() {
    let mut bench = Bench::new(&[]);
    let place = Placement {
        aircraft: 0,
        latitude_deg: 28.01,
        longitude_deg: -82.0,
        elevation_m: 0.0,
        heading_deg: 0.0,
        speed_m_s: 0.0,
    };
    bench.standin.frame();
    bench.send(|out| place.encode(out));
    let far_m = bench.read("sim/flightmodel/position/local_z").unwrap();
    assert!((far_m + 1108.0).abs() < 2.0, "{far_m}");
    let before = bench.positions(1)[0];
    bench.set("skein/standin/move_origin", 1.0);
    // Only the attitude refers to the local frame: its plane was tilted by 1.1 km / 6370 km, 0.01 degrees.
    let after = bench.positions(1)[0];
    assert!((before.pitch_deg + 0.01).abs() < 1e-4 && after.pitch_deg.abs() < 1e-6, "{before:?} {after:?}");
    assert_eq!(
        Position { pitch_deg: 0.0, roll_deg: 0.0, ..after },
        Position { pitch_deg: 0.0, roll_deg: 0.0, ..before }
    );
    assert!(bench.read("sim/flightmodel/position/local_z").unwrap().abs() < 1e-6);
    assert_eq!(bench.read("sim/flightmodel/position/lat_ref"), Some(28.01));
}

#[test]
fn the_loaded_aircraft_is_read_byte_by_byte_and_the_wind_in_the_local_frame() {
    let mut bench = Bench::new(&["--acf", "Aircraft/a.acf", "--wind-m-s", "5", "--wind-from-deg", "270"]);
    let bytes: Vec<u8> =
        (0..16).map(|nth| bench.read(&format!("sim/aircraft/view/acf_relative_path[{nth}]")).unwrap() as u8).collect();
    assert_eq!(bytes, b"Aircraft/a.acf\0\0");
    let wind = ["x", "y", "z"].map(|axis| bench.read(&format!("sim/weather/aircraft/wind_now_{axis}_msc")).unwrap());
    assert!((wind[0] - 5.0).abs() < 1e-5 && wind[1].abs() < 1e-5 && wind[2].abs() < 1e-5, "{wind:?}");
}

#[test]
fn between_the_ticks_of_the_model_the_helicopter_moves() {
    let mut bench = Bench::new(&["--rate", "100"]);
    bench.climb(200);
    let heights: Vec<f32> = bench.positions(10).iter().map(|position| position.height_m).collect();
    for pair in heights.windows(2) {
        assert!(pair[1] > pair[0] + 0.002, "{heights:?}");
    }
}
