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

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use skein_common::frame::PositionNed;
use skein_common::id::{TeamId, VehicleId};
use skein_common::message::Severity;

use super::reader::parse;
use super::scan::{Piece, scan_file};
use super::{RecordError, format};
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
    /// The event or fault as a text.
    pub(super) text: String,
    /// Its severity.
    #[serde(default)]
    pub(super) severity: Severity,
}

/// The recording of a fleet.
#[derive(Clone, Debug, PartialEq)]
pub struct FleetPlaces {
    /// All places, in the order of time and team.
    pub places: Vec<TeamPlaces>,
    /// The parts of the flight that its file lacks.
    pub lacks: Lacks,
}

/// Reads a fleet's recording.
///
/// # Errors
/// The file cannot be read, or is not the recording of a fleet.
pub fn read_fleet(path: &Path) -> Result<FleetPlaces, RecordError> {
    let (mut places, mut lacks) = (Vec::new(), Lacks::default());
    let found = scan_file(path, |piece| {
        match piece {
            Piece::Message(channel, _, data) if channel.topic == TEAMS => places.push(parse(TEAMS, data)?),
            Piece::Metadata(metadata) => format::add_lacks(&mut lacks, &metadata),
            _ => {}
        }
        Ok(())
    });
    let found = found.map_err(|error| error.reading(path))?;
    let lacks = Lacks { end: lacks.end || found.is_cut, pieces: lacks.pieces + found.damaged, ..lacks };
    Ok(FleetPlaces { places, lacks })
}

#[cfg(test)]
pub(super) mod tests;
