use skein_common::scenario::{Source, load};

use super::super::{FASTEST_M_S, check_airspace};
use super::*;
use crate::formation::safety::SafetyFilter;

const FILTER: SafetyFilter = SafetyFilter { distance_m: 8.0, rate_per_s: 0.5 };

fn scenario(text: &str) -> Scenario {
    let text = &match text.strip_prefix("[swarm]\n") {
        Some(text) => format!("[swarm]\nvehicles = 4\n{text}"),
        None => format!("swarm.vehicles = 4\n{text}"),
    };
    load(&Source { name: "test.toml", text }, &[]).unwrap().scenario
}

fn airspace(lines: &str) -> Airspace {
    Airspace::new(&scenario(&format!("[airspace]\n{lines}\n")).airspace)
}

/// Where a vehicle ends that is sent this way for a minute and follows its velocity with a lag of 1 s.
fn flown(airspace: &Airspace, from: [f64; 2], command_ne_m_s: [f64; 2], wind_ne_m_s: [f64; 2]) -> Vec<Vector2<f64>> {
    let (mut at, mut velocity) = (Vector2::from(from), Vector2::zeros());
    let step = |_| {
        let position = PositionNed::new(at.x, at.y, -30.0);
        let constraints: Vec<Constraint> = airspace.constraints(position, Vector2::zeros()).collect();
        let command = Vector2::from(command_ne_m_s);
        let setpoint = FILTER.restrain(command, &constraints).unwrap_or(command);
        velocity += (setpoint - velocity) * 0.02;
        at += (velocity + Vector2::from(wind_ne_m_s)) * 0.02;
        at
    };
    (0..3000).map(step).collect()
}

const SQUARE: &str = "fence_ne_m = [[-100, -100], [-100, 100], [100, 100], [100, -100]]";

#[test]
fn a_vehicle_sent_through_the_fence_stops_at_the_margin() {
    for text in [SQUARE, "fence_ne_m = [[100, -100], [100, 100], [-100, 100], [-100, -100]]"] {
        let places = flown(&airspace(text), [0.0, 0.0], [FASTEST_M_S, 0.0], [0.0; 2]);
        let farthest_m = places.iter().map(|at| at.x).fold(0.0, f64::max);
        assert!((89.0..=90.01).contains(&farthest_m), "{farthest_m}");
        assert!(places.iter().all(|at| at.y.abs() <= 90.01), "along the fence it stays inside too");
    }
    // A wind that is not corrected for pushes it by its speed over κ into the margin.
    let blown = flown(&airspace(SQUARE), [0.0, 0.0], [FASTEST_M_S, 0.0], [1.0, 0.0]);
    let farthest_m = blown.iter().map(|at| at.x).fold(0.0, f64::max);
    assert!((93.5..=94.5).contains(&farthest_m), "{farthest_m}");
}

#[test]
fn a_vehicle_outside_the_fence_comes_back() {
    let places = flown(&airspace(SQUARE), [150.0, 0.0], [0.0, 0.0], [0.0; 2]);
    assert!(places.last().is_some_and(|at| at.x < 91.0), "{:?}", places.last());
}

#[test]
fn an_obstacle_in_the_way_is_passed_on_the_right_with_the_margin() {
    for shape in ["radius_m = 15", "size_ne_m = [30, 30]"] {
        let around = airspace(&format!("obstacles = [{{ centre_ne_m = [60, 0], {shape} }}]"));
        let places = flown(&around, [0.0, 0.0], [4.0, 0.0], [0.0; 2]);
        let nearest_m = places.iter().map(|at| away_from(&around.obstacles[0], *at).1).fold(f64::INFINITY, f64::min);
        assert!(nearest_m > 9.5, "{shape}: {nearest_m}");
        assert!(places.last().is_some_and(|at| at.x > 100.0 && at.y > 0.0), "{shape}: {:?}", places.last());
    }
}

#[test]
fn a_vehicle_above_the_top_of_an_obstacle_flies_over_it() {
    let low = airspace("obstacles = [{ centre_ne_m = [60, 0], radius_m = 15, top_m = 20 }]");
    let constraints =
        |altitude_m: f64| low.constraints(PositionNed::new(0.0, 0.0, -altitude_m), Vector2::zeros()).count();
    assert_eq!((constraints(24.0), constraints(26.0)), (1, 0));
}

#[test]
fn the_way_out_of_a_box_is_its_nearest_face() {
    let around = airspace("obstacles = [{ centre_ne_m = [0, 0], size_ne_m = [20, 40] }]");
    let (away, distance_m) = away_from(&around.obstacles[0], Vector2::new(-8.0, 5.0));
    assert_eq!((away, distance_m), (Vector2::new(-1.0, 0.0), -2.0));
    let (away, distance_m) = away_from(&around.obstacles[0], Vector2::new(13.0, 24.0));
    assert!((away - Vector2::new(0.6, 0.8)).norm() < 1e-12 && (distance_m - 5.0).abs() < 1e-12);
}

#[test]
fn a_moving_centre_carries_no_vehicle_through_the_fence() {
    let square = airspace(SQUARE);
    let carried = Vector2::new(4.0, 0.0);
    let constraints: Vec<Constraint> = square.constraints(PositionNed::new(90.0, 0.0, -30.0), carried).collect();
    let flown = FILTER.restrain(Vector2::zeros(), &constraints).unwrap() + carried;
    assert!(flown.x < 1e-9, "{flown}");
}

#[test]
fn altitudes_stay_between_floor_and_ceiling() {
    let between = airspace("floor_m = 20\nceiling_m = 60");
    assert_eq!([10.0, 30.0, 90.0].map(|wanted_m| between.altitude_m(wanted_m, 50.0)), [20.0, 30.0, 60.0]);
    assert_eq!(airspace("").altitude_m(90.0, 95.0), 90.0);
}

#[test]
fn the_floor_above_the_ground_rises_with_it_and_outranks_the_ceiling() {
    let over_terrain = airspace("floor_m = 20\nfloor_above_ground_m = 15\nceiling_m = 60");
    let altitudes_m = [-30.0, 0.0, 12.0, 50.0].map(|ground_m| over_terrain.altitude_m(10.0, ground_m));
    assert_eq!(altitudes_m, [20.0, 20.0, 27.0, 65.0]);
}

#[test]
fn a_mission_that_leaves_the_airspace_is_refused_with_its_step() {
    let refused = |lines: &str| check_airspace(&scenario(lines)).map_err(|why| why.to_string());
    let fence = "[airspace]\nfence_ne_m = [[-150, -150], [-150, 400], [150, 400], [150, -150]]\n";
    assert_eq!(refused(&format!("{fence}[mission]\nsteps = [{{ centre_ne_m = [0, 0] }}]\n")), Ok(()));
    let far = format!("{fence}[mission]\nsteps = [{{ centre_ne_m = [0, 0] }}, {{ centre_ne_m = [40, 0] }}]\n");
    assert!(
        refused(&far).unwrap_err().starts_with("mission.steps[1]: the formation about [40.0, 0.0] leaves the fence")
    );
    let path = format!("{fence}[mission]\nsteps = [{{ path_ne_m = [[0, 0], [0, 300]] }}]\n");
    assert!(refused(&path).unwrap_err().contains("[0.0, 300.0] leaves the fence"));
    let high = "[formation]\naltitude_m = 80\n[airspace]\nceiling_m = 70\n";
    assert!(refused(high).unwrap_err().contains("formation.altitude_m is 80"));
    let low = |plant: &str| {
        let lines = format!("plant = '{plant}'\n[formation]\naltitude_m = 20\n[airspace]\nfloor_above_ground_m = 25\n");
        refused(&format!("[swarm]\n{lines}"))
    };
    for flat in ["builtin", "standin"] {
        let why = low(flat).unwrap_err();
        assert!(
            why.starts_with("mission.steps[0]: formation.altitude_m is 20, below airspace.floor_above_ground_m"),
            "{why}"
        );
    }
    assert_eq!(low("xplane"), Ok(()), "the height of the ground is not known before the flight");
    let inside = "[airspace]\nobstacles = [{ centre_ne_m = [5, 5], radius_m = 3 }]\n";
    assert!(refused(inside).unwrap_err().contains("within airspace.margin_m of the obstacle"));
    let below = "[airspace]\nobstacles = [{ centre_ne_m = [5, 5], radius_m = 3, top_m = 20 }]\n";
    assert_eq!(refused(below), Ok(()), "30 m is above its top");
}
