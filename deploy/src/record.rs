//! `skein record`: records a live swarm or fleet into an MCAP file. [`skein_lab::record`] documents the format of the file.

mod command;
mod fleet;
mod live;

pub use command::{RecordArgs, run};
pub use fleet::FleetRecorder;
pub use live::{Recorder, told};
