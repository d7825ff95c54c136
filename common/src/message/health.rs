//! Health report of an agent, sent once a second.

use serde::{Deserialize, Serialize};

use super::{ClockOffset, Failure, Header, Message, ShortText, SimulatorFault, message};
use crate::id::VehicleId;
use crate::state::{Activity, PeerStatus};
use crate::topic::{Author, Topic};

/// Health report of an agent. It shows whether a problem comes from the flight software or from the computer and
/// network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Health {
    /// Sender, number and time of the message.
    pub header: Header,
    /// Time since this incarnation of the agent started, s.
    pub uptime_s: f64,
    /// The vehicle's activity.
    pub activity: Activity,
    /// Time for which the vehicle has been in formation without interruption, s: at its altitude, and where the law wants it.
    /// `None` while it is not in formation.
    pub in_place_s: Option<f64>,
    /// The plant: the built-in flight model or an X-Plane.
    pub plant: String,
    /// The release that was installed, or else the agent's version.
    pub version: String,
    /// Failures that the agent detected of its own vehicle.
    pub failures: Vec<Failure>,
    /// Faults of the simulator's set-up, at most [`SimulatorFault::MAX_COUNT`].
    pub simulator_faults: Vec<SimulatorFault>,
    /// Rate of simulator frames over the last second, Hz.
    pub frame_rate_hz: f64,
    /// Largest excess of the time between two frames over their period, over the last second, ms.
    pub jitter_ms: f64,
    /// Median time from a frame's arrival to its last control output, over the last second, µs.
    pub step_p50_us: f64,
    /// 99th percentile of the time from a frame's arrival to its last control output, over the last second, µs.
    pub step_p99_us: f64,
    /// Number of steps that ended after the next frame was due, since the start.
    pub frame_overruns: u64,
    /// Data that the agent dropped, by reason, since the start.
    pub drops: Drops,
    /// Own messages that the agent did not send because the network was too slow, since the start: events, traces and health
    /// reports. A waiting state, heartbeat or summary is replaced by a newer one and does not count.
    pub unsent: u64,
    /// Messages and links that the agent refused, the latest kinds first, at most [`Refused::MAX_COUNT`].
    pub refused: Vec<Refused>,
    /// Number of state messages sent, since the start.
    pub state_messages: u64,
    /// Payload of the state messages sent, bytes.
    pub state_bytes: u64,
    /// Number of links with other agents, and on plain links with observers.
    pub links: u32,
    /// Messages of all kinds published, since the start. A message that goes out on several links counts once.
    pub sent: Traffic,
    /// Messages of all kinds received, accepted or not, since the start.
    pub received: Traffic,
    /// Status of each peer.
    pub peers: Vec<PeerHealth>,
}

impl Health {
    /// Largest length of [`Self::version`], bytes.
    pub const MAX_VERSION: usize = 64;
}

/// Messages in one direction, without the framing of the network.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Traffic {
    /// Number of messages.
    pub messages: u64,
    /// Their bytes, signatures included.
    pub bytes: u64,
}

/// Counts of data that an agent dropped, by reason, since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Drops {
    /// Datagrams of the simulator that were malformed or had values out of range.
    pub plant_malformed: u64,
    /// Datagrams that came from another program than the simulator.
    pub plant_foreign: u64,
    /// Messages of peers that did not decode.
    pub undecodable: u64,
    /// Messages of peers that have another version.
    pub other_version: u64,
    /// Messages that the vehicle of their key did not send in this run of the swarm.
    pub forged: u64,
    /// Messages older than one already received: late, replayed or of an earlier incarnation.
    pub old: u64,
    /// Orders of an operator, or orders repeated by a peer, without a valid signature of this run.
    #[serde(rename = "unsealed")]
    pub unsigned: u64,
    /// Heartbeats of peers that fly a different plan: their agreement state is ignored.
    pub other_plan: u64,
    /// Links that were refused: one of the two sides does not accept the certificate of the other.
    pub links: u64,
    /// Own measurements that were not finite or out of range.
    pub measurement: u64,
}

impl Drops {
    /// Sum of all counts.
    pub fn total(&self) -> u64 {
        self.plant_malformed + self.plant_foreign + self.measurement + self.old + self.refused()
    }

    /// Sum of the counts that a correct peer of this swarm never causes, even over a bad network.
    pub fn refused(&self) -> u64 {
        self.undecodable + self.other_version + self.forged + self.unsigned + self.other_plan + self.links
    }
}

/// Messages or links of one kind that an agent refused, since the start.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refused {
    /// Reason of the refusal.
    pub reason: Reason,
    /// Key of the refused messages, without the cell; at most [`Self::MAX_KEY`] bytes of printable ASCII.
    pub key: String,
    /// Number of refusals.
    pub count: u64,
}

impl Refused {
    /// Largest length of [`Self::key`], bytes.
    pub const MAX_KEY: usize = 48;
    /// Largest number of kinds in a health report.
    pub const MAX_COUNT: usize = 16;

    /// Makes a key safe to show: cut to [`Self::MAX_KEY`] bytes of printable ASCII, because the sender may be hostile.
    pub fn printable(key: &str) -> String {
        let printable = |c: char| if ShortText::is_shown(c) { c } else { '?' };
        key.chars().take(Self::MAX_KEY).map(printable).collect()
    }

    fn is_plausible(&self) -> bool {
        self.key.len() <= Self::MAX_KEY && self.key.chars().all(ShortText::is_shown)
    }
}

/// Reason why an agent refused a message or a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Reason {
    /// The bytes do not decode, or a value is out of range.
    Undecodable,
    /// The message was sent by another version of Skein.
    OtherVersion,
    /// The message was sent in the name of another vehicle.
    Forged,
    /// The message was sent by a vehicle that is not in this swarm.
    UnknownVehicle,
    /// The order has no valid signature of this run.
    Unsealed,
    /// The heartbeat is of a different plan.
    OtherPlan,
    /// The message is of another run of the swarm.
    OtherRun,
    /// One of the two sides of the link does not accept the other's certificate.
    Link,
    /// The message is older than one already received: late, repeated or replayed.
    Old,
}

impl std::fmt::Display for Reason {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(match self {
            Self::Undecodable => "undecodable",
            Self::OtherVersion => "different version",
            Self::Forged => "forged",
            Self::UnknownVehicle => "not in this swarm",
            Self::Unsealed => "order without a valid signature",
            Self::OtherPlan => "different plan",
            Self::OtherRun => "different run",
            Self::Link => "link refused",
            Self::Old => "old or replayed",
        })
    }
}

/// Status of one peer as an agent sees it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PeerHealth {
    /// The peer.
    pub id: VehicleId,
    /// Fresh, stale or lost.
    pub standing: PeerStatus,
    /// Upper bound of the age of the peer's newest state by the receiver's clock, s: the time since it arrived plus
    /// [`Self::delay_s`].
    pub age_s: f64,
    /// Upper bound of the network delay of that state, s; `None` until a round trip is known.
    pub delay_s: Option<f64>,
    /// Offset of the peer's clock, once measured. It is for information only: no flight function uses it.
    pub clock: Option<ClockOffset>,
}

impl PeerHealth {
    fn is_plausible(&self) -> bool {
        self.age_s.is_finite()
            && self.delay_s.is_none_or(|delay_s| delay_s.is_finite() && delay_s >= 0.0)
            && self.clock.is_none_or(|clock| clock.is_plausible())
    }
}

message!(Health, 16 * 1024, |health| Author::Vehicle(health.header.sender), |health| {
    let numbers = [health.uptime_s, health.frame_rate_hz, health.jitter_ms, health.step_p50_us, health.step_p99_us];
    numbers.iter().chain(&health.in_place_s).all(|number| number.is_finite())
        && health.plant.len() <= 64
        && health.version.len() <= Health::MAX_VERSION
        && health.failures.len() <= Failure::KINDS
        && health.simulator_faults.len() <= SimulatorFault::MAX_COUNT
        && health.simulator_faults.iter().all(|fault| fault.is_plausible())
        && health.refused.len() <= Refused::MAX_COUNT
        && health.refused.iter().all(Refused::is_plausible)
        && health.peers.iter().all(PeerHealth::is_plausible)
});
