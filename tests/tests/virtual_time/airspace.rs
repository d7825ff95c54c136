//! The airspace in virtual time: every law keeps a fence through its formation and passes obstacles without a collision.

use skein_common::frame::Origin;
use skein_common::id::{Incarnation, VehicleId};
use skein_common::math;
use skein_common::scenario::StaticObstacle;
use skein_common::state::Activity;
use skein_common::time::{LocalTime, Now};
use skein_core::agent::{Agent, Inputs};
use skein_core::aircraft::Aircraft;
use skein_core::control::Rules;
use skein_core::formation::Workspace;
use skein_core::formation::laws::built_in;
use skein_core::helicopter::{BuiltInVehicle, Start, Weather};
use skein_core::peers::Broadcast;
use skein_core::plant::{Command, Measurement, PlantStatus};
use skein_lab::metrics::{Report, Run};
use skein_lab::recording::{Recording, Step};
use skein_tests::{of_scenario, scenario};

/// Half the length of the square fence, m: through the ring of 100 m.
const FENCE_M: f64 = 80.0;

/// Flies a scenario of a mission that `skein check` would refuse because it leads through the fence.
fn flown(sets: &[&str], obstacle: Option<StaticObstacle>, fence_m: Option<f64>) -> (Report, Recording) {
    let name = if sets.iter().any(|set| set.contains("path_ne_m")) { "flock.toml" } else { "hover.toml" };
    let mut scenario = scenario(name, sets);
    if let Some(far_m) = fence_m {
        scenario.airspace.fence_ne_m = vec![[-far_m, -far_m], [-far_m, far_m], [far_m, far_m], [far_m, -far_m]];
    }
    scenario.airspace.obstacles.extend(obstacle);
    let mut recording = Recording::new(&scenario, Run::new(&scenario, "study"));
    let study = of_scenario(scenario);
    let report = study.fly_watched(study.scenario.seed, Some((&mut recording, 5.0))).unwrap();
    (report, recording)
}

fn steps(recording: &Recording) -> impl Iterator<Item = &Step> {
    recording.tracks.iter().flat_map(|track| &track.steps)
}

#[test]
fn every_law_keeps_a_fence_through_its_formation_in_wind() {
    for law in built_in() {
        let law_set = format!("formation.law={law}");
        let sets = [&law_set, "world.wind_m_s=8", "world.gust_w20_m_s=3", "duration_s=60", "start.square_m=100"];
        let (report, recording) = flown(&sets, None, Some(FENCE_M));
        let beyond_m = |step: &Step| {
            let position = step.trace.position;
            position.north_m().abs().max(position.east_m().abs()) - FENCE_M
        };
        let most_m = steps(&recording).map(beyond_m).fold(f64::NEG_INFINITY, f64::max);
        println!("{law}: {:.1} m inside the fence", -most_m);
        assert!(most_m < 0.0, "{law}: {most_m} m beyond the fence");
        assert_eq!((report.collisions, report.crashes), (0, 0), "{law}");
    }
}

#[test]
fn a_flock_passes_an_obstacle_on_its_path_without_touching_it() {
    let sets = ["duration_s=150", "mission.steps=[{ path_ne_m = [[0, 0], [200, 0]], speed_m_s = 2.0 }]"];
    let obstacle = StaticObstacle { centre_ne_m: [90.0, 0.0], radius_m: Some(15.0), size_ne_m: None, top_m: None };
    let (report, recording) = flown(&sets, Some(obstacle), None);
    let clear_m = |step: &Step| {
        let position = step.trace.position;
        math::hypot(position.north_m() - 90.0, position.east_m()) - 15.0
    };
    let nearest_m = steps(&recording).map(clear_m).fold(f64::INFINITY, f64::min);
    println!("nearest to the obstacle: {nearest_m:.1} m");
    assert!(nearest_m > 0.0, "{nearest_m}");
    assert_eq!((report.collisions, report.crashes), (0, 0));
    let passed = recording.tracks.iter().filter(|track| track.steps.last().unwrap().trace.position.north_m() > 120.0);
    assert_eq!(passed.count(), recording.tracks.len(), "every vehicle has passed it");
}

#[test]
fn vehicles_are_kept_at_the_floor_above_the_ground_and_land_below_it() {
    for law in ["ring", "vasarhelyi"] {
        let law_set = format!("formation.law={law}");
        let lands = "mission.events=[{ at_s = 60, order = 'land', vehicles = [1] }]";
        let mut scenario = scenario("hover.toml", &[&law_set, lands, "formation.altitude_m=20", "duration_s=150"]);
        // `skein check` would refuse it: the formation is below.
        scenario.airspace.floor_above_ground_m = Some(35.0);
        let mut recording = Recording::new(&scenario, Run::new(&scenario, "study"));
        let study = of_scenario(scenario);
        let report = study.fly_watched(study.scenario.seed, Some((&mut recording, 5.0))).unwrap();
        assert_eq!((report.collisions, report.crashes), (0, 0), "{law}");
        for (nth, track) in recording.tracks.iter().enumerate() {
            let flown = |step: &&Step| step.trace.activity == Activity::Formation && step.t_s > 40.0;
            let heights_m: Vec<_> = track.steps.iter().filter(flown).map(|step| step.trace.height_m).collect();
            let least_m = heights_m.iter().copied().fold(f64::INFINITY, f64::min);
            println!("{law}: {least_m:.1} m above the ground in {} steps", heights_m.len());
            assert!(heights_m.len() > 50 && least_m > 33.0, "{law}: {least_m} m");
            let last = track.steps.last().unwrap().trace.activity;
            assert_eq!(last, if nth == 0 { Activity::Landed } else { Activity::Formation }, "{law}");
        }
    }
}

/// Height of the ground above the origin, m: flat, then a slope of 1 in 5, then a plateau of 25 m.
fn ground_m(north_m: f64) -> f64 {
    (0.2 * (north_m - 60.0)).clamp(0.0, 25.0)
}

/// The built-in plant stands on flat ground, so that the hill is in what the vehicle measures: its height above the ground.
#[test]
fn a_vehicle_climbs_over_a_hill_on_its_path_and_returns_to_its_altitude() {
    let path = "mission.steps=[{ hold_s = 15 }, { path_ne_m = [[0, 0], [300, 0], [0, 0]], speed_m_s = 2 }]";
    let floor = "airspace.floor_above_ground_m=15";
    let scenario = scenario("flock.toml", &["swarm.vehicles=1", "formation.altitude_m=30", floor, path]);
    let aircraft = Aircraft::shipped("xcell60").unwrap().unwrap();
    let id = VehicleId::new(1).unwrap();
    let mut agent = Agent::new(&scenario, id, Incarnation(1), &aircraft, Rules::shipped()).unwrap();
    let origin = Origin::new(scenario.origin.geodetic());
    let calm = Weather::default();
    let mut vehicle =
        BuiltInVehicle::new(&origin, aircraft.helicopter.as_ref().unwrap(), &Start::default(), &calm, 1, id);
    let mut workspace = Workspace::default();
    // Above the ground and above the origin, once the vehicle follows its path.
    let (mut heights_m, mut altitudes_m, mut furthest_m) = (Vec::new(), Vec::new(), 0.0_f64);
    for _ in 0..18_000 {
        let frame = vehicle.frame();
        let truth = frame.truth;
        let height_m = truth.height_m - ground_m(truth.position.north_m());
        let measurement = Measurement { height_m, ..frame.measurement };
        let now = Now { plant: frame.time, local: LocalTime::from_seconds(frame.time.seconds()) };
        let inputs = Inputs {
            did_not_run_s: None,
            status: &PlantStatus::default(),
            measurement: Some(&measurement),
            received: &[],
            broadcast: Broadcast::default(),
            strangers: None,
            intents: &[],
            leave: false,
            answer: None,
        };
        let controls = match agent.step(now, &inputs, &mut workspace).command {
            Some(Command::Controls(controls)) => Some(controls),
            _ => None,
        };
        vehicle.advance(controls);
        furthest_m = furthest_m.max(truth.position.north_m());
        if frame.time.seconds() > 40.0 {
            heights_m.push(height_m);
            altitudes_m.push(truth.height_m);
        }
    }
    let least_m = heights_m.iter().copied().fold(f64::INFINITY, f64::min);
    let (highest_m, last_m) = (altitudes_m.iter().copied().fold(0.0, f64::max), *altitudes_m.last().unwrap());
    println!(
        "{furthest_m:.0} m north; at least {least_m:.1} m above the ground; up to {highest_m:.1} m, at last {last_m:.1} m"
    );
    assert!(furthest_m > 280.0, "it crosses the hill");
    assert!(least_m > 13.0, "{least_m} m above the ground");
    assert!((39.0..42.0).contains(&highest_m), "{highest_m} m above the origin on the plateau");
    assert!((last_m - 30.0).abs() < 1.0, "{last_m} m above the origin on flat ground again");
}
