use skein_cluster::capacity::{MessageTime, StateRate, StepTime};

use super::*;

/// Measurements in round numbers: a state of 100 bytes takes 190 on the wire, a heartbeat of 60 takes 150, an
/// acknowledgement 90.
pub(in super::super) fn measured() -> Measured {
    let rate = |flight, states_hz| StateRate { flight, vehicles: 4, states_hz, nearest_pair_m: Some(100.0) };
    Measured {
        machine: "a test".to_owned(),
        when: "20260101T000000Z".to_owned(),
        state: MessageSize { encoded_bytes: 70, segment_bytes: 100.0 },
        heartbeat: MessageSize { encoded_bytes: 30, segment_bytes: 60.0 },
        heartbeat_hz: 5.0,
        time: MessageTime { message_us: Some(40.0), deliveries: 1 },
        datagram_us: Some([6.0, 2.0]),
        state_rates: vec![rate("hover", 5.0), rate("flock", 10.0)],
        step: Some(StepTime { alone_us: 2.0, per_peer_us: 0.5 }),
    }
}

fn load(scheme: &Scheme, vehicles: u32) -> Load {
    scheme.load(&measured(), vehicles)
}

fn sending(traffic: Traffic, vehicles: u32) -> Load {
    load(&Scheme { name: "", traffic }, vehicles)
}

fn near(one: f64, other: f64) {
    assert!((one / other - 1.0).abs() < 1e-12, "{one}, not {other}");
}

#[test]
fn a_central_controller_receives_and_answers_every_vehicle_each_frame() {
    let schemes = Scheme::all(&measured());
    let rows = load(&schemes[0], 10);
    near(rows.port_bit_s[0], 10.0 * 50.0 * 323.0 * 8.0);
    // 77 bytes of rows are 143 on the wire.
    near(rows.port_bit_s[1], 10.0 * 50.0 * 143.0 * 8.0);
    near(rows.network_bit_s, 10.0 * 50.0 * 466.0 * 8.0);
    near(rows.cores.unwrap(), 10.0 * 50.0 * (2.0 + 6.0 + 2.0 + 0.5 * 9.0) * 1e-6);
    let datarefs = load(&schemes[1], 10);
    near(datarefs.port_bit_s[1], 10.0 * 50.0 * 4.0 * 575.0 * 8.0);
    let messages = sending(Traffic::CentralZenoh, 10);
    near(messages.port_bit_s[0], 10.0 * 50.0 * 190.0 * 8.0);
    near(messages.cores.unwrap(), 10.0 * 50.0 * (40.0 + 2.0 + 0.5 * 9.0) * 1e-6);
}

#[test]
fn in_a_mesh_each_vehicle_receives_all_others_and_the_network_carries_all_pairs() {
    let every_frame = Traffic::Mesh(50.0);
    let ten = sending(every_frame, 10);
    // Nine others, each with fifty states and five heartbeats that acknowledge each other.
    near(ten.port_bit_s[0], 9.0 * (50.0 * 190.0 + 5.0 * 150.0) * 8.0);
    near(ten.network_bit_s, 10.0 * ten.port_bit_s[0]);
    near(ten.cores.unwrap(), (9.0 * 55.0 * 40.0 + 50.0 * (2.0 + 0.5 * 9.0)) * 1e-6);
    let on_need = sending(Traffic::Mesh(5.0), 10);
    // So rare that every message is acknowledged by a frame of its own.
    near(on_need.port_bit_s[0], 9.0 * 5.0 * (190.0 + 90.0 + 150.0 + 90.0) * 8.0);
    near(sending(every_frame, 1).port_bit_s[0] + 1.0, 1.0);
}

#[test]
fn the_largest_fleet_is_the_last_that_fits() {
    let measured = measured();
    for scheme in Scheme::all(&measured) {
        for limit in [1e6, 1e8, 1e9] {
            let fits = |load: &Load| load.network_bit_s <= limit;
            let most = scheme.most(&measured, fits);
            assert!(most == 0 || fits(&scheme.load(&measured, most)), "{scheme:?} {limit}");
            assert!(!fits(&scheme.load(&measured, most + 1)), "{scheme:?} {limit}");
        }
    }
    // 1 Gbit/s of 323-byte frames at 50 Hz.
    let rows = &Scheme::all(&measured)[0];
    assert_eq!(rows.most(&measured, |load| load.port_bit_s[0] <= 1e9), 7_739);
}
