//! The network as a host sees it: its own addresses, and which peers it can reach.

use std::io;
use std::net::{IpAddr, SocketAddr, TcpStream, ToSocketAddrs};
use std::thread;
use std::time::Duration;

use crate::protocol::{Cause, Reached};

/// Time limit of a connection to a peer.
const PEER: Duration = Duration::from_secs(1);

/// The addresses of this host's network interfaces; none if the system does not report them.
pub(super) fn addresses() -> Vec<IpAddr> {
    let interfaces = if_addrs::get_if_addrs().unwrap_or_default();
    interfaces.iter().map(if_addrs::Interface::ip).collect()
}

/// Whether other computers can reach a host at such an address.
pub fn is_from_elsewhere(address: &IpAddr) -> bool {
    match address {
        IpAddr::V4(address) => !address.is_loopback() && !address.is_link_local(),
        IpAddr::V6(address) => !address.is_loopback() && !address.is_unicast_link_local(),
    }
}

/// Connects to each of these endpoints, all at once, and returns the results.
pub fn reach(endpoints: &[String]) -> Vec<Reached> {
    let calls: Vec<_> = endpoints.iter().cloned().map(|endpoint| thread::spawn(move || call(&endpoint))).collect();
    let interrupted = |_| Reached::No(Cause::Other, "the call was interrupted".to_owned());
    calls.into_iter().map(|call| call.join().unwrap_or_else(interrupted)).collect()
}

fn call(endpoint: &str) -> Reached {
    let addresses: Vec<SocketAddr> = match endpoint.to_socket_addrs() {
        Ok(addresses) => addresses.collect(),
        Err(error) => return Reached::No(Cause::Name, error.to_string()),
    };
    let mut reached = Reached::No(Cause::Name, "it has no address".to_owned());
    for address in addresses {
        reached = match TcpStream::connect_timeout(&address, PEER).map_err(|error| (error.kind(), error)) {
            Ok(_) => return Reached::Taken,
            Err((io::ErrorKind::ConnectionRefused, _)) => Reached::Refused,
            Err((io::ErrorKind::TimedOut, _)) => {
                Reached::No(Cause::Silence, format!("no answer within {} s", PEER.as_secs()))
            }
            Err((kind, error)) => Reached::No(cause(kind), error.to_string()),
        };
    }
    reached
}

fn cause(kind: io::ErrorKind) -> Cause {
    match kind {
        io::ErrorKind::HostUnreachable | io::ErrorKind::NetworkUnreachable | io::ErrorKind::NetworkDown => Cause::Route,
        io::ErrorKind::InvalidInput | io::ErrorKind::AddrNotAvailable => Cause::Address,
        io::ErrorKind::PermissionDenied => Cause::Forbidden,
        _ => Cause::Other,
    }
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use super::*;

    #[test]
    fn a_host_knows_its_addresses() {
        assert!(addresses().contains(&IpAddr::from([127, 0, 0, 1])), "{:?}", addresses());
    }

    #[test]
    fn calls_are_accepted_or_refused() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let open = listener.local_addr().unwrap().to_string();
        let closed = "127.0.0.1:1".to_owned();
        let reached = reach(&[open, closed, "no.such.host.invalid:1".to_owned(), "127.0.0.1".to_owned()]);
        assert_eq!(reached[..2], [Reached::Taken, Reached::Refused]);
        assert!(matches!(&reached[2..3], [Reached::No(Cause::Name, _)]), "{reached:?}");
    }

    #[test]
    fn a_connection_that_fails_has_a_cause() {
        use io::ErrorKind::{ConnectionReset, HostUnreachable, InvalidInput, NetworkUnreachable, PermissionDenied};
        let causes = [HostUnreachable, NetworkUnreachable, InvalidInput, PermissionDenied, ConnectionReset].map(cause);
        assert_eq!(causes, [Cause::Route, Cause::Route, Cause::Address, Cause::Forbidden, Cause::Other]);
    }
}
