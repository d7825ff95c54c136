use super::*;
use crate::random::Purpose;
use skein_common::math;

const WIND_FROM_RAD: f64 = 0.7;
/// A low height has short length scales, so that a run of moderate length holds many of them.
const HEIGHT_M: f64 = 3.0;
const WIND_M_S: f64 = 20.0;
const W20_M_S: f64 = 10.0;

/// The gusts along, across and down of a long run, m/s.
fn gusts(seed: u64, ticks: usize) -> [Vec<f64>; 3] {
    let weather = Weather { wind_m_s: WIND_M_S, wind_from_rad: WIND_FROM_RAD, gust_w20_m_s: W20_M_S };
    let mut air = LocalWind::new(&weather, random::generator(seed, None, Purpose::Wind));
    let mut gusts = [const { Vec::new() }; 3];
    // The direction to which the wind blows, and the direction to its right.
    let (sin, cos) = math::sin_cos(WIND_FROM_RAD + core::f64::consts::PI);
    for _ in 0..ticks {
        let air = air.advance(HEIGHT_M);
        let (north, east) = (air.north_m_s(), air.east_m_s());
        gusts[0].push(north * cos + east * sin - WIND_M_S);
        gusts[1].push(-north * sin + east * cos);
        gusts[2].push(air.down_m_s());
    }
    gusts
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / a.len().min(b.len()) as f64;
    product(a, b) / (product(a, a) * product(b, b)).sqrt()
}

#[test]
fn gusts_have_the_strength_and_length_of_the_standard() {
    let gusts = gusts(3, 1_000_000);
    // Worked out by hand from h = 9.8425 ft: f = 0.18510, σ_w = 1, σ_u = 1/f^0.4, L_u = 9.8425 ft/f^1.2, L_w = 9.8425
    // ft.
    let expected = [(1.9636, 22.72), (1.9636, 22.72), (1.0, 3.0)];
    for (axis, (gust, (sigma_m_s, length_m))) in gusts.iter().zip(expected).enumerate() {
        let measured = (gust.iter().map(|g| g * g).sum::<f64>() / gust.len() as f64).sqrt();
        assert!((measured / sigma_m_s - 1.0).abs() < 0.03, "axis {axis}: σ {measured} m/s");
        // Dryden's correlation after the air has moved by x length scales: e^-x along, e^-x (1 - x/2) across.
        for lengths in [0.5_f64, 1.0, 2.0] {
            let lag = (lengths * length_m / WIND_M_S / TICK_S).round();
            let x = lag * TICK_S * WIND_M_S / length_m;
            let expected = math::exp(-x) * if axis == 0 { 1.0 } else { 1.0 - 0.5 * x };
            let measured = correlation(&gust[lag as usize..], gust);
            assert!((measured - expected).abs() < 0.03, "axis {axis}, {x} lengths: {measured}, not {expected}");
        }
    }
    assert!(correlation(&gusts[0], &gusts[1]).abs() < 0.05 && correlation(&gusts[1], &gusts[2]).abs() < 0.05);
}

#[test]
fn stationary_variances_are_exact_at_any_bandwidth() {
    for a in [0.05, 1.0, 7.0, 40.0] {
        // White noise of variance one: the output's variance is the sum of the squared impulse response.
        let (decay, noise) = discrete(a);
        let first_order = noise * noise / (1.0 - decay * decay);
        assert!((first_order * 2.0 * a - 1.0).abs() < 1e-9, "{a}: {first_order}");
        let mut filter = ShapingFilter::default();
        let mut variance = math::square(filter.advance(a, 1.0));
        variance += (0..200_000).map(|_| math::square(filter.advance(a, 0.0))).sum::<f64>();
        assert!((variance - 1.0).abs() < 1e-9, "{a}: {variance}");
    }
}

#[test]
fn gusts_are_repeatable_and_differ_between_seeds() {
    assert_eq!(gusts(1, 500), gusts(1, 500));
    assert_ne!(gusts(1, 500), gusts(2, 500));
}

#[test]
fn the_wind_blows_away_from_its_direction_of_origin() {
    for (from_deg, north, east) in [(0.0_f64, -6.0, 0.0), (90.0, 0.0, -6.0), (180.0, 6.0, 0.0), (270.0, 0.0, 6.0)] {
        let weather = Weather { wind_m_s: 6.0, wind_from_rad: from_deg.to_radians(), gust_w20_m_s: 0.0 };
        let air = LocalWind::new(&weather, random::generator(0, None, Purpose::Wind)).advance(50.0);
        assert!((air - VelocityNed::new(north, east, 0.0)).norm() < 1e-12, "from {from_deg}°: {air:?}");
    }
}

#[test]
fn heights_outside_the_low_altitude_form_are_clamped() {
    let at = |height_m: f64| {
        let spectrum = Spectrum::at(height_m, 10.0);
        (spectrum.sigma_horizontal_m_s, spectrum.length_horizontal_m, spectrum.length_vertical_m)
    };
    assert_eq!(at(-5.0), at(3.0));
    assert_eq!(at(2_000.0), at(304.8));
    // At 1000 ft the turbulence is the same in all directions.
    let (sigma_m_s, along_m, vertical_m) = at(304.8);
    assert!((sigma_m_s - 1.0).abs() < 1e-9 && (along_m - vertical_m).abs() < 1e-6);
}
