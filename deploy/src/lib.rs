//! The operator's and researcher's command: flies a swarm on this PC, studies it in virtual time, looks at it. It is never
//! in the loop: kill it and the swarm flies on.

pub mod metrics;
pub mod study;

use serde::Serialize;

/// A file's worth of JSON.
pub fn json(value: &impl Serialize) -> String {
    // Our reports are structs of numbers and texts, whose keys are texts.
    #[expect(clippy::expect_used, reason = "a report always has a JSON form")]
    let text = serde_json::to_string_pretty(value).expect("a report is JSON");
    text + "\n"
}
