//! The operator's view of a flight while it lasts: events, losses and the landing.

use std::time::Instant;

use skein_common::id::VehicleSet;
use skein_common::message::{Event, EventKind, Severity};
use skein_common::printable::printable;
use skein_core::mission::landing;

use super::{Flight, fresh};
use crate::fly::children::{Ended, ProcessRole};
use crate::fly::stream::{Happened, Line};
use skein_cluster::display::journal::{self, Alike, When};
use skein_cluster::display::status::Stage;
use skein_cluster::os;

/// No event takes more room on the screen, characters.
const MAX_EVENT: usize = 400;

impl Flight {
    /// Shows what this process did or found, and records it.
    pub(super) fn report_news(&mut self, now: Instant, what: String) {
        self.record(|recorder| recorder.note(now, Severity::Info, "fly", &what));
        self.show(now, what);
    }

    /// Shows what this process did or found, or another line that is about no vehicle.
    pub fn show(&mut self, now: Instant, what: String) {
        // It may contain the last output of a process.
        let what = printable(&what, MAX_EVENT);
        self.stream(now, Line::Note { text: what.clone() });
        self.journal.add(self.when(now), what);
    }

    /// Shows what happened to a vehicle; an event that several vehicles share is one line.
    pub(super) fn show_event(&mut self, now: Instant, event: &Event) {
        let id = event.header.sender;
        let mut awaited: VehicleSet = self.live().map(|(id, _)| id).collect();
        match event.what {
            // While the swarm gathers, each vehicle finds each of the others: that it becomes active is enough.
            EventKind::PeerFound(_) if self.stage == Stage::Gathering => return,
            EventKind::PeerFound(peer) | EventKind::PeerLost(peer) => awaited.remove(peer),
            // All others are active already.
            EventKind::BecameActive if self.stage == Stage::Flying => awaited = VehicleSet::default(),
            _ => {}
        }
        self.journal.add_alike(self.when(now), id, journal::alike(&event.what), awaited);
    }

    /// Shows that a process has ended, and keeps it for the end of the flight if it was not ordered to end.
    pub(super) fn take_leave(&mut self, now: Instant, ended: &Ended) {
        let Ended { role, id, status, last_words } = ended;
        if *role == ProcessRole::Agent {
            self.count_out(now, *id);
        }
        let how = os::how_it_ended(*status);
        let (what, one, several) = match role {
            ProcessRole::Agent => (format!("vehicle {id}"), how.clone(), how.clone()),
            ProcessRole::Standin => {
                (format!("vehicle {id}'s simulator"), format!("its simulator {how}"), format!("simulators {how}"))
            }
        };
        let wrote = last_words.as_ref().map(|text| format!(" ({text})")).unwrap_or_default();
        let sentence = format!("{what}: {how}{wrote}");
        let was_killed = *role == ProcessRole::Agent && self.killed.contains(*id);
        if !status.success() && !was_killed {
            let when =
                self.zero.as_ref().map_or_else(String::new, |_| format!(" after {:.1} s", self.since_zero_s(now)));
            self.lost.push(format!("lost{when}: {sentence}"));
        }
        if !status.success() {
            self.report_news(now, sentence);
            return;
        }
        self.record(|recorder| recorder.note(now, Severity::Info, "fly", &sentence));
        self.stream(now, Line::Note { text: sentence });
        let awaited = self.live().map(|(id, _)| id).collect();
        self.journal.add_alike(self.when(now), *id, Alike { one, several, by_all: true }, awaited);
    }

    /// Shows how long the landing takes for the vehicle that is highest above the ground.
    pub(super) fn announce_landing(&mut self, now: Instant) {
        let heights_m = self.live().filter_map(|(_, seen)| Some(fresh(seen?, now)?.height_m));
        let Some(highest_m) = heights_m.reduce(f64::max).filter(|height_m| *height_m > super::LIFTED_M) else { return };
        let (usual_s, limit_s) = (landing::usual_s(highest_m), self.landing_limit().as_secs());
        self.report_news(
            now,
            format!("landing from {highest_m:.0} m: about {usual_s:.0} s, given up after {limit_s} s"),
        );
    }

    /// Keeps a line for the stream of `--json`.
    pub(super) fn stream(&mut self, at: Instant, line: Line) {
        let window_s = self.when(at).window_s;
        self.happened.push(Happened { at, window_s, line });
    }

    fn when(&self, now: Instant) -> When {
        When { now, window_s: self.zero.as_ref().map(|_| self.since_zero_s(now)) }
    }
}
