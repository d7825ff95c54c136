//! The control stage: the vehicle's controller, that of a helicopter or that of a point mass.

use alloc::boxed::Box;

use skein_common::scenario::{CommandKind, Scenario};

use super::{ControlFault, ControlOutput, Gains, Rules, Trim, VehicleController, VelocityController};
use crate::estimate::Estimate;
use crate::plant::{Command, Controls};
use crate::setpoint::{CollectiveLimit, Setpoint};

/// The controller of a vehicle, for the kind of command that its plant takes.
#[derive(Clone, Debug)]
pub enum Controller {
    /// Gives the controls of a helicopter.
    Helicopter(Box<VehicleController>),
    /// Gives the velocities of a point mass.
    PointMass(VelocityController),
}

impl Controller {
    /// A controller that has not commanded anything yet. `rules`, `trim` and `gains` are those of a helicopter.
    pub fn new(scenario: &Scenario, rules: Rules, trim: Trim, gains: Gains) -> Self {
        match scenario.swarm.plant.spec().command_for(scenario.plant.model) {
            Some(CommandKind::Controls) | None => {
                Self::Helicopter(Box::new(VehicleController::new(rules, trim, gains, scenario.control.auto_trim)))
            }
            Some(CommandKind::Velocities) => Self::PointMass(VelocityController::default()),
        }
    }

    /// Flies the setpoint; see [`VehicleController::step`] and [`VelocityController::step`]. Returns the command, always finite
    /// and for the controller's kind of vehicle, and the reason why it repeats the last good command; `None` for a new command.
    pub fn step(&mut self, dt_s: f64, estimate: &Estimate, setpoint: &Setpoint) -> (Command, Option<ControlFault>) {
        match self {
            Self::Helicopter(controller) => of_helicopter(controller.step(dt_s, estimate, setpoint)),
            Self::PointMass(controller) => {
                let (command, fault) = controller.step(dt_s, estimate, setpoint);
                (Command::Velocity(command), fault)
            }
        }
    }

    /// Flies the setpoint with full pedal ([`VehicleController::turn`]). A point mass has no servo that could be stuck
    /// and flies the setpoint.
    pub fn turn(&mut self, dt_s: f64, estimate: &Estimate, setpoint: &Setpoint) -> (Command, Option<ControlFault>) {
        match self {
            Self::Helicopter(controller) => of_helicopter(controller.turn(dt_s, estimate, setpoint)),
            Self::PointMass(_) => self.step(dt_s, estimate, setpoint),
        }
    }

    /// Descends without power: [`VehicleController::autorotate`]. A point mass sinks on the spot.
    pub fn autorotate(&mut self, dt_s: f64, estimate: &Estimate, heading_rad: f64) -> (Command, Option<ControlFault>) {
        match self {
            Self::Helicopter(controller) => of_helicopter(controller.autorotate(dt_s, estimate, heading_rad)),
            Self::PointMass(controller) => (Command::Velocity(controller.sink()), None),
        }
    }

    /// Rests on the ground: [`VehicleController::unload`], or no velocity.
    pub fn park(&mut self, dt_s: f64) -> Command {
        match self {
            Self::Helicopter(controller) => Command::Controls(controller.unload(dt_s)),
            Self::PointMass(controller) => Command::Velocity(controller.stop()),
        }
    }

    /// Takes the vehicle over from a human pilot. The controls are in these positions ([`VehicleController::take_over`]).
    /// A point mass flies at its limits of acceleration in any case.
    pub fn take_over(&mut self, controls: Option<Controls>) {
        match self {
            Self::Helicopter(controller) => controller.take_over(controls),
            Self::PointMass(_) => {}
        }
    }

    /// The command of a vehicle without own data: [`VehicleController::neutral`], or no velocity.
    pub fn neutral(&mut self) -> Command {
        match self {
            Self::Helicopter(controller) => Command::Controls(controller.neutral()),
            Self::PointMass(controller) => Command::Velocity(controller.stop()),
        }
    }

    /// The limit of the climb authority at the last step, if it was at one. A point mass always follows.
    pub fn collective_limit(&self) -> Option<CollectiveLimit> {
        match self {
            Self::Helicopter(controller) => controller.collective_limit,
            Self::PointMass(_) => None,
        }
    }
}

fn of_helicopter(ControlOutput { controls, fault }: ControlOutput) -> (Command, Option<ControlFault>) {
    (Command::Controls(controls), fault)
}
