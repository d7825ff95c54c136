//! Converts X-Plane's position to our units and axes and back. Degrees, revolutions per minute and south stay in this
//! folder.
//!
//! X-Plane's velocity and attitude refer to the plane that touches the Earth at X-Plane's own origin, which may be 100 km
//! from the aircraft. There the plane is tilted by 16 mrad against the local vertical: without a conversion, level flight
//! at 7 m/s would appear as a climb of 0.1 m/s. A measurement is local, so that both are rotated from the plane to the
//! local axes, and back in the stand-in. Both sides take mean sea level as the ellipsoid.

use std::f64::consts::TAU;

use nalgebra::Rotation3;
use skein_common::frame::{Attitude, BodyRates, Geodetic, Origin, TangentPlane, VelocityNed, wrap_rad};

use super::wire::aircraft::{Move, VEHX};
use super::wire::rpos::Position;
use skein_core::plant::{GroundTruth, Measurement, PeerPose};

/// Largest plausible speed of a helicopter, m/s.
const MAX_SPEED_M_S: f64 = 500.0;
/// Largest plausible body rate, rad/s.
const MAX_RATE_RAD_S: f64 = 100.0;

/// Converts revolutions per minute to radians per second.
pub(super) fn rad_s_from_rpm(rpm: f64) -> f64 {
    rpm * TAU / 60.0
}

/// Converts radians per second to revolutions per minute.
pub(super) fn rpm_from_rad_s(rad_s: f64) -> f64 {
    rad_s * 60.0 / TAU
}

/// Measurement of a position, or `None` if it is not plausible for a helicopter. `plane` is X-Plane's local frame; while it
/// is unknown, it is taken to touch the Earth at the aircraft.
pub(super) fn measurement(
    position: &Position,
    plane: Option<&TangentPlane>,
    rotor_speed_rad_s: Option<f64>,
) -> Option<Measurement> {
    let angle = |degrees: f32| f64::from(degrees).to_radians();
    let place = Geodetic::from_degrees(position.latitude_deg, position.longitude_deg, position.elevation_m);
    let velocity = VelocityNed::new(
        -f64::from(position.velocity_south_m_s),
        position.velocity_east_m_s.into(),
        -f64::from(position.velocity_up_m_s),
    );
    let attitude = Attitude {
        roll_rad: angle(position.roll_deg),
        pitch_rad: angle(position.pitch_deg),
        heading_rad: wrap_rad(angle(position.heading_deg)),
    };
    let (velocity, attitude) = match plane {
        Some(plane) => rotated(&plane.local_from_plane(&place), velocity, attitude),
        None => (velocity, attitude),
    };
    let measurement = Measurement {
        position: place,
        height_m: position.height_m.into(),
        velocity,
        attitude,
        rates: BodyRates {
            roll_rad_s: position.roll_rate_rad_s.into(),
            pitch_rad_s: position.pitch_rate_rad_s.into(),
            yaw_rad_s: position.yaw_rate_rad_s.into(),
        },
        rotor_speed_rad_s,
    };
    let is_turn = |degrees: f32, limit: f32| degrees.abs() <= limit;
    let BodyRates { roll_rad_s, pitch_rad_s, yaw_rad_s } = measurement.rates;
    let plausible = measurement.position.is_plausible()
        && measurement.height_m.abs() <= 100_000.0
        && measurement.velocity.0.norm() <= MAX_SPEED_M_S
        && [roll_rad_s, pitch_rad_s, yaw_rad_s].iter().all(|rate| rate.abs() <= MAX_RATE_RAD_S)
        && is_turn(position.pitch_deg, 90.0)
        && is_turn(position.roll_deg, 180.0)
        && is_turn(position.heading_deg, 360.0);
    plausible.then_some(measurement)
}

/// Velocity and attitude in other axes.
fn rotated(
    rotation: &Rotation3<f64>,
    VelocityNed(velocity): VelocityNed,
    attitude: Attitude,
) -> (VelocityNed, Attitude) {
    let (roll_rad, pitch_rad, heading_rad) = (rotation * attitude.ned_from_body()).euler_angles();
    (VelocityNed(rotation * velocity), Attitude { roll_rad, pitch_rad, heading_rad })
}

/// Ground truth of the simulator: its own position.
pub(super) fn truth(measurement: &Measurement, origin: &Origin) -> GroundTruth {
    let (position, convergence) = origin.locate(&measurement.position);
    GroundTruth {
        position,
        height_m: measurement.height_m,
        velocity: convergence.velocity_from_local(measurement.velocity),
        attitude: convergence.attitude_from_local(measurement.attitude),
        power_w: None,
    }
}

/// Position that X-Plane would send for this measurement, with its local frame in this plane.
pub(super) fn position(measurement: &Measurement, plane: &TangentPlane) -> Position {
    let Measurement { position, height_m, rates, .. } = measurement;
    let plane_from_local = plane.local_from_plane(position).inverse();
    let (velocity, attitude) = rotated(&plane_from_local, measurement.velocity, measurement.attitude);
    let heading_deg = attitude.heading_rad.to_degrees().rem_euclid(360.0);
    Position {
        longitude_deg: position.longitude_deg(),
        latitude_deg: position.latitude_deg(),
        elevation_m: position.altitude_m,
        height_m: *height_m as f32,
        pitch_deg: attitude.pitch_rad.to_degrees() as f32,
        heading_deg: heading_deg as f32,
        roll_deg: attitude.roll_rad.to_degrees() as f32,
        velocity_east_m_s: velocity.east_m_s() as f32,
        velocity_up_m_s: -velocity.down_m_s() as f32,
        velocity_south_m_s: -velocity.north_m_s() as f32,
        roll_rate_rad_s: rates.roll_rad_s as f32,
        pitch_rate_rad_s: rates.pitch_rad_s as f32,
        yaw_rate_rad_s: rates.yaw_rad_s as f32,
    }
}

/// Pose of the simulator's aircraft of this number that shows this peer.
pub(super) fn peer(pose: &PeerPose, number: u8) -> Move {
    let PeerPose { position, attitude, .. } = pose;
    Move {
        tag: VEHX,
        aircraft: number,
        latitude_deg: position.latitude_deg(),
        longitude_deg: position.longitude_deg(),
        elevation_m: position.altitude_m,
        heading_deg: attitude.heading_rad.to_degrees().rem_euclid(360.0) as f32,
        pitch_deg: attitude.pitch_rad.to_degrees() as f32,
        roll_deg: attitude.roll_rad.to_degrees() as f32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn level() -> Position {
        Position { longitude_deg: -82.0, latitude_deg: 28.0, elevation_m: 12.0, ..Position::default() }
    }

    #[test]
    fn axes_and_signs_are_converted() {
        let flying = Position {
            heading_deg: 270.0,
            pitch_deg: 10.0,
            roll_deg: -20.0,
            velocity_east_m_s: 1.0,
            velocity_up_m_s: 2.0,
            velocity_south_m_s: 3.0,
            ..level()
        };
        let Measurement { velocity, attitude, position, .. } = measurement(&flying, None, None).unwrap();
        assert_eq!(velocity, VelocityNed::new(-3.0, 1.0, -2.0));
        assert!((attitude.heading_rad + TAU / 4.0).abs() < 1e-9);
        assert!((attitude.pitch_rad - 10f64.to_radians()).abs() < 1e-7);
        assert!((attitude.roll_rad + 20f64.to_radians()).abs() < 1e-7);
        assert!((position.longitude_deg() + 82.0).abs() < 1e-12);
    }

    #[test]
    fn a_position_survives_conversion_and_back() {
        let flying = Position {
            height_m: 7.5,
            heading_deg: 300.0,
            pitch_deg: -3.0,
            roll_deg: 4.5,
            velocity_south_m_s: -8.0,
            yaw_rate_rad_s: 0.25,
            ..level()
        };
        for (latitude_deg, longitude_deg) in [(28.0, -82.0), (28.9, -81.1), (-89.0, 10.0)] {
            let plane = TangentPlane::new(Geodetic::from_degrees(latitude_deg, longitude_deg, 0.0));
            let back = position(&measurement(&flying, Some(&plane), None).unwrap(), &plane);
            assert!((back.heading_deg - 300.0).abs() < 1e-4 && (back.latitude_deg - 28.0).abs() < 1e-12);
            assert!((back.velocity_south_m_s + 8.0).abs() < 1e-5 && (back.roll_deg - 4.5).abs() < 1e-4);
            assert_eq!(back.yaw_rate_rad_s, 0.25);
        }
    }

    #[test]
    fn level_flight_far_from_the_simulators_origin_is_level() {
        // 100 km east of X-Plane's origin: its plane is tilted by 16 mrad and its north by 7 mrad against the local axes.
        let plane = TangentPlane::new(Geodetic::from_degrees(28.0, -83.0186, 0.0));
        let east = Attitude { heading_rad: TAU / 4.0, ..Attitude::default() };
        let level = measurement(&level(), None, None).unwrap();
        let level = Measurement { velocity: VelocityNed::new(0.0, 7.0, 0.0), attitude: east, ..level };
        let sent = position(&level, &plane);
        assert!((sent.velocity_up_m_s + 0.11).abs() < 0.01 && (sent.pitch_deg + 0.9).abs() < 0.01, "{sent:?}");
        assert!((sent.heading_deg - 89.52).abs() < 0.01, "{sent:?}");
        let received = measurement(&sent, Some(&plane), None).unwrap();
        assert!((received.velocity - level.velocity).norm() < 1e-5, "{received:?}");
        assert!((received.attitude.heading_rad - TAU / 4.0).abs() < 1e-6 && received.attitude.pitch_rad.abs() < 1e-6);
    }

    #[test]
    fn motion_beyond_any_helicopter_is_refused() {
        assert!(measurement(&level(), None, None).is_some());
        let impossible = [
            Position { velocity_up_m_s: 501.0, ..level() },
            Position { elevation_m: 2e5, ..level() },
            Position { roll_rate_rad_s: -101.0, ..level() },
            Position { pitch_deg: 91.0, ..level() },
            Position { roll_deg: 181.0, ..level() },
            Position { heading_deg: 1e9, ..level() },
            Position { height_m: 1e6, ..level() },
        ];
        for position in impossible {
            assert_eq!(measurement(&position, None, None), None, "{position:?}");
        }
    }
}
