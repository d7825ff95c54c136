//! Opens a Zenoh session of a swarm, with the settings that suit a control loop.

use std::time::Duration;

use serde_json::{Value, json};
use skein_common::id::SwarmName;
use zenoh::{Config, Session, Wait};

use super::error::LinkError;

/// Time for a dialled peer to reply. The tunnel gives up earlier on a host that cannot be reached.
const OPEN_TIMEOUT: Duration = Duration::from_secs(10);
/// Zenoh's lease: a session that has sent nothing for this long ends. The lease is long so that agents on a slow PC
/// stay linked; a lost agent is detected earlier, by the age of its messages.
const LEASE: Duration = Duration::from_secs(4);

/// Longest time that a thread waits for a peer to accept a message that must not be dropped; then that link is closed.
const BLOCK_TIMEOUT: Duration = Duration::from_millis(20);

/// Largest message accepted from the network, bytes.
const MAX_MESSAGE_BYTES: usize = 1 << 20;

/// Opens a Zenoh session of this swarm: a peer without discovery. The settings in `more` override ours.
pub(crate) fn open_zenoh(
    swarm: &SwarmName,
    listen: &[String],
    dial: &[String],
    more: &[(&str, Value)],
) -> Result<Session, LinkError> {
    let configuration = configuration(swarm, listen, dial, more).map_err(LinkError::Configuration)?;
    zenoh::open(configuration).wait().map_err(|source| LinkError::Open(listen.to_vec(), source))
}

fn configuration(
    swarm: &SwarmName,
    listen: &[String],
    dial: &[String],
    more: &[(&str, Value)],
) -> zenoh::Result<Config> {
    let mut configuration = Config::default();
    let values = [
        ("mode", json!("peer")),
        ("namespace", json!(swarm.as_str())),
        ("listen/endpoints", json!(listen)),
        ("connect/endpoints", json!(dial)),
        // A short retry period: a peer is back within a second after the network is restored.
        ("connect/retry", json!({ "period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5 })),
        // A peer that replies slowly is not dialled a second time.
        ("transport/unicast/open_timeout", json!(OPEN_TIMEOUT.as_millis())),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        ("adminspace/enabled", json!(false)),
        ("transport/link/tx/lease", json!(LEASE.as_millis())),
        ("transport/link/tx/keep_alive", json!(4)),
        // Sending never waits: a message whose queue is full is dropped at once, because the next one is newer.
        ("transport/link/tx/queue/congestion_control/drop/wait_before_drop", json!(0)),
        // Zenoh must not drop its own declarations. A peer that does not accept them in time loses its link.
        ("transport/link/tx/queue/congestion_control/block/wait_before_close", json!(BLOCK_TIMEOUT.as_micros())),
        // A reply gets the quality of service of its query. The querying peer must not choose it: a reply is dropped
        // rather than waited for, and has a queue of its own.
        (
            "qos/network",
            json!([{
                "messages": ["query"],
                "flows": ["ingress"],
                "overwrite": { "congestion_control": "drop", "priority": "interactive_low", "express": true },
            }]),
        ),
        // Limits the memory for fragmented messages before they are decoded: many times the largest message.
        ("transport/link/rx/max_message_size", json!(MAX_MESSAGE_BYTES)),
    ];
    for (key, value) in values.iter().chain(more) {
        configuration.insert_json5(key, &value.to_string())?;
    }
    Ok(configuration)
}
