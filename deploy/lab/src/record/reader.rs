//! Reads a recording.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use mcap::records::Metadata;
use serde::Deserialize;
use skein_common::id::{Incarnation, VehicleId};
use skein_common::message::{Message, Trace};
use skein_common::scenario::{Source, load};

use super::RecordError;
use super::format::{self, EventLine, FaultLine, seconds_since};
use super::scan::{Found, Piece, scan_file};
use crate::metrics::Run;
use crate::recording::{Lacks, Noted, NotedKind, Recording, Step};

/// Reads the steps, events and faults of a recording that lie in the figures' window.
///
/// The recording ends where the window ends or where the file is cut off. Its steps are those that were recorded, with
/// times rounded to nanoseconds. A step or an event that two recorders wrote into one merged file appears once.
///
/// # Errors
/// The file cannot be read, or is not a recording of Skein.
pub fn read(path: &Path) -> Result<Recording, RecordError> {
    let mut whole = read_all(path)?;
    let end_s = whole.end_s.unwrap_or(f64::INFINITY);
    let is_in_window = |t_s: f64| (0.0..=end_s).contains(&t_s);
    whole.recording.tracks.iter_mut().for_each(|track| track.steps.retain(|step| is_in_window(step.t_s)));
    whole.recording.noted.retain(|noted| is_in_window(noted.t_s));
    Ok(whole.recording)
}

/// Everything in a file, including steps before and after the figures' window.
#[derive(Debug)]
pub(super) struct FullRecording {
    /// The recording; times before the window are negative.
    pub(super) recording: Recording,
    /// End of the window, s; `None` if the file is cut off before it.
    pub(super) end_s: Option<f64>,
}

pub(super) fn read_all(path: &Path) -> Result<FullRecording, RecordError> {
    let mut pieces = Pieces::default();
    let scanned = scan_file(path, |piece| pieces.take(piece));
    let release = pieces.run.as_ref().and_then(|run| run.get("version")).cloned().unwrap_or_default();
    scanned.and_then(|found| pieces.assemble(&found)).map_err(|error| error.recorded_by(&release).reading(path))
}

/// Identifies an event or a fault, to drop the copies of other recorders.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
enum EventId {
    /// The vehicle's own number of the event, which is the same for every recorder.
    Numbered(VehicleId, Incarnation, u64),
    /// Log time, vehicle and text.
    Described(u64, Option<VehicleId>, String),
}

/// The contents of a file, collected until the beginning of the window is known.
#[derive(Default)]
struct Pieces {
    run: Option<BTreeMap<String, String>>,
    scenario: Option<String>,
    begins_ns: Option<u64>,
    ends_ns: Option<u64>,
    first_ns: Option<u64>,
    /// Whether this file was repaired or merged from a file with damaged records outside chunks.
    lacks_records: bool,
    /// The parts that the files lack from which this one was made, and the recorder's own counts.
    lacks: Lacks,
    steps: Vec<(u64, Trace)>,
    noted: Vec<(u64, EventId, NotedKind)>,
}

impl Pieces {
    fn take(&mut self, piece: Piece<'_>) -> Result<(), RecordError> {
        match piece {
            Piece::Message(channel, header, data) => return self.take_message(&channel.topic, header.log_time, data),
            Piece::Attachment(header, data) if header.name == format::SCENARIO => {
                let text = String::from_utf8_lossy(data).into_owned();
                self.scenario.get_or_insert(text);
            }
            Piece::Attachment(..) => {}
            Piece::Metadata(about) => {
                format::add_lacks(&mut self.lacks, &about);
                let Metadata { name, metadata } = about;
                let log_time_ns = || metadata.get(format::LOG_TIME)?.parse().ok();
                match name.as_str() {
                    format::BEGINS => self.begins_ns = self.begins_ns.or_else(log_time_ns),
                    format::DAMAGED => self.lacks_records = true,
                    format::ENDS => self.ends_ns = self.ends_ns.or_else(log_time_ns),
                    format::RUN => {
                        self.run.get_or_insert(metadata);
                    }
                    _ => {}
                }
            }
        }
        Ok(())
    }

    fn take_message(&mut self, topic: &str, log_time_ns: u64, data: &[u8]) -> Result<(), RecordError> {
        let (name, what) = match (format::traced(topic), topic) {
            (Some(id), _) => {
                self.first_ns.get_or_insert(log_time_ns);
                self.steps.push((log_time_ns, trace(id, topic, data)?));
                return Ok(());
            }
            (None, format::EVENTS) => {
                let EventLine { vehicle, incarnation, sequence, text, what } = parse(topic, data)?;
                let name = match incarnation.zip(sequence) {
                    Some((incarnation, sequence)) => EventId::Numbered(vehicle, incarnation, sequence),
                    None => EventId::Described(log_time_ns, Some(vehicle), text.into_owned()),
                };
                (name, NotedKind::Event(vehicle, what))
            }
            (None, format::FAULTS) => {
                let FaultLine { vehicle, text, what } = parse(topic, data)?;
                (EventId::Described(log_time_ns, vehicle, text.into_owned()), NotedKind::Fault(what.into_owned()))
            }
            // Other topics repeat the data above in a form for display.
            _ => return Ok(()),
        };
        self.noted.push((log_time_ns, name, what));
        Ok(())
    }

    fn assemble(self, found: &Found) -> Result<FullRecording, RecordError> {
        // A damaged record may have been the beginning or the end of the window: then steps would have wrong times, or
        // steps from after the window would count.
        let lacks_records = self.lacks_records || found.damaged_outside_chunks > 0;
        for (name, log_time_ns) in [(format::BEGINS, self.begins_ns), (format::ENDS, self.ends_ns)] {
            if log_time_ns.is_none() && lacks_records {
                return Err(RecordError::Missing(name));
            }
        }
        let run = self.run.ok_or(RecordError::Missing(format::RUN))?;
        let entry = |key: &str| run.get(key).cloned().unwrap_or_default();
        if entry("format") != format::FORMAT {
            return Err(RecordError::Format(entry("format")));
        }
        let text = self.scenario.ok_or(RecordError::Missing(format::SCENARIO))?;
        let loaded = load(&Source { name: format::SCENARIO, text: &text }, &[]);
        let scenario = loaded.map_err(|fault| RecordError::Scenario(fault.into()))?.scenario;
        let run =
            Run { version: entry("version"), revision: entry("revision"), ..Run::new(&scenario, &entry("target")) };
        // A file that is cut off before all vehicles were active members has no window: its first step is time 0.
        let zero_ns = self.begins_ns.or(self.first_ns).unwrap_or(0);
        let mut recording = Recording::new(&scenario, run);
        let mut known = BTreeSet::new();
        for (log_time_ns, trace) in self.steps {
            let header = trace.header;
            let is_new = known.insert((header.sender, header.incarnation, header.sequence));
            let track = recording.tracks.iter_mut().find(|track| track.id == header.sender);
            if let Some(track) = track.filter(|_| is_new) {
                track.steps.push(Step { t_s: seconds_since(zero_ns, log_time_ns), trace });
            }
        }
        recording.tracks.iter_mut().for_each(|track| track.steps.sort_by(|one, two| one.t_s.total_cmp(&two.t_s)));
        let mut known = BTreeSet::new();
        let once = self.noted.into_iter().filter_map(|(log_time_ns, name, what)| {
            known.insert(name).then(|| Noted { t_s: seconds_since(zero_ns, log_time_ns), what })
        });
        recording.noted = once.collect();
        recording.noted.sort_by(|one, two| one.t_s.total_cmp(&two.t_s));
        recording.lacks = Lacks {
            // What comes after the end of the window belongs to no figure.
            end: self.ends_ns.is_none() && (self.lacks.end || found.is_cut),
            pieces: self.lacks.pieces + found.damaged,
            ..self.lacks
        };
        Ok(FullRecording { recording, end_s: self.ends_ns.map(|ends_ns| seconds_since(zero_ns, ends_ns)) })
    }
}

/// Parses a trace and checks that it is plausible and from this vehicle.
pub(super) fn trace(id: VehicleId, topic: &str, data: &[u8]) -> Result<Trace, RecordError> {
    let trace: Trace = parse(topic, data)?;
    match trace.header.sender == id && trace.is_plausible() {
        true => Ok(trace),
        false => Err(unreadable(topic, "impossible values")),
    }
}

pub(super) fn parse<'a, T: Deserialize<'a>>(topic: &str, data: &'a [u8]) -> Result<T, RecordError> {
    serde_json::from_slice(data).map_err(|error| unreadable(topic, error))
}

fn unreadable(topic: &str, what: impl ToString) -> RecordError {
    RecordError::Message { topic: topic.to_owned(), what: what.to_string() }
}
