//! The controller of a point mass: converts the formation's setpoint to commanded velocities.
//!
//! The horizontal velocity is the setpoint's own, feed-forward included. Altitude and heading are proportional:
//! climb = 0.5/s · altitude error, heading rate = 1/s · heading error. The plant has the limits.

use nalgebra::Vector2;
use skein_common::frame::wrap_rad;

use super::{ControlFault, check, gate};
use crate::estimate::Estimate;
use crate::plant::VelocityCommand;
use crate::setpoint::Setpoint;

/// Climb rate that is commanded per metre of altitude error, 1/s: that of the collective rules.
const CLIMB_PER_ERROR_PER_S: f64 = 0.5;
/// Heading rate that is commanded per radian of heading error, 1/s.
const TURN_PER_ERROR_PER_S: f64 = 1.0;
/// Sink rate of a descent without power, m/s. A point mass has no engine that could fail.
const POWERLESS_SINK_M_S: f64 = 1.0;

/// The controller of one point mass. Call [`VelocityController::step`] once per frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct VelocityController {
    last: VelocityCommand,
}

impl VelocityController {
    /// Computes the next command. If an argument is not finite, it repeats the last command and returns the fault.
    pub fn step(
        &mut self,
        dt_s: f64,
        estimate: &Estimate,
        setpoint: &Setpoint,
    ) -> (VelocityCommand, Option<ControlFault>) {
        let fault = check(dt_s, estimate, setpoint).err();
        if fault.is_none() {
            let velocity_ne_m_s = setpoint.relative_velocity_ne_m_s + setpoint.feedforward_ne_m_s;
            let altitude_error_m = setpoint.altitude_m - estimate.position.altitude_m();
            let heading_error_rad = wrap_rad(setpoint.heading_rad - estimate.attitude.heading_rad);
            self.last = VelocityCommand {
                velocity_ne_m_s: velocity_ne_m_s * gate(estimate.height_m),
                climb_m_s: CLIMB_PER_ERROR_PER_S * altitude_error_m,
                turn_rad_s: TURN_PER_ERROR_PER_S * heading_error_rad,
            };
        }
        (self.last, fault)
    }

    /// All velocities zero: for a vehicle without own data, and for one on the ground.
    pub fn stop(&mut self) -> VelocityCommand {
        self.last = VelocityCommand::default();
        self.last
    }

    /// A slow descent on the spot.
    pub fn sink(&mut self) -> VelocityCommand {
        self.last =
            VelocityCommand { velocity_ne_m_s: Vector2::zeros(), climb_m_s: -POWERLESS_SINK_M_S, turn_rad_s: 0.0 };
        self.last
    }
}

#[cfg(test)]
mod tests {
    use skein_common::frame::{Attitude, BodyRates, Geodetic, Origin, PositionNed, VelocityNed};
    use skein_common::scenario::{Source, load};

    use super::*;
    use crate::helicopter::{Start, TICK_S};
    use crate::point_mass::PointMass;

    fn estimate(altitude_m: f64, heading_rad: f64) -> Estimate {
        Estimate {
            position: PositionNed::new(0.0, 0.0, -altitude_m),
            geodetic: Geodetic::from_degrees(28.0, -82.0, altitude_m),
            height_m: altitude_m,
            velocity: VelocityNed::default(),
            attitude: Attitude { heading_rad, ..Attitude::default() },
            rates: BodyRates::default(),
            rotor_speed_rad_s: None,
        }
    }

    fn setpoint(altitude_m: f64, heading_rad: f64) -> Setpoint {
        Setpoint {
            relative_velocity_ne_m_s: Vector2::new(3.0, -1.0),
            feedforward_ne_m_s: Vector2::new(1.0, 2.0),
            altitude_m,
            heading_rad,
        }
    }

    #[test]
    fn the_setpoints_velocity_is_commanded_with_its_feed_forward() {
        let (command, fault) = VelocityController::default().step(0.02, &estimate(30.0, 3.0), &setpoint(32.0, -3.0));
        assert_eq!((command.velocity_ne_m_s, command.climb_m_s, fault), (Vector2::new(4.0, 1.0), 1.0, None));
        // The shorter way from 3 rad to −3 rad leads over π.
        assert!((command.turn_rad_s - (2.0 * core::f64::consts::PI - 6.0)).abs() < 1e-12);
    }

    #[test]
    fn a_point_near_the_ground_climbs_before_it_moves_sideways() {
        let (command, _) = VelocityController::default().step(0.02, &estimate(1.0, 0.0), &setpoint(30.0, 0.0));
        assert!(command.velocity_ne_m_s == Vector2::zeros() && command.climb_m_s > 0.0, "{command:?}");
    }

    #[test]
    fn a_fault_repeats_the_last_command() {
        let mut controller = VelocityController::default();
        let (good, _) = controller.step(0.02, &estimate(30.0, 0.0), &setpoint(31.0, 0.0));
        for (dt_s, estimate, setpoint, fault) in [
            (0.02, estimate(f64::NAN, 0.0), setpoint(31.0, 0.0), ControlFault::Estimate),
            (0.02, estimate(30.0, 0.0), setpoint(f64::INFINITY, 0.0), ControlFault::Setpoint),
            (f64::NAN, estimate(30.0, 0.0), setpoint(31.0, 0.0), ControlFault::TimeStep),
        ] {
            assert_eq!(controller.step(dt_s, &estimate, &setpoint), (good, Some(fault)));
        }
        assert_eq!(controller.stop(), VelocityCommand::default());
        assert_eq!(controller.step(f64::NAN, &estimate(30.0, 0.0), &setpoint(31.0, 0.0)).0, VelocityCommand::default());
        assert!(controller.sink().climb_m_s < 0.0);
    }

    #[test]
    fn altitude_and_heading_settle_without_much_overshoot() {
        let scenario = load(&Source { name: "test.toml", text: "swarm.vehicles = 1" }, &[]).unwrap().scenario;
        let origin = Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0));
        let mut plant = PointMass::new(&origin, &scenario.plant.point_mass, &Start::default());
        let mut controller = VelocityController::default();
        let setpoint = Setpoint { altitude_m: 30.0, heading_rad: 2.5, ..setpoint(30.0, 0.0) };
        let (mut highest_m, mut farthest_rad) = (0.0_f64, 0.0_f64);
        for _ in 0..(60.0 / TICK_S) as u32 {
            let truth = plant.frame().truth;
            let estimate = Estimate {
                position: truth.position,
                height_m: truth.height_m,
                velocity: truth.velocity,
                attitude: truth.attitude,
                ..estimate(0.0, 0.0)
            };
            (highest_m, farthest_rad) = (highest_m.max(truth.height_m), farthest_rad.max(truth.attitude.heading_rad));
            plant.advance(Some(controller.step(TICK_S, &estimate, &setpoint).0));
        }
        let truth = plant.frame().truth;
        assert!((truth.height_m - 30.0).abs() < 0.01 && highest_m < 30.5, "{} m, {highest_m} m", truth.height_m);
        assert!((truth.attitude.heading_rad - 2.5).abs() < 1e-3 && farthest_rad < 2.55, "{farthest_rad}");
        assert!((truth.velocity.horizontal() - Vector2::new(4.0, 1.0)).norm() < 1e-6);
    }
}
