use crate::math;
use proptest::prelude::*;

use super::*;

/// The table of reference points; its first lines explain the columns.
fn reference_points() -> Vec<[f64; 12]> {
    include_str!("reference_points.csv")
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| {
            let numbers: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
            numbers.try_into().unwrap()
        })
        .collect()
}

#[test]
fn conversions_of_200_points_agree_with_an_independent_package() {
    const TOLERANCE_M: f64 = 1e-3;
    let points = reference_points();
    assert_eq!(points.len(), 200);
    for [lat, lon, h, lat0, lon0, h0, x, y, z, north, east, down] in points {
        let place = Geodetic::from_degrees(lat, lon, h);
        assert!((place.to_ecef() - Vector3::new(x, y, z)).norm() < TOLERANCE_M, "ECEF of {place:?}");

        let reference = Geodetic::from_degrees(lat0, lon0, h0);
        let plane = TangentPlane::new(reference);
        let ned = Vector3::new(north, east, down);
        assert!((plane.ned_from_geodetic(&place) - ned).norm() < TOLERANCE_M, "place of {place:?} in the plane");

        // The footprint is below the point, along the point's own vertical.
        let vertical = plane.local_from_plane(&place).inverse() * Vector3::z();
        let footprint = ned + vertical * (h - h0);
        let expected = PositionNed::new(footprint.x, footprint.y, h0 - h);
        let origin = Origin::new(reference);
        assert!((origin.ned_from_geodetic(&place) - expected).norm() < TOLERANCE_M, "position of {place:?}");
        let back = origin.geodetic_from_ned(expected);
        assert!((back.altitude_m - h).abs() < 1e-9, "height of {expected:?}: {back:?}");
        assert!((back.to_ecef() - place.to_ecef()).norm() < TOLERANCE_M, "geodetic of {expected:?}: {back:?}");
    }
}

#[test]
fn an_altitude_is_the_height_above_the_ellipsoid_at_any_distance() {
    for latitude_deg in [-90.0, -60.0, 0.0, 28.0, 89.99, 90.0] {
        let origin = Origin::new(Geodetic::from_degrees(latitude_deg, 179.99, 12.0));
        for away_m in [0.0, 8e3, 2e4, 5e4, 1e5, 1.5e5] {
            for (north, east) in [(1.0, 0.0), (0.0, -1.0), (-0.6, 0.8)] {
                let place = origin.geodetic_from_ned(PositionNed::new(north * away_m, east * away_m, -30.0));
                assert_eq!(place.altitude_m, 42.0);
                let higher = Geodetic { altitude_m: 542.0, ..place };
                let [low, high] = [place, higher].map(|place| origin.ned_from_geodetic(&place));
                assert_eq!((low.altitude_m(), high.altitude_m()), (30.0, 530.0));
                assert_eq!(low.horizontal(), high.horizontal(), "a climb moves no vehicle sideways");
            }
        }
    }
}

#[test]
fn the_scale_of_horizontal_distances_is_exact_to_the_stated_share() {
    // Along the equator the circle has the semi-major axis.
    let origin = Origin::new(Geodetic::from_degrees(0.0, 0.0, 0.0));
    let place = origin.geodetic_from_ned(PositionNed::new(0.0, 1e5, 0.0));
    let along_m = place.longitude_rad * A;
    assert!((along_m / 1e5 - 1.0).abs() < 1.3e-4, "{along_m}");
}

#[test]
fn no_place_on_the_other_side_of_the_earth_appears_near() {
    for latitude_deg in [-90.0, 0.0, 28.0, 90.0] {
        let origin = Origin::new(Geodetic::from_degrees(latitude_deg, 10.0, 0.0));
        let mut last_m = 0.0;
        for step in 1..=180 {
            // Over the pole, or along the meridian that leads to the other side.
            let towards = if latitude_deg > 0.0 { -1.0 } else { 1.0 };
            let latitude_deg = latitude_deg + towards * f64::from(step);
            let place = if latitude_deg.abs() <= 90.0 {
                Geodetic::from_degrees(latitude_deg, 10.0, 0.0)
            } else {
                Geodetic::from_degrees(latitude_deg.signum() * 180.0 - latitude_deg, -170.0, 0.0)
            };
            let away_m = origin.ned_from_geodetic(&place).horizontal().norm();
            assert!(away_m > last_m, "{step}: {away_m} m after {last_m} m");
            last_m = away_m;
        }
        assert!(last_m > 1.2e7);
        let back = origin.geodetic_from_ned(PositionNed::new(1e9, -1e8, -30.0));
        assert!(back.is_plausible(), "{back:?}");
    }
}

#[test]
fn convergence_is_the_turn_of_the_meridian() {
    // Near a pole the meridians turn as fast as the longitude, at the equator not at all.
    let turn_deg = |latitude_deg: f64, by_deg: f64| {
        let origin = Origin::new(Geodetic::from_degrees(latitude_deg, -170.0, 0.0));
        origin.convergence_at(&Geodetic::from_degrees(latitude_deg, 190.0 + by_deg, 0.0)).angle_rad().to_degrees()
    };
    for by_deg in [-90.0, -1.0, 0.0, 0.3, 120.0] {
        assert!((turn_deg(90.0, by_deg) + by_deg).abs() < 1e-9);
        assert!((turn_deg(-90.0, by_deg) - by_deg).abs() < 1e-9);
        assert!(turn_deg(0.0, by_deg.clamp(-80.0, 80.0)).abs() < 1e-9);
    }
    assert!((turn_deg(60.0, 1.0) + math::sin(60f64.to_radians())).abs() < 1e-4, "as a map's grid declination");
}

#[test]
fn a_motion_along_the_local_north_moves_a_position_along_the_converted_velocity() {
    for (latitude_deg, north_m, east_m) in [
        (28.0, 0.0, 1e5),
        (60.0, 7e4, -7e4),
        (-75.0, 1e5, 1e5),
        (90.0, 40.0, 30.0),
        (-89.99999, 3.0, -60.0),
        (0.0, 0.0, 1e5),
    ] {
        let origin = Origin::new(Geodetic::from_degrees(latitude_deg, 179.9, 0.0));
        let (place, convergence) = origin.place(PositionNed::new(north_m, east_m, 0.0));
        for (local, heading_rad) in
            [(VelocityNed::new(1.0, 0.0, 0.0), 0.0), (VelocityNed::new(0.0, 1.0, 0.0), PI / 2.0)]
        {
            // A small step along the meridian or the parallel, in the plane that touches there.
            let step_m = 0.01;
            let moved = Origin::new(place).geodetic_from_ned(PositionNed(local.0 * step_m));
            let moved = (origin.ned_from_geodetic(&moved) - origin.ned_from_geodetic(&place)) / step_m;
            let expected = convergence.velocity_from_local(local);
            assert!((moved - expected.0).norm() < 4e-4, "{latitude_deg}: {moved:?} and {expected:?}");
            let heading_rad = convergence.heading_from_local(heading_rad);
            assert!((math::sin(heading_rad) - expected.east_m_s()).abs() < 1e-12);
            assert!((math::cos(heading_rad) - expected.north_m_s()).abs() < 1e-12);
        }
    }
}

#[test]
fn the_axes_of_a_plane_are_tilted_against_the_local_ones() {
    let plane = TangentPlane::new(Geodetic::from_degrees(0.0, 0.0, 0.0));
    let degree = 1f64.to_radians();
    let east_of_it = plane.local_from_plane(&Geodetic::from_degrees(0.0, 1.0, 0.0));
    // What flies along the plane's east climbs, seen from a place a degree further east.
    let climbs = east_of_it * Vector3::y();
    assert!((climbs - Vector3::new(0.0, math::cos(degree), -math::sin(degree))).norm() < 1e-12, "{climbs:?}");
    assert!((plane.local_from_plane(&plane.geodetic()) * Vector3::y() - Vector3::y()).norm() < 1e-15);
}

#[test]
fn the_local_axes_point_north_east_and_down() {
    let origin = Origin::new(Geodetic::from_degrees(28.0, -82.0, 10.0));
    let north = origin.ned_from_geodetic(&Geodetic::from_degrees(28.001, -82.0, 10.0));
    let east = origin.ned_from_geodetic(&Geodetic::from_degrees(28.0, -81.999, 10.0));
    let up = origin.ned_from_geodetic(&Geodetic::from_degrees(28.0, -82.0, 25.0));
    assert!(north.north_m() > 110.0 && north.east_m().abs() < 0.01);
    assert!(east.east_m() > 98.0 && east.north_m().abs() < 0.01);
    assert!((up.altitude_m() - 15.0).abs() < 1e-6);
}

#[test]
fn a_vector_is_resolved_forward_and_right_of_a_heading() {
    let north = Vector2::new(1.0, 0.0);
    let from_east = HeadingFrame::new(PI / 2.0).from_ne(north);
    assert!((from_east - Vector2::new(0.0, -1.0)).norm() < 1e-12, "north is left of east");
}

#[test]
fn positions_off_the_globe_are_implausible() {
    assert!(Geodetic::from_degrees(90.0, 180.0, 0.0).is_plausible());
    for (lat, lon, alt) in [(91.0, 0.0, 0.0), (0.0, 181.0, 0.0), (f64::NAN, 0.0, 0.0), (0.0, 0.0, f64::INFINITY)] {
        assert!(!Geodetic::from_degrees(lat, lon, alt).is_plausible());
    }
}

/// Latitudes in degrees, with the poles and their neighbourhood among them.
fn latitudes() -> impl Strategy<Value = f64> {
    let near_pole = (0.0..2.0, any::<bool>()).prop_map(|(off, south)| if south { off - 90.0 } else { 90.0 - off });
    prop_oneof![4 => -90.0..=90.0, 2 => near_pole, 1 => Just(90.0), 1 => Just(-90.0), 1 => Just(0.0)]
}

proptest! {
    #[test]
    fn local_and_geodetic_are_inverse(
        lat in latitudes(), lon in -180.0..=180.0, h0 in -400.0..5000.0, away in 0.0..1.5e5, azimuth in -PI..PI,
        down in -1e4..100.0,
    ) {
        let origin = Origin::new(Geodetic::from_degrees(lat, lon, h0));
        let ned = PositionNed::new(away * math::cos(azimuth), away * math::sin(azimuth), down);
        let (place, convergence) = origin.place(ned);
        prop_assert!(place.is_plausible() || place.altitude_m < -1e3);
        let (back, again) = origin.locate(&place);
        prop_assert!((back - ned).norm() < 1e-6, "{ned:?} came back as {back:?}");
        // Where a longitude is of a few bits only, so is the direction of its meridian.
        let pole_m = (PI / 2.0 - place.latitude_rad.abs()) * A;
        prop_assert!(wrap_rad(convergence.angle_rad() - again.angle_rad()).abs() < 1e-9 + 1e-8 / pole_m.max(1e-9));
    }

    #[test]
    fn a_velocity_and_a_heading_come_back_from_the_local_axes(
        lat in latitudes(), lon in -180.0..=180.0, north in -1e5..1e5, east in -1e5..1e5,
        velocity in [-50.0..50.0, -50.0..50.0, -9.0..9.0], heading in -PI..PI,
    ) {
        let origin = Origin::new(Geodetic::from_degrees(lat, lon, 0.0));
        let (_, convergence) = origin.place(PositionNed::new(north, east, -30.0));
        let velocity = VelocityNed::from(velocity);
        let back = convergence.velocity_from_local(convergence.velocity_to_local(velocity));
        prop_assert!((back - velocity).norm() < 1e-12);
        let back = convergence.heading_from_local(convergence.heading_to_local(heading));
        prop_assert!(wrap_rad(back - heading).abs() < 1e-12);
        prop_assert!((math::sin(convergence.angle_rad()) - convergence.sin).abs() < 1e-15);
    }

    #[test]
    fn wrapped_angles_are_the_same_direction(angle in -1e3..1e3) {
        let wrapped = wrap_rad(angle);
        prop_assert!(wrapped.abs() <= PI + 1e-9);
        prop_assert!((math::sin(wrapped) - math::sin(angle)).abs() < 1e-9 && (math::cos(wrapped) - math::cos(angle)).abs() < 1e-9);
    }

    #[test]
    fn the_rotation_of_an_attitude_keeps_heading_and_pitch(roll in -1.0..1.0, pitch in -1.0..1.0, heading in -3.0..3.0) {
        let attitude = Attitude { roll_rad: roll, pitch_rad: pitch, heading_rad: heading };
        let forward = attitude.ned_from_body() * Vector3::x();
        prop_assert!((math::atan2(forward.y, forward.x) - heading).abs() < 1e-9);
        prop_assert!((-forward.z - math::sin(pitch)).abs() < 1e-9, "nose up is up");
    }
}
