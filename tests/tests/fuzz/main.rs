//! Random input for all that reads what others send or write: no input causes a panic, and nothing false comes out of it.
//! Every strategy starts from valid examples and damages them; some inputs are mere noise.
//!
//! The number of inputs is bounded for CI. `SKEIN_FUZZ=100 cargo test --release -p skein-tests --test fuzz` tries a hundred
//! times as many.
#![expect(clippy::unwrap_used, reason = "what a test cannot do has failed")]

mod agent;
mod files;
mod inputs;
mod laws;
mod messages;
mod simulator;
