//! Where the agents of a world run, and what lies between a vehicle and its agent.

use std::fmt::Debug;

use skein_common::scenario::Scenario;
use skein_common::time::LocalTime;
use skein_core::agent::Outputs;
use skein_core::aircraft::Aircraft;
use skein_core::formation::external::Ask;
use skein_core::outbox::Outbox;

use super::script::Deed;
use super::vehicle::Vehicle;
use crate::metrics::Totals;

/// Takes what the agent of a vehicle sends and asks in one step.
pub(super) type Take<'a> = dyn FnMut(&mut Vehicle, Outbox, Option<Ask>) + 'a;

/// Steps the agents and the vehicles of a world, one frame at a time.
pub(super) trait Driver: Debug {
    /// The scenario as the agents fly it here.
    fn as_agents_see_it(&self, scenario: &Scenario) -> Scenario;

    /// The aircraft as an agent knows it here.
    fn as_agents_know_it(&self, aircraft: &Aircraft) -> Aircraft;

    /// Whether the agents take in messages now.
    fn listens(&self, now: LocalTime) -> bool;

    /// What happens next to all agents at once, by this time after the first take-off, s.
    fn due(&mut self, flown_s: f64) -> Option<Deed>;

    /// One frame: every agent that is due steps, every vehicle moves.
    fn frame(&mut self, now: LocalTime, vehicles: &mut [Vehicle], take: &mut Take<'_>);

    /// What crossed the network, made of what the agents have counted.
    fn totals(&self, of_agents: Totals) -> Totals;
}

/// An agent beside each vehicle: nothing lies between the two.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beside;

impl Driver for Beside {
    fn as_agents_see_it(&self, scenario: &Scenario) -> Scenario {
        scenario.clone()
    }

    fn as_agents_know_it(&self, aircraft: &Aircraft) -> Aircraft {
        aircraft.clone()
    }

    fn listens(&self, _: LocalTime) -> bool {
        true
    }

    fn due(&mut self, _: f64) -> Option<Deed> {
        None
    }

    fn frame(&mut self, now: LocalTime, vehicles: &mut [Vehicle], take: &mut Take<'_>) {
        for vehicle in vehicles {
            let (frame, simulator_frozen) = vehicle.frame(now);
            let measurement = (!simulator_frozen).then_some(&frame.measurement);
            let outputs = vehicle.step(now, (frame.time, measurement));
            if let Some(Outputs { command, .. }) = &outputs {
                vehicle.command = *command;
            }
            if !simulator_frozen {
                vehicle.plant.advance(vehicle.command);
            }
            if let Some(Outputs { outbox, ask, .. }) = outputs {
                take(vehicle, outbox, ask);
            }
        }
    }

    fn totals(&self, of_agents: Totals) -> Totals {
        of_agents
    }
}
