//! X-Plane 11 and 12 over UDP: the agent's side of the protocol, and a stand-in for the simulator's side.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`wire`] | encodes and decodes every datagram |
//! | [`discovery`] | finds the X-Planes of a network |
//! | [`placing`] | puts an aircraft to its vehicle's start |
//! | [`client`] | the agent's side without socket and clock: subscriptions, frames, controls |
//! | [`link`] | X-Plane as a [`Plant`](skein_core::plant::Plant) |
//! | [`server`] | the simulator's side without sockets: subscriptions, datarefs, overrides |
//! | [`standin`] | a headless X-Plane: the built-in helicopter behind that server |
//!
//! The aircraft's file names the datarefs of its controls ([`skein_core::aircraft::Profile`]).
//!
//! Degrees, X-Plane's axes and its single precision are used in this folder only.

mod convert;
mod socket;

pub mod client;
pub mod discovery;
pub mod link;
pub mod placing;
pub mod server;
pub mod standin;
pub mod wire;

pub use client::Counters;
pub use link::{XPlane, XPlaneLinkError};
