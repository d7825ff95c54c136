//! Calculates the load of a fleet on its busiest computer and on the whole network, for each communication scheme.
//!
//! * **Central**: every simulator sends its aircraft's state to a central controller and receives its controls, each frame.
//!   The controller computes every vehicle's law: the only load that grows as N² in one place.
//! * **Mesh**: every vehicle sends to every other, as in Skein. Each computer receives from N − 1 others; the whole network
//!   carries N·(N − 1) streams.
//!
//! What a fleet of teams receives by cells is not calculated but flown: [`super::flown`].
//!
//! A message between agents is one TCP segment. It is acknowledged by the next segment in the opposite direction, if
//! one follows within the 40 ms that Linux waits, or else by a frame of its own.

use serde::Serialize;
use skein_agent::plant::xplane::wire::{dref, rpos};

use skein_cluster::capacity::{
    FRAME_HZ, Measured, MessageSize, data_output_bytes, of_datagram_bytes, of_segment_bytes,
};

/// Linux's shortest wait before it acknowledges by a segment of its own, s.
const DELAYED_ACKNOWLEDGEMENT_S: f64 = 0.04;
/// Largest fleet that is considered, vehicles.
const MANY: u32 = 10_000_000;

/// Load of a fleet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Load {
    /// Traffic received and sent by the busiest computer, bit/s on the wire.
    pub port_bit_s: [f64; 2],
    /// Cores used on the busiest computer; `None` where the system does not report processor time.
    pub cores: Option<f64>,
    /// Traffic of the whole network, bit/s on the wire.
    pub network_bit_s: f64,
}

/// A communication scheme: how the vehicles' states are shared.
#[derive(Clone, Debug, PartialEq)]
pub struct Scheme {
    /// Name of the scheme in tables and figures.
    pub name: &'static str,
    traffic: Traffic,
}

/// The messages of a scheme.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Traffic {
    /// A datagram from each simulator to a central controller, and so many back, each frame; their payloads in bytes.
    CentralDatagrams { inward_bytes: usize, outward_bytes: usize, outward_count: usize },
    /// Skein's own messages to a central controller and back, each frame.
    CentralZenoh,
    /// The states of every vehicle to every other vehicle, so many of each a second.
    Mesh(f64),
}

impl Scheme {
    /// All schemes, with the measurements. The schemes on need use the highest rate of states of all measured flights.
    pub fn all(measured: &Measured) -> Vec<Self> {
        let central = |inward_bytes, outward_bytes, outward_count| Traffic::CentralDatagrams {
            inward_bytes,
            outward_bytes,
            outward_count,
        };
        let all = [
            ("central, X-Plane's rows in, two rows back", central(data_output_bytes(7), data_output_bytes(2), 1)),
            ("central, RPOS in, four DREF back", central(rpos::SIZE, dref::SIZE, 4)),
            ("central, states in, commands back over Zenoh", Traffic::CentralZenoh),
            ("mesh, every frame", Traffic::Mesh(FRAME_HZ)),
            ("mesh, on need", Traffic::Mesh(measured.states_hz())),
        ];
        all.map(|(name, traffic)| Self { name, traffic }).to_vec()
    }

    /// Whether the scheme has a central controller.
    pub fn is_central(&self) -> bool {
        !matches!(self.traffic, Traffic::Mesh(_))
    }

    /// Calculates the load of `vehicles` vehicles.
    pub fn load(&self, measured: &Measured, vehicles: u32) -> Load {
        let count = f64::from(vehicles);
        let others = count - 1.0;
        match self.traffic {
            Traffic::CentralDatagrams { inward_bytes, outward_bytes, outward_count } => {
                let (frames, back) = (count * FRAME_HZ, outward_count as f64);
                let inward = frames * bits(of_datagram_bytes(inward_bytes));
                let outward = frames * back * bits(of_datagram_bytes(outward_bytes));
                let messages_us =
                    measured.datagram_us.map(|[send_us, receive_us]| frames * (receive_us + back * send_us));
                let cores = cores(messages_us, steps_us(measured, count, others));
                Load { port_bit_s: [inward, outward], cores, network_bit_s: inward + outward }
            }
            Traffic::CentralZenoh => {
                let messages = count * FRAME_HZ;
                let each_way = messages * message_bits(measured.state, FRAME_HZ);
                // A command is assumed to cost as much as a state. The controller has one end of each message.
                let messages_us = measured.time.message_us.map(|message_us| messages * message_us);
                let cores = cores(messages_us, steps_us(measured, count, others));
                Load { port_bit_s: [each_way; 2], cores, network_bit_s: 2.0 * each_way }
            }
            Traffic::Mesh(states_hz) => mesh(measured, count, states_hz),
        }
    }

    /// The largest fleet whose load is acceptable; 0 if even one vehicle is too many.
    pub fn most(&self, measured: &Measured, is_acceptable: impl Fn(&Load) -> bool) -> u32 {
        let (mut fits, mut does_not) = (0, MANY);
        while does_not - fits > 1 {
            let middle = fits + (does_not - fits) / 2;
            if is_acceptable(&self.load(measured, middle)) { fits = middle } else { does_not = middle }
        }
        fits
    }
}

/// The load of a mesh in which every vehicle receives the states and heartbeats of all others.
fn mesh(measured: &Measured, count: f64, states_hz: f64) -> Load {
    let (others, heartbeat_hz) = (count - 1.0, measured.heartbeat_hz);
    let link_hz = states_hz + heartbeat_hz;
    let of_one =
        states_hz * message_bits(measured.state, link_hz) + heartbeat_hz * message_bits(measured.heartbeat, link_hz);
    // As much is received as sent, because the same pairs send in both directions.
    let each_way = others * of_one;
    let messages_us = measured.time.message_us.map(|message_us| others * link_hz * message_us);
    let cores = cores(messages_us, steps_us(measured, 1.0, others));
    Load { port_bit_s: [each_way; 2], cores, network_bit_s: count * each_way }
}

/// Processor time of the steps of `vehicles` agents with `peers` peers each, µs per second.
fn steps_us(measured: &Measured, vehicles: f64, peers: f64) -> Option<f64> {
    measured.step.map(|step| vehicles * FRAME_HZ * (step.alone_us + step.per_peer_us * peers))
}

fn cores(messages_us: Option<f64>, steps_us: Option<f64>) -> Option<f64> {
    messages_us.zip(steps_us).map(|(messages_us, steps_us)| (messages_us + steps_us) * 1e-6)
}

/// Size of a message with its acknowledgement, on a link that carries `link_hz` messages a second in each direction,
/// bit.
fn message_bits(size: MessageSize, link_hz: f64) -> f64 {
    let rides = link_hz * DELAYED_ACKNOWLEDGEMENT_S >= 1.0;
    let acknowledgement = if rides { 0 } else { of_segment_bytes(0) };
    bits(of_segment_bytes(size.segment_bytes.ceil() as usize) + acknowledgement)
}

fn bits(bytes: usize) -> f64 {
    8.0 * bytes as f64
}

#[cfg(test)]
pub(super) mod tests;
