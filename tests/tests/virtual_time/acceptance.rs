//! Acceptance figures of the swarm in virtual time, and repeatability.

use std::num::NonZeroUsize;

use serde_json::Value;
use skein_common::id::VehicleId;
use skein_common::state::{Membership, PeerStatus};
use skein_lab::compare::divergence::{ComparedPair, Divergence, FigureDifference};
use skein_lab::metrics::limits::{self, Limit};
use skein_lab::metrics::{Measured, Metrics, Report, Run, WALL_CLOCK_KEYS, Wall};
use skein_lab::study::{Study, measure, summarize};
use skein_lab::world::World;
use skein_tests::divergence::too_far;
use skein_tests::{in_parallel, scenario, study, wire};

const TWO: NonZeroUsize = NonZeroUsize::MIN.saturating_add(1);

fn fly(study: &Study, seeds: u64) -> Vec<Report> {
    study.fly_all(0..seeds, TWO, |_| {}).unwrap()
}

/// Checks that a flight of the four-vehicle hover formation keeps these limits.
fn keeps(report: &Report, limits: &[Limit]) {
    let run = Measured::of(report);
    for limit in limits {
        let figure = run.outcome(limit.key);
        assert!(limit.is_kept(&run), "seed {}: {} is {figure:?}, {:?}", run.seed, limit.key, limit.bound);
    }
}

#[test]
fn the_default_hover_formation_keeps_its_limits() {
    fly(&study("hover.toml", &[]), 20).iter().for_each(|report| keeps(report, &limits::HOVER));
}

#[test]
fn over_the_simulators_protocol_it_keeps_them_down_to_20_frames_a_second_and_5_percent_loss() {
    for cell in wire::cells() {
        for report in in_parallel(0..3, |seed| wire::fly(seed, cell, 400.0)) {
            let report = report.unwrap_or_else(|| panic!("{cell:?}: not all vehicles have joined"));
            if cell.rate >= 20 && cell.drop <= 0.05 {
                keeps(&report, &limits::HOVER);
            }
            // Below that it may be worse, and no vehicle is lost.
            assert_eq!((report.crashes, report.collisions), (0, 0), "{cell:?}, seed {}", report.run.seed);
            assert!(report.in_band_s.is_some(), "{cell:?}, seed {}", report.run.seed);
        }
    }
}

#[test]
fn the_papers_hover_formation_keeps_its_limits() {
    fly(&study("hover.toml", &["preset=paper"]), 20).iter().for_each(|report| keeps(report, &limits::PAPER_HOVER));
}

#[test]
fn a_steep_linear_conversion_oscillates_and_the_nonlinear_one_does_not() {
    let median = |sets: &[&str], key: &str| summarize(&fly(&study("sinusoid.toml", sets), 10))[key].median;
    let linear = ["formation.conversion=linear", "formation.gain_m=56"];
    let swing_m = median(&linear, "oscillation_m").unwrap();
    assert!(swing_m >= 2.5, "linear, c = 56: {swing_m} m");
    let calm_m = median(&[], "oscillation_m").unwrap();
    assert!(calm_m <= 0.8, "nonlinear: {calm_m} m");
}

#[test]
fn the_safety_filter_keeps_a_crowd_apart() {
    let closest = |filter: &str| {
        let filter = format!("formation.safety_filter={filter}");
        let sets = ["swarm.vehicles=12", "start.square_m=80", "start.separation_m=10", "duration_s=60", &filter];
        let reports = study("hover.toml", &sets).fly_all(20..30, TWO, |_| {}).unwrap();
        let activations: Option<u64> = reports.iter().map(|report| report.safety_activations).sum();
        (summarize(&reports)["min_separation_m"].worst.unwrap(), activations)
    };
    let (with_m, activations) = closest("cbf");
    let (without_m, none) = closest("none");
    println!("twelve vehicles that start 10 m apart: closest {with_m:.1} m, without the filter {without_m:.1} m");
    assert!(with_m > 8.0 && with_m > without_m + 1.0, "{with_m} m, without {without_m} m");
    assert!(activations.is_some_and(|activations| activations > 0) && none.is_none());
}

/// The report as text, without the figures that depend on the wall clock.
fn without_wall_clock(report: &Report) -> String {
    let mut value = serde_json::to_value(report).unwrap();
    let Value::Object(keys) = &mut value else { panic!("a report is an object") };
    WALL_CLOCK_KEYS.iter().for_each(|key| assert!(keys.remove(*key).is_some(), "{key}"));
    value.to_string()
}

#[test]
fn a_seed_gives_the_same_figures_again_with_any_number_of_jobs() {
    let study = study("hover.toml", &["duration_s=120", "world.wind_m_s=4", "world.gust_w20_m_s=4"]);
    let figures =
        |jobs| -> Vec<_> { study.fly_all(3..7, jobs, |_| {}).unwrap().iter().map(without_wall_clock).collect() };
    let one = figures(NonZeroUsize::MIN);
    assert_eq!(one, figures(NonZeroUsize::MIN), "twice");
    assert_eq!(one, figures(TWO), "two jobs");
    assert_ne!(one[0], one[1], "another seed flies differently");
}

#[test]
fn a_seed_gives_the_same_flight_bit_for_bit() {
    let study = study("hover.toml", &["preset=paper", "world.wind_m_s=4", "world.gust_w20_m_s=4"]);
    let mut worlds = [0, 1].map(|_| World::new(&study.scenario, &study.aircraft, &study.rules).unwrap());
    for tick in 0..3_000 {
        let [one, other] = worlds.each_mut().map(|world| {
            world.tick();
            let bits = |(_, _, truth, controls): (
                _,
                _,
                &skein_core::plant::GroundTruth,
                Option<skein_core::plant::Controls>,
            )| {
                let place: [f64; 3] = truth.position.into();
                let velocity: [f64; 3] = truth.velocity.into();
                let controls = controls.map_or([0.0; 4], |s| [s.roll, s.pitch, s.yaw, s.collective]);
                (place.map(f64::to_bits), velocity.map(f64::to_bits), controls.map(f64::to_bits))
            };
            world.vehicles().map(bits).collect::<Vec<_>>()
        });
        assert_eq!(one, other, "tick {tick}");
    }
}

#[test]
fn three_of_four_vehicles_respace_evenly_after_one_is_killed() {
    for seed in 0..5 {
        let study = study("hover.toml", &[&format!("seed={seed}")]);
        let mut world = World::new(&study.scenario, &study.aircraft, &study.rules).unwrap();
        let victim = VehicleId::new(2).unwrap();
        while world.t_s() < 150.0 {
            world.tick();
        }
        world.kill(victim);
        let killed_s = world.t_s();
        let three = scenario("hover.toml", &[]);
        let mut metrics = Metrics::new(&three, Run::new(&three, "study"));
        let mut vehicles = Vec::new();
        let mut noticed_s = None;
        while world.t_s() < killed_s + 250.0 {
            world.tick();
            measure(&world, killed_s, &mut metrics, &mut vehicles);
            let noticed = world
                .vehicles()
                .all(|(_, agent, ..)| agent.peers().any(|peer| peer.id == victim && peer.standing == PeerStatus::Lost));
            if noticed {
                noticed_s.get_or_insert(world.t_s() - killed_s);
            }
        }
        assert_eq!(world.vehicles().count(), 3);
        assert!(world.vehicles().all(|(_, agent, ..)| agent.membership() == Membership::Active));
        let report = metrics.report(Wall { wall_s: 1.0, real_time_factor: 1.0 });
        assert!(noticed_s.is_some_and(|noticed_s| noticed_s < 2.0), "seed {seed}: noticed after {noticed_s:?} s");
        assert!(report.even_10deg_s.is_some_and(|even_s| even_s < 180.0), "seed {seed}: {:?}", report.even_10deg_s);
        assert!(report.in_band_s.is_some_and(|since_s| since_s < 0.03), "seed {seed}: a vehicle left the band");
        println!("seed {seed}: noticed after {noticed_s:?} s, even to 10 degrees after {:?} s", report.even_10deg_s);
    }
}

#[test]
fn two_plants_differ_too_much_beyond_a_twentieth_of_a_figure_and_a_tenth_of_its_limit() {
    let is_too_far = |key: &str, a: Option<f64>, b: Option<f64>| {
        let figure = FigureDifference {
            key: key.to_owned(),
            a,
            b,
            difference: a.zip(b).map(|(a, b)| b - a),
            relative: None,
            farthest: ComparedPair { seed: 0, a, b },
            each: Vec::new(),
        };
        let (figures, one_sided) = (vec![figure], Default::default());
        let plants = Divergence { a: String::new(), b: String::new(), pairs: 1, figures, one_sided };
        !too_far(&plants).is_empty()
    };
    assert!(!is_too_far("min_separation_m", Some(60.0), Some(62.9)));
    assert!(is_too_far("min_separation_m", Some(60.0), Some(63.1)));
    assert!(!is_too_far("radial_rms_m", Some(1.0), Some(1.19)));
    assert!(is_too_far("radial_rms_m", Some(1.0), Some(0.79)));
    assert!(!is_too_far("even_5deg_s", None, None) && is_too_far("even_5deg_s", None, Some(100.0)));
    assert!(!is_too_far("step_p99_us", Some(36.0), Some(98.0)), "it has no limit of the ring");
}
