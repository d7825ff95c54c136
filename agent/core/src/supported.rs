//! What of a scenario is flown today. A scenario that asks for more is refused in one clear sentence: flying something
//! else in its place would be worse than not flying.

use alloc::borrow::ToOwned;
use alloc::format;
use alloc::string::String;

use skein_common::scenario::{ControlMode, Scenario};

use crate::formation::Formation;

/// A scenario that asks for what is not flown, in a sentence.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct NotFlown(pub String);

impl NotFlown {
    /// There is no such thing yet.
    pub fn yet(what: &str) -> Self {
        Self(format!("{what} is not flown yet"))
    }
}

/// Refuses a scenario that asks for what is not flown in real time.
///
/// # Errors
/// The first such thing, by name.
pub fn check_live(scenario: &Scenario) -> Result<(), NotFlown> {
    if scenario.control.mode == ControlMode::Central {
        return Err(NotFlown("control.mode = \"central\" is flown only in a study".to_owned()));
    }
    check(scenario)
}

/// Refuses a scenario that asks for what is not flown at all.
///
/// # Errors
/// The first such thing, by name.
pub fn check(scenario: &Scenario) -> Result<(), NotFlown> {
    let refused = [(scenario.network.state_json_hz > 0.0, "network.state_json_hz")];
    match refused.iter().find(|(asked, _)| *asked) {
        Some((_, what)) => Err(NotFlown::yet(what)),
        // Whoever makes a law knows its parameters.
        None => scenario.ids().try_for_each(|id| Formation::new(id, scenario).map(drop)),
    }
}
