//! The events that the page shows: those of the past at once, then each as it happens.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use serde::Serialize;
use skein_common::id::VehicleName;
use skein_common::message::EventKind;
use skein_lab::record::PlayedEvent;

use super::snapshot::rounded;

/// Largest number of events that are kept of a live swarm.
const MOST_KEPT: usize = 5_000;

/// How bad an event is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum EventLevel {
    Info,
    Warn,
    Bad,
}

/// An event as the page receives it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Event {
    pub(super) t_s: Option<f64>,
    pub(super) vehicle: Option<String>,
    pub(super) text: String,
    pub(super) level: EventLevel,
}

/// The message with the events of the past.
#[derive(Serialize)]
#[serde(tag = "type", rename = "events")]
struct Past {
    events: Vec<Event>,
}

/// The message with one event.
#[derive(Serialize)]
#[serde(tag = "type", rename = "event")]
struct News {
    #[serde(flatten)]
    event: Event,
}

/// The message with events of the past.
pub(super) fn past(events: Vec<Event>) -> String {
    // Structs of numbers and texts always have a JSON form.
    serde_json::to_string(&Past { events }).unwrap_or_default()
}

/// The message with one new event.
pub(super) fn news(event: Event) -> String {
    serde_json::to_string(&News { event }).unwrap_or_default()
}

impl From<&PlayedEvent> for Event {
    fn from(PlayedEvent { t_s, vehicle, text, what, is_fault }: &PlayedEvent) -> Self {
        let level = if *is_fault { EventLevel::Bad } else { what.as_ref().map_or(EventLevel::Info, level) };
        Self { t_s: Some(rounded(*t_s)), vehicle: vehicle.map(|name| name.to_string()), text: text.clone(), level }
    }
}

/// How bad it is that this happens to a vehicle.
pub(super) fn level(what: &EventKind) -> EventLevel {
    match what {
        EventKind::PeerLost(_)
        | EventKind::PlanDiffers(_)
        | EventKind::AllPeersLost
        | EventKind::ForcedAdvance { .. }
        | EventKind::Skipped { .. }
        | EventKind::QuorumLost
        | EventKind::ClockJumped
        | EventKind::SimulatorStopped(_)
        | EventKind::SimulatorFault(_)
        | EventKind::LawLost
        | EventKind::SettingRefused(_)
        | EventKind::LandingWaits
        | EventKind::FrameRate(_) => EventLevel::Warn,
        EventKind::Failed(_) | EventKind::OwnDataStale | EventKind::SimulatorLost | EventKind::ControlFault => {
            EventLevel::Bad
        }
        _ => EventLevel::Info,
    }
}

/// The events of a live swarm since the server listens.
#[derive(Debug, Default)]
pub(super) struct EventLog(Mutex<Kept>);

#[derive(Debug, Default)]
struct Kept {
    events: VecDeque<Entry>,
    /// Number of events before the first that is kept.
    before: u64,
}

#[derive(Debug)]
struct Entry {
    at: Instant,
    vehicle: Option<String>,
    text: String,
    level: EventLevel,
}

impl EventLog {
    /// Keeps an event that arrived at `at`; the oldest is forgotten when there are too many.
    pub(super) fn add(&self, at: Instant, vehicle: VehicleName, text: String, level: EventLevel) {
        let mut kept = self.kept();
        kept.events.push_back(Entry { at, vehicle: Some(vehicle.to_string()), text, level });
        if kept.events.len() > MOST_KEPT {
            kept.events.pop_front();
            kept.before += 1;
        }
    }

    /// The events from the `from`th on, and the number of the next one; `zero` is when the flight began.
    pub(super) fn since(&self, from: u64, zero: Option<Instant>) -> (Vec<Event>, u64) {
        let kept = self.kept();
        let skipped = usize::try_from(from.saturating_sub(kept.before)).unwrap_or(usize::MAX);
        let t_s = |at: Instant| {
            let zero = zero?;
            Some(match at.checked_duration_since(zero) {
                Some(after) => after.as_secs_f64(),
                None => -zero.saturating_duration_since(at).as_secs_f64(),
            })
        };
        let shown = |entry: &Entry| Event {
            t_s: t_s(entry.at).map(rounded),
            vehicle: entry.vehicle.clone(),
            text: entry.text.clone(),
            level: entry.level,
        };
        (kept.events.iter().skip(skipped).map(shown).collect(), kept.before + kept.events.len() as u64)
    }

    /// No holder can panic, so poisoning is ignored.
    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
