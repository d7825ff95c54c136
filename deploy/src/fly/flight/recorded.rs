//! The recording of a flight, and what the recording of its fleet needs of it.

use std::time::Instant;

use skein_common::message::Trace;
use skein_common::scenario::RecordRuns;

use super::{Flight, fresh};
use crate::fly::plan::Plan;
use crate::fly::stream::Line;
use crate::record::Recorder;
use skein_lab::error::Error;
use skein_lab::faults::InjectedFault;
use skein_lab::metrics::Run;
use skein_lab::record::{self, RecordingInfo};

impl Flight {
    /// Records something in the flight's own recording, if it has one.
    pub(super) fn record(&mut self, record: impl FnOnce(&mut Recorder)) {
        if let Some(recorder) = &mut self.recorder {
            record(recorder);
        }
    }

    /// Records a fault that was injected.
    pub(super) fn record_fault(&mut self, now: Instant, fault: &InjectedFault) {
        self.record(|recorder| recorder.fault(now, None, fault));
        self.stream(now, Line::of_fault(fault));
    }

    /// Whether the clock of the flight runs, or has run.
    pub fn has_begun(&self) -> bool {
        self.zero.is_some()
    }

    /// The newest steps of the vehicles whose agents run, as far as they are fresh.
    pub fn steps(&self, now: Instant) -> impl Iterator<Item = &Trace> {
        let steps = self.observer.vehicles().values().filter_map(move |seen| fresh(seen, now));
        steps.filter(|step| self.ground.lives(step))
    }
}

/// The recorder of a flight, if the scenario wants a recording. In a fleet only chosen teams have one of their own.
pub(super) fn recorder(plan: &Plan) -> Result<Option<Recorder>, Error> {
    let scenario = plan.scenario();
    if scenario.record.runs == RecordRuns::None || scenario.team.is_some_and(|team| !team.is_recorded) {
        return Ok(None);
    }
    let (run, path) = (Run::new(scenario, "fly"), plan.out.join(record::FILE));
    let about = RecordingInfo { scenario, scenario_toml: &plan.loaded.to_toml(), run: &run, is_fleet: false };
    let recorder = Recorder::begin(&path, &about, Some(scenario.record.hz.live_hz()));
    recorder.map(Some).map_err(|error| Error::Failed(format!("no recording: {error}")))
}
