//! X-Plane 11 and 12 over UDP: the agent's end of the wire, and a stand-in for the other end.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`wire`] | every datagram, both ways, byte for byte |
//! | [`link`] | X-Plane as a [`Plant`](skein_core::plant::Plant) |
//! | [`server`] | the simulator's side: subscriptions, datarefs, overrides; no sockets |
//! | [`standin`] | a headless X-Plane: the built-in helicopter behind that server |
//!
//! Which datarefs carry an aircraft's controls stands in its file ([`skein_core::aircraft::Profile`]).
//!
//! Degrees, X-Plane's axes and its single precision do not leave this folder.

mod clock;
mod convert;
mod socket;

pub mod link;
pub mod server;
pub mod standin;
pub mod wire;

pub use link::{Counters, LinkError, XPlane};
