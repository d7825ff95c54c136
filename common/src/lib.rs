//! What every process of a Skein swarm must agree on.
//!
//! | module | what it fixes |
//! | --- | --- |
//! | [`frame`] | WGS84, Earth-centred, local north-east-down, body axes, and the way between them |
//! | [`time`] | plant time, local time, sender's stamp: three clocks that do not mix |
//! | [`id`] | vehicle, swarm, incarnation |
//! | [`state`] | what a vehicle knows of itself |
//! | [`message`] | what is said between processes, byte for byte |
//! | [`topic`] | under which key it is said |
//! | [`scenario`] | the one file that describes a swarm |
//!
//! No input or output, no clock, no threads: everything here is a value or a function of values.

pub mod frame;
pub mod id;
pub mod message;
pub mod scenario;
pub mod state;
pub mod time;
pub mod topic;
