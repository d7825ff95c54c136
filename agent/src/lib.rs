//! One agent process: the clocks, sockets and files around the decision-making core. The decisions themselves are made
//! in [`skein_core`], a pure function that this crate calls once per simulator frame.
//!
//! ```text
//!   plant (built-in helicopter, X-Plane)                                link (Zenoh)
//!        | frame       ^ controls                             messages |       ^ messages
//!        v             |                                               v       |
//!      run.rs: one control thread, woken by the simulator's frame, calls skein_core::agent::Agent::step
//! ```

pub mod config;
pub mod external;
pub mod inputs;
pub mod link;
pub mod plant;
pub mod run;
pub mod unix;
