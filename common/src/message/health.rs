//! How well an agent does, once a second.

use serde::{Deserialize, Serialize};

use super::{Header, Message, message};
use crate::id::VehicleId;
use crate::state::{Activity, Standing};
use crate::topic::{Author, Topic};

/// How well an agent does: what tells an algorithm's fault from the PC's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Health {
    /// Who and when.
    pub header: Header,
    /// Since this life began, s.
    pub uptime_s: f64,
    /// What it is doing.
    pub activity: Activity,
    /// Whether the built-in model or an X-Plane is flown.
    pub plant: String,
    /// Version of the agent.
    pub version: String,
    /// Simulator frames a second, over the last second.
    pub frame_rate_hz: f64,
    /// 99th percentile of the distance between frames beyond their period over the last second, ms.
    pub jitter_ms: f64,
    /// Median time from a frame's arrival to its last control, over the last second, µs.
    pub step_p50_us: f64,
    /// 99th percentile of the same, µs.
    pub step_p99_us: f64,
    /// Steps that ended after the next frame was due, since the start.
    pub frame_overruns: u64,
    /// What was dropped, since the start.
    pub drops: Drops,
    /// State messages said, since the start.
    pub state_messages: u64,
    /// Their payload, bytes.
    pub state_bytes: u64,
    /// How each peer's word stands.
    pub peers: Vec<PeerHealth>,
}

/// What was dropped instead of believed, by reason, since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Drops {
    /// Datagrams of the simulator that were malformed or impossible.
    pub plant_malformed: u64,
    /// Peers' messages that did not decode.
    pub undecodable: u64,
    /// Peers' messages of another version.
    pub other_version: u64,
    /// Messages whose sender is not the one their key names, or who is not of this swarm.
    pub forged: u64,
    /// Messages older than one already heard: late, replayed or of an earlier life.
    pub old: u64,
    /// Own measurements that were not finite or not possible.
    pub measurement: u64,
}

impl Drops {
    /// All of them.
    pub fn total(&self) -> u64 {
        self.plant_malformed + self.undecodable + self.other_version + self.forged + self.old + self.measurement
    }
}

/// How one peer's word stands.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PeerHealth {
    /// The peer.
    pub id: VehicleId,
    /// Fresh, stale or lost.
    pub standing: Standing,
    /// Age of its last word by the receiver's clock, s.
    pub age_s: f64,
}

message!(Health, 16 * 1024, |said| Author::Vehicle(said.header.sender), |said| {
    let numbers = [said.uptime_s, said.frame_rate_hz, said.jitter_ms, said.step_p50_us, said.step_p99_us];
    numbers.iter().all(|number| number.is_finite())
        && said.plant.len() <= 64
        && said.version.len() <= 64
        && said.peers.iter().all(|peer| peer.age_s.is_finite())
});
