//! What of a scenario is flown today. A scenario that asks for more is refused in one clear sentence: flying something
//! else in its place would be worse than not flying.

use skein_common::scenario::{ControlMode, Graph, Law, Scenario};

/// A scenario that asks for what is not flown yet.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0} is not flown yet")]
pub struct NotFlown(pub String);

/// Refuses a scenario that asks for what is not flown.
///
/// # Errors
/// The first such thing, by name.
pub fn check(scenario: &Scenario) -> Result<(), NotFlown> {
    let network = &scenario.network;
    let flown = |law| matches!(law, Law::Ring | Law::Flock | Law::VirtualStructure);
    let mut laws = scenario.mission.steps.iter().map(|step| step.formation.law);
    let refused = [
        (!laws.all(flown), "a formation.law other than \"ring\", \"flock\" and \"virtual-structure\""),
        (scenario.control.mode != ControlMode::Each, "control.mode = \"central\""),
        (network.jitter_s > 0.0, "network.jitter_s"),
        (network.range_m.is_some() || network.graph != Graph::All, "a network in which not everybody hears everybody"),
        (network.state_json_hz > 0.0, "network.state_json_hz"),
    ];
    match refused.iter().find(|(asked, _)| *asked) {
        Some((_, what)) => Err(NotFlown((*what).to_owned())),
        None => Ok(()),
    }
}
