//! The interface to a plant: the simulator that an agent controls.
//!
//! A plant delivers one [`Frame`] at a time and takes [`Command`]s. Degrees, feet, knots and a simulator's own axes are
//! converted inside the module of that plant.

use alloc::vec::Vec;
use core::time::Duration;

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};
use skein_common::frame::{Attitude, BodyRates, Geodetic, PositionNed, VelocityNed};
use skein_common::id::VehicleId;
use skein_common::message::{SimulatorFault, Standstill};
use skein_common::time::PlantTime;

/// Positions of the pilot's controls. The same numbers drive the built-in helicopter and X-Plane's overrides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Controls {
    /// Lateral cyclic, −1 to 1, positive rolls right.
    pub roll: f64,
    /// Longitudinal cyclic, −1 to 1, positive lifts the nose.
    pub pitch: f64,
    /// Pedals, −1 to 1, positive turns the nose right; commands a yaw rate through the gyro.
    pub yaw: f64,
    /// Collective, 0 to 1, positive climbs.
    pub collective: f64,
}

impl Controls {
    /// These controls, each clamped to its travel.
    #[must_use]
    pub fn clamped(self) -> Self {
        let axis = |value: f64| value.clamp(-1.0, 1.0);
        let (roll, pitch, yaw) = (axis(self.roll), axis(self.pitch), axis(self.yaw));
        Self { roll, pitch, yaw, collective: self.collective.clamp(0.0, 1.0) }
    }

    /// Whether all controls are finite and within their travel.
    pub fn is_within_limits(&self) -> bool {
        let axis = |value: f64| (-1.0..=1.0).contains(&value);
        axis(self.roll) && axis(self.pitch) && axis(self.yaw) && (0.0..=1.0).contains(&self.collective)
    }

    /// Whether a control is at an end of its travel.
    pub fn is_at_a_stop(&self) -> bool {
        let axis = |value: f64| value.abs() >= 1.0;
        axis(self.roll) || axis(self.pitch) || axis(self.yaw) || self.collective <= 0.0 || self.collective >= 1.0
    }
}

/// Velocities for a vehicle that has a velocity controller of its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct VelocityCommand {
    /// Velocity over the ground, north and east, m/s.
    #[serde(with = "crate::encoding::vector")]
    pub velocity_ne_m_s: Vector2<f64>,
    /// Climb rate, m/s, positive up.
    pub climb_m_s: f64,
    /// Heading rate, rad/s, positive clockwise from above.
    pub turn_rad_s: f64,
}

impl VelocityCommand {
    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.velocity_ne_m_s.iter().chain([&self.climb_m_s, &self.turn_rad_s]).all(|number| number.is_finite())
    }
}

/// An agent's command to its plant.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Command {
    /// Positions of a helicopter's controls.
    Controls(Controls),
    /// Velocities of a point mass.
    Velocity(VelocityCommand),
    /// The controls belong to a human pilot until the next other command.
    Release,
}

impl Command {
    /// The controls of a helicopter; `None` if the command is for another vehicle.
    pub fn controls(self) -> Option<Controls> {
        match self {
            Self::Controls(controls) => Some(controls),
            Self::Velocity(_) | Self::Release => None,
        }
    }

    /// The velocities of a point mass; `None` if the command is for another vehicle.
    pub fn velocity(self) -> Option<VelocityCommand> {
        match self {
            Self::Controls(_) | Self::Release => None,
            Self::Velocity(velocity) => Some(velocity),
        }
    }
}

/// The vehicle's sensor readings at one instant. Velocity and heading are local: they refer to the meridian of the measured
/// position.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// Position of the centre of gravity.
    pub position: Geodetic,
    /// Height of the centre of gravity above the ground below it, m.
    pub height_m: f64,
    /// Velocity over the ground, local.
    pub velocity: VelocityNed,
    /// Attitude, with the heading from the local true north.
    pub attitude: Attitude,
    /// Angular velocity.
    pub rates: BodyRates,
    /// Main rotor speed, rad/s, if the plant reports it.
    pub rotor_speed_rad_s: Option<f64>,
}

/// The vehicle's true state in the swarm's frame. For measuring and plotting only: no decision may use it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GroundTruth {
    /// Position of the centre of gravity in the swarm's frame.
    pub position: PositionNed,
    /// Height of the centre of gravity above the ground, m.
    pub height_m: f64,
    /// Velocity over the ground.
    pub velocity: VelocityNed,
    /// Attitude.
    pub attitude: Attitude,
    /// Shaft power, W, if the plant reports it.
    pub power_w: Option<f64>,
}

/// One frame of the simulator, with values of the same instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// The simulator's time of this frame.
    pub time: PlantTime,
    /// The sensor readings.
    pub measurement: Measurement,
    /// The true state.
    pub truth: GroundTruth,
}

/// A plant's report beside its frames, with a frame or without one; by default it reports nothing.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlantStatus {
    /// The reason why the simulator does not simulate the flight, if it does not. A plant that cannot stand still never gives one.
    pub standstill: Option<Standstill>,
    /// Faults of the simulator's set-up, as found at its last start; most plants have none.
    pub faults: Vec<SimulatorFault>,
    /// Present positions of the controls, as the pilot or the agent has set them, if the plant reports them. The agent begins
    /// with them when it takes the controls back from a human pilot.
    pub controls: Option<Controls>,
    /// Whether a human pilot has moved the stick so far that the scenario gives the pilot the controls. The vehicle is then
    /// released as by an order, until an order that names it takes the controls back.
    pub pilot_takes_over: bool,
}

/// A plant's delivery when it wakes its agent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Wake {
    /// The new frame; `None` if the deadline passed without one.
    pub frame: Option<Frame>,
    /// The plant's report beside its frames.
    pub status: PlantStatus,
}

/// Pose of a peer, for a simulator that draws it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeerPose {
    /// The peer's id.
    pub id: VehicleId,
    /// Position of its centre of gravity now.
    pub position: Geodetic,
    /// Its attitude, with the heading from the local true north. States carry the heading only, so that roll and pitch are zero.
    pub attitude: Attitude,
    /// Its distance from this vehicle, m: a simulator that can draw a few peers draws the nearest.
    pub distance_m: f64,
}

/// Counts of the data that a plant has dropped since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlantDrops {
    /// Frames that were missed because the agent or the computer was too late for them.
    pub skipped_frames: u64,
    /// Malformed datagrams or messages.
    pub malformed: u64,
    /// Datagrams whose sender is not the simulator.
    pub foreign: u64,
}

/// A vehicle in real time. Only the control thread uses it.
pub trait Plant: Send {
    /// Blocks until the simulator's next frame or until the timeout. Faults of the link (garbage, a simulator that has
    /// gone) are counted and end as a [`Wake`] without a frame, never as a panic.
    fn wait(&mut self, timeout: Duration) -> Wake;

    /// Sets the command; called at most once per frame, never blocks. A command for another kind of vehicle is ignored.
    fn command(&mut self, command: Command);

    /// Returns the control of the vehicle to the simulator.
    fn release(&mut self);

    /// Nominal time between two frames, s.
    fn frame_period_s(&self) -> f64;

    /// Counts of the data dropped so far.
    fn drops(&self) -> PlantDrops {
        PlantDrops::default()
    }

    /// Draws these peers, the nearest ones if they are too many, and no other peers, if the simulator draws any. Called after
    /// [`Self::command`], never blocks.
    fn show_peers(&mut self, _peers: &mut dyn Iterator<Item = PeerPose>) {}
}
