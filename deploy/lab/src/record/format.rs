//! The format of recordings, for writer and reader: topics, JSON messages and metadata records.

use std::borrow::Cow;
use std::collections::BTreeMap;

use mcap::records::Metadata;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use skein_common::hash::{FNV_1A_START, fnv_1a};
use skein_common::id::{Incarnation, VehicleId};
use skein_common::message::EventKind;

use crate::faults::InjectedFault;
use crate::recording::Lacks;

/// Version of the format; a change that older programs cannot read increases it.
pub(super) const FORMAT: &str = "1";

/// Name of the metadata record with the scenario and the program.
pub(super) const RUN: &str = "skein.run";
/// Name of the metadata record with the log time at which the figures' window begins.
pub(super) const BEGINS: &str = "skein.window_begins";
/// Name of the metadata record with the log time at which the figures' window ends.
pub(super) const ENDS: &str = "skein.window_ends";
/// Name of the metadata record with the counts of what could not be recorded.
pub(super) const RECORDER: &str = "skein.recorder";
/// Name of the metadata record in a repaired or merged recording that lacks damaged records from outside chunks.
pub(super) const DAMAGED: &str = "skein.damaged";
/// Name of the metadata record in a repaired or merged recording with what the files lack from which it was made.
pub(super) const LACKS: &str = "skein.lacks";
/// Its key for the number of damaged pieces.
pub(super) const PIECES: &str = "pieces";
/// Its key for a file that was cut off.
pub(super) const CUT: &str = "cut";
/// Key of the log time in the records of the window.
pub(super) const LOG_TIME: &str = "log_time_ns";
/// Key of the checksum in each metadata record.
pub(super) const CHECKSUM: &str = "skein.checksum";
/// Name of the attachment with the complete scenario.
pub(super) const SCENARIO: &str = "scenario.toml";

pub(super) const EVENTS: &str = "/events";
pub(super) const FAULTS: &str = "/faults";
pub(super) const TRANSFORMS: &str = "/tf";
pub(super) const VEHICLES: &str = "/scene/vehicles";
pub(super) const FORMATION: &str = "/scene/formation";
pub(super) const LOG: &str = "/log";

/// Adds what this metadata record says is missing.
pub(super) fn add_lacks(lacks: &mut Lacks, Metadata { name, metadata }: &Metadata) {
    let count = |key: &str| metadata.get(key).and_then(|number| number.parse::<u64>().ok()).unwrap_or(0);
    match name.as_str() {
        LACKS => {
            lacks.end |= metadata.get(CUT).is_some_and(|cut| cut == "true");
            lacks.pieces += count(PIECES) as usize;
        }
        RECORDER => lacks.unrecorded += count("dropped") + count("refused_steps"),
        _ => {}
    }
}

/// Makes a metadata record with its checksum.
pub(super) fn record(name: &str, mut metadata: BTreeMap<String, String>) -> Metadata {
    metadata.insert(CHECKSUM.to_owned(), checksum(name, &metadata));
    Metadata { name: name.to_owned(), metadata }
}

/// Whether the checksum of a record is right; `None` if it has none.
pub(super) fn is_intact(record: &Metadata) -> Option<bool> {
    let stated = record.metadata.get(CHECKSUM)?;
    Some(*stated == checksum(&record.name, &record.metadata))
}

/// FNV-1a over the name and all entries except the checksum, each with its length.
fn checksum(name: &str, entries: &BTreeMap<String, String>) -> String {
    let entries = entries.iter().filter(|(key, _)| *key != CHECKSUM);
    let texts = [name].into_iter().chain(entries.flat_map(|(key, value)| [key.as_str(), value.as_str()]));
    let with_length = |hash, text: &str| fnv_1a(text.as_bytes(), fnv_1a(&(text.len() as u64).to_le_bytes(), hash));
    let hash = texts.fold(FNV_1A_START, with_length);
    format!("{hash:016x}")
}

pub(super) fn trace_topic(id: VehicleId) -> String {
    format!("/vehicle/{id}/trace")
}

pub(super) fn location_topic(id: VehicleId) -> String {
    format!("/vehicle/{id}/location")
}

/// The vehicle whose traces are on this topic; `None` for any other topic.
pub(super) fn traced(topic: &str) -> Option<VehicleId> {
    topic.strip_prefix("/vehicle/")?.strip_suffix("/trace")?.parse().ok()
}

/// An event that a vehicle reported of itself: a message on `/events`.
#[derive(Debug, Serialize, Deserialize, JsonSchema)]
pub(super) struct EventLine<'a> {
    /// The vehicle that reports the event.
    pub(super) vehicle: VehicleId,
    /// Incarnation of its agent: a restarted agent has a larger one; null in virtual time.
    pub(super) incarnation: Option<Incarnation>,
    /// Number of the event, which grows with every event of the incarnation; null in virtual time.
    pub(super) sequence: Option<u64>,
    /// The event as text.
    pub(super) text: Cow<'a, str>,
    /// The event as data: a name, or a name with its values.
    pub(super) what: EventKind,
}

/// A fault that was injected into the swarm: a message on `/faults`.
#[derive(Debug, Serialize, Deserialize, JsonSchema)]
pub(super) struct FaultLine<'a> {
    /// The vehicle that the fault affects; null if it affects links.
    pub(super) vehicle: Option<VehicleId>,
    /// The fault as text.
    pub(super) text: Cow<'a, str>,
    /// The fault as data: a name, or a name with its values.
    pub(super) what: Cow<'a, InjectedFault>,
}

/// Log time of the instant `t_s` seconds after log time `zero_ns`, ns.
pub(crate) fn log_time_ns(zero_ns: u64, t_s: f64) -> u64 {
    zero_ns.saturating_add_signed((t_s * 1e9).round() as i64)
}

/// Time from `zero_ns` to a log time, s; negative if the log time is before.
pub(super) fn seconds_since(zero_ns: u64, log_time_ns: u64) -> f64 {
    // A division gives the number nearest to the decimal value; a multiplication would not.
    log_time_ns.wrapping_sub(zero_ns) as i64 as f64 / 1e9
}

/// The vehicle that a fault affects; `None` if it affects links.
pub(super) fn vehicle_of(fault: &InjectedFault) -> Option<VehicleId> {
    match fault {
        InjectedFault::Died(id) | InjectedFault::Restarted(id) | InjectedFault::Failed(id, _) => Some(*id),
        InjectedFault::Cut { .. }
        | InjectedFault::Healed { .. }
        | InjectedFault::Delayed { .. }
        | InjectedFault::DelayOver { .. } => None,
    }
}
