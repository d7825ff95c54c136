//! Central control compared with a controller on each vehicle, in short: a row for each question, a column for each
//! number of vehicles.

use skein_common::statistics::median;

use crate::central::{Case, CentralCell, CentralFlight};

/// The loss at which the rows about a single network compare the two, without delay.
const LOSS: f64 = 0.3;

/// A question, and its answer for the cells of one number of vehicles.
type Row = (&'static str, fn(&Cells<'_>) -> String);

const ROWS: [Row; 10] = [
    ("in formation at the end, no failure: decentralised, central", |cells| {
        format!("{}, {}", cells.in_formation(false, false), cells.in_formation(true, false))
    }),
    ("the same, one agent killed: decentralised", |cells| cells.in_formation(false, true)),
    ("the same, central controller killed: central", |cells| cells.in_formation(true, true)),
    ("crashed within 180 s, one agent killed: decentralised", |cells| cells.crashed(false)),
    ("crashed within 180 s, central controller killed: central", |cells| cells.crashed(true)),
    ("radial rms, no failure, 30 % loss: decentralised, central", |cells| {
        cells.both(|flight| flight.report.radial_rms_m, " m")
    }),
    ("spacing error, the same", |cells| cells.both(|flight| flight.report.spacing_error_deg, "°")),
    ("least separation, no failure: decentralised, central", |cells| {
        format!("{}, {}", cells.least_separation(false, false), cells.least_separation(true, false))
    }),
    ("least separation, one agent killed: decentralised", |cells| cells.least_separation(false, true)),
    ("messages delivered or sent a second, 0 % loss: decentralised, central", |cells| {
        format!("{}, {}", cells.traffic(false), cells.traffic(true))
    }),
];

/// The cells of one number of vehicles.
struct Cells<'a>(Vec<&'a CentralCell>);

impl Cells<'_> {
    /// The flights of one kind over every network, each with its case.
    fn flights(&self, central: bool, killed: bool) -> impl Iterator<Item = (&Case, &CentralFlight)> {
        let cells = self.0.iter().filter(move |cell| (cell.case.central, cell.case.killed) == (central, killed));
        cells.flat_map(|cell| cell.flights.iter().map(|flight| (&cell.case, flight)))
    }

    /// The flights of one kind without a kill over the network with this loss and no delay.
    fn over(&self, central: bool, loss: f64) -> impl Iterator<Item = (&Case, &CentralFlight)> {
        self.flights(central, false).filter(move |(case, _)| (case.loss, case.delay_s) == (loss, 0.0))
    }

    /// Least and largest share of vehicles of a flight that were in formation at the end.
    fn in_formation(&self, central: bool, killed: bool) -> String {
        let share = |(case, flight): (&Case, &CentralFlight)| flight.in_formation as f64 / case.vehicles as f64;
        let shares: Vec<f64> = self.flights(central, killed).map(share).collect();
        let least = shares.iter().copied().fold(f64::INFINITY, f64::min);
        let largest = shares.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let percent = |share: f64| format!("{}", (1e3 * share).round() / 10.0);
        match (percent(least), percent(largest)) {
            (least, largest) if least == largest => format!("{least} %"),
            (least, largest) => format!("{least} to {largest} %"),
        }
    }

    /// Number of vehicles that crashed in all flights with a kill, of those that flew.
    fn crashed(&self, central: bool) -> String {
        let (mut crashes, mut vehicles) = (0, 0);
        for (case, flight) in self.flights(central, true) {
            crashes += flight.report.crashes;
            vehicles += case.vehicles;
        }
        format!("{crashes} of {vehicles}")
    }

    /// Median of a figure under each kind of control, over the network with [`LOSS`].
    fn both(&self, figure: fn(&CentralFlight) -> Option<f64>, unit: &str) -> String {
        let median = |central| {
            let mut values: Vec<f64> = self.over(central, LOSS).filter_map(|(_, flight)| figure(flight)).collect();
            median(&mut values).unwrap_or(f64::NAN)
        };
        format!("{:.2}{unit}, {:.2}{unit}", median(false), median(true))
    }

    /// Least separation of a pair in all flights of one kind.
    fn least_separation(&self, central: bool, killed: bool) -> String {
        let separations_m = self.flights(central, killed).filter_map(|(_, flight)| flight.report.min_separation_m);
        format!("{:.1} m", separations_m.fold(f64::INFINITY, f64::min))
    }

    /// Mean traffic over the perfect network.
    fn traffic(&self, central: bool) -> String {
        let sent: Vec<(f64, f64)> = self.over(central, 0.0).map(|(case, flight)| flight.sent(case)).collect();
        let mean = |part: fn(&(f64, f64)) -> f64| sent.iter().map(part).sum::<f64>() / sent.len() as f64;
        format!("{:.0} ({:.0} kB)", mean(|sent| sent.0), mean(|sent| sent.1))
    }
}

/// The table in Markdown.
pub fn markdown(cells: &[CentralCell]) -> String {
    let mut vehicles: Vec<usize> = cells.iter().map(|cell| cell.case.vehicles).collect();
    vehicles.dedup();
    let numbers = vehicles.iter().map(|n| format!(" N = {n} |")).collect::<String>();
    let mut lines = vec![format!("| |{numbers}"), format!("| --- |{}", " --- |".repeat(vehicles.len()))];
    let columns: Vec<Cells<'_>> =
        vehicles.iter().map(|&n| Cells(cells.iter().filter(|cell| cell.case.vehicles == n).collect())).collect();
    for (question, answer) in ROWS {
        lines.push(format!("| {question} | {} |", columns.iter().map(answer).collect::<Vec<_>>().join(" | ")));
    }
    lines.join("\n")
}
