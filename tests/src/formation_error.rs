//! How well the ring stands in gusts, over worse and worse networks and in larger and larger swarms. The whole table is a golden file,
//! `tests/golden/formation_error.csv`; a test flies some of its cells again.

use std::ops::RangeInclusive;

use skein::metrics::Report;
use skein::study::Study;

use crate::{in_parallel, study};

/// Rows of the table.
pub const VEHICLES: [usize; 4] = [4, 8, 16, 32];
/// Share of messages that never arrive.
pub const LOSSES: [f64; 3] = [0.0, 0.2, 0.5];
/// Of every message, s.
pub const DELAYS_S: [f64; 3] = [0.0, 0.5, 2.0];
/// The figures of a cell: names as in `metrics.json`.
pub const FIGURES: [&str; 4] = ["radial_rms_m", "spacing_error_deg", "oscillation_m", "min_separation_m"];

/// One swarm over one network.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// How many fly.
    pub vehicles: usize,
    /// Share of messages that never arrive.
    pub loss: f64,
    /// Of every message, s.
    pub delay_s: f64,
}

/// A figure of a cell over its seeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Median.
    pub median: f64,
    /// Least and largest.
    pub range: [f64; 2],
}

impl Spread {
    fn of(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let (least, largest) = (values[0], values[values.len() - 1]);
        Self { median: values[values.len() / 2], range: [least, largest] }
    }

    /// Where the median of a few of the seeds has to lie: where any of them lay when the table was made, and 2 % beyond.
    pub fn allowed(&self) -> RangeInclusive<f64> {
        let [least, largest] = self.range;
        least - 0.02 * least.abs()..=largest + 0.02 * largest.abs()
    }
}

/// All cells.
pub fn cells() -> Vec<Cell> {
    let networks = || LOSSES.iter().flat_map(|&loss| DELAYS_S.map(|delay_s| (loss, delay_s)));
    let cells = |vehicles| networks().map(move |(loss, delay_s)| Cell { vehicles, loss, delay_s });
    VEHICLES.iter().flat_map(|&vehicles| cells(vehicles)).collect()
}

/// A cell: the shipped hover formation in gusts for 150 s, of which the last 100 s count. `sets` are set besides.
///
/// # Panics
/// If a set is wrong.
pub fn of_cell(cell: Cell, sets: &[&str]) -> Study {
    let Cell { vehicles, loss, delay_s } = cell;
    let own = [
        format!("swarm.vehicles={vehicles}"),
        format!("network.loss={loss}"),
        format!("network.delay_s={delay_s}"),
        // In still air everybody soon stands, and who stands needs no network.
        "world.gust_w20_m_s=5".to_owned(),
        "duration_s=150".to_owned(),
    ];
    let sets: Vec<&str> = own.iter().map(String::as_str).chain(sets.iter().copied()).collect();
    study("hover.toml", &sets)
}

/// What the table tells of a flight, in the order of [`FIGURES`].
///
/// # Panics
/// If the flight was too short.
pub fn figures(report: &Report) -> [f64; 4] {
    let figures = [report.radial_rms_m, report.spacing_error_deg, report.oscillation_m, report.min_separation_m];
    figures.map(|figure| figure.expect("several vehicles that fly for 150 s have it"))
}

/// The figures of a cell over so many seeds.
pub fn spreads(cell: Cell, sets: &[&str], seeds: u64) -> [Spread; 4] {
    let flown = in_parallel(0..seeds, |seed| figures(&of_cell(cell, sets).fly(seed).expect("a hover that may fly")));
    [0, 1, 2, 3].map(|nth| Spread::of(flown.iter().map(|figures| figures[nth]).collect()))
}

/// The golden file: of each cell and figure the median, the least and the largest of all seeds.
pub fn golden() -> Vec<(Cell, [Spread; 4])> {
    let row = |line: &str| {
        let numbers: Vec<f64> = line.split(',').map(|cell| cell.parse().expect("a number")).collect();
        let cell = Cell { vehicles: numbers[0] as usize, loss: numbers[1], delay_s: numbers[2] };
        let spread = |nth: usize| {
            let at = 3 + 3 * nth;
            Spread { median: numbers[at], range: [numbers[at + 1], numbers[at + 2]] }
        };
        (cell, [0, 1, 2, 3].map(spread))
    };
    include_str!("../golden/formation_error.csv").lines().skip(1).map(row).collect()
}

/// The whole table over so many seeds, as the golden file has it.
pub fn table(seeds: u64) -> String {
    let heads = FIGURES.iter().flat_map(|name| ["", ".least", ".largest"].map(|part| format!(",{name}{part}")));
    let mut text = format!("vehicles,loss,delay_s{}\n", heads.collect::<String>());
    for cell in cells() {
        let spreads = spreads(cell, &[], seeds);
        let numbers = spreads.iter().flat_map(|spread| [spread.median, spread.range[0], spread.range[1]]);
        let numbers: String = numbers.map(|number| format!(",{number:.4}")).collect();
        text += &format!("{},{},{}{numbers}\n", cell.vehicles, cell.loss, cell.delay_s);
    }
    text
}
