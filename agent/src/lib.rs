//! Flies one vehicle of a swarm that nobody leads. One process, one vehicle, deciding alone from what it measures and what
//! its peers last said.
//!
//! ```text
//!                        Agent::step(now, inputs) -> outputs            (agent.rs: pure, no clock, no IO)
//!   +----------------------------------------------------------------------------------------------+
//!   |  estimate -> peers -> mission -> formation -> control          failsafe: when one is missing  |
//!   +----^-----------^--------------------------------|--------------------------|------------------+
//!        | frame     | heard                          | sticks                   | said
//!   plant (built-in helicopter, X-Plane)              v                     link (Zenoh)
//!        ^--------------------------------------------+                          |
//!                   run.rs: one control thread, woken by the simulator's frame    +--> the other agents
//! ```
//!
//! Imports follow the arrows; the loop closes only through the plant. The same [`agent::Agent`] flies in real time
//! ([`run`]) and in a study's virtual time.

pub mod agent;
pub mod aircraft;
pub mod clock;
pub mod config;
pub mod control;
pub mod delay;
pub mod diagnosis;
pub mod estimate;
pub mod external;
pub mod failsafe;
pub mod formation;
pub mod link;
pub mod mission;
pub mod network;
pub mod peers;
pub mod plant;
pub mod random;
pub mod run;
pub mod speech;
pub mod start;
pub mod supported;
pub mod unix;
