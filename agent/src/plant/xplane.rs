//! X-Plane 11 and 12 over UDP: the agent's side of the protocol, and a stand-in for the simulator's side.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`wire`] | encodes and decodes every datagram |
//! | [`discovery`] | finds the X-Planes of a network |
//! | [`placing`] | puts an aircraft to its vehicle's start |
//! | [`client`] | the agent's side without socket and clock: subscriptions, frames, controls |
//! | [`link`] | X-Plane as a [`Plant`] |
//! | [`server`] | the simulator's side without sockets: subscriptions, datarefs, overrides |
//! | [`standin`] | a headless X-Plane: the built-in helicopter behind that server |
//!
//! The aircraft's file names the datarefs of its controls ([`skein_core::aircraft::Profile`]).
//!
//! Degrees, X-Plane's axes and its single precision are used in this folder only.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs};

use skein_common::frame::Origin;
use skein_common::id::VehicleId;
use skein_common::scenario::StartPattern;
use skein_core::helicopter::TICK_S;
use skein_core::plant::Plant;

use super::{PlantError, PlantVehicle};

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
use placing::start_of;

/// The link to this vehicle's X-Plane, as its scenario wants it.
///
/// # Errors
/// If a socket for the simulator cannot be opened.
pub(super) fn open(address: Option<SocketAddr>, vehicle: &PlantVehicle<'_>) -> Result<Box<dyn Plant>, PlantError> {
    let &PlantVehicle { scenario, id, aircraft, flown_s, .. } = vehicle;
    let refused = |error: XPlaneLinkError| PlantError::Open(Box::new(error));
    let origin = Origin::new(scenario.origin.geodetic());
    let listen = address.map_or(Ipv4Addr::UNSPECIFIED.into(), |address| listen_for(address.ip()));
    let rate_hz = (1.0 / TICK_S).round() as u32;
    let mut link = XPlane::new(&origin, address, &aircraft.xplane, rate_hz, listen).map_err(refused)?;
    // An aircraft that is flying already, or that the scenario leaves where it is, is not placed.
    let is_placed = scenario.start.pattern != StartPattern::AsIs && flown_s.is_none();
    link.set_up(is_placed.then(|| start_of(scenario, id)).flatten(), &scenario.plant).map_err(refused)?;
    Ok(Box::new(link))
}

/// Resolves `HOST[:PORT]`, IPv4 first where a name has several addresses.
///
/// # Errors
/// If the address cannot be resolved.
pub fn simulator(text: &str) -> Result<SocketAddr, PlantError> {
    let addresses = if let Ok(ip) = text.parse::<IpAddr>() {
        Ok(vec![(ip, wire::PORT).into()])
    } else if text.contains(':') {
        text.to_socket_addrs().map(Vec::from_iter)
    } else {
        (text, wire::PORT).to_socket_addrs().map(Vec::from_iter)
    };
    let address = |source| PlantError::Address(text.to_owned(), source);
    let addresses = addresses.map_err(address)?;
    let first = addresses.iter().find(|address| address.is_ipv4()).or(addresses.first());
    first.copied().ok_or_else(|| address(io::ErrorKind::NotFound.into()))
}

/// The address of a vehicle's stand-in on this computer where nothing names another.
pub(super) fn default_address(id: VehicleId) -> SocketAddr {
    (Ipv4Addr::LOCALHOST, wire::PORT + 10 * u16::from(id.get() - 1)).into()
}

/// Local address to bind for talking to a simulator.
pub fn listen_for(simulator: IpAddr) -> IpAddr {
    match simulator {
        _ if simulator.is_loopback() => simulator,
        IpAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
        IpAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
    }
}
