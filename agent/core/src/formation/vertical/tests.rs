use proptest::prelude::*;
use skein_common::frame::{Attitude, BodyRates, Geodetic, PositionNed, VelocityNed};

use super::*;

fn at(altitude_m: f64, height_m: f64) -> Estimate {
    Estimate {
        position: PositionNed::new(0.0, 0.0, -altitude_m),
        geodetic: Geodetic::from_degrees(0.0, 0.0, 0.0),
        height_m,
        velocity: VelocityNed::default(),
        attitude: Attitude::default(),
        rates: BodyRates::default(),
        rotor_speed_rad_s: None,
    }
}

#[test]
fn bands_lie_around_the_centre_in_the_order_of_ranks() {
    let bands: Vec<f64> = (0..4).map(|rank| Heights::default().in_band(0.02, 30.0, 5.0, rank, 4)).collect();
    assert_eq!(bands, [22.5, 27.5, 32.5, 37.5]);
    assert_eq!(Heights::default().in_band(0.02, 30.0, 5.0, 0, 1), 30.0, "a single vehicle at the centre's altitude");
    assert_eq!(Heights::default().in_band(0.02, 30.0, 0.0, 3, 4), 30.0);
}

#[test]
fn a_new_rank_is_reached_at_one_metre_per_second() {
    let mut heights = Heights::default();
    heights.in_band(0.02, 30.0, 5.0, 0, 4);
    let mut seconds = 0.0;
    while heights.in_band(0.02, 30.0, 5.0, 2, 4) < 32.5 {
        seconds += 0.02;
    }
    assert!((seconds - 10.0_f64).abs() < 0.05, "10 m in {seconds} s");
    assert_eq!(heights.in_band(0.02, 50.0, 5.0, 2, 4), 52.5, "the bands move with the centre");
}

#[test]
fn a_vehicle_whose_partition_flies_above_waits_until_it_has_climbed() {
    let mut heights = Heights::default();
    let mut fly = |is_above, altitude_m: f64| {
        let rise_m = heights.partition_rise(0.02, is_above, Some((30.0, 30.0..=30.0)));
        let setpoint_m = heights.in_band(0.02, 30.0 + rise_m, 0.0, 0, 4);
        (setpoint_m, heights.is_climbing_above(setpoint_m, &at(altitude_m, altitude_m)))
    };
    assert!(!fly(false, 5.0).1, "the lower partition never waits");
    let mut altitude_m = 5.01;
    for step in 0..1_000 {
        let (setpoint_m, waits) = fly(true, altitude_m);
        assert_eq!(waits, altitude_m < 38.0, "step {step}, at {altitude_m} m");
        altitude_m = (altitude_m + 0.04_f64).min(setpoint_m);
    }
    assert!(!fly(false, 40.0).1, "in contact again");
}

#[test]
fn a_partition_flies_above_every_altitude_of_the_other_one_and_keeps_its_own_at_a_new_step() {
    let (mut heights, mut altitude_m) = (Heights::default(), 30.0);
    for tick in 0..3_000 {
        // At the step with 30 m, then at that with 45 m; the other partition may be at either.
        let own_m = if tick < 2_000 { 30.0 } else { 45.0 };
        heights.begin_step(own_m);
        let next_m = own_m + heights.partition_rise(0.02, true, Some((own_m, 30.0..=45.0)));
        assert!((next_m - altitude_m).abs() < 0.041, "tick {tick}: from {altitude_m} to {next_m} m");
        altitude_m = next_m;
    }
    assert_eq!(altitude_m, 55.0);
    assert_eq!(heights.partition_rise(0.02, true, None), 10.0, "a landing keeps it");
    // A vehicle that stays in mid-climb, at 37 m, rises as high.
    let mut heights = Heights::default();
    let mut altitude_m = 37.0;
    for _ in 0..3_000 {
        let without_rise_m = heights.stay_without_rise_m(37.0);
        let rise_m = heights.partition_rise(0.02, true, Some((without_rise_m, 30.0..=45.0)));
        altitude_m = 37.0 + heights.risen_since_stay(rise_m, false);
    }
    assert!((altitude_m - 55.0).abs() < 0.03, "{altitude_m} m");
}

#[test]
fn on_an_ellipsoid_a_vehicle_first_rises_to_the_centre() {
    let mut heights = Heights::default();
    assert_eq!(heights.on_surface(0.02, 40.0, -1.0, &at(0.3, 0.3)), 40.0);
    assert_eq!(heights.on_surface(0.02, 40.0, 1.0, &at(38.9, 38.9)), 40.0);
    let risen_m = heights.on_surface(0.1, 40.0, 0.5, &at(39.5, 39.5));
    assert!((risen_m - 39.65).abs() < 1e-9, "then at 3 m/s per unit of field: {risen_m}");
    let sunk_m = heights.on_surface(0.1, 40.0, -5.0, &at(30.0, 30.0));
    assert!((sunk_m - 35.0).abs() < 1e-9, "never far from the vehicle: {sunk_m}");
}

#[test]
fn the_setpoint_on_an_ellipsoid_stays_above_the_ground() {
    let mut heights = Heights::default();
    let (ground_m, mut altitude_m) = (100.0, 140.0);
    for _ in 0..5_000 {
        altitude_m = heights.on_surface(0.02, 120.0, -1.0, &at(altitude_m, altitude_m - ground_m));
    }
    assert_eq!(altitude_m, 105.0, "five metres above a hill");
}

proptest! {
    #[test]
    fn a_band_moves_slowly_for_any_change_of_ranks(
        ranks in proptest::collection::vec((0_usize..20, 1_usize..20), 2..40), step_m in 0.0..20.0, dt_s in 0.0..0.2,
    ) {
        let mut heights = Heights::default();
        let mut before_m = None;
        for (rank, live) in ranks {
            let band_m = heights.in_band(dt_s, 30.0, step_m, rank.min(live - 1), live);
            prop_assert!(before_m.is_none_or(|before_m: f64| (band_m - before_m).abs() <= dt_s + 1e-9));
            before_m = Some(band_m);
        }
    }

    #[test]
    fn the_setpoint_on_an_ellipsoid_moves_slowly_and_stays_off_the_ground(
        fields in proptest::collection::vec(-5.0..5.0, 2..200), dt_s in 0.0..1.0, lag in 0.0..1.0,
    ) {
        let (mut heights, mut altitude_m) = (Heights::default(), 30.0);
        let mut before_m = None;
        for field_up in fields {
            let surface_m = heights.on_surface(dt_s, 30.0, field_up, &at(altitude_m, altitude_m));
            let fastest_m = 2.0 * dt_s.min(LONGEST_STEP_S);
            prop_assert!(surface_m.is_finite() && surface_m >= LOWEST_M);
            prop_assert!(before_m.is_none_or(|before_m: f64| (surface_m - before_m).abs() <= fastest_m + 1e-9));
            before_m = Some(surface_m);
            // The vehicle follows the setpoint with a lag.
            altitude_m += (surface_m - altitude_m) * lag;
        }
    }
}

#[test]
fn the_partition_rise_changes_slowly_and_ends_when_all_peers_return() {
    let mut heights = Heights::default();
    let mut last_m = 0.0;
    for tick in 0..1500 {
        let above_m = heights.partition_rise(0.02, tick < 750, Some((30.0, 30.0..=30.0)));
        let change_m = above_m - last_m;
        let (fall_m, climb_m) = (BAND_CHANGE_M_S * 0.02, PARTITION_CLIMB_M_S * 0.02);
        assert!((-fall_m - 1e-9..=climb_m + 1e-9).contains(&change_m), "a jump by {change_m} m");
        last_m = above_m;
        if tick == 749 {
            assert!((above_m - PARTITION_RISE_M).abs() < 1e-9, "the full rise after 15 s");
        }
    }
    assert!(last_m.abs() < 1e-9);
}
