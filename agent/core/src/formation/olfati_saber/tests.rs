use proptest::prelude::*;
use skein_common::frame::VelocityNed;
use skein_common::math;
use skein_common::scenario::{Source, load};

use super::super::tests::points::Points;
use super::*;

fn law(sets: &[&str]) -> OlfatiSaber {
    let sets: Vec<_> = sets.iter().map(|set| format!("formation.olfati_saber.{set}")).collect();
    let scenario = load(&Source { name: "test.toml", text: "swarm.vehicles = 2" }, &sets).unwrap().scenario;
    OlfatiSaber::new(&scenario.formation.olfati_saber).unwrap()
}

/// Potential ψ_α of a sigma-norm: the integral of φ_α from ‖d‖σ, by Simpson's rule.
fn potential(law: &OlfatiSaber, sigma: f64) -> f64 {
    let pieces = 200;
    let width = (sigma.min(law.range_sigma) - law.distance_sigma) / f64::from(pieces);
    let at = |nth: i32| law.action(law.distance_sigma + f64::from(nth) * width);
    let inner: f64 = (1..pieces).map(|nth| at(nth) * if nth % 2 == 1 { 4.0 } else { 2.0 }).sum();
    (at(0) + inner + at(pieces)) * width / 3.0
}

/// The source's Hamiltonian in the frame of the goal (equation 36): potential of all pairs, of the goal, and motion;
/// m²/s².
fn energy(law: &OlfatiSaber, points: &Points) -> f64 {
    let scale = math::square(law.unit_m / law.its.time_unit_s);
    let pairs = points.distances_m().into_iter().map(|distance_m| {
        let squared = math::square(distance_m / law.unit_m);
        scale * potential(law, sigma_norm(law.its.epsilon, squared))
    });
    let (centre, drift) = (points.goal.centre.horizontal(), points.goal.centre_velocity.horizontal());
    let goal = points.places_m.iter().map(|place| 0.5 * law.its.c1_per_s2 * (place - centre).norm_squared());
    let motion = points.velocities_m_s.iter().map(|velocity| 0.5 * (velocity - drift).norm_squared());
    pairs.chain(goal).chain(motion).sum()
}

/// Moves points with inertia, as in the source.
fn accelerate(law: &OlfatiSaber, points: &mut Points, dt_s: f64) {
    let accelerations = points.each(|_, _| true, |_, observation| law.acceleration(observation));
    points.velocities_m_s.iter_mut().zip(accelerations).for_each(|(velocity, u)| *velocity += u * dt_s);
    points.pass(dt_s);
}

/// Number of connected components of the graph of vehicles within range.
fn pieces(law: &OlfatiSaber, points: &Points) -> usize {
    let range_m = 1.2 * SOURCE_DISTANCE * law.unit_m;
    let mut piece: Vec<usize> = (0..points.places_m.len()).collect();
    for one in 0..piece.len() {
        for other in 0..one {
            if (points.places_m[one] - points.places_m[other]).norm() < range_m {
                let (from, to) = (piece[one], piece[other]);
                piece.iter_mut().filter(|it| **it == from).for_each(|it| *it = to);
            }
        }
    }
    piece.sort_unstable();
    piece.dedup();
    piece.len()
}

/// The source's proof (theorem 2) and simulation (section IX): energy falls, velocities match, the flock is connected,
/// no vehicles collide, and neighbours are at distance d. The deviation energy is the source's (equation 17),
/// normalised by d².
#[test]
fn ten_points_become_a_lattice_that_moves_with_its_goal() {
    let law = law(&[]);
    let mut points = Points::scattered(10, 90.0, 7);
    points.goal.centre_velocity = VelocityNed::new(2.0, -1.0, 0.0);
    let (mut energies, mut nearest_m) = (vec![energy(&law, &points)], f64::INFINITY);
    for tick in 1..=30_000 {
        accelerate(&law, &mut points, 0.02);
        if tick % 50 == 0 {
            energies.push(energy(&law, &points));
        }
        // Some points are scattered close together.
        if tick > 3_000 {
            nearest_m = points.distances_m().into_iter().fold(nearest_m, f64::min);
        }
    }
    let grew = energies.windows(2).map(|two| two[1] - two[0]).fold(f64::NEG_INFINITY, f64::max);
    assert!(grew < 1e-3 * energies[0], "the energy grew by {grew} of {}", energies[0]);
    assert!(nearest_m > 20.0, "{nearest_m} m");
    let drift = points.goal.centre_velocity.horizontal();
    assert!(points.velocities_m_s.iter().all(|velocity| (velocity - drift).norm() < 0.01), "{points:?}");
    assert_eq!(pieces(&law, &points), 1);
    let d_m = SOURCE_DISTANCE * law.unit_m;
    let close: Vec<_> = points.distances_m().into_iter().filter(|&distance_m| distance_m < 1.2 * d_m).collect();
    let deviation: f64 = close.iter().map(|distance_m| math::square(distance_m - d_m)).sum();
    let normalised = deviation / (close.len() as f64 + 1.0) / math::square(d_m);
    assert!(close.len() >= 15 && normalised < 2e-3, "{} links, deviation energy {normalised}", close.len());
}

#[test]
fn the_lattice_scales_with_its_units_of_length_and_time() {
    let (small, large) = (law(&["distance_m=7", "time_unit_s=1"]), law(&["distance_m=35", "time_unit_s=10"]));
    let place = Vector2::new(3.0, 1.0);
    let pull = |law: &OlfatiSaber| {
        let points = Points::at(vec![Vector2::zeros(), place * law.unit_m]);
        points.each(
            |_, _| true,
            |_, observation| law.acceleration(&Observation { position: Default::default(), ..*observation }),
        )[0]
    };
    let (in_sources_units, ours) = (pull(&small), pull(&large));
    assert!((ours - in_sources_units * (5.0 / 100.0)).norm() < 1e-12, "length over time squared: {ours}");
    assert!(in_sources_units.norm() > 5.0);
}

proptest! {
    #[test]
    fn norm_bump_and_action_match_the_source(
        z in 0.01..100.0_f64, epsilon in 0.01..2.0_f64, a in 0.5..10.0_f64, more in 0.0..10.0_f64, h in 0.0..0.9_f64, share in 0.0..1.5_f64,
    ) {
        let slope = (sigma_norm(epsilon, math::square(z + 1e-5)) - sigma_norm(epsilon, math::square(z - 1e-5))) / 2e-5;
        prop_assert!((slope - z / (1.0 + epsilon * z * z).sqrt()).abs() < 1e-5, "the gradient is n_ij");
        prop_assert!(sigma_norm(epsilon, 0.0) == 0.0);

        let mut law = law(&[&format!("action_b={}", a + more), &format!("action_a={a}")]);
        law.its.bump_h = h;
        prop_assert!((0.0..=1.0).contains(&law.bump(share)) && law.bump(0.0) == 1.0 && law.bump(1.0) == 0.0);
        prop_assert!((law.bump((1.0 + h) / 2.0) - 0.5).abs() < 1e-9, "half in the middle of its fall");
        prop_assert!((law.bump(share + 1e-7) - law.bump(share)).abs() < 1e-4, "continuous");
        prop_assert!(law.action(law.distance_sigma).abs() < 1e-12, "no force at distance d, even if a is not b");
        let action = law.action(share * law.range_sigma);
        prop_assert!(action < a + 1e-9 && action > -(a + more) - 1e-9);
        let side = (share * law.range_sigma - law.distance_sigma).signum();
        prop_assert!(action * side >= -1e-9 && (share < 1.0 || action == 0.0), "repels when near, attracts when far");
    }

    #[test]
    fn two_pull_each_other_equally(north in -40.0..40.0, east in -40.0..40.0, vn in -4.0..4.0, ve in -4.0..4.0) {
        let mut law = law(&[]);
        (law.its.c1_per_s2, law.its.c2_per_s) = (0.0, 0.0);
        let mut points = Points::at(vec![Vector2::zeros(), Vector2::new(north, east)]);
        points.velocities_m_s[1] = Vector2::new(vn, ve);
        let forces = points.each(|_, _| true, |_, observation| law.acceleration(observation));
        prop_assert!((forces[0] + forces[1]).norm() < 1e-9);
    }
}
