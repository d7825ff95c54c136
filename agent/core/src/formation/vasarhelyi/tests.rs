use proptest::prelude::*;
use skein_common::frame::VelocityNed;
use skein_common::math;

use super::super::tests::points::{Points, laws};
use super::*;

const LAW: &str = "law = 'vasarhelyi'\nradius_m = 50";

#[test]
fn the_braking_curve_has_the_published_pieces() {
    let (a, p) = (4.16, 3.2);
    assert_eq!(braking_m_s(-3.0, a, p), 0.0);
    assert_eq!(braking_m_s(0.2, a, p), 0.2 * p);
    let knee_m = a / (p * p);
    assert!((braking_m_s(knee_m, a, p) - a / p).abs() < 1e-9);
    assert!((braking_m_s(10.0, a, p) - (2.0 * a * 10.0 - math::square(a / p)).sqrt()).abs() < 1e-12);
}

#[test]
fn two_vehicles_separate_to_the_repulsion_range_and_no_farther() {
    let mut laws = laws(2, LAW);
    let mut points = Points::at(vec![Vector2::new(0.0, 3.0), Vector2::new(1.0, -5.0)]);
    points.fly(&mut laws, |_, _| true, 60.0);
    let apart_m = points.distances_m()[0];
    assert!((25.5..=25.6).contains(&apart_m), "{apart_m} m");
    let mut both = Points::at(vec![Vector2::zeros(); 2]);
    both.fly(&mut laws, |_, _| true, 60.0);
    assert!(both.distances_m()[0] > 25.5, "also from one position");
}

/// Two vehicles at 30 m with a difference of 3 m/s: each removes C_frict of the excess over v_frict.
#[test]
fn friction_removes_relative_speed_that_is_too_fast_to_stop() {
    let mut points = Points::at(vec![Vector2::zeros(), Vector2::new(0.0, 30.0)]);
    points.velocities_m_s[1] = Vector2::new(3.0, 0.0);
    let command = command(&points);
    assert!((command[0] - Vector2::new(0.05 * (3.0 - 0.63), 0.0)).norm() < 1e-12, "{command:?}");
    assert!((command[0] + command[1]).norm() < 1e-12);
    points.velocities_m_s[1] = Vector2::new(0.6, 0.0);
    assert_eq!(self::command(&points)[0], Vector2::zeros(), "a small difference is allowed at any distance");
    let far = 85.3 + 2.0;
    points.places_m[1] = Vector2::new(0.0, far);
    points.velocities_m_s[1] = Vector2::new(3.0, 0.0);
    assert_eq!(self::command(&points)[0], Vector2::zeros(), "far away, stopping is still possible");
}

fn command(points: &Points) -> Vec<Vector2<f64>> {
    let mut laws = laws(points.places_m.len(), "law = 'vasarhelyi'\nradius_m = 1000");
    points.each(
        |_, _| true,
        |own, observation| match laws[own].update(observation).command {
            LawCommand::Velocity { ne_m_s, .. } => ne_m_s,
            _ => panic!("not a velocity"),
        },
    )
}

/// The source's measures, with a lag of one second: no collisions, correlated velocities, no vehicle left behind.
#[test]
fn ten_vehicles_with_a_lag_follow_a_centre_aligned_and_apart() {
    let mut laws = laws(10, LAW);
    let mut points = Points::scattered(10, 120.0, 11);
    points.goal.radius_m = 50.0;
    points.goal.centre_velocity = VelocityNed::new(2.0, 0.0, 0.0);
    let mut rng = crate::random::generator(5, None, crate::random::Purpose::Start);
    let mut speed = || 8.0 * (crate::random::uniform(&mut rng) - 0.5);
    points.velocities_m_s.iter_mut().for_each(|velocity| *velocity = Vector2::new(speed(), speed()));
    let mut nearest_m = f64::INFINITY;
    for tick in 0..10_000 {
        let command = points.each(
            |_, _| true,
            |own, observation| match laws[own].update(observation).command {
                LawCommand::Velocity { ne_m_s, .. } => ne_m_s,
                _ => panic!("not a velocity"),
            },
        );
        let velocities = points.velocities_m_s.iter_mut().zip(command);
        velocities.for_each(|(velocity, command)| *velocity += (command - *velocity) * 0.02);
        points.pass(0.02);
        if tick > 3_000 {
            nearest_m = points.distances_m().into_iter().fold(nearest_m, f64::min);
        }
    }
    let count = points.velocities_m_s.len();
    let direction: Vec<_> = points.velocities_m_s.iter().map(|velocity| velocity.normalize()).collect();
    let pairs = direction.iter().enumerate().flat_map(|(nth, one)| direction[..nth].iter().map(move |it| it.dot(one)));
    let correlation = pairs.sum::<f64>() / (count * (count - 1) / 2) as f64;
    assert!(correlation > 0.99 && nearest_m > 12.0, "{correlation}, {nearest_m} m");
    let centre = points.goal.centre.horizontal();
    assert!(points.places_m.iter().all(|place| (place - centre).norm() < 50.0), "{points:?}");
}

proptest! {
    #[test]
    fn the_braking_curve_is_smooth_and_allows_a_stop(
        distance_m in 0.0..200.0_f64, more in 1e-6..1.0_f64, a in 0.1..10.0_f64, p in 0.05..10.0_f64,
    ) {
        let (slow, fast) = (braking_m_s(distance_m, a, p), braking_m_s(distance_m + more, a, p));
        prop_assert!(fast > slow && fast - slow <= p * more + 1e-9, "never steeper than p");
        // At constant deceleration a, a vehicle stops within the distance plus its exponential end.
        prop_assert!(slow * slow / (2.0 * a) <= distance_m + 1e-9);
    }
}
