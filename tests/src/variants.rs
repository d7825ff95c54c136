//! The hover formation with imperfect sensors, and with point masses.

use skein_common::statistics::median;
use skein_lab::metrics::Report;

use crate::{in_parallel, study};

/// Rows of the table: what flies, and its keys.
pub const VARIANTS: [(&str, &[&str]); 14] = [
    ("helicopter, exact sensors", &[]),
    ("satellite receiver and inertial unit", &[SATELLITE]),
    ("the same, four times as bad", &[FOUR_TIMES]),
    (
        "the same as the second, 0.1 s late, 2 % dropouts of 0.1 s",
        &[SATELLITE, "sensing.latency_s=0.1", SHORT[0], SHORT[1]],
    ),
    ("position white, 0.3 m", &["sensing.noise={ position_m = 0.3, altitude_m = 0.3 }"]),
    ("velocity white, 0.3 m/s", &["sensing.noise.velocity_m_s=0.3"]),
    ("heading 5° off", &["sensing.bias.heading_deg=5"]),
    ("roll and pitch 1° off", &["sensing.bias.attitude_deg=1"]),
    ("0.1 s late", &["sensing.latency_s=0.1"]),
    ("0.2 s late", &["sensing.latency_s=0.2"]),
    ("20 % of the frames missing", &["sensing.dropout=0.2"]),
    ("2 % missing, for 0.5 s each", &["sensing.dropout=0.02", "sensing.dropout_s=0.5"]),
    ("point mass", &["plant.model=point_mass"]),
    (
        "point mass without lag and limit of acceleration",
        &[
            "plant.model=point_mass",
            "plant.point_mass.lag_s=0",
            "plant.point_mass.turn_lag_s=0",
            "plant.point_mass.max_acceleration_m_s2=none",
        ],
    ),
];

/// What the navigation of a small vehicle leaves of the errors of a satellite receiver and an inertial unit.
const SATELLITE: &str = "sensing={ correlation_s = 30, noise = { position_m = 1, altitude_m = 1.5, velocity_m_s = 0.1, \
                         attitude_deg = 0.3, heading_deg = 1, rate_deg_s = 0.5 }, bias = { heading_deg = 2 } }";
const FOUR_TIMES: &str = "sensing={ correlation_s = 30, noise = { position_m = 4, altitude_m = 6, velocity_m_s = 0.4, \
                          attitude_deg = 1.2, heading_deg = 4, rate_deg_s = 2 }, bias = { heading_deg = 8 } }";
const SHORT: [&str; 2] = ["sensing.dropout=0.02", "sensing.dropout_s=0.1"];

/// Flies the shipped hover with these keys.
///
/// # Panics
/// If the flight cannot start.
pub fn fly(keys: &[&str], seed: u64) -> Report {
    study("hover.toml", keys).fly(seed).expect("a valid scenario")
}

/// The table in Markdown over this many seeds.
pub fn markdown(variants: &[(&str, &[&str])], seeds: u64) -> String {
    let mut lines = vec![
        "| what flies | even to 10° | radial rms | spacing error | altitude rms | least separation | crashes |"
            .to_owned(),
        "| --- | --- | --- | --- | --- | --- | --- |".to_owned(),
    ];
    for (name, keys) in variants {
        let reports = in_parallel(0..seeds, |seed| fly(keys, seed));
        lines.push(row(name, &reports));
    }
    lines.join("\n")
}

fn row(name: &str, reports: &[Report]) -> String {
    let cell = |figure: fn(&Report) -> Option<f64>, unit: &str, is_less_worse: bool| {
        let mut values: Vec<f64> = reports.iter().filter_map(figure).collect();
        let worst = values.iter().copied().reduce(if is_less_worse { f64::min } else { f64::max });
        let never = reports.len() - values.len();
        let never = if never > 0 { format!(", {never} never") } else { String::new() };
        match median(&mut values).zip(worst) {
            Some((median, worst)) => format!("{median:.2} [{worst:.2}] {unit}{never}"),
            None => "never".to_owned(),
        }
    };
    let crashes: u64 = reports.iter().map(|report| report.crashes + report.collisions).sum();
    format!(
        "| {name} | {} | {} | {} | {} | {} | {crashes} |",
        cell(|report| report.even_10deg_s, "s", false),
        cell(|report| report.radial_rms_m, "m", false),
        cell(|report| report.spacing_error_deg, "°", false),
        cell(|report| report.altitude_rms_m, "m", false),
        cell(|report| report.min_separation_m, "m", true),
    )
}
