//! Central control: how closely it flies to a controller on each vehicle, and its limits.

use serde_json::Value;
use skein_common::state::Membership;
use skein_core::plant::GroundTruth;
use skein_lab::faults::InjectedFault;
use skein_lab::metrics::{Report, WALL_CLOCK_KEYS};
use skein_lab::study::Study;
use skein_lab::world::World;
use skein_tests::central::{Case, PLAIN};
use skein_tests::study;

const CENTRAL: &str = "control.mode=central";

fn world(sets: &[&str]) -> World {
    let Study { scenario, aircraft, rules, .. } = study("hover.toml", sets);
    World::new(&scenario, &aircraft, &rules).unwrap()
}

fn truths(world: &World) -> Vec<GroundTruth> {
    world.all_vehicles().map(|(_, _, truth, _)| *truth).collect()
}

/// The figures that do not depend on the wall clock.
fn figures(report: &Report) -> Value {
    let mut value = serde_json::to_value(report).unwrap();
    let keys = value.as_object_mut().unwrap();
    WALL_CLOCK_KEYS.iter().for_each(|key| assert!(keys.remove(*key).is_some(), "{key}"));
    value
}

#[test]
fn over_a_perfect_network_fast_central_control_flies_the_same_bits() {
    // In gusts, with infinite speed and with the default computing time.
    for speed in ["control.central_step_s=0", "control.central_step_s=0.0001"] {
        let sets = ["network.send=every_frame", "world.wind_m_s=5", "world.gust_w20_m_s=5"];
        let mut each = world(&sets);
        let mut central = world(&[&sets[..], &[CENTRAL, speed]].concat());
        for _ in 0..3000 {
            each.tick();
            central.tick();
            assert_eq!(truths(&each), truths(&central), "{speed}: at {} s", each.t_s());
        }
        assert!(truths(&each).iter().all(|truth| truth.height_m > 25.0), "a vehicle did not climb");
    }
}

#[test]
fn central_control_over_a_perfect_network_has_almost_the_same_figures() {
    let sets = ["duration_s=200", "swarm.vehicles=6"];
    let each = study("hover.toml", &sets).fly(3).unwrap();
    let central = study("hover.toml", &[&sets[..], &[CENTRAL]].concat()).fly(3).unwrap();
    let near = |name: &str, figure: fn(&Report) -> Option<f64>, by: f64| {
        let (each, central) = (figure(&each).unwrap(), figure(&central).unwrap());
        assert!((each - central).abs() <= by, "{name}: each {each}, central {central}");
    };
    near("in_band_s", |report| report.in_band_s, 0.5);
    near("even_10deg_s", |report| report.even_10deg_s, 1.0);
    near("radial_rms_m", |report| report.radial_rms_m, 0.02);
    near("min_separation_m", |report| report.min_separation_m, 0.2);
    assert!(central.peer_age_p50_ms.is_none() && each.peer_age_p50_ms.is_some());
    assert_eq!((central.frame_overruns, each.frame_overruns), (Some(0), None));
    // Two datagrams a frame and vehicle, 69 and 77 bytes; the first frames have no controls yet.
    let frames = 6 * 50 * 200;
    assert!((2 * frames..2 * frames + 6 * 250).contains(&central.state_messages), "{}", central.state_messages);
    assert!(central.state_bytes.abs_diff(73 * central.state_messages) < 4 * 6 * 250, "{}", central.state_bytes);
}

#[test]
fn a_killed_central_controller_loses_all_vehicles_a_killed_agent_loses_one() {
    let killed = Case { killed: true, breeze: true, ..PLAIN };
    let each = killed.fly(0);
    assert_eq!((each.report.crashes, each.in_formation), (1, 3));
    assert!(each.report.detection_s.is_some_and(|noticed_s| noticed_s < 0.03));
    let central = Case { central: true, ..killed }.fly(0);
    // Some vehicles drift in the wind with their last controls; their positions are undefined.
    assert!(central.report.crashes > 1, "{} crashes", central.report.crashes);
    assert_eq!(central.in_formation, 0);
    assert!(central.report.in_band_s.is_none() && central.report.never.contains(&"in_band_s"));
    // No agent is left to notice.
    assert!(central.report.detection_s.is_none() && !central.report.never.contains(&"detection_s"));
}

#[test]
fn a_central_controller_that_restarts_soon_controls_all_vehicles_again() {
    let events = "mission.events=[{ at_s = 60, for_s = 1, fault = 'kill_control' }]";
    let mut world = world(&[CENTRAL, events, "network.loss=0.1", "network.delay_s=0.02"]);
    let (mut died, mut restarted) = (Vec::new(), Vec::new());
    while world.t_s() < 120.0 {
        world.tick();
        for fault in world.faults() {
            match fault {
                InjectedFault::Died(_) => died.push(world.t_s()),
                InjectedFault::Restarted(_) => restarted.push(world.t_s()),
                _ => panic!("{fault:?}"),
            }
        }
        assert_eq!(world.vehicles().count(), if died.len() > restarted.len() { 0 } else { 4 });
    }
    assert_eq!((died.len(), restarted.len()), (4, 4));
    assert!((restarted[0] - died[0] - 1.0).abs() < 0.021, "{died:?} {restarted:?}");
    assert!(world.vehicles().all(|(_, agent, ..)| agent.membership() == Membership::Active));
    for truth in truths(&world) {
        assert!((truth.position.horizontal().norm() - 100.0).abs() < 20.0, "{truth:?}");
        assert!((truth.height_m - 30.0).abs() < 3.0, "{truth:?}");
    }
}

#[test]
fn a_slow_central_controller_skips_frames_a_too_slow_one_loses_the_swarm() {
    // Eight vehicles at 10 ms each: the controller needs four frames for one.
    let slow = Case { central: true, vehicles: 8, step_s: Some(0.01), ..PLAIN };
    let flight = slow.fly(1);
    let frames: f64 = 300.0 * 50.0;
    let left_out = flight.report.frame_overruns.unwrap() as f64;
    assert!((left_out / frames - 0.75).abs() < 0.01, "{left_out}");
    let sent = flight.report.state_messages as f64 / (8.0 * frames);
    assert!((sent - 1.25).abs() < 0.02, "a state in every frame, controls in every fourth: {sent}");
    assert_eq!((flight.in_formation, flight.report.crashes), (8, 0));

    let flight = Case { step_s: Some(0.05), ..slow }.fly(1);
    assert!(flight.report.crashes > 0 && flight.in_formation < 8, "2.5 frames a second");
}

#[test]
fn central_control_fails_with_a_long_delay_each_way() {
    let central = Case { central: true, ..PLAIN };
    for delay_s in [0.1, 0.25] {
        let flight = Case { delay_s, ..central }.fly(2);
        let flies = (flight.in_formation, flight.report.crashes) == (4, 0);
        assert_eq!(flies, delay_s < 0.2, "{delay_s} s: {} in formation", flight.in_formation);
        let each = Case { delay_s, ..PLAIN }.fly(2);
        assert_eq!((each.in_formation, each.report.crashes), (4, 0), "{delay_s} s");
    }
}

#[test]
fn the_same_seed_gives_the_same_flight() {
    let sets = ["duration_s=80", "network.loss=0.3", "network.delay_s=0.05", "control.central_step_s=0.008", CENTRAL];
    let study = study("hover.toml", &sets);
    let (one, again) = (study.fly(5).unwrap(), study.fly(5).unwrap());
    assert_eq!(figures(&one), figures(&again));
    assert_eq!(one.frame_overruns, again.frame_overruns);
    assert_ne!(figures(&one), figures(&study.fly(6).unwrap()));
}
