//! The point mass: a vehicle that follows commanded velocities, for studies of laws at scale.
//!
//! It holds its velocity over the ground, as a vehicle with an autopilot and a satellite receiver does, so that wind
//! does not move it: a scenario with wind is refused. It stays level. With the commanded horizontal velocity u, cut to
//! the largest speed, and the commanded climb rate and heading rate, cut likewise, each over a tick of Δt = 20 ms:
//!
//! ```text
//! a = (u − v)(1 − e^(−Δt/τ))/Δt,  |a| ≤ a_max          the exact response to a held command, cut to the acceleration
//! v ← v + a Δt
//! x ← x + (v_old + v) Δt/2
//! ```
//!
//! The climb rate has the same time constant τ and the same limit of acceleration; the heading rate has a time constant
//! of its own. τ = 0 gives the commanded rate at once.
//!
//! The ground is flat, at the height of the swarm's origin. On the ground the point rests until a climb is commanded,
//! and a point that sinks onto it stops there. Its height on the ground is zero.

use nalgebra::Vector3;
use skein_common::frame::{Attitude, BodyRates, Convergence, Geodetic, Origin, PositionNed, VelocityNed, wrap_rad};
use skein_common::math;
use skein_common::scenario::PointMassLimits;
use skein_common::time::PlantTime;

use crate::helicopter::{Failures, Start, TICK_S};
use crate::plant::{Frame, GroundTruth, Measurement, VelocityCommand};

/// A point mass with its measurements.
#[derive(Clone, Debug)]
pub struct PointMass {
    origin: Origin,
    limits: Limits,
    position: PositionNed,
    velocity: VelocityNed,
    heading_rad: f64,
    turn_rad_s: f64,
    ticks: u64,
    /// The last valid command; `None` before the first.
    command: Option<VelocityCommand>,
    failures: Failures,
    /// The position that is measured while the position is frozen, with the convergence there.
    frozen: Option<(Geodetic, Convergence)>,
}

/// The limits of a point mass, and its responses over a tick.
#[derive(Clone, Copy, Debug)]
struct Limits {
    speed_m_s: f64,
    climb_m_s: f64,
    turn_rad_s: f64,
    /// Largest change of the velocity in a tick, m/s; infinite without a limit.
    change_m_s: f64,
    /// Share of the difference to the command that a tick removes: 1 − e^(−Δt/τ).
    velocity_share: f64,
    turn_share: f64,
}

impl PointMass {
    /// A point at rest on the ground at its start.
    pub fn new(origin: &Origin, limits: &PointMassLimits, start: &Start) -> Self {
        let share = |lag_s: f64| if lag_s > 0.0 { 1.0 - math::exp(-TICK_S / lag_s) } else { 1.0 };
        Self {
            origin: *origin,
            limits: Limits {
                speed_m_s: limits.max_speed_m_s,
                climb_m_s: limits.max_climb_m_s,
                turn_rad_s: limits.max_turn_deg_s.to_radians(),
                change_m_s: limits.max_acceleration_m_s2.map_or(f64::INFINITY, |limit_m_s2| limit_m_s2 * TICK_S),
                velocity_share: share(limits.lag_s),
                turn_share: share(limits.turn_lag_s),
            },
            position: PositionNed::new(start.north_m, start.east_m, 0.0),
            velocity: VelocityNed::default(),
            heading_rad: wrap_rad(start.heading_rad),
            turn_rad_s: 0.0,
            ticks: 0,
            command: None,
            failures: Failures::default(),
            frozen: None,
        }
    }

    /// The current frame. The measurement is exact unless the position is frozen.
    pub fn frame(&self) -> Frame {
        let &Self { position, velocity, heading_rad, turn_rad_s, .. } = self;
        let attitude = Attitude { roll_rad: 0.0, pitch_rad: 0.0, heading_rad };
        let height_m = position.altitude_m();
        let (measured, convergence) = self.frozen.unwrap_or_else(|| self.origin.place(position));
        Frame {
            time: PlantTime::from_seconds(self.ticks as f64 * TICK_S),
            measurement: Measurement {
                position: measured,
                height_m,
                velocity: convergence.velocity_to_local(velocity),
                attitude: convergence.attitude_to_local(attitude),
                rates: BodyRates { yaw_rad_s: turn_rad_s, ..BodyRates::default() },
                rotor_speed_rad_s: None,
            },
            truth: GroundTruth { position, height_m, velocity, attitude, power_w: None },
        }
    }

    /// Advances by one tick. `None` keeps the last command, and a command that is not finite is ignored. Before the
    /// first command the point stays where it is.
    pub fn advance(&mut self, command: Option<VelocityCommand>) {
        self.ticks += 1;
        self.command = command.filter(VelocityCommand::is_finite).or(self.command);
        let Some(VelocityCommand { velocity_ne_m_s, climb_m_s, turn_rad_s }) = self.command else { return };
        let limits = self.limits;
        let climb_m_s = climb_m_s.clamp(-limits.climb_m_s, limits.climb_m_s);
        if self.position.down_m() >= 0.0 && climb_m_s <= 0.0 {
            self.rest();
            return;
        }
        let before = self.velocity;
        let change_ne_m_s =
            (velocity_ne_m_s.cap_magnitude(limits.speed_m_s) - before.horizontal()) * limits.velocity_share;
        let change_ne_m_s = change_ne_m_s.cap_magnitude(limits.change_m_s);
        let change_down_m_s = (-climb_m_s - before.down_m_s()) * limits.velocity_share;
        let change_down_m_s = change_down_m_s.clamp(-limits.change_m_s, limits.change_m_s);
        self.velocity.0 += Vector3::new(change_ne_m_s.x, change_ne_m_s.y, change_down_m_s);
        self.position.0 += (before.0 + self.velocity.0) * (0.5 * TICK_S);
        let turned_rad_s = self.turn_rad_s;
        let command_rad_s = turn_rad_s.clamp(-limits.turn_rad_s, limits.turn_rad_s);
        self.turn_rad_s += (command_rad_s - turned_rad_s) * limits.turn_share;
        self.heading_rad = wrap_rad(self.heading_rad + (turned_rad_s + self.turn_rad_s) * (0.5 * TICK_S));
        if self.position.down_m() >= 0.0 && self.velocity.down_m_s() > 0.0 {
            self.position.0.z = 0.0;
            self.rest();
        }
    }

    /// From now on exactly these failures are present; all others are cured. Only a frozen position has an effect: a
    /// point mass has no engine, servo or gyro that can fail.
    pub fn fail(&mut self, failures: Failures) {
        if failures.position_frozen != self.failures.position_frozen {
            self.frozen = failures.position_frozen.then(|| self.origin.place(self.position));
        }
        self.failures = failures;
    }

    fn rest(&mut self) {
        (self.velocity, self.turn_rad_s) = (VelocityNed::default(), 0.0);
    }
}

#[cfg(test)]
mod tests;
