mod network;

use skein_common::message::Failure;
use skein_common::scenario::{Source, load};
use skein_common::state::Activity;

use super::*;

/// A world of the shipped hover with these keys.
fn world(sets: &[&str]) -> World {
    let sets: Vec<String> = sets.iter().map(|&set| set.to_owned()).collect();
    let text = include_str!("../../../scenarios/hover.toml");
    let scenario = load(&Source { name: "hover.toml", text }, &sets).unwrap().scenario;
    let aircraft = vec![Aircraft::shipped("xcell60").unwrap().unwrap(); scenario.swarm.vehicles];
    World::new(&scenario, &aircraft, &Rules::shipped()).unwrap()
}

/// Simulates this time and returns the events with their times, s.
fn fly(world: &mut World, seconds: f64) -> Vec<(f64, VehicleId, EventKind)> {
    let mut events = Vec::new();
    let end_s = world.t_s() + seconds;
    while world.t_s() < end_s {
        world.tick();
        let t_s = world.t_s();
        events.extend(world.events().map(|(id, what)| (t_s, id, what)));
    }
    events
}

fn activities(world: &World) -> Vec<Activity> {
    world.vehicles().map(|(_, agent, ..)| agent.activity()).collect()
}

/// Distances from the centre, m.
fn radii_m(world: &World) -> Vec<f64> {
    world.vehicles().map(|(_, _, truth, _)| truth.position.horizontal().norm()).collect()
}

fn failures(events: &[(f64, VehicleId, EventKind)]) -> Vec<(f64, VehicleId, Failure)> {
    let failed = |(t_s, id, what): &(f64, VehicleId, EventKind)| match what {
        EventKind::Failed(failure) => Some((*t_s, *id, *failure)),
        _ => None,
    };
    events.iter().filter_map(failed).collect()
}

const POINTS: &str = "plant.model=point_mass";
const RING_THEN_LAND: &str = "mission.steps=[{ hold_s = 90 }, { land = true }]";
/// The errors that the navigation of a small vehicle leaves of those of a satellite receiver and an inertial unit.
const SATELLITE: &str = "sensing={ correlation_s = 30, noise = { position_m = 1, altitude_m = 1.5, velocity_m_s = 0.1, \
                         attitude_deg = 0.3, heading_deg = 1, rate_deg_s = 0.5 }, bias = { heading_deg = 2 } }";

#[test]
fn point_masses_take_off_surround_the_centre_and_land() {
    let mut world = world(&[POINTS, RING_THEN_LAND]);
    let events = fly(&mut world, 90.0);
    assert!(radii_m(&world).iter().all(|radius_m| (radius_m - 100.0).abs() < 1.5), "{:?}", radii_m(&world));
    let altitudes: Vec<f64> = world.vehicles().map(|(_, _, truth, _)| truth.position.altitude_m()).collect();
    assert!(altitudes.iter().all(|altitude_m| (altitude_m - 30.0).abs() < 0.01), "{altitudes:?}");
    assert!(world.traces().all(|trace| trace.controls.is_none() && trace.power_w.is_none()));
    assert!(failures(&events).is_empty(), "{:?}", failures(&events));
    let mut fastest_m_s = 0.0_f64;
    while activities(&world).iter().any(|activity| *activity != Activity::Landed) && world.t_s() < 200.0 {
        fly(&mut world, 0.02);
        let low = world.vehicles().filter(|(_, _, truth, _)| (0.0..0.3).contains(&truth.height_m));
        fastest_m_s = low.map(|(_, _, truth, _)| truth.velocity.0.norm()).fold(fastest_m_s, f64::max);
    }
    assert_eq!(activities(&world), [Activity::Landed; 4], "after {} s", world.t_s());
    assert!(fastest_m_s < 1.0 && world.vehicles().all(|(_, _, truth, _)| truth.height_m == 0.0), "{fastest_m_s} m/s");
}

#[test]
fn point_masses_fly_under_a_central_controller_and_with_agents_that_restart() {
    let mut central = world(&[POINTS, "control.mode=central"]);
    fly(&mut central, 60.0);
    assert!(radii_m(&central).iter().all(|radius_m| (radius_m - 100.0).abs() < 2.0), "{:?}", radii_m(&central));
    let killed = "mission.events=[{ at_s = 30, fault = 'kill', vehicle = 2, for_s = 20 }]";
    let mut restarted = world(&[POINTS, killed]);
    let events = fly(&mut restarted, 100.0);
    assert!(restarted.all_active() && radii_m(&restarted).len() == 4);
    assert!(events.iter().any(|(t_s, _, what)| *t_s > 30.0 && matches!(what, EventKind::PeerLost(_))));
    assert!(radii_m(&restarted).iter().all(|radius_m| (radius_m - 100.0).abs() < 2.0), "{:?}", radii_m(&restarted));
}

#[test]
fn a_point_mass_with_a_frozen_position_lands() {
    for sensors in ["sensing.noise.position_m=0", SATELLITE] {
        let frozen = "mission.events=[{ at_s = 15, fault = 'gps_frozen', vehicle = 3 }]";
        let mut world = world(&[POINTS, frozen, sensors]);
        let events = fly(&mut world, 90.0);
        let failures = failures(&events);
        assert_eq!(failures.len(), 1, "{failures:?}");
        assert_eq!((failures[0].1.get(), failures[0].2), (3, Failure::Position));
        assert_eq!(activities(&world)[2], Activity::Landed);
    }
}

#[test]
fn a_point_mass_whose_simulator_freezes_rejoins() {
    let frozen = "mission.events=[{ at_s = 20, fault = 'simulator_freeze', vehicle = 1, for_s = 3 }]";
    let mut world = world(&[POINTS, frozen]);
    fly(&mut world, 21.5);
    assert_ne!(activities(&world)[0], Activity::Blind);
    fly(&mut world, 2.0);
    assert_eq!(activities(&world)[0], Activity::Blind);
    fly(&mut world, 60.0);
    assert!(world.all_active() && radii_m(&world).iter().all(|radius_m| (radius_m - 100.0).abs() < 2.0));
}

#[test]
fn helicopters_with_the_sensors_of_real_ones_keep_the_ring_and_land() {
    let mut world = world(&[SATELLITE, RING_THEN_LAND]);
    let mut events = fly(&mut world, 90.0);
    assert!(radii_m(&world).iter().all(|radius_m| (radius_m - 100.0).abs() < 6.0), "{:?}", radii_m(&world));
    let errors: Vec<f64> = world.traces().map(|trace| (trace.estimate - trace.position).norm()).collect();
    assert!(errors.iter().all(|error_m| (0.01..10.0).contains(error_m)), "the ground truth stays exact: {errors:?}");
    events.extend(fly(&mut world, 90.0));
    assert_eq!(activities(&world), [Activity::Landed; 4]);
    assert!(failures(&events).is_empty(), "{:?}", failures(&events));
}

#[test]
fn sensors_of_the_same_seed_give_the_same_bits() {
    let flown = |seed: &str| {
        let mut world = world(&[SATELLITE, POINTS, seed, "sensing.latency_s=0.06", "sensing.dropout=0.1"]);
        fly(&mut world, 30.0);
        world.traces().map(|trace| (trace.estimate, trace.position)).collect::<Vec<_>>()
    };
    assert_eq!(flown("seed=4"), flown("seed=4"));
    assert_ne!(flown("seed=4"), flown("seed=5"));
}

#[test]
fn a_vehicle_that_is_released_for_a_time_joins_the_ring_again() {
    let release = "mission.events=[{ at_s = 60, for_s = 20, order = 'release', vehicles = [3] }]";
    let mut world = world(&[release]);
    fly(&mut world, 75.0);
    assert_eq!(activities(&world)[2], Activity::Released);
    let others = [0, 1, 3].map(|nth| activities(&world)[nth]);
    assert_eq!(others, [Activity::Formation; 3]);
    let height_m = world.vehicles().nth(2).map(|(_, _, truth, _)| truth.height_m);
    assert!(height_m.is_some_and(|height_m| height_m > 20.0), "the pilot flies: {height_m:?}");
    fly(&mut world, 60.0);
    assert!(world.all_active() && activities(&world) == [Activity::Formation; 4], "{:?}", activities(&world));
}

#[test]
fn orders_to_different_vehicles_do_not_replace_each_other() {
    let events =
        "mission.events=[{ at_s = 40, order = 'land', vehicles = [1] }, { at_s = 40, order = 'hold', vehicles = [2] }]";
    let mut world = world(&[events]);
    fly(&mut world, 90.0);
    assert_eq!(activities(&world), [Activity::Landed, Activity::Holding, Activity::Formation, Activity::Formation]);
}
