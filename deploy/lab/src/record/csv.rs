//! Writes a recording as CSV tables: vehicles' steps, the ages of peers' states, numbers that external laws log, and
//! events.
//!
//! Column names stay the same from release to release; new columns come last. Times before the figures' window are
//! negative. An empty cell means that the value does not apply.

use std::fs::File;
use std::path::{Path, PathBuf};

use csv::Writer;
use skein_common::message::Trace;

use super::reader::{FullRecording, read_all};
use super::{Draft, RecordError, format};
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
    to.write_record(["t_s"].into_iter().chain(COLUMNS.map(|(name, _)| name)))?;
    for Step { t_s, trace } in steps(recording) {
        to.write_record([t_s.to_string()].into_iter().chain(COLUMNS.map(|(_, cell)| cell(trace))))?;
    }
    Ok(())
}

/// Formats one cell of a step.
type Cell = fn(&Trace) -> String;

/// The columns of `trace.csv` after the time.
const COLUMNS: [(&str, Cell); 42] = [
    ("vehicle", |trace| trace.header.sender.to_string()),
    ("incarnation", |trace| trace.header.incarnation.0.to_string()),
    ("sequence", |trace| trace.header.sequence.to_string()),
    ("stamp_s", |trace| trace.header.stamp.seconds().to_string()),
    ("plant_time_s", |trace| trace.plant_time.seconds().to_string()),
    ("membership", |trace| format::spelling(&trace.membership)),
    ("activity", |trace| format::spelling(&trace.activity)),
    ("live", |trace| trace.live.to_string()),
    ("step", |trace| trace.step.to_string()),
    ("reached", |trace| number(trace.reached.map(u64::from))),
    ("centre_north_m", |trace| trace.centre_ne_m[0].to_string()),
    ("centre_east_m", |trace| trace.centre_ne_m[1].to_string()),
    ("estimate_north_m", |trace| trace.estimate.north_m().to_string()),
    ("estimate_east_m", |trace| trace.estimate.east_m().to_string()),
    ("estimate_down_m", |trace| trace.estimate.down_m().to_string()),
    ("north_m", |trace| trace.position.north_m().to_string()),
    ("east_m", |trace| trace.position.east_m().to_string()),
    ("down_m", |trace| trace.position.down_m().to_string()),
    ("height_m", |trace| trace.height_m.to_string()),
    ("velocity_north_m_s", |trace| trace.velocity.north_m_s().to_string()),
    ("velocity_east_m_s", |trace| trace.velocity.east_m_s().to_string()),
    ("velocity_down_m_s", |trace| trace.velocity.down_m_s().to_string()),
    ("roll_rad", |trace| trace.attitude.roll_rad.to_string()),
    ("pitch_rad", |trace| trace.attitude.pitch_rad.to_string()),
    ("heading_rad", |trace| trace.attitude.heading_rad.to_string()),
    ("power_w", |trace| number(trace.power_w)),
    ("field_north", |trace| trace.field_ne[0].to_string()),
    ("field_east", |trace| trace.field_ne[1].to_string()),
    ("error_north_m", |trace| trace.error_ne_m[0].to_string()),
    ("error_east_m", |trace| trace.error_ne_m[1].to_string()),
    ("altitude_setpoint_m", |trace| trace.altitude_setpoint_m.to_string()),
    ("stick_roll", |trace| number(trace.controls.map(|controls| controls[0]))),
    ("stick_pitch", |trace| number(trace.controls.map(|controls| controls[1]))),
    ("stick_yaw", |trace| number(trace.controls.map(|controls| controls[2]))),
    ("stick_collective", |trace| number(trace.controls.map(|controls| controls[3]))),
    ("step_us", |trace| number(trace.step_us)),
    ("safety_activations", |trace| number(trace.safety_activations)),
    ("frame_overruns", |trace| trace.frame_overruns.to_string()),
    ("state_messages", |trace| trace.state_messages.to_string()),
    ("state_bytes", |trace| trace.state_bytes.to_string()),
    ("law_misses", |trace| number(trace.law_misses)),
    ("fallback_flies", |trace| number(trace.fallback_flies)),
];

/// Formats a cell that may be empty.
fn number(value: Option<impl ToString>) -> String {
    value.map(|value| value.to_string()).unwrap_or_default()
}

/// Writes the age of every peer's newest state at each step of each vehicle.
fn peers(to: &mut Writer<File>, recording: &Recording) -> csv::Result<()> {
    to.write_record(["t_s", "vehicle", "peer", "standing", "age_s", "delay_s", "delivered_age_s"])?;
    for Step { t_s, trace } in steps(recording) {
        for peer in &trace.peers {
            let (vehicle, standing) = (trace.header.sender.to_string(), format::spelling(&peer.standing));
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
