use skein_cluster::capacity::MessageTime;

use super::*;

#[test]
fn the_measurements_are_plausible() {
    let measured = measure(Effort { messages: 20, sending_s: 0.2, batches: 5, flight_s: 20.0 }).unwrap();
    for message in [measured.state, measured.heartbeat] {
        assert!(message.segment_bytes > message.encoded_bytes as f64, "{message:?}");
    }
    assert!(!measured.machine.is_empty() && measured.when.ends_with('Z'));
    assert_eq!(measured.heartbeat_hz, 5.0);
    for rate in &measured.state_rates {
        assert!(
            (1.0..=50.0).contains(&rate.states_hz),
            "{rate:?}: at least every 0.2 s in flight, at most every frame"
        );
    }
    if cfg!(unix) {
        assert!(measured.datagram_us.unwrap().iter().all(|&us| us > 0.0 && us < 10_000.0), "{measured:?}");
        let step = measured.step.unwrap();
        assert!(step.alone_us + step.per_peer_us > 0.0 && step.alone_us < 10_000.0, "{step:?}");
    }
    let capacity = Capacity::of(measured, flown::tests::flown());
    assert_eq!(capacity.schemes[0].port_1_gbit, 7_739, "the paper's datagrams, each with its frame");
    assert!(f64::from(capacity.schemes[0].port_1_gbit) < capacity.paper_vehicles);
}

#[test]
fn the_tables_contain_the_measurements_and_the_capacities() {
    let capacity = Capacity::of(fleet::tests::measured(), flown::tests::flown());
    let text = capacity.to_text();
    for part in [
        "(40 + 7 x 288) bit x 50 Hz) = 9727 vehicles",
        "datagram of 257 bytes takes 323 bytes of wire",
        "Measured on a test, at 20260101T000000Z",
        "a state: 70 bytes, 100 as Zenoh sends it over TCP, 190 of wire",
        "a state delivered: 40.0 us",
        "flock, 4 vehicles: 10.0 states a second",
        "By cells, as flown: two teams",
        "80 [130]     5.6 [9.1]      –  0.003",
        "mean of the 2 vehicles [most of one]",
    ] {
        assert!(text.contains(part), "{part} is missing in\n{text}");
    }
    let json: serde_json::Value = serde_json::from_str(&skein_lab::terminal::json(&capacity)).unwrap();
    assert_eq!(json["paper_vehicles"], 9727.0);
    assert_eq!(json["schemes"][0]["port_1_gbit"], 7739);
    assert_eq!(json["schemes"][0]["loads"][0][0], 4);
}

#[test]
fn without_processor_times_the_capacity_in_bytes_is_still_given() {
    let measured = fleet::tests::measured();
    let measured =
        Measured { time: MessageTime { message_us: None, deliveries: 0 }, datagram_us: None, step: None, ..measured };
    let capacity = Capacity::of(measured, flown::tests::flown());
    assert!(capacity.schemes.iter().all(|fits| fits.one_core.is_none() && fits.port_1_gbit > 0));
    assert!(capacity.to_text().contains('–'));
}
