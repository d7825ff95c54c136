//! Writes a recording as CSV tables: vehicles' steps, the ages of peers' states, numbers that external laws log, and
//! events.
//!
//! Column names stay the same from release to release; new columns come last. Times before the figures' window are
//! negative. An empty cell means that the value does not apply.

use std::fs::File;
use std::path::{Path, PathBuf};

use csv::Writer;
use skein_common::message::TRACE_COLUMNS;

use super::reader::{FullRecording, read_all};
use super::{Draft, RecordError, format};
use crate::metrics::spelling;
use crate::recording::{NotedKind, Recording, Step};

/// Writes `trace.csv`, `peers.csv`, `laws.csv` and `events.csv` of a recording into a folder and returns their paths.
///
/// Creates the folder if it does not exist.
///
/// # Errors
/// The recording cannot be read, or a table cannot be written.
pub fn csv(recording: &Path, folder: &Path) -> Result<Vec<PathBuf>, RecordError> {
    let FullRecording { recording, .. } = read_all(recording)?;
    std::fs::create_dir_all(folder).map_err(|error| RecordError::Io { path: folder.to_owned(), error })?;
    type Table = fn(&mut Writer<File>, &Recording) -> csv::Result<()>;
    let tables: [(&str, Table); 4] =
        [("trace.csv", traces), ("peers.csv", peers), ("laws.csv", laws), ("events.csv", events)];
    let write = |(name, table): (&str, Table)| {
        let path = folder.join(name);
        let draft = Draft::new(&path);
        let mut file = Writer::from_writer(draft.create()?);
        table(&mut file, &recording).map_err(|error| draft.error(error.into()))?;
        let file = file.into_inner().map_err(|error| draft.error(error.into_error()))?;
        draft.finish(&file)?;
        Ok(path)
    };
    tables.into_iter().map(write).collect()
}

/// The steps of all vehicles, in the order of time.
fn steps(recording: &Recording) -> Vec<&Step> {
    let mut steps: Vec<_> = recording.tracks.iter().flat_map(|track| &track.steps).collect();
    // A stable sort: steps of one instant stay in the order of ids.
    steps.sort_by(|one, two| one.t_s.total_cmp(&two.t_s));
    steps
}

fn traces(to: &mut Writer<File>, recording: &Recording) -> csv::Result<()> {
    to.write_record(["t_s"].into_iter().chain(TRACE_COLUMNS.iter().map(|(name, _)| *name)))?;
    for Step { t_s, trace } in steps(recording) {
        to.write_record([t_s.to_string()].into_iter().chain(TRACE_COLUMNS.iter().map(|(_, cell)| cell(trace))))?;
    }
    Ok(())
}

/// Formats a cell that may be empty.
fn number(value: Option<impl ToString>) -> String {
    value.map(|value| value.to_string()).unwrap_or_default()
}

/// Writes the age of every peer's newest state at each step of each vehicle.
fn peers(to: &mut Writer<File>, recording: &Recording) -> csv::Result<()> {
    to.write_record(["t_s", "vehicle", "peer", "standing", "age_s", "delay_s", "delivered_age_s"])?;
    for Step { t_s, trace } in steps(recording) {
        for peer in &trace.peers {
            let (vehicle, standing) = (trace.header.sender.to_string(), spelling(&peer.standing));
            let ages = [peer.age_s.to_string(), number(peer.delay_s), peer.delivered_age_s.to_string()];
            to.write_record([t_s.to_string(), vehicle, peer.id.to_string(), standing].iter().chain(&ages))?;
        }
    }
    Ok(())
}

/// Writes the numbers that external laws log.
fn laws(to: &mut Writer<File>, recording: &Recording) -> csv::Result<()> {
    to.write_record(["t_s", "vehicle", "name", "value"])?;
    for Step { t_s, trace } in steps(recording) {
        for number in &trace.law_log {
            let vehicle = trace.header.sender.to_string();
            to.write_record([t_s.to_string(), vehicle, number.name.to_string(), number.value.to_string()])?;
        }
    }
    Ok(())
}

fn events(to: &mut Writer<File>, recording: &Recording) -> csv::Result<()> {
    to.write_record(["t_s", "kind", "vehicle", "text"])?;
    for noted in &recording.noted {
        let (kind, vehicle, what) = match &noted.what {
            NotedKind::Event(id, what) => ("event", Some(*id), what.to_string()),
            NotedKind::Fault(fault) => ("fault", format::vehicle_of(fault), fault.to_string()),
        };
        to.write_record([noted.t_s.to_string(), kind.to_owned(), number(vehicle), what])?;
    }
    Ok(())
}
