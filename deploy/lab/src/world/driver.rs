//! Drivers decide where the agents of a world run and how a vehicle is connected to its agent.

use std::fmt::Debug;
use std::num::NonZeroUsize;

use skein_common::scenario::Scenario;
use skein_common::time::LocalTime;
use skein_core::agent::Outputs;
use skein_core::aircraft::Aircraft;
use skein_core::formation::Workspace;
use skein_core::formation::external::LawQuery;
use skein_core::outbox::Outbox;
use skein_host::parallel::at_once;

use super::script::ScriptedAction;
use super::vehicle::{Arriving, Vehicle};
use crate::metrics::Totals;

/// Accepts the messages and the query that the agent of a vehicle sends in one step.
pub(super) type TakeOutputs<'a> = dyn FnMut(&mut Vehicle, Outbox, Option<Box<LawQuery>>) + 'a;

/// Steps the agents of a world, one frame at a time.
pub(super) trait Driver: Debug + Send {
    /// The scenario that the agents receive from this driver.
    fn scenario_of_agents(&self, scenario: &Scenario) -> Scenario;

    /// The aircraft data that an agent receives from this driver.
    fn aircraft_of_agents(&self, aircraft: &Aircraft) -> Aircraft;

    /// Whether the agents receive messages now.
    fn agents_receive(&self, now: LocalTime) -> bool;

    /// Takes the next action on all agents that is due at this time after the first take-off, s.
    fn due(&mut self, flown_s: f64) -> Option<ScriptedAction>;

    /// Whether agents may take messages to all vehicles in place, in the frame in which they are delivered.
    fn broadcasts(&self) -> bool;

    /// Simulates the agents' part of one frame: every vehicle is read, every agent that is due steps, and every
    /// vehicle has its controls. The plants move afterwards. `arriving` is for those vehicles that
    /// take it in place.
    fn frame(
        &mut self,
        now: LocalTime,
        arriving: Arriving<'_>,
        vehicles: &mut [Vehicle],
        threads: NonZeroUsize,
        take: &mut TakeOutputs<'_>,
    );

    /// The counters of what crossed the network, from the agents' own counters.
    fn totals(&self, of_agents: Totals) -> Totals;
}

/// The driver with one agent beside each vehicle, connected without delay or loss.
#[derive(Clone, Debug, Default)]
pub(super) struct Decentralised {
    /// One for each thread.
    workspaces: Vec<Workspace>,
}

impl Driver for Decentralised {
    fn scenario_of_agents(&self, scenario: &Scenario) -> Scenario {
        scenario.clone()
    }

    fn aircraft_of_agents(&self, aircraft: &Aircraft) -> Aircraft {
        aircraft.clone()
    }

    fn agents_receive(&self, _: LocalTime) -> bool {
        true
    }

    fn due(&mut self, _: f64) -> Option<ScriptedAction> {
        None
    }

    fn broadcasts(&self) -> bool {
        true
    }

    /// The agents of one frame do not affect each other: their messages arrive in the next. So they may step in several
    /// threads, and their outputs are taken in the order of vehicles.
    fn frame(
        &mut self,
        now: LocalTime,
        arriving: Arriving<'_>,
        vehicles: &mut [Vehicle],
        threads: NonZeroUsize,
        take: &mut TakeOutputs<'_>,
    ) {
        self.workspaces.resize_with(threads.get(), Workspace::default);
        if let [workspace] = self.workspaces.as_mut_slice() {
            for vehicle in vehicles {
                if let Some(Outputs { outbox, ask, .. }) = step(now, vehicle, arriving, workspace) {
                    take(vehicle, outbox, ask);
                }
            }
            return;
        }
        let share = vehicles.len().div_ceil(threads.get());
        let shares = vehicles.chunks_mut(share).zip(&mut self.workspaces);
        let sent = at_once(shares.map(|(vehicles, workspace)| {
            move || vehicles.iter_mut().map(|vehicle| step(now, vehicle, arriving, workspace)).collect::<Vec<_>>()
        }));
        for (vehicle, sent) in vehicles.iter_mut().zip(sent.into_iter().flatten()) {
            if let Some(Outputs { outbox, ask, .. }) = sent {
                take(vehicle, outbox, ask);
            }
        }
    }

    fn totals(&self, of_agents: Totals) -> Totals {
        of_agents
    }
}

/// One frame of a vehicle with the agent beside it: what the agent gives, of which the vehicle has the command.
fn step(now: LocalTime, vehicle: &mut Vehicle, arriving: Arriving<'_>, workspace: &mut Workspace) -> Option<Outputs> {
    let frame = vehicle.frame(now);
    let measurement = (!vehicle.simulator_frozen).then_some(&frame.measurement);
    let outputs = vehicle.step(now, (frame.time, measurement), arriving, workspace);
    if let Some(outputs) = &outputs {
        vehicle.command = outputs.command;
    }
    outputs
}
