//! The table of many worlds.

use std::ops::Range;

use super::plan::FaultKind;
use super::{WorldFlight, fly};
use crate::in_parallel;

/// A figure of one flight.
type Figure<T> = fn(&WorldFlight) -> T;

/// Flies these seeds. Returns the table, and below it every seed in which an invariant was broken; with a log of the flights
/// if wanted.
pub fn table(seeds: Range<u64>, wants_log: bool) -> String {
    let flights = in_parallel(seeds, |seed| fly(seed, wants_log));
    let mut text = String::new();
    for flight in flights.iter().filter(|_| wants_log) {
        text += &format!("seed {}\n{}\n\n", flight.seed, flight.log.join("\n"));
    }
    text += &summary(&flights);
    for flight in flights.iter().filter(|flight| flight.violation.is_some()) {
        text += &format!("\n{}", failure(flight));
    }
    text
}

/// What failed in a flight: its seed, its faults and the first broken invariant.
pub fn failure(flight: &WorldFlight) -> String {
    let Some(violation) = &flight.violation else { return String::new() };
    let faults: String = flight.fault_list.iter().map(|fault| format!("  {fault}\n")).collect();
    format!(
        "seed {}: at {:.2} s broken: {}: {}\n{faults}again with a log: cargo run --release -p skein-tests --bin tables -- \
         world --first {} --seeds 1 --log\n",
        flight.seed, violation.t_s, violation.invariant, violation.what, flight.seed
    )
}

fn summary(flights: &[WorldFlight]) -> String {
    let sum = |of: fn(&WorldFlight) -> u64| flights.iter().map(of).sum::<u64>();
    let most = |of: fn(&WorldFlight) -> f64| flights.iter().map(of).fold(0.0, f64::max);
    let largest = |of: fn(&WorldFlight) -> usize| flights.iter().map(of).max().unwrap_or(0);
    let broken = flights.iter().filter(|flight| flight.violation.is_some()).count();
    let mut rows = vec![
        ("seeds".to_owned(), flights.len().to_string()),
        ("seeds with a broken invariant".to_owned(), broken.to_string()),
    ];
    for kind in FaultKind::ALL {
        let count: u32 = flights.iter().filter_map(|flight| flight.faults.get(&kind)).sum();
        rows.push((format!("fault: {}", kind.name()), count.to_string()));
    }
    let counts: [(&str, Figure<u64>); 14] = [
        ("orders given", |flight| flight.orders.into()),
        ("agents started again", |flight| flight.restarts.into()),
        ("missions flown to their end", |flight| flight.has_ended.into()),
        ("mission steps reached", |flight| flight.steps.into()),
        ("vehicles awaited at a step (P3)", |flight| flight.awaited),
        ("advances of a majority (P7)", |flight| flight.majorities),
        ("messages delivered", |flight| flight.delivered),
        ("messages of the liar", |flight| flight.lies),
        ("refused: forged, of unknown id or of another run", |flight| flight.refused.forged),
        ("refused: not signed by the operator", |flight| flight.refused.unsigned),
        ("refused: undecodable", |flight| flight.refused.undecodable),
        ("refused: of another version", |flight| flight.refused.other_version),
        ("refused: of another plan", |flight| flight.refused.other_plan),
        ("refused: old", |flight| flight.refused.old),
    ];
    rows.extend(counts.map(|(name, of)| (name.to_owned(), sum(of).to_string())));
    let sizes: [(&str, Figure<usize>); 6] = [
        ("largest inbox", |flight| flight.largest.inbox),
        ("most linked peers", |flight| flight.largest.linked),
        ("most waiting events", |flight| flight.largest.events),
        ("most waiting traces", |flight| flight.largest.traces),
        ("most kinds of refusals", |flight| flight.largest.refusals),
        ("most remembered orders", |flight| flight.largest.checked_orders),
    ];
    rows.extend(sizes.map(|(name, of)| (name.to_owned(), largest(of).to_string())));
    rows.push((
        "longest time without an agent, s".to_owned(),
        format!("{:.2}", most(|flight| flight.longest_restart_s)),
    ));
    rows.push(("longest rejoin, s".to_owned(), format!("{:.2}", most(|flight| flight.longest_rejoin_s))));
    let width = rows.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    rows.iter().map(|(name, value)| format!("{name:width$} {value:>12}\n")).collect()
}
