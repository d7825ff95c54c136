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
pub(super) mod tests {
    use skein_cluster::capacity::{MessageTime, StateRate, StepTime};

    use super::*;

    /// Measurements in round numbers: a state of 100 bytes takes 190 on the wire, a heartbeat of 60 takes 150, an
    /// acknowledgement 90.
    pub(in super::super) fn measured() -> Measured {
        let rate = |flight, states_hz| StateRate { flight, vehicles: 4, states_hz, nearest_pair_m: Some(100.0) };
        Measured {
            machine: "a test".to_owned(),
            when: "20260101T000000Z".to_owned(),
            state: MessageSize { encoded_bytes: 70, segment_bytes: 100.0 },
            heartbeat: MessageSize { encoded_bytes: 30, segment_bytes: 60.0 },
            heartbeat_hz: 5.0,
            time: MessageTime { message_us: Some(40.0), deliveries: 1 },
            datagram_us: Some([6.0, 2.0]),
            state_rates: vec![rate("hover", 5.0), rate("flock", 10.0)],
            step: Some(StepTime { alone_us: 2.0, per_peer_us: 0.5 }),
        }
    }

    fn load(scheme: &Scheme, vehicles: u32) -> Load {
        scheme.load(&measured(), vehicles)
    }

    fn sending(traffic: Traffic, vehicles: u32) -> Load {
        load(&Scheme { name: "", traffic }, vehicles)
    }

    fn near(one: f64, other: f64) {
        assert!((one / other - 1.0).abs() < 1e-12, "{one}, not {other}");
    }

    #[test]
    fn a_central_controller_receives_and_answers_every_vehicle_each_frame() {
        let schemes = Scheme::all(&measured());
        let rows = load(&schemes[0], 10);
        near(rows.port_bit_s[0], 10.0 * 50.0 * 323.0 * 8.0);
        // 77 bytes of rows are 143 on the wire.
        near(rows.port_bit_s[1], 10.0 * 50.0 * 143.0 * 8.0);
        near(rows.network_bit_s, 10.0 * 50.0 * 466.0 * 8.0);
        near(rows.cores.unwrap(), 10.0 * 50.0 * (2.0 + 6.0 + 2.0 + 0.5 * 9.0) * 1e-6);
        let datarefs = load(&schemes[1], 10);
        near(datarefs.port_bit_s[1], 10.0 * 50.0 * 4.0 * 575.0 * 8.0);
        let messages = sending(Traffic::CentralZenoh, 10);
        near(messages.port_bit_s[0], 10.0 * 50.0 * 190.0 * 8.0);
        near(messages.cores.unwrap(), 10.0 * 50.0 * (40.0 + 2.0 + 0.5 * 9.0) * 1e-6);
    }

    #[test]
    fn in_a_mesh_each_vehicle_receives_all_others_and_the_network_carries_all_pairs() {
        let every_frame = Traffic::Mesh(50.0);
        let ten = sending(every_frame, 10);
        // Nine others, each with fifty states and five heartbeats that acknowledge each other.
        near(ten.port_bit_s[0], 9.0 * (50.0 * 190.0 + 5.0 * 150.0) * 8.0);
        near(ten.network_bit_s, 10.0 * ten.port_bit_s[0]);
        near(ten.cores.unwrap(), (9.0 * 55.0 * 40.0 + 50.0 * (2.0 + 0.5 * 9.0)) * 1e-6);
        let on_need = sending(Traffic::Mesh(5.0), 10);
        // So rare that every message is acknowledged by a frame of its own.
        near(on_need.port_bit_s[0], 9.0 * 5.0 * (190.0 + 90.0 + 150.0 + 90.0) * 8.0);
        near(sending(every_frame, 1).port_bit_s[0] + 1.0, 1.0);
    }

    #[test]
    fn the_largest_fleet_is_the_last_that_fits() {
        let measured = measured();
        for scheme in Scheme::all(&measured) {
            for limit in [1e6, 1e8, 1e9] {
                let fits = |load: &Load| load.network_bit_s <= limit;
                let most = scheme.most(&measured, fits);
                assert!(most == 0 || fits(&scheme.load(&measured, most)), "{scheme:?} {limit}");
                assert!(!fits(&scheme.load(&measured, most + 1)), "{scheme:?} {limit}");
            }
        }
        // 1 Gbit/s of 323-byte frames at 50 Hz.
        let rows = &Scheme::all(&measured)[0];
        assert_eq!(rows.most(&measured, |load| load.port_bit_s[0] <= 1e9), 7_739);
    }
}
