//! The channels from all other vehicles to one receiver, if they have more than a delay: the [`Channel`] of every
//! direction, loss by distance, and the graph that selects whose states are received.

use alloc::vec::Vec;

use skein_common::frame::PositionNed;
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::scenario::{Graph, Network, Quality, Scenario};
use skein_common::time::LocalTime;

use super::Delivery;
use super::channel::{Channel, Direction, size_bytes};
use super::draw::{Draws, MessageKey};
use crate::peers::{PeerMessage, Received};

/// All channels to one receiving vehicle.
#[derive(Clone, Debug)]
pub(super) struct ReceiverChannels {
    own: VehicleId,
    draws: Draws,
    /// The settings of every link, and those of the links from single senders that have others, by id.
    quality: Quality,
    particular: Vec<(VehicleId, Quality)>,
    /// The other vehicles, by id.
    senders: Vec<Sender>,
    /// The channel for orders from operators, and their number so far. An operator has no position, so range does not apply.
    operator: Channel,
    orders: u64,
    range: Option<Range>,
    selection: NeighbourSelection,
    /// Age beyond which a sender is not selected as one of the nearest, s.
    stale_s: f64,
    /// Position of the receiver.
    own_position: Option<PositionNed>,
}

#[derive(Clone, Debug)]
struct Sender {
    id: VehicleId,
    channel: Channel,
    /// Its position as last reported, and the time of that report.
    place: Option<(PositionNed, LocalTime)>,
}

/// Loss by distance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Range {
    pub(super) fade_m: f64,
    pub(super) range_m: f64,
}

impl Range {
    /// The loss by distance of this network, if it has any.
    pub(super) fn of(network: &Network) -> Option<Self> {
        network.range_m.map(|range_m| Self { fade_m: network.fade_m.unwrap_or(range_m), range_m })
    }

    /// Share of messages lost at this distance: 0 up to `fade_m`, 1 from `range_m`, and s²·(3 − 2s) at the fraction s
    /// between them. The formula is ours: smooth, monotone, and S-shaped like the transitional region of real radios
    /// (Zúñiga and Krishnamachari 2004).
    pub(super) fn loss_at(self, distance_m: f64) -> f64 {
        if distance_m >= self.range_m {
            1.0
        } else if distance_m <= self.fade_m {
            0.0
        } else {
            let fraction = (distance_m - self.fade_m) / (self.range_m - self.fade_m);
            fraction * fraction * (3.0 - 2.0 * fraction)
        }
    }
}

/// The selection of senders whose states the vehicle receives.
#[derive(Clone, Debug)]
enum NeighbourSelection {
    All,
    /// These senders.
    Edges(VehicleSet),
    /// The `count` nearest senders; all of them until a position is known.
    Nearest {
        count: usize,
        selected: Option<VehicleSet>,
        /// Buffer for sorting.
        distances: Vec<(f64, VehicleId)>,
    },
}

impl ReceiverChannels {
    /// The channels to vehicle `own`; `None` if all links have only the same delay.
    pub(super) fn new(scenario: &Scenario, own: VehicleId) -> Option<Self> {
        let Network { range_m, graph, ref links, .. } = scenario.network;
        let everywhere = scenario.network.quality();
        if links.is_empty() && range_m.is_none() && graph == Graph::All && only_delays(&everywhere) {
            return None;
        }
        let selection = match graph {
            Graph::All => NeighbourSelection::All,
            Graph::Edges => {
                let to_own = scenario.network.edges.iter().filter(|[_, receiver]| *receiver == own);
                NeighbourSelection::Edges(to_own.map(|[sender, _]| *sender).collect())
            }
            Graph::Nearest => NeighbourSelection::Nearest {
                count: scenario.network.neighbours,
                selected: None,
                distances: Vec::new(),
            },
        };
        let senders = scenario.ids().filter(|&id| id != own);
        let particular = senders.clone().map(|id| (id, scenario.network.link(id, own)));
        Some(Self {
            own,
            draws: Draws::new(scenario.seed),
            quality: everywhere,
            particular: particular.filter(|(_, quality)| *quality != everywhere).collect(),
            senders: senders.map(|id| Sender { id, channel: Channel::default(), place: None }).collect(),
            operator: Channel::default(),
            orders: 0,
            range: Range::of(&scenario.network),
            selection,
            stale_s: scenario.network.peer_stale_s,
            own_position: None,
        })
    }

    /// Sets the receiver's position and selects the nearest senders.
    pub(super) fn update(&mut self, now: LocalTime, own_position: Option<PositionNed>) {
        self.own_position = own_position;
        let NeighbourSelection::Nearest { count, selected, distances } = &mut self.selection else { return };
        let Some(own) = own_position else { return };
        let near = self.senders.iter().filter_map(|sender| {
            let (position, sent_at) = sender.place?;
            (now.seconds_since(sent_at) <= self.stale_s).then(|| ((position - own).norm_squared(), sender.id))
        });
        distances.clear();
        distances.extend(near);
        distances.sort_unstable_by(|one, other| one.0.total_cmp(&other.0).then(one.1.cmp(&other.1)));
        *selected = (!distances.is_empty()).then(|| distances.iter().take(*count).map(|(_, id)| *id).collect());
    }

    /// Delivery of a message. With `is_cut` the link is dead, so the sender's reported position is not taken over.
    pub(super) fn fate(&mut self, received: &Received, is_cut: bool) -> Delivery {
        let Received { message, at } = received;
        let key = MessageKey::of(message, self.orders);
        let Some(sender_id) = message.sender() else {
            self.orders += 1;
            let direction = Direction { sender: 0, receiver: self.own, quality: &self.quality };
            return self.operator.fate(&self.draws, &direction, (&key, || size_bytes(message)), *at, 0.0);
        };
        let index = self.senders.binary_search_by_key(&sender_id, |sender| sender.id);
        // A message with a false sender id passes: the agent counts those.
        let Some(sender) = index.ok().and_then(|index| self.senders.get_mut(index)) else {
            return Delivery::Arrives { at: *at, copy_at: None };
        };
        let quality = quality_of(sender_id, &self.particular, &self.quality);
        match message {
            PeerMessage::Appeared(_) | PeerMessage::Vanished(_) => {
                sender.place = None;
                return Delivery::Arrives { at: at.plus_seconds(quality.delay_s), copy_at: None };
            }
            PeerMessage::State(payload) => {
                if !is_cut {
                    sender.place = Some((payload.position, *at));
                }
                if !self.selection.includes(sender_id) {
                    return Delivery::OutsideGraph;
                }
            }
            PeerMessage::Mission(_) | PeerMessage::Order(_) => {}
        }
        let distance_m = self.own_position.zip(sender.place).map(|(own, (other, _))| (own - other).norm());
        let lost_by_distance = self.range.zip(distance_m).map_or(0.0, |(range, distance_m)| range.loss_at(distance_m));
        let direction = Direction { sender: sender_id.get().into(), receiver: self.own, quality };
        sender.channel.fate(&self.draws, &direction, (&key, || size_bytes(message)), *at, lost_by_distance)
    }

    /// The delay of every message from this sender, liveliness tokens included, s.
    pub(super) fn delay_s(&self, sender: VehicleId) -> f64 {
        quality_of(sender, &self.particular, &self.quality).delay_s
    }
}

/// The settings of the link to or from this vehicle among those of `particular`, by id; else those of `everywhere`.
pub(super) fn quality_of<'a>(
    vehicle: VehicleId,
    particular: &'a [(VehicleId, Quality)],
    everywhere: &'a Quality,
) -> &'a Quality {
    let listed = particular.binary_search_by_key(&vehicle, |(id, _)| *id).ok();
    listed.and_then(|nth| particular.get(nth)).map_or(everywhere, |(_, quality)| quality)
}

impl NeighbourSelection {
    fn includes(&self, sender: VehicleId) -> bool {
        match self {
            Self::All => true,
            Self::Edges(senders) => senders.contains(sender),
            Self::Nearest { selected, .. } => selected.is_none_or(|selected| selected.contains(sender)),
        }
    }
}

pub(super) fn only_delays(quality: &Quality) -> bool {
    let Quality { loss, jitter_s, reorder, duplicate, bandwidth_bit_s, .. } = *quality;
    bandwidth_bit_s.is_none() && [loss, jitter_s, reorder, duplicate] == [0.0; 4]
}
