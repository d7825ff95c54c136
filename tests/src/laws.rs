//! Comparison of the control laws: one mission with a moving centre, flown by each law with more and more vehicles.

use skein_common::statistics::median;
use skein_lab::metrics::Report;

use crate::{in_parallel, study};

/// The numbers of vehicles of the table.
pub const VEHICLES: [usize; 3] = [4, 8, 16];

/// Flies the shipped mission with this law.
///
/// # Panics
/// If the flight cannot start.
pub fn fly(law: &str, vehicles: usize, seed: u64) -> Report {
    let sets = [format!("formation.law={law}"), format!("swarm.vehicles={vehicles}")];
    study("laws.toml", &sets.each_ref().map(String::as_str)).fly(seed).expect("a valid mission")
}

/// The table in Markdown over this many seeds.
pub fn markdown(laws: &[&str], vehicles: &[usize], seeds: u64) -> String {
    let mut lines = vec![
        "| law | vehicles | farthest from centre | least separation | centroid's lag | filter activations | control rms |"
            .to_owned(),
        "| --- | --- | --- | --- | --- | --- | --- |".to_owned(),
    ];
    for law in laws {
        for &vehicles in vehicles {
            let reports = in_parallel(0..seeds, |seed| fly(law, vehicles, seed));
            lines.push(row(law, vehicles, &reports));
        }
    }
    lines.join("\n")
}

fn row(law: &str, vehicles: usize, reports: &[Report]) -> String {
    let values = |figure: fn(&Report) -> Option<f64>| -> Vec<f64> { reports.iter().filter_map(figure).collect() };
    let middle = |figure| median(&mut values(figure)).unwrap_or(f64::NAN);
    let largest = |figure| values(figure).into_iter().fold(f64::NEG_INFINITY, f64::max);
    let least = |figure| values(figure).into_iter().fold(f64::INFINITY, f64::min);
    let farthest = |report: &Report| report.max_centre_distance_m;
    let separation = |report: &Report| report.min_separation_m;
    let lag = |report: &Report| report.centroid_lag_m;
    format!(
        "| {law} | {vehicles} | {:.1} [{:.1}] m | {:.1} [{:.1}] m | {:.2} [{:.2}] m | {} | {:.4} |",
        middle(farthest),
        largest(farthest),
        middle(separation),
        least(separation),
        middle(lag),
        largest(lag),
        middle(|report| report.safety_activations.map(|count| count as f64)),
        middle(|report| report.stick_rms),
    )
}
