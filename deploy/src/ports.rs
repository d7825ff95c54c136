//! Free ports of this PC's loopback: taken for a moment, read, and released for those who are to have them.

use std::io;
use std::net::{Ipv4Addr, TcpListener, UdpSocket};

use skein_common::id::VehicleId;

/// Between the simulator ports of neighbouring vehicles.
pub const SIMULATOR_STEP: u16 = 10;
/// Beginnings of a row of simulator ports that are tried.
const ROWS: usize = 200;

/// So many different TCP ports that nobody listens on.
///
/// # Errors
/// If the system has none to give.
pub fn tcp(count: usize) -> io::Result<Vec<u16>> {
    let listeners = (0..count).map(|_| TcpListener::bind((Ipv4Addr::LOCALHOST, 0))).collect::<io::Result<Vec<_>>>()?;
    listeners.iter().map(|listener| Ok(listener.local_addr()?.port())).collect()
}

/// A UDP port from which on every tenth is free, for so many vehicles.
///
/// # Errors
/// If there is no such row.
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

/// The simulator port of this vehicle, where vehicle 1 has `first`; `None` beyond the last port.
pub fn simulator(first: u16, id: VehicleId) -> Option<u16> {
    first.checked_add(SIMULATOR_STEP * u16::from(id.get() - 1))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn ports_are_free_and_no_two_are_the_same() {
        let ports = tcp(16).unwrap();
        assert_eq!(ports.iter().collect::<BTreeSet<_>>().len(), 16);
        for port in ports {
            TcpListener::bind((Ipv4Addr::LOCALHOST, port)).unwrap();
        }
    }

    #[test]
    fn a_row_is_free_at_every_tenth_port() {
        let first = udp_row(6).unwrap();
        for id in VehicleId::first(6) {
            UdpSocket::bind((Ipv4Addr::LOCALHOST, simulator(first, id).unwrap())).unwrap();
        }
    }

    #[test]
    fn the_row_of_a_simulator_ends_with_the_ports() {
        let id = |number| VehicleId::new(number).unwrap();
        assert_eq!(simulator(49_000, id(1)), Some(49_000));
        assert_eq!(simulator(49_000, id(4)), Some(49_030));
        assert_eq!(simulator(65_530, id(2)), None);
    }
}
