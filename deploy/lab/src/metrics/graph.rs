//! The communication graph: its nodes are the live members, and an edge joins two members that both have a fresh state
//! of each other.
//!
//! SwarmLab (E. Soria, F. Schiano, D. Floreano, "SwarmLab: a Matlab drone swarm simulator", IROS 2020) takes the edges
//! from distances, and joins two vehicles if one of them sees the other. Vásárhelyi et al. ("Optimized flocking of
//! autonomous drones in confined environments", Science Robotics 3, 2018) join two vehicles that are nearer than their
//! law's forces reach. Here the graph is the network that the swarm really had, the same for every law.

use nalgebra::{DMatrix, Vector3};

use super::VehicleNow;
use super::series::Mean;
use super::steady::{Column, SwarmSeries};

/// Number of observations for each computation of the spectrum, about one a second, in a swarm of up to [`SPECTRUM_OF`] members.
const SPECTRUM_EVERY: u64 = 10;
/// The spectrum costs the cube of the members, so it is computed less often in a larger swarm.
const SPECTRUM_OF: usize = 50;

/// Means of the graph over the window; `None` while there were fewer than two members.
#[derive(Debug, Default)]
pub(super) struct Graph {
    observations: u64,
    /// (N − components)/(N − 1).
    pub(super) union: Mean,
    /// Second-smallest eigenvalue of the Laplacian, divided by N.
    pub(super) connectivity: Mean,
    /// Share of time in which the graph is connected.
    pub(super) connected: Mean,
    /// Number of members without an edge: Vásárhelyi's φ^disc.
    pub(super) disconnected: Mean,
    /// Number of members of the smallest component, 1 for a member without an edge: Vásárhelyi's N_min.
    pub(super) smallest: Mean,
    /// Reused memory: the components, and the direction of flight of each node.
    components: Components,
    directions: Vec<Option<Vector3<f64>>>,
    spectrum: Spectrum,
}

impl Graph {
    /// Observes all vehicles. The nodes are the live members, as indices of the vehicles; so are `moving`, those of them
    /// that move, each with its direction of flight.
    pub(super) fn observe(
        &mut self,
        series: &mut SwarmSeries,
        vehicles: &[VehicleNow],
        nodes: &[usize],
        moving: &[(usize, Vector3<f64>)],
    ) {
        let Self { components, directions, spectrum, .. } = self;
        let count = nodes.len();
        if count < 2 {
            return;
        }
        let mut moving = moving.iter().peekable();
        directions.clear();
        directions.extend(nodes.iter().map(|node| Some(moving.next_if(|(nth, _)| nth == node)?.1)));
        let joined = |one: usize, other: usize| {
            let (one, other) = (&vehicles[nodes[one]], &vehicles[nodes[other]]);
            one.fresh.contains(other.id) && other.fresh.contains(one.id)
        };
        components.find(count, joined);
        let sizes = &components.sizes;
        self.union.add((count - sizes.len()) as f64 / (count - 1) as f64);
        self.connected.add(f64::from(sizes.len() == 1));
        self.disconnected.add(sizes.iter().filter(|&&size| size == 1).count() as f64);
        self.smallest.add(sizes.iter().copied().min().unwrap_or(count) as f64);
        series.set(Column::Correlation, components.correlation(|node| directions[node]));
        if self.observations.is_multiple_of(SPECTRUM_EVERY * count.div_ceil(SPECTRUM_OF) as u64) {
            self.connectivity.add(spectrum.second_eigenvalue(count, joined) / count as f64);
        }
        self.observations += 1;
    }
}

/// The connected components of a graph, with reused memory.
#[derive(Debug, Default)]
pub(crate) struct Components {
    /// The nodes, those of one component together.
    nodes: Vec<usize>,
    /// Number of nodes of each component.
    pub(crate) sizes: Vec<usize>,
}

impl Components {
    /// Finds the components of a graph with so many nodes.
    pub(crate) fn find(&mut self, count: usize, joined: impl Fn(usize, usize) -> bool) {
        let Self { nodes, sizes } = self;
        nodes.clear();
        nodes.extend(0..count);
        sizes.clear();
        let mut first = 0;
        while first < count {
            // The nodes from `first` to `reached` belong to this component; the nodes behind are not assigned yet.
            let (mut reached, mut expanded) = (first + 1, first);
            while expanded < reached {
                let mut other = reached;
                while other < count {
                    if joined(nodes[expanded], nodes[other]) {
                        nodes.swap(reached, other);
                        reached += 1;
                    }
                    other += 1;
                }
                expanded += 1;
            }
            sizes.push(reached - first);
            first = reached;
        }
    }

    /// The nodes of each component.
    fn each(&self) -> impl Iterator<Item = &[usize]> {
        let mut rest = self.nodes.as_slice();
        self.sizes.iter().filter_map(move |size| rest.split_off(..*size))
    }

    /// Mean over the nodes of the mean cosine between the own direction and those of all others in the component.
    ///
    /// Only nodes count that have a direction and share their component with another one that has.
    fn correlation(&self, direction: impl Fn(usize) -> Option<Vector3<f64>>) -> Option<f64> {
        let (mut all, mut cosines) = (0.0, 0.0);
        for component in self.each() {
            let directions = component.iter().filter_map(|&node| direction(node));
            let (count, sum) = directions.fold((0.0, Vector3::zeros()), |(count, sum), one| (count + 1.0, sum + one));
            if count > 1.0 {
                // The cosines of one direction with all others add up to its product with their sum. The cosines of all
                // with all others add up to the square of the whole sum, minus 1 for each direction with itself.
                cosines += (sum.norm_squared() - count) / (count - 1.0);
                all += count;
            }
        }
        (all > 0.0).then(|| cosines / all)
    }
}

/// The second eigenvalue of the last graph: a graph rarely changes from one second to the next.
#[derive(Debug, Default)]
struct Spectrum {
    nodes: usize,
    /// A bit for each pair of nodes: whether an edge joins them.
    edges: Vec<u64>,
    second: f64,
}

impl Spectrum {
    /// The result of the function [`second_eigenvalue`], without a computation for an unchanged graph.
    fn second_eigenvalue(&mut self, count: usize, joined: impl Fn(usize, usize) -> bool) -> f64 {
        let mut edges = vec![0_u64; (count * count.saturating_sub(1) / 2).div_ceil(64)];
        let pairs = (0..count).flat_map(|one| (0..one).map(move |other| (one, other)));
        for (nth, (one, other)) in pairs.enumerate() {
            edges[nth / 64] |= u64::from(joined(one, other)) << (nth % 64);
        }
        if self.nodes != count || self.edges != edges {
            *self = Self { nodes: count, edges, second: second_eigenvalue(count, joined) };
        }
        self.second
    }
}

/// Second-smallest eigenvalue of the graph's Laplacian (M. Fiedler, "Algebraic connectivity of graphs", Czechoslovak
/// Mathematical Journal 23 (1973)): 0 if it is not connected, N if it is complete.
///
/// It is N minus the largest eigenvalue of the complement, which joins the nodes that the graph does not (R. Merris, "Laplacian
/// matrices of graphs: a survey", Linear Algebra and its Applications 197 (1994)). The eigenvalues take the cube
/// of the number of nodes, and the graph of a swarm is nearly complete: its complement falls into small components, and each
/// has eigenvalues of its own.
fn second_eigenvalue(count: usize, joined: impl Fn(usize, usize) -> bool) -> f64 {
    let apart = |one: usize, other: usize| one != other && !joined(one, other);
    let mut complement = Components::default();
    complement.find(count, apart);
    let largest = complement.each().map(|nodes| largest_eigenvalue(nodes, apart)).fold(0.0, f64::max);
    (count as f64 - largest).max(0.0)
}

/// Largest eigenvalue of the Laplacian of a graph with these nodes.
fn largest_eigenvalue(nodes: &[usize], joined: impl Fn(usize, usize) -> bool) -> f64 {
    let edge = |row: usize, column: usize| if joined(nodes[row], nodes[column]) { -1.0 } else { 0.0 };
    let mut laplacian = DMatrix::from_fn(nodes.len(), nodes.len(), edge);
    for nth in 0..nodes.len() {
        laplacian[(nth, nth)] = -laplacian.column(nth).sum();
    }
    laplacian.symmetric_eigenvalues().max()
}

#[cfg(test)]
mod tests {
    use skein_common::math;

    use super::super::tests::{set, vehicle};
    use super::*;

    fn edges(edges: &[(usize, usize)]) -> impl Fn(usize, usize) -> bool {
        |one, other| edges.contains(&(one, other)) || edges.contains(&(other, one))
    }

    #[test]
    fn components_are_separated() {
        let sizes = |list: &[(usize, usize)]| {
            let mut components = Components::default();
            components.find(5, edges(list));
            assert_eq!(components.nodes.len(), 5);
            components.sizes
        };
        assert_eq!(sizes(&[]), [1, 1, 1, 1, 1]);
        assert_eq!(sizes(&[(0, 3), (3, 1)]), [3, 1, 1]);
        assert_eq!(sizes(&[(0, 3), (2, 4)]), [2, 2, 1]);
        assert_eq!(sizes(&[(0, 3), (3, 1), (1, 2), (2, 4)]), [5]);
    }

    #[test]
    fn velocities_are_compared_within_components_only() {
        let north = Vector3::x();
        let east = Vector3::y();
        let correlation = |list: &[(usize, usize)], directions: [Option<Vector3<f64>>; 5]| {
            let mut components = Components::default();
            components.find(5, edges(list));
            components.correlation(|node| directions[node])
        };
        let near = |one: Option<f64>, other: f64| assert!((one.unwrap() - other).abs() < 1e-12, "{one:?}, not {other}");
        // Three north and two south: 3 + 1 of ten pairs agree, 6 do not.
        let opposed = [Some(north), Some(north), Some(north), Some(-north), Some(-north)];
        near(correlation(&[(0, 1), (1, 2), (2, 3), (3, 4)], opposed), -0.2);
        near(correlation(&[(0, 1), (1, 2), (3, 4)], opposed), 1.0);
        // A pair at right angles, a pair that agrees, and a hovering vehicle that does not count.
        let mixed = [Some(north), Some(east), Some(north), Some(north), None];
        near(correlation(&[(0, 1), (2, 3), (3, 4)], mixed), 0.5);
        // Vertices of a triangle, 120 degrees apart, each with two cosines of -1/2; the fourth is alone.
        let turned =
            |degrees: f64| Some(Vector3::new(math::cos(degrees.to_radians()), math::sin(degrees.to_radians()), 0.0));
        let triangle = [turned(0.0), turned(120.0), turned(240.0), Some(north), None];
        near(correlation(&[(0, 1), (1, 2), (3, 4)], triangle), -0.5);
        assert_eq!(correlation(&[], opposed), None, "every vehicle is alone in its component");
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
    fn the_eigenvalue_is_that_of_the_present_graph() {
        let mut spectrum = Spectrum::default();
        let path: &[(usize, usize)] = &[(0, 1), (1, 2), (2, 3)];
        let complete: &[(usize, usize)] = &[(0, 1), (0, 2), (1, 2)];
        let graphs: [(usize, &[(usize, usize)]); 7] = [
            (4, path),
            (4, path),
            (4, &path[1..]),
            (5, path),
            (3, &[(0, 1), (1, 2)]),
            (4, &[(0, 2), (1, 2), (2, 3)]),
            (3, complete),
        ];
        for (count, list) in graphs {
            let (kept, computed) =
                (spectrum.second_eigenvalue(count, edges(list)), second_eigenvalue(count, edges(list)));
            assert!((kept - computed).abs() < 1e-12, "{count} nodes, {list:?}: {kept} instead of {computed}");
        }
    }

    #[test]
    fn an_edge_needs_both_directions_and_only_live_members_are_nodes() {
        // Three vehicles receive each other, two of them in one direction only; the fourth is dead.
        let mut vehicles = [1, 2, 3, 4].map(|number| vehicle(number, 0.0, 100.0, 30.0));
        vehicles[0].fresh = set(&[2, 3, 4]);
        vehicles[1].fresh = set(&[1, 3, 4]);
        vehicles[2].fresh = set(&[1]);
        vehicles[3].fresh = set(&[1, 2, 3]);
        vehicles[3].runs = false;
        let (mut graph, mut series) = (Graph::default(), SwarmSeries::default());
        graph.observe(&mut series, &vehicles, &[0, 1, 2], &[]);
        assert_eq!((graph.union.mean(), graph.connected.mean()), (Some(1.0), Some(1.0)));
        assert!((graph.connectivity.mean().unwrap() - 1.0 / 3.0).abs() < 1e-9, "a path of three");
        assert_eq!((graph.disconnected.mean(), graph.smallest.mean()), (Some(0.0), Some(3.0)));

        vehicles[2].fresh = set(&[]);
        graph.observe(&mut series, &vehicles, &[0, 1, 2], &[]);
        assert_eq!(graph.connected.mean(), Some(0.5), "not the second time");
        assert_eq!(graph.union.mean(), Some(0.75), "(3 - 2)/(3 - 1) the second time");
        assert_eq!(graph.disconnected.mean(), Some(0.5), "no vehicle, then the third");
        assert_eq!(graph.smallest.mean(), Some(2.0), "3 members, then 1");
    }
}
