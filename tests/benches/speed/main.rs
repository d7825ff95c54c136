//! How fast Skein is on this PC: `cargo bench -p skein-tests`, or one part of it with `-- virtual`, `-- live` or `-- page`.
//!
//! | module | what it measures |
//! | --- | --- |
//! | [`virtual_time`] | flights in virtual time: processor time, memory, the cost of a study |
//! | [`networks`] | flights in virtual time over imperfect networks, against a perfect one |
//! | [`fleets`] | fleets in virtual time, over the network that they ship with and over a perfect one |
//! | [`stages`] | the stages of a vehicle's frame, by replaying what a [`swarm`] recorded |
//! | [`live`] | agents in real time over Zenoh |
//! | [`page`] | what the page of `skein view` costs the agents that it shows, and its own server |
//!
//! Times are processor time, which depends little on what else this PC does. Nothing in Skein measures itself for this: the
//! stages are called through their public interfaces.

#![expect(clippy::expect_used, reason = "a bench that cannot measure has failed")]

mod fleets;
#[cfg(target_os = "linux")]
mod live;
mod networks;
#[cfg(target_os = "linux")]
mod page;
mod stages;
mod swarm;
mod virtual_time;

use std::env;

use skein_lab::study::Study;
use skein_tests::study;

/// How long the flights of every size last, s.
const FLIGHT_S: u32 = 60;

/// The hover in one ring: R* = 12 m x N, and random starts in an area that grows with N. `sets` are further keys.
fn hover_in_one_ring(vehicles: usize, sets: &[String]) -> Study {
    let mut all = one_ring(vehicles);
    all.push(format!("duration_s={FLIGHT_S}"));
    all.extend_from_slice(sets);
    study("hover.toml", &all.iter().map(String::as_str).collect::<Vec<_>>())
}

/// The keys with which the vehicles of one ring start on it.
fn on_the_ring(vehicles: usize) -> [String; 2] {
    ["start.pattern=ring".to_owned(), format!("start.square_m={}", 24 * vehicles)]
}

/// The keys of one ring of this many vehicles.
fn one_ring(vehicles: usize) -> Vec<String> {
    let side_m = (30.0 * (vehicles as f64).sqrt()).round().max(150.0);
    vec![
        format!("swarm.vehicles={vehicles}"),
        format!("formation.radius_m={}", 12 * vehicles),
        format!("start.square_m={side_m}"),
    ]
}

/// Processor time of `work`, s, with its result.
fn processor_time_s<T>(work: impl FnOnce() -> T) -> (f64, T) {
    let now_s = || skein_cluster::os::cpu_s().expect("this system reports processor time");
    let begin_s = now_s();
    let result = work();
    (now_s() - begin_s, result)
}

/// A table with its columns aligned to the right, the first to the left.
fn print_table(rows: &[Vec<String>]) {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |nth: usize| rows.iter().filter_map(|row| row.get(nth)).map(|cell| cell.chars().count()).max();
    let widths: Vec<usize> = (0..columns).map(|nth| width(nth).unwrap_or(0)).collect();
    for row in rows {
        let cells = row.iter().zip(&widths).enumerate().map(|(nth, (cell, &width))| match nth {
            0 => format!("{cell:<width$}"),
            _ => format!("{cell:>width$}"),
        });
        println!("{}", cells.collect::<Vec<_>>().join("  ").trim_end());
    }
    println!();
}

/// The cells of a row.
fn row<const COLUMNS: usize>(cells: [&str; COLUMNS]) -> Vec<String> {
    cells.map(str::to_owned).to_vec()
}

fn main() {
    // Cargo adds `--bench`.
    let arguments: Vec<String> = env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    if let [command, vehicles, sets @ ..] = arguments.as_slice()
        && command == virtual_time::FLY_ONCE
    {
        virtual_time::fly_once(vehicles.parse().expect("a number of vehicles"), sets);
        return;
    }
    if let [command, sets @ ..] = arguments.as_slice()
        && command == fleets::FLY_FLEET_ONCE
    {
        fleets::fly_once(sets);
        return;
    }
    let is_wanted = |part: &str| arguments.is_empty() || arguments.iter().any(|argument| argument == part);
    if is_wanted("virtual") {
        virtual_time::print();
        networks::print();
        fleets::print();
        stages::print();
    }
    #[cfg(target_os = "linux")]
    for (part, print) in [("live", live::print as fn()), ("page", page::print)] {
        if is_wanted(part) {
            print();
        }
    }
    #[cfg(not(target_os = "linux"))]
    println!("the parts in real time read the processor time of agents from /proc: on Linux only");
}
