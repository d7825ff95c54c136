//! Writes a recording.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use mcap::records::MessageHeader;
use mcap::{Attachment, Compression, WriteOptions};
use skein_common::id::VehicleId;
use skein_common::message::{EventKind, Trace};
use skein_common::scenario::Scenario;

use super::RecordError;
use super::channels::{Channels, Sink};
use super::format::{self, log_time_ns};
use crate::faults::InjectedFault;
use crate::metrics::Run;
use crate::recording::Watch;

/// Uncompressed size at which a chunk is closed, bytes: the most that one disk error can destroy. The index of all chunks stays in
/// memory until the end, so that smaller chunks would take more of it.
const CHUNK_BYTES: u64 = 256 * 1024;

/// The description of a flight at the beginning of its recording.
#[derive(Clone, Copy, Debug)]
pub struct RecordingInfo<'a> {
    /// The scenario that flies; of a fleet that of its first team.
    pub scenario: &'a Scenario,
    /// The scenario as a complete TOML file.
    pub scenario_toml: &'a str,
    /// The run: program, seed and target.
    pub run: &'a Run,
    /// Whether the recording is that of a fleet: places of vehicles, events and faults of all teams.
    pub is_fleet: bool,
}

/// A recording of a swarm or of a fleet that is being written. The first error stops the writing; [`Writer::finish`]
/// returns it.
pub type Writer<W> = Channels<McapFile<W>>;

/// The MCAP file that the messages of a recording go to.
pub struct McapFile<W: Write + Seek> {
    mcap: mcap::Writer<W>,
    /// Log time of time 0 of the calls through [`Watch`], ns.
    zero_ns: u64,
    /// Sequence number of each channel's next message.
    sequences: BTreeMap<u16, u32>,
    failed: Option<RecordError>,
}

impl<W: Write + Seek> Writer<W> {
    /// Begins a recording with the description of the flight. `clock` is the origin of log times, as text for the reader.
    /// Times of calls through [`Watch`] count from `zero_ns`.
    ///
    /// # Errors
    /// The recording cannot be written.
    pub fn begin(to: W, about: &RecordingInfo<'_>, clock: &str, zero_ns: u64) -> Result<Self, RecordError> {
        let begin = if about.is_fleet { Self::of_fleet } else { Self::new };
        let mut writer = begin(McapFile::new(to, about, clock, zero_ns)?, about.scenario)?;
        writer.draw(zero_ns);
        writer.flush();
        Ok(writer)
    }

    /// Records the log time at which the figures' window begins, ns.
    pub fn window_begins(&mut self, log_time_ns: u64) {
        self.write_metadata_record(format::BEGINS, &[(format::LOG_TIME, log_time_ns)]);
    }

    /// Records the log time at which the figures' window ends, ns.
    pub fn window_ends(&mut self, log_time_ns: u64) {
        self.write_metadata_record(format::ENDS, &[(format::LOG_TIME, log_time_ns)]);
    }

    /// Closes the current chunk and flushes it to the underlying writer.
    pub fn flush(&mut self) {
        self.sink.attempt(|mcap| mcap.flush());
    }

    /// Completes the recording and returns the underlying writer; `dropped` is the number of messages that were dropped
    /// because they came faster than they could be written.
    ///
    /// # Errors
    /// The first error since the beginning.
    pub fn finish(mut self, dropped: u64) -> Result<W, RecordError> {
        let refused = self.refused;
        self.write_metadata_record(format::RECORDER, &[("refused_steps", refused), ("dropped", dropped)]);
        let mut file = self.sink;
        file.attempt(|mcap| mcap.finish().map(|_| ()));
        match file.failed {
            Some(error) => Err(error),
            None => Ok(file.mcap.into_inner()),
        }
    }

    /// The first error so far, if there was one.
    pub fn failed(&self) -> Option<&RecordError> {
        self.sink.failed.as_ref()
    }

    fn write_metadata_record(&mut self, name: &str, values: &[(&str, u64)]) {
        let metadata = values.iter().map(|(key, value)| ((*key).to_owned(), value.to_string())).collect();
        self.sink.attempt(|mcap| mcap.write_metadata(&format::record(name, metadata)));
    }
}

impl<W: Write + Seek> McapFile<W> {
    /// Begins a file with the description of the flight.
    fn new(to: W, about: &RecordingInfo<'_>, clock: &str, zero_ns: u64) -> Result<Self, RecordError> {
        let mut mcap = options().create(to)?;
        mcap.write_metadata(&format::record(format::RUN, run_record(about.run, clock)))?;
        mcap.attach(&Attachment {
            log_time: zero_ns,
            create_time: zero_ns,
            name: format::SCENARIO.to_owned(),
            media_type: "application/toml".to_owned(),
            data: about.scenario_toml.as_bytes().into(),
        })?;
        Ok(Self { mcap, zero_ns, sequences: BTreeMap::new(), failed: None })
    }

    fn attempt(&mut self, write: impl FnOnce(&mut mcap::Writer<W>) -> mcap::McapResult<()>) {
        if self.failed.is_none() {
            self.failed = write(&mut self.mcap).err().map(RecordError::Write);
        }
    }
}

impl<W: Write + Seek> Sink for McapFile<W> {
    fn add_schema(&mut self, name: &str, encoding: &str, data: &[u8]) -> Result<u16, RecordError> {
        Ok(self.mcap.add_schema(name, encoding, data)?)
    }

    fn add_channel(&mut self, topic: &str, schema: u16, encoding: &str) -> Result<u16, RecordError> {
        Ok(self.mcap.add_channel(schema, topic, encoding, &BTreeMap::new())?)
    }

    fn put(&mut self, channel_id: u16, log_time_ns: u64, message: &[u8]) {
        let next = self.sequences.entry(channel_id).or_default();
        let sequence = std::mem::replace(next, next.wrapping_add(1));
        let header = MessageHeader { channel_id, sequence, log_time: log_time_ns, publish_time: log_time_ns };
        self.attempt(|mcap| mcap.write_to_known_channel(&header, message));
    }
}

/// The options of all our MCAP files.
pub(super) fn options() -> WriteOptions {
    WriteOptions::new()
        .compression(Some(Compression::Zstd))
        // Compression in the caller's thread makes the same bytes on every computer.
        .compression_threads(0)
        .chunk_size(Some(CHUNK_BYTES))
        // A chunk is written when it is complete: the file never contains a part of an open chunk.
        .disable_seeking(true)
        .library(format!("skein {}", env!("CARGO_PKG_VERSION")))
}

/// Records a flight in virtual time.
impl<W: Write + Seek> Watch for Writer<W> {
    fn step(&mut self, t_s: f64, trace: &Trace) {
        Self::step(self, log_time_ns(self.sink.zero_ns, t_s), trace);
    }

    fn event(&mut self, t_s: f64, sender: VehicleId, what: &EventKind) {
        Self::event(self, log_time_ns(self.sink.zero_ns, t_s), sender, None, what);
    }

    fn fault(&mut self, t_s: f64, fault: &InjectedFault) {
        Self::fault(self, log_time_ns(self.sink.zero_ns, t_s), None, fault);
    }
}

fn run_record(run: &Run, clock: &str) -> BTreeMap<String, String> {
    let Run { scenario, target, seed, version, revision, .. } = run;
    let entries = [
        ("format", format::FORMAT.to_owned()),
        ("scenario", scenario.clone()),
        ("target", target.clone()),
        ("seed", seed.to_string()),
        ("version", version.clone()),
        ("revision", revision.clone()),
        ("clock", clock.to_owned()),
    ];
    entries.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
}
