//! Queries and replies as vectors of little-endian f64, one datagram each, for programs without JSON such as Simulink.
//!
//! [`QUERY`], [`PEER`] and [`REPLY`] are the layouts, from which the book's page is made. Unused rows of peers are zero. Of more
//! than 15 peers the nearest have a row, ordered by id.

use nalgebra::{Vector2, Vector3};
use skein_common::frame::PositionNed;

use super::protocol::{Fault, PROTOCOL, is_sane, vehicle_id, whole_f64};
use skein_core::formation::external::{LawQuery, LawReply, ReplyCommand};
use skein_core::formation::law::Neighbour;

/// Neighbouring values of a vector: how many, and what they are.
#[derive(Clone, Copy, Debug)]
pub struct Part {
    /// Number of values.
    pub values: usize,
    /// Their meaning, with units.
    pub meaning: &'static str,
}

const fn part(values: usize, meaning: &'static str) -> Part {
    Part { values, meaning }
}

const fn sum(parts: &[Part]) -> usize {
    let (mut sum, mut nth) = (0, 0);
    while nth < parts.len() {
        sum += parts[nth].values;
        nth += 1;
    }
    sum
}

/// The layout of a query before its rows of peers.
pub const QUERY: [Part; 15] = [
    part(1, "version of the protocol: 1"),
    part(1, "vehicle, its id"),
    part(1, "tick: number of the query, to be repeated in the reply"),
    part(1, "`time_s`: time since the start, s"),
    part(1, "`dt_s`: time since the query before, s"),
    part(1, "step of the mission, counted from 0"),
    part(3, "own position: north, east, down, m"),
    part(3, "own velocity over the ground: north, east, down, m/s"),
    part(1, "own heading, clockwise from true north, rad"),
    part(3, "centre of the formation: north, east, down, m"),
    part(3, "velocity of the centre: north, east, down, m/s"),
    part(1, "heading of the formation's first axis, clockwise from true north, rad"),
    part(2, "radius R*, m, and γ of the ellipse"),
    part(1, "number of peers that have a row"),
    part(1, "0"),
];
/// The layout of a peer's row.
pub const PEER: [Part; 4] = [
    part(1, "id of the peer, 0 in a row without a peer"),
    part(3, "its position, extrapolated to now: north, east, down, m"),
    part(3, "its velocity: north, east, down, m/s"),
    part(1, "age of its state, s"),
];
/// The layout of a reply.
pub const REPLY: [Part; 6] = [
    part(1, "version of the protocol: 1"),
    part(2, "vehicle and tick of the query"),
    part(1, "kind: 1 is a velocity, 2 a field"),
    part(3, "the velocity north, east, down, m/s; or the field north, east, then 0"),
    part(1, "heading, clockwise from true north, rad"),
    part(1, "1 if that heading is meant, 0 if the vehicle is to keep to the mission's"),
];
/// Number of rows for peers.
pub const PEERS: usize = 15;
/// Number of values in a query.
pub const ASK: usize = sum(&QUERY) + PEERS * sum(&PEER);
/// Number of values in a reply.
pub const ANSWER: usize = sum(&REPLY);

const KIND_VELOCITY: f64 = 1.0;
const KIND_FIELD: f64 = 2.0;

/// Encodes a query.
pub fn write(ask: &LawQuery) -> Vec<u8> {
    let LawQuery { vehicle, tick, time_s, dt_s, own, peers, goal } = ask;
    let peers = nearest(own.position, peers);
    let mut values = Vec::with_capacity(ASK);
    let mut put = |part: &Part, its: &[f64]| {
        debug_assert_eq!(its.len(), part.values, "{}", part.meaning);
        values.extend_from_slice(its);
    };
    let head: [&[f64]; QUERY.len()] = [
        &[PROTOCOL as f64],
        &[vehicle.get().into()],
        &[*tick as f64],
        &[*time_s],
        &[*dt_s],
        &[goal.step as f64],
        own.position.0.as_slice(),
        own.velocity.0.as_slice(),
        &[own.heading_rad],
        goal.centre.0.as_slice(),
        goal.centre_velocity.0.as_slice(),
        &[goal.heading_rad],
        &[goal.radius_m, goal.gamma],
        &[peers.len() as f64],
        &[0.0],
    ];
    QUERY.iter().zip(head).for_each(|(part, its)| put(part, its));
    for peer in peers {
        let row: [&[f64]; PEER.len()] =
            [&[peer.id.get().into()], peer.position.0.as_slice(), peer.velocity.0.as_slice(), &[peer.age_s]];
        PEER.iter().zip(row).for_each(|(part, its)| put(part, its));
    }
    values.resize(ASK, 0.0);
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// The nearest peers, ordered by id.
fn nearest(own: PositionNed, peers: &[Neighbour]) -> Vec<&Neighbour> {
    let distance_m = |peer: &Neighbour| (peer.position - own).norm();
    let mut nearest: Vec<&Neighbour> = peers.iter().collect();
    nearest.sort_by(|one, other| distance_m(one).total_cmp(&distance_m(other)));
    nearest.truncate(PEERS);
    nearest.sort_by_key(|peer| peer.id);
    nearest
}

/// Decodes a reply.
///
/// # Errors
/// The fault of the datagram. The caller has to check that a reply answers the open query.
pub fn read(datagram: &[u8]) -> Result<LawReply, Fault> {
    let wrong_length = || Fault::Length(datagram.len(), 8 * ANSWER);
    let (chunks, []) = datagram.as_chunks::<8>() else { return Err(wrong_length()) };
    let chunks: &[[u8; 8]; ANSWER] = chunks.try_into().map_err(|_| wrong_length())?;
    let values = chunks.map(f64::from_le_bytes);
    if !values.iter().all(|value| is_sane(*value)) {
        return Err(Fault::Content("numbers are not all finite"));
    }
    let [protocol, vehicle, tick, kind, x, y, z, heading_rad, heading_is_meant] = values;
    if protocol != PROTOCOL as f64 {
        return Err(Fault::Protocol);
    }
    let vehicle = vehicle_id(whole_f64(vehicle).ok_or(Fault::Content("vehicle is not a whole number"))?)?;
    let tick = whole_f64(tick).ok_or(Fault::Content("tick is not a whole number"))?;
    let command = if kind == KIND_VELOCITY {
        ReplyCommand::VelocityNed(Vector3::new(x, y, z))
    } else if kind == KIND_FIELD {
        ReplyCommand::FieldNe(Vector2::new(x, y))
    } else {
        return Err(Fault::Content("kind is neither 1 nor 2"));
    };
    let heading_rad = (heading_is_meant == 1.0).then_some(heading_rad);
    Ok(LawReply { vehicle, tick, command, heading_rad, reached: None, log: Vec::new() })
}

#[cfg(test)]
mod tests;
