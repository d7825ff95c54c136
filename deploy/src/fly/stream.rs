//! `fly --json`: what happens during a flight as lines of JSON on stdout, one object a line, as it happens. The last line
//! is the result.
//!
//! A thread of its own writes: a program that reads slowly delays neither the measurement nor the landing.

use std::sync::mpsc::{Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use serde::Serialize;
use skein_common::id::{TeamId, VehicleId, VehicleName};
use skein_common::message::EventKind;
use skein_lab::error::Error;
use skein_lab::faults::InjectedFault;
use skein_lab::metrics::Run;
use skein_lab::terminal::say;

use skein_cluster::display::status::{FlightStatus, Row, Stage};

/// Interval between two lines of progress.
const PROGRESS: Duration = Duration::from_secs(10);

/// A line, by its subject.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Line {
    /// The processes have been started.
    Began {
        /// Name of the swarm or fleet.
        swarm: String,
        /// The vehicles.
        ids: Vec<VehicleName>,
        /// Time to be flown, s; null until the operator stops the flight.
        duration_s: Option<f64>,
        /// The folder for everything that is written.
        out: String,
        /// The run.
        #[serde(flatten)]
        run: Run,
    },
    /// A vehicle became an active member of the swarm.
    Active(VehicleEvent),
    /// A vehicle landed.
    Landed(VehicleEvent),
    /// Any other event that a vehicle reported of itself.
    Event(VehicleEvent),
    /// A fault was injected into the swarm.
    Fault {
        /// The fault as text.
        text: String,
        /// The fault as data: a name, or a name with its values.
        what: InjectedFault,
    },
    /// All vehicles are active: the clock of the flight runs, and the window of the figures begins.
    Window,
    /// All vehicles are ordered to land.
    Landing,
    /// An action or a finding of this process, such as a process that ended.
    Note {
        /// The sentence that people read.
        text: String,
    },
    /// The state of the flight, every ten seconds.
    Progress {
        /// The stage of the flight.
        stage: Stage,
        /// Time flown, s.
        flown_s: f64,
        /// The sentence that people read.
        text: String,
        /// Each vehicle.
        vehicles: Vec<Row>,
    },
}

/// An event that a vehicle reported of itself.
#[derive(Clone, Debug, Serialize)]
pub struct VehicleEvent {
    pub(super) vehicle: VehicleId,
    /// The event as text.
    text: String,
    /// The event as data: a name, or a name with its values.
    pub(super) what: EventKind,
}

impl Line {
    /// The line about an event of a vehicle.
    pub fn of_event(vehicle: VehicleId, what: EventKind) -> Self {
        let event = VehicleEvent { vehicle, text: what.to_string(), what };
        match what {
            EventKind::BecameActive => Self::Active(event),
            EventKind::Landed => Self::Landed(event),
            _ => Self::Event(event),
        }
    }

    /// The line about an injected fault.
    pub fn of_fault(what: &InjectedFault) -> Self {
        Self::Fault { text: what.to_string(), what: what.clone() }
    }
}

/// A line that happened in a flight.
#[derive(Clone, Debug)]
pub struct Happened {
    /// The time at which it happened, by this process's clock.
    pub at: Instant,
    /// Time since the window of the figures began, s; `None` before.
    pub window_s: Option<f64>,
    /// The line.
    pub line: Line,
}

/// A line with the fields that all lines have.
#[derive(Serialize)]
struct Timed<'a, T: Serialize> {
    #[serde(flatten)]
    line: &'a T,
    #[serde(skip_serializing_if = "Option::is_none")]
    team: Option<TeamId>,
    /// Time since the processes were started, s.
    at_s: f64,
    /// Time since the window of the figures began, s; null before.
    t_s: Option<f64>,
}

/// The last line.
#[derive(Serialize)]
#[serde(tag = "kind", rename = "result")]
struct Outcome<'a, R: Serialize> {
    /// The reason why the flight failed; null if it did not.
    error: Option<&'a str>,
    /// Lost vehicles, an incomplete recording.
    notes: &'a [String],
    out: &'a str,
    /// The figures; absent if the clock of the flight never ran.
    #[serde(flatten)]
    report: Option<&'a R>,
}

/// The lines of a flight, or of all teams of a fleet, on stdout.
#[derive(Debug)]
pub struct Stream {
    lines: Sender<String>,
    writing: JoinHandle<()>,
    began: Instant,
    next_progress: Instant,
}

impl Stream {
    /// Begins to write.
    ///
    /// # Errors
    /// If the system has no thread left.
    pub fn begin(now: Instant) -> Result<Self, Error> {
        let (lines, queue) = channel::<String>();
        let thread = thread::Builder::new().name("stream".to_owned());
        let writing = thread.spawn(move || queue.iter().for_each(|line| say(&line)));
        let writing = writing.map_err(|error| Error::Failed(format!("--json: thread: {error}")))?;
        Ok(Self { lines, writing, began: now, next_progress: now + PROGRESS })
    }

    /// Writes a line about the swarm, or about this team of the fleet.
    pub fn write(&self, team: Option<TeamId>, Happened { at, window_s, line }: &Happened) {
        self.put(&Timed { line, team, at_s: self.since(*at), t_s: *window_s });
    }

    /// Whether a line of progress is to be written.
    pub fn is_due(&self, now: Instant) -> bool {
        now >= self.next_progress
    }

    /// Writes a line of progress.
    pub fn progress(&mut self, now: Instant, status: &FlightStatus) {
        self.next_progress = now + PROGRESS;
        let FlightStatus { stage, flown_s, rows, .. } = status;
        let line = Line::Progress {
            stage: *stage,
            flown_s: *flown_s,
            text: status.summary(usize::MAX),
            vehicles: rows.clone(),
        };
        let window_s = (*stage != Stage::Gathering).then_some(*flown_s);
        self.write(None, &Happened { at: now, window_s, line });
    }

    /// Writes the last line, and waits until everything is written. `report` has the figures of the flight.
    pub fn end(
        self,
        now: Instant,
        report: Option<&impl Serialize>,
        (error, notes): (Option<&str>, &[String]),
        out: &str,
    ) {
        let line = &Outcome { error, notes, out, report };
        self.put(&Timed { line, team: None, at_s: self.since(now), t_s: None });
        drop(self.lines);
        // A panic of the thread has been printed.
        let _ = self.writing.join();
    }

    fn since(&self, at: Instant) -> f64 {
        // Microseconds are finer than anything that is measured here, and short to read.
        (at.saturating_duration_since(self.began).as_secs_f64() * 1e6).round() / 1e6
    }

    fn put(&self, line: &impl Serialize) {
        // Lines are structs of numbers and texts, and their keys are texts: serialising them cannot fail.
        #[expect(clippy::expect_used, reason = "a line always has a JSON form")]
        let text = serde_json::to_string(line).expect("a line serialises to JSON");
        // The thread ends only with this value.
        let _ = self.lines.send(text + "\n");
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};
    use skein_host::clock;

    use super::*;

    fn value(line: &Line) -> Value {
        serde_json::to_value(Timed { line, team: TeamId::new(2).ok(), at_s: 1.5, t_s: None }).unwrap()
    }

    #[test]
    fn every_line_has_its_kind_its_times_and_its_data() {
        let id = VehicleId::new(3).unwrap();
        let active = value(&Line::of_event(id, EventKind::BecameActive));
        let expected = json!({ "kind": "active", "vehicle": 3, "text": "active", "what": "BecameActive", "team": 2, "at_s": 1.5, "t_s": null });
        assert_eq!(active, expected);
        let kind = |line: &Line| value(line)["kind"].as_str().unwrap_or_default().to_owned();
        assert_eq!(kind(&Line::of_event(id, EventKind::Landed)), "landed");
        assert_eq!(kind(&Line::of_event(id, EventKind::Reached(2))), "event");
        assert_eq!((kind(&Line::Window), kind(&Line::Landing)), ("window".to_owned(), "landing".to_owned()));
        let fault = value(&Line::of_fault(&InjectedFault::Died(id)));
        assert_eq!((&fault["kind"], &fault["what"]), (&json!("fault"), &json!({ "Died": 3 })));
    }

    #[test]
    fn the_last_line_has_the_figures_beside_its_own_keys() {
        let last = |report: Option<&Run>, error| {
            let line = Outcome { error, notes: &[], out: "runs/x", report };
            serde_json::to_value(Timed { line: &line, team: None, at_s: 2.0, t_s: None }).unwrap()
        };
        let good = last(Some(&Run { scenario: "hover".to_owned(), ..Run::default() }), None);
        assert_eq!(
            (&good["kind"], &good["scenario"], &good["error"]),
            (&json!("result"), &json!("hover"), &Value::Null)
        );
        let bad = last(None, Some("every agent ended"));
        let expected = json!({
            "kind": "result", "error": "every agent ended", "notes": [], "out": "runs/x", "at_s": 2.0, "t_s": null,
        });
        assert_eq!(bad, expected);
    }

    #[test]
    fn progress_is_due_every_ten_seconds() {
        let now = clock::now();
        let stream = Stream::begin(now).unwrap();
        assert!(!stream.is_due(now + PROGRESS - Duration::from_millis(1)) && stream.is_due(now + PROGRESS));
        assert!((stream.since(now + Duration::from_millis(1500)) - 1.5).abs() < 1e-9);
    }
}
