//! Formations other than the ring in virtual time, and their limits: few seeds here; `skein study` flies fifty.

use std::f64::consts::{PI, TAU};
use std::num::NonZeroUsize;

use nalgebra::Vector2;
use skein_common::frame::PositionNed;
use skein_common::math;
use skein_common::scenario::Scenario;
use skein_common::statistics;
use skein_lab::metrics::Report;
use skein_lab::world::World;
use skein_tests::{in_parallel, study, wind};

const TWO: NonZeroUsize = NonZeroUsize::MIN.saturating_add(1);

fn median(mut figures: Vec<f64>) -> f64 {
    statistics::median(&mut figures).unwrap()
}

fn worst(figures: &[f64]) -> f64 {
    figures.iter().copied().fold(f64::INFINITY, f64::min)
}

/// Least separation in four seeds of the flock, m. Checks that every vehicle stays inside while the centre moves, and
/// arrives.
fn flock_m(sets: &[&str]) -> Vec<f64> {
    let study = study("flock.toml", sets);
    let within_m = study.scenario.formation.radius_m;
    let separation_m = |report: &Report| {
        let (seed, farthest_m) = (report.run.seed, report.max_centre_distance_m.unwrap());
        assert!(farthest_m <= within_m, "seed {seed}: {farthest_m} m from the centre");
        assert_eq!(report.setpoints_reached, Some(2), "seed {seed}");
        report.min_separation_m.unwrap()
    };
    study.fly_all(0..4, TWO, |_| {}).unwrap().iter().map(separation_m).collect()
}

#[test]
fn a_flock_follows_its_centre_with_safe_separation() {
    let calm_m = flock_m(&[]);
    assert!(worst(&calm_m) >= 20.0 && median(calm_m.clone()) >= 28.0, "2 m/s: {calm_m:?} m");
    let fast_m = flock_m(&["mission.speed_m_s=4"]);
    assert!(worst(&fast_m) >= 18.0, "4 m/s: {fast_m:?} m");
    let papers_m = flock_m(&["preset=paper"]);
    assert!(worst(&papers_m) >= 18.0, "without feed-forward: {papers_m:?} m");
}

/// One crossing: least separation from the start of the second step on, number of pairs that collided, and time from
/// that start until all vehicles were in their new places, s.
fn cross(sets: &[&str], seed: u64) -> (f64, usize, Option<f64>) {
    let study = study("crossing.toml", sets);
    let scenario = Scenario { seed, ..study.scenario };
    let mut world = World::new(&scenario, &study.aircraft, &study.rules).unwrap();
    let count = scenario.swarm.vehicles;
    let mut least_m = vec![f64::INFINITY; count * count];
    let mut began_s = None;
    while world.t_s() < 150.0 {
        world.tick();
        let crossing = world.vehicles().all(|(_, agent, ..)| agent.at_step() > 0);
        let places: Vec<PositionNed> = world.vehicles().map(|(_, _, truth, _)| truth.position).collect();
        if !crossing {
            continue;
        }
        let began_s = *began_s.get_or_insert(world.t_s());
        for (nth, one) in places.iter().enumerate() {
            for (mth, other) in places[..nth].iter().enumerate() {
                least_m[nth * count + mth] = least_m[nth * count + mth].min((*one - *other).norm());
            }
        }
        let opposite_m = |nth: usize| {
            let bearing_rad = PI + TAU * nth as f64 / count as f64;
            Vector2::new(math::cos(bearing_rad), math::sin(bearing_rad)) * scenario.formation.radius_m
        };
        if places.iter().enumerate().all(|(nth, place)| (place.horizontal() - opposite_m(nth)).norm() < 3.0) {
            let collided = least_m.iter().filter(|distance_m| **distance_m < 2.0).count();
            return (worst(&least_m), collided, Some(world.t_s() - began_s));
        }
    }
    (worst(&least_m), least_m.iter().filter(|distance_m| **distance_m < 2.0).count(), None)
}

#[test]
fn sixteen_vehicles_cross_through_one_centre_without_collisions() {
    let crossings = in_parallel(0..6, |seed| cross(&[], seed));
    for (seed, (separation_m, collided, placed_s)) in crossings.iter().enumerate() {
        println!("seed {seed}: {separation_m:.1} m, all in place after {placed_s:?} s");
        assert!(*separation_m >= 4.0 && *collided == 0, "seed {seed}: {separation_m} m");
        assert!(placed_s.is_some_and(|placed_s| placed_s <= 120.0), "seed {seed}: {placed_s:?} s");
    }
    let (separation_m, collided, _) = cross(&["formation.safety_filter=none"], 0);
    println!("without the filter {separation_m:.2} m, {collided} pairs collide");
    assert!(collided > 0, "without the filter vehicles collide");
}

#[test]
fn sixteen_vehicles_find_their_places_from_random_starts_without_deadlock() {
    let anywhere = ["start.pattern=random", "start.separation_m=12"];
    // The seeds among the first 50 that end in a deadlock of three or four if no vehicle turns more than 37 degrees.
    for seed in [2, 7, 12, 15] {
        let (separation_m, _, placed_s) = cross(&anywhere, seed);
        assert!(separation_m >= 4.0 && placed_s.is_some(), "seed {seed}: {separation_m} m, {placed_s:?} s");
    }
}

/// Flies six vehicles around one place for this time; returns their positions then, and the least separation in flight.
fn six(sets: &[&str], seed: u64, for_s: f64) -> (Vec<PositionNed>, f64) {
    let common = ["swarm.vehicles=6", "formation.radius_m=40", "formation.altitude_m=60"];
    let study = study("hover.toml", &[&common, sets].concat());
    let mut world = World::new(&Scenario { seed, ..study.scenario }, &study.aircraft, &study.rules).unwrap();
    let mut separation_m = f64::INFINITY;
    loop {
        world.tick();
        let flying = world.vehicles().filter(|(_, _, truth, _)| truth.height_m > 2.0);
        let places: Vec<PositionNed> = flying.map(|(_, _, truth, _)| truth.position).collect();
        separation_m = separation_m.min(nearest_m(&places).into_iter().fold(f64::INFINITY, f64::min));
        if world.t_s() > for_s {
            return (places, separation_m);
        }
    }
}

/// Distance of each vehicle to its nearest neighbour, m.
fn nearest_m(places: &[PositionNed]) -> Vec<f64> {
    let others = |nth: usize| places.iter().enumerate().filter(move |(mth, _)| *mth != nth).map(|(_, place)| *place);
    let nearest = |(nth, one): (usize, &PositionNed)| others(nth).map(|other| (*one - other).norm()).reduce(f64::min);
    places.iter().enumerate().filter_map(nearest).collect()
}

#[test]
fn six_vehicles_in_bands_are_evenly_spaced_on_six_heights() {
    for (seed, (places, separation_m)) in
        in_parallel(0..3, |seed| six(&["formation.band_step_m=5"], seed, 250.0)).into_iter().enumerate()
    {
        let altitudes_m: Vec<f64> = places.iter().map(PositionNed::altitude_m).collect();
        for (rank, altitude_m) in altitudes_m.iter().enumerate() {
            assert!((altitude_m - (47.5 + 5.0 * rank as f64)).abs() < 0.3, "seed {seed}: {altitudes_m:?} m");
        }
        let mut bearings: Vec<f64> = places.iter().map(|place| math::atan2(place.east_m(), place.north_m())).collect();
        let uneven_deg = skein_lab::metrics::largest_gap_deviation_rad(&mut bearings).unwrap().to_degrees();
        assert!(uneven_deg < 10.0, "seed {seed}: {uneven_deg} degrees");
        assert!(separation_m >= 10.0, "seed {seed}: {separation_m} m");
    }
}

#[test]
fn six_vehicles_on_an_ellipsoid_spread_over_all_of_it() {
    for (seed, (places, separation_m)) in
        in_parallel(0..4, |seed| six(&["formation.vertical=ellipsoid"], seed, 300.0)).into_iter().enumerate()
    {
        let centre = PositionNed::new(0.0, 0.0, -60.0);
        for place in &places {
            let radius_m = (*place - centre).norm();
            assert!((38.0..44.0).contains(&radius_m), "seed {seed}: {radius_m} m from the centre");
        }
        // The corners of an octahedron are the widest spacing of six points on a sphere: 57 m for a radius of 40 m.
        let apart_m = nearest_m(&places);
        assert!(apart_m.iter().all(|apart_m| *apart_m > 55.0), "seed {seed}: {apart_m:?} m");
        assert!(separation_m >= 10.0, "seed {seed}: {separation_m} m");
    }
}

/// Flights in wind, gusts and heights up to 60 m, in which the climb fills the integral of the collective. The vehicle
/// then hovers 1 to 2.5 m too high while the integral empties. An earlier version reported that as a failure.
#[test]
fn a_healthy_helicopter_in_wind_reports_no_failure() {
    for (wind_m_s, vehicles, altitude_m) in [(6.0, 7, 50.0), (6.0, 8, 60.0), (8.0, 7, 50.0)] {
        let sets = [
            format!("world.wind_m_s={wind_m_s}"),
            "world.gust_w20_m_s=5".to_owned(),
            format!("swarm.vehicles={vehicles}"),
            format!("formation.altitude_m={altitude_m}"),
        ];
        let sets: Vec<&str> = sets.iter().map(String::as_str).collect();
        for flight in in_parallel(0..3, |seed| wind::fly(Scenario { seed, ..study("hover.toml", &sets).scenario })) {
            assert!(flight.failures.is_empty(), "{sets:?}: {flight}");
        }
    }
}
