//! Random input for all that reads what others send or write: no input causes a panic, and nothing false comes out of it.
//! Readers of one message or file get valid examples that are damaged, and noise. What has a state gets sequences of steps, made
//! out of noise.
//!
//! The number of inputs is bounded for CI. `SKEIN_FUZZ=100 cargo test --release -p skein-fuzz` tries a hundred times as many, and
//! `.ci/fuzz` looks for inputs that reach new code.
#![expect(clippy::unwrap_used, reason = "what a test cannot do has failed")]

mod agent;
mod draws;
mod files;
mod laws;
mod messages;
mod simulator;
