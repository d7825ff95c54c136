//! The formation's error against loss, delay and size of the swarm: cells of the golden table, flown again.

use skein_tests::formation_error::{Cell, FIGURES, cells, golden, spreads};

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

#[test]
fn a_swarm_that_forgets_its_peers_at_once_is_off_the_golden_table() {
    // No more than a little longer than between two words: with half of them lost, somebody is always forgotten.
    let off = off(cell(8, 0.5, 0.0), &["network.peer_stale_s=0.21"]);
    assert!(off.iter().any(|figure| figure.contains("oscillation_m")), "{off:#?}");
}
