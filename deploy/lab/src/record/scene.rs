//! Messages that Foxglove draws: frames, positions on the globe, helicopters and the formation.
//!
//! Foxglove's world frame is east, north, up, and its body frames are forward, left, up (as in ROS, REP 103). Ours are
//! north, east, down and forward, right, down. The two differ by a constant rotation on each side:
//!
//! ```text
//!   enu_from_flu = enu_from_ned * ned_from_frd * frd_from_flu
//! ```

use foxglove::messages::{
    Color, CubePrimitive, CylinderPrimitive, FrameTransform, FrameTransforms, LinePrimitive, LocationFix, Log, Point3,
    Pose, Quaternion, SceneEntity, SceneUpdate, TextPrimitive, Timestamp, Vector3, line_primitive, log,
};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector2};
use skein_common::frame::{Attitude, HeadingFrame, Origin};
use skein_common::id::VehicleId;
use skein_common::math;
use skein_common::message::{Severity, Trace};
use skein_common::scenario::Formation;
use skein_core::formation::{self, ring::Region};

/// The root frame: east, north, up at the scenario's origin.
pub(super) const WORLD: &str = "world";
/// The frame of the formation's centre, with the axes of the world frame.
pub(super) const CENTRE: &str = "centre";

/// Length of a drawn helicopter, m. At its true size a model helicopter would be a dot in a formation of 100 m.
const DRAWN_LENGTH_M: f64 = 8.0;
/// Number of corners of a drawn ellipse.
const CORNERS: usize = 90;

/// M. Okabe & K. Ito's colours, without black and yellow.
const COLOURS: [[f64; 3]; 6] = [
    [0.0, 0.45, 0.70],
    [0.90, 0.60, 0.0],
    [0.0, 0.62, 0.45],
    [0.84, 0.37, 0.0],
    [0.80, 0.47, 0.65],
    [0.35, 0.70, 0.90],
];

/// Name of the frame of a vehicle: forward, left, up.
pub(super) fn frame(id: VehicleId) -> String {
    format!("vehicle/{id}")
}

pub(super) fn timestamp(log_time_ns: u64) -> Timestamp {
    let seconds = u32::try_from(log_time_ns / 1_000_000_000).unwrap_or(u32::MAX);
    Timestamp::new(seconds, (log_time_ns % 1_000_000_000) as u32)
}

/// Converts north, east, down to east, north, up.
fn enu_from_ned(ned: nalgebra::Vector3<f64>) -> Vector3 {
    Vector3 { x: ned.y, y: ned.x, z: -ned.z }
}

/// Rotation from a vehicle's forward, left, up to east, north, up.
fn enu_from_flu(attitude: &Attitude) -> UnitQuaternion<f64> {
    let enu_from_ned = Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0);
    let frd_from_flu = Matrix3::from_diagonal(&nalgebra::Vector3::new(1.0, -1.0, -1.0));
    let rotation = enu_from_ned * attitude.ned_from_body().matrix() * frd_from_flu;
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation))
}

/// The transform of a vehicle's frame, from its ground truth.
pub(super) fn vehicle_transform(time: Timestamp, trace: &Trace) -> FrameTransforms {
    let rotation = enu_from_flu(&trace.attitude);
    transform(time, frame(trace.header.sender), enu_from_ned(trace.position.0), rotation)
}

/// The transform of the frame `centre`, from a vehicle's own estimate of the centre, at this altitude, m.
pub(super) fn centre_transform(time: Timestamp, centre_ne_m: [f64; 2], altitude_m: f64) -> FrameTransforms {
    let centre = Vector3 { x: centre_ne_m[1], y: centre_ne_m[0], z: altitude_m };
    transform(time, CENTRE.to_owned(), centre, UnitQuaternion::identity())
}

fn transform(time: Timestamp, child: String, place: Vector3, rotation: UnitQuaternion<f64>) -> FrameTransforms {
    let transform = FrameTransform {
        timestamp: Some(time),
        parent_frame_id: WORLD.to_owned(),
        child_frame_id: child,
        translation: Some(place),
        rotation: Some(Quaternion { x: rotation.i, y: rotation.j, z: rotation.k, w: rotation.w }),
    };
    FrameTransforms { transforms: vec![transform] }
}

/// The vehicle's position on the globe, from its ground truth. Heading and velocity refer to its local north and vertical.
pub(super) fn location(time: Timestamp, origin: &Origin, trace: &Trace) -> LocationFix {
    let (place, convergence) = origin.place(trace.position);
    LocationFix {
        timestamp: Some(time),
        frame_id: frame(trace.header.sender),
        latitude: place.latitude_deg(),
        longitude: place.longitude_deg(),
        altitude: place.altitude_m,
        heading: Some(convergence.heading_to_local(trace.attitude.heading_rad)),
        velocity: Some(enu_from_ned(convergence.velocity_to_local(trace.velocity).0)),
        color: Some(colour(trace.header.sender, 1.0)),
        ..LocationFix::default()
    }
}

/// A helicopter in the frame of each vehicle, larger than its true size, with the vehicle's id.
pub(super) fn vehicles(time: Timestamp, ids: impl Iterator<Item = VehicleId>) -> SceneUpdate {
    let entity = |id: VehicleId| {
        let at = |x: f64, z: f64| pose(DRAWN_LENGTH_M * x, 0.0, DRAWN_LENGTH_M * z);
        let size =
            |x: f64, y: f64, z: f64| Vector3 { x: DRAWN_LENGTH_M * x, y: DRAWN_LENGTH_M * y, z: DRAWN_LENGTH_M * z };
        let cube = |x, size| CubePrimitive { pose: Some(at(x, 0.0)), size: Some(size), color: Some(colour(id, 1.0)) };
        let rotor = CylinderPrimitive {
            pose: Some(at(0.0, 0.16)),
            size: Some(size(1.0, 1.0, 0.02)),
            bottom_scale: 1.0,
            top_scale: 1.0,
            color: Some(colour(id, 0.35)),
        };
        let number = TextPrimitive {
            pose: Some(at(0.0, 0.5)),
            billboard: true,
            font_size: 14.0,
            scale_invariant: true,
            color: Some(colour(id, 1.0)),
            text: id.to_string(),
        };
        SceneEntity {
            timestamp: Some(time),
            frame_id: frame(id),
            id: frame(id),
            frame_locked: true,
            // A cabin in front of a tail boom.
            cubes: vec![cube(0.1, size(0.4, 0.18, 0.2)), cube(-0.35, size(0.5, 0.05, 0.06))],
            cylinders: vec![rotor],
            texts: vec![number],
            ..SceneEntity::default()
        }
    };
    SceneUpdate { deletions: Vec::new(), entities: ids.map(entity).collect() }
}

/// The formation's ellipse and the edges of its band, about the frame `centre`.
pub(super) fn formation(time: Timestamp, formation: &Formation) -> SceneUpdate {
    let ring = formation::ring(formation);
    let edges_m = match ring.region {
        Region::Band => vec![ring.radius_m - ring.inner_width_m, ring.radius_m + ring.outer_width_m],
        Region::Inside => Vec::new(),
    };
    let line = |radius_m: f64, thickness: f64, alpha: f64| LinePrimitive {
        r#type: line_primitive::Type::LineLoop.into(),
        pose: Some(pose(0.0, 0.0, 0.0)),
        thickness,
        scale_invariant: true,
        points: ellipse(radius_m, ring.gamma, ring.heading_rad),
        color: Some(Color { r: 0.5, g: 0.5, b: 0.5, a: alpha }),
        ..LinePrimitive::default()
    };
    let edges = edges_m.into_iter().filter(|radius_m| *radius_m > 0.0).map(|radius_m| line(radius_m, 1.0, 0.6));
    let entity = SceneEntity {
        timestamp: Some(time),
        frame_id: CENTRE.to_owned(),
        id: "formation".to_owned(),
        frame_locked: true,
        lines: std::iter::once(line(ring.radius_m, 2.0, 1.0)).chain(edges).collect(),
        ..SceneEntity::default()
    };
    SceneUpdate { deletions: Vec::new(), entities: vec![entity] }
}

/// Points of the ellipse ρ = `radius_m`, with the semi-axes ρ along the heading and ρ/√γ across it, m. East, north, up.
fn ellipse(radius_m: f64, gamma: f64, heading_rad: f64) -> Vec<Point3> {
    let axes = HeadingFrame::new(heading_rad);
    let corner = |nth: usize| {
        let (sin, cos) = math::sin_cos(std::f64::consts::TAU * nth as f64 / CORNERS as f64);
        let north_east = axes.to_ne(Vector2::new(radius_m * cos, radius_m / gamma.sqrt() * sin));
        Point3 { x: north_east.y, y: north_east.x, z: 0.0 }
    };
    (0..CORNERS).map(corner).collect()
}

/// A line of the log: its source and its text.
pub(super) fn line(time: Timestamp, severity: Severity, who: String, what: String) -> Log {
    let level = match severity {
        Severity::Info => log::Level::Info,
        Severity::Warning => log::Level::Warning,
        Severity::Error => log::Level::Error,
    };
    Log { timestamp: Some(time), level: level.into(), message: what, name: who, ..Log::default() }
}

fn pose(x: f64, y: f64, z: f64) -> Pose {
    Pose { position: Some(Vector3 { x, y, z }), orientation: Some(Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }) }
}

fn colour(id: VehicleId, alpha: f64) -> Color {
    let [r, g, b] = COLOURS[usize::from(id.get() - 1) % COLOURS.len()];
    Color { r, g, b, a: alpha }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use skein_common::frame::PositionNed;

    use super::*;

    /// A vehicle's forward, left and up axes in east, north, up.
    fn axes(roll_rad: f64, pitch_rad: f64, heading_rad: f64) -> [[f64; 3]; 3] {
        let rotation = enu_from_flu(&Attitude { roll_rad, pitch_rad, heading_rad });
        let axes = [nalgebra::Vector3::x(), nalgebra::Vector3::y(), nalgebra::Vector3::z()];
        axes.map(|axis| (rotation * axis).map(|c| (c * 1e9).round() / 1e9 + 0.0).into())
    }

    #[test]
    fn the_axes_of_a_vehicle_are_forward_left_and_up() {
        let (east, north, up) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
        let [west, south, down] = [east, north, up].map(|axis| axis.map(|c| 0.0 - c));
        assert_eq!(axes(0.0, 0.0, 0.0), [north, west, up], "nose north");
        assert_eq!(axes(0.0, 0.0, FRAC_PI_2), [east, north, up], "nose east: the world's own axes");
        assert_eq!(axes(0.0, FRAC_PI_2, 0.0), [up, west, south], "nose up");
        assert_eq!(axes(FRAC_PI_2, 0.0, 0.0), [north, up, east], "right side down");
        assert_eq!(axes(0.0, 0.0, -FRAC_PI_2), [west, south, up]);
        assert_eq!(axes(0.0, -FRAC_PI_2, FRAC_PI_2), [down, north, east], "nose east, then down");
    }

    #[test]
    fn a_position_is_converted_to_east_north_and_up() {
        let ned = PositionNed::new(10.0, 20.0, -30.0);
        assert_eq!(enu_from_ned(ned.0), Vector3 { x: 20.0, y: 10.0, z: 30.0 });
    }

    #[test]
    fn an_ellipse_lies_along_its_heading() {
        // Semi-axes 100 along the heading, which is east, and 50 across it.
        let points = ellipse(100.0, 4.0, FRAC_PI_2);
        let farthest = |part: fn(&Point3) -> f64| points.iter().map(part).fold(0.0, f64::max);
        assert!((farthest(|point| point.x) - 100.0).abs() < 0.1 && (farthest(|point| point.y) - 50.0).abs() < 0.1);
        let ring = formation::ring::Ring {
            gamma: 4.0,
            heading_rad: 0.5,
            ..formation::ring(&crate::scenario::ScenarioArgs::default().read(Vec::new()).unwrap().scenario.formation)
        };
        for point in ellipse(70.0, 4.0, 0.5) {
            assert!((ring.level_m(Vector2::new(point.y, point.x)) - 70.0).abs() < 1e-9);
        }
    }

    #[test]
    fn times_beyond_the_range_of_a_stamp_are_clamped() {
        assert_eq!(timestamp(1_500_000_000), Timestamp::new(1, 500_000_000));
        assert_eq!(timestamp(u64::MAX).sec(), u32::MAX);
    }
}
