//! Writes a recording.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{Seek, Write};

use foxglove::Encode;
use foxglove::messages::{FrameTransforms, LocationFix, Log, SceneUpdate};
use mcap::records::MessageHeader;
use mcap::{Attachment, Compression, WriteOptions};
use serde::Serialize;
use serde_json::Value;
use skein_common::frame::Origin;
use skein_common::id::VehicleId;
use skein_common::message::{EventKind, Header, Message, Trace};
use skein_common::scenario::{Formation, Scenario};
use skein_common::state::Membership;

use super::format::{self, EventLine, FaultLine, log_time_ns, seconds_since};
use super::{RecordError, scene, schema};
use crate::faults::InjectedFault;
use crate::metrics::Run;
use crate::recording::Watch;

/// Uncompressed size at which a chunk is closed, bytes: the most that one disk error can destroy.
const CHUNK_BYTES: u64 = 64 * 1024;
/// Time after which a silent vehicle no longer determines the drawn centre, s.
const SILENT_S: f64 = 1.0;

/// The description of a flight at the beginning of its recording.
#[derive(Clone, Copy, Debug)]
pub struct RecordingInfo<'a> {
    /// The scenario that flies.
    pub scenario: &'a Scenario,
    /// The scenario as a complete TOML file.
    pub scenario_toml: &'a str,
    /// The run: program, seed and target.
    pub run: &'a Run,
    /// The origin of log times, as text for the reader.
    pub clock: &'a str,
}

/// Writes a recording. The first error stops the writing; [`Self::finish`] returns it.
pub struct Writer<W: Write + Seek> {
    mcap: mcap::Writer<W>,
    channels: Channels,
    origin: Origin,
    /// The formation of each step of the mission.
    formations: Vec<Formation>,
    /// Log time at which each active member was last recorded as one, ns.
    members: BTreeMap<VehicleId, u64>,
    /// The step whose formation was drawn last.
    drawn: Option<u32>,
    /// Log time of time 0 of the calls through [`Watch`], ns.
    zero_ns: u64,
    /// Number of steps that were refused because of impossible values.
    refused: u64,
    failed: Option<RecordError>,
    bytes: Vec<u8>,
}

/// The channel of each kind of message.
struct Channels {
    traces: BTreeMap<VehicleId, Channel>,
    locations: BTreeMap<VehicleId, Channel>,
    events: Channel,
    faults: Channel,
    transforms: Channel,
    vehicles: Channel,
    formation: Channel,
    log: Channel,
}

/// One channel, with the sequence number of its next message.
struct Channel {
    id: u16,
    sequence: u32,
}

impl<W: Write + Seek> Writer<W> {
    /// Begins a recording with the description of the flight. Times of calls through [`Watch`] count from `zero_ns`.
    ///
    /// # Errors
    /// The recording cannot be written.
    pub fn new(to: W, about: &RecordingInfo<'_>, zero_ns: u64) -> Result<Self, RecordError> {
        let mut mcap = options().create(to)?;
        mcap.write_metadata(&format::record(format::RUN, run_record(about)))?;
        mcap.attach(&Attachment {
            log_time: zero_ns,
            create_time: zero_ns,
            name: format::SCENARIO.to_owned(),
            media_type: "application/toml".to_owned(),
            data: about.scenario_toml.as_bytes().into(),
        })?;
        let scenario = about.scenario;
        let mut writer = Self {
            channels: Channels::new(&mut mcap, scenario)?,
            mcap,
            origin: Origin::new(scenario.origin.geodetic()),
            formations: scenario.mission.steps.iter().map(|step| step.formation.clone()).collect(),
            members: BTreeMap::new(),
            drawn: None,
            zero_ns,
            refused: 0,
            failed: None,
            bytes: Vec::new(),
        };
        let vehicles = scene::vehicles(scene::timestamp(zero_ns), scenario.ids());
        writer.write_foxglove(|channels| Some(&mut channels.vehicles), zero_ns, &vehicles);
        writer.flush();
        Ok(writer)
    }

    /// Records a step of a vehicle. A step with impossible values is only counted.
    pub fn step(&mut self, log_time_ns: u64, trace: &Trace) {
        if !trace.is_plausible() {
            self.refused += 1;
            return;
        }
        let (id, time) = (trace.header.sender, scene::timestamp(log_time_ns));
        self.write_json(|channels| channels.traces.get_mut(&id), log_time_ns, trace);
        self.write_foxglove(
            |channels| Some(&mut channels.transforms),
            log_time_ns,
            &scene::vehicle_transform(time, trace),
        );
        let location = scene::location(time, &self.origin, trace);
        self.write_foxglove(|channels| channels.locations.get_mut(&id), log_time_ns, &location);
        self.draw_formation(log_time_ns, trace);
    }

    /// Records an event that a vehicle reported of itself, with the header of its message if it came over the network.
    pub fn event(&mut self, log_time_ns: u64, sender: VehicleId, header: Option<&Header>, what: &EventKind) {
        let text = what.to_string();
        self.note(log_time_ns, matches!(what, EventKind::Failed(_)), format!("vehicle {sender}"), text.clone());
        let (incarnation, sequence) = header.map(|header| (header.incarnation, header.sequence)).unzip();
        let line = EventLine { vehicle: sender, incarnation, sequence, text: text.into(), what: *what };
        self.write_json(|channels| Some(&mut channels.events), log_time_ns, &line);
    }

    /// Records a fault that was injected into the swarm.
    pub fn fault(&mut self, log_time_ns: u64, fault: &InjectedFault) {
        let text = fault.to_string();
        self.note(log_time_ns, true, "swarm".to_owned(), text.clone());
        let line = FaultLine { vehicle: format::vehicle_of(fault), text: text.into(), what: Cow::Borrowed(fault) };
        self.write_json(|channels| Some(&mut channels.faults), log_time_ns, &line);
    }

    /// Records a line of the log, from source `who`.
    pub fn note(&mut self, log_time_ns: u64, is_bad: bool, who: String, what: String) {
        let line = scene::line(scene::timestamp(log_time_ns), is_bad, who, what);
        self.write_foxglove(|channels| Some(&mut channels.log), log_time_ns, &line);
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
        self.attempt(|mcap| mcap.flush());
    }

    /// Completes the recording and returns the underlying writer; `dropped` is the number of messages that were dropped
    /// because they came faster than they could be written.
    ///
    /// # Errors
    /// The first error since the beginning.
    pub fn finish(mut self, dropped: u64) -> Result<W, RecordError> {
        self.write_metadata_record(format::RECORDER, &[("refused_steps", self.refused), ("dropped", dropped)]);
        self.attempt(|mcap| mcap.finish().map(|_| ()));
        match self.failed {
            Some(error) => Err(error),
            None => Ok(self.mcap.into_inner()),
        }
    }

    /// The first error so far, if there was one.
    pub fn failed(&self) -> Option<&RecordError> {
        self.failed.as_ref()
    }

    /// Draws the centre by the estimate of the active member with the lowest id, and the formation there when it
    /// changes.
    fn draw_formation(&mut self, log_time_ns: u64, trace: &Trace) {
        let id = trace.header.sender;
        match trace.membership {
            Membership::Active => self.members.insert(id, log_time_ns),
            Membership::Joining | Membership::Left => self.members.remove(&id),
        };
        self.members.retain(|_, seen_ns| seconds_since(*seen_ns, log_time_ns) < SILENT_S);
        if self.members.keys().next() != Some(&id) {
            return;
        }
        let Some(formation) = self.formations.get(trace.step as usize) else { return };
        let time = scene::timestamp(log_time_ns);
        let centre = scene::centre_transform(time, trace.centre_ne_m, formation.altitude_m);
        let drawing = (self.drawn != Some(trace.step)).then(|| scene::formation(time, formation));
        self.write_foxglove(|channels| Some(&mut channels.transforms), log_time_ns, &centre);
        if let Some(drawing) = drawing {
            self.drawn = Some(trace.step);
            self.write_foxglove(|channels| Some(&mut channels.formation), log_time_ns, &drawing);
        }
    }

    fn write_json(
        &mut self,
        channel: impl FnOnce(&mut Channels) -> Option<&mut Channel>,
        log_time_ns: u64,
        message: &impl Serialize,
    ) {
        self.bytes.clear();
        // Our messages are structs of finite numbers and texts: serialising them cannot fail.
        if serde_json::to_writer(&mut self.bytes, message).is_ok() {
            self.put(channel, log_time_ns);
        }
    }

    fn write_foxglove(
        &mut self,
        channel: impl FnOnce(&mut Channels) -> Option<&mut Channel>,
        log_time_ns: u64,
        message: &impl Encode,
    ) {
        self.bytes.clear();
        // Encoding into growing memory cannot fail.
        if message.encode(&mut self.bytes).is_ok() {
            self.put(channel, log_time_ns);
        }
    }

    /// Writes the contents of `bytes` to the channel. A vehicle outside this swarm has no channel.
    fn put(&mut self, channel: impl FnOnce(&mut Channels) -> Option<&mut Channel>, log_time_ns: u64) {
        let Some(channel) = channel(&mut self.channels) else { return };
        let (channel_id, sequence) = (channel.id, channel.sequence);
        channel.sequence = sequence.wrapping_add(1);
        let header = MessageHeader { channel_id, sequence, log_time: log_time_ns, publish_time: log_time_ns };
        let bytes = std::mem::take(&mut self.bytes);
        self.attempt(|mcap| mcap.write_to_known_channel(&header, &bytes));
        self.bytes = bytes;
    }

    fn write_metadata_record(&mut self, name: &str, values: &[(&str, u64)]) {
        let metadata = values.iter().map(|(key, value)| ((*key).to_owned(), value.to_string())).collect();
        self.attempt(|mcap| mcap.write_metadata(&format::record(name, metadata)));
    }

    fn attempt(&mut self, write: impl FnOnce(&mut mcap::Writer<W>) -> mcap::McapResult<()>) {
        if self.failed.is_none() {
            self.failed = write(&mut self.mcap).err().map(RecordError::Write);
        }
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
        Self::step(self, log_time_ns(self.zero_ns, t_s), trace);
    }

    fn event(&mut self, t_s: f64, sender: VehicleId, what: &EventKind) {
        Self::event(self, log_time_ns(self.zero_ns, t_s), sender, None, what);
    }

    fn fault(&mut self, t_s: f64, fault: &InjectedFault) {
        Self::fault(self, log_time_ns(self.zero_ns, t_s), fault);
    }
}

impl Channels {
    fn new<W: Write + Seek>(mcap: &mut mcap::Writer<W>, scenario: &Scenario) -> Result<Self, RecordError> {
        let trace = json_schema(mcap, schema::TRACE, &schema::trace())?;
        let event = json_schema(mcap, schema::EVENT, &schema::event())?;
        let fault = json_schema(mcap, schema::FAULT, &schema::fault())?;
        let location = foxglove_schema::<LocationFix, W>(mcap)?;
        let transforms = foxglove_schema::<FrameTransforms, W>(mcap)?;
        let scene = foxglove_schema::<SceneUpdate, W>(mcap)?;
        let log = foxglove_schema::<Log, W>(mcap)?;
        let mut channel = |topic: &str, (schema, encoding): (u16, &str)| -> Result<Channel, RecordError> {
            Ok(Channel { id: mcap.add_channel(schema, topic, encoding, &BTreeMap::new())?, sequence: 0 })
        };
        let (mut traces, mut locations) = (BTreeMap::new(), BTreeMap::new());
        for id in scenario.ids() {
            traces.insert(id, channel(&format::trace_topic(id), trace)?);
            locations.insert(id, channel(&format::location_topic(id), location)?);
        }
        Ok(Self {
            traces,
            locations,
            events: channel(format::EVENTS, event)?,
            faults: channel(format::FAULTS, fault)?,
            transforms: channel(format::TRANSFORMS, transforms)?,
            vehicles: channel(format::VEHICLES, scene)?,
            formation: channel(format::FORMATION, scene)?,
            log: channel(format::LOG, log)?,
        })
    }
}

/// A schema with the encoding of its messages.
type Schema = (u16, &'static str);

fn json_schema<W: Write + Seek>(mcap: &mut mcap::Writer<W>, name: &str, schema: &Value) -> Result<Schema, RecordError> {
    Ok((mcap.add_schema(name, "jsonschema", schema.to_string().as_bytes())?, "json"))
}

fn foxglove_schema<M: Encode, W: Write + Seek>(mcap: &mut mcap::Writer<W>) -> Result<Schema, RecordError> {
    let schema = M::get_schema().ok_or(RecordError::Missing("a schema"))?;
    Ok((mcap.add_schema(&schema.name, &schema.encoding, &schema.data)?, "protobuf"))
}

fn run_record(about: &RecordingInfo<'_>) -> BTreeMap<String, String> {
    let Run { scenario, target, seed, version, revision, .. } = about.run;
    let entries = [
        ("format", format::FORMAT.to_owned()),
        ("scenario", scenario.clone()),
        ("target", target.clone()),
        ("seed", seed.to_string()),
        ("version", version.clone()),
        ("revision", revision.clone()),
        ("clock", about.clock.to_owned()),
    ];
    entries.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
}
