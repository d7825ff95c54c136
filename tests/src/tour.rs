//! The tour of six places over worse and worse networks: every vehicle finishes it, all at the same time.

use skein_lab::metrics::Report;

use crate::{in_parallel, median_and_worst, study};

/// Flies the shipped tour without its events.
///
/// # Panics
/// If the flight cannot start.
pub fn fly(vehicles: usize, loss: f64, delay_s: f64, seed: u64) -> Report {
    let sets = [
        format!("swarm.vehicles={vehicles}"),
        format!("network.loss={loss}"),
        format!("network.delay_s={delay_s}"),
        "mission.events=[]".to_owned(),
    ];
    let sets: Vec<_> = sets.iter().map(String::as_str).collect();
    study("tour.toml", &sets).fly(seed).expect("a valid tour")
}

/// The table over numbers of vehicles, losses and delays (s), over this many seeds.
pub fn table(vehicles: &[usize], losses: &[f64], delays_s: &[f64], seeds: u64) -> String {
    let mut lines = vec![format!(
        "{:>8} {:>5} {:>7} {:>7} {:>9} {:>5} {:>10} {:>7} {:>17} {:>15} {:>10}",
        "vehicles",
        "loss",
        "delay s",
        "flights",
        "finished",
        "skew",
        "suspicions",
        "forced",
        "latency s",
        "mission s",
        "closest m"
    )];
    for &n in vehicles {
        for &loss in losses {
            for &delay_s in delays_s {
                let reports = in_parallel(0..seeds, |seed| fly(n, loss, delay_s, seed));
                lines.push(format!("{n:>8} {loss:>5.2} {delay_s:>7.1} {}", row(&reports)));
            }
        }
    }
    lines.join("\n")
}

/// Number of places of the tour; after the last one every vehicle lands.
pub const PLACES: u64 = 6;

fn row(reports: &[Report]) -> String {
    let finished = reports.iter().filter(|report| report.setpoints_reached == Some(PLACES)).count();
    let most = |figure: fn(&Report) -> Option<u64>| reports.iter().filter_map(figure).max().unwrap_or(0);
    let sum = |figure: fn(&Report) -> Option<u64>| reports.iter().filter_map(figure).sum::<u64>();
    let closest_m = reports.iter().filter_map(|report| report.min_separation_m).fold(f64::INFINITY, f64::min);
    format!(
        "{:>7} {finished:>9} {:>5} {:>10} {:>7} {:>17} {:>15} {closest_m:>10.1}",
        reports.len(),
        most(|report| report.setpoint_skew),
        sum(|report| report.false_suspicions),
        sum(|report| report.forced_advances),
        median_and_worst(reports.iter().map(|report| report.advance_latency_s)),
        median_and_worst(reports.iter().map(|report| Some(report.duration_s))),
    )
}
