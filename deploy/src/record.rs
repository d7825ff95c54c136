//! `skein record`: a live swarm as an MCAP file. What stands in such a file is told by [`skein_lab::record`].

mod command;
mod live;

pub use command::{RecordArgs, run};
pub use live::Recorder;
