//! Recordings of flights: one MCAP file for each flight, which Foxglove, PlotJuggler and Python's `mcap` open and this
//! module reads back.
//!
//! | topic | schema | content |
//! | --- | --- | --- |
//! | `/vehicle/N/trace` | `skein.Trace`, JSON | every step of a vehicle, with its complete trace |
//! | `/events` | `skein.Event`, JSON | events that vehicles reported of themselves |
//! | `/faults` | `skein.Fault`, JSON | faults that were injected into the swarm |
//! | `/tf` | `foxglove.FrameTransforms` | frames `vehicle/N` and `centre` in the root frame `world` |
//! | `/vehicle/N/location` | `foxglove.LocationFix` | position on the globe, twice a second |
//! | `/scene/vehicles`, `/scene/formation` | `foxglove.SceneUpdate` | helicopters; the formation's ellipse and band |
//! | `/log` | `foxglove.Log` | events and faults as text |
//!
//! The file also has the metadata records `skein.run` (the scenario and the program), `skein.window_begins` and
//! `skein.window_ends` (log times of the figures' window) and `skein.recorder` (counts of what could not be recorded),
//! and the complete `scenario.toml` as an attachment.
//!
//! **Log time** is in nanoseconds. In virtual time, 0 is the beginning of the window; in real time, log time is the UTC
//! time at which the recorder received the message. Times read back are rounded to the nanosecond. Every other number is written
//! so that it can be read back to the last bit, as Python does; `serde_json` may miss that bit.
//!
//! **Frames**: `world` is east, north, up at the scenario's origin; a vehicle's frame is forward, left, up. The JSON
//! channels keep the program's own NED and FRD.
//!
//! **Damaged files**: messages are written in chunks, each with a checksum. An intact chunk can be read even if the file behind
//! it is cut off or damaged. A message is on disk, in an intact chunk, within [`FLUSH`] of its recording. The scenario has the
//! checksum of an attachment. MCAP has no checksum for metadata: each metadata record of a recording carries its own, as
//! `skein.checksum`. Older recordings have none, and are read without it. If a damaged record may have been the beginning or the
//! end of the window, the reader refuses the file, and so it does for every file repaired or merged from it: without the window
//! no step has a time.

mod channels;
mod copy;
mod csv;
mod draft;
mod fleet;
mod format;
mod merge;
mod player;
mod reader;
mod repair;
mod scan;
mod scene;
mod schema;
mod writer;

use std::path::{Path, PathBuf};
use std::time::Duration;

use mcap::McapError;
use skein_common::scenario::ScenarioError;

use crate::terminal::of_writing;

pub use channels::{Channels, Sink};
pub use csv::csv;
pub(crate) use draft::Draft;
pub use fleet::{FLEET_FILE, FleetPlaces, TeamPlaces, VehiclePlace, read_fleet};
pub(crate) use format::log_time_ns;
pub use merge::merge;
pub use player::{PlayedEvent, PlayedPlace, Player, Replay};
pub use reader::read;
pub use repair::{Repaired, repair};
pub use writer::{McapFile, RecordingInfo, Writer};

/// File name of the recording in the folder of a run.
pub const FILE: &str = "run.mcap";
/// Longest time until a recorded message is on disk.
pub const FLUSH: Duration = Duration::from_millis(200);

/// The reason why a recording cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The operating system reported an error.
    #[error("{path}: {error}", path = path.display(), error = of_writing(.error))]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        error: std::io::Error,
    },
    /// The file is not an MCAP file.
    #[error("not an MCAP file, so no recording")]
    NoMcap,
    /// The file was not written by Skein, or is cut off before its scenario.
    #[error("not a recording of Skein: {0} is missing")]
    Missing(&'static str),
    /// The file has the format of another version of Skein.
    #[error("the recording has format {0}; this program reads format {format}", format = format::FORMAT)]
    Format(String),
    /// Another release of Skein recorded the file in a way that this one does not read.
    #[error("{error}; Skein {release} recorded it: read it with that release, because this one is {own}", own = crate::VERSION)]
    OtherRelease {
        /// The release that recorded the file.
        release: String,
        /// The content that this release does not read.
        error: Box<RecordError>,
    },
    /// The scenario in the file is invalid for this program.
    #[error("the scenario in the recording cannot be read: {0}")]
    Scenario(Box<ScenarioError>),
    /// The file has no index.
    #[error("cut off before its end; `skein record --repair` makes a whole file of it")]
    NoIndex,
    /// The file is damaged.
    #[error("damaged: {0}; `skein record --repair` makes a whole file of what is left")]
    Unreadable(String),
    /// A message in the file does not decode.
    #[error("a message on {topic} cannot be read: {what}")]
    Message {
        /// Topic of the message.
        topic: String,
        /// Error of the decoder.
        what: String,
    },
    /// One file cannot be read.
    #[error("{path}: {error}", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The error of that file.
        error: Box<RecordError>,
    },
    /// The recording cannot be written.
    #[error("cannot write: {}", why(.0))]
    Write(#[from] McapError),
}

impl RecordError {
    /// Adds the release that recorded the file, if it is another one and what it wrote cannot be read here.
    fn recorded_by(self, release: &str) -> Self {
        match self {
            Self::Format(_) | Self::Scenario(_) | Self::Message { .. } if release != crate::VERSION => {
                Self::OtherRelease { release: release.to_owned(), error: Box::new(self) }
            }
            error => error,
        }
    }

    /// Adds the name of the file that was read, unless the error has it already.
    fn reading(self, path: &Path) -> Self {
        match self {
            Self::Io { .. } | Self::File { .. } | Self::Write(_) => self,
            error => Self::File { path: path.to_owned(), error: Box::new(error) },
        }
    }
}

/// The text of the error; that of the operating system, if it caused the error.
fn why(error: &McapError) -> String {
    match error {
        McapError::Io(error) => of_writing(error),
        error => error.to_string(),
    }
}

#[cfg(test)]
pub(crate) mod tests;
