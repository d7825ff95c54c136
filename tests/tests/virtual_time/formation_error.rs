//! Formation error over loss, delay and size of the swarm: cells of the golden table, flown again.

use skein_lab::metrics::{Report, Run};
use skein_lab::recording::Recording;
use skein_tests::formation_error::{
    self, Cell, FIGURES, FormationErrorFlight, cells, figures, flights, golden, of_cell,
};
use skein_tests::in_parallel;

/// Number of seeds: the first ones of the golden file.
const SEEDS: u64 = 3;

const fn cell(vehicles: usize, loss: f64, delay_s: f64) -> Cell {
    Cell { vehicles, loss, delay_s }
}

/// The corners of the table, and some cells between them.
const FLOWN: [Cell; 8] = [
    cell(4, 0.0, 0.0),
    cell(4, 0.2, 0.5),
    cell(4, 0.5, 2.0),
    cell(8, 0.0, 2.0),
    cell(8, 0.2, 0.5),
    cell(8, 0.5, 0.0),
    cell(8, 0.5, 2.0),
    cell(16, 0.5, 2.0),
];

#[test]
fn the_golden_table_is_complete() {
    let golden: Vec<(Cell, u64)> = golden().iter().map(|flight| (flight.cell, flight.seed)).collect();
    let expected = cells().into_iter().flat_map(|cell| (0..formation_error::SEEDS).map(move |seed| (cell, seed)));
    assert_eq!(golden, expected.collect::<Vec<_>>());
}

#[test]
fn the_formation_error_equals_the_golden_table_to_the_bit() {
    let golden = golden();
    for cell in FLOWN {
        let expected: Vec<FormationErrorFlight> =
            golden.iter().filter(|flight| flight.cell == cell && flight.seed < SEEDS).copied().collect();
        assert_eq!(flights(cell, &[], SEEDS), expected);
    }
}

/// One flight: its report, and the delivery delay of the peers' newest states in every recorded step, s.
fn delivered(cell: Cell, seed: u64) -> (Report, Vec<f64>) {
    let study = of_cell(cell, &[]);
    let mut recording = Recording::new(&study.scenario, Run::new(&study.scenario, "study"));
    let report = study.fly_watched(seed, Some((&mut recording, 1.0))).expect("a valid hover");
    let steps = recording.tracks.iter().flat_map(|track| &track.steps);
    (report, steps.flat_map(|step| &step.trace.peers).map(|peer| peer.delivered_age_s).collect())
}

/// The seeds differ more than the networks, therefore the test compares networks for each seed.
#[test]
fn every_network_changes_the_figures_of_every_flight() {
    let flown = |loss, delay_s| in_parallel(0..SEEDS, |seed| delivered(cell(4, loss, delay_s), seed));
    let [perfect, late, lossy] = [(0.0, 0.0), (0.0, 2.0), (0.5, 0.0)].map(|(loss, delay_s)| flown(loss, delay_s));
    for (((perfect, on_time), (late, lateness)), (lossy, _)) in perfect.iter().zip(&late).zip(&lossy) {
        let seed = perfect.run.seed;
        assert!(!on_time.is_empty() && on_time.iter().all(|age_s| *age_s < 0.05), "seed {seed}: {on_time:?}");
        let is_late = |age_s: &f64| (1.99..2.05).contains(age_s);
        assert!(lateness.len() == on_time.len() && lateness.iter().all(is_late), "seed {seed}: {lateness:?}");
        // States are sent five times a second. If half of them are lost, the median age nearly doubles, and one gap in
        // a hundred has seven lost states. All ages include up to two frames for sending and receiving.
        let ages_ms = |report: &Report| [report.peer_age_p50_ms, report.peer_age_p99_ms].map(|age| age.expect("peers"));
        let ([p50, p99], [lossy_p50, lossy_p99]) = (ages_ms(perfect), ages_ms(lossy));
        let rise = (lossy_p50 / p50, lossy_p99 / p99);
        assert!((1.6..2.3).contains(&rise.0) && (5.0..7.5).contains(&rise.1), "seed {seed}: {rise:?} times as old");
        for other in [late, lossy] {
            let (perfect, other) = (figures(perfect), figures(other));
            assert!((0..FIGURES.len()).all(|nth| perfect[nth] != other[nth]), "seed {seed}: {perfect:?}, {other:?}");
        }
    }
}

#[test]
fn a_swarm_with_a_very_short_staleness_limit_differs_from_the_golden_table() {
    // The limit is hardly longer than the time between two states: with half of the states lost, some peer of each
    // vehicle is always stale.
    let cell = cell(8, 0.5, 0.0);
    let golden = golden();
    for flown in flights(cell, &["network.peer_stale_s=0.21"], SEEDS) {
        let expected =
            golden.iter().find(|flight| flight.cell == cell && flight.seed == flown.seed).expect("a golden flight");
        assert!(flown.figures[2] > 1.02 * expected.figures[2], "oscillation: {flown:?}, golden {expected:?}");
    }
}
