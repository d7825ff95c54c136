//! The reading of an accelerometer in the aircraft, from the velocities of two frames.

use nalgebra::{Rotation3, Vector3};
use skein_common::frame::{Attitude, VelocityNed};
use skein_common::time::PlantTime;
use skein_core::plant::Frame;

/// Standard gravity, m/s².
const GRAVITY_M_S2: f64 = 9.80665;

/// The aircraft's velocity in the last frame, and its specific force since the one before.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    time: PlantTime,
    velocity: VelocityNed,
    /// Specific force in body axes, forward, right, down, as a multiple of gravity: 0, 0, -1 in a hover.
    pub(super) specific_force_g: [f64; 3],
}

impl Motion {
    /// An aircraft that has not moved yet.
    pub(super) fn begin(frame: &Frame) -> Self {
        let attitude = &frame.measurement.attitude;
        Self {
            time: frame.time,
            velocity: frame.measurement.velocity,
            specific_force_g: specific_force_g(Vector3::zeros(), attitude),
        }
    }

    /// The motion up to this frame. While time stands still, it stays.
    pub(super) fn after(self, frame: &Frame) -> Self {
        let (passed_s, velocity) = (frame.time.seconds() - self.time.seconds(), frame.measurement.velocity);
        if passed_s <= 0.0 {
            // After a reset or in a replay, time runs back.
            return if passed_s < 0.0 { Self::begin(frame) } else { self };
        }
        let acceleration_m_s2 = (velocity.0 - self.velocity.0) / passed_s;
        let specific_force_g = specific_force_g(acceleration_m_s2, &frame.measurement.attitude);
        Self { time: frame.time, velocity, specific_force_g }
    }
}

/// Acceleration, north, east, down, m/s², without that of gravity, in body axes.
fn specific_force_g(acceleration_m_s2: Vector3<f64>, attitude: &Attitude) -> [f64; 3] {
    let Attitude { roll_rad, pitch_rad, heading_rad } = *attitude;
    let body_from_ned = Rotation3::from_euler_angles(roll_rad, pitch_rad, heading_rad).inverse();
    ((body_from_ned * (acceleration_m_s2 - Vector3::new(0.0, 0.0, GRAVITY_M_S2))) / GRAVITY_M_S2).into()
}

#[cfg(test)]
mod tests {
    use skein_common::frame::{BodyRates, Geodetic};
    use skein_core::plant::{GroundTruth, Measurement};

    use super::*;

    fn frame(t_s: f64, velocity: [f64; 3], pitch_deg: f64) -> Frame {
        let [north, east, down] = velocity;
        let measurement = Measurement {
            velocity: VelocityNed::new(north, east, down),
            attitude: Attitude { pitch_rad: f64::to_radians(pitch_deg), heading_rad: 0.0, roll_rad: 0.0 },
            position: Geodetic::from_degrees(0.0, 0.0, 0.0),
            height_m: 0.0,
            rates: BodyRates::default(),
            rotor_speed_rad_s: None,
        };
        Frame { time: PlantTime::from_seconds(t_s), measurement, truth: GroundTruth::default() }
    }

    #[test]
    fn a_hover_is_one_g_up_and_a_climb_or_an_acceleration_adds_to_it() {
        let near = |one: [f64; 3], other: [f64; 3]| {
            one.iter().zip(other).for_each(|(one, other)| assert!((one - other).abs() < 1e-9, "{one} {other}"));
        };
        let hover = Motion::begin(&frame(0.0, [0.0; 3], 0.0));
        near(hover.specific_force_g, [0.0, 0.0, -1.0]);
        let climbing = hover.after(&frame(0.1, [0.0, 0.0, -0.980665], 0.0));
        near(climbing.specific_force_g, [0.0, 0.0, -2.0]);
        near(hover.after(&frame(0.1, [0.980665, 0.0, 0.0], 0.0)).specific_force_g, [1.0, 0.0, -1.0]);
        near(hover.after(&frame(0.1, [0.0, 0.980665, 0.0], 0.0)).specific_force_g, [0.0, 1.0, -1.0]);
        // Nose up at rest: gravity pulls towards the tail, and the seat pushes forward.
        near(hover.after(&frame(0.1, [0.0; 3], 30.0)).specific_force_g, [0.5, 0.0, -f64::sqrt(0.75)]);
        near(climbing.after(&frame(0.1, [9.0; 3], 0.0)).specific_force_g, climbing.specific_force_g);
        near(climbing.after(&frame(0.0, [9.0; 3], 0.0)).specific_force_g, [0.0, 0.0, -1.0]);
    }
}
