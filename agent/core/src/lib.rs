//! The agent of one vehicle in a leaderless swarm, as a pure function: [`agent::Agent::step`] takes the time, the
//! vehicle's measurement and the peers' messages, and returns the command and the messages to send.
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
//! The agent runs inside a [`station`], which adds the network impairments and the clock error of the scenario, the
//! time since take-off and the trace. The control thread and the study drive the same station.
//!
//! Each stage is the module of its name. It takes the values of earlier stages and returns its own; feedback exists
//! only through the plant and through the state kept from the last step. The responses to missing or broken data and
//! hardware are in one table ([`failsafe`]), the deadlines in another ([`deadlines`]).
//!
//! The crate uses no clock, file, socket, thread or environment variable; it is `no_std`, so the compiler enforces
//! this. The same inputs give bit-identical outputs, in real time and in virtual time.
#![cfg_attr(not(test), no_std)]

extern crate alloc;

pub mod agent;
pub mod aircraft;
pub mod builtin;
pub mod control;
pub mod deadlines;
pub mod delay;
pub mod diagnosis;
mod encoding;
pub mod energy;
pub mod estimate;
pub mod failsafe;
pub mod fit;
pub mod formation;
mod gilbert;
pub mod helicopter;
pub mod hover;
pub mod impairments;
pub mod intent;
mod lanes;
pub mod mission;
pub mod neighbourhood;
pub mod outbox;
mod pace;
pub mod peers;
pub mod pilot;
pub mod plant;
pub mod point_mass;
pub mod random;
pub mod sensors;
pub mod setpoint;
pub mod skew;
pub mod start;
pub mod station;
pub mod strangers;
#[cfg(test)]
mod tests;
pub mod tuning;
