//! How well an agent does, once a second.

use serde::{Deserialize, Serialize};

use super::{ClockOffset, Failure, Header, Message, message};
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
    /// What the agent is: the release that was installed, or else its version.
    pub version: String,
    /// What it finds failed of its own vehicle.
    pub failures: Vec<Failure>,
    /// Simulator frames a second, over the last second.
    pub frame_rate_hz: f64,
    /// Largest distance between two frames beyond their period over the last second, ms.
    pub jitter_ms: f64,
    /// Median time from a frame's arrival to its last control, over the last second, µs.
    pub step_p50_us: f64,
    /// 99th percentile of the same, µs.
    pub step_p99_us: f64,
    /// Steps that ended after the next frame was due, since the start.
    pub frame_overruns: u64,
    /// What was dropped, since the start.
    pub drops: Drops,
    /// What of others was not believed, the latest kinds first, at most [`Refused::MAX_COUNT`].
    pub refused: Vec<Refused>,
    /// State messages said, since the start.
    pub state_messages: u64,
    /// Their payload, bytes.
    pub state_bytes: u64,
    /// How each peer's word stands.
    pub peers: Vec<PeerHealth>,
}

impl Health {
    /// Longest name of a release, bytes.
    pub const MAX_VERSION: usize = 64;
}

/// What was dropped instead of believed, by reason, since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Drops {
    /// Datagrams of the simulator that were malformed or impossible.
    pub plant_malformed: u64,
    /// Datagrams that another program sent in the simulator's place.
    pub plant_foreign: u64,
    /// Peers' messages that did not decode.
    pub undecodable: u64,
    /// Peers' messages of another version.
    pub other_version: u64,
    /// Messages that are not what the vehicle of their key has said in this run of the swarm.
    pub forged: u64,
    /// Messages older than one already heard: late, replayed or of an earlier life.
    pub old: u64,
    /// Orders, in an operator's name or repeated by a peer, without a valid seal of this run.
    pub unsealed: u64,
    /// Registers of peers that fly another plan: they count for nothing in the agreement.
    pub other_plan: u64,
    /// Links that were refused: somebody without a certificate that counts here, or for whom the own one does not.
    pub links: u64,
    /// Own measurements that were not finite or not possible.
    pub measurement: u64,
}

impl Drops {
    /// All of them.
    pub fn total(&self) -> u64 {
        self.plant_malformed + self.plant_foreign + self.measurement + self.old + self.refused()
    }

    /// What no honest peer of this swarm says, however bad the network.
    pub fn refused(&self) -> u64 {
        self.undecodable + self.other_version + self.forged + self.unsealed + self.other_plan + self.links
    }
}

/// Something of others that was not believed, since the start.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refused {
    /// Why not.
    pub reason: Reason,
    /// Under which key it came, without the cell; at most [`Self::MAX_KEY`] bytes of printable ASCII.
    pub key: String,
    /// How often.
    pub count: u64,
}

impl Refused {
    /// Longest key, bytes.
    pub const MAX_KEY: usize = 48;
    /// Most kinds that are told.
    pub const MAX_COUNT: usize = 16;

    /// Nothing of `key`, which anybody may have chosen, is longer than it should be or does something to a terminal.
    pub fn printable(key: &str) -> String {
        let printable = |c: char| if Self::is_printable(c) { c } else { '?' };
        key.chars().take(Self::MAX_KEY).map(printable).collect()
    }

    fn is_printable(c: char) -> bool {
        c == ' ' || c.is_ascii_graphic()
    }

    fn is_plausible(&self) -> bool {
        self.key.len() <= Self::MAX_KEY && self.key.chars().all(Self::is_printable)
    }
}

/// Why something was not believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Reason {
    /// Bytes that are no message, or one with an impossible value.
    Undecodable,
    /// A message of another version of Skein.
    OtherVersion,
    /// Said in somebody else's name.
    Forged,
    /// Said by a vehicle that is not of this swarm.
    Stranger,
    /// An order without a valid seal of this run.
    Unsealed,
    /// A register of another plan.
    OtherPlan,
    /// Said in another run of the swarm.
    OtherRun,
    /// A link without a certificate that counts.
    Link,
    /// Older than what was already heard: late, repeated or replayed.
    Old,
}

impl std::fmt::Display for Reason {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(match self {
            Self::Undecodable => "undecodable",
            Self::OtherVersion => "another version",
            Self::Forged => "forged",
            Self::Stranger => "not of this swarm",
            Self::Unsealed => "order without a valid seal",
            Self::OtherPlan => "another plan",
            Self::OtherRun => "of another run",
            Self::Link => "link refused",
            Self::Old => "old or replayed",
        })
    }
}

/// How one peer's word stands.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PeerHealth {
    /// The peer.
    pub id: VehicleId,
    /// Fresh, stale or lost.
    pub standing: Standing,
    /// Upper bound of the age of its last state by the receiver's clock, s: the time since it came and [`Self::delay_s`].
    pub age_s: f64,
    /// Upper bound of the time that this state was on its way, s; `None` until a round trip is known.
    pub delay_s: Option<f64>,
    /// How far its clock is ahead of the own, once measured. Nothing in flight relies on it.
    pub clock: Option<ClockOffset>,
}

impl PeerHealth {
    fn is_plausible(&self) -> bool {
        self.age_s.is_finite()
            && self.delay_s.is_none_or(|delay_s| delay_s.is_finite() && delay_s >= 0.0)
            && self.clock.is_none_or(|clock| clock.is_plausible())
    }
}

message!(Health, 16 * 1024, |said| Author::Vehicle(said.header.sender), |said| {
    let numbers = [said.uptime_s, said.frame_rate_hz, said.jitter_ms, said.step_p50_us, said.step_p99_us];
    numbers.iter().all(|number| number.is_finite())
        && said.plant.len() <= 64
        && said.version.len() <= Health::MAX_VERSION
        && said.failures.len() <= Failure::KINDS
        && said.refused.len() <= Refused::MAX_COUNT
        && said.refused.iter().all(Refused::is_plausible)
        && said.peers.iter().all(PeerHealth::is_plausible)
});
