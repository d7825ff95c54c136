//! Definitions that every process of a Skein swarm shares.
//!
//! | module | what it defines |
//! | --- | --- |
//! | [`math`] | sine, exponential and the like, with the same bits on every machine |
//! | [`hash`] | a hash with the same value on every platform |
//! | [`frame`] | WGS84, Earth-centred, local north-east-down and body frames, and the conversions between them |
//! | [`time`] | plant time, local time, sender's stamp: three clocks that the compiler keeps apart |
//! | [`id`] | vehicle ids, swarm names, incarnations |
//! | [`state`] | the state that a vehicle reports |
//! | [`message`] | the messages between processes, byte for byte |
//! | [`statistics`] | quantiles, by one definition |
//! | [`topic`] | the Zenoh key of each message |
//! | [`scenario`] | the file that describes a swarm |
//! | [`printable`] | foreign text made safe for a terminal or a log |
//!
//! This crate does no input or output, reads no clock and starts no thread: it has values and functions of values only.

pub mod frame;
pub mod hash;
pub mod id;
pub mod math;
pub mod message;
pub mod printable;
pub mod scenario;
pub mod state;
pub mod statistics;
pub mod time;
pub mod topic;
