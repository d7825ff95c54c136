//! The recording of a fleet: where every vehicle was, about once a second, with the events and faults of all teams. A study
//! and a live recording write the same.
//!
//! A step of a vehicle with all that its agent knows takes kilobytes; ten thousand vehicles at 10 Hz would fill a disk. So a
//! fleet's recording has only places, on one channel, and the teams that the scenario chooses have a full recording each.
//!
//! | topic | content |
//! | --- | --- |
//! | `/teams` | places and mission steps of a team's vehicles |
//! | `/events`, `/faults` | those of all teams, each with its team |

use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use mcap::Attachment;
use mcap::records::MessageHeader;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use skein_common::frame::PositionNed;
use skein_common::id::{TeamId, VehicleId};
use skein_common::message::{EventKind, Severity};

use super::draft::Draft;
use super::format::{self, log_time_ns};
use super::scan::{Piece, scan};
use super::writer::options;
use super::{RecordError, schema};
use crate::faults::InjectedFault;
use crate::metrics::Run;
use crate::recording::Lacks;

/// File name of a fleet's recording in the folder of a run.
pub const FLEET_FILE: &str = "fleet.mcap";
pub(super) const TEAMS: &str = "/teams";

/// The places of a team's vehicles at one instant: a message on `/teams`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TeamPlaces {
    /// The team.
    pub team: TeamId,
    /// Time from the beginning of the figures' window, s.
    pub t_s: f64,
    /// The vehicles whose agents run.
    pub vehicles: Vec<VehiclePlace>,
}

/// One vehicle of [`TeamPlaces`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct VehiclePlace {
    /// The vehicle.
    pub id: VehicleId,
    /// Its mission step.
    pub step: u32,
    /// North of the fleet's origin, m, to the decimetre.
    pub north_m: f64,
    /// East of the fleet's origin, m, to the decimetre.
    pub east_m: f64,
    /// Above the origin, m, to the decimetre.
    pub altitude_m: f64,
    /// Whether it is in formation.
    #[serde(default)]
    pub in_place: bool,
}

impl VehiclePlace {
    /// The vehicle at this mission step and place in the fleet's frame, so high above its team's origin, in formation or not.
    pub fn new(id: VehicleId, step: u32, in_fleet: PositionNed, altitude_m: f64, in_place: bool) -> Self {
        let decimetre = |metres: f64| (metres * 10.0).round() / 10.0;
        let (north_m, east_m) = (decimetre(in_fleet.north_m()), decimetre(in_fleet.east_m()));
        Self { id, step, north_m, east_m, altitude_m: decimetre(altitude_m), in_place }
    }
}

/// An event or a fault of a team.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub(super) struct TeamLine {
    /// The team.
    pub(super) team: TeamId,
    /// The vehicle; null if a fault affects links.
    pub(super) vehicle: Option<VehicleId>,
    /// What happened.
    pub(super) text: String,
    /// How severe it is.
    #[serde(default)]
    pub(super) severity: Severity,
}

/// Writes a fleet's recording. That of a study appears when it is complete; a live one grows, and what was flushed can be
/// read and repaired if the program is killed.
pub struct FleetWriter {
    mcap: mcap::Writer<BufWriter<File>>,
    path: PathBuf,
    /// `None` of a live recording.
    draft: Option<Draft>,
    /// Log time of the beginning of the window, ns.
    zero_ns: u64,
    places: u16,
    events: u16,
    faults: u16,
    sequence: u32,
}

impl FleetWriter {
    /// Begins the recording of this run in virtual time at `path`; `scenario_toml` is the complete file. Log time 0 is the
    /// beginning of the window.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(crate) fn new(path: &Path, run: &Run, scenario_toml: &str) -> Result<Self, RecordError> {
        let draft = Draft::new(path);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(|error| draft.error(error))?;
        }
        let file = draft.create()?;
        Self::begin(file, path, Some(draft), run, scenario_toml)
    }

    /// Begins the recording of a live flight at `path`, where no file may be. Its window begins with
    /// [`Self::window_begins`].
    ///
    /// # Errors
    /// If the file exists already or cannot be written.
    pub fn live(path: &Path, run: &Run, scenario_toml: &str) -> Result<Self, RecordError> {
        let file = File::options().write(true).create_new(true).open(path);
        let file = file.map_err(|error| RecordError::Io { path: path.to_owned(), error })?;
        Self::begin(file, path, None, run, scenario_toml)
    }

    fn begin(
        file: File,
        path: &Path,
        draft: Option<Draft>,
        run: &Run,
        scenario_toml: &str,
    ) -> Result<Self, RecordError> {
        let mut mcap = options().create(BufWriter::new(file))?;
        let entries = [
            ("format", format::FORMAT.to_owned()),
            ("scenario", run.scenario.clone()),
            ("target", run.target.clone()),
            ("seed", run.seed.to_string()),
            ("version", run.version.clone()),
            ("revision", run.revision.clone()),
        ];
        let entries = entries.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
        mcap.write_metadata(&format::record(format::RUN, entries))?;
        mcap.attach(&Attachment {
            log_time: 0,
            create_time: 0,
            name: format::SCENARIO.to_owned(),
            media_type: "application/toml".to_owned(),
            data: scenario_toml.as_bytes().into(),
        })?;
        let mut channel = |name: &str, topic: &str, schema: serde_json::Value| -> Result<u16, RecordError> {
            let schema = mcap.add_schema(name, "jsonschema", schema.to_string().as_bytes())?;
            Ok(mcap.add_channel(schema, topic, "json", &Default::default())?)
        };
        let places = channel("skein.TeamPlaces", TEAMS, schema::of::<TeamPlaces>("skein.TeamPlaces"))?;
        let events = channel("skein.TeamEvent", format::EVENTS, schema::of::<TeamLine>("skein.TeamEvent"))?;
        let faults = channel("skein.TeamFault", format::FAULTS, schema::of::<TeamLine>("skein.TeamFault"))?;
        let path = path.to_owned();
        Ok(Self { mcap, path, draft, zero_ns: 0, places, events, faults, sequence: 0 })
    }

    /// The window of a live recording begins at this log time, ns.
    pub fn window_begins(&mut self, log_time_ns: u64) {
        self.zero_ns = log_time_ns;
    }

    /// Writes everything recorded so far into the file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        Ok(self.mcap.flush()?)
    }

    /// Records the places of a team's vehicles.
    ///
    /// # Errors
    /// If they cannot be written.
    pub fn places(&mut self, places: &TeamPlaces) -> Result<(), RecordError> {
        self.put(self.places, places.t_s, places)
    }

    /// Records an event that a vehicle reported of itself.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn event(&mut self, t_s: f64, team: TeamId, vehicle: VehicleId, what: &EventKind) -> Result<(), RecordError> {
        let (vehicle, text, severity) = (Some(vehicle), what.to_string(), what.severity());
        self.put(self.events, t_s, &TeamLine { team, vehicle, text, severity })
    }

    /// Records a fault that was injected into a team.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn fault(&mut self, t_s: f64, team: TeamId, fault: &InjectedFault) -> Result<(), RecordError> {
        let (vehicle, text) = (format::vehicle_of(fault), fault.to_string());
        let line = TeamLine { team, vehicle, text, severity: Severity::Error };
        self.put(self.faults, t_s, &line)
    }

    /// Completes the recording.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn finish(self) -> Result<(), RecordError> {
        let Self { mut mcap, path, draft, .. } = self;
        let failed = |error: std::io::Error| RecordError::Io { path: path.clone(), error };
        mcap.finish()?;
        let file = mcap.into_inner().into_inner().map_err(|error| failed(error.into_error()))?;
        match draft {
            Some(draft) => draft.finish(&file),
            None => file.sync_all().map_err(failed),
        }
    }

    fn put(&mut self, channel_id: u16, t_s: f64, message: &impl Serialize) -> Result<(), RecordError> {
        // Structs of finite numbers and texts always have a JSON form.
        let Ok(bytes) = serde_json::to_vec(message) else { return Ok(()) };
        let log_time = log_time_ns(self.zero_ns, t_s);
        let header = MessageHeader { channel_id, sequence: self.sequence, log_time, publish_time: log_time };
        self.sequence = self.sequence.wrapping_add(1);
        Ok(self.mcap.write_to_known_channel(&header, &bytes)?)
    }
}

/// The recording of a fleet.
#[derive(Clone, Debug, PartialEq)]
pub struct FleetPlaces {
    /// All places, in the order of time and team.
    pub places: Vec<TeamPlaces>,
    /// What its file lacks.
    pub lacks: Lacks,
}

/// Reads a fleet's recording.
///
/// # Errors
/// The file cannot be read, or is not the recording of a fleet.
pub fn read_fleet(path: &Path) -> Result<FleetPlaces, RecordError> {
    let bytes = fs::read(path).map_err(|error| RecordError::Io { path: path.to_owned(), error })?;
    let (mut places, mut lacks) = (Vec::new(), Lacks::default());
    let found = scan(&bytes, |piece| {
        if let Piece::Message(channel, _, data) = piece
            && channel.topic == TEAMS
        {
            let what =
                |error: serde_json::Error| RecordError::Message { topic: TEAMS.to_owned(), what: error.to_string() };
            places.push(serde_json::from_slice(data).map_err(what)?);
        }
        if let Piece::Metadata(metadata) = piece {
            format::add_lacks(&mut lacks, &metadata);
        }
        Ok(())
    });
    let found = found.map_err(|error| error.reading(path))?;
    let lacks = Lacks { end: lacks.end || found.is_cut, pieces: lacks.pieces + found.damaged, ..lacks };
    Ok(FleetPlaces { places, lacks })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_recorded_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a").join(FLEET_FILE);
        let mut writer = FleetWriter::new(&path, &Run::default(), "[fleet]\nteams = 2\n").unwrap();
        let place = |number: u8, north_m: f64| VehiclePlace {
            id: VehicleId::new(number).unwrap(),
            step: 1,
            north_m,
            east_m: -12.3,
            altitude_m: 30.0,
            in_place: true,
        };
        let team = |team: u16, t_s: f64| TeamPlaces {
            team: TeamId::new(team).unwrap(),
            t_s,
            vehicles: vec![place(1, 24_000.1), place(2, t_s)],
        };
        let written = [team(1, 0.0), team(2, 0.0), team(1, 1.0)];
        written.iter().for_each(|places| writer.places(places).unwrap());
        writer.event(1.0, TeamId::FIRST, VehicleId::new(1).unwrap(), &EventKind::Landed).unwrap();
        assert!(!path.exists(), "not before it is complete");
        writer.finish().unwrap();
        assert_eq!(read_fleet(&path).unwrap(), FleetPlaces { places: written.to_vec(), lacks: Lacks::default() });
    }
}
