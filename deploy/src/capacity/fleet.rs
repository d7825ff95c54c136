//! What a fleet asks of its busiest machine and of the whole network, for each way to share what vehicles know.
//!
//! * **Central**: every simulator tells one machine how its aircraft is, and gets its controls back, each frame. That machine
//!   computes every vehicle's law: the only load that grows as N² in one place.
//! * **Mesh**: every vehicle tells every other, as Skein does. Each machine hears N − 1 others; all together the network
//!   carries N·(N − 1) streams.
//! * **By cells**: states go only to those in the own cell and the eight around it. The agreement still goes to everybody.
//!   (The keys carry the cells; agents subscribe to all of them today.)
//!
//! Words between agents go over TCP, a segment each. A segment is acknowledged by the next that goes the other way, if there is one
//! within the 40 ms that Linux waits, or else by a frame of its own.

use serde::Serialize;
use skein_agent::plant::xplane::wire::{dref, rpos};
use skein_common::math;
use skein_common::topic::Cell;

use super::measure::Measured;
use super::message_cost::{FRAME_HZ, MessageSize};
use super::wire::{data_output_bytes, of_datagram_bytes, of_segment_bytes};

/// Linux's least wait before it acknowledges by a segment of its own, s.
const DELAYED_ACKNOWLEDGEMENT_S: f64 = 0.04;
/// A fleet that fits by any reckoning is not counted further.
const MANY: u32 = 10_000_000;

/// What a fleet asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Load {
    /// What the busiest machine hears, and what it says, bit/s of wire.
    pub port_bit_s: [f64; 2],
    /// Cores of the busiest machine; `None` where the system does not tell processor time.
    pub cores: Option<f64>,
    /// What the whole network carries, bit/s of wire.
    pub network_bit_s: f64,
}

/// How what vehicles know is shared.
#[derive(Clone, Debug, PartialEq)]
pub enum Scheme {
    /// Datagrams to one machine and back, each frame.
    CentralDatagrams {
        /// What they are.
        name: &'static str,
        /// Payload from each simulator, bytes.
        inward_bytes: usize,
        /// Payload of each datagram back, bytes.
        outward_bytes: usize,
        /// How many go back.
        outward_count: usize,
    },
    /// Words of our own to one machine and back, each frame.
    CentralZenoh,
    /// Everybody's states to everybody.
    Mesh {
        /// When they are said.
        name: &'static str,
        /// States of one vehicle a second.
        states_hz: f64,
    },
    /// Everybody's states to those near by.
    Cells {
        /// States of one vehicle a second.
        states_hz: f64,
        /// How many others are in the nine cells at most.
        near: f64,
    },
}

impl Scheme {
    /// All of them, with what was measured; on need as often as in the flight with the most to say.
    pub fn all(measured: &Measured) -> Vec<Self> {
        let data = Self::CentralDatagrams {
            name: "central, X-Plane's rows in, two rows back",
            inward_bytes: data_output_bytes(7),
            outward_bytes: data_output_bytes(2),
            outward_count: 1,
        };
        let datarefs = Self::CentralDatagrams {
            name: "central, RPOS in, four DREF back",
            inward_bytes: rpos::SIZE,
            outward_bytes: dref::SIZE,
            outward_count: 4,
        };
        let every_frame = Self::Mesh { name: "mesh, every frame", states_hz: FRAME_HZ };
        let states_hz = measured.talk.iter().map(|talk| talk.states_hz).fold(0.0, f64::max);
        let on_need = Self::Mesh { name: "mesh, on need", states_hz };
        // As dense as the hover, if that went on and on.
        let apart_m = measured.talk.first().and_then(|talk| talk.nearest_pair_m);
        let near = apart_m.map(|apart_m| (9.0 * math::square(Cell::SIDE_M / apart_m)).round());
        let by_cells = near.map(|near| Self::Cells { states_hz, near });
        [data, datarefs, Self::CentralZenoh, every_frame, on_need].into_iter().chain(by_cells).collect()
    }

    /// For tables.
    pub fn name(&self) -> String {
        match self {
            Self::CentralDatagrams { name, .. } | Self::Mesh { name, .. } => (*name).to_owned(),
            Self::CentralZenoh => "central, states in, commands back over Zenoh".to_owned(),
            Self::Cells { near, .. } => format!("mesh, on need, by cells, {near} near by"),
        }
    }

    /// Whether one machine stands in the middle.
    pub fn is_central(&self) -> bool {
        match self {
            Self::CentralDatagrams { .. } | Self::CentralZenoh => true,
            Self::Mesh { .. } | Self::Cells { .. } => false,
        }
    }

    /// What so many vehicles ask for.
    pub fn load(&self, measured: &Measured, vehicles: u32) -> Load {
        let count = f64::from(vehicles);
        let others = count - 1.0;
        match *self {
            Self::CentralDatagrams { inward_bytes, outward_bytes, outward_count, .. } => {
                let (frames, back) = (count * FRAME_HZ, outward_count as f64);
                let inward = frames * bits(of_datagram_bytes(inward_bytes));
                let outward = frames * back * bits(of_datagram_bytes(outward_bytes));
                let talk = measured.datagram_us.map(|[send_us, receive_us]| frames * (receive_us + back * send_us));
                let cores = cores(talk, steps_us(measured, count, others));
                Load { port_bit_s: [inward, outward], cores, network_bit_s: inward + outward }
            }
            Self::CentralZenoh => {
                let words = count * FRAME_HZ;
                let each_way = words * message_bits(measured.state, FRAME_HZ);
                // A command is taken to cost what a state does; each end of a word falls here once.
                let talk = measured.time.message_us.map(|message_us| words * message_us);
                let cores = cores(talk, steps_us(measured, count, others));
                Load { port_bit_s: [each_way; 2], cores, network_bit_s: 2.0 * each_way }
            }
            Self::Mesh { states_hz, .. } => mesh(measured, count, others, states_hz),
            Self::Cells { states_hz, near } => mesh(measured, count, near.min(others), states_hz),
        }
    }

    /// The largest fleet whose load is bearable; none if a fleet of one is not.
    pub fn most(&self, measured: &Measured, is_bearable: impl Fn(&Load) -> bool) -> u32 {
        let (mut fits, mut does_not) = (0, MANY);
        while does_not - fits > 1 {
            let middle = fits + (does_not - fits) / 2;
            if is_bearable(&self.load(measured, middle)) { fits = middle } else { does_not = middle }
        }
        fits
    }
}

/// A mesh in which everybody hears the states of `near` others, and everybody's part in the agreement.
fn mesh(measured: &Measured, count: f64, near: f64, states_hz: f64) -> Load {
    let (others, heartbeat_hz) = (count - 1.0, measured.heartbeat_hz);
    let near_hz = states_hz + heartbeat_hz;
    let of_near =
        states_hz * message_bits(measured.state, near_hz) + heartbeat_hz * message_bits(measured.register, near_hz);
    let of_far = heartbeat_hz * message_bits(measured.register, heartbeat_hz);
    // As much is heard as said: the same pairs, the other way.
    let each_way = near * of_near + (others - near) * of_far;
    let words = near * states_hz + others * heartbeat_hz;
    let talk = measured.time.message_us.map(|message_us| words * message_us);
    let cores = cores(talk, steps_us(measured, 1.0, near));
    Load { port_bit_s: [each_way; 2], cores, network_bit_s: count * each_way }
}

/// Steps of `vehicles` agents that know so many peers, µs of processor in a second.
fn steps_us(measured: &Measured, vehicles: f64, peers: f64) -> Option<f64> {
    measured.step.map(|step| vehicles * FRAME_HZ * (step.alone_us + step.per_peer_us * peers))
}

fn cores(talk_us: Option<f64>, steps_us: Option<f64>) -> Option<f64> {
    talk_us.zip(steps_us).map(|(talk_us, steps_us)| (talk_us + steps_us) * 1e-6)
}

/// A word on a link that carries as many words a second each way, with its acknowledgement, bit.
fn message_bits(word: MessageSize, link_hz: f64) -> f64 {
    let rides = link_hz * DELAYED_ACKNOWLEDGEMENT_S >= 1.0;
    let acknowledgement = if rides { 0 } else { of_segment_bytes(0) };
    bits(of_segment_bytes(word.segment_bytes.ceil() as usize) + acknowledgement)
}

fn bits(bytes: usize) -> f64 {
    8.0 * bytes as f64
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::measure::{StateRate, StepTime};
    use super::super::message_cost::MessageTime;
    use super::*;

    /// Round numbers: a state of 100 bytes takes 190 of wire, a register of 60 takes 150, an acknowledgement 90.
    pub(in super::super) fn measured() -> Measured {
        let talk = |flight, states_hz| StateRate { flight, vehicles: 4, states_hz, nearest_pair_m: Some(100.0) };
        Measured {
            machine: "a test".to_owned(),
            when: "20260101T000000Z".to_owned(),
            state: MessageSize { encoded_bytes: 70, segment_bytes: 100.0 },
            register: MessageSize { encoded_bytes: 30, segment_bytes: 60.0 },
            heartbeat_hz: 5.0,
            time: MessageTime { message_us: Some(40.0), deliveries: 1 },
            datagram_us: Some([6.0, 2.0]),
            talk: vec![talk("hover", 5.0), talk("flock", 10.0)],
            step: Some(StepTime { alone_us: 2.0, per_peer_us: 0.5 }),
        }
    }

    fn load(scheme: &Scheme, vehicles: u32) -> Load {
        scheme.load(&measured(), vehicles)
    }

    fn near(one: f64, other: f64) {
        assert!((one / other - 1.0).abs() < 1e-12, "{one}, not {other}");
    }

    #[test]
    fn a_central_machine_hears_and_answers_every_vehicle_each_frame() {
        let schemes = Scheme::all(&measured());
        let rows = load(&schemes[0], 10);
        near(rows.port_bit_s[0], 10.0 * 50.0 * 323.0 * 8.0);
        // 77 bytes of rows are 143 on the wire.
        near(rows.port_bit_s[1], 10.0 * 50.0 * 143.0 * 8.0);
        near(rows.network_bit_s, 10.0 * 50.0 * 466.0 * 8.0);
        near(rows.cores.unwrap(), 10.0 * 50.0 * (2.0 + 6.0 + 2.0 + 0.5 * 9.0) * 1e-6);
        let datarefs = load(&schemes[1], 10);
        near(datarefs.port_bit_s[1], 10.0 * 50.0 * 4.0 * 575.0 * 8.0);
        let words = load(&Scheme::CentralZenoh, 10);
        near(words.port_bit_s[0], 10.0 * 50.0 * 190.0 * 8.0);
        near(words.cores.unwrap(), 10.0 * 50.0 * (40.0 + 2.0 + 0.5 * 9.0) * 1e-6);
    }

    #[test]
    fn in_a_mesh_everybody_hears_all_others_and_the_network_carries_all_pairs() {
        let every_frame = Scheme::Mesh { name: "", states_hz: 50.0 };
        let ten = load(&every_frame, 10);
        // Nine others, each with fifty states and five registers that acknowledge each other.
        near(ten.port_bit_s[0], 9.0 * (50.0 * 190.0 + 5.0 * 150.0) * 8.0);
        near(ten.network_bit_s, 10.0 * ten.port_bit_s[0]);
        near(ten.cores.unwrap(), (9.0 * 55.0 * 40.0 + 50.0 * (2.0 + 0.5 * 9.0)) * 1e-6);
        let on_need = load(&Scheme::Mesh { name: "", states_hz: 5.0 }, 10);
        // So seldom that every word is acknowledged by itself.
        near(on_need.port_bit_s[0], 9.0 * 5.0 * (190.0 + 90.0 + 150.0 + 90.0) * 8.0);
        near(load(&every_frame, 1).port_bit_s[0] + 1.0, 1.0);
    }

    #[test]
    fn by_cells_only_the_agreement_comes_from_everybody() {
        let schemes = Scheme::all(&measured());
        let cells = schemes.last().unwrap();
        assert_eq!(*cells, Scheme::Cells { states_hz: 10.0, near: 900.0 }, "one in every 100 m by 100 m, on 9 km²");
        let (few, many) = (load(cells, 901), load(cells, 1901));
        assert_eq!(few, load(&Scheme::Mesh { name: "", states_hz: 10.0 }, 901), "all of them near by");
        near(many.port_bit_s[0] - few.port_bit_s[0], 1000.0 * 5.0 * (150.0 + 90.0) * 8.0);
        near(many.cores.unwrap() - few.cores.unwrap(), 1000.0 * 5.0 * 40.0 * 1e-6);
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
