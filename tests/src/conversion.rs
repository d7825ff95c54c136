//! Linear and nonlinear conversions of the field into metres, compared in situations that favour one or the other.

use skein_lab::metrics::Report;
use skein_lab::study::{FigureSummary, rounded, summarize};

use crate::{in_parallel, study};

/// Head of the table; the last five columns are the conversions.
const HEAD: &str = "| situation | flights | figure | linear 7 | linear 28 | linear 56 | 7→28 | 7→56 |";

/// Settings of each conversion, in the order of the columns; `None` leaves the column empty.
type Conversions = [Option<&'static [&'static str]>; 5];

const LINEAR_7: &[&str] = &["formation.conversion=linear", "formation.gain_m=7"];
const LINEAR_28: &[&str] = &["formation.conversion=linear", "formation.gain_m=28"];
const LINEAR_56: &[&str] = &["formation.conversion=linear", "formation.gain_m=56"];

const ALL: Conversions =
    [Some(LINEAR_7), Some(LINEAR_28), Some(LINEAR_56), Some(&[]), Some(&["formation.far_gain_m=56"])];
/// Those of `sinusoid.toml`, which has a nonlinear conversion of its own.
const SINUSOID: Conversions = [Some(LINEAR_7), Some(LINEAR_28), Some(LINEAR_56), None, Some(&[])];

/// A scenario with settings, and the figures that its rows have.
struct Situation {
    name: &'static str,
    scenario: &'static str,
    sets: &'static [&'static str],
    /// Most flights of each conversion.
    most: u64,
    /// Keys of `metrics.json`, each with its name in the table.
    figures: &'static [(&'static str, &'static str)],
    conversions: Conversions,
}

const IN_BAND: (&str, &str) = ("in_band_s", "in the band for good, s");
const EVEN: (&str, &str) = ("even_10deg_s", "even to 10°, s");
const RADIAL: (&str, &str) = ("radial_rms_m", "radial rms, m");
const OSCILLATION: (&str, &str) = ("oscillation_m", "oscillation, m");
const SEPARATION: (&str, &str) = ("min_separation_m", "least separation, m");
const FARTHEST: (&str, &str) = ("max_centre_distance_m", "farthest from centre, m");
const TILT: (&str, &str) = ("max_tilt_deg", "largest tilt, °");
/// Shown as the number of swarms that reached their place.
const REACHED: (&str, &str) = ("setpoints_reached", "swarms that reached their place");

const fn hover(
    name: &'static str,
    sets: &'static [&'static str],
    most: u64,
    figures: &'static [(&'static str, &'static str)],
) -> Situation {
    Situation { name, scenario: "hover.toml", sets, most, figures, conversions: ALL }
}

const SITUATIONS: [Situation; 10] = [
    hover("hover", &[], u64::MAX, &[IN_BAND, EVEN, RADIAL, SEPARATION, TILT]),
    hover(
        "wind and gusts, 5 m/s each",
        &["world.wind_m_s=5", "world.gust_w20_m_s=5"],
        u64::MAX,
        &[EVEN, RADIAL, OSCILLATION],
    ),
    hover("positions in single precision", &["sensing.position=f32_latlon"], 20, &[EVEN, OSCILLATION]),
    hover("loss 30 %, delay 1 s", &["network.loss=0.3", "network.delay_s=1"], 20, &[EVEN]),
    hover("no auto-trim", &["control.auto_trim=false"], 20, &[RADIAL]),
    hover("8 vehicles", &["swarm.vehicles=8"], 20, &[EVEN]),
    hover(
        "16 vehicles, no safety filter",
        &["swarm.vehicles=16", "formation.safety_filter=none"],
        8,
        &[EVEN, SEPARATION],
    ),
    hover(
        "starts within 60 m by 60 m, no safety filter",
        &["start.square_m=60", "formation.safety_filter=none"],
        20,
        &[SEPARATION],
    ),
    Situation {
        name: "`flock.toml`",
        scenario: "flock.toml",
        sets: &[],
        most: 20,
        figures: &[FARTHEST, SEPARATION],
        conversions: ALL,
    },
    Situation {
        name: "`sinusoid.toml`; last column as shipped, 3.5→56",
        scenario: "sinusoid.toml",
        sets: &[],
        most: u64::MAX,
        figures: &[IN_BAND, EVEN, OSCILLATION, REACHED],
        conversions: SINUSOID,
    },
];

/// The table in Markdown over this many seeds, fewer where a situation takes long.
pub fn markdown(seeds: u64) -> String {
    let mut lines = vec![HEAD.to_owned(), format!("|{}", " --- |".repeat(HEAD.matches(" |").count()))];
    SITUATIONS.iter().for_each(|situation| lines.extend(rows(situation, seeds.min(situation.most))));
    lines.join("\n")
}

/// The rows of a situation.
fn rows(situation: &Situation, seeds: u64) -> Vec<String> {
    let Situation { name, scenario, sets, figures, conversions, .. } = situation;
    let summaries = conversions.map(|conversion| {
        let sets: Vec<&str> = sets.iter().chain(conversion?).copied().collect();
        let study = study(scenario, &sets);
        Some(in_parallel(0..seeds, |seed| study.fly(seed).expect("a shipped scenario flies")))
    });
    let cell = |key: &str, flown: &Option<Vec<Report>>| {
        let Some(reports) = flown else { return String::new() };
        if key == REACHED.0 {
            let reached = reports.iter().filter(|report| report.setpoints_reached >= Some(1)).count();
            return format!("{reached} of {seeds}");
        }
        summarize(reports).get(key).map_or_else(|| "-".to_owned(), median_and_worst)
    };
    let row = |(nth, (key, label)): (usize, &(&str, &str))| {
        let (name, flights) = if nth == 0 { (*name, seeds.to_string()) } else { ("", String::new()) };
        let cells = summaries.iter().map(|flown| cell(key, flown)).collect::<Vec<_>>().join(" | ");
        format!("| {name} | {flights} | {label} | {cells} |")
    };
    figures.iter().enumerate().map(row).collect()
}

/// `median [worst]`, or the number of flights that never came to a value in the place of the worst.
fn median_and_worst(figure: &FigureSummary) -> String {
    let median = figure.median.map_or_else(|| "never".to_owned(), rounded);
    match figure.worst.filter(|_| figure.never == 0) {
        Some(worst) => format!("{median} [{}]", rounded(worst)),
        None => format!("{median} [{} never]", figure.never),
    }
}
