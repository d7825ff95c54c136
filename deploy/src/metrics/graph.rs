//! Who hears whom, as a graph: its nodes are the live members, an edge joins two who both have fresh words of each other.

use nalgebra::DMatrix;

use super::VehicleNow;
use super::series::Mean;

/// At least this long between two looks, s.
const PERIOD_S: f64 = 0.1;
/// Every so many looks one at the spectrum, which costs the most: about once a second.
const SPECTRUM_EVERY: u64 = 10;

/// What the graph was like over the window; `None` while there was nobody to join.
#[derive(Debug, Default)]
pub(super) struct Graph {
    next_s: f64,
    looks: u64,
    /// (N − components)/(N − 1).
    pub(super) union: Mean,
    /// Second-smallest eigenvalue of the Laplacian, divided by N.
    pub(super) connectivity: Mean,
    /// 1 while connected, 0 while not.
    pub(super) connected: Mean,
}

impl Graph {
    pub(super) fn observe(&mut self, t_s: f64, vehicles: &[VehicleNow]) {
        if t_s < self.next_s {
            return;
        }
        self.next_s = t_s + PERIOD_S;
        let nodes: Vec<&VehicleNow> = vehicles.iter().filter(|vehicle| vehicle.takes_part()).collect();
        let count = nodes.len();
        if count < 2 {
            return;
        }
        let joined = |one: usize, other: usize| {
            nodes[one].fresh.contains(nodes[other].id) && nodes[other].fresh.contains(nodes[one].id)
        };
        let components = components(count, joined);
        self.union.add((count - components) as f64 / (count - 1) as f64);
        self.connected.add(if components == 1 { 1.0 } else { 0.0 });
        if self.looks.is_multiple_of(SPECTRUM_EVERY) {
            self.connectivity.add(second_eigenvalue(count, joined) / count as f64);
        }
        self.looks += 1;
    }
}

/// How many parts of the graph hang together.
fn components(count: usize, joined: impl Fn(usize, usize) -> bool) -> usize {
    let mut rest: Vec<usize> = (0..count).collect();
    let mut components = 0;
    while let Some(first) = rest.pop() {
        components += 1;
        let mut reached = vec![first];
        while let Some(node) = reached.pop() {
            let neighbours = rest.extract_if(.., |other| joined(node, *other));
            reached.extend(neighbours);
        }
    }
    components
}

/// Second-smallest eigenvalue of the graph's Laplacian (M. Fiedler, "Algebraic connectivity of graphs", Czechoslovak
/// Mathematical Journal 23 (1973)): 0 if it is not connected, N if it is complete.
fn second_eigenvalue(count: usize, joined: impl Fn(usize, usize) -> bool) -> f64 {
    let mut laplacian = DMatrix::<f64>::zeros(count, count);
    for one in 0..count {
        for other in (0..one).filter(|&other| joined(one, other)) {
            laplacian[(one, other)] = -1.0;
            laplacian[(other, one)] = -1.0;
            laplacian[(one, one)] += 1.0;
            laplacian[(other, other)] += 1.0;
        }
    }
    let mut eigenvalues: Vec<f64> = laplacian.symmetric_eigenvalues().iter().copied().collect();
    eigenvalues.sort_unstable_by(f64::total_cmp);
    eigenvalues.get(1).copied().unwrap_or(0.0).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{set, vehicle};
    use super::*;

    fn edges(edges: &[(usize, usize)]) -> impl Fn(usize, usize) -> bool {
        |one, other| edges.contains(&(one, other)) || edges.contains(&(other, one))
    }

    #[test]
    fn components_are_counted() {
        assert_eq!(components(5, edges(&[])), 5);
        assert_eq!(components(5, edges(&[(0, 3), (3, 1)])), 3);
        assert_eq!(components(5, edges(&[(0, 3), (3, 1), (1, 2), (2, 4)])), 1);
    }

    #[test]
    fn eigenvalues_are_those_of_textbook_graphs() {
        let near = |count, list: &[(usize, usize)], expected: f64| {
            let value = second_eigenvalue(count, edges(list));
            assert!((value - expected).abs() < 1e-9, "{value}, expected {expected}");
        };
        near(4, &[(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)], 4.0);
        near(4, &[(0, 1), (1, 2), (2, 3)], 2.0 - 2.0_f64.sqrt());
        near(4, &[(0, 1), (0, 2), (0, 3)], 1.0);
        near(4, &[(0, 1), (2, 3)], 0.0);
    }

    #[test]
    fn an_edge_needs_both_ways_and_only_live_members_are_nodes() {
        // Three hear each other, two of them in one direction only; the fourth is dead.
        let mut vehicles = [1, 2, 3, 4].map(|number| vehicle(number, 0.0, 100.0, 30.0));
        vehicles[0].fresh = set(&[2, 3, 4]);
        vehicles[1].fresh = set(&[1, 3, 4]);
        vehicles[2].fresh = set(&[1]);
        vehicles[3].fresh = set(&[1, 2, 3]);
        vehicles[3].runs = false;
        let mut graph = Graph::default();
        graph.observe(1.0, &vehicles);
        assert_eq!((graph.union.mean(), graph.connected.mean()), (Some(1.0), Some(1.0)));
        assert!((graph.connectivity.mean().unwrap() - 1.0 / 3.0).abs() < 1e-9, "a path of three");

        graph.observe(1.05, &vehicles);
        vehicles[2].fresh = set(&[]);
        graph.observe(1.2, &vehicles);
        assert_eq!(graph.connected.mean(), Some(0.5), "not looked at 50 ms after the first");
        assert_eq!(graph.union.mean(), Some(0.75), "(3 - 2)/(3 - 1) the second time");
    }
}
