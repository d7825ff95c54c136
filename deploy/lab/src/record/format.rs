//! What writer and reader agree on: topics, the JSON of our own channels, the metadata records.

use std::borrow::Cow;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use skein_common::id::{Incarnation, VehicleId};
use skein_common::message::Happening;

use crate::faults::Incident;

/// Of the whole; a change that older programs cannot read counts it up.
pub(super) const FORMAT: &str = "1";

/// Metadata record: what flew, in which program.
pub(super) const RUN: &str = "skein.run";
/// Metadata record: the log time at which the window of the figures begins.
pub(super) const BEGINS: &str = "skein.window_begins";
/// Metadata record: the log time at which it ends.
pub(super) const ENDS: &str = "skein.window_ends";
/// Metadata record: what could not be recorded.
pub(super) const RECORDER: &str = "skein.recorder";
/// Key of the log time in the records of the window.
pub(super) const LOG_TIME: &str = "log_time_ns";
/// Attachment: the complete scenario.
pub(super) const SCENARIO: &str = "scenario.toml";

pub(super) const EVENTS: &str = "/events";
pub(super) const FAULTS: &str = "/faults";
pub(super) const TRANSFORMS: &str = "/tf";
pub(super) const VEHICLES: &str = "/scene/vehicles";
pub(super) const FORMATION: &str = "/scene/formation";
pub(super) const LOG: &str = "/log";

pub(super) fn trace_topic(id: VehicleId) -> String {
    format!("/vehicle/{id}/trace")
}

pub(super) fn location_topic(id: VehicleId) -> String {
    format!("/vehicle/{id}/location")
}

/// Whose trace this topic holds.
pub(super) fn traced(topic: &str) -> Option<VehicleId> {
    topic.strip_prefix("/vehicle/")?.strip_suffix("/trace")?.parse().ok()
}

/// What a vehicle reported of itself: a message on `/events`.
#[derive(Debug, Serialize, Deserialize, JsonSchema)]
pub(super) struct EventLine<'a> {
    /// The vehicle that reports it.
    pub(super) vehicle: VehicleId,
    /// The life of its agent: a restarted agent has a larger one; null in virtual time.
    pub(super) incarnation: Option<Incarnation>,
    /// Grows with every event of that life; null in virtual time.
    pub(super) sequence: Option<u64>,
    /// As people read it.
    pub(super) text: Cow<'a, str>,
    /// As programs read it: a name, or a name with its values.
    pub(super) what: Happening,
}

/// What was done to the swarm: a message on `/faults`.
#[derive(Debug, Serialize, Deserialize, JsonSchema)]
pub(super) struct FaultLine<'a> {
    /// The vehicle that it was done to; null if it was done to links.
    pub(super) vehicle: Option<VehicleId>,
    /// As people read it.
    pub(super) text: Cow<'a, str>,
    /// As programs read it: a name, or a name with its values.
    pub(super) what: Cow<'a, Incident>,
}

/// Log time of an instant `t_s` after log time `zero_ns`.
pub(crate) fn log_time_ns(zero_ns: u64, t_s: f64) -> u64 {
    zero_ns.saturating_add_signed((t_s * 1e9).round() as i64)
}

/// Seconds from `zero_ns` to a log time; negative before.
pub(super) fn seconds_since(zero_ns: u64, log_time_ns: u64) -> f64 {
    // Divided, not multiplied: the nearest number to what the decimal says.
    log_time_ns.wrapping_sub(zero_ns) as i64 as f64 / 1e9
}

/// A choice as the JSON has it.
pub(super) fn spelling(choice: &impl Serialize) -> String {
    match serde_json::to_value(choice) {
        Ok(serde_json::Value::String(text)) => text,
        _ => String::new(),
    }
}

/// To which vehicle it is done, if to one.
pub(super) fn vehicle_of(incident: &Incident) -> Option<VehicleId> {
    match incident {
        Incident::Died(id) | Incident::Restarted(id) | Incident::Failed(id, _) => Some(*id),
        Incident::Cut { .. } | Incident::Healed { .. } | Incident::Delayed { .. } | Incident::DelayOver { .. } => None,
    }
}
