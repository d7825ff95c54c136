//! The times at which links are cut or delayed, and the outages that both ends of a cut link observe.

use alloc::vec::Vec;
use core::ops::Range;

use skein_common::id::VehicleId;
use skein_common::scenario::{EventAction, Fault, ScriptedEvent};

use crate::random::{self, Purpose};

/// Time without data after which an end closes the session: the lease that agents give each other, s.
pub(super) const LEASE_S: f64 = 1.0;
/// Time from the end of an outage to a new session: the retry periods of the connecting end, s.
const RETRY_S: Range<f64> = 0.2..1.0;

/// An outage of the link of a pair, on the clock that counts from take-off.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Outage {
    /// Time at which a direction dies, s.
    pub(super) from_s: f64,
    /// Time at which both ends close the session, s; infinite if no direction is dead for so long.
    pub(super) closes_s: f64,
    /// Time from which both directions are alive again, s; infinite if the outage is permanent.
    pub(super) until_s: f64,
    /// Time at which a closed session is open again, s.
    pub(super) back_s: f64,
}

/// The times in which no message from `sender` reaches `receiver`, s after take-off, in order and disjoint.
pub fn silences(events: &[ScriptedEvent], sender: VehicleId, receiver: VehicleId) -> Vec<Range<f64>> {
    let silence = |event: &ScriptedEvent| {
        let EventAction::Fault(Fault::Cut { from, to, both_ways }) = &event.what else { return None };
        is_among([from, to], *both_ways, sender, receiver).then(|| lasting(event))
    };
    union(events.iter().filter_map(silence))
}

/// The times, s after the receiver's take-off, in which events delay messages from `sender` to `receiver`, in the order
/// of the file, each with the added delay, s. Overlapping delays add up.
pub fn delays(events: &[ScriptedEvent], sender: VehicleId, receiver: VehicleId) -> Vec<(Range<f64>, f64)> {
    let delay = |event: &ScriptedEvent| {
        let EventAction::Fault(Fault::Delay { from, to, both_ways, delay_s }) = &event.what else { return None };
        is_among([from, to], *both_ways, sender, receiver).then(|| (lasting(event), *delay_s))
    };
    events.iter().filter_map(delay).collect()
}

/// Whether an event between these senders and receivers affects this direction of a link.
fn is_among([from, to]: [&Vec<VehicleId>; 2], both_ways: bool, sender: VehicleId, receiver: VehicleId) -> bool {
    let affects = |sender: &VehicleId, receiver: &VehicleId| from.contains(sender) && to.contains(receiver);
    sender != receiver && (affects(&sender, &receiver) || both_ways && affects(&receiver, &sender))
}

/// Begin and end of an event, s after take-off.
pub fn lasting(event: &ScriptedEvent) -> Range<f64> {
    event.at_s..event.for_s.map_or(f64::INFINITY, |for_s| event.at_s + for_s)
}

/// The union of these times, in order; adjoining ranges become one.
pub fn union(ranges: impl IntoIterator<Item = Range<f64>>) -> Vec<Range<f64>> {
    let mut ranges: Vec<_> = ranges.into_iter().collect();
    ranges.sort_by(|one, other| one.start.total_cmp(&other.start));
    ranges.dedup_by(|later, kept| {
        let touches = later.start <= kept.end;
        if touches {
            kept.end = kept.end.max(later.end);
        }
        touches
    });
    ranges
}

/// The outages between two vehicles, the same from either end, in order and disjoint. The silences are those of the two directions.
pub(super) fn outages(seed: u64, [one, other]: [VehicleId; 2], silences: [&[Range<f64>]; 2]) -> Vec<Outage> {
    let directions = silences.concat();
    let outage = |(nth, Range { start, end }): (usize, Range<f64>)| {
        let within = directions.iter().filter(|silence| (start..end).contains(&silence.start));
        let closes_s = within.map(|silence| (silence.start + LEASE_S, silence.end)).filter(|(at, end)| at <= end);
        Outage {
            from_s: start,
            closes_s: closes_s.map(|(at, _)| at).fold(f64::INFINITY, f64::min),
            until_s: end,
            back_s: end + retry_s(seed, [one.min(other), one.max(other)], nth),
        }
    };
    union(directions.iter().cloned()).into_iter().enumerate().map(outage).collect()
}

/// Time after their `nth` outage until two vehicles reconnect, s. Every outage of every pair has its own position in
/// the swarm's random stream, so both ends draw the same value regardless of other cuts.
fn retry_s(seed: u64, [low, high]: [VehicleId; 2], nth: usize) -> f64 {
    let mut generator = random::generator(seed, None, Purpose::Network);
    let place = (nth as u128) << 16 | u128::from(low.get()) << 8 | u128::from(high.get());
    // One draw takes two 32-bit numbers of the stream.
    generator.set_word_pos(2 * place);
    RETRY_S.start + (RETRY_S.end - RETRY_S.start) * random::uniform(&mut generator)
}
