//! Checks that a scenario can fly, before a command starts or writes anything.
//!
//! Every command uses these checks, so every command refuses the same scenario with the same sentence.

use skein_common::scenario::{ModelKind, Scenario};
use skein_host::external::is_external;
use skein_host::external::protocol::Time;

use crate::error::Error;
use crate::external::{LawError, Trial};
use crate::scenario::{Ready, ScenarioArgs};

/// Checks that a scenario from [`ScenarioArgs::read`] can fly on the built-in plant, in virtual or real time.
///
/// This build must support the scenario, its files must exist and be valid, every helicopter needs a flight model, and its
/// external law must start and report that it is ready. One `trial` may serve several scenarios.
///
/// # Errors
/// The first obstacle, with its place and a remedy.
pub fn prepare(args: &ScenarioArgs, scenario: &Scenario, time: Time, trial: &mut Trial) -> Result<Ready, Error> {
    let ready = args.ready(scenario)?;
    let is_helicopter = scenario.plant.model == ModelKind::Helicopter;
    let mut vehicles = scenario.vehicle.iter().zip(&ready.aircraft);
    if let Some((vehicle, _)) = vehicles.find(|(_, aircraft)| is_helicopter && aircraft.helicopter.is_none()) {
        let (id, name) = (vehicle.id, &vehicle.aircraft);
        return Err(Error::Refused(format!(
            "{}: vehicle {id}: only X-Plane can fly the aircraft \"{name}\": {name}.toml has no [helicopter] table",
            args.name()
        )));
    }
    try_law(args, scenario, time, trial)?;
    Ok(ready)
}

/// Checks that the scenario's external law, if it has one, starts and reports that it is ready.
///
/// # Errors
/// Why the law cannot be used, with the command to try.
pub fn try_law(args: &ScenarioArgs, scenario: &Scenario, time: Time, trial: &mut Trial) -> Result<(), Error> {
    let tried = trial.check(scenario, time);
    tried.map_err(|error| Error::Refused(format!("{}: {}", args.name(), law_error_text(scenario, &error))))
}

/// The error text of a law that was started, with the command that started it.
fn law_error_text(scenario: &Scenario, error: &LawError) -> String {
    let command = scenario.formation.external.command.as_deref().filter(|_| is_external(scenario));
    match (error, command) {
        (LawError::Ended(..) | LawError::Silent { .. }, Some(command)) => {
            format!("formation.external.command: {error}; does `{}` run by itself?", command.join(" "))
        }
        _ => error.to_string(),
    }
}
