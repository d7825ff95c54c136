//! Whole swarms in virtual time, and programs that compute: no test here waits for a clock, so that a busy PC makes them slower
//! and changes nothing else.
#![expect(clippy::unwrap_used, reason = "what a test cannot do has failed")]

mod acceptance;
mod agreed_missions;
mod agreement;
mod airspace;
mod central;
mod far;
mod fit;
mod fleets;
mod formation_error;
mod formations;
mod impairments;
mod laws;
mod mistakes;
mod network;
mod own_law;
mod places;
mod python;
mod repeatable;
mod report;
mod simulator_life;
mod specimens;
mod study;
mod takeover;
mod tuning;
mod world;
mod wrong_files;
