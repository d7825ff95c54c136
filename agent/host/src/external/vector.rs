//! Queries and replies as vectors of little-endian f64, one datagram each, for programs without JSON such as Simulink.
//!
//! | query, 144 values | | reply, 9 values | |
//! | --- | --- | --- | --- |
//! | 1-6 | protocol 1, vehicle, tick, time_s, dt_s, step | 1-3 | protocol 1, vehicle, tick |
//! | 7-9, 10-12, 13 | own position, velocity, heading | 4, 5-7 | kind (1 velocity NED, 2 field NE, 0), its values |
//! | 14-16, 17-19, 20, 21, 22 | centre, centre velocity, goal heading, radius_m, gamma | 8, 9 | heading_rad, 1 if set |
//! | 23, 24, then 25 + 8k | number of peers n, 0; id, position, velocity, age_s | | k = 0..14 |
//!
//! Indices count from 1. Unused rows of peers are zero. Of more than 15 peers the nearest have a row, ordered by id.

use nalgebra::{Vector2, Vector3};

use super::protocol::{Fault, PROTOCOL, is_sane, vehicle_id, whole_f64};
use skein_core::formation::external::{LawQuery, LawReply, PeerState, ReplyCommand};

/// Number of values in a query.
pub const ASK: usize = 144;
/// Number of values in a reply.
pub const ANSWER: usize = 9;
/// Number of rows for peers.
const PEERS: usize = 15;

const KIND_VELOCITY: f64 = 1.0;
const KIND_FIELD: f64 = 2.0;

/// Encodes a query.
pub fn write(ask: &LawQuery) -> Vec<u8> {
    let LawQuery { vehicle, tick, time_s, dt_s, own, peers, goal } = ask;
    let peers = nearest(own.position_ned_m.into(), peers);
    let mut values = Vec::with_capacity(ASK);
    values.extend([PROTOCOL as f64, vehicle.get().into(), *tick as f64, *time_s, *dt_s, goal.step as f64]);
    values.extend(own.position_ned_m.iter().chain(&own.velocity_ned_m_s));
    values.push(own.heading_rad);
    values.extend(goal.centre_ned_m.iter().chain(&goal.centre_velocity_ned_m_s));
    values.extend([goal.heading_rad, goal.radius_m, goal.gamma, peers.len() as f64, 0.0]);
    for peer in peers {
        values.push(peer.id.get().into());
        values.extend(peer.position_ned_m.iter().chain(&peer.velocity_ned_m_s));
        values.push(peer.age_s);
    }
    values.resize(ASK, 0.0);
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// The nearest peers, ordered by id.
fn nearest(own_m: Vector3<f64>, peers: &[PeerState]) -> Vec<&PeerState> {
    let distance_m = |peer: &PeerState| (Vector3::from(peer.position_ned_m) - own_m).norm();
    let mut nearest: Vec<&PeerState> = peers.iter().collect();
    nearest.sort_by(|one, other| distance_m(one).total_cmp(&distance_m(other)));
    nearest.truncate(PEERS);
    nearest.sort_by_key(|peer| peer.id);
    nearest
}

/// Decodes a reply.
///
/// # Errors
/// What is wrong with the datagram. The caller has to check that a reply answers the open query.
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
