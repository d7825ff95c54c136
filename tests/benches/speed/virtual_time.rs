//! Whole flights in virtual time: processor time, memory, and the cost of a study against stepping the world directly.

use std::env;
use std::fs;
use std::num::NonZeroUsize;
use std::process::Command;

use skein_common::statistics::median;
use skein_core::helicopter::TICK_S;
use skein_lab::study::Study;
use skein_lab::world::World;
use skein_tests::study;

use crate::{FLIGHT_S, hover_in_one_ring, on_the_ring, print_table, processor_time_s, row};

/// Argument with which the bench starts itself, to measure the memory of one flight in a process of its own.
pub(super) const FLY_ONCE: &str = "fly-once";
/// Sizes of the ring.
pub(super) const SIZES: [usize; 5] = [4, 16, 64, 100, 250];
/// How often each flight is repeated, in turn with the others.
const REPEATS: usize = 5;
/// The seed of flights that have one, and the number of seeds of those that have several.
pub(super) const SEED: u64 = 1;
const SEEDS: u64 = 10;

/// A row of the table.
struct Flight {
    name: &'static str,
    study: Study,
    seeds: u64,
    /// Whether the row shows what a study of one seed costs against the world alone, and whether it shows the memory.
    has_ratio: bool,
    has_memory: bool,
    study_s: Vec<f64>,
    world_s: Vec<f64>,
}

impl Flight {
    fn new(name: &'static str, study: Study, seeds: u64) -> Self {
        Self { name, study, seeds, has_ratio: false, has_memory: false, study_s: Vec::new(), world_s: Vec::new() }
    }

    /// One seed of a swarm that flies one ring from random starts.
    fn from_random_starts(vehicles: usize) -> Self {
        let flight = Self::new("one ring, random starts", hover_in_one_ring(vehicles, &[]), 1);
        Self { has_ratio: true, has_memory: vehicles > SIZES[0], ..flight }
    }

    /// One seed of a swarm that flies one ring and starts on it; `sets` are further keys.
    fn from_the_ring(name: &'static str, vehicles: usize, sets: &[&str]) -> Self {
        let sets: Vec<_> = on_the_ring(vehicles).into_iter().chain(sets.iter().map(|&set| set.to_owned())).collect();
        Self { has_ratio: true, ..Self::new(name, hover_in_one_ring(vehicles, &sets), 1) }
    }

    /// Flies once as a study and, where that is compared, once by stepping the world.
    fn repeat(&mut self) {
        let seeds = SEED..SEED + self.seeds;
        let fly = || self.study.fly_all(seeds, NonZeroUsize::MIN, |_| {}).expect("the hover flies");
        self.study_s.push(processor_time_s(fly).0);
        if self.has_ratio {
            self.world_s.push(processor_time_s(|| step_world(&self.study)).0);
        }
    }

    fn row(&self, base_kb: f64) -> Vec<String> {
        let vehicles = self.study.scenario.swarm.vehicles;
        let duration_s = self.study.scenario.duration_s.expect("the flight has a duration");
        let vehicle_s = vehicles as f64 * duration_s * self.seeds as f64;
        let best_s = self.study_s.iter().copied().fold(f64::INFINITY, f64::min);
        let ratio = |(study_s, world_s): (&f64, &f64)| study_s / world_s;
        let ratio = median(&mut self.study_s.iter().zip(&self.world_s).map(ratio).collect::<Vec<_>>());
        let memory_kb =
            self.has_memory.then(|| (peak_memory_kb(vehicles, &[]) - base_kb) / (vehicles - SIZES[0]) as f64);
        let shown =
            |value: Option<f64>, digits: usize| value.map_or("-".to_owned(), |value| format!("{value:.digits$}"));
        vec![
            self.name.to_owned(),
            vehicles.to_string(),
            self.seeds.to_string(),
            format!("{:.0}", vehicle_s / best_s),
            format!("{:.2}", best_s * 1e6 * TICK_S / vehicle_s),
            shown(ratio, 3),
            shown(memory_kb, 1),
        ]
    }
}

/// Prints the table.
pub(super) fn print() {
    let mut flights = vec![Flight::new("hover.toml as shipped", study("hover.toml", &[]), SEEDS)];
    flights.extend(SIZES.map(|vehicles| Flight::from_the_ring("one ring", vehicles, &[])));
    flights.push(Flight::from_the_ring("one ring of point masses", 100, &["plant.model=point_mass"]));
    flights.extend(SIZES.map(Flight::from_random_starts));
    for nth in 1..=REPEATS {
        eprintln!("flights in virtual time, repeat {nth} of {REPEATS}");
        flights.iter_mut().for_each(Flight::repeat);
    }
    println!(
        "Virtual time on one core, processor time, least of {REPEATS} repeats.\n\
         One ring: R* = 12 m x N, {FLIGHT_S} s from take-off on. The vehicles of \"one ring\" start on the ring, about 75 m from\n\
         each other. With random starts they start in a square with a side of 30 m x sqrt(N) (150 m at least), in which most of them\n\
         are near each other until they have flown apart.\n"
    );
    let base_kb = peak_memory_kb(SIZES[0], &[]);
    let head =
        ["", "vehicles", "seeds", "vehicle-s per CPU-s", "us per vehicle and frame", "study / world", "kB per vehicle"];
    let rows: Vec<_> = [row(head)].into_iter().chain(flights.iter().map(|flight| flight.row(base_kb))).collect();
    print_table(&rows);
    println!(
        "study / world: `skein study --no-record` against stepping the world without figures, median of {REPEATS} pairs.\n\
         kB per vehicle: peak resident memory beyond that of {} vehicles.\n",
        SIZES[0]
    );
}

/// Steps the world of a study for as long as the study flies, without figures.
fn step_world(study: &Study) {
    let scenario = skein_common::scenario::Scenario { seed: SEED, ..study.scenario.clone() };
    let mut world = World::new(&scenario, &study.aircraft, &study.rules).expect("the hover starts");
    while !world.all_active() {
        world.tick();
    }
    (0..(f64::from(FLIGHT_S) / TICK_S).round() as u64).for_each(|_| world.tick());
}

/// Flies the study of one ring with these keys and prints the peak resident memory of this process, kB.
pub(super) fn fly_once(vehicles: usize, sets: &[String]) {
    hover_in_one_ring(vehicles, sets).fly(SEED).expect("the hover flies");
    print_peak_kb();
}

/// Prints the peak resident memory of this process, kB.
pub(super) fn print_peak_kb() {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")?.trim().strip_suffix(" kB"));
    println!("{}", peak.unwrap_or("NaN"));
}

/// Peak resident memory of a process that flies one ring with these keys, kB; NaN where the system does not report it.
pub(super) fn peak_memory_kb(vehicles: usize, sets: &[String]) -> f64 {
    let arguments: Vec<String> = [vehicles.to_string()].into_iter().chain(sets.iter().cloned()).collect();
    peak_kb_of(FLY_ONCE, &arguments)
}

/// Peak resident memory of this program with these arguments, kB; NaN where the system does not report it.
pub(super) fn peak_kb_of(command: &str, arguments: &[String]) -> f64 {
    let bench = env::current_exe().expect("the bench that runs");
    let output = Command::new(bench).arg(command).args(arguments).output().expect("the bench starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).trim().parse().expect("a number of kB")
}
