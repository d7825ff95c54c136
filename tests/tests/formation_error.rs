//! The formation's error against loss, delay and size of the swarm: cells of the golden table, flown again.

use skein::metrics::{Report, Run};
use skein::recording::Recording;
use skein_tests::formation_error::{Cell, FIGURES, cells, figures, golden, of_cell, spreads};
use skein_tests::in_parallel;

/// Fewer seeds than the golden file has, the first of the same.
const SEEDS: u64 = 3;

const fn cell(vehicles: usize, loss: f64, delay_s: f64) -> Cell {
    Cell { vehicles, loss, delay_s }
}

/// The corners, and some between.
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

/// Figures of a cell that lie farther from the golden ones than these allow.
fn off(cell: Cell, sets: &[&str]) -> Vec<String> {
    let golden = golden();
    let (_, expected) = golden.iter().find(|(known, _)| *known == cell).expect("a cell of the golden file");
    let flown = spreads(cell, sets, SEEDS);
    let is_off = |nth: &usize| !expected[*nth].allowed().contains(&flown[*nth].median);
    let text = |nth: usize| {
        let (name, flown, allowed) = (FIGURES[nth], flown[nth].median, expected[nth].allowed());
        format!("{cell:?}: {name} is {flown}, golden {allowed:?}")
    };
    (0..FIGURES.len()).filter(is_off).map(text).collect()
}

#[test]
fn the_golden_table_is_whole() {
    let golden = golden();
    assert_eq!(golden.iter().map(|(cell, _)| *cell).collect::<Vec<_>>(), cells());
    for (cell, spreads) in golden {
        for spread in spreads {
            let [least, largest] = spread.range;
            assert!(least <= spread.median && spread.median <= largest, "{cell:?}: {spread:?}");
        }
    }
}

#[test]
fn the_formations_error_is_that_of_the_golden_table() {
    let off: Vec<_> = FLOWN.iter().flat_map(|&cell| off(cell, &[])).collect();
    assert!(off.is_empty(), "{off:#?}");
}

/// One flight: its report, and how late the newest words were delivered, each time somebody looked, s.
fn delivered(cell: Cell, seed: u64) -> (Report, Vec<f64>) {
    let study = of_cell(cell, &[]);
    let mut recording = Recording::new(&study.scenario, Run::new(&study.scenario, "study"));
    let report = study.fly_watched(seed, Some((&mut recording, 1.0))).expect("a hover that may fly");
    let steps = recording.tracks.iter().flat_map(|track| &track.steps);
    (report, steps.flat_map(|step| &step.trace.peers).map(|peer| peer.delivered_age_s).collect())
}

/// The seeds differ by more than networks do: what a network does is seen seed by seed.
#[test]
fn a_network_makes_itself_felt_in_every_flight() {
    let flown = |loss, delay_s| in_parallel(0..SEEDS, |seed| delivered(cell(4, loss, delay_s), seed));
    let [perfect, late, lossy] = [(0.0, 0.0), (0.0, 2.0), (0.5, 0.0)].map(|(loss, delay_s)| flown(loss, delay_s));
    for (((perfect, on_time), (late, lateness)), (lossy, _)) in perfect.iter().zip(&late).zip(&lossy) {
        let seed = perfect.run.seed;
        assert!(!on_time.is_empty() && on_time.iter().all(|age_s| *age_s < 0.05), "seed {seed}: {on_time:?}");
        let is_late = |age_s: &f64| (1.99..2.05).contains(age_s);
        assert!(lateness.len() == on_time.len() && lateness.iter().all(is_late), "seed {seed}: {lateness:?}");
        // Words come five times a second: of every two one, so twice as old in the median, and a gap of seven at worst in
        // a hundred.
        let ages_ms = |report: &Report| [report.peer_age_p50_ms, report.peer_age_p99_ms].map(|age| age.expect("peers"));
        let ([p50, p99], [lossy_p50, lossy_p99]) = (ages_ms(perfect), ages_ms(lossy));
        let rise = (lossy_p50 / p50, lossy_p99 / p99);
        assert!((1.8..2.7).contains(&rise.0) && (6.0..9.0).contains(&rise.1), "seed {seed}: {rise:?} times as old");
        for other in [late, lossy] {
            let (perfect, other) = (figures(perfect), figures(other));
            assert!((0..FIGURES.len()).all(|nth| perfect[nth] != other[nth]), "seed {seed}: {perfect:?}, {other:?}");
        }
    }
}

#[test]
fn a_swarm_that_forgets_its_peers_at_once_is_off_the_golden_table() {
    // No more than a little longer than between two words: with half of them lost, somebody is always forgotten.
    let off = off(cell(8, 0.5, 0.0), &["network.peer_stale_s=0.21"]);
    assert!(off.iter().any(|figure| figure.contains("oscillation_m")), "{off:#?}");
}
