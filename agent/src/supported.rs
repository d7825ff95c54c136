//! What of a scenario is flown today. A scenario that asks for more is refused in one clear sentence: flying something
//! else in its place would be worse than not flying.

use nalgebra::Vector2;
use skein_common::scenario::{ControlMode, Graph, Law, Scenario, Target, Vertical};

use crate::mission::Goal;

/// A scenario that asks for what is not flown yet.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0} is not flown yet")]
pub struct NotFlown(pub String);

/// The one place that the swarm of this scenario goes to.
pub fn goal(scenario: &Scenario) -> Result<Goal, NotFlown> {
    let formation = &scenario.formation;
    let network = &scenario.network;
    let refused = [
        (formation.law != Law::Ring, "a formation.law other than \"ring\""),
        (formation.vertical != Vertical::Bands || formation.band_step_m != 0.0, "a formation with different heights"),
        (scenario.control.mode != ControlMode::Each, "control.mode = \"central\""),
        (!scenario.mission.events.is_empty(), "a mission with events"),
        (network.loss > 0.0 || network.delay_s > 0.0 || network.jitter_s > 0.0, "an imperfect network"),
        (network.range_m.is_some() || network.graph != Graph::All, "a network in which not everybody hears everybody"),
        (network.state_json_hz > 0.0, "network.state_json_hz"),
    ];
    if let Some((_, what)) = refused.iter().find(|(asked, _)| *asked) {
        return Err(NotFlown((*what).to_owned()));
    }
    match scenario.mission.steps.as_slice() {
        [step] => match step.target {
            Target::Centre(centre_ne_m) if step.formation == *formation => {
                Ok(Goal { centre_ne_m: Vector2::from(centre_ne_m), altitude_m: formation.altitude_m })
            }
            _ => Err(NotFlown("a mission other than one centre in the scenario's formation".to_owned())),
        },
        _ => Err(NotFlown("a mission of several steps".to_owned())),
    }
}
