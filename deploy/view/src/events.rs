//! The events that the page shows: those of the past at once, then each as it happens.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use serde::{Serialize, Serializer};
use skein_common::id::VehicleName;
use skein_common::message::Severity;
use skein_host::clock;
use skein_lab::record::PlayedEvent;

use super::snapshot::rounded;

/// Largest number of events that are kept of a live swarm.
const MOST_KEPT: usize = 5_000;

/// An event as the page receives it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Event {
    /// Time of the flight, s; `None` if that is not known.
    pub(super) t_s: Option<f64>,
    /// Time of its arrival at this server, ms since 1970; `None` in a recording.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) at_ms: Option<u64>,
    pub(super) vehicle: Option<String>,
    pub(super) text: String,
    #[serde(serialize_with = "as_level")]
    pub(super) level: Severity,
}

/// A severity as the page names it.
fn as_level<S: Serializer>(severity: &Severity, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(match severity {
        Severity::Info => "info",
        Severity::Warning => "warn",
        Severity::Error => "bad",
    })
}

/// A message to the page.
#[derive(Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub(super) enum EventMessage {
    /// The events of the past.
    Events { events: Vec<Event> },
    /// One new event.
    Event(Event),
}

impl EventMessage {
    pub(super) fn to_json(&self) -> String {
        // Structs of numbers and texts always have a JSON form.
        serde_json::to_string(self).unwrap_or_default()
    }
}

impl From<&PlayedEvent> for Event {
    fn from(PlayedEvent { t_s, vehicle, text, severity, .. }: &PlayedEvent) -> Self {
        let vehicle = vehicle.map(|name| name.to_string());
        Self { t_s: Some(rounded(*t_s)), at_ms: None, vehicle, text: text.clone(), level: *severity }
    }
}

/// The events of a live swarm since the server listens.
#[derive(Debug, Default)]
pub(super) struct EventLog(Mutex<Kept>);

#[derive(Debug, Default)]
struct Kept {
    events: VecDeque<LoggedEvent>,
    /// Number of events before the first that is kept.
    before: u64,
}

/// An event of a live swarm as it arrived.
#[derive(Clone, Debug)]
pub(super) struct LoggedEvent {
    at: Instant,
    pub(super) vehicle: VehicleName,
    pub(super) text: String,
    pub(super) severity: Severity,
}

impl EventLog {
    /// Keeps an event that arrived at `at`; the oldest is forgotten when there are too many.
    pub(super) fn add(&self, at: Instant, vehicle: VehicleName, text: String, severity: Severity) {
        let mut kept = self.kept();
        kept.events.push_back(LoggedEvent { at, vehicle, text, severity });
        if kept.events.len() > MOST_KEPT {
            kept.events.pop_front();
            kept.before += 1;
        }
    }

    /// Number of events so far.
    pub(super) fn count(&self) -> u64 {
        let kept = self.kept();
        kept.before + kept.events.len() as u64
    }

    /// The events from the `from`th on, and the number of the next one.
    pub(super) fn logged_since(&self, from: u64) -> (Vec<LoggedEvent>, u64) {
        let kept = self.kept();
        let skipped = usize::try_from(from.saturating_sub(kept.before)).unwrap_or(usize::MAX);
        (kept.events.iter().skip(skipped).cloned().collect(), kept.before + kept.events.len() as u64)
    }

    /// The events from the `from`th on as pages receive them, and the number of the next one; `zero` is when the flight began.
    pub(super) fn since(&self, from: u64, zero: Option<Instant>) -> (Vec<Event>, u64) {
        let (events, next) = self.logged_since(from);
        let t_s = |at: Instant| {
            let zero = zero?;
            Some(match at.checked_duration_since(zero) {
                Some(after) => after.as_secs_f64(),
                None => -zero.saturating_duration_since(at).as_secs_f64(),
            })
        };
        let (now, utc_ms) = (clock::now(), clock::utc_nanoseconds() / 1_000_000);
        let at_ms = |at: Instant| {
            let ago_ms = now.saturating_duration_since(at).as_millis();
            utc_ms.saturating_sub(u64::try_from(ago_ms).unwrap_or(u64::MAX))
        };
        let shown = |LoggedEvent { at, vehicle, text, severity }| Event {
            t_s: t_s(at).map(rounded),
            at_ms: Some(at_ms(at)),
            vehicle: Some(vehicle.to_string()),
            text,
            level: severity,
        };
        (events.into_iter().map(shown).collect(), next)
    }

    /// No holder can panic, so poisoning is ignored.
    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use skein_common::id::VehicleId;

    use super::*;

    #[test]
    fn an_event_before_the_flight_time_is_known_has_the_time_of_its_arrival() {
        let log = EventLog::default();
        let before = clock::now() - Duration::from_secs(60);
        let name = VehicleName::from(VehicleId::new(1).unwrap());
        log.add(before, name, "at altitude".to_owned(), Severity::Info);
        let now_ms = clock::utc_nanoseconds() / 1_000_000;
        let (events, next) = log.since(0, None);
        let at_ms = events[0].at_ms.unwrap();
        assert_eq!((next, events[0].t_s), (1, None));
        assert!((now_ms - 30_000..now_ms + 30_000).contains(&(at_ms + 60_000)), "{at_ms} {now_ms}");
        let (events, _) = log.since(0, Some(before - Duration::from_secs(5)));
        assert_eq!(events[0].t_s, Some(5.0));
    }
}
