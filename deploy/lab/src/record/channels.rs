//! The channels of a flight: the same for a recording and for a live server, so that a program that reads one reads the other.

use std::borrow::Cow;
use std::collections::BTreeMap;

use foxglove::Encode;
use foxglove::messages::{FrameTransforms, LocationFix, Log, SceneUpdate};
use schemars::JsonSchema;
use serde::Serialize;
use skein_common::frame::Origin;
use skein_common::id::{TeamId, VehicleId, VehicleName};
use skein_common::message::{EventKind, Header, Message, Severity, Trace};
use skein_common::scenario::{Formation, Scenario};
use skein_common::state::Membership;

use super::fleet::{TEAMS, TeamLine, TeamPlaces};
use super::format::{self, EventLine, FaultLine, seconds_since};
use super::{RecordError, scene, schema};
use crate::faults::InjectedFault;

/// Time after which a silent vehicle no longer determines the drawn centre, s.
const SILENT_S: f64 = 1.0;
/// Time from one position on the globe to the next, ns: a map needs no more, and the trace has every position. All vehicles publish
/// theirs at the same times, so that most chunks of a recording have none, and its index stays small.
const LOCATION_NS: u64 = 500_000_000;

/// The destination of the channels' messages: a file, or the clients of a live server.
pub trait Sink {
    /// Adds a schema: its name, its encoding and its definition. Returns its number.
    ///
    /// # Errors
    /// The schema cannot be written.
    fn add_schema(&mut self, name: &str, encoding: &str, data: &[u8]) -> Result<u16, RecordError>;

    /// Adds a channel whose messages have this schema and encoding. Returns its number.
    ///
    /// # Errors
    /// The channel cannot be written.
    fn add_channel(&mut self, topic: &str, schema: u16, encoding: &str) -> Result<u16, RecordError>;

    /// Whether a message of this channel has a reader. A message without one is not even encoded.
    fn is_read(&self, _channel: u16) -> bool {
        true
    }

    /// Takes a message of a channel, with its log time in nanoseconds.
    fn put(&mut self, channel: u16, log_time_ns: u64, message: &[u8]);
}

/// The channels of a swarm's flight, or of a fleet's. Every message goes to the sink at once.
pub struct Channels<S> {
    /// The destination of the messages.
    pub sink: S,
    /// The number of each channel, by topic. A fleet has only places, events and faults, a swarm everything but places.
    numbers: BTreeMap<String, u16>,
    origin: Origin,
    ids: Vec<VehicleId>,
    /// The scenario as written, for the formation of each step of the mission.
    scenario: Scenario,
    /// Log time at which each active member was last observed as one, ns.
    members: BTreeMap<VehicleId, u64>,
    /// The period of [`LOCATION_NS`] in which each vehicle's position on the globe was published last.
    located: BTreeMap<VehicleId, u64>,
    /// The formation that was drawn last.
    drawn: Option<Formation>,
    /// Number of steps that were refused because of impossible values.
    pub refused: u64,
    bytes: Vec<u8>,
}

impl<S: Sink> Channels<S> {
    /// Adds the channels of a swarm that flies this scenario.
    ///
    /// # Errors
    /// The sink does not take a channel.
    pub fn new(mut sink: S, scenario: &Scenario) -> Result<Self, RecordError> {
        let trace = json_schema::<Trace>(&mut sink, "skein.Trace")?;
        let event = json_schema::<EventLine<'_>>(&mut sink, "skein.Event")?;
        let fault = json_schema::<FaultLine<'_>>(&mut sink, "skein.Fault")?;
        let location = foxglove_schema::<LocationFix>(&mut sink)?;
        let transforms = foxglove_schema::<FrameTransforms>(&mut sink)?;
        let scene = foxglove_schema::<SceneUpdate>(&mut sink)?;
        let log = foxglove_schema::<Log>(&mut sink)?;
        let mut channels = Self::without_channels(sink, scenario);
        for id in scenario.ids() {
            channels.add(format::trace_topic(id), trace)?;
            channels.add(format::location_topic(id), location)?;
        }
        channels.add(format::EVENTS, event)?;
        channels.add(format::FAULTS, fault)?;
        channels.add(format::TRANSFORMS, transforms)?;
        channels.add(format::VEHICLES, scene)?;
        channels.add(format::FORMATION, scene)?;
        channels.add(format::LOG, log)?;
        Ok(channels)
    }

    /// Adds the channels of a fleet whose first team flies this scenario.
    ///
    /// # Errors
    /// The sink does not take a channel.
    pub(super) fn of_fleet(sink: S, scenario: &Scenario) -> Result<Self, RecordError> {
        let mut channels = Self::without_channels(sink, scenario);
        let places = json_schema::<TeamPlaces>(&mut channels.sink, "skein.TeamPlaces")?;
        channels.add(TEAMS, places)?;
        for (topic, name) in [(format::EVENTS, "skein.TeamEvent"), (format::FAULTS, "skein.TeamFault")] {
            let line = json_schema::<TeamLine>(&mut channels.sink, name)?;
            channels.add(topic, line)?;
        }
        Ok(channels)
    }

    fn without_channels(sink: S, scenario: &Scenario) -> Self {
        Self {
            numbers: BTreeMap::new(),
            sink,
            origin: Origin::new(scenario.origin.geodetic()),
            ids: scenario.ids().collect(),
            scenario: scenario.clone(),
            members: BTreeMap::new(),
            located: BTreeMap::new(),
            drawn: None,
            refused: 0,
            bytes: Vec::new(),
        }
    }

    fn add(&mut self, topic: impl Into<String>, (schema, encoding): Schema) -> Result<(), RecordError> {
        let topic = topic.into();
        let number = self.sink.add_channel(&topic, schema, encoding)?;
        self.numbers.insert(topic, number);
        Ok(())
    }

    /// Draws the vehicles, and the formation with the next step of a vehicle: at the beginning, and again for a new reader.
    pub fn draw(&mut self, log_time_ns: u64) {
        self.drawn = None;
        let vehicles = scene::vehicles(scene::timestamp(log_time_ns), self.ids.iter().copied());
        self.put_foxglove(format::VEHICLES, log_time_ns, || vehicles);
    }

    /// Publishes a step of a vehicle. A step with impossible values is only counted.
    pub fn step(&mut self, log_time_ns: u64, trace: &Trace) {
        if !trace.is_plausible() {
            self.refused += 1;
            return;
        }
        let (id, time) = (trace.header.sender, scene::timestamp(log_time_ns));
        self.put_json(&format::trace_topic(id), log_time_ns, trace);
        let transform = || scene::vehicle_transform(time, trace);
        self.put_foxglove(format::TRANSFORMS, log_time_ns, transform);
        let period = log_time_ns / LOCATION_NS;
        if self.located.insert(id, period) != Some(period) {
            let location = scene::location(time, &self.origin, trace);
            self.put_foxglove(&format::location_topic(id), log_time_ns, || location);
        }
        self.draw_formation(log_time_ns, trace);
    }

    /// Publishes an event that a vehicle reported of itself, with the header of its message if it came over the network.
    pub fn event(
        &mut self,
        log_time_ns: u64,
        sender: impl Into<VehicleName>,
        header: Option<&Header>,
        what: &EventKind,
    ) {
        let (VehicleName { team, vehicle: sender }, text) = (sender.into(), what.to_string());
        if let Some(team) = team {
            let line = TeamLine { team, vehicle: Some(sender), text, severity: what.severity() };
            return self.put_json(format::EVENTS, log_time_ns, &line);
        }
        self.note(log_time_ns, what.severity(), format!("vehicle {sender}"), text.clone());
        let (incarnation, sequence) = header.map(|header| (header.incarnation, header.sequence)).unzip();
        let line = EventLine { vehicle: sender, incarnation, sequence, text: text.into(), what: *what };
        self.put_json(format::EVENTS, log_time_ns, &line);
    }

    /// Publishes a fault that was injected into the swarm, or into this team of a fleet.
    pub fn fault(&mut self, log_time_ns: u64, team: Option<TeamId>, fault: &InjectedFault) {
        let text = fault.to_string();
        if let Some(team) = team {
            let line = TeamLine { team, vehicle: format::vehicle_of(fault), text, severity: Severity::Error };
            return self.put_json(format::FAULTS, log_time_ns, &line);
        }
        self.note(log_time_ns, Severity::Error, "swarm".to_owned(), text.clone());
        let line = FaultLine { vehicle: format::vehicle_of(fault), text: text.into(), what: Cow::Borrowed(fault) };
        self.put_json(format::FAULTS, log_time_ns, &line);
    }

    /// Publishes the places of a team's vehicles.
    pub fn places(&mut self, log_time_ns: u64, places: &TeamPlaces) {
        self.put_json(TEAMS, log_time_ns, places);
    }

    /// Publishes a line of the log, from source `who`.
    pub fn note(&mut self, log_time_ns: u64, severity: Severity, who: String, what: String) {
        let line = || scene::line(scene::timestamp(log_time_ns), severity, who, what);
        self.put_foxglove(format::LOG, log_time_ns, line);
    }

    /// Draws the centre by the estimate of the active member with the lowest id, and the formation there when it
    /// changes, with the step or with what an operator sets.
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
        let Some(formation) = self.scenario.formation_with(trace.step, &trace.settings) else { return };
        let time = scene::timestamp(log_time_ns);
        let centre = scene::centre_transform(time, trace.centre_ne_m, formation.altitude_m);
        let is_new = self.drawn.as_ref() != Some(&*formation);
        let drawn = is_new.then(|| (scene::formation(time, &formation), formation.into_owned()));
        self.put_foxglove(format::TRANSFORMS, log_time_ns, || centre);
        if let Some((drawing, formation)) = drawn {
            self.drawn = Some(formation);
            self.put_foxglove(format::FORMATION, log_time_ns, || drawing);
        }
    }

    fn put_json(&mut self, topic: &str, log_time_ns: u64, message: &impl Serialize) {
        // Our messages are structs of finite numbers and texts: serialising them cannot fail.
        self.put(topic, log_time_ns, |bytes| serde_json::to_writer(bytes, message).is_ok());
    }

    fn put_foxglove<M: Encode>(&mut self, topic: &str, log_time_ns: u64, message: impl FnOnce() -> M) {
        // Encoding into growing memory cannot fail.
        self.put(topic, log_time_ns, |bytes| message().encode(bytes).is_ok());
    }

    /// Puts what `encode` writes into this channel, if that has a reader. A vehicle outside this swarm has no channel.
    fn put(&mut self, topic: &str, log_time_ns: u64, encode: impl FnOnce(&mut Vec<u8>) -> bool) {
        let channel = self.numbers.get(topic).copied().filter(|channel| self.sink.is_read(*channel));
        let Some(channel) = channel else { return };
        self.bytes.clear();
        if encode(&mut self.bytes) {
            self.sink.put(channel, log_time_ns, &self.bytes);
        }
    }
}

/// The number of a schema with the encoding of its messages.
type Schema = (u16, &'static str);

fn json_schema<M: JsonSchema>(sink: &mut impl Sink, name: &str) -> Result<Schema, RecordError> {
    Ok((sink.add_schema(name, "jsonschema", schema::of::<M>(name).to_string().as_bytes())?, "json"))
}

fn foxglove_schema<M: Encode>(sink: &mut impl Sink) -> Result<Schema, RecordError> {
    let schema = M::get_schema().ok_or(RecordError::Missing("a schema"))?;
    Ok((sink.add_schema(&schema.name, &schema.encoding, &schema.data)?, "protobuf"))
}
