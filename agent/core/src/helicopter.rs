//! The built-in helicopter: a flight model of a small helicopter, of the class flown with X-Plane, that runs in the
//! agent's own process.
//!
//! After V. Gavrilets, B. Mettler and E. Feron, "Dynamic Model for a Miniature Aerobatic Helicopter" (MIT, 2003; also a
//! chapter of the Handbook of Unmanned Aerial Vehicles, 2015). A dynamic inflow replaces their iterated one, which
//! diverges in descents and gusts.
//!
//! | module | what it computes |
//! | --- | --- |
//! | [`parameters`] | the parameters of one helicopter type |
//! | `check` | the limits of these parameters |
//! | `rotor`, `main_rotor` | thrust, inflow and torque; tilt of the disc |
//! | `tail` | tail rotor, fin, yaw gyro |
//! | `body` | drag, stabiliser, rigid-body motion |
//! | `drive` | engine, governor, shaft |
//! | `ground` | contact of the skids, ground effect |
//! | `hover` | the steady hover, for the initial state |
//! | `dynamics` | the state and its rate of change |
//! | `integration` | the step from one tick to the next |
//! | `lanes`, `vector` | the numbers of the equations: one helicopter's, or eight helicopters' |
//! | [`block`] | eight vehicles stepped together |
//! | [`failures`] | the failures a scenario can inject, and when |
//! | [`wind`] | mean wind and gusts |
//! | [`vehicle`] | the complete vehicle with its measurements |

pub mod block;
mod check;
pub mod failures;
pub mod parameters;
pub mod vehicle;
pub mod wind;

mod body;
mod drive;
mod dynamics;
mod ground;
mod hover;
mod integration;
mod main_rotor;
mod rotor;
mod tail;
mod vector;

use alloc::sync::Arc;

use skein_common::frame::{Attitude, BodyRates, PositionNed, VelocityNed};
use skein_common::math;

pub use block::Block;
pub use check::ParameterError;
pub use failures::{Failures, Script};
pub use parameters::Parameters;
pub use vehicle::{BuiltInVehicle, Start};
pub use wind::{LocalWind, Weather};

use crate::plant::Controls;
use dynamics::{Dynamics, STATES, ServoCommand, State};
use integration::Stages;
use vector::{Rotation, Vector};

/// Length of one tick, during which controls and wind are held, s.
pub const TICK_S: f64 = 0.02;

/// One simulated helicopter: its constants and its 23 states.
#[derive(Clone, Debug)]
pub struct Helicopter {
    dynamics: Arc<Dynamics>,
    /// `dynamics` without any failure.
    healthy: Arc<Dynamics>,
    controls: HeldControls,
    state: State,
}

/// Converts control deflections to blade pitch and yaw rate commands.
#[derive(Clone, Debug)]
struct HeldControls {
    /// Cyclic blade pitch at full control to the right, and aft.
    lateral_throw_rad: f64,
    longitudinal_throw_rad: f64,
    min_collective_rad: f64,
    collective_range_rad: f64,
    max_yaw_rate_rad_s: f64,
}

impl HeldControls {
    fn new(parameters: &Parameters) -> Self {
        let servos = &parameters.servos;
        Self {
            lateral_throw_rad: parameters.lateral_throw_rad(),
            longitudinal_throw_rad: parameters.longitudinal_throw_rad(),
            min_collective_rad: servos.min_collective_rad,
            collective_range_rad: servos.max_collective_rad - servos.min_collective_rad,
            max_yaw_rate_rad_s: parameters.yaw_rate_rad_s(),
        }
    }

    fn command(&self, controls: &Controls) -> ServoCommand {
        ServoCommand {
            lateral_rad: self.lateral_throw_rad * controls.roll.clamp(-1.0, 1.0),
            longitudinal_rad: self.longitudinal_throw_rad * controls.pitch.clamp(-1.0, 1.0),
            collective_rad: self.min_collective_rad + self.collective_range_rad * controls.collective.clamp(0.0, 1.0),
            yaw_rate_rad_s: self.max_yaw_rate_rad_s * controls.yaw.clamp(-1.0, 1.0),
        }
    }
}

impl Helicopter {
    /// A helicopter that stands level and still on the ground at `ground_altitude_m` above the frame's origin, with the
    /// rotor at nominal speed. Governor, gyro and inflows start with the values of a hover: otherwise the helicopter
    /// sags and swings at lift-off.
    pub fn at_rest(
        parameters: &Parameters,
        north_m: f64,
        east_m: f64,
        ground_altitude_m: f64,
        heading_rad: f64,
    ) -> Self {
        let dynamics = Arc::new(Dynamics::new(parameters, ground_altitude_m));
        let hover = dynamics.hover();
        let skids = &parameters.skids;
        let height_m = skids.down_m - dynamics.body.weight_n() / (4.0 * skids.stiffness_n_m);
        let (sin, cos) = math::sin_cos(0.5 * heading_rad);
        let mut state = [0.0; STATES];
        state[..3].copy_from_slice(&[north_m, east_m, dynamics.ground_down_m - height_m]);
        state[6..10].copy_from_slice(&[cos, 0.0, 0.0, sin]);
        state[15..18].copy_from_slice(&[
            parameters.head.nominal_speed_rad_s,
            hover.governor_integral,
            hover.tail_pitch_rad,
        ]);
        state[21..].copy_from_slice(&[hover.lambda, hover.lambda_t]);
        Self { healthy: Arc::clone(&dynamics), dynamics, controls: HeldControls::new(parameters), state: State(state) }
    }

    /// Advances by one tick with these controls and this wind. The controls must be finite; values beyond the travel
    /// are clamped.
    pub fn advance(&mut self, controls: &Controls, wind: VelocityNed) {
        self.state =
            self.dynamics.tick(&self.state, &self.controls.command(controls), wind.0.into(), &mut Stages::default());
    }

    /// From now on exactly these failures are present. The measurements are not affected.
    pub fn fail(&mut self, failures: &Failures) {
        self.dynamics = Arc::new(failures.applied_to(&self.healthy));
    }

    /// Position of the centre of gravity.
    pub fn position(&self) -> PositionNed {
        let [north, east, down, ..] = self.state.0;
        PositionNed::new(north, east, down)
    }

    /// Height of the centre of gravity above the ground, m.
    pub fn height_m(&self) -> f64 {
        self.dynamics.ground_down_m - self.state.0[2]
    }

    /// Velocity over the ground.
    pub fn velocity(&self) -> VelocityNed {
        let [_, _, _, u, v, w, ..] = self.state.0;
        VelocityNed(body::ned_from_body(self.quaternion()).to_ned(Vector::new(u, v, w)).into())
    }

    /// Attitude.
    pub fn attitude(&self) -> Attitude {
        let Rotation { north, east, down } = body::ned_from_body(self.quaternion());
        Attitude {
            roll_rad: math::atan2(down.y, down.z),
            pitch_rad: math::asin((-down.x).clamp(-1.0, 1.0)),
            heading_rad: math::atan2(east.x, north.x),
        }
    }

    /// Angular velocity.
    pub fn rates(&self) -> BodyRates {
        let [_, _, _, _, _, _, _, _, _, _, p, q, r, ..] = self.state.0;
        BodyRates { roll_rad_s: p, pitch_rad_s: q, yaw_rad_s: r }
    }

    /// Main rotor speed, rad/s.
    pub fn rotor_speed_rad_s(&self) -> f64 {
        self.state.0[15]
    }

    /// Shaft power, W.
    pub fn power_w(&self) -> f64 {
        let [.., speed_rad_s, governor_integral, _, _, _, _, _, _] = self.state.0;
        self.dynamics.drive.throttle(speed_rad_s, governor_integral).power_w
    }

    fn quaternion(&self) -> [f64; 4] {
        let [_, _, _, _, _, _, w, x, y, z, ..] = self.state.0;
        [w, x, y, z]
    }
}

#[cfg(test)]
mod tests;
