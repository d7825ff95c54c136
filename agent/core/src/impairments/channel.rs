//! One direction of a link: what happens to a message in flight.
//!
//! In this order: the message waits for the bandwidth and may be dropped in the queue, it may be lost, it is delayed,
//! it may be duplicated. All of this but the queue follows from the seed and from the message's number (`draw.rs`).

use skein_common::id::VehicleId;
use skein_common::math;
use skein_common::message;
use skein_common::scenario::Quality;
use skein_common::time::LocalTime;

use super::Delivery;
use super::draw::{Draw, Draws, MessageKey};
use crate::peers::PeerMessage;

/// Size of a message on the wire beyond its encoding, bytes. Measured on a mesh of TCP links: 20 of Zenoh's framing and
/// 52 of IPv4 and TCP with timestamps, with piggybacked acknowledgements. Ethernet's preamble, header, checksum and gap
/// are 38 more.
const OVERHEAD_BYTES: usize = 20 + 52 + 38;
/// Size of a state's complete key, sent because it changes with the cell: `hover/vehicle/3/cell/0/-1/state`.
const STATE_KEY_BYTES: usize = 30;
/// Shortest mean duration of a burst, s. Messages are farther apart, so that shorter bursts have the same effect.
const SHORTEST_BURST_S: f64 = 0.001;

/// The memory of one direction of a link from one message to the next.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Channel {
    /// Time at which the last queued message has left the queue.
    free_at: LocalTime,
    burst: Burst,
}

/// One direction of a link: its sender's number, its receiver and its settings.
#[derive(Clone, Copy, Debug)]
pub(super) struct Direction<'a> {
    pub(super) sender: u32,
    pub(super) receiver: VehicleId,
    pub(super) quality: &'a Quality,
}

impl Channel {
    /// Delivery of a message of this size, bytes, sent at `at`, with this share of messages lost by distance.
    pub(super) fn fate(
        &mut self,
        draws: &Draws,
        direction: &Direction<'_>,
        (key, size_bytes): (&MessageKey, impl FnOnce() -> usize),
        at: LocalTime,
        lost_by_distance: f64,
    ) -> Delivery {
        let Direction { sender, receiver, quality } = *direction;
        let Some(sent_at) = self.through_queue(quality, size_bytes, at) else { return Delivery::QueueFull };
        let is_in_burst = self.is_in_burst(quality, sent_at, |nth| draws.of_link(sender, nth, receiver));
        delivery(quality, |what| draws.of(what, key, receiver), sent_at, is_in_burst, lost_by_distance)
    }

    /// Whether the link is in a burst at this time; `None` if it has no bursts. `chance` gives the numbers of the link.
    pub(super) fn is_in_burst(
        &mut self,
        quality: &Quality,
        at: LocalTime,
        chance: impl Fn(u64) -> f64,
    ) -> Option<bool> {
        quality.burst_s.map(|mean_s| self.burst.is_on((quality.loss, mean_s), at, chance))
    }

    /// The time until which [`Self::is_in_burst`] stays as it was last.
    pub(super) fn burst_until(&self) -> LocalTime {
        self.burst.until
    }

    /// The time at which the message has left the queue; `None` if it would have to wait too long.
    pub(super) fn through_queue(
        &mut self,
        quality: &Quality,
        size_bytes: impl FnOnce() -> usize,
        at: LocalTime,
    ) -> Option<LocalTime> {
        let Some(bandwidth_bit_s) = quality.bandwidth_bit_s else { return Some(at) };
        let begins_at = self.free_at.max(at);
        if begins_at.seconds_since(at) > quality.queue_s {
            return None;
        }
        self.free_at = begins_at.plus_seconds(8.0 * size_bytes() as f64 / bandwidth_bit_s);
        Some(self.free_at)
    }
}

/// Delivery of a message that has left the queue at `sent_at`, by its random numbers. `is_in_burst` is whether its link is in a
/// burst of losses, `None` if each message is lost by itself.
pub(super) fn delivery(
    quality: &Quality,
    chance: impl Fn(Draw) -> f64,
    sent_at: LocalTime,
    is_in_burst: Option<bool>,
    lost_by_distance: f64,
) -> Delivery {
    let happens = |what, share| share > 0.0 && chance(what) < share;
    if happens(Draw::Distance, lost_by_distance) {
        return Delivery::OutOfRange;
    }
    if is_in_burst.unwrap_or_else(|| happens(Draw::Loss, quality.loss)) {
        return Delivery::Lost;
    }
    let Quality { delay_s, jitter_s, reorder, reorder_s, duplicate, .. } = *quality;
    let jitter_of = |what| if jitter_s > 0.0 { chance(what) * jitter_s } else { 0.0 };
    let held_s = if happens(Draw::Reorder, reorder) { reorder_s } else { 0.0 };
    let at = sent_at.plus_seconds(delay_s + jitter_of(Draw::Jitter) + held_s);
    // The copy arrives later, as a retransmission does. So copies only repeat known content.
    let copy_at = happens(Draw::Duplicate, duplicate).then(|| at.plus_seconds(jitter_of(Draw::Copy)));
    Delivery::Arrives { at, copy_at }
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

/// Loss in bursts: a link is in a burst and without one by turns, each for an exponentially distributed time (Gilbert 1960,
/// "Capacity of a burst-noise channel", in continuous time; with Elliott's 1963 loss probabilities 0 and 1). Counted in
/// time, not in messages: a fade does not pass sooner because more messages are sent.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Burst {
    /// Number of turns so far, the present one included; zero before the first message.
    turns: u32,
    is_on: bool,
    /// End of the present turn.
    until: LocalTime,
}

impl Burst {
    /// Whether the link is in a burst at `at`, if it is so for this share of all time, each time for this mean duration, s.
    /// `chance` gives the numbers of the link by their place, evenly distributed in [0, 1).
    pub(super) fn is_on(&mut self, (share, mean_s): (f64, f64), at: LocalTime, chance: impl Fn(u64) -> f64) -> bool {
        if share <= 0.0 || share >= 1.0 {
            return share >= 1.0;
        }
        let mean_s = mean_s.max(SHORTEST_BURST_S);
        while self.turns == 0 || at >= self.until {
            self.is_on = if self.turns == 0 { chance(0) < share } else { !self.is_on };
            self.turns += 1;
            let turn_s = if self.is_on { mean_s } else { mean_s * (1.0 - share) / share };
            self.until = self.until.plus_seconds(-turn_s * math::ln(1.0 - chance(self.turns.into())));
        }
        self.is_on
    }
}
