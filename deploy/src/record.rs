//! `skein record`: records a live swarm into an MCAP file. [`skein_lab::record`] documents the format of the file.

mod command;
mod live;

pub use command::{RecordArgs, run};
pub use live::Recorder;
