//! Ports: of a simulator on its host, and free ones on this PC's loopback interface. A free port is bound for a moment, noted,
//! and released for its user.

use std::fmt;
use std::io;
use std::net::{Ipv4Addr, TcpListener, UdpSocket};

use skein_agent::plant::xplane::wire;
use skein_common::id::VehicleId;

/// Difference between the simulator ports of neighbouring vehicles.
pub const SIMULATOR_STEP: u16 = 10;
/// Number of first ports that are tried for a row of simulator ports.
const ROWS: usize = 200;

/// A host and a UDP port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HostPort {
    /// Name or address of the host.
    pub host: String,
    /// UDP port.
    pub port: u16,
}

impl std::str::FromStr for HostPort {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let (host, port) = text.rsplit_once(':').unwrap_or((text, ""));
        let port = if port.is_empty() && !text.contains(':') { Ok(wire::PORT) } else { port.parse() };
        match port {
            Ok(port) if port > 0 && !host.is_empty() => Ok(Self { host: host.to_owned(), port }),
            _ => Err("has to be HOST or HOST:PORT, such as 10.0.0.7:49000".to_owned()),
        }
    }
}

impl fmt::Display for HostPort {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.host, self.port)
    }
}

/// Returns `count` different TCP ports on which no process listens.
///
/// # Errors
/// If the system has no free port.
pub fn tcp(count: usize) -> io::Result<Vec<u16>> {
    let listeners = (0..count).map(|_| TcpListener::bind((Ipv4Addr::LOCALHOST, 0))).collect::<io::Result<Vec<_>>>()?;
    listeners.iter().map(|listener| Ok(listener.local_addr()?.port())).collect()
}

/// The first of `count` free UDP ports, [`SIMULATOR_STEP`] apart.
///
/// # Errors
/// If no such row of ports is free.
pub fn udp_row(count: usize) -> io::Result<u16> {
    let mut refusal = None;
    for _ in 0..ROWS {
        let first = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
        let port = first.local_addr()?.port();
        let others = (1..count).map(|nth| {
            let nth = u16::try_from(nth).ok().and_then(|nth| nth.checked_mul(SIMULATOR_STEP));
            let port = nth.and_then(|offset| port.checked_add(offset)).ok_or(io::ErrorKind::AddrNotAvailable)?;
            UdpSocket::bind((Ipv4Addr::LOCALHOST, port))
        });
        match others.collect::<io::Result<Vec<_>>>() {
            Ok(_) => return Ok(port),
            Err(error) => refusal = Some(error),
        }
    }
    Err(refusal.unwrap_or_else(|| io::ErrorKind::AddrNotAvailable.into()))
}

/// The simulator port of this vehicle if vehicle 1 has `first`; `None` if it would exceed the largest port.
pub fn simulator(first: u16, id: VehicleId) -> Option<u16> {
    first.checked_add(SIMULATOR_STEP * u16::from(id.get() - 1))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn a_host_may_have_a_port() {
        let parse = |text: &str| text.parse::<HostPort>().map(|parsed| (parsed.host, parsed.port)).ok();
        assert_eq!(parse("heli"), Some(("heli".to_owned(), 49_000)));
        assert_eq!(parse("10.0.0.7:49010"), Some(("10.0.0.7".to_owned(), 49_010)));
        for bad in ["", ":", ":1", "heli:", "heli:x", "heli:0", "heli:70000"] {
            assert_eq!(parse(bad), None, "{bad:?}");
        }
    }

    #[test]
    fn tcp_ports_are_free_and_different() {
        let ports = tcp(16).unwrap();
        assert_eq!(ports.iter().collect::<BTreeSet<_>>().len(), 16);
        for port in ports {
            TcpListener::bind((Ipv4Addr::LOCALHOST, port)).unwrap();
        }
    }

    #[test]
    fn every_tenth_port_of_a_row_is_free() {
        let first = udp_row(6).unwrap();
        for id in VehicleId::first(6) {
            UdpSocket::bind((Ipv4Addr::LOCALHOST, simulator(first, id).unwrap())).unwrap();
        }
    }

    #[test]
    fn a_simulator_port_beyond_the_largest_port_does_not_exist() {
        let id = |number| VehicleId::new(number).unwrap();
        assert_eq!(simulator(49_000, id(1)), Some(49_000));
        assert_eq!(simulator(49_000, id(4)), Some(49_030));
        assert_eq!(simulator(65_530, id(2)), None);
    }
}
