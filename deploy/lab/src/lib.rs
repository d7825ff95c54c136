//! The laboratory: flies scenarios in virtual time, seeded and repeatable, measures, records, draws and compares them. It needs
//! no network: a crate with a law of its own builds a study program from this one alone.
//!
//! | module | what it does |
//! | --- | --- |
//! | [`scenario`], [`prepare`] | a command's scenario: read, and everything that can stand against its flight |
//! | [`world`] | a swarm in virtual time, step by step |
//! | [`faults`] | what a scenario does to a swarm, and when; what really happened |
//! | [`external`] | laws in other programs, in virtual time |
//! | [`metrics`] | the figures of a flight |
//! | [`study`] | many flights: seeds, sweeps, summaries |
//! | [`recording`], [`record`] | a flight in memory, and as an MCAP file |
//! | [`report`], [`compare`] | pictures and tables; one folder of runs judged against another |
//! | [`cli`] | a program of these commands |
//! | [`law`] | everything that a law of your own needs |

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
pub mod study;
pub mod terminal;
pub mod world;

/// The version of this build.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
/// The git revision of this build; "unknown" without a repository.
pub const REVISION: &str = env!("SKEIN_REVISION");
