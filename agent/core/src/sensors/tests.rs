use skein_common::frame::VelocityNed;
use skein_common::scenario::{Source, load};
use skein_common::time::PlantTime;

use super::*;
use crate::tests::id;

const TICK_NS: u64 = 20_000_000;

fn sensors(keys: &str, seed: u64, vehicle: u8) -> Option<Box<Sensors>> {
    let text = alloc::format!("swarm.vehicles = 4\nseed = {seed}\n[sensing]\n{keys}");
    Sensors::new(&load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario, id(vehicle))
}

fn origin() -> Origin {
    Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0))
}

/// The exact measurement of a vehicle that flies north at 1 m/s and rolls about its heading.
fn exact(tick: u64) -> Measurement {
    let t_s = tick as f64 * 0.02;
    Measurement {
        position: origin().geodetic_from_ned([t_s, 20.0, -30.0].into()),
        height_m: 30.0,
        velocity: VelocityNed::new(1.0, 0.0, 0.0),
        attitude: Attitude { roll_rad: 0.05, pitch_rad: -0.02, heading_rad: 3.1 },
        rates: BodyRates { roll_rad_s: 0.1, pitch_rad_s: 0.2, yaw_rad_s: 0.3 },
        rotor_speed_rad_s: Some(167.0),
    }
}

/// What reaches the agent in each of this many frames.
fn measured(sensors: &mut Sensors, ticks: u64) -> Vec<Option<Measurement>> {
    (0..ticks).map(|tick| sensors.measure(PlantTime::from_nanoseconds(tick * TICK_NS), &exact(tick))).collect()
}

/// Errors of the twelve components in each frame: position, velocity, attitude, rates.
fn errors(sensors: &mut Sensors, ticks: u64) -> Vec<[f64; 12]> {
    let error = |(tick, measured): (usize, &Option<Measurement>)| {
        let (measured, exact) = (measured.unwrap(), exact(tick as u64));
        let position = origin().ned_from_geodetic(&measured.position) - origin().ned_from_geodetic(&exact.position);
        let velocity = measured.velocity - exact.velocity;
        let of = |attitude: Attitude| [attitude.roll_rad, attitude.pitch_rad, attitude.heading_rad];
        let attitude: Vec<f64> =
            of(measured.attitude).iter().zip(of(exact.attitude)).map(|(a, b)| wrap_rad(a - b)).collect();
        let of = |rates: BodyRates| Vector3::new(rates.roll_rad_s, rates.pitch_rad_s, rates.yaw_rad_s);
        let rates = of(measured.rates) - of(exact.rates);
        let all = position.iter().chain(&velocity).chain(&attitude).chain(&rates);
        all.copied().collect::<Vec<_>>().try_into().unwrap()
    };
    measured(sensors, ticks).iter().enumerate().map(error).collect()
}

fn mean(values: impl Iterator<Item = f64> + Clone) -> f64 {
    values.clone().sum::<f64>() / values.count() as f64
}

const ALL_NOISE: &str = "noise = { position_m = 0.5, altitude_m = 0.8, velocity_m_s = 0.1, attitude_deg = 0.5, \
                         heading_deg = 2, rate_deg_s = 1 }";

#[test]
fn sensors_without_errors_latency_or_dropouts_are_absent() {
    assert!(sensors("", 1, 1).is_none());
    assert!(sensors("position = \"f32_latlon\"\ndropout_s = 1\ncorrelation_s = 10", 1, 1).is_none());
    for key in ["latency_s = 0.02", "dropout = 0.1", "noise.heading_deg = 1", "bias.rate_deg_s = 1"] {
        assert!(sensors(key, 1, 1).is_some(), "{key}");
    }
}

#[test]
fn noise_has_its_standard_deviation_and_no_mean() {
    let deg = f64::to_radians(1.0);
    let expected = [0.5, 0.5, 0.8, 0.1, 0.1, 0.1, 0.5 * deg, 0.5 * deg, 2.0 * deg, 1.0 * deg, 1.0 * deg, 1.0 * deg];
    let errors = errors(&mut sensors(ALL_NOISE, 1, 1).unwrap(), 20_000);
    for (component, sigma) in expected.into_iter().enumerate() {
        let of = errors.iter().map(|errors| errors[component]);
        let (mean, square) = (mean(of.clone()), mean(of.clone().map(math::square)));
        // Four standard errors of a mean and of a variance of 20,000 draws.
        assert!(mean.abs() < 4.0 * sigma / 20_000_f64.sqrt(), "component {component}: mean {mean}");
        let variance = square / (sigma * sigma);
        assert!((variance - 1.0).abs() < 4.0 * (2.0 / 20_000_f64).sqrt(), "component {component}: {variance} sigma^2");
        let next = errors.windows(2).map(|two| two[0][component] * two[1][component]);
        let correlation = self::mean(next) / (sigma * sigma);
        assert!(correlation.abs() < 4.0 / 20_000_f64.sqrt(), "component {component}: {correlation} one frame later");
    }
    for (one, other) in (0..12).flat_map(|one| (0..one).map(move |other| (one, other))) {
        let product = mean(errors.iter().map(|errors| errors[one] * errors[other]));
        assert!(product.abs() < 4.5 * expected[one] * expected[other] / 20_000_f64.sqrt(), "{one} and {other}");
    }
}

#[test]
fn correlated_noise_keeps_its_standard_deviation_and_fades_with_its_time_constant() {
    let keys = "correlation_s = 2\nnoise = { position_m = 1, altitude_m = 3, velocity_m_s = 0.1 }";
    let errors = errors(&mut sensors(keys, 3, 2).unwrap(), 200_000);
    let lagged = |component: usize, ticks: usize| {
        mean(errors.iter().zip(&errors[ticks..]).map(|(one, other)| one[component] * other[component]))
    };
    // 4,000 s hold 1,000 independent times of two time constants: the standard error of a variance is 4.5 %.
    for (component, variance) in [(0, 1.0), (1, 1.0), (2, 9.0)] {
        assert!((lagged(component, 0) / variance - 1.0).abs() < 0.15, "{component}: {}", lagged(component, 0));
        let left = lagged(component, 100) / lagged(component, 0);
        assert!((left - math::exp(-1.0)).abs() < 0.12, "{component}: {left} of it left after 2 s");
    }
    assert!(lagged(3, 1).abs() < 1e-4, "the noise of the velocity stays white");
}

#[test]
fn a_bias_is_constant_and_drawn_from_its_standard_deviation() {
    let keys = "bias = { position_m = 1, altitude_m = 2, velocity_m_s = 0.2, attitude_deg = 1, heading_deg = 3, rate_deg_s = 2 }";
    let deg = f64::to_radians(1.0);
    let sigma = [1.0, 1.0, 2.0, 0.2, 0.2, 0.2, deg, deg, 3.0 * deg, 2.0 * deg, 2.0 * deg, 2.0 * deg];
    let of_all: Vec<[f64; 12]> = (0..400)
        .map(|seed| {
            let errors = errors(&mut sensors(keys, seed, 1).unwrap(), 3);
            assert!((0..12).all(|component| (errors[0][component] - errors[2][component]).abs() < 1e-6));
            errors[0]
        })
        .collect();
    for (component, sigma) in sigma.into_iter().enumerate() {
        let variance = mean(of_all.iter().map(|errors| math::square(errors[component] / sigma)));
        assert!((variance - 1.0).abs() < 4.0 * (2.0 / 400_f64).sqrt(), "component {component}: {variance} sigma^2");
    }
    assert_ne!(of_all[0], errors(&mut sensors(keys, 0, 2).unwrap(), 1)[0], "vehicles differ");
}

#[test]
fn one_quantity_does_not_change_the_errors_of_another() {
    let of = |keys: &str| measured(&mut sensors(keys, 5, 3).unwrap(), 50);
    let alone = of("noise.velocity_m_s = 0.1");
    let together = of(&alloc::format!("{ALL_NOISE}\nbias.heading_deg = 3\ndropout = 0.3\ndropout_s = 0.1"));
    let mut compared = 0;
    for (one, other) in alone.iter().zip(&together).filter_map(|(one, other)| one.as_ref().zip(other.as_ref())) {
        // The axes of a velocity are those of the measured position, which has an error of its own.
        assert!((one.velocity - other.velocity).norm() < 1e-6);
        compared += 1;
    }
    assert!(compared > 20);
    let doubled = of("noise.velocity_m_s = 0.2");
    for (one, twice) in alone.iter().zip(&doubled).map(|(one, twice)| (one.unwrap(), twice.unwrap())) {
        let (small, large) = (one.velocity.north_m_s() - 1.0, twice.velocity.north_m_s() - 1.0);
        assert!((large - 2.0 * small).abs() < 1e-12);
    }
}

#[test]
fn a_measurement_arrives_exactly_its_latency_later() {
    for (latency_s, frames) in [(0.02, 1), (0.1, 5), (0.05, 3), (0.001, 1), (2.0, 100)] {
        let mut sensors = sensors(&alloc::format!("latency_s = {latency_s}"), 1, 1).unwrap();
        let measured = measured(&mut sensors, 300);
        assert!(measured[..frames].iter().all(Option::is_none), "{latency_s} s");
        for (tick, measured) in measured.iter().enumerate().skip(frames) {
            assert_eq!(*measured, Some(exact((tick - frames) as u64)), "{latency_s} s, frame {tick}");
        }
        assert!(sensors.delayed.len() <= frames + 1);
    }
}

#[test]
fn the_delay_line_takes_frames_at_any_time() {
    let mut sensors = sensors("latency_s = 0.1", 1, 1).unwrap();
    let mut at = |ms: u64| sensors.measure(PlantTime::from_nanoseconds(ms * 1_000_000), &exact(ms));
    assert_eq!([0, 30, 60].map(&mut at), [None; 3]);
    assert_eq!(at(150), Some(exact(30)), "the newest of those that are old enough");
    assert_eq!(at(155), None, "no newer one is old enough yet");
    for _ in 0..1000 {
        // A paused simulator.
        at(160);
    }
    assert_eq!(at(5), None, "the simulator has started again");
    assert_eq!([at(50), at(105)], [None, Some(exact(5))]);
    assert_eq!(sensors.delayed.len(), 2);
}

#[test]
fn dropouts_take_their_share_of_frames_and_last_as_long_as_they_should() {
    let lost = |keys: &str| -> Vec<bool> {
        measured(&mut sensors(keys, 2, 1).unwrap(), 200_000).iter().map(Option::is_none).collect()
    };
    let share = |lost: &[bool]| mean(lost.iter().map(|&lost| f64::from(u8::from(lost))));
    let mean_length = |lost: &[bool]| {
        let begins = lost.windows(2).filter(|two| !two[0] && two[1]).count();
        lost.iter().filter(|&&lost| lost).count() as f64 / begins as f64
    };
    let independent = lost("dropout = 0.1");
    assert!((share(&independent) - 0.1).abs() < 0.003, "{}", share(&independent));
    assert!((mean_length(&independent) - 1.0 / 0.9).abs() < 0.02);
    let bursts = lost("dropout = 0.1\ndropout_s = 0.5");
    assert!((share(&bursts) - 0.1).abs() < 0.015, "{}", share(&bursts));
    // A state with an exponential duration of 25 frames, seen once a frame.
    assert!((mean_length(&bursts) - 25.0).abs() < 3.0, "{}", mean_length(&bursts));
    assert!(lost("dropout = 1").iter().all(|&lost| lost));
}

#[test]
fn a_dropout_is_one_still_after_the_latency() {
    let direct = measured(&mut sensors("dropout = 0.3\ndropout_s = 0.1", 4, 1).unwrap(), 1000);
    let late = measured(&mut sensors("dropout = 0.3\ndropout_s = 0.1\nlatency_s = 0.1", 4, 1).unwrap(), 1000);
    assert_eq!(late[5..], direct[..995]);
}

#[test]
fn height_rotor_speed_and_a_frozen_position_stay_recognisable() {
    let mut sensors = sensors(ALL_NOISE, 1, 1).unwrap();
    let before = sensors.measure(PlantTime::ZERO, &exact(0)).unwrap();
    assert_eq!((before.height_m, before.rotor_speed_rad_s), (30.0, Some(167.0)));
    let frozen = Measurement { position: exact(0).position, ..exact(1) };
    let after = sensors.measure(PlantTime::from_nanoseconds(TICK_NS), &frozen).unwrap();
    assert_eq!(after.position, before.position);
    assert_ne!(after.velocity, before.velocity);
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    let keys = alloc::format!("{ALL_NOISE}\nlatency_s = 0.06\ndropout = 0.1\nbias.position_m = 2");
    let of = |seed, vehicle| measured(&mut sensors(&keys, seed, vehicle).unwrap(), 100);
    assert_eq!(of(1, 1), of(1, 1));
    assert_ne!(of(1, 1), of(2, 1));
    assert_ne!(of(1, 1), of(1, 2));
}
