use skein_common::frame::{Attitude, PositionNed, VelocityNed};
use skein_common::id::VehicleSet;
use skein_common::math;
use skein_common::message::Failure;
use skein_common::scenario::{Source, load};
use skein_common::state::Membership;
use skein_core::plant::{Controls, GroundTruth};
use std::collections::BTreeSet;

use super::*;

fn scenario(text: &str) -> Scenario {
    load(&Source { name: "test.toml", text }, &[]).unwrap().scenario
}

fn metrics(text: &str) -> Metrics {
    let scenario = scenario(text);
    Metrics::new(&scenario, Run::new(&scenario, "study"))
}

fn report(metrics: &Metrics) -> Report {
    metrics.report(Wall { wall_s: 1.0, real_time_factor: 1.0 })
}

/// Vehicle `number` at this bearing, distance from the centre and height.
pub(super) fn vehicle(number: u8, bearing_deg: f64, distance_m: f64, height_m: f64) -> VehicleNow {
    let (sin, cos) = math::sin_cos(bearing_deg.to_radians());
    let truth = GroundTruth {
        position: PositionNed::new(distance_m * cos, distance_m * sin, -height_m),
        height_m,
        velocity: VelocityNed::default(),
        attitude: Attitude { roll_rad: 0.1, pitch_rad: -0.2, heading_rad: 3.0 },
        power_w: Some(1000.0),
    };
    let controls = Some(Controls { roll: 0.3, pitch: 0.0, yaw: 0.0, collective: 0.6 });
    VehicleNow {
        runs: true,
        membership: Membership::Active,
        controls,
        in_contact: VehicleId::first(3).collect(),
        ..VehicleNow::dead(VehicleId::new(number).unwrap(), truth)
    }
}

/// A set of these vehicles.
pub(super) fn set(numbers: &[u8]) -> VehicleSet {
    numbers.iter().map(|&number| VehicleId::new(number).unwrap()).collect()
}

#[test]
fn settling_is_the_first_time_after_which_a_condition_holds_to_the_end() {
    let mut metrics = metrics("swarm.vehicles = 2");
    for (t_s, distance_m, height_m) in
        [(1.0, 90.0, 0.0), (2.0, 90.0, 28.0), (3.0, 130.0, 28.0), (4.0, 119.0, 26.0), (5.0, 110.0, 30.0)]
    {
        let bearing_deg = if t_s < 3.0 { 150.0 } else { 172.0 };
        metrics.observe(t_s, &[vehicle(1, 0.0, distance_m, height_m), vehicle(2, bearing_deg, distance_m, height_m)]);
    }
    let report = report(&metrics);
    assert_eq!(report.in_band_s, Some(4.0), "left the band once");
    assert_eq!(report.at_altitude_s, Some(5.0), "27 m, for good");
    assert_eq!(report.even_10deg_s, Some(3.0), "8 degrees off from then on");
    assert_eq!(report.even_5deg_s, None);
    assert_eq!(report.never, ["even_5deg_s"]);
    assert_eq!(report.radial_rms_m, None, "no steady figures in a short window");
    assert!((report.max_tilt_deg - 0.2_f64.to_degrees()).abs() < 1e-9);
    assert_eq!(report.energy_j, Some(2.0 * 1000.0 * 5.0));
    assert!((report.stick_rms.unwrap() - 0.3 / 3.0_f64.sqrt()).abs() < 1e-12);
}

#[test]
fn what_had_settled_before_the_landing_stays_settled() {
    let mut metrics = metrics("swarm.vehicles = 2\nmission.steps = [{ centre_ne_m = [0, 0] }, { land = true }]");
    let at = |step, height_m| {
        [0.0, 180.0]
            .into_iter()
            .zip(1..)
            .map(move |(bearing_deg, number)| VehicleNow { step, ..vehicle(number, bearing_deg, 100.0, height_m) })
    };
    let both = |step, height_m| at(step, height_m).collect::<Vec<_>>();
    metrics.observe(1.0, &both(0, 30.0));
    metrics.observe(2.0, &both(0, 30.0));
    let landing = at(1, 20.0).map(|vehicle| VehicleNow { membership: Membership::Left, ..vehicle });
    // Vehicle 2 follows a moment later.
    metrics.observe(3.0, &[at(1, 20.0).next().unwrap(), at(0, 30.0).last().unwrap()]);
    metrics.observe(4.0, &landing.collect::<Vec<_>>());
    let report = report(&metrics);
    assert_eq!((report.at_altitude_s, report.in_band_s, report.even_5deg_s), (Some(1.0), Some(1.0), Some(1.0)));
    assert_eq!(report.never, [""; 0]);
}

#[test]
fn separations_count_pairs_in_the_air_and_collisions_count_pairs() {
    let mut metrics = metrics("swarm.vehicles = 3");
    metrics.observe(0.1, &[vehicle(1, 0.0, 1.0, 1.0), vehicle(2, 180.0, 0.5, 30.0), vehicle(3, 90.0, 100.0, 30.0)]);
    assert_eq!(report(&metrics).collisions, 0, "one of the near pair is on the ground");
    for t_s in [0.2, 0.3] {
        metrics
            .observe(t_s, &[vehicle(1, 0.0, 1.0, 30.0), vehicle(2, 180.0, 0.5, 30.0), vehicle(3, 90.0, 100.0, 30.0)]);
    }
    metrics.observe(0.4, &[vehicle(1, 0.0, 10.0, 30.0), vehicle(2, 180.0, 10.0, 30.0), vehicle(3, 90.0, 100.0, 30.0)]);
    let report = report(&metrics);
    assert_eq!(report.collisions, 1, "one pair, however often");
    assert!((report.min_separation_m.unwrap() - 1.5).abs() < 1e-9);
    assert!((report.nearest_pair_end_m.unwrap() - 20.0).abs() < 1e-9);
    assert!((report.safety.unwrap() - 2.0 / 3.0).abs() < 1e-12);
    assert!((report.collision_risk.unwrap() - 1.0 / 6.0).abs() < 1e-12, "one of three pairs, at two of four instants");
}

#[test]
fn steady_figures_use_the_last_hundred_seconds() {
    let mut metrics = metrics("swarm.vehicles = 2");
    for tick in 0..=10_000_u32 {
        let t_s = f64::from(tick) * 0.02;
        // Before the last hundred seconds far out; then 101 m, drifting by 1 m, with a swing of 0.5 m.
        let swing_m = 0.5 * math::cos(t_s * TAU / 5.0);
        let distance_m = if t_s < 100.0 { 500.0 } else { 101.0 + (t_s - 100.0) * 0.01 + swing_m };
        metrics.observe(t_s, &[vehicle(1, 0.0, distance_m, 31.0), vehicle(2, 176.0, distance_m, 31.0)]);
    }
    let report = report(&metrics);
    let near = |figure: Option<f64>, expected: f64, tolerance: f64| (figure.unwrap() - expected).abs() < tolerance;
    assert!(near(report.radial_mean_m, 101.5, 0.02), "{:?}", report.radial_mean_m);
    assert!(near(report.oscillation_m, 0.5, 0.02), "without the drift: {:?}", report.oscillation_m);
    assert!(near(report.radial_max_m, 102.5, 0.1) && near(report.radial_min_m, 100.5, 0.1));
    assert!(near(report.spacing_error_deg, 4.0, 1e-9));
    assert!(near(report.altitude_rms_m, 1.0, 1e-9));
    assert!(near(report.band_occupancy, 1.0, 1e-12));
    assert_eq!(report.in_band_s, Some(100.0));
}

#[test]
fn the_share_of_the_fallback_is_that_of_the_vehicle_where_it_is_largest() {
    let mut metrics = metrics("swarm.vehicles = 3");
    let flown_by =
        |n: u8, fallback_flies| VehicleNow { fallback_flies, ..vehicle(n, 120.0 * f64::from(n), 100.0, 30.0) };
    assert_eq!(report(&metrics).fallback_share, None, "nothing was observed");
    for (t_s, second) in [(0.1, false), (0.3, true), (0.5, false), (0.7, false)] {
        metrics.observe(t_s, &[flown_by(1, Some(false)), flown_by(2, Some(second)), flown_by(3, None)]);
    }
    let left = VehicleNow { membership: Membership::Left, ..flown_by(2, Some(true)) };
    metrics.observe(0.9, &[flown_by(1, Some(false)), left, flown_by(3, None)]);
    let report = report(&metrics);
    assert_eq!(report.fallback_share, Some(0.25), "not while it lands");
    let shares: Vec<_> = report.vehicle.values().map(|vehicle| vehicle.fallback_share).collect();
    assert_eq!(shares, [Some(0.0), Some(0.25), None]);
}

#[test]
fn ages_and_steps_are_quantiles() {
    let mut metrics = metrics("swarm.vehicles = 2");
    assert_eq!(report(&metrics).peer_age_p50_ms, None);
    // 101 samples: the percentiles are samples.
    for nth in 0..=100_u32 {
        metrics.observe_age(f64::from(nth) * 1e-3);
        metrics.observe_step(f64::from(nth));
    }
    let report = report(&metrics);
    assert_eq!((report.peer_age_p50_ms, report.peer_age_p99_ms), (Some(50.0), Some(99.0)));
    assert_eq!((report.step_p50_us, report.step_p99_us), (Some(50.0), Some(99.0)));
}

#[test]
fn the_last_gap_closes_the_circle() {
    let degrees = |bearings: &[f64]| {
        let mut bearings: Vec<_> = bearings.iter().map(|degrees| degrees.to_radians()).collect();
        largest_gap_deviation_rad(&mut bearings).map(|deviation| deviation.to_degrees().round())
    };
    assert_eq!(degrees(&[0.0, 90.0, 180.0, -90.0]), Some(0.0));
    assert_eq!(degrees(&[179.0, -1.0, 89.0, -81.0]), Some(10.0));
    assert_eq!(degrees(&[10.0]), None);
}

#[test]
fn every_key_is_written_even_without_a_value_and_is_in_the_table_of_figures() {
    let report = report(&metrics("swarm.vehicles = 2"));
    let serde_json::Value::Object(keys) = serde_json::to_value(&report).unwrap() else { panic!("an object") };
    let run = ["scenario", "preset", "law", "conversion", "plant", "target", "seed", "version", "revision", "vehicles"];
    let figures = figures::FIGURES.iter().map(|figure| figure.key);
    let expected: BTreeSet<&str> = run.into_iter().chain(["vehicle"]).chain(figures.clone()).collect();
    assert_eq!(keys.keys().map(String::as_str).collect::<BTreeSet<_>>(), expected);
    assert_eq!(expected.len(), run.len() + 1 + figures.len(), "every figure is in the table once");
}

/// The same vehicle about another centre, at this step.
fn about(vehicle: VehicleNow, step: u32, north_m: f64) -> VehicleNow {
    let mut vehicle = VehicleNow { step, centre_ne_m: Vector2::new(north_m, 0.0), ..vehicle };
    vehicle.truth.position.0.x += north_m;
    vehicle
}

#[test]
fn figures_use_the_formation_of_the_step_about_the_vehicles_own_centre() {
    let mut metrics = metrics(
        "swarm.vehicles = 2\nmission.steps = [{ centre_ne_m = [0, 0] }, { centre_ne_m = [300, 0], formation = { radius_m = \
         50, altitude_m = 60 } }]",
    );
    let at = |step, north_m, distance_m, height_m| {
        [(1, 0.0), (2, 178.0)]
            .map(|(number, bearing_deg)| about(vehicle(number, bearing_deg, distance_m, height_m), step, north_m))
    };
    for tick in 1..=15_000_u32 {
        let t_s = f64::from(tick) * 0.01;
        metrics.observe(t_s, &if t_s < 20.0 { at(0, 0.0, 100.0, 30.0) } else { at(1, 300.0, 52.0, 61.0) });
    }
    let report = report(&metrics);
    assert!((report.radial_rms_m.unwrap() - 2.0).abs() < 1e-9, "about 50 m: {:?}", report.radial_rms_m);
    assert!((report.altitude_rms_m.unwrap() - 1.0).abs() < 1e-9, "about 60 m");
    assert_eq!((report.in_band_s, report.at_altitude_s, report.even_5deg_s), (Some(0.01), Some(0.01), Some(0.01)));
    assert!((report.spacing_error_deg.unwrap() - 2.0).abs() < 1e-9);
    assert_eq!((report.setpoints_reached, report.setpoint_skew, report.forced_advances), (Some(1), Some(0), Some(0)));
}

#[test]
fn settling_does_not_apply_in_a_mission_of_several_places() {
    let steps = "swarm.vehicles = 2\nmission.steps = [{ centre_ne_m = [0, 0] }, { centre_ne_m = [300, 0] }]";
    let far = |number| vehicle(number, 0.0, 200.0, 1.0);
    let report = |text: &str| {
        let mut metrics = metrics(text);
        metrics.observe(1.0, &[far(1), far(2)]);
        report(&metrics)
    };
    let several = report(steps);
    assert_eq!((several.in_band_s, several.never.len()), (None, 0));
    let one = report("swarm.vehicles = 2\nmission.steps = [{ centre_ne_m = [0, 0] }, { land = true }]");
    assert_eq!(one.never, ["at_altitude_s", "in_band_s", "even_10deg_s", "even_5deg_s"]);
    assert_eq!((one.setpoint_skew, one.advance_latency_s), (Some(0), None));
    let flock = report("swarm.vehicles = 2\nformation.law = \"flock\"");
    assert_eq!(flock.never, ["at_altitude_s", "in_band_s"], "a flock has no even spacing");
    assert_eq!((flock.setpoint_skew, flock.forced_advances), (None, None), "there is only one step");
}

#[test]
fn a_flock_is_measured_from_the_first_movement_of_its_centre_on() {
    let mut metrics = metrics(
        "swarm.vehicles = 2\nformation.law = \"flock\"\nmission.steps = [{ hold_s = 1 }, { path_ne_m = [[0, 0], [30, 0]] }]",
    );
    let pair = |step, north_m, one_m, other_m| {
        [about(vehicle(1, 0.0, one_m, 30.0), step, north_m), about(vehicle(2, 180.0, other_m, 30.0), step, north_m)]
    };
    // 1.5 m and 200 m apart before the centre moves.
    metrics.observe(1.0, &pair(0, 0.0, 0.75, 0.75));
    metrics.observe(2.0, &pair(1, 0.0, 100.0, 100.0));
    metrics.observe(3.0, &pair(1, 10.0, 40.0, 20.0));
    metrics.observe(4.0, &pair(1, 20.0, 60.0, 0.0));
    // At the end of the path the centre rests again.
    metrics.observe(5.0, &pair(1, 30.0, 90.0, 50.0));
    let report = report(&metrics);
    assert_eq!(report.collisions, 0);
    assert!((report.min_separation_m.unwrap() - 60.0).abs() < 1e-9, "{:?}", report.min_separation_m);
    assert!((report.max_centre_distance_m.unwrap() - 60.0).abs() < 1e-9, "while it moves");
    assert_eq!(report.band_occupancy, Some(0.75), "three of four within 50 m");
    assert!((report.centroid_lag_m.unwrap() - 20.0).abs() < 1e-9, "10, 30 and 20 m");
}

#[test]
fn bands_have_their_own_altitudes_and_an_ellipsoid_has_all() {
    let report = |text: &str, heights_m: [f64; 2]| {
        let mut metrics = metrics(&format!("swarm.vehicles = 2\n{text}"));
        for tick in 0..=101_u32 {
            let [low_m, high_m] = heights_m;
            metrics.observe(f64::from(tick), &[vehicle(1, 0.0, 100.0, low_m), vehicle(2, 180.0, 100.0, high_m)]);
        }
        report(&metrics)
    };
    let bands = report("formation.band_step_m = 10", [25.0, 36.0]);
    assert!(
        (bands.altitude_rms_m.unwrap() - 0.5_f64.sqrt()).abs() < 1e-9,
        "one exact, one 1 m off: {:?}",
        bands.altitude_rms_m
    );
    assert_eq!(bands.at_altitude_s, Some(0.0));
    // gamma_z = 4, 40 m above a centre at 130 m: rho = sqrt(100^2 + 4 * 40^2) = 128.06 m, outside the band.
    let text = "formation.altitude_m = 130\nformation.vertical = \"ellipsoid\"\nformation.gamma_z = 4";
    let ellipsoid = report(text, [130.0, 170.0]);
    assert!((ellipsoid.radial_max_m.unwrap() - 16_400.0_f64.sqrt()).abs() < 1e-5, "{:?}", ellipsoid.radial_max_m);
    assert_eq!((ellipsoid.altitude_rms_m, ellipsoid.at_altitude_s), (None, None));
    assert_eq!((ellipsoid.never, ellipsoid.band_occupancy), (vec!["in_band_s"], Some(0.5)));
}

#[test]
fn steady_figures_leave_out_vehicles_that_were_gone_before() {
    let mut metrics = metrics("swarm.vehicles = 3");
    for t_s in 0..=300_u32 {
        let alive = [vehicle(1, 0.0, 101.0, 30.0), vehicle(2, 180.0, 101.0, 30.0)];
        let gone = VehicleNow { runs: t_s < 150, ..vehicle(3, 90.0, 500.0, 30.0) };
        metrics.observe(f64::from(t_s), &[alive[0], alive[1], gone]);
    }
    let report = report(&metrics);
    assert!((report.radial_rms_m.unwrap() - 1.0).abs() < 1e-9, "{:?}", report.radial_rms_m);
    assert_eq!(report.vehicle["3"].radial_mean_m, None);
    assert!((report.min_separation_m.unwrap() - 202.0).abs() < 1e-9);
}

#[test]
fn injected_faults_and_reported_events_appear_in_the_report() {
    let id = |number| VehicleId::new(number).unwrap();
    let mut metrics =
        metrics("swarm.vehicles = 3\nmission.steps = [{ centre_ne_m = [0, 0] }, { centre_ne_m = [9, 0] }]");
    let member = |number: u8, bearing_deg, in_contact: &[u8]| VehicleNow {
        in_contact: set(in_contact),
        ..vehicle(number, bearing_deg, 100.0, 30.0)
    };
    metrics.observe(0.0, &[member(1, 0.0, &[2, 3]), member(2, 120.0, &[1, 3]), member(3, 240.0, &[1, 2])]);
    metrics.fault(10.0, &InjectedFault::Died(id(3)));
    metrics.fault(10.0, &InjectedFault::Failed(id(2), "gyro_off"));
    let dead = VehicleNow::dead(id(3), vehicle(3, 0.0, 0.0, 30.0).truth);
    metrics.observe_event(10.5, id(2), &EventKind::Failed(Failure::Gyro));
    metrics.observe_event(10.5, id(2), &EventKind::ForcedAdvance { to: 1, without: set(&[3]) });
    metrics.observe_event(10.5, id(1), &EventKind::PeerLost(id(3)));
    metrics.observe(10.5, &[member(1, 0.0, &[2]), member(2, 120.0, &[1]), dead]);
    metrics.observe(40.0, &[member(1, 0.0, &[2]), member(2, 175.0, &[1]), dead]);
    metrics.fault(50.0, &InjectedFault::Cut { links: vec![(id(1), id(2))] });
    metrics.observe(85.0, &[member(1, 0.0, &[2]), member(2, 175.0, &[1]), dead]);
    let report = report(&metrics);
    assert_eq!((report.response_s, report.transient_s), (Some(0.5), Some(29.5)));
    assert_eq!((report.detection_s, report.rejoin_s), (None, None), "the cut was never noticed");
    assert_eq!(report.never, ["detection_s"]);
    assert_eq!((report.forced_advances, report.false_suspicions), (Some(1), Some(0)));
    assert!((report.min_separation_m.unwrap() - 100.0).abs() < 1e-9, "to the dead one at the centre too");
}
