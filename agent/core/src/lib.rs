//! One vehicle of a swarm without a leader, as a pure function: [`agent::Agent::step`] takes the time, what the vehicle's
//! sensors measured and what its peers sent, and gives the controls and what to send.
//!
//! ```text
//!                        Agent::step(now, inputs) -> outputs                                (agent.rs)
//!   +----------------------------------------------------------------------------------------------+
//!   |  estimate -> diagnosis -> peers -> mission -> formation -> control -> outbox                  |
//!   +----^-----------------------^--------------------------------------|-------------------|-------+
//!        | measurement           | messages                             | controls          | messages
//!      plant                  peer agents                             plant             peer agents
//! ```
//!
//! Around the agent stands its [`station`]: the network that the scenario impairs, the clock that it sets wrong, the time since
//! take-off and the trace. Control thread and study drive the same station.
//!
//! Each stage is the module of its name. It takes the values of the stages before it and returns its own; the loop closes only
//! through the plant and through what the last step left behind. What is missing or broken is answered by one table ([`failsafe`]);
//! what time alone changes stands in another ([`deadlines`]).
//!
//! The crate has no clock, no file, no socket, no thread and no environment: it is `no_std`, so that the compiler keeps it so.
//! Same inputs, same outputs, bit for bit, in real time and in virtual time alike.
#![cfg_attr(not(test), no_std)]

extern crate alloc;

pub mod agent;
pub mod aircraft;
pub mod control;
pub mod deadlines;
pub mod delay;
pub mod diagnosis;
pub mod estimate;
pub mod failsafe;
pub mod formation;
pub mod helicopter;
pub mod impairments;
pub mod mission;
pub mod outbox;
pub mod peers;
pub mod plant;
pub mod random;
pub mod skew;
pub mod start;
pub mod station;
#[cfg(test)]
mod testing;
