//! One direction of a link: what happens to a message in flight.
//!
//! In this order: the message waits for the bandwidth and may be dropped in the queue, it may be lost, it is delayed,
//! it may be duplicated. Six numbers are drawn for every message, whatever the settings, from a stream of this
//! direction alone. So one impairment does not change the effect of another, and the delivery of a vehicle's n-th
//! message is independent of all other vehicles.

use rand_chacha::ChaCha8Rng;
use skein_common::id::VehicleId;
use skein_common::message;
use skein_common::scenario::Quality;
use skein_common::time::LocalTime;

use super::Delivery;
use crate::gilbert::Gilbert;
use crate::peers::PeerMessage;
use crate::random::{self, Purpose};

/// Size of a message on the wire beyond its encoding, bytes. Measured on a mesh of TCP links: 20 of Zenoh's framing and
/// 52 of IPv4 and TCP with timestamps, with piggybacked acknowledgements. Ethernet's preamble, header, checksum and gap
/// are 38 more.
const OVERHEAD_BYTES: usize = 20 + 52 + 38;
/// Size of a state's complete key, sent because it changes with the cell: `hover/vehicle/3/cell/0/-1/state`.
const STATE_KEY_BYTES: usize = 30;

/// The receiver's end of one direction of a link.
#[derive(Clone, Debug)]
pub(super) struct Channel {
    quality: Quality,
    generator: ChaCha8Rng,
    burst: Option<Burst>,
    /// Time at which the last queued message has left the queue.
    free_at: LocalTime,
}

/// The random numbers of one message, each evenly distributed in [0, 1).
struct Chance {
    loss: f64,
    distance: f64,
    jitter: f64,
    reorder: f64,
    duplicate: f64,
    copy: f64,
}

impl Channel {
    /// The direction from `sender`, `None` for an operator, to `receiver`.
    pub(super) fn new(quality: Quality, seed: u64, sender: Option<VehicleId>, receiver: VehicleId) -> Self {
        Self::with(quality, random::link_generator(seed, sender, receiver))
    }

    /// The channel that carries the states of all vehicles of other teams to `receiver`. It has no bandwidth: they share
    /// no link.
    pub(super) fn of_strangers(quality: Quality, seed: u64, receiver: VehicleId) -> Self {
        let quality = Quality { bandwidth_bit_s: None, ..quality };
        Self::with(quality, random::generator(seed, Some(receiver), Purpose::Strangers))
    }

    fn with(quality: Quality, generator: ChaCha8Rng) -> Self {
        let burst = quality.burst_s.map(|mean_s| Burst { model: Gilbert::new(quality.loss, mean_s), before: None });
        Self { quality, generator, burst, free_at: LocalTime::ZERO }
    }

    /// Delivery of a message sent at `at`, with this share of messages lost by distance.
    pub(super) fn fate(&mut self, message: &PeerMessage, at: LocalTime, lost_by_distance: f64) -> Delivery {
        self.fate_of(|| size_bytes(message), at, lost_by_distance)
    }

    /// Delivery of a message of this size, bytes, as in [`Self::fate`].
    pub(super) fn fate_of(
        &mut self,
        size_bytes: impl FnOnce() -> usize,
        at: LocalTime,
        lost_by_distance: f64,
    ) -> Delivery {
        let chance = self.draw();
        let Some(sent_at) = self.through_queue(size_bytes, at) else { return Delivery::QueueFull };
        let is_lost = match &mut self.burst {
            Some(burst) => burst.is_on(sent_at, chance.loss),
            None => chance.loss < self.quality.loss,
        };
        if chance.distance < lost_by_distance {
            return Delivery::OutOfRange;
        }
        if is_lost {
            return Delivery::Lost;
        }
        let Quality { delay_s, jitter_s, reorder, reorder_s, duplicate, .. } = self.quality;
        let held_s = if chance.reorder < reorder { reorder_s } else { 0.0 };
        let at = sent_at.plus_seconds(delay_s + chance.jitter * jitter_s + held_s);
        // The copy arrives later, as a retransmission does. So copies only repeat known content.
        let copy_at = (chance.duplicate < duplicate).then(|| at.plus_seconds(chance.copy * jitter_s));
        Delivery::Arrives { at, copy_at }
    }

    /// The delay of every message, liveliness tokens included, s.
    pub(super) fn delay_s(&self) -> f64 {
        self.quality.delay_s
    }

    fn draw(&mut self) -> Chance {
        let mut next = || random::uniform(&mut self.generator);
        Chance { loss: next(), distance: next(), jitter: next(), reorder: next(), duplicate: next(), copy: next() }
    }

    /// The time at which the message has left the queue; `None` if it would have to wait too long.
    fn through_queue(&mut self, size_bytes: impl FnOnce() -> usize, at: LocalTime) -> Option<LocalTime> {
        let Some(bandwidth_bit_s) = self.quality.bandwidth_bit_s else { return Some(at) };
        let begins_at = self.free_at.max(at);
        if begins_at.seconds_since(at) > self.quality.queue_s {
            return None;
        }
        self.free_at = begins_at.plus_seconds(8.0 * size_bytes() as f64 / bandwidth_bit_s);
        Some(self.free_at)
    }
}

/// Size of a message on the wire, bytes.
pub(super) fn size_bytes(message: &PeerMessage) -> usize {
    let encoded = match message {
        PeerMessage::State(payload) => payload.message_len() + STATE_KEY_BYTES,
        PeerMessage::Mission(payload) => message::encoded_len(payload),
        PeerMessage::Order(payload) => message::encoded_len(payload),
        PeerMessage::Appeared(_) | PeerMessage::Vanished(_) => 0,
    };
    encoded + OVERHEAD_BYTES
}

/// Loss in bursts. Counted in time, not in messages: a fade does not pass sooner because more messages are sent.
#[derive(Clone, Copy, Debug)]
struct Burst {
    model: Gilbert,
    /// Time of the last message.
    before: Option<LocalTime>,
}

impl Burst {
    /// Whether the link is bad at `at`; `chance` is evenly distributed in [0, 1).
    fn is_on(&mut self, at: LocalTime, chance: f64) -> bool {
        let since_s = self.before.map_or(0.0, |before| at.seconds_since(before));
        self.before = Some(at);
        self.model.is_bad(since_s, chance)
    }
}
