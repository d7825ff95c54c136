use skein_common::frame::{Attitude, PositionNed, VelocityNed};
use skein_common::scenario::{Source, load};

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

/// Vehicle `number` at a bearing and a distance from the centre.
fn vehicle(number: u8, bearing_deg: f64, distance_m: f64, height_m: f64) -> VehicleNow {
    let (sin, cos) = bearing_deg.to_radians().sin_cos();
    let truth = Truth {
        position: PositionNed::new(distance_m * cos, distance_m * sin, -height_m),
        height_m,
        velocity: VelocityNed::default(),
        attitude: Attitude { roll_rad: 0.1, pitch_rad: -0.2, heading_rad: 3.0 },
        power_w: Some(1000.0),
    };
    let sticks = Some(Sticks { roll: 0.3, pitch: 0.0, yaw: 0.0, collective: 0.6 });
    VehicleNow { id: VehicleId::new(number).unwrap(), is_member: true, truth, sticks }
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
}

#[test]
fn steady_figures_use_the_last_hundred_seconds() {
    let mut metrics = metrics("swarm.vehicles = 2");
    for tick in 1..=20_000_u32 {
        let t_s = f64::from(tick) * 0.01;
        // Before the last hundred seconds far out; then 101 m, drifting by 1 m, with a swing of 0.5 m.
        let swing_m = 0.5 * (t_s * TAU / 5.0).cos();
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
fn ages_and_steps_are_quantiles() {
    let mut metrics = metrics("swarm.vehicles = 2");
    assert_eq!(report(&metrics).peer_age_p50_ms, None);
    for nth in 1..=100_u32 {
        metrics.observe_age(f64::from(nth) * 1e-3);
        metrics.observe_step(f64::from(nth));
    }
    let report = report(&metrics);
    assert_eq!((report.peer_age_p50_ms, report.peer_age_p99_ms), (Some(50.0), Some(99.0)));
    assert_eq!((report.step_p50_us, report.step_p99_us), (Some(50.0), Some(99.0)));
}

#[test]
fn gaps_close_around_the_circle() {
    let degrees = |bearings: &[f64]| {
        let mut bearings: Vec<_> = bearings.iter().map(|degrees| degrees.to_radians()).collect();
        largest_gap_deviation_rad(&mut bearings).map(|deviation| deviation.to_degrees().round())
    };
    assert_eq!(degrees(&[0.0, 90.0, 180.0, -90.0]), Some(0.0));
    assert_eq!(degrees(&[179.0, -1.0, 89.0, -81.0]), Some(10.0));
    assert_eq!(degrees(&[10.0]), None);
}

#[test]
fn every_key_of_the_file_is_there_even_without_a_value() {
    let report = report(&metrics("swarm.vehicles = 2"));
    let serde_json::Value::Object(keys) = serde_json::to_value(&report).unwrap() else { panic!("an object") };
    let wanted = "scenario, preset, law, conversion, plant, target, seed, version, revision, vehicles, duration_s, \
        at_altitude_s, in_band_s, even_10deg_s, even_5deg_s, radial_rms_m, radial_mean_m, radial_min_m, radial_max_m, \
        spacing_error_deg, nearest_pair_end_m, min_separation_m, collisions, safety_activations, oscillation_m, \
        max_tilt_deg, altitude_rms_m, stick_rms, energy_j, band_occupancy, polarization, order, safety, union, \
        connectivity, connected_share, centroid_lag_m, max_centre_distance_m, setpoints_reached, setpoint_skew, \
        advance_latency_s, forced_advances, detection_s, false_suspicions, state_messages, state_bytes, \
        peer_age_p50_ms, peer_age_p99_ms, step_p50_us, step_p99_us, frame_overruns, law_misses, wall_s, \
        real_time_factor, never";
    for key in wanted.split(", ") {
        assert!(keys.contains_key(key), "{key}");
    }
}
