//! Error of the ring formation in gusts, over worse and worse networks and in larger and larger swarms. The golden file
//! `tests/golden/formation_error.csv` has every flight of the table to the last bit; a test flies some of them again.

use skein_lab::metrics::Report;
use skein_lab::study::Study;

use crate::{in_parallel, study};

/// Numbers of vehicles: rows of the table.
pub const VEHICLES: [usize; 4] = [4, 8, 16, 32];
/// Share of messages that are lost.
pub const LOSSES: [f64; 3] = [0.0, 0.2, 0.5];
/// Delay of every message, s.
pub const DELAYS_S: [f64; 3] = [0.0, 0.5, 2.0];
/// The figures of a flight: names as in `metrics.json`.
pub const FIGURES: [&str; 4] = ["radial_rms_m", "spacing_error_deg", "oscillation_m", "min_separation_m"];
/// Number of seeds of each cell of the table.
pub const SEEDS: u64 = 5;

/// One swarm over one network.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Number of vehicles.
    pub vehicles: usize,
    /// Share of messages that are lost.
    pub loss: f64,
    /// Delay of every message, s.
    pub delay_s: f64,
}

/// One flight of a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FormationErrorFlight {
    /// The swarm and the network.
    pub cell: Cell,
    /// The seed.
    pub seed: u64,
    /// The figures, in the order of [`FIGURES`].
    pub figures: [f64; 4],
}

/// All cells, in the order of the table.
pub fn cells() -> Vec<Cell> {
    let networks = || LOSSES.iter().flat_map(|&loss| DELAYS_S.map(|delay_s| (loss, delay_s)));
    let cells = |vehicles| networks().map(move |(loss, delay_s)| Cell { vehicles, loss, delay_s });
    VEHICLES.iter().flat_map(|&vehicles| cells(vehicles)).collect()
}

/// The study of a cell: the shipped hover formation in gusts for 150 s, of which the last 100 s count. `sets` are
/// further settings.
///
/// # Panics
/// If a setting is not valid.
pub fn of_cell(cell: Cell, sets: &[&str]) -> Study {
    let Cell { vehicles, loss, delay_s } = cell;
    let own = [
        format!("swarm.vehicles={vehicles}"),
        format!("network.loss={loss}"),
        format!("network.delay_s={delay_s}"),
        // In calm air every vehicle soon hovers in its place and hardly needs the network.
        "world.gust_w20_m_s=5".to_owned(),
        "duration_s=150".to_owned(),
    ];
    let sets: Vec<&str> = own.iter().map(String::as_str).chain(sets.iter().copied()).collect();
    study("hover.toml", &sets)
}

/// The figures of a flight, in the order of [`FIGURES`].
///
/// # Panics
/// If the flight was too short.
pub fn figures(report: &Report) -> [f64; 4] {
    let figures = [report.radial_rms_m, report.spacing_error_deg, report.oscillation_m, report.min_separation_m];
    figures.map(|figure| figure.expect("several vehicles that fly for 150 s have it"))
}

/// The flights of a cell with the seeds below `seeds`.
pub fn flights(cell: Cell, sets: &[&str], seeds: u64) -> Vec<FormationErrorFlight> {
    in_parallel(0..seeds, |seed| {
        let report = of_cell(cell, sets).fly(seed).expect("a valid hover");
        FormationErrorFlight { cell, seed, figures: figures(&report) }
    })
}

/// The flights of the golden file.
pub fn golden() -> Vec<FormationErrorFlight> {
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |nth: usize| cells[nth].parse::<f64>().expect("a number");
        FormationErrorFlight {
            cell: Cell { vehicles: number(0) as usize, loss: number(1), delay_s: number(2) },
            seed: number(3) as u64,
            figures: [4, 5, 6, 7].map(number),
        }
    };
    include_str!("../golden/formation_error.csv").lines().skip(1).map(row).collect()
}

/// The whole table in the format of the golden file: a row for each flight, every figure with all its digits.
pub fn csv() -> String {
    let mut text = format!("vehicles,loss,delay_s,seed,{}\n", FIGURES.join(","));
    for cell in cells() {
        for flight in flights(cell, &[], SEEDS) {
            let figures = flight.figures.map(|figure| figure.to_string()).join(",");
            text += &format!("{},{},{},{},{figures}\n", cell.vehicles, cell.loss, cell.delay_s, flight.seed);
        }
    }
    text
}

/// The table of the documentation: for each network and number of vehicles the medians of the radial rms and of the
/// spacing error.
pub fn markdown(flights: &[FormationErrorFlight]) -> String {
    let median = |cell: Cell, figure: usize| {
        let mut values: Vec<f64> =
            flights.iter().filter(|flight| flight.cell == cell).map(|flight| flight.figures[figure]).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let numbers = VEHICLES.map(|vehicles| vehicles.to_string()).join(" | ").replacen(" |", " vehicles |", 1);
    let mut text = format!("| loss | delay | {numbers} |\n");
    text += &format!("| --- | --- |{}\n", " --- |".repeat(VEHICLES.len()));
    for loss in LOSSES {
        for delay_s in DELAYS_S {
            let shown = VEHICLES.map(|vehicles| {
                let cell = Cell { vehicles, loss, delay_s };
                format!(" {:.2} m, {:.1}° |", median(cell, 0), median(cell, 1))
            });
            text += &format!("| {:.0} % | {delay_s} s |{}\n", 100.0 * loss, shown.concat());
        }
    }
    text
}
