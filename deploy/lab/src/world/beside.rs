//! One frame of agents that run beside their vehicles, each connected to its own without delay or loss.

use skein_common::time::LocalTime;
use skein_core::agent::Outputs;
use skein_core::formation::Workspace;
use skein_core::formation::external::LawQuery;
use skein_core::outbox::Outbox;
use skein_host::parallel::at_once;

use super::vehicle::{Arriving, Vehicle};

/// Accepts the messages and the query that the agent of a vehicle sends in one step.
pub(super) type TakeOutputs<'a> = dyn FnMut(&mut Vehicle, Outbox, Option<Box<LawQuery>>) + 'a;

/// Reads every vehicle, steps its agent and gives it the controls, with a thread for each workspace. The plants move
/// afterwards.
///
/// The agents of one frame do not affect each other: their messages arrive in the next. So they may step in several
/// threads, and their outputs are taken in the order of vehicles.
pub(super) fn frame(
    now: LocalTime,
    arriving: Arriving<'_>,
    vehicles: &mut [Vehicle],
    workspaces: &mut [Workspace],
    take: &mut TakeOutputs<'_>,
) {
    if let [workspace] = workspaces {
        for vehicle in vehicles {
            if let Some(Outputs { outbox, ask, .. }) = step(now, vehicle, arriving, workspace) {
                take(vehicle, outbox, ask);
            }
        }
        return;
    }
    let share = vehicles.len().div_ceil(workspaces.len());
    let shares = vehicles.chunks_mut(share).zip(workspaces);
    let sent = at_once(shares.map(|(vehicles, workspace)| {
        move || vehicles.iter_mut().map(|vehicle| step(now, vehicle, arriving, workspace)).collect::<Vec<_>>()
    }));
    for (vehicle, sent) in vehicles.iter_mut().zip(sent.into_iter().flatten()) {
        if let Some(Outputs { outbox, ask, .. }) = sent {
            take(vehicle, outbox, ask);
        }
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
