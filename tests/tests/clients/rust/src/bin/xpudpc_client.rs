//! Talks to the stand-in by UDP through xpudpc, which others wrote, at the address of the beacon. Fails with a panic.

use std::time::{Duration, Instant};

use xpudpc::{Beacon, Response, XPlaneClient};

const RUNNING: i32 = 0;
const JOYSTICK: i32 = 1;
const PAUSED: i32 = 2;
const DATAREFS: [(i32, &str); 3] = [
    (RUNNING, "sim/time/total_running_time_sec"),
    (JOYSTICK, "sim/operation/override/override_joystick"),
    (PAUSED, "sim/time/paused"),
];

/// Receives until a value of this subscription is the wanted one.
async fn until(client: &XPlaneClient, index: i32, wanted: f32) {
    let end = Instant::now() + Duration::from_secs(5);
    while Instant::now() < end {
        if let Response::DatarefValues(values) = client.recv_timeout(Duration::from_secs(1)).await.unwrap()
            && values.iter().any(|value| value.index == index && value.value == wanted)
        {
            return;
        }
    }
    panic!("subscription {index}: no value {wanted}");
}

#[tokio::main(flavor = "current_thread")]
async fn main() {
    let arguments: Vec<_> = std::env::args().collect();
    let (port, latitude_deg): (u16, f64) = (arguments[1].parse().unwrap(), arguments[2].parse().unwrap());
    let beacon = Beacon::find(Some(Duration::from_secs(5))).await.unwrap();
    assert_eq!((beacon.port, beacon.beacon_major_version, beacon.beacon_minor_version), (port, 1, 2));
    assert_eq!((beacon.application_host_id, beacon.version_number, beacon.role), (1, 124000, 1));
    println!("beacon: X-Plane {} at {}:{}", beacon.version_number, beacon.ip, beacon.port);

    let client = XPlaneClient::connect((beacon.ip, beacon.port)).await.unwrap();
    client.request_position(20).await.unwrap();
    let begin = Instant::now();
    let mut positions = 0;
    while begin.elapsed() < Duration::from_secs(2) {
        match client.recv_timeout(Duration::from_secs(1)).await.unwrap() {
            Response::Position(at) => assert!((at.latitude - latitude_deg).abs() < 1e-9, "double precision: {at:?}"),
            other => panic!("{other:?}"),
        }
        positions += 1;
    }
    assert!((35..=42).contains(&positions), "20 a second: {positions} in 2 s");
    client.stop_position().await.unwrap();

    for (index, path) in DATAREFS {
        client.subscribe_dataref(20, index, path).await.unwrap();
    }
    for wanted in [1.0, 0.0] {
        client.set_dataref(DATAREFS[JOYSTICK as usize].1, wanted).await.unwrap();
        until(&client, JOYSTICK, wanted).await;
    }
    for (command, wanted) in [("sim/operation/pause_on", 1.0), ("sim/operation/pause_off", 0.0)] {
        client.send_command(command).await.unwrap();
        until(&client, PAUSED, wanted).await;
    }
    for (index, _) in DATAREFS {
        client.unsubscribe_dataref(index).await.unwrap();
    }
    // What was sent before the end of the subscriptions may still arrive.
    let end = Instant::now() + Duration::from_millis(500);
    while Instant::now() < end {
        let _ = client.recv_timeout(Duration::from_millis(100)).await;
    }
    assert!(client.recv_timeout(Duration::from_millis(500)).await.is_err(), "silence after the subscriptions");
    println!("UDP: {positions} positions in 2 s, datarefs read and written, commands executed, silence after the subscriptions");
}
