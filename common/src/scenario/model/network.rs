//! The network between the vehicles: which messages are sent, which links exist, and their impairments.

use serde::{Deserialize, Serialize};

use super::super::key::keys;
use crate::id::VehicleId;

keys! {
    /// The network, `[network]`.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct Network at "network." {
        // Quantised positions step by 0.2 to 0.8 m: "on need" would be every frame anyway, at more cost.
        send: SendMode = OneOf(&["on_need", "every_frame"]), text("on_need"),
            "when a vehicle sends its state: when its peers' dead reckoning of it is off, or every frame",
            implied("sensing.position", "f32_latlon", text("every_frame"));
        state_error_m: f64 = above_zero(1e3), number(0.1),
            "position error of the peers' dead reckoning from which on the state is sent; 0.1 m is far below any distance that matters";
        state_error_m_s: f64 = above_zero(1e3), number(0.1),
            "velocity error of the peers' dead reckoning from which on the state is sent";
        state_max_period_s: f64 = from(0.02, 10.0), number(0.2),
            "longest time between two states of a vehicle, whatever their error; the state is also the sign of life";
        peer_stale_s: f64 = from(0.1, 600.0), number(2.0),
            "silence T_stale after which a peer leaves the formation and is lost, half of it where no message is lost; 2 s make false suspicions rare at 30 % loss";
        loss: f64 = from(0.0, 1.0), number(0.0),
            "share of messages that are lost; by default the network is perfect", unit_is("1");
        burst_s: Option<f64> = above_zero_or("none", 60.0), text("none"),
            "mean length of a burst of loss on each directed link; \"none\": each message is lost independently";
        delay_s: f64 = from(0.0, 60.0), number(0.0),
            "delay of every message; by default the network is perfect";
        jitter_s: f64 = from(0.0, 60.0), number(0.0),
            "random addition to the delay, 0 to this, drawn for every message: a later message may overtake";
        reorder: f64 = from(0.0, 1.0), number(0.0),
            "share of messages that are held back by reorder_s", unit_is("1");
        reorder_s: f64 = above_zero(60.0), number(0.3),
            "how long they are held back; above state_max_period_s, so that a later message overtakes";
        duplicate: f64 = from(0.0, 1.0), number(0.0),
            "share of messages that are received twice, the second up to jitter_s after the first", unit_is("1");
        bandwidth_bit_s: Option<f64> = above_zero_or("none", 1e12), text("none"),
            "bandwidth of each directed link; one uplink that n peers share gives each link an n-th of it";
        queue_s: f64 = from(0.0, 60.0), number(0.2),
            "a message that would wait longer for bandwidth is dropped; after 0.2 s the next state is due";
        range_m: Option<f64> = above_zero_or("none", 1e6), text("none"),
            "distance beyond which no message is received";
        fade_m: Option<f64> = above_zero_or("none", 1e6), text("none"),
            "distance from which on messages are lost, smoothly up to all at range_m; \"none\": none are lost before range_m";
        graph: Graph = OneOf(&["all", "nearest", "edges"]), text("all"),
            "which vehicles receive whose state; agreement and orders reach all in any case";
        neighbours: usize = Integer(1, 249), whole(6),
            "number of nearest vehicles whose state is received under graph = \"nearest\"; starlings heed six or seven",
            unit_is("vehicles");
        #[serde(default)]
        edges: Vec<[VehicleId; 2]> = Edges, Nothing,
            "[sender, receiver] pairs under graph = \"edges\"";
        links: Vec<LinkChange> = Tables, Nothing,
            "links that differ from the others; a later entry overrides an earlier one";
    }
}

/// The rule that decides when a vehicle sends its state, `network.send`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SendMode {
    /// A state is sent when the peers' dead reckoning of the vehicle would be off by too much, at the latest after
    /// `network.state_max_period_s`.
    OnNeed,
    /// Every frame.
    EveryFrame,
}

/// The rule that decides which vehicles receive whose state, `network.graph`.
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

keys! {
    /// Differences of some links, an entry of `network.links`.
    #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
    pub struct LinkChange at "network.links[N]." {
        #[serde(default)]
        from: Vec<VehicleId> = Ids, Nothing,
            "senders of these links; without it, all";
        #[serde(default)]
        to: Vec<VehicleId> = Ids, Nothing,
            "receivers of these links; without it, all";
        both_ways: bool = Bool, flag(false),
            "the entry holds for the opposite direction too";
        loss: Option<f64> = from(0.0, 1.0), Nothing,
            "network.loss of these links", unit_is("1");
        burst_s: Option<f64> = above_zero(60.0), Nothing,
            "network.burst_s of these links";
        delay_s: Option<f64> = from(0.0, 60.0), Nothing,
            "network.delay_s of these links";
        jitter_s: Option<f64> = from(0.0, 60.0), Nothing,
            "network.jitter_s of these links";
        reorder: Option<f64> = from(0.0, 1.0), Nothing,
            "network.reorder of these links", unit_is("1");
        reorder_s: Option<f64> = above_zero(60.0), Nothing,
            "network.reorder_s of these links";
        duplicate: Option<f64> = from(0.0, 1.0), Nothing,
            "network.duplicate of these links", unit_is("1");
        bandwidth_bit_s: Option<f64> = above_zero(1e12), Nothing,
            "network.bandwidth_bit_s of these links";
        queue_s: Option<f64> = from(0.0, 60.0), Nothing,
            "network.queue_s of these links";
    }
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
