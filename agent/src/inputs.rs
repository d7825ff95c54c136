//! The inputs of a vehicle's station and its outputs, in a file: `skein replay` runs the station again with them.
//!
//! ```text
//!   file    = "skein inputs" version (u16) chunk chunk ...        numbers are little-endian
//!   chunk   = length (u32) checksum (8 bytes of SHA-256) content (this many bytes)
//!   content = what flies, in the first chunk; else the inputs of a step, its outputs, the inputs of the next step, ...
//! ```
//!
//! A replay needs every input since the agent's start, because what an agent knows comes from all of them. The control
//! thread encodes them and hands a chunk a second to another thread, which never makes it wait. That thread keeps them in
//! memory up to [`MEMORY_BYTES`] and then in a file. If nothing has gone wrong by the end of the flight, it removes the file.
//! A fault of [`is_fault`], a panic of the control thread, and `record.inputs` leave it.

mod reader;
mod recorder;
#[cfg(test)]
mod tests;

use ring::digest::{SHA256, digest};
use serde::{Deserialize, Serialize};
use skein_common::id::{Incarnation, InvalidFleetVehicle, VehicleName};
use skein_common::message::{EventKind, Severity};
use skein_common::scenario::{self, ScenarioError, Source};
use skein_core::aircraft::{Aircraft, AircraftError};
use skein_core::control::{FisError, Rules};
use skein_core::formation::UnsupportedScenario;
use skein_core::station::{Clocks, Station};

pub use reader::{InputsReader, RecordedStep};
pub use recorder::{FINISH_TIMEOUT, Recorder};

/// Ending of the name of a file of inputs.
pub const EXTENSION: &str = "inputs";
/// Largest memory for the inputs of an agent that writes no file yet, bytes: ten minutes in a swarm of eight.
pub const MEMORY_BYTES: usize = 8 << 20;
/// Largest file of inputs, bytes; what follows is not kept.
pub const FILE_BYTES: u64 = 1 << 30;

const MAGIC: [u8; 12] = *b"skein inputs";
/// Version of the file. A change of any type that enters or leaves a station is a new version, too.
const VERSION: u16 = 1;
/// Bytes of a chunk's checksum.
const CHECKSUM: usize = 8;

/// The first chunk of a file of inputs: what flies.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Flown {
    /// Release that flew.
    pub release: String,
    /// The complete scenario file.
    pub scenario: String,
    /// Name of the vehicle, with its team in a fleet.
    pub vehicle: String,
    /// Incarnation of its agent.
    pub incarnation: Incarnation,
    /// Time for which an earlier agent had flown the vehicle, s; `None` for the first agent.
    pub flown_s: Option<f64>,
    /// The vehicle's aircraft file.
    pub aircraft: String,
    /// The rule bases for roll, pitch, heading and collective; `None` for those that come with the program.
    pub rules: Option<[String; 4]>,
}

/// The reason why a file of inputs cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum InputsError {
    /// The file is of another kind.
    #[error("this is not a file of an agent's inputs; an agent writes NUMBER-INCARNATION.inputs beside its log")]
    OtherKind,
    /// The file has another version.
    #[error(
        "this file has version {0} of the inputs, and this program reads version {VERSION}: replay it with the release that \
         flew"
    )]
    OtherVersion(u16),
    /// The file ends before its first chunk.
    #[error("the file was cut off before its first step; nothing can be replayed")]
    Empty,
    /// A chunk, from its first byte to its end, differs from its checksum.
    #[error("bytes {0} to {1} do not match their checksum, so the file was changed or damaged there")]
    Damaged(usize, usize),
    /// A chunk has its checksum and cannot be decoded.
    #[error(
        "what begins at byte {0} cannot be decoded: another release of Skein flew, so replay the file with that one"
    )]
    Undecodable(usize),
    /// The scenario in the file is not valid for this program.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The name of the vehicle is not one.
    #[error("the vehicle of the file, {0:?}: {1}")]
    Vehicle(String, #[source] InvalidFleetVehicle),
    /// The vehicle is not in the scenario.
    #[error("vehicle {0} does not fly in the scenario of the file")]
    NotInScenario(VehicleName),
    /// The aircraft in the file is not valid for this program.
    #[error(transparent)]
    Aircraft(#[from] AircraftError),
    /// The rules in the file are not valid for this program.
    #[error(transparent)]
    Rules(#[from] FisError),
    /// This program cannot fly the scenario.
    #[error(transparent)]
    UnsupportedScenario(#[from] UnsupportedScenario),
}

impl Flown {
    /// The station as it was when the agent started.
    ///
    /// # Errors
    /// If what flies is not valid for this program.
    pub fn station(&self) -> Result<Station, InputsError> {
        let described = scenario::load_any(&Source { name: "scenario.toml", text: &self.scenario }, &[])?;
        let name: VehicleName =
            self.vehicle.parse().map_err(|source| InputsError::Vehicle(self.vehicle.clone(), source))?;
        let swarm = described.into_team(name.team).ok_or(InputsError::NotInScenario(name))?;
        let scenario = swarm.scenario;
        scenario.vehicle(name.vehicle).ok_or(InputsError::NotInScenario(name))?;
        let aircraft = Aircraft::from_text("aircraft.toml", &self.aircraft)?;
        let names = ["roll.fis", "pitch.fis", "heading.fis", "collective.fis"];
        let rules = match &self.rules {
            Some(texts) => Rules::from_texts(std::array::from_fn(|axis| (names[axis], texts[axis].as_str())))?,
            None => Rules::shipped(),
        };
        let clocks = Clocks::new(&scenario, name.vehicle).after(self.flown_s);
        Ok(Station::new(&scenario, name.vehicle, self.incarnation, (&aircraft, rules), clocks)?)
    }
}

/// Whether an agent leaves its inputs in a file after this event: after every error but a gap in the own data, which a busy PC
/// makes often and which is a lost simulator if it lasts.
pub fn is_fault(event: &EventKind) -> bool {
    event.severity() == Severity::Error && *event != EventKind::OwnDataStale
}

/// The beginning of a file: its kind, and what flies.
fn beginning(flown: &Flown) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend(chunk(&encoded(flown)));
    bytes
}

/// A chunk with this content.
fn chunk(content: &[u8]) -> Vec<u8> {
    let mut chunk = Vec::with_capacity(4 + CHECKSUM + content.len());
    chunk.extend((content.len() as u32).to_le_bytes());
    chunk.extend(checksum(content));
    chunk.extend(content);
    chunk
}

fn checksum(content: &[u8]) -> [u8; CHECKSUM] {
    let whole = digest(&SHA256, content);
    std::array::from_fn(|nth| whole.as_ref()[nth])
}

fn encoded(value: &impl Serialize) -> Vec<u8> {
    encoded_after(Vec::new(), value)
}

/// These bytes, and the value after them.
fn encoded_after(bytes: Vec<u8>, value: &impl Serialize) -> Vec<u8> {
    // Memory that grows takes every value, and no type of ours has a part that cannot be encoded.
    #[expect(clippy::expect_used, reason = "memory that grows takes every value")]
    postcard::to_extend(value, bytes).expect("a value is encoded")
}
