//! Speed of virtual time, cost of one step, and its shares.
//!
//! Criterion's figures depend on the computer; the ratios printed before them are measured in a single run.

use std::hint::black_box;
use std::num::NonZeroUsize;
use std::time::{Duration, Instant};

use criterion::{Criterion, Throughput};
use nalgebra::Vector2;
use skein_common::frame::Origin;
use skein_common::id::VehicleId;
use skein_common::scenario::{Source, load};
use skein_common::time::Now;
use skein_core::aircraft::Aircraft;
use skein_core::control::{Rules, Setpoint, VehicleController};
use skein_core::estimate::Estimator;
use skein_core::helicopter::{BuiltInVehicle, Start, TICK_S, Weather};
use skein_core::plant::Controls;
use skein_lab::external::LawPool;
use skein_lab::study::Study;
use skein_lab::world::World;

const HOVER: &str = include_str!("../../deploy/scenarios/hover.toml");

fn hover(preset: &str) -> Study {
    let sets = [format!("preset={preset}"), "duration_s=100".to_owned()];
    let scenario = load(&Source { name: "hover.toml", text: HOVER }, &sets).expect("the shipped scenario").scenario;
    let aircraft = Aircraft::shipped("xcell60").expect("shipped").expect("well formed");
    Study {
        aircraft: vec![aircraft; scenario.swarm.vehicles],
        scenario,
        rules: Rules::shipped(),
        laws: LawPool::default(),
    }
}

/// One vehicle of the hover, with its estimator and controller.
struct Bench {
    vehicle: BuiltInVehicle,
    estimator: Estimator,
    controller: VehicleController,
}

impl Bench {
    fn new(study: &Study) -> Self {
        let origin = Origin::new(study.scenario.origin.geodetic());
        let parameters = study.aircraft[0].helicopter.as_ref().expect("a flight model");
        let id = VehicleId::first(1).next().expect("vehicle 1");
        Self {
            vehicle: BuiltInVehicle::new(&origin, parameters, &Start::default(), &Weather::default(), 1, id),
            estimator: Estimator::new(origin, &study.scenario.sensing),
            controller: VehicleController::new(study.rules.clone(), study.aircraft[0].trim, true),
        }
    }

    fn plant(&mut self) {
        let trim = Controls { roll: 0.0185, pitch: 0.0, yaw: 0.0, collective: 0.6 };
        self.vehicle.advance(Some(black_box(trim)));
        black_box(self.vehicle.frame());
    }

    fn control(&mut self) {
        let measurement = self.vehicle.frame().measurement;
        let estimate = self.estimator.update(Now::default(), Some(black_box(&measurement)));
        let setpoint = Setpoint {
            relative_velocity_ne_m_s: Vector2::new(1.5, -1.0),
            feedforward_ne_m_s: Vector2::zeros(),
            altitude_m: 30.0,
            heading_rad: 0.1,
        };
        if let Some(estimate) = estimate {
            black_box(self.controller.step(0.02, &estimate, &setpoint));
        }
    }
}

#[expect(clippy::disallowed_methods, reason = "a bench measures time")]
fn seconds_of(mut work: impl FnMut(), times: u32) -> f64 {
    let started = Instant::now();
    (0..times).for_each(|_| work());
    started.elapsed().as_secs_f64() / f64::from(times)
}

/// The figures that the README quotes.
fn print_ratios() {
    let jobs = NonZeroUsize::MIN;
    for preset in ["default", "paper"] {
        let study = hover(preset);
        let reports = study.fly_all(0..10, jobs, |_| {}).expect("the hover flies");
        let (flown_s, wall_s) =
            reports.iter().fold((0.0, 0.0), |sum, report| (sum.0 + report.duration_s, sum.1 + report.wall_s));
        let vehicles = study.scenario.swarm.vehicles as f64;
        println!(
            "hover, preset {preset}: {:.0} times real time on one core ({:.0} vehicle-seconds a CPU second)",
            flown_s / wall_s,
            vehicles * flown_s / wall_s
        );
    }
    let study = hover("default");
    let mut world = World::new(&study.scenario, &study.aircraft, &study.rules).expect("the hover starts");
    (0..2_000).for_each(|_| world.tick());
    let whole_s = seconds_of(|| world.tick(), 20_000) / study.scenario.swarm.vehicles as f64;
    let mut bench = Bench::new(&study);
    let plant_s = seconds_of(|| bench.plant(), 20_000);
    let control_s = seconds_of(|| bench.control(), 20_000);
    println!("one vehicle, one frame of {:.0} ms: {:.2} us", TICK_S * 1e3, whole_s * 1e6);
    println!("  flight model and its frame   {:4.0} %", 100.0 * plant_s / whole_s);
    println!("  estimate and control         {:4.0} %", 100.0 * control_s / whole_s);
    println!("  peers, formation, messages   {:4.0} %\n", 100.0 * (whole_s - plant_s - control_s) / whole_s);
}

fn main() {
    print_ratios();
    let mut criterion = Criterion::default().configure_from_args().measurement_time(Duration::from_secs(3));
    let study = hover("default");
    let mut world = World::new(&study.scenario, &study.aircraft, &study.rules).expect("the hover starts");
    (0..2_000).for_each(|_| world.tick());
    let mut bench = Bench::new(&study);
    let mut group = criterion.benchmark_group("hover");
    group.throughput(Throughput::Elements(study.scenario.swarm.vehicles as u64));
    group.bench_function("four vehicles, one frame", |b| b.iter(|| world.tick()));
    group.throughput(Throughput::Elements(1));
    group.bench_function("flight model, one frame", |b| b.iter(|| bench.plant()));
    group.bench_function("estimate and control, one step", |b| b.iter(|| bench.control()));
    group.finish();
    criterion.final_summary();
}
