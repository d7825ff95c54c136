//! One flight as those saw it who looked on: every vehicle's steps, what was said, what was done to the swarm.

use skein_common::id::VehicleId;
use skein_common::message::{Happening, Trace};
use skein_common::scenario::Scenario;

use crate::faults::Incident;
use crate::metrics::Run;

/// Looks on while a flight goes by. Times are seconds into the window of the figures.
pub trait Watch {
    /// One step of one vehicle.
    fn step(&mut self, t_s: f64, trace: &Trace);
    /// Something that a vehicle said of itself.
    fn happened(&mut self, t_s: f64, speaker: VehicleId, what: &Happening);
    /// Something that was done to the swarm.
    fn incident(&mut self, t_s: f64, incident: &Incident);
}

/// A whole flight in memory: what reports draw.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// What flew.
    pub scenario: Scenario,
    /// In which run.
    pub run: Run,
    /// One for each vehicle, in the order of ids.
    pub tracks: Vec<Track>,
    /// In the order in which it happened.
    pub noted: Vec<Noted>,
}

/// One vehicle's steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// Whose.
    pub id: VehicleId,
    /// In order of time; there are none while its agent is dead.
    pub steps: Vec<Step>,
}

/// One step of one vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// Into the window, s.
    pub t_s: f64,
    /// What the vehicle traced.
    pub trace: Trace,
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq)]
pub struct Noted {
    /// Into the window, s.
    pub t_s: f64,
    /// What.
    pub what: What,
}

/// What can be noted.
#[derive(Clone, Debug, PartialEq)]
pub enum What {
    /// A vehicle said it of itself.
    Said(VehicleId, Happening),
    /// It was done to the swarm.
    Done(Incident),
}

impl Recording {
    /// Nothing recorded yet.
    pub fn new(scenario: &Scenario, run: Run) -> Self {
        let tracks = scenario.ids().map(|id| Track { id, steps: Vec::new() }).collect();
        Self { scenario: scenario.clone(), run, tracks, noted: Vec::new() }
    }
}

impl Watch for Recording {
    fn step(&mut self, t_s: f64, trace: &Trace) {
        if let Some(track) = self.tracks.iter_mut().find(|track| track.id == trace.header.sender) {
            track.steps.push(Step { t_s, trace: trace.clone() });
        }
    }

    fn happened(&mut self, t_s: f64, speaker: VehicleId, what: &Happening) {
        self.noted.push(Noted { t_s, what: What::Said(speaker, *what) });
    }

    fn incident(&mut self, t_s: f64, incident: &Incident) {
        self.noted.push(Noted { t_s, what: What::Done(incident.clone()) });
    }
}
