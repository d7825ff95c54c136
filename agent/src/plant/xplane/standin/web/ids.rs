//! Datarefs and commands by the numbers that clients send.

use super::{Fault, Shared};
use crate::plant::xplane::server::{COMMANDS, Dataref};

/// The dataref with this number.
pub(super) fn dataref_of(shared: &Shared, id: u64) -> Result<(usize, &'static Dataref), Fault> {
    let at = id.checked_sub(shared.first_id()).and_then(|at| usize::try_from(at).ok());
    at.and_then(|at| Dataref::all().get(at).map(|dataref| (at, dataref)))
        .ok_or_else(|| Fault::missing("invalid_dataref_id", format!("Dataref {id} doesn't exist")))
}

/// The position of the command with this number.
pub(super) fn command_of(shared: &Shared, id: u64) -> Result<usize, Fault> {
    let at = id.checked_sub(shared.command_id(0)).and_then(|at| usize::try_from(at).ok());
    at.filter(|&at| at < COMMANDS.len())
        .ok_or_else(|| Fault::missing("invalid_command_id", format!("Command {id} doesn't exist")))
}
