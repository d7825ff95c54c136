//! The network between the vehicles: which messages are sent, which links exist, and their impairments.

use serde::{Deserialize, Serialize};

use crate::id::VehicleId;

/// The network, `[network]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Network {
    /// When a vehicle sends its state.
    pub send: SendMode,
    /// Position error of the peers' dead reckoning at which the state is sent, m.
    pub state_error_m: f64,
    /// Velocity error of the peers' dead reckoning at which the state is sent, m/s.
    pub state_error_m_s: f64,
    /// Longest time between two states of a vehicle, s.
    pub state_max_period_s: f64,
    /// Age T_stale at which a peer's state becomes stale, s.
    pub peer_stale_s: f64,
    /// Share of messages lost.
    pub loss: f64,
    /// Mean length of a burst of loss, s; `None`: each message is lost independently.
    pub burst_s: Option<f64>,
    /// Delay of every message, s.
    pub delay_s: f64,
    /// Largest random addition to the delay, s.
    pub jitter_s: f64,
    /// Share of messages that are held back by [`Self::reorder_s`].
    pub reorder: f64,
    /// Time for which these messages are held back, s.
    pub reorder_s: f64,
    /// Share of messages that are received twice.
    pub duplicate: f64,
    /// Bandwidth of each directed link, bit/s; `None`: no limit.
    pub bandwidth_bit_s: Option<f64>,
    /// Longest time that a message waits for bandwidth before it is dropped, s.
    pub queue_s: f64,
    /// Distance beyond which no message is received, m; `None`: no limit.
    pub range_m: Option<f64>,
    /// Distance at which loss by distance begins, m; `None`: at [`Network::range_m`].
    pub fade_m: Option<f64>,
    /// Which vehicles receive whose state.
    pub graph: Graph,
    /// Number of nearest vehicles under [`Graph::Nearest`].
    pub neighbours: usize,
    /// Sender and receiver of each link under [`Graph::Edges`]; otherwise empty or unused.
    #[serde(default)]
    pub edges: Vec<[VehicleId; 2]>,
    /// Links that differ from the others; a later entry overrides an earlier one.
    pub links: Vec<LinkChange>,
}

/// When a vehicle sends its state, `network.send`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SendMode {
    /// When the peers' dead reckoning of the vehicle is off.
    OnNeed,
    /// Every frame.
    EveryFrame,
}

/// Which vehicles receive whose state, `network.graph`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Graph {
    /// Every vehicle receives every state.
    All,
    /// A vehicle receives the states of the nearest `neighbours`.
    Nearest,
    /// States are received over the links that `edges` lists.
    Edges,
}

/// Differences of some links, an entry of `network.links`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LinkChange {
    /// Senders; empty means all.
    #[serde(default)]
    pub from: Vec<VehicleId>,
    /// Receivers; empty means all.
    #[serde(default)]
    pub to: Vec<VehicleId>,
    /// Whether the entry holds for the opposite direction too.
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

/// Impairments of one directed link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Share of messages lost.
    pub loss: f64,
    /// Mean length of a burst of loss, s; `None`: each message is lost independently.
    pub burst_s: Option<f64>,
    /// Delay of every message, s.
    pub delay_s: f64,
    /// Largest random addition to the delay, s.
    pub jitter_s: f64,
    /// Share of messages that are held back by [`Self::reorder_s`].
    pub reorder: f64,
    /// Time for which these messages are held back, s.
    pub reorder_s: f64,
    /// Share of messages that are received twice.
    pub duplicate: f64,
    /// Bandwidth, bit/s; `None`: no limit.
    pub bandwidth_bit_s: Option<f64>,
    /// Longest time that a message waits for bandwidth before it is dropped, s.
    pub queue_s: f64,
}

impl Network {
    /// Impairments of a link that no entry of `links` changes.
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

    /// Impairments of the link from `sender` to `receiver`.
    pub fn link(&self, sender: VehicleId, receiver: VehicleId) -> Quality {
        let changes = self.links.iter().filter(|change| change.is_of(sender, receiver));
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
    fn is_of(&self, sender: VehicleId, receiver: VehicleId) -> bool {
        let is_among = |ids: &[VehicleId], id| ids.is_empty() || ids.contains(&id);
        let goes = |sender, receiver| is_among(&self.from, sender) && is_among(&self.to, receiver);
        goes(sender, receiver) || self.both_ways && goes(receiver, sender)
    }
}
