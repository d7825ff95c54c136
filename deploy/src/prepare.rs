//! Everything that can stand between a scenario and its flight, looked at before anything is started or written. `fly`, `study`
//! and `check` all come through here: what `check` passes, flies, and what it refuses is refused with the same sentence.

use skein_agent::config::check_live;
use skein_common::scenario::{PlantKind, Scenario};
use skein_host::external::protocol::Time;

use crate::simulators::{self, HostPort};
use skein_lab::error::Error;
use skein_lab::external::Trial;
use skein_lab::prepare;
use skein_lab::scenario::{Ready, ScenarioArgs};

/// Where a scenario is to fly.
#[derive(Clone, Copy, Debug)]
pub enum Target<'a> {
    /// In real time on this PC.
    Fly {
        /// The X-Plane of vehicle 1, if the command names it.
        xplane: Option<&'a HostPort>,
    },
    /// In virtual time.
    Study,
}

/// A scenario that may fly.
#[derive(Clone, Debug)]
pub struct Prepared {
    /// What its flight begins with.
    pub ready: Ready,
    /// HOST:PORT of each vehicle's X-Plane, in the order of ids; empty for other plants.
    pub xplanes: Vec<String>,
}

/// Makes sure that this scenario, as [`ScenarioArgs::read`] gave it, can fly: that agents of this build fly it, that its files
/// are there and right, that its external law starts and gets ready, and that its X-Planes answer. A `trial` may serve several
/// scenarios.
///
/// # Errors
/// The first thing that stands against it, with its place and a remedy.
pub fn prepare(
    args: &ScenarioArgs,
    scenario: &Scenario,
    target: Target<'_>,
    trial: &mut Trial,
) -> Result<Prepared, Error> {
    let refused = |why: String| Error::Refused(format!("{}: {why}", args.name()));
    let time = match target {
        Target::Fly { .. } => Time::Real,
        Target::Study => Time::Virtual,
    };
    if time == Time::Real {
        check_live(scenario).map_err(|why| refused(why.to_string()))?;
    }
    let flies_in_xplane = time == Time::Real && scenario.swarm.plant == PlantKind::Xplane;
    let ready = if flies_in_xplane {
        let ready = args.ready(scenario)?;
        prepare::try_law(args, scenario, time, trial)?;
        ready
    } else {
        prepare::prepare(args, scenario, time, trial)?
    };
    let xplanes = match target {
        Target::Fly { xplane } if flies_in_xplane => simulators::addresses(scenario, xplane)?,
        Target::Fly { .. } | Target::Study => Vec::new(),
    };
    simulators::ask_all(&xplanes)?;
    Ok(Prepared { ready, xplanes })
}

#[cfg(test)]
mod tests;
