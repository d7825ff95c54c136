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
        let ecef = Vector3::new(x, y, z);
        assert!((place.to_ecef().0 - ecef).norm() < TOLERANCE_M, "ECEF of {place:?}");
        let back = Ecef(ecef).to_geodetic();
        assert!((back.to_ecef().0 - ecef).norm() < TOLERANCE_M, "geodetic of {ecef:?}: {back:?}");
        assert!((back.altitude_m - h).abs() < TOLERANCE_M, "height of {ecef:?}: {back:?}");
        assert!((back.latitude_rad - place.latitude_rad).abs() * A < TOLERANCE_M, "latitude of {ecef:?}");

        let origin = Origin::new(Geodetic::from_degrees(lat0, lon0, h0));
        let ned = Vector3::new(north, east, down);
        assert!((origin.ned_from_geodetic(&place).0 - ned).norm() < TOLERANCE_M, "NED of {place:?}");
        let back = origin.geodetic_from_ned(PositionNed(ned));
        assert!((back.to_ecef().0 - ecef).norm() < TOLERANCE_M, "geodetic of {ned:?}: {back:?}");
    }
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

proptest! {
    #[test]
    fn local_and_geodetic_are_inverse(
        lat in -90.0..90.0, lon in -180.0..180.0, north in -2e4..2e4, east in -2e4..2e4, down in -1e4..100.0,
    ) {
        let origin = Origin::new(Geodetic::from_degrees(lat, lon, 100.0));
        let ned = PositionNed::new(north, east, down);
        let back = origin.ned_from_geodetic(&origin.geodetic_from_ned(ned));
        prop_assert!((back - ned).norm() < 1e-5, "{ned:?} came back as {back:?}");
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
