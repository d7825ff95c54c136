//! The events of a flight, for people: equal events of several vehicles are one line that counts up.
//!
//! On a terminal the line changes as vehicles are added. Elsewhere a line is written once its group is complete, or
//! `PARTIAL_AFTER` later with the vehicles that are missing. The recording has every event of every vehicle.

use std::time::{Duration, Instant};

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::EventKind;

use crate::mesh::order::ranges;

/// An incomplete group is written after this time.
const PARTIAL_AFTER: Duration = Duration::from_secs(5);
/// An event that comes so long after the last one of its kind begins a new group.
const NEW_GROUP_AFTER: Duration = Duration::from_secs(60);

/// The events of a flight.
#[derive(Clone, Debug, Default)]
pub struct Journal {
    entries: Vec<Entry>,
}

/// The time of an event: by this process's clock, and in the window of the figures if that has begun, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct When {
    /// By this process's clock.
    pub now: Instant,
    /// In the window of the figures.
    pub window_s: Option<f64>,
}

/// A thing that several vehicles do alike.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Alike {
    /// The text for one vehicle: `takes part`.
    pub one: String,
    /// The text for several: `take part`.
    pub several: String,
    /// Every vehicle does this sooner or later. Otherwise it is news at once, for each vehicle.
    pub by_all: bool,
}

#[derive(Clone, Debug)]
struct Entry {
    began: When,
    what: What,
    /// The instant of the first change that has not been written.
    unwritten: Option<Instant>,
}

#[derive(Clone, Debug)]
enum What {
    Single(String),
    Group { alike: Alike, awaited: VehicleSet, came: VehicleSet, last: When },
}

impl Journal {
    /// Adds an event of no vehicle in particular, or of which each one counts.
    pub fn add(&mut self, when: When, what: String) {
        self.entries.push(Entry { began: when, what: What::Single(what), unwritten: Some(when.now) });
    }

    /// Adds an event of a vehicle to the group of its kind; `awaited` are the vehicles that are expected to follow.
    pub fn add_alike(&mut self, when: When, id: VehicleId, alike: Alike, awaited: VehicleSet) {
        if !alike.by_all {
            self.add(when, format!("vehicle {id}: {}", alike.one));
            return;
        }
        for entry in self.entries.iter_mut().rev() {
            if let What::Group { alike: before, came, last, .. } = &mut entry.what
                && *before == alike
            {
                if came.contains(id) || when.now.saturating_duration_since(last.now) > NEW_GROUP_AFTER {
                    break;
                }
                came.insert(id);
                *last = when;
                entry.unwritten.get_or_insert(when.now);
                return;
            }
        }
        let (mut awaited, mut came) = (awaited, VehicleSet::default());
        awaited.insert(id);
        came.insert(id);
        let what = What::Group { alike, awaited, came, last: when };
        self.entries.push(Entry { began: when, what, unwritten: Some(when.now) });
    }

    /// The newest events, the newest last, at most so many.
    pub fn newest(&self, most: usize) -> Vec<String> {
        self.entries[self.entries.len().saturating_sub(most)..].iter().map(Entry::line).collect()
    }

    /// Whether a line is to be written now.
    pub fn has_news(&self, now: Instant) -> bool {
        self.entries.iter().any(|entry| entry.is_due(now))
    }

    /// The lines that are to be written now; at the `end` whatever is left.
    pub fn take_news(&mut self, now: Instant, end: bool) -> Vec<String> {
        let due = self.entries.iter_mut().filter(|entry| entry.is_due(now) || end && entry.unwritten.is_some());
        due.map(|entry| {
            entry.unwritten = None;
            entry.line()
        })
        .collect()
    }
}

impl Entry {
    fn is_due(&self, now: Instant) -> bool {
        let Some(since) = self.unwritten else { return false };
        match &self.what {
            What::Single(_) => true,
            What::Group { awaited, came, .. } => {
                missing(*awaited, *came).is_empty() || now.saturating_duration_since(since) >= PARTIAL_AFTER
            }
        }
    }

    /// `  16.2 s  8 of 8 at altitude (16.2 to 18.5 s)`
    fn line(&self) -> String {
        let at = self.began.window_s.map_or_else(|| "     -".to_owned(), |window_s| format!("{window_s:6.1}"));
        format!("{at} s  {}", self.text())
    }

    fn text(&self) -> String {
        let (alike, awaited, came, last) = match &self.what {
            What::Single(what) => return what.clone(),
            What::Group { alike, awaited, came, last } => (alike, *awaited, *came, last),
        };
        if let (1, Some(only)) = (came.len(), came.iter().next()) {
            return format!("vehicle {only}: {}", alike.one);
        }
        let missing = missing(awaited, came);
        let of = came.len() + missing.len();
        let mut text = format!("{} of {of} {}", came.len(), alike.several);
        if let (Some(first_s), Some(last_s)) = (self.began.window_s, last.window_s) {
            text += &match format!("{first_s:.1}") == format!("{last_s:.1}") {
                true => format!(" ({first_s:.1} s)"),
                false => format!(" ({first_s:.1} to {last_s:.1} s)"),
            };
        }
        if !missing.is_empty() {
            text += &format!(", missing vehicle {}", ranges(&missing));
        }
        text
    }
}

fn missing(awaited: VehicleSet, came: VehicleSet) -> Vec<VehicleId> {
    awaited.iter().filter(|id| !came.contains(*id)).collect()
}

/// The texts of an event for one vehicle and for several of them.
pub fn alike(what: &EventKind) -> Alike {
    let one = what.to_string();
    let (several, by_all) = match what {
        EventKind::BecameActive => (one.clone(), true),
        EventKind::PeerFound(id) => (format!("in contact with vehicle {id}"), true),
        EventKind::OrderTaken(order) => (format!("accept the order: {order}"), order.vehicles.is_none()),
        EventKind::Advanced(step) => (format!("continue to step {step}"), true),
        EventKind::ForcedAdvance { to, without } => (format!("continue to step {to} without vehicle {without}"), true),
        EventKind::PeerLost(_) | EventKind::Reached(_) | EventKind::AtAltitude | EventKind::Landed => {
            (one.clone(), true)
        }
        _ => (one.clone(), false),
    };
    Alike { one, several, by_all }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn id(number: u8) -> VehicleId {
        VehicleId::new(number).unwrap()
    }

    fn set(numbers: impl IntoIterator<Item = u8>) -> VehicleSet {
        numbers.into_iter().map(id).collect()
    }

    /// A journal with a clock of its own.
    struct JournalFixture {
        journal: Journal,
        zero: Instant,
    }

    impl JournalFixture {
        fn new() -> Self {
            Self { journal: Journal::default(), zero: skein_host::clock::now() }
        }

        fn when(&self, at_s: f64) -> When {
            When { now: self.zero + Duration::from_secs_f64(at_s), window_s: Some(at_s) }
        }

        fn add_event(&mut self, at_s: f64, number: u8, what: EventKind) {
            self.journal.add_alike(self.when(at_s), id(number), alike(&what), set(1..=4));
        }

        fn news(&mut self, at_s: f64) -> Vec<String> {
            let now = self.when(at_s).now;
            assert_eq!(self.journal.has_news(now), !self.journal.clone().take_news(now, false).is_empty());
            self.journal.take_news(now, false)
        }
    }

    #[test]
    fn a_group_is_one_line_that_counts_up_and_is_written_when_complete() {
        let mut fixture = JournalFixture::new();
        fixture.add_event(16.2, 2, EventKind::AtAltitude);
        assert_eq!(fixture.journal.newest(9), ["  16.2 s  vehicle 2: at altitude"]);
        fixture.add_event(17.0, 1, EventKind::AtAltitude);
        fixture.add_event(17.1, 4, EventKind::AtAltitude);
        assert_eq!(fixture.journal.newest(9), ["  16.2 s  3 of 4 at altitude (16.2 to 17.1 s), missing vehicle 3"]);
        assert_eq!(fixture.news(17.2), [""; 0]);
        fixture.add_event(18.5, 3, EventKind::AtAltitude);
        let line = "  16.2 s  4 of 4 at altitude (16.2 to 18.5 s)";
        assert_eq!(fixture.news(18.5), [line]);
        assert_eq!(fixture.news(60.0), [""; 0], "written once");
        assert_eq!(fixture.journal.newest(9), [line]);
    }

    #[test]
    fn a_group_that_waits_is_written_with_the_vehicles_that_are_missing_and_again_when_complete() {
        let mut fixture = JournalFixture::new();
        fixture.add_event(1.0, 1, EventKind::Reached(3));
        fixture.add_event(1.0, 2, EventKind::Reached(3));
        assert_eq!(fixture.news(5.9), [""; 0]);
        assert_eq!(fixture.news(6.0), ["   1.0 s  2 of 4 reached step 3 (1.0 s), missing vehicle 3, 4"]);
        fixture.add_event(9.0, 3, EventKind::Reached(3));
        fixture.add_event(9.5, 4, EventKind::Reached(3));
        assert_eq!(fixture.news(9.5), ["   1.0 s  4 of 4 reached step 3 (1.0 to 9.5 s)"]);
    }

    #[test]
    fn the_same_event_of_the_same_vehicle_begins_a_new_group() {
        let mut fixture = JournalFixture::new();
        (1..=4).for_each(|number| fixture.add_event(1.0, number, EventKind::Landed));
        fixture.add_event(2.0, 3, EventKind::Landed);
        assert_eq!(fixture.journal.newest(9), ["   1.0 s  4 of 4 landed (1.0 s)", "   2.0 s  vehicle 3: landed"]);
        assert_eq!(fixture.journal.newest(1).len(), 1);
        fixture.add_event(90.0, 1, EventKind::Landed);
        assert_eq!(fixture.journal.newest(9).len(), 3, "long after the others");
    }

    #[test]
    fn a_failure_of_one_vehicle_is_news_at_once() {
        let mut fixture = JournalFixture::new();
        fixture.add_event(1.0, 3, EventKind::OwnDataStale);
        assert_eq!(fixture.news(1.0), ["   1.0 s  vehicle 3: simulator data stale, controls neutral"]);
        fixture.add_event(1.0, 4, EventKind::OwnDataStale);
        assert_eq!(fixture.news(1.0).len(), 1);
    }

    #[test]
    fn the_end_writes_what_is_left() {
        let mut fixture = JournalFixture::new();
        fixture.add_event(1.0, 1, EventKind::Landed);
        fixture.journal.add(When { now: fixture.zero, window_s: None }, "ends".to_owned());
        let now = fixture.when(1.0).now;
        assert_eq!(fixture.journal.take_news(now, true), ["   1.0 s  vehicle 1: landed", "     - s  ends"]);
        assert!(fixture.journal.take_news(now, true).is_empty());
    }
}
