//! Addresses of simulators, and the local ones to reach them from.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs};

use skein_common::id::VehicleId;

use super::wire;
use crate::plant::vehicle::PlantError;

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
    let address = |source| PlantError::Address { text: text.to_owned(), source };
    let addresses = addresses.map_err(address)?;
    let first = addresses.iter().find(|address| address.is_ipv4()).or(addresses.first());
    first.copied().ok_or_else(|| address(io::ErrorKind::NotFound.into()))
}

/// The address of a vehicle's stand-in on this computer where nothing names another.
pub(crate) fn default_address(id: VehicleId) -> SocketAddr {
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
