//! Everything that can stand between a scenario and its flight, looked at before anything is started or written: what passes
//! here, flies, and what is refused is refused with the same sentence by every command.

use skein_common::scenario::Scenario;
use skein_host::external::is_external;
use skein_host::external::protocol::Time;

use crate::error::Error;
use crate::external::{LawError, Trial};
use crate::scenario::{Ready, ScenarioArgs};

/// Makes sure that this scenario, as [`ScenarioArgs::read`] gave it, can fly in this kind of time on the built-in helicopter:
/// that this build flies it, that its files are there and right, that every vehicle has a flight model, and that its external
/// law starts and gets ready. A `trial` may serve several scenarios.
///
/// # Errors
/// The first thing that stands against it, with its place and a remedy.
pub fn prepare(args: &ScenarioArgs, scenario: &Scenario, time: Time, trial: &mut Trial) -> Result<Ready, Error> {
    let ready = args.ready(scenario)?;
    let mut vehicles = scenario.vehicle.iter().zip(&ready.aircraft);
    if let Some((vehicle, _)) = vehicles.find(|(_, aircraft)| aircraft.helicopter.is_none()) {
        let (id, name) = (vehicle.id, &vehicle.aircraft);
        return Err(Error::Refused(format!(
            "{}: vehicle {id}: only X-Plane can fly the aircraft \"{name}\": {name}.toml has no [helicopter] table",
            args.name()
        )));
    }
    try_law(args, scenario, time, trial)?;
    Ok(ready)
}

/// Makes sure that the scenario's external law, if it has one, starts and gets ready.
///
/// # Errors
/// What stands against it, with the command to try.
pub fn try_law(args: &ScenarioArgs, scenario: &Scenario, time: Time, trial: &mut Trial) -> Result<(), Error> {
    let tried = trial.of(scenario, time);
    tried.map_err(|error| Error::Refused(format!("{}: {}", args.name(), of_law(scenario, &error))))
}

/// What stands against a law that was started, with its command as it was started.
fn of_law(scenario: &Scenario, error: &LawError) -> String {
    let command = scenario.formation.external.command.as_deref().filter(|_| is_external(scenario));
    match (error, command) {
        (LawError::Ended(..) | LawError::Silent { .. }, Some(command)) => {
            format!("formation.external.command: {error}; does `{}` run by itself?", command.join(" "))
        }
        _ => error.to_string(),
    }
}
