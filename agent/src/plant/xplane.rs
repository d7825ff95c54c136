//! X-Plane 11 and 12 over UDP: the agent's end of the wire, and a stand-in for the other end.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`wire`] | every datagram, both ways, byte for byte |
//! | [`profile`] | which datarefs carry an aircraft's controls |
//! | [`link`] | X-Plane as a [`Plant`](super::Plant) |
//! | [`server`] | the simulator's side: subscriptions, datarefs, overrides; no sockets |
//! | [`standin`] | a headless X-Plane: the built-in helicopter behind that server |
//!
//! Degrees, X-Plane's axes and its single precision do not leave this folder.

mod clock;
mod convert;
mod socket;

pub mod link;
pub mod profile;
pub mod server;
pub mod standin;
pub mod wire;

pub use link::{Counters, LinkError, XPlane};
pub use profile::Profile;
