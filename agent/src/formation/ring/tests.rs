use proptest::prelude::*;

use super::*;

fn id(number: u8) -> VehicleId {
    VehicleId::new(number).unwrap()
}

/// Table 1 of the paper.
fn table_1() -> Ring {
    let k = edge_exponent(0.01);
    Ring {
        radius_m: 100.0,
        gamma: 1.0,
        heading_rad: 0.0,
        inner_width_m: 20.0,
        outer_width_m: 20.0,
        edge_steepness_per_m: [k / 20.0, k / 20.0],
        edge_exponent: k,
        avoidance: Avoidance::Tangential,
        avoid_distance: AvoidDistance::Adaptive,
        circulation: 0.0,
    }
}

fn alone(ring: &Ring, position: Vector2<f64>) -> Vector2<f64> {
    ring.field_ne(id(1), position, Vector2::zeros(), &[], &[])
}

fn neighbours(positions: &[Vector2<f64>]) -> Vec<Neighbour> {
    (2..).zip(positions).map(|(number, &position_ne_m)| Neighbour { id: id(number), position_ne_m }).collect()
}

#[test]
fn the_band_pushes_to_the_ring_with_the_published_slopes() {
    let ring = table_1();
    let radial = |rho: f64| alone(&ring, Vector2::new(rho, 0.0)).x;
    assert!(radial(100.0).abs() < 1e-12, "equal widths: no push on the ring");
    assert!((radial(80.0) - 0.5).abs() < 2e-3 && (radial(120.0) + 0.5).abs() < 2e-3);
    assert!((radial(10.0) - 1.0).abs() < 1e-3 && (radial(200.0) + 1.0).abs() < 1e-3);
    let slope = |rho: f64| (radial(rho + 0.01) - radial(rho - 0.01)) / 0.02;
    assert!((slope(100.0) + 0.0046).abs() < 1e-4, "soft on the ring: {}", slope(100.0));
    assert!((slope(120.0) + 0.058).abs() < 1e-3, "steep at the edge: {}", slope(120.0));
}

#[test]
fn four_on_the_even_ring_are_in_equilibrium() {
    let ring = table_1();
    assert!((ring.avoid_distance_m(4) - 100.0).abs() < 1e-9);
    let others = neighbours(&[Vector2::new(0.0, 100.0), Vector2::new(-100.0, 0.0), Vector2::new(0.0, -100.0)]);
    let field = ring.field_ne(id(1), Vector2::new(100.0, 0.0), Vector2::zeros(), &others, &[]);
    assert!(field.y.abs() < 1e-12, "no reason to move along the ring");
    assert!(field.x.abs() < 0.01, "tangential avoidance hardly widens the ring: {}", field.x);
    let full = Ring { avoidance: Avoidance::Full, ..ring };
    assert!(full.field_ne(id(1), Vector2::new(100.0, 0.0), Vector2::zeros(), &others, &[]).x > 0.1, "full does");
}

#[test]
fn a_nearer_neighbour_pushes_along_the_ring() {
    let ring = table_1();
    let at = |bearing: f64| Vector2::new(f64::cos(bearing), f64::sin(bearing)) * 100.0;
    let others = neighbours(&[at(1.2), at(-1.9), at(3.1)]);
    let field = ring.field_ne(id(1), at(0.0), Vector2::zeros(), &others, &[]);
    assert!(field.y < 0.0, "the neighbour at 1.2 rad is nearer than the one at −1.9 rad");
}

#[test]
fn coincident_vehicles_disagree_about_where_to_go() {
    let ring = table_1();
    let place = Vector2::new(5.0, 5.0);
    let one = ring.push(id(1), place, &[Neighbour { id: id(2), position_ne_m: place }]);
    let two = ring.push(id(2), place, &[Neighbour { id: id(1), position_ne_m: place }]);
    assert!(one.x > 0.5);
    assert_eq!(one, -two);
    assert!(alone(&ring, Vector2::zeros()).norm() < 1e-12, "nothing radial at the very centre");
}

#[test]
fn an_obstacle_is_kept_clear_of_and_forgotten_far_away() {
    let ring = table_1();
    let obstacle = |distance: f64| Obstacle { id: id(9), position_ne_m: Vector2::new(100.0, distance), radius_m: 10.0 };
    let push = |distance| ring.keep_clear(id(1), Vector2::new(100.0, 0.0), &[obstacle(distance)]);
    assert!(push(5.0).y < -1.0, "away from it");
    assert!((push(10.0).y + 1.0).abs() < 1e-9, "half strength at its radius");
    assert!(push(60.0).norm() < 1e-6);
}

#[test]
fn the_ellipse_has_the_semi_axes_of_its_level_function() {
    let ring = Ring { gamma: 4.0, heading_rad: PI / 2.0, ..table_1() };
    assert!((ring.level_m(Vector2::new(0.0, 100.0)) - 100.0).abs() < 1e-9, "first axis points east");
    assert!((ring.level_m(Vector2::new(50.0, 0.0)) - 100.0).abs() < 1e-9, "the other is half as long");
    assert!(alone(&ring, Vector2::new(80.0, 0.0)).x < -0.9, "outside the short axis: inward");
    assert!(alone(&ring, Vector2::new(0.0, 50.0)).y > 0.9, "inside the long axis: outward");
}

fn place() -> impl Strategy<Value = Vector2<f64>> {
    (-200.0..200.0, -200.0..200.0).prop_map(|(x, y)| Vector2::new(x, y))
}

proptest! {
    #[test]
    fn renumbering_the_peers_changes_nothing(own in place(), mut others in proptest::collection::vec(place(), 1..8), turn in 0_usize..8) {
        let ring = table_1();
        let field = ring.field_ne(id(1), own, Vector2::zeros(), &neighbours(&others), &[]);
        let count = others.len();
        others.rotate_left(turn % count);
        let renumbered = ring.field_ne(id(1), own, Vector2::zeros(), &neighbours(&others), &[]);
        prop_assert!((field - renumbered).norm() < 1e-12);
    }

    #[test]
    fn the_field_moves_and_turns_with_the_formation(
        own in place(), others in proptest::collection::vec(place(), 0..6), shift in place(), angle in -3.0..3.0, gamma in 0.3..5.0,
        full: bool,
    ) {
        let avoidance = if full { Avoidance::Full } else { Avoidance::Tangential };
        let ring = Ring { gamma, avoidance, circulation: 0.1, ..table_1() };
        let field = ring.field_ne(id(1), own, Vector2::zeros(), &neighbours(&others), &[]);
        let turn = Rotation2::new(angle);
        let moved: Vec<_> = others.iter().map(|other| turn * other + shift).collect();
        let turned = Ring { heading_rad: angle, ..ring };
        let there = turned.field_ne(id(1), turn * own + shift, shift, &neighbours(&moved), &[]);
        prop_assert!((turn * field - there).norm() < 1e-9);
    }

    #[test]
    fn the_field_is_finite_and_bounded_for_any_crowd(own in place(), others in proptest::collection::vec(place(), 0..40)) {
        let field = table_1().field_ne(id(1), own, Vector2::zeros(), &neighbours(&others), &[]);
        prop_assert!(field.norm() <= 1.0 + MAX_AVOIDANCE + 1e-9);
    }

    #[test]
    fn the_band_is_strictly_falling(rho in 1.0..250.0) {
        let radial = |rho: f64| alone(&table_1(), Vector2::new(rho, 0.0)).x;
        prop_assert!(radial(rho + 0.5) <= radial(rho));
    }
}
