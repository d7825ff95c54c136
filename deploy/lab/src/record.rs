//! Recordings: one MCAP file a flight, which Foxglove, PlotJuggler and Python's `mcap` open, and which reads back here.
//!
//! | topic | schema | what |
//! | --- | --- | --- |
//! | `/vehicle/N/trace` | `skein.Trace`, JSON | every step of a vehicle, all that it traced |
//! | `/events` | `skein.Event`, JSON | what vehicles said of themselves |
//! | `/faults` | `skein.Fault`, JSON | what was done to the swarm |
//! | `/tf` | `foxglove.FrameTransforms` | frames `vehicle/N` and `centre` in the root frame `world` |
//! | `/vehicle/N/location` | `foxglove.LocationFix` | where on the globe |
//! | `/scene/vehicles`, `/scene/formation` | `foxglove.SceneUpdate` | helicopters; the formation's ellipse and band |
//! | `/log` | `foxglove.Log` | events and faults as people read them |
//!
//! Beside the messages stand a metadata record `skein.run` (what flew, in which program), one `skein.window_begins` and one
//! `skein.window_ends` (log times of the window of the figures), one `skein.recorder` (what could not be recorded), and the
//! complete `scenario.toml` as an attachment.
//!
//! **Log time** is nanoseconds. In virtual time 0 is the beginning of the window; in real time it is UTC, the moment at which
//! the recorder heard of it. Times read back are rounded to the nanosecond; everything else comes back bit for bit.
//!
//! **Frames**: `world` is east, north, up at the scenario's origin; a vehicle's is forward, left, up. The program's own NED and
//! FRD stay in the JSON channels.
//!
//! **What survives**: messages are written in chunks, each with a checksum. A chunk that is whole can be read whatever is cut
//! off or damaged behind it; a message is on disk, in such a chunk, within [`FLUSH`] of its recording. The scenario has the
//! checksum of an attachment. MCAP has none for metadata: each record of ours carries its own, as `skein.checksum`. Older
//! recordings have none there and are read all the same. Where a damaged record may have been the beginning or the end of the
//! window, reading is refused, also of what is repaired or merged of it: without the window no step has its time.

mod copy;
mod csv;
mod draft;
mod format;
mod merge;
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

pub use csv::csv;
pub(crate) use draft::Draft;
pub(crate) use format::log_time_ns;
pub use merge::merge;
pub use reader::read;
pub use repair::{Repaired, repair};
pub use writer::{About, Writer};

/// Name of a run's recording in its folder.
pub const FILE: &str = "run.mcap";
/// A message waits no longer than this for its way to the disk.
pub const FLUSH: Duration = Duration::from_millis(200);

/// Why something cannot be recorded or read.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The system refuses.
    #[error("{path}: {error}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What it says.
        error: std::io::Error,
    },
    /// Something else than MCAP.
    #[error("not an MCAP file")]
    NoMcap,
    /// Not written by Skein, or cut off before the scenario.
    #[error("no recording of Skein: {0} is missing")]
    Missing(&'static str),
    /// Written by a program that records otherwise.
    #[error("a recording of format {0}, where {format} is read", format = format::FORMAT)]
    Format(String),
    /// The scenario in it is none that this program knows.
    #[error("its scenario cannot be read: {0}")]
    Scenario(Box<ScenarioError>),
    /// A message in it is none of ours.
    #[error("a message on {topic} cannot be read: {what}")]
    Message {
        /// Where it stands.
        topic: String,
        /// What is wrong with it.
        what: String,
    },
    /// What is wrong with one file.
    #[error("{path}: {error}", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        error: Box<RecordError>,
    },
    /// It cannot be written.
    #[error("cannot write: {}", why(.0))]
    Write(#[from] McapError),
}

impl RecordError {
    /// The same with the name of the file that was read, unless it says already where it arose.
    fn reading(self, path: &Path) -> Self {
        match self {
            Self::Io { .. } | Self::File { .. } | Self::Write(_) => self,
            error => Self::File { path: path.to_owned(), error: Box::new(error) },
        }
    }
}

/// What the system says, if it was the system.
fn why(error: &McapError) -> String {
    match error {
        McapError::Io(error) => error.to_string(),
        error => error.to_string(),
    }
}

#[cfg(test)]
mod tests;
