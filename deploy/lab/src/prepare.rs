//! Checks that a scenario can fly, before a command starts or writes anything.
//!
//! Every command uses these checks, so every command refuses the same scenario with the same sentence.

use std::collections::BTreeMap;

use skein_common::scenario::{ModelKind, Rules, Scenario};
use skein_core::aircraft::Aircraft;
use skein_core::hover::{self, Hover};
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
    if let Some(why) = unfit_rules(scenario, &ready) {
        return Err(Error::Refused(format!("{}: control.rules: {why}", args.name())));
    }
    try_law(args, scenario, time, trial)?;
    Ok(ready)
}

/// A hover of each aircraft of a scenario that has its own rules, which prevents nothing if it holds.
#[derive(Clone, Debug)]
pub struct RulesTried {
    /// Name of the aircraft.
    pub aircraft: String,
    /// With all four rule bases of the scenario.
    pub all: Hover,
    /// With that of one axis, and the shipped ones for the others.
    pub each: [Hover; 4],
}

/// Flies the hovers; empty with the shipped rules, and for aircraft without a flight model.
pub fn try_rules(scenario: &Scenario, ready: &Ready) -> Vec<RulesTried> {
    let auto_trim = scenario.control.auto_trim;
    let tried = |(name, aircraft): (&String, &Aircraft)| {
        Some(RulesTried {
            aircraft: name.clone(),
            all: hover::hover(aircraft, &ready.rules, auto_trim)?,
            each: hover::of_each_axis(aircraft, &ready.rules, auto_trim)?,
        })
    };
    own_rules(scenario, ready).filter_map(tried).collect()
}

/// The different aircraft of a scenario with its own rules.
fn own_rules<'a>(scenario: &'a Scenario, ready: &'a Ready) -> impl Iterator<Item = (&'a String, &'a Aircraft)> {
    let has_own = matches!(scenario.control.rules, Rules::Folder(_)) && scenario.plant.model == ModelKind::Helicopter;
    let all = scenario.vehicle.iter().map(|vehicle| &vehicle.aircraft).zip(&ready.aircraft).filter(move |_| has_own);
    all.collect::<BTreeMap<_, _>>().into_iter()
}

/// The reason why the scenario's own rules cannot fly one of its aircraft, with the file at fault; `None` without such a fault.
fn unfit_rules(scenario: &Scenario, ready: &Ready) -> Option<String> {
    let auto_trim = scenario.control.auto_trim;
    let mut faults = own_rules(scenario, ready).filter_map(|(name, aircraft)| {
        let fault = hover::hover(aircraft, &ready.rules, auto_trim)?.fault()?;
        let each = hover::of_each_axis(aircraft, &ready.rules, auto_trim)?;
        let files = hover::AXES.iter().zip(each).filter(|(_, hover)| hover.fault().is_some());
        let files: Vec<String> = files.map(|(axis, _)| format!("{axis}.fis")).collect();
        let files = if files.is_empty() { "all four together".to_owned() } else { files.join(", ") };
        Some(format!(
            "a hover of the aircraft \"{name}\" with these rules does not hold: {fault}; at fault: {files}. `skein check` prints the \
             figures of each file"
        ))
    });
    faults.next()
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
