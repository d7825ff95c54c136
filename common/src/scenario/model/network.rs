//! Who hears whom, when and how well.

use serde::{Deserialize, Serialize};

use crate::id::VehicleId;

/// `[network]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Network {
    /// When the state is sent.
    pub send: SendMode,
    /// Error of the peers' dead reckoning that sends.
    pub state_error_m: f64,
    /// The same of the velocity.
    pub state_error_m_s: f64,
    /// At least this often.
    pub state_max_period_s: f64,
    /// T_stale.
    pub peer_stale_s: f64,
    /// Share of messages lost.
    pub loss: f64,
    /// Mean length of a burst of loss; without it each message is lost on its own.
    pub burst_s: Option<f64>,
    /// Of every message.
    pub delay_s: f64,
    /// Added to the delay, 0 to this.
    pub jitter_s: f64,
    /// Share of messages held back.
    pub reorder: f64,
    /// By this.
    pub reorder_s: f64,
    /// Share of messages that come twice.
    pub duplicate: f64,
    /// Of each directed link; without it no limit.
    pub bandwidth_bit_s: Option<f64>,
    /// Longest wait for the bandwidth.
    pub queue_s: f64,
    /// Farther apart, nobody hears; without it no limit.
    pub range_m: Option<f64>,
    /// Where loss by distance begins; without it, at [`Network::range_m`].
    pub fade_m: Option<f64>,
    /// Who hears whose state.
    pub graph: Graph,
    /// How many under [`Graph::Nearest`].
    pub neighbours: usize,
    /// Speaker and hearer under [`Graph::Edges`], else empty or unused.
    #[serde(default)]
    pub edges: Vec<[VehicleId; 2]>,
    /// Links that are not like the others, the last of them on top.
    pub links: Vec<LinkChange>,
}

/// `network.send`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SendMode {
    /// When the peers' dead reckoning is off.
    OnNeed,
    /// Every frame.
    EveryFrame,
}

/// `network.graph`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Graph {
    /// Everybody.
    All,
    /// The nearest `neighbours`.
    Nearest,
    /// As listed.
    Edges,
}

/// `network.links`: what is different about some links.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LinkChange {
    /// Speakers; empty for everybody.
    #[serde(default)]
    pub from: Vec<VehicleId>,
    /// Hearers; empty for everybody.
    #[serde(default)]
    pub to: Vec<VehicleId>,
    /// The other way too.
    pub both_ways: bool,
    /// [`Network::loss`] of these links.
    pub loss: Option<f64>,
    /// [`Network::burst_s`] of these links.
    pub burst_s: Option<f64>,
    /// [`Network::delay_s`] of these links.
    pub delay_s: Option<f64>,
    /// [`Network::jitter_s`] of these links.
    pub jitter_s: Option<f64>,
    /// [`Network::reorder`] of these links.
    pub reorder: Option<f64>,
    /// [`Network::reorder_s`] of these links.
    pub reorder_s: Option<f64>,
    /// [`Network::duplicate`] of these links.
    pub duplicate: Option<f64>,
    /// [`Network::bandwidth_bit_s`] of these links.
    pub bandwidth_bit_s: Option<f64>,
    /// [`Network::queue_s`] of these links.
    pub queue_s: Option<f64>,
}

/// How good one directed link is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Share of messages lost.
    pub loss: f64,
    /// Mean length of a burst of loss.
    pub burst_s: Option<f64>,
    /// Of every message.
    pub delay_s: f64,
    /// Added to the delay, 0 to this.
    pub jitter_s: f64,
    /// Share of messages held back.
    pub reorder: f64,
    /// By this.
    pub reorder_s: f64,
    /// Share of messages that come twice.
    pub duplicate: f64,
    /// Without it no limit.
    pub bandwidth_bit_s: Option<f64>,
    /// Longest wait for the bandwidth.
    pub queue_s: f64,
}

impl Network {
    /// What `[network]` says of every link.
    pub fn quality(&self) -> Quality {
        Quality {
            loss: self.loss,
            burst_s: self.burst_s,
            delay_s: self.delay_s,
            jitter_s: self.jitter_s,
            reorder: self.reorder,
            reorder_s: self.reorder_s,
            duplicate: self.duplicate,
            bandwidth_bit_s: self.bandwidth_bit_s,
            queue_s: self.queue_s,
        }
    }

    /// The link on which `hearer` hears `speaker`.
    pub fn link(&self, speaker: VehicleId, hearer: VehicleId) -> Quality {
        let changes = self.links.iter().filter(|change| change.is_of(speaker, hearer));
        changes.fold(self.quality(), |link, change| Quality {
            loss: change.loss.unwrap_or(link.loss),
            burst_s: change.burst_s.or(link.burst_s),
            delay_s: change.delay_s.unwrap_or(link.delay_s),
            jitter_s: change.jitter_s.unwrap_or(link.jitter_s),
            reorder: change.reorder.unwrap_or(link.reorder),
            reorder_s: change.reorder_s.unwrap_or(link.reorder_s),
            duplicate: change.duplicate.unwrap_or(link.duplicate),
            bandwidth_bit_s: change.bandwidth_bit_s.or(link.bandwidth_bit_s),
            queue_s: change.queue_s.unwrap_or(link.queue_s),
        })
    }
}

impl LinkChange {
    fn is_of(&self, speaker: VehicleId, hearer: VehicleId) -> bool {
        let is_among = |ids: &[VehicleId], id| ids.is_empty() || ids.contains(&id);
        let goes = |speaker, hearer| is_among(&self.from, speaker) && is_among(&self.to, hearer);
        goes(speaker, hearer) || self.both_ways && goes(hearer, speaker)
    }
}
