//! Checks everything that can prevent a flight, before anything is started or written. `fly`, `study` and `check` all
//! use this module: a scenario that passes `check` can fly, and a scenario that `check` refuses is refused by the
//! others with the same message.

use skein_agent::config::check_live;
use skein_common::scenario::{Scenario, Simulator};
use skein_host::external::protocol::Time;

use skein_cluster::ports::HostPort;
use skein_cluster::simulators;
use skein_lab::error::Error;
use skein_lab::external::Trial;
use skein_lab::prepare;
use skein_lab::scenario::{Ready, ScenarioArgs};

/// A scenario that can fly.
#[derive(Clone, Debug)]
pub struct Prepared {
    /// The aircraft and rules that its flight needs.
    pub ready: Ready,
    /// HOST:PORT of each vehicle's X-Plane, in the order of ids; empty for other plants.
    pub xplanes: Vec<String>,
}

/// Checks that this scenario, as read by [`ScenarioArgs::read`], can fly: that agents of this build support it, that
/// its files exist and are valid, that its external law starts and gets ready, and that its X-Planes answer. One
/// `trial` of an external law can serve several scenarios. `named` are the X-Planes that the command names for a flight in real
/// time: none, that of vehicle 1, or one for each vehicle. Without `named` it flies in virtual time.
///
/// # Errors
/// The first reason why it cannot fly, with its place in the file and a remedy.
pub fn prepare(
    args: &ScenarioArgs,
    scenario: &Scenario,
    named: Option<&[HostPort]>,
    trial: &mut Trial,
) -> Result<Prepared, Error> {
    let refused = |why: String| Error::Refused(format!("{}: {why}", args.name()));
    let time = if named.is_some() { Time::Real } else { Time::Virtual };
    if time == Time::Real {
        check_live(scenario).map_err(|why| refused(why.to_string()))?;
    }
    let flies_in_given = time == Time::Real && scenario.swarm.plant.spec().simulator == Simulator::Given;
    let ready = if flies_in_given {
        let ready = args.ready(scenario)?;
        prepare::try_law(args, scenario, time, trial)?;
        ready
    } else {
        prepare::prepare(args, scenario, time, trial)?
    };
    let named = named.filter(|_| flies_in_given);
    let xplanes = named.map_or_else(|| Ok(Vec::new()), |named| simulators::addresses(scenario, named))?;
    simulators::ask_all(&xplanes)?;
    Ok(Prepared { ready, xplanes })
}

#[cfg(test)]
mod tests;
