//! A human pilot of the built-in plant: what flies a vehicle that its agent has released and that no person can fly.

use skein_common::frame::Origin;
use skein_common::scenario::Scenario;

use crate::aircraft::Aircraft;
use crate::control::{Controller, Rules};
use crate::estimate::Estimate;
use crate::helicopter::TICK_S;
use crate::plant::{Command, Frame};
use crate::setpoint::Setpoint;

/// Keeps the velocity and the altitude that the vehicle has when this pilot gets the controls. It moves the controls itself,
/// so that the agent gets them back in other positions than it left them in.
#[derive(Clone, Debug)]
pub struct SimulatedPilot {
    origin: Origin,
    controller: Controller,
    /// The setpoint that it keeps; `None` while the agent has the controls.
    keeps: Option<Setpoint>,
}

impl SimulatedPilot {
    /// The pilot of this aircraft of a scenario, with the rules of a helicopter's controller.
    pub fn new(scenario: &Scenario, aircraft: &Aircraft, rules: &Rules) -> Self {
        Self {
            origin: Origin::new(scenario.origin.geodetic()),
            controller: Controller::new(scenario, rules.clone(), aircraft.trim, aircraft.gains),
            keeps: None,
        }
    }

    /// Returns the command that moves the vehicle in this frame: the agent's, or the pilot's where the agent has released the
    /// vehicle.
    pub fn fly(&mut self, command: Option<Command>, frame: impl FnOnce() -> Frame) -> Option<Command> {
        if command != Some(Command::Release) {
            self.keeps = None;
            return command;
        }
        let estimate = Estimate::of(&frame().measurement, &self.origin);
        let keeps = self.keeps.get_or_insert_with(|| Setpoint {
            relative_velocity_ne_m_s: estimate.velocity.horizontal(),
            feedforward_ne_m_s: Default::default(),
            altitude_m: estimate.position.altitude_m(),
            heading_rad: estimate.attitude.heading_rad,
        });
        let (command, _) = self.controller.step(TICK_S, &estimate, keeps);
        Some(command)
    }
}
