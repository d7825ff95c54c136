//! What every process of a Skein swarm must agree on.
//!
//! | module | what it fixes |
//! | --- | --- |
//! | [`math`] | sine, exponential and the like, with the same bits on every machine |
//! | [`frame`] | WGS84, Earth-centred, local north-east-down, body axes, and the way between them |
//! | [`time`] | plant time, local time, sender's stamp: three clocks that do not mix |
//! | [`id`] | vehicle, swarm, incarnation |
//! | [`state`] | what a vehicle knows of itself |
//! | [`message`] | what is said between processes, byte for byte |
//! | [`statistics`] | quantiles, by one definition |
//! | [`topic`] | under which key it is said |
//! | [`scenario`] | the one file that describes a swarm |
//! | [`printable`] | how foreign text may reach a terminal or a log |
//!
//! No input or output, no clock, no threads: everything here is a value or a function of values.

pub mod frame;
pub mod id;
pub mod math;
pub mod message;
pub mod printable;
pub mod scenario;
pub mod state;
pub mod statistics;
pub mod time;
pub mod topic;
