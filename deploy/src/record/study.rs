//! Recording a flight in virtual time.

use std::io::BufWriter;
use std::path::Path;

use skein_common::scenario::Scenario;

use super::draft::Draft;
use super::format::log_time_ns;
use super::{About, RecordError, Writer};
use crate::metrics::{Report, Run};
use crate::study::Study;

/// What log times count from.
const CLOCK: &str = "virtual: 0 is the beginning of the window of the figures";

/// Flies one seed again and records it at `path`, at the scenario's `record.hz`; `as_flown` is that seed's complete scenario
/// file. The file appears when it is whole. The flight, and so its report, is the same as without a recorder.
///
/// # Errors
/// If it cannot be flown or written.
pub fn record_run(study: &Study, seed: u64, as_flown: &str, path: &Path) -> Result<Report, RecordError> {
    let scenario = Scenario { seed, ..study.scenario.clone() };
    let run = Run::new(&scenario, "study");
    let about = About { scenario: &scenario, scenario_toml: as_flown, run: &run, clock: CLOCK };
    let draft = Draft::new(path);
    let mut writer = Writer::new(BufWriter::new(draft.create()?), &about, 0)?;
    writer.window_begins(0);
    let report = study.fly_watched(seed, Some((&mut writer, scenario.record.hz.in_study_hz())))?;
    writer.window_ends(log_time_ns(0, report.duration_s));
    let file = writer.finish(0)?.into_inner().map_err(|error| draft.error(error.into_error()))?;
    draft.finish(&file)?;
    Ok(report)
}
