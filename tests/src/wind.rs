//! Helicopters without faults in wind: in none of these flights does an agent detect a failure and land, and every ring
//! is spaced as evenly as in calm air.

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::fmt;

use skein_common::id::VehicleId;
use skein_common::message::{EventKind, Failure};
use skein_common::scenario::{Scenario, Source, load};
use skein_common::state::Activity;
use skein_core::formation::laws::built_in;
use skein_core::random::{self, Purpose};
use skein_lab::metrics::Report;
use skein_lab::world::World;

use crate::{in_parallel, median_and_worst, of_scenario, study};

/// Length of each flight, s.
const DURATION_S: f64 = 120.0;
/// Number of ticks between two checks of the altitudes.
const LOOK_TICKS: u64 = 5;
/// A vehicle is off its altitude if it is farther from it than this, m, and approaches it more slowly than
/// [`NEARING_M_S`].
const OFF_M: f64 = 2.5;
/// Speed below which a vehicle does not approach its altitude, m/s.
const NEARING_M_S: f64 = 1.0;
/// The wind of the strongest flights, m/s.
pub const STRONGEST_M_S: f64 = 10.0;

const STARTS: [&str; 3] = ["random", "ring", "line"];

/// Result of one flight without faults.
#[derive(Clone, Debug, Default)]
pub struct WindFlight {
    /// Mean wind, m/s.
    pub wind_m_s: f64,
    /// Number of vehicles.
    pub vehicles: usize,
    /// Failures that agents reported although the vehicles had none: time, s, vehicle and failure.
    pub failures: Vec<(f64, VehicleId, Failure)>,
    /// Longest uninterrupted time for which a vehicle in formation was off its altitude by more than 2.5 m and
    /// approached it at less than 1 m/s, s.
    pub longest_off_s: f64,
    /// That vehicle, the end of that time, s, and the vehicle's distance below its altitude then, m.
    pub longest_off: Option<(VehicleId, f64, f64)>,
}

impl fmt::Display for WindFlight {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let failures = self.failures.iter().map(|(t_s, id, failure)| format!("{t_s:.1} s vehicle {id}: {failure}"));
        write!(f, "{}", failures.collect::<Vec<_>>().join(", "))
    }
}

/// A flight without faults. The seed decides its wind of up to `wind_m_s`, gusts, size, height, start, law and mission.
///
/// # Panics
/// If the scenario is not valid.
pub fn scenario(seed: u64, wind_m_s: f64) -> Scenario {
    let mut generator = random::generator(seed, None, Purpose::Study);
    let mut uniform = |from: f64, to: f64| from + (to - from) * random::uniform(&mut generator);
    let vehicles = uniform(3.0, 9.0) as usize;
    let altitude_m = uniform(20.0, 60.0);
    let wind_m_s = uniform(0.0, wind_m_s);
    let gust_w20_m_s = uniform(0.0, wind_m_s.max(1.0));
    let from_deg = uniform(0.0, TAU).to_degrees();
    let laws = built_in();
    let law = laws[uniform(0.0, laws.len() as f64) as usize];
    let start = STARTS[uniform(0.0, STARTS.len() as f64) as usize];
    let radius_m = uniform(40.0, 100.0);
    let higher_m = uniform(3.5 - altitude_m, 30.0).max(-15.0) + altitude_m;
    let (north_m, east_m, speed_m_s) = (uniform(-120.0, 120.0), uniform(-120.0, 120.0), uniform(1.0, 4.0));
    let steps = [
        // A hover, a second place at another height, and a moving centre.
        "{ centre_ne_m = [0, 0] }".to_owned(),
        format!(
            "{{ hold_s = 40 }}, {{ centre_ne_m = [{north_m}, {east_m}], formation = {{ altitude_m = {higher_m} }} }}"
        ),
        format!("{{ hold_s = 30 }}, {{ path_ne_m = [[0, 0], [{north_m}, {east_m}]], speed_m_s = {speed_m_s} }}"),
    ];
    let steps = &steps[uniform(0.0, steps.len() as f64) as usize];
    let text = format!(
        r#"
        name = "wind"
        seed = {seed}
        duration_s = {DURATION_S}
        swarm.vehicles = {vehicles}
        start.pattern = "{start}"
        formation = {{ law = "{law}", altitude_m = {altitude_m}, radius_m = {radius_m} }}
        world = {{ wind_m_s = {wind_m_s}, wind_from_deg = {from_deg}, gust_w20_m_s = {gust_w20_m_s} }}
        mission.steps = [{steps}]
        "#
    );
    load(&Source { name: "wind", text: &text }, &[]).expect("a valid scenario").scenario
}

/// Flies the scenario.
///
/// # Panics
/// If the flight cannot start.
pub fn fly(scenario: Scenario) -> WindFlight {
    let study = of_scenario(scenario);
    let mut world = World::new(&study.scenario, &study.aircraft, &study.rules).expect("a valid scenario");
    let (wind_m_s, vehicles) = (study.scenario.world.wind_m_s, study.scenario.swarm.vehicles);
    let mut flight = WindFlight { wind_m_s, vehicles, ..WindFlight::default() };
    let mut off_s: BTreeMap<VehicleId, f64> = BTreeMap::new();
    let mut tick = 0;
    while world.t_s() < DURATION_S {
        world.tick();
        tick += 1;
        let t_s = world.t_s();
        for (id, what) in world.events() {
            if let EventKind::Failed(failure) = what {
                flight.failures.push((t_s, id, failure));
            }
        }
        if tick % LOOK_TICKS != 0 {
            continue;
        }
        for trace in world.traces().filter(|trace| trace.activity == Activity::Formation) {
            let error_m = trace.altitude_setpoint_m - trace.position.altitude_m();
            let nearing_m_s = -trace.velocity.down_m_s() * error_m.signum();
            let is_off = error_m.abs() > OFF_M && nearing_m_s < NEARING_M_S;
            let off_s = off_s.entry(trace.header.sender).or_default();
            *off_s = if is_off { *off_s + LOOK_TICKS as f64 * skein_core::helicopter::TICK_S } else { 0.0 };
            if *off_s > flight.longest_off_s {
                flight.longest_off_s = *off_s;
                flight.longest_off = Some((trace.header.sender, t_s, error_m));
            }
        }
    }
    flight
}

/// The table of this many flights without faults, by wind; then every flight in which an agent reported a failure.
pub fn table(seeds: u64) -> String {
    let flights = in_parallel(0..seeds, |seed| fly(scenario(seed, STRONGEST_M_S)));
    let mut lines =
        vec![format!("{:>8} {:>7} {:>8} {:>8} {:>14}", "wind m/s", "flights", "vehicles", "failures", "longest off s")];
    for from_m_s in [0.0, 2.0, 4.0, 6.0, 8.0] {
        let of = |flight: &&WindFlight| (from_m_s..from_m_s + 2.0).contains(&flight.wind_m_s);
        lines.push(row(&format!("{from_m_s:.0} to {:.0}", from_m_s + 2.0), flights.iter().filter(of)));
    }
    lines.push(row("all", flights.iter()));
    for (seed, flight) in flights.iter().enumerate().filter(|(_, flight)| !flight.failures.is_empty()) {
        lines.push(format!("seed {seed}, {:.1} m/s: {flight}", flight.wind_m_s));
    }
    let mut longest: Vec<_> = flights.iter().enumerate().collect();
    longest.sort_by(|(_, one), (_, other)| other.longest_off_s.total_cmp(&one.longest_off_s));
    for (seed, WindFlight { wind_m_s, longest_off_s, longest_off, .. }) in longest.into_iter().take(5) {
        let Some((id, until_s, below_m)) = longest_off else { continue };
        lines.push(format!(
            "seed {seed}, {wind_m_s:.1} m/s: vehicle {id} off its altitude for {longest_off_s:.1} s until {until_s:.1} s, \
             then {below_m:.1} m below it"
        ));
    }
    lines.join("\n")
}

fn row<'a>(wind: &str, flights: impl Iterator<Item = &'a WindFlight>) -> String {
    let (mut count, mut vehicles, mut failures, mut longest_off_s) = (0, 0, 0, 0.0_f64);
    for flight in flights {
        count += 1;
        vehicles += flight.vehicles;
        failures += flight.failures.len();
        longest_off_s = longest_off_s.max(flight.longest_off_s);
    }
    format!("{wind:>8} {count:>7} {vehicles:>8} {failures:>8} {longest_off_s:>14.1}")
}

/// Winds and gusts of the shipped hover, m/s: (mean wind, W20 of the gusts).
pub const HOVERS: [(f64, f64); 12] = [
    (0.0, 0.0),
    (5.0, 0.0),
    (5.0, 5.0),
    (8.0, 0.0),
    (8.0, 5.0),
    (10.0, 0.0),
    (10.0, 5.0),
    (12.0, 0.0),
    (12.0, 5.0),
    (14.0, 0.0),
    (16.0, 0.0),
    (18.0, 0.0),
];

/// One shipped hover in wind, from a direction that the seed sets.
///
/// # Panics
/// If the flight cannot start.
pub fn hover(wind_m_s: f64, gust_w20_m_s: f64, seed: u64) -> Report {
    let from_deg = (seed * 37) % 360;
    let sets = [
        format!("world.wind_m_s={wind_m_s}"),
        format!("world.wind_from_deg={from_deg}"),
        format!("world.gust_w20_m_s={gust_w20_m_s}"),
    ];
    let sets: Vec<&str> = sets.iter().map(String::as_str).collect();
    study("hover.toml", &sets).fly(seed).expect("a valid hover")
}

/// The table of the shipped hover in stronger and stronger wind.
pub fn hovers(seeds: u64) -> String {
    let mut lines = vec![format!(
        "{:>8} {:>8} {:>7} {:>24} {:>24} {:>24} {:>17} {:>17} {:>17}",
        "wind m/s",
        "gust m/s",
        "flights",
        "at altitude s",
        "in band s",
        "even to 10° s",
        "radial rms m",
        "spacing error °",
        "altitude rms m"
    )];
    for (wind_m_s, gust_w20_m_s) in HOVERS {
        let reports = in_parallel(0..seeds, |seed| hover(wind_m_s, gust_w20_m_s, seed));
        let of = |figure: fn(&Report) -> Option<f64>| median_and_worst(reports.iter().map(figure));
        lines.push(format!(
            "{wind_m_s:>8.0} {gust_w20_m_s:>8.0} {:>7} {:>24} {:>24} {:>24} {:>17} {:>17} {:>17}",
            reports.len(),
            of(|report| report.at_altitude_s),
            of(|report| report.in_band_s),
            of(|report| report.even_10deg_s),
            of(|report| report.radial_rms_m),
            of(|report| report.spacing_error_deg),
            of(|report| report.altitude_rms_m),
        ));
    }
    lines.join("\n")
}
