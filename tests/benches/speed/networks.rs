//! What an imperfect network costs in virtual time: each row against the perfect network of the same run.

use std::num::NonZeroUsize;
use std::ops::RangeInclusive;

use skein_lab::study::Study;

use crate::virtual_time::{SEED, peak_memory_kb};
use crate::{FLIGHT_S, hover_in_one_ring, print_table, processor_time_s, row};

/// Sizes of the ring.
const SIZES: [usize; 4] = [4, 16, 100, 250];
/// How often each flight is repeated, in turn with the others.
const REPEATS: usize = 5;
/// A network: name and keys, in which LOW and HIGH are the ids of the two halves of the swarm.
type Network = (&'static str, &'static [&'static str]);
/// The networks, the perfect one first.
const NETWORKS: [Network; 9] = [
    ("perfect", &[]),
    ("loss 5 %", &["network.loss=0.05"]),
    ("delay 0.1 s", &["network.delay_s=0.1"]),
    ("delay 0.1 s, jitter 20 ms", &["network.delay_s=0.1", "network.jitter_s=0.02"]),
    ("loss 5 % in bursts of 0.5 s", &["network.loss=0.05", "network.burst_s=0.5"]),
    ("range 300 m", &["network.range_m=300"]),
    ("states of the nearest six", &["network.graph=nearest", "network.neighbours=6"]),
    (
        "halves cut apart from 20 to 40 s",
        &["mission.events=[{ at_s = 20, for_s = 20, fault = 'cut', from = LOW, to = HIGH, both_ways = true }]"],
    ),
    (
        "all of them",
        &[
            "network.loss=0.05",
            "network.burst_s=0.5",
            "network.delay_s=0.1",
            "network.jitter_s=0.02",
            "network.range_m=300",
            "network.graph=nearest",
            "network.neighbours=6",
        ],
    ),
];

/// The keys of a network, for a ring that starts in a square with a side of its radius.
fn keys(vehicles: usize, network: &[&str]) -> Vec<String> {
    let square = format!("start.square_m={}", (12 * vehicles).max(150));
    let ids = |ids: RangeInclusive<usize>| format!("{:?}", Vec::from_iter(ids));
    let [low, high] = [1..=vehicles / 2, vehicles / 2 + 1..=vehicles].map(ids);
    let of_network = network.iter().map(|key| key.replace("LOW", &low).replace("HIGH", &high));
    [square].into_iter().chain(of_network).collect()
}

/// The flights of one size, one for each network.
struct Ring {
    vehicles: usize,
    flights: Vec<Flight>,
}

/// The flight over one network, and the processor time of each repeat, s.
struct Flight {
    network: &'static Network,
    study: Study,
    times_s: Vec<f64>,
}

impl Ring {
    fn new(vehicles: usize) -> Self {
        let flight = |network: &'static Network| {
            let study = hover_in_one_ring(vehicles, &keys(vehicles, network.1));
            Flight { network, study, times_s: Vec::new() }
        };
        Self { vehicles, flights: NETWORKS.iter().map(flight).collect() }
    }

    fn repeat(&mut self) {
        for Flight { study, times_s, .. } in &mut self.flights {
            let fly = || study.fly_all(SEED..SEED + 1, NonZeroUsize::MIN, |_| {}).expect("the hover flies");
            times_s.push(processor_time_s(fly).0);
        }
    }

    fn rows(&self, base_kb: f64) -> Vec<Vec<String>> {
        let least_s = |flight: &Flight| flight.times_s.iter().copied().fold(f64::INFINITY, f64::min);
        let perfect_s = self.flights.first().map_or(f64::NAN, least_s);
        let of_flight = |flight: &Flight| {
            let Flight { network: (name, network), study, .. } = flight;
            let duration_s = study.scenario.duration_s.expect("the flight has a duration");
            let best_s = least_s(flight);
            let memory_kb = peak_memory_kb(self.vehicles, &keys(self.vehicles, network));
            let more = self.vehicles.saturating_sub(SIZES[0]);
            vec![
                (*name).to_owned(),
                self.vehicles.to_string(),
                format!("{:.0}", self.vehicles as f64 * duration_s / best_s),
                format!("{:.2}", best_s / perfect_s),
                if more == 0 { "-".to_owned() } else { format!("{:.1}", (memory_kb - base_kb) / more as f64) },
            ]
        };
        self.flights.iter().map(of_flight).collect()
    }
}

/// Prints the table.
pub(super) fn print() {
    let mut rings = SIZES.map(Ring::new);
    for nth in 1..=REPEATS {
        eprintln!("imperfect networks, repeat {nth} of {REPEATS}");
        rings.iter_mut().for_each(Ring::repeat);
    }
    println!(
        "Imperfect networks: one ring, R* = 12 m x N, {FLIGHT_S} s from take-off on, started in a square with a side of R*.\n\
         Processor time, least of {REPEATS} repeats.\n"
    );
    let base_kb = peak_memory_kb(SIZES[0], &keys(SIZES[0], &[]));
    let head = ["", "vehicles", "vehicle-s per CPU-s", "times perfect", "kB per vehicle"];
    let rows: Vec<_> = [row(head)].into_iter().chain(rings.iter().flat_map(|ring| ring.rows(base_kb))).collect();
    print_table(&rows);
    println!(
        "times perfect: processor time against that over the perfect network.\n\
         kB per vehicle: peak resident memory beyond that of {} vehicles over a perfect network.\n",
        SIZES[0]
    );
}
