//! Flies scenarios in virtual time, seeded and repeatable, and measures, records, draws and compares the flights.
//!
//! The crate needs no network: a crate with its own formation law builds a study program from this one alone.
//!
//! | module | what it does |
//! | --- | --- |
//! | [`scenario`], [`prepare`] | reads a command's scenario and checks that it can fly |
//! | [`shipped`] | the files that the program carries |
//! | [`world`] | simulates a swarm in virtual time, step by step |
//! | [`faults`] | schedules the faults and orders of a scenario; names the faults that were injected |
//! | [`external`] | connects laws that run in other programs, in virtual time |
//! | [`metrics`] | measures the figures of a flight |
//! | [`study`] | flies many flights: seeds, sweeps, summaries |
//! | [`recording`], [`record`] | keep a flight in memory, and in an MCAP file |
//! | [`report`], [`compare`] | draw pictures and tables; compare one folder of runs with another |
//! | [`cli`] | makes a command-line program of these commands |
//! | [`law`] | re-exports everything that your own formation law needs |

pub mod cli;
pub mod compare;
pub mod error;
pub mod external;
pub mod faults;
pub mod law;
pub mod metrics;
pub mod out;
pub mod prepare;
pub mod record;
pub mod recording;
pub mod report;
pub mod scenario;
pub mod shipped;
pub mod study;
pub mod terminal;
pub mod world;

/// The version of this build.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
/// The git revision of this build; "unknown" without a repository.
pub const REVISION: &str = env!("SKEIN_REVISION");
/// The platform that this build is for, in the compiler's notation.
pub const TARGET: &str = env!("SKEIN_TARGET");
/// The version of Zenoh in the workspace's lock file: that of the agents that are built with this crate.
pub const ZENOH: &str = env!("SKEIN_ZENOH");
