//! Plays a recording: what every vehicle did at any time of it, read from the file piece by piece.
//!
//! The file's index names the chunks that have the messages of a vehicle around a time. Only those are read, so that memory does not grow
//! with the length of the recording. A file without an index was cut off; [`repair`](super::repair()) writes one.

mod replay;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use mcap::records::{Record, op};
use mcap::sans_io::indexed_reader::{IndexedReadEvent, IndexedReader, IndexedReaderOptions, ReadOrder};
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use mcap::{MAGIC, McapError, Summary};
use skein_common::id::{TeamId, VehicleId, VehicleName};
use skein_common::message::{EventKind, Severity, Trace};
use skein_common::scenario::{Described, Source, load_any};

use super::RecordError;
use super::fleet::{TEAMS, TeamLine, TeamPlaces, VehiclePlace};
use super::format::{self, EventLine, FaultLine, seconds_since};
use super::reader::{parse, trace};
use super::scan::{PREFIX, parse_content};
pub use replay::Replay;

/// Size of the largest record that is read, bytes: a damaged length must not allocate all memory.
const LARGEST_RECORD: usize = 1 << 28;
/// A step forward in time of at most this length is read message by message; a longer one is looked up, s.
const NEAR_S: f64 = 2.0;
/// Largest number of events and faults that are read.
const MAX_NOTED: usize = 100_000;

/// A recording that is played.
pub struct Player {
    open: OpenFile,
    summary: Summary,
    described: Described,
    /// The release of Skein that recorded the file.
    release: String,
    /// Log time of the beginning of the figures' window.
    zero_ns: u64,
    /// The newest trace of each vehicle at `at_s`, with its time.
    traces: BTreeMap<VehicleId, (f64, Trace)>,
    /// The places of the teams around `at_s`, by time.
    places: BTreeMap<TeamId, Vec<TeamPlaces>>,
    at_s: Option<f64>,
}

/// An event or a fault of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct PlayedEvent {
    /// Time from the beginning of the window, s.
    pub t_s: f64,
    /// The vehicle; `None` if a fault affects links.
    pub vehicle: Option<VehicleName>,
    /// The event or the fault as text.
    pub text: String,
    /// The event as data; `None` of a fault, and in a fleet's recording, which has only the text.
    pub what: Option<EventKind>,
    /// Its severity; an injected fault is an error.
    pub severity: Severity,
}

/// The place of a vehicle of a fleet at one time, with its velocity from place to place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlayedPlace {
    /// The place.
    pub place: VehiclePlace,
    /// Velocity north and east, m/s.
    pub velocity_ne_m_s: [f64; 2],
}

impl Player {
    /// Opens a recording, of a swarm or of a fleet.
    ///
    /// # Errors
    /// The file cannot be read, is not a recording of Skein, or was cut off.
    pub fn open(path: &Path) -> Result<Self, RecordError> {
        Self::open_file(path).map_err(|error| error.reading(path))
    }

    fn open_file(path: &Path) -> Result<Self, RecordError> {
        let failed = |error| RecordError::Io { path: path.to_owned(), error };
        let mut file = File::open(path).map_err(failed)?;
        let mut magic = [0; MAGIC.len()];
        if file.read_exact(&mut magic).is_err() || magic != *MAGIC {
            return Err(RecordError::NoMcap);
        }
        let summary = read_summary(&mut file).map_err(unreadable)?.ok_or(RecordError::NoIndex)?;
        let mut open = OpenFile { file, path: path.to_owned() };
        let run = open.metadata(&summary, format::RUN)?.ok_or(RecordError::Missing(format::RUN))?;
        let entry = |key: &str| run.get(key).cloned().unwrap_or_default();
        let (version, release) = (entry("format"), entry("version"));
        if version != format::FORMAT {
            return Err(RecordError::Format(version).recorded_by(&release));
        }
        let text = open.scenario(&summary)?;
        let described = load_any(&Source { name: format::SCENARIO, text: &text }, &[])
            .map_err(|fault| RecordError::Scenario(fault.into()).recorded_by(&release))?;
        let begins = open.metadata(&summary, format::BEGINS)?;
        let zero_ns = begins.and_then(|metadata| metadata.get(format::LOG_TIME)?.parse().ok());
        let (traces, places) = (BTreeMap::new(), BTreeMap::new());
        let mut player = Self { open, summary, described, release, zero_ns: 0, traces, places, at_s: None };
        player.zero_ns = match zero_ns {
            Some(zero_ns) => zero_ns,
            // The places of a fleet carry the time in the window.
            None if player.is_fleet() => player.zero_of_fleet()?,
            None => player.first_ns(),
        };
        Ok(player)
    }

    /// The scenario that was flown.
    pub fn described(&self) -> &Described {
        &self.described
    }

    /// Whether it is the recording of a fleet: places instead of traces.
    pub fn is_fleet(&self) -> bool {
        self.has(TEAMS)
    }

    /// First and last time of the recording, from the beginning of the window, s.
    pub fn span_s(&self) -> (f64, f64) {
        let (first_ns, last_ns) = self.span_ns();
        (seconds_since(self.zero_ns, first_ns), seconds_since(self.zero_ns, last_ns))
    }

    /// Log times of the first and the last message, ns.
    pub fn span_ns(&self) -> (u64, u64) {
        let last_ns = self.summary.chunk_indexes.iter().map(|chunk| chunk.message_end_time).max().unwrap_or(0);
        (self.first_ns(), last_ns)
    }

    /// All events and faults, in the order of time.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn events(&mut self) -> Result<Vec<PlayedEvent>, RecordError> {
        let (zero_ns, is_fleet, mut events) = (self.zero_ns, self.is_fleet(), Vec::new());
        let topics = [format::EVENTS.to_owned(), format::FAULTS.to_owned()];
        self.visit(&topics, (0, u64::MAX), ReadOrder::LogTime, |topic, log_time_ns, data| {
            let t_s = seconds_since(zero_ns, log_time_ns);
            let is_fault = topic == format::FAULTS;
            let (vehicle, text, what, severity) = if is_fleet {
                let TeamLine { team, vehicle, text, severity } = parse(topic, data)?;
                let vehicle = vehicle.map(|vehicle| VehicleName { team: Some(team), vehicle });
                (vehicle, text, None, if is_fault { Severity::Error } else { severity })
            } else if is_fault {
                let FaultLine { vehicle, text, .. } = parse(topic, data)?;
                (vehicle.map(Into::into), text.into_owned(), None, Severity::Error)
            } else {
                let EventLine { vehicle, text, what, .. } = parse(topic, data)?;
                (Some(vehicle.into()), text.into_owned(), Some(what), what.severity())
            };
            events.push(PlayedEvent { t_s, vehicle, text, what, severity });
            Ok(events.len() < MAX_NOTED)
        })?;
        Ok(events)
    }

    /// The newest trace of each vehicle at this time, with its time, s. A vehicle that has made no step by then is absent.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn traces(&mut self, at_s: f64) -> Result<&BTreeMap<VehicleId, (f64, Trace)>, RecordError> {
        match self.at_s {
            Some(before_s) if before_s == at_s => {}
            Some(before_s) if (0.0..=NEAR_S).contains(&(at_s - before_s)) => {
                let topics: Vec<String> = self.ids().into_iter().map(format::trace_topic).collect();
                let found =
                    self.read_traces(&topics, (self.ns(before_s) + 1, self.ns(at_s)), ReadOrder::LogTime, None)?;
                self.traces.extend(found);
            }
            _ => self.traces = self.look_up(at_s)?,
        }
        self.at_s = Some(at_s);
        Ok(&self.traces)
    }

    /// The places of the vehicles of each team of a fleet at this time, interpolated between two recorded ones. A vehicle that is
    /// not in the newest places of its team is absent.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn places(&mut self, at_s: f64) -> Result<BTreeMap<TeamId, Vec<PlayedPlace>>, RecordError> {
        let period_s = self.described.first().scenario.team.map_or(1.0, |team| 1.0 / team.record_hz);
        let is_near = |before_s: f64| (0.0..period_s).contains(&(at_s - before_s));
        if !self.at_s.is_some_and(is_near) {
            let around = (self.ns(at_s - 1.5 * period_s), self.ns(at_s + 2.5 * period_s));
            let mut places: BTreeMap<TeamId, Vec<TeamPlaces>> = BTreeMap::new();
            self.visit(&[TEAMS.to_owned()], around, ReadOrder::LogTime, |topic, _, data| {
                let found: TeamPlaces = parse(topic, data)?;
                places.entry(found.team).or_default().push(found);
                Ok(true)
            })?;
            (self.places, self.at_s) = (places, Some(at_s));
        }
        let played = |places: &Vec<TeamPlaces>| between(places, at_s);
        Ok(self.places.iter().map(|(team, places)| (*team, played(places))).collect())
    }

    fn ids(&self) -> Vec<VehicleId> {
        self.described.first().scenario.ids().collect()
    }

    fn has(&self, topic: &str) -> bool {
        // Any order: only whether there is one.
        self.summary.channels.values().any(|channel| channel.topic == topic)
    }

    fn first_ns(&self) -> u64 {
        self.summary.chunk_indexes.iter().map(|chunk| chunk.message_start_time).min().unwrap_or(0)
    }

    fn zero_of_fleet(&mut self) -> Result<u64, RecordError> {
        let mut zero_ns = None;
        self.visit(&[TEAMS.to_owned()], (0, u64::MAX), ReadOrder::LogTime, |topic, log_time_ns, data| {
            let TeamPlaces { t_s, .. } = parse(topic, data)?;
            zero_ns = Some(format::log_time_ns(log_time_ns, -t_s));
            Ok(false)
        })?;
        Ok(zero_ns.unwrap_or(0))
    }

    /// Log time of this time in the window.
    fn ns(&self, t_s: f64) -> u64 {
        format::log_time_ns(self.zero_ns, t_s)
    }

    /// The newest trace of each vehicle at a time: of most from just before it, of those that had fallen silent from their last
    /// chunk.
    fn look_up(&mut self, at_s: f64) -> Result<BTreeMap<VehicleId, (f64, Trace)>, RecordError> {
        let topic = format::trace_topic;
        let topics: Vec<String> = self.ids().into_iter().map(topic).collect();
        let near = (self.ns(at_s - NEAR_S), self.ns(at_s));
        let mut found = self.read_traces(&topics, near, ReadOrder::LogTime, None)?;
        for id in self.ids().into_iter().filter(|id| !found.contains_key(id)).collect::<Vec<_>>() {
            let one = self.read_traces(&[topic(id)], (0, self.ns(at_s)), ReadOrder::ReverseLogTime, Some(1))?;
            found.extend(one);
        }
        Ok(found)
    }

    /// The last of the traces of each vehicle that are read; at most so many are read.
    fn read_traces(
        &mut self,
        topics: &[String],
        within_ns: (u64, u64),
        order: ReadOrder,
        most: Option<usize>,
    ) -> Result<BTreeMap<VehicleId, (f64, Trace)>, RecordError> {
        let (zero_ns, mut found, mut count) = (self.zero_ns, BTreeMap::new(), 0);
        self.visit(topics, within_ns, order, |topic, log_time_ns, data| {
            if let Some(id) = format::traced(topic) {
                found.insert(id, (seconds_since(zero_ns, log_time_ns), trace(id, topic, data)?));
                count += 1;
            }
            Ok(most.is_none_or(|most| count < most))
        })?;
        Ok(found)
    }

    /// Reads the messages on these topics from one log time to another, both included, until `take` returns false.
    fn visit(
        &mut self,
        topics: &[String],
        (from_ns, to_ns): (u64, u64),
        order: ReadOrder,
        mut take: impl FnMut(&str, u64, &[u8]) -> Result<bool, RecordError>,
    ) -> Result<(), RecordError> {
        // The library reads all topics if none of these is in the file.
        if from_ns > to_ns || !topics.iter().any(|topic| self.has(topic)) {
            return Ok(());
        }
        let options = IndexedReaderOptions::new()
            .with_order(order)
            .include_topics(topics.iter().cloned())
            .starting_at(from_ns)
            .ending_at(to_ns)
            .with_record_length_limit(LARGEST_RECORD);
        let mut reader = IndexedReader::new_with_options(&self.summary, options).map_err(unreadable)?;
        let mut buffer = Vec::new();
        while let Some(event) = reader.next_event() {
            match event.map_err(unreadable)? {
                IndexedReadEvent::ReadChunkRequest { offset, length } => {
                    self.open.read(offset, length, &mut buffer)?;
                    reader.insert_chunk_record_data(offset, &buffer).map_err(unreadable)?;
                }
                IndexedReadEvent::Message { header, data } => {
                    let Some(channel) = self.summary.channels.get(&header.channel_id) else { continue };
                    let taken = take(&channel.topic, header.log_time, data);
                    if !taken.map_err(|error| error.recorded_by(&self.release))? {
                        break;
                    }
                }
            }
        }
        Ok(())
    }
}

/// The places at this time, between the newest before it and the next.
fn between(places: &[TeamPlaces], at_s: f64) -> Vec<PlayedPlace> {
    let split = places.partition_point(|places| places.t_s <= at_s);
    let (Some(before), next) = (split.checked_sub(1).and_then(|nth| places.get(nth)), places.get(split)) else {
        return Vec::new();
    };
    let played = |place: &VehiclePlace| {
        let still = PlayedPlace { place: *place, velocity_ne_m_s: [0.0; 2] };
        let later = next.and_then(|next| Some((next, next.vehicles.iter().find(|other| other.id == place.id)?)));
        let Some((next, later)) = later else { return still };
        let (span_s, passed_s) = (next.t_s - before.t_s, at_s - before.t_s);
        let rate = |from: f64, to: f64| (to - from) / span_s;
        let moved = |from: f64, to: f64| from + rate(from, to) * passed_s;
        let place = VehiclePlace {
            north_m: moved(place.north_m, later.north_m),
            east_m: moved(place.east_m, later.east_m),
            altitude_m: moved(place.altitude_m, later.altitude_m),
            ..*place
        };
        PlayedPlace {
            velocity_ne_m_s: [rate(still.place.north_m, later.north_m), rate(still.place.east_m, later.east_m)],
            place,
        }
    };
    before.vehicles.iter().map(played).collect()
}

/// A file with the path for its errors.
struct OpenFile {
    file: File,
    path: PathBuf,
}

impl OpenFile {
    fn read(&mut self, offset: u64, length: usize, buffer: &mut Vec<u8>) -> Result<(), RecordError> {
        if length > LARGEST_RECORD {
            return Err(unreadable(McapError::BadIndex));
        }
        buffer.resize(length, 0);
        let read = self.file.seek(SeekFrom::Start(offset)).and_then(|_| self.file.read_exact(buffer));
        read.map_err(|error| RecordError::Io { path: self.path.clone(), error })
    }

    /// The content of the record at this place of the file.
    fn record(&mut self, offset: u64, length: u64) -> Result<Vec<u8>, RecordError> {
        let mut buffer = Vec::new();
        self.read(offset, usize::try_from(length).unwrap_or(usize::MAX), &mut buffer)?;
        Ok(buffer.split_off(PREFIX.min(buffer.len())))
    }

    /// The first metadata record of this name.
    fn metadata(&mut self, summary: &Summary, name: &str) -> Result<Option<BTreeMap<String, String>>, RecordError> {
        let Some(index) = summary.metadata_indexes.iter().find(|index| index.name == name) else { return Ok(None) };
        let content = self.record(index.offset, index.length)?;
        match parse_content(op::METADATA, &content).map_err(unreadable)? {
            Record::Metadata(metadata) if format::is_intact(&metadata) != Some(false) => Ok(Some(metadata.metadata)),
            _ => Err(unreadable(McapError::BadIndex)),
        }
    }

    fn scenario(&mut self, summary: &Summary) -> Result<String, RecordError> {
        let index = summary.attachment_indexes.iter().find(|index| index.name == format::SCENARIO);
        let index = index.ok_or(RecordError::Missing(format::SCENARIO))?;
        let content = self.record(index.offset, index.length)?;
        match parse_content(op::ATTACHMENT, &content).map_err(unreadable)? {
            Record::Attachment { data, .. } => Ok(String::from_utf8_lossy(&data).into_owned()),
            _ => Err(unreadable(McapError::BadIndex)),
        }
    }
}

/// Size of the footer and of what ends a file behind it, bytes.
const FOOTER: u64 = PREFIX as u64 + 20 + MAGIC.len() as u64;

/// Whether an attachment is in the summary, where none belongs: the crate `mcap` would parse it, and panics if it is cut off.
/// `None` if the file has no summary.
fn has_attachment_in_summary(file: &mut File) -> Option<bool> {
    let end = file.metadata().ok()?.len().checked_sub(FOOTER)?;
    let mut footer = [0; PREFIX + 8];
    file.seek(SeekFrom::Start(end)).and_then(|_| file.read_exact(&mut footer)).ok()?;
    let mut at = u64::from_le_bytes(*footer.last_chunk()?);
    if at == 0 {
        return None;
    }
    file.seek(SeekFrom::Start(at)).ok()?;
    let mut file = BufReader::new(file);
    while at < end {
        let mut prefix = [0; PREFIX];
        file.read_exact(&mut prefix).ok()?;
        let length = u64::from_le_bytes(*prefix.last_chunk()?);
        if prefix[0] == op::ATTACHMENT {
            return Some(true);
        }
        at = at.checked_add(PREFIX as u64)?.checked_add(length)?;
        file.seek_relative(i64::try_from(length).ok()?).ok()?;
    }
    Some(false)
}

fn read_summary(file: &mut File) -> Result<Option<Summary>, McapError> {
    if has_attachment_in_summary(file) == Some(true) {
        return Err(McapError::BadFooter);
    }
    file.rewind()?;
    let options = SummaryReaderOptions::default().with_record_length_limit(LARGEST_RECORD);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event? {
            SummaryReadEvent::ReadRequest(wanted) => {
                let read = file.read(reader.insert(wanted))?;
                reader.notify_read(read);
            }
            SummaryReadEvent::SeekRequest(to) => reader.notify_seeked(file.seek(to)?),
        }
    }
    Ok(reader.finish().filter(|summary| !summary.chunk_indexes.is_empty()))
}

fn unreadable(error: McapError) -> RecordError {
    RecordError::Unreadable(error.to_string())
}

#[cfg(test)]
mod tests;
