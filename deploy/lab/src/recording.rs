//! A flight in memory: every vehicle's steps, the events that vehicles reported, and the faults that were injected.

use skein_common::id::VehicleId;
use skein_common::message::{EventKind, Trace};
use skein_common::scenario::Scenario;

use crate::faults::InjectedFault;
use crate::metrics::Run;

/// Observes a flight. Times count from the start of the figures' window, s.
pub trait Watch {
    /// Observes one step of one vehicle.
    fn step(&mut self, t_s: f64, trace: &Trace);
    /// Observes an event that a vehicle reported of itself.
    fn event(&mut self, t_s: f64, sender: VehicleId, what: &EventKind);
    /// Observes a fault that was injected into the swarm.
    fn fault(&mut self, t_s: f64, fault: &InjectedFault);
}

/// A whole flight in memory, from which reports are drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// The scenario that flew.
    pub scenario: Scenario,
    /// The run: program, seed and target.
    pub run: Run,
    /// The steps of each vehicle, in the order of ids.
    pub tracks: Vec<Track>,
    /// Events and faults, in the order in which they happened.
    pub noted: Vec<Noted>,
    /// The parts of the flight that its file lacks.
    pub lacks: Lacks,
}

/// The parts of the flight that the file of a recording lacks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lacks {
    /// Whether the file ends before the flight does.
    pub end: bool,
    /// Number of damaged chunks and records, which are left out.
    pub pieces: usize,
    /// Number of messages that the recorder could not write.
    pub unrecorded: u64,
}

/// The steps of one vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// The vehicle.
    pub id: VehicleId,
    /// Its steps in the order of time; a dead agent makes no steps.
    pub steps: Vec<Step>,
}

/// One step of one vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// Time from the start of the figures' window, s.
    pub t_s: f64,
    /// The trace that the vehicle published.
    pub trace: Trace,
}

/// An event or a fault, with its time.
#[derive(Clone, Debug, PartialEq)]
pub struct Noted {
    /// Time from the start of the figures' window, s.
    pub t_s: f64,
    /// The event or the fault.
    pub what: NotedKind,
}

/// An event or a fault of a recording.
#[derive(Clone, Debug, PartialEq)]
pub enum NotedKind {
    /// An event that this vehicle reported of itself.
    Event(VehicleId, EventKind),
    /// A fault that was injected into the swarm.
    Fault(InjectedFault),
}

impl Recording {
    /// An empty recording.
    pub fn new(scenario: &Scenario, run: Run) -> Self {
        let tracks = scenario.ids().map(|id| Track { id, steps: Vec::new() }).collect();
        Self { scenario: scenario.clone(), run, tracks, noted: Vec::new(), lacks: Lacks::default() }
    }
}

impl Watch for Recording {
    fn step(&mut self, t_s: f64, trace: &Trace) {
        if let Some(track) = self.tracks.iter_mut().find(|track| track.id == trace.header.sender) {
            track.steps.push(Step { t_s, trace: trace.clone() });
        }
    }

    fn event(&mut self, t_s: f64, sender: VehicleId, what: &EventKind) {
        self.noted.push(Noted { t_s, what: NotedKind::Event(sender, *what) });
    }

    fn fault(&mut self, t_s: f64, fault: &InjectedFault) {
        self.noted.push(Noted { t_s, what: NotedKind::Fault(fault.clone()) });
    }
}
