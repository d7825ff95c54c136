use nalgebra::Rotation3;
use proptest::prelude::*;
use skein_common::frame::VelocityNed;
use skein_common::math;

use super::*;
use crate::tests::id;

/// Table 1 of the paper.
fn table_1() -> Ring {
    let k = edge_exponent(0.01);
    Ring {
        radius_m: 100.0,
        gamma: 1.0,
        gamma_z: None,
        region: Region::Band,
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

/// A sphere of the same size.
fn sphere() -> Ring {
    Ring { gamma_z: Some(1.0), ..table_1() }
}

/// A position at the centre's altitude.
fn level(ne_m: Vector2<f64>) -> PositionNed {
    PositionNed(flat(ne_m))
}

/// The field around a centre at the origin, north and east.
fn field(ring: &Ring, place: Vector2<f64>, neighbours: &[Neighbour]) -> Vector2<f64> {
    ring.field(id(1), level(place), PositionNed::default(), neighbours, &[]).xy()
}

fn alone(ring: &Ring, place: Vector2<f64>) -> Vector2<f64> {
    field(ring, place, &[])
}

fn neighbour(number: u8, position: PositionNed) -> Neighbour {
    let velocity = VelocityNed::default();
    Neighbour { id: id(number), position, velocity, heading_rad: 0.0, age_s: 0.0, is_fresh: true }
}

fn neighbours(places: &[Vector2<f64>]) -> Vec<Neighbour> {
    (2..).zip(places).map(|(number, &place)| neighbour(number, level(place))).collect()
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
    let own = Vector2::new(100.0, 0.0);
    let even = field(&ring, own, &others);
    assert!(even.y.abs() < 1e-12, "no push along the ring");
    assert!(even.x.abs() < 0.01, "tangential avoidance hardly widens the ring: {}", even.x);
    let full = Ring { avoidance: Avoidance::Full, ..ring };
    assert!(field(&full, own, &others).x > 0.1, "full avoidance does");
}

#[test]
fn a_nearer_neighbour_pushes_along_the_ring() {
    let ring = table_1();
    let at = |bearing: f64| Vector2::new(math::cos(bearing), math::sin(bearing)) * 100.0;
    let others = neighbours(&[at(1.2), at(-1.9), at(3.1)]);
    assert!(field(&ring, at(0.0), &others).y < 0.0, "the neighbour at 1.2 rad is nearer than the one at −1.9 rad");
}

#[test]
fn coincident_vehicles_are_pushed_in_opposite_directions() {
    let ring = table_1();
    let place = level(Vector2::new(5.0, 5.0));
    let one = ring.push(id(1), place, &[neighbour(2, place)]);
    let two = ring.push(id(2), place, &[neighbour(1, place)]);
    assert!(one.x > 0.5);
    assert_eq!(one, -two);
    assert!(alone(&ring, Vector2::zeros()).norm() < 1e-12, "no radial field at the centre");
}

#[test]
fn an_obstacle_is_avoided_nearby_and_ignored_far_away() {
    let ring = table_1();
    let obstacle =
        |distance: f64| Obstacle { id: id(9), position: level(Vector2::new(100.0, distance)), radius_m: 10.0 };
    let push = |distance| keep_clear(&ring, id(1), level(Vector2::new(100.0, 0.0)), &[obstacle(distance)]);
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

#[test]
fn a_flock_is_pulled_in_at_the_edge_and_left_alone_inside() {
    let k = edge_exponent(0.01);
    let flock = Ring {
        region: Region::Inside,
        radius_m: 50.0,
        outer_width_m: 10.0,
        edge_steepness_per_m: [k / 20.0, k / 10.0],
        avoidance: Avoidance::Full,
        avoid_distance: AvoidDistance::Fixed(20.0),
        circulation: 0.5,
        ..table_1()
    };
    let outward = |rho: f64| alone(&flock, Vector2::new(0.0, rho)).y;
    assert!((outward(50.0) + 0.99).abs() < 1e-9 && (outward(40.0) + 0.5).abs() < 1e-9);
    assert!(outward(10.0).abs() < 1e-5 && alone(&flock, Vector2::zeros()).norm() < 1e-6, "no outward push");
    assert!(alone(&flock, Vector2::new(40.0, 0.0)).y.abs() < 1e-12, "no tangential push");
    let close = field(&flock, Vector2::zeros(), &neighbours(&[Vector2::new(0.0, 20.0)]));
    assert!((close.y + 0.5).abs() < 1e-5, "half the push at the avoidance distance: {close}");
    let is_inside = |north_m| flock.holds_level(flock.level_m(Vector2::new(north_m, 0.0)));
    assert!(is_inside(0.0) && !is_inside(50.1));
}

#[test]
fn the_adaptive_distance_matches_even_spacing_on_a_sphere() {
    let apart = |live: usize| sphere().avoid_distance_m(live) * SQRT_2 / 100.0;
    let known = [(2, 2.0), (3, 3_f64.sqrt()), (4, (8.0_f64 / 3.0).sqrt()), (6, SQRT_2), (12, 1.05146)];
    for (live, expected) in known {
        assert!((apart(live) - expected).abs() < 1e-5, "{live}: {}", apart(live));
    }
    assert_eq!(apart(1), apart(2), "a single vehicle spaces as for two");
    for live in 3..60 {
        assert!(apart(live + 1) < apart(live) && apart(live + 1) > 0.0);
    }
}

#[test]
fn six_vehicles_on_an_octahedron_are_in_a_stable_equilibrium() {
    let sphere = sphere();
    let corners = [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]];
    let others: Vec<_> =
        (2..).zip(corners).map(|(number, at)| neighbour(number, PositionNed(Vector3::from(at) * 100.0))).collect();
    let field = |at: Vector3<f64>| sphere.field(id(1), PositionNed(at), PositionNed::default(), &others, &[]);
    let even = field(Vector3::new(0.0, 0.0, -100.0));
    assert!(even.xy().norm() < 1e-12 && even.z.abs() < 0.01, "{even}");
    assert!(field(Vector3::new(30.0, 0.0, -95.0)).x < -0.02, "back to the pole");
}

#[test]
fn a_flat_swarm_on_an_ellipsoid_leaves_its_plane_when_it_is_disturbed() {
    let others = neighbours(&[Vector2::new(50.0, 86.6), Vector2::new(50.0, -86.6), Vector2::new(-100.0, 0.0)]);
    let higher = PositionNed::new(100.0, 0.0, -1.0);
    let field = sphere().field(id(1), higher, PositionNed::default(), &others, &[]);
    assert!(field.z < -1e-3, "up, away from the others: {field}");
}

fn place() -> impl Strategy<Value = Vector2<f64>> {
    (-200.0..200.0, -200.0..200.0).prop_map(|(x, y)| Vector2::new(x, y))
}

/// Positions in space, some exactly at the centre.
fn spot() -> impl Strategy<Value = PositionNed> {
    let anywhere = (-200.0..200.0, -200.0..200.0, -200.0..200.0).prop_map(|(n, e, d)| PositionNed::new(n, e, d));
    prop_oneof![9 => anywhere, 1 => Just(PositionNed::default())]
}

/// Ellipsoids of all proportions, with either kind of avoidance.
fn ellipsoid() -> impl Strategy<Value = Ring> {
    (0.2..5.0, 0.2..5.0, -3.0..3.0, any::<bool>(), any::<bool>()).prop_map(
        |(gamma, gamma_z, heading_rad, full, inside)| Ring {
            gamma,
            gamma_z: Some(gamma_z),
            heading_rad,
            region: if inside { Region::Inside } else { Region::Band },
            avoidance: if full { Avoidance::Full } else { Avoidance::Tangential },
            circulation: 0.1,
            ..table_1()
        },
    )
}

fn in_space(spots: &[PositionNed]) -> Vec<Neighbour> {
    (2..).zip(spots).map(|(number, &spot)| neighbour(number, spot)).collect()
}

proptest! {
    #[test]
    fn renumbering_the_peers_changes_nothing(own in spot(), mut others in proptest::collection::vec(spot(), 1..8), turn in 0_usize..8, ring in ellipsoid()) {
        let field = |others: &[PositionNed]| ring.field(id(1), own, PositionNed::default(), &in_space(others), &[]);
        let before = field(&others);
        let count = others.len();
        others.rotate_left(turn % count);
        prop_assert!((field(&others) - before).norm() < 1e-12);
    }

    #[test]
    fn the_field_moves_and_turns_with_the_formation(
        own in spot(), others in proptest::collection::vec(spot(), 0..6), shift in spot(), angle in -3.0..3.0, ring in ellipsoid(),
        is_flat: bool,
    ) {
        // Two vehicles at one position are separated north and south, regardless of the formation's heading.
        prop_assume!(others.iter().all(|&other| (other - own).xy().norm() > COINCIDENT_M));
        let ring = if is_flat { Ring { gamma_z: None, ..ring } } else { ring };
        let field = ring.field(id(1), own, PositionNed::default(), &in_space(&others), &[]);
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), angle);
        let moved = |spot: PositionNed| shift + turn * spot.0;
        let others: Vec<_> = others.iter().map(|&other| moved(other)).collect();
        let turned = Ring { heading_rad: ring.heading_rad + angle, ..ring };
        let there = turned.field(id(1), moved(own), shift, &in_space(&others), &[]);
        prop_assert!((turn * field - there).norm() < 1e-9);
    }

    #[test]
    fn the_field_is_finite_and_bounded_for_any_crowd(
        own in spot(), mut others in proptest::collection::vec(spot(), 0..40), ring in ellipsoid(), is_flat: bool,
    ) {
        // One of them is at exactly the same position.
        others.push(own);
        let ring = if is_flat { Ring { gamma_z: None, ..ring } } else { ring };
        let field = ring.field(id(1), own, PositionNed::default(), &in_space(&others), &[]);
        prop_assert!(field.norm() <= 1.0 + MAX_AVOIDANCE + 0.1 + 1e-9);
        prop_assert!(!is_flat || field.z == 0.0, "no vertical field in a flat law");
    }

    #[test]
    fn the_band_is_strictly_falling(rho in 1.0..250.0) {
        let radial = |rho: f64| alone(&table_1(), Vector2::new(rho, 0.0)).x;
        prop_assert!(radial(rho + 0.5) <= radial(rho));
    }

    #[test]
    fn on_the_surface_nothing_pushes_off_it(spot in spot(), ring in ellipsoid()) {
        prop_assume!(spot.0.norm() > 1.0);
        let ring = Ring { region: Region::Band, circulation: 0.0, ..ring };
        let on_it = spot.0 * (ring.radius_m / ring.level_and_normal(spot.0).0);
        let field = ring.field(id(1), PositionNed(on_it), PositionNed::default(), &[], &[]);
        prop_assert!(field.norm() < 1e-9, "{field}");
    }

    #[test]
    fn the_normal_is_the_gradient_of_the_level(spot in spot(), ring in ellipsoid()) {
        prop_assume!(spot.0.norm() > 1.0);
        let level = |offset: Vector3<f64>| ring.level_and_normal(spot.0 + offset).0;
        let steps = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| axis * 1e-4);
        let gradient = Vector3::from(steps.map(|step| level(step) - level(-step)));
        prop_assert!((ring.level_and_normal(spot.0).1 - gradient.normalize()).norm() < 1e-5);
    }

    #[test]
    fn two_push_each_other_apart_with_equal_strength(one in spot(), other in spot(), is_same: bool, ring in ellipsoid()) {
        let other = if is_same { one } else { other };
        let push = ring.push(id(1), one, &[neighbour(2, other)]);
        prop_assert_eq!(push, -ring.push(id(2), other, &[neighbour(1, one)]));
        prop_assert!(push.dot(&(one - other)) >= 0.0 && (!is_same || push.norm() > 0.9));
    }

    #[test]
    fn at_the_centres_altitude_an_ellipsoid_equals_the_flat_ring(
        own in place(), others in proptest::collection::vec(place(), 0..6), ring in ellipsoid(),
    ) {
        // The flat distance, because even neighbours on a surface are farther apart than on a ring.
        let ring = Ring { avoid_distance: AvoidDistance::Fixed(80.0), ..ring };
        let field = |ring: &Ring| ring.field(id(1), level(own), PositionNed::default(), &neighbours(&others), &[]);
        prop_assert_eq!(field(&ring), field(&Ring { gamma_z: None, ..ring }));
        prop_assert_eq!(field(&ring).z, 0.0);
    }

    #[test]
    fn what_is_beyond_the_reach_changes_nothing_that_matters(
        own in spot(), others in proptest::collection::vec((spot(), 0.0..60.0), 1..20), ring in ellipsoid(), is_flat: bool,
    ) {
        let ring = Ring { gamma_z: ring.gamma_z.filter(|_| !is_flat), ..ring };
        let far = |(spot, times): &(PositionNed, f64)| PositionNed(spot.0 * *times);
        let all = in_space(&others.iter().map(far).collect::<Vec<_>>());
        let centre = PositionNed::default();
        let obstacles: Vec<_> = all
            .iter()
            .map(|it| Obstacle { id: it.id, position: it.position, radius_m: MAX_OBSTACLE_RADIUS_M })
            .collect();
        let reach_m = ring.reach_m(all.len() + 1);
        let is_within = |position: PositionNed| (position - own).xy().norm() <= reach_m;
        let near: Vec<_> = all.iter().copied().filter(|it| is_within(it.position)).collect();
        let near_obstacles: Vec<_> = obstacles.iter().copied().filter(|it| is_within(it.position)).collect();
        let ring = Ring { avoid_distance: AvoidDistance::Fixed(ring.avoid_distance_m(all.len() + 1)), ..ring };
        let change = ring.field(VehicleId::new(1).unwrap(), own, centre, &all, &obstacles)
            - ring.field(VehicleId::new(1).unwrap(), own, centre, &near, &near_obstacles);
        prop_assert!(change.norm() < 1e-10, "{change}");
    }

    #[test]
    fn a_flat_law_sees_no_heights(own in spot(), others in proptest::collection::vec(spot(), 0..6)) {
        let ring = table_1();
        let flatten = |spot: PositionNed| level(spot.horizontal());
        let level: Vec<_> = others.iter().map(|&other| flatten(other)).collect();
        let field = ring.field(id(1), own, PositionNed::default(), &in_space(&others), &[]);
        prop_assert_eq!(field, ring.field(id(1), flatten(own), PositionNed::default(), &in_space(&level), &[]));
    }

    #[test]
    fn the_field_is_symmetric_in_altitude(own in spot(), others in proptest::collection::vec(spot(), 0..6), ring in ellipsoid()) {
        let field = |mirror: Vector3<f64>| {
            let mirrored = |spot: PositionNed| PositionNed(spot.0.component_mul(&mirror));
            let others: Vec<_> = others.iter().map(|&other| mirrored(other)).collect();
            ring.field(id(1), mirrored(own), PositionNed::default(), &in_space(&others), &[])
        };
        let mirror = Vector3::new(1.0, 1.0, -1.0);
        prop_assert!((field(mirror) - field(Vector3::repeat(1.0)).component_mul(&mirror)).norm() < 1e-12);
    }
}
