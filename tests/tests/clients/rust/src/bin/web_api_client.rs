//! Talks to the stand-in's Web API through xplane-web-api, which others wrote: REST, whose client its authors generated
//! from a model of the interface, and WebSocket. Fails with a panic.

use std::time::Duration;

use serde_json::{Value, json};
use tokio::time::{Instant, timeout};
use xplane_web_api::rest::Client;
use xplane_web_api::rest::types::{ActivateCommandRequest, DatarefValueWriteRequest};
use xplane_web_api::websocket::{
    All, AllOrList, CommandSetActive, DatarefSelection, DatarefValueSet, ServerMessage, WebSocketApiClient,
};

const LATITUDE: &str = "sim/flightmodel/position/latitude";
const RUNNING: &str = "sim/time/total_running_time_sec";
const JOYSTICK: &str = "sim/operation/override/override_joystick";
const PAUSED: &str = "sim/time/paused";

async fn dataref(client: &Client, name: &str) -> i64 {
    let list = client.list_datarefs(None, Some(&vec![name.to_owned()]), None, None).await.unwrap();
    assert_eq!(list.data.iter().map(|own| own.name.as_str()).collect::<Vec<_>>(), [name]);
    list.data[0].id
}

async fn command(client: &Client, name: &str) -> i64 {
    let list = client.list_commands(None, Some(&vec![name.to_owned()]), None, None).await.unwrap();
    assert_eq!(list.data.iter().map(|own| own.name.as_str()).collect::<Vec<_>>(), [name]);
    list.data[0].id
}

async fn value(client: &Client, id: i64) -> Value {
    let response = client.get_dataref_value(id, None).await.unwrap();
    serde_json::to_value(&response.data).unwrap()
}

/// Waits until a dataref has a value.
async fn until(client: &Client, id: i64, wanted: f64) {
    let end = Instant::now() + Duration::from_secs(5);
    while value(client, id).await.as_f64() != Some(wanted) {
        assert!(Instant::now() < end, "dataref {id}: not {wanted}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::main(flavor = "current_thread")]
async fn main() {
    let arguments: Vec<_> = std::env::args().collect();
    let (port, latitude_deg): (u16, f64) = (arguments[1].parse().unwrap(), arguments[2].parse().unwrap());
    let client = Client::new(&format!("http://127.0.0.1:{port}"));
    assert_eq!(client.get_capabilities().await.unwrap().api.versions, ["v1", "v2", "v3"]);
    let count = client.get_dataref_count().await.unwrap().data;
    let all = client.list_datarefs(None, None, None, None).await.unwrap();
    assert_eq!(all.data.len() as i64, count);
    let latitude = value(&client, dataref(&client, LATITUDE).await).await.as_f64().unwrap();
    assert!((latitude - latitude_deg).abs() < 1e-9, "double precision: {latitude}");
    let missing = client.list_datarefs(None, Some(&vec!["sim/none".to_owned()]), None, None).await;
    assert!(missing.is_err(), "a name that does not exist is refused: {missing:?}");

    let (joystick, paused) = (dataref(&client, JOYSTICK).await, dataref(&client, PAUSED).await);
    for wanted in [1.0, 0.0] {
        let body: DatarefValueWriteRequest = serde_json::from_value(json!({ "data": wanted })).unwrap();
        client.set_dataref_value(joystick, None, &body).await.unwrap();
        until(&client, joystick, wanted).await;
    }
    let commands = [command(&client, "sim/operation/pause_on").await, command(&client, "sim/operation/pause_off").await];
    for (id, wanted) in commands.into_iter().zip([1.0, 0.0]) {
        client.activate_command(id, &ActivateCommandRequest { duration: 0.0 }).await.unwrap();
        until(&client, paused, wanted).await;
    }
    println!("REST: {count} datarefs, a double read, a dataref written, commands executed");

    let mut socket = WebSocketApiClient::connect(&format!("ws://127.0.0.1:{port}/api/v3")).await.unwrap();
    let running = dataref(&client, RUNNING).await;
    let request = socket
        .dataref_subscribe_values(vec![DatarefSelection { id: running as u64, index: None }])
        .await
        .unwrap();
    let end = Instant::now() + Duration::from_secs(2);
    let (mut updates, mut is_accepted) = (0, false);
    while let Ok(message) = timeout(end - Instant::now(), socket.recv_message()).await {
        match message.unwrap().unwrap() {
            ServerMessage::Result { req_id, success, .. } => is_accepted = req_id == request && success,
            ServerMessage::DatarefUpdateValues { data } => {
                assert!(data[&running.to_string()].is_number());
                updates += 1;
            }
            other => panic!("{other:?}"),
        }
    }
    assert!(is_accepted && (15..=22).contains(&updates), "ten a second: {updates} in 2 s");
    socket.dataref_unsubscribe_values(AllOrList::All(All::All)).await.unwrap();
    socket.dataref_set_values(vec![DatarefValueSet { id: joystick as u64, value: json!(1), index: None }]).await.unwrap();
    until(&client, joystick, 1.0).await;
    let pause = CommandSetActive { id: commands[0] as u64, is_active: true, duration: Some(0.1) };
    socket.command_set_is_active(vec![pause]).await.unwrap();
    until(&client, paused, 1.0).await;
    client.activate_command(commands[1], &ActivateCommandRequest { duration: 0.0 }).await.unwrap();
    until(&client, paused, 0.0).await;
    // What was sent before the end of the subscription is read first.
    let mut results = 0;
    while let Ok(message) = timeout(Duration::from_millis(500), socket.recv_message()).await {
        match message.unwrap().unwrap() {
            ServerMessage::Result { success, .. } => {
                assert!(success);
                results += 1;
            }
            ServerMessage::DatarefUpdateValues { .. } => assert_eq!(results, 0, "an update after the end"),
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(results, 3);
    socket.close().await.unwrap();
    println!("WebSocket: {updates} updates in 2 s, then silence; a dataref written, a command activated");
}
