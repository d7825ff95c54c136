//! Finds the X-Planes of a network by their beacons.

use std::collections::BTreeMap;
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use skein_host::clock::now;
use socket2::{Domain, Protocol, SockRef, Socket, Type};

use super::socket::{Port, Received, is_this_host, own_address_towards};
use super::wire::WireError;
use super::wire::becn::{self, Beacon};

/// Most X-Planes that are kept: anything on the network can send a beacon.
const MOST: usize = 250;

/// Time without a beacon before a warning: an X-Plane that loads scenery may miss two beacons.
const TIMEOUT: Duration = Duration::from_secs(3);

/// An X-Plane that was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FoundSimulator {
    /// Address of its computer.
    pub address: IpAddr,
    /// UDP port on which it receives.
    pub port: u16,
    /// Its version: 121400 is 12.1.4.
    pub version: i32,
    /// The name that its computer gives itself.
    pub computer: String,
    /// Name of this computer's interface over which it is reached, if that is known.
    pub interface: Option<String>,
}

/// Listens for this time and returns every X-Plane that flies its own aircraft, in the order of addresses and ports. An
/// X-Plane of this computer that is received over several interfaces is returned once.
///
/// # Errors
/// If beacons cannot be received.
pub fn listen(time: Duration) -> io::Result<Vec<FoundSimulator>> {
    Ok(listen_on(socket()?, time)?.into_values().collect())
}

type Found = BTreeMap<(IpAddr, u16), FoundSimulator>;

fn listen_on(socket: UdpSocket, time: Duration) -> io::Result<Found> {
    let (mut search, until, mut found) = (Search::on(socket)?, now() + time, Found::new());
    while now() < until {
        if let Some((Ok(beacon), from)) = search.next(until)
            && beacon.is_master()
            && found.len() < MOST
        {
            let Beacon { port, version, name: computer, .. } = beacon;
            let address = from.ip();
            let interface = interface_towards(from);
            found.insert((address, port), FoundSimulator { address, port, version, computer, interface });
        }
    }
    let elsewhere: Vec<u16> =
        found.keys().filter(|(ip, _)| !ip.is_loopback() && is_this_host(*ip)).map(|(_, port)| *port).collect();
    found.retain(|(ip, port), _| !(ip.is_loopback() && elsewhere.contains(port)));
    Ok(found)
}

/// Listens for beacons, above all for that of an X-Plane on this host.
pub(super) struct Search {
    port: Port,
    since: Instant,
    /// The time at which the group was last joined on every interface.
    joined: Instant,
    is_reported: bool,
}

impl Search {
    /// Begins to listen.
    pub(super) fn new() -> io::Result<Self> {
        Self::on(socket()?)
    }

    /// Listens on a socket that is already bound.
    pub(super) fn on(socket: UdpSocket) -> io::Result<Self> {
        let since = now();
        Ok(Self { port: Port::new(socket)?, since, joined: since, is_reported: false })
    }

    /// The next datagram that arrives before the deadline, as a beacon, and its sender.
    fn next(&mut self, deadline: Instant) -> Option<(Result<Beacon, WireError>, SocketAddr)> {
        loop {
            if let Received::Datagram(size, from) = self.port.receive(Some(deadline)) {
                return Some((Beacon::decode(self.port.datagram(size)), from));
            }
            if now() >= deadline {
                return None;
            }
        }
    }

    /// Port of the first master X-Plane on this host whose beacon arrives before the deadline. Beacons of other hosts
    /// are ignored, because their aircraft are not ours to fly.
    pub(super) fn find(&mut self, deadline: Instant, malformed: &mut u64) -> Option<u16> {
        while let Some((beacon, from)) = self.next(deadline) {
            match beacon {
                _ if !is_this_host(from.ip()) => {}
                Ok(beacon) if beacon.is_master() => {
                    tracing::info!(computer = beacon.name, version = beacon.version, "found X-Plane");
                    return Some(beacon.port);
                }
                Ok(_) => {}
                Err(_) => *malformed += 1,
            }
            if now() >= deadline {
                break;
            }
        }
        if now() >= self.joined + TIMEOUT {
            self.joined = now();
            // Includes the interfaces that came up since then: an agent may start before its computer's network. The socket is
            // open, so that it has joined at least one interface before.
            let _ = join(&SockRef::from(&self.port.socket));
        }
        if !self.is_reported && now() >= self.since + TIMEOUT {
            self.is_reported = true;
            tracing::warn!(
                "no beacon from an X-Plane on this computer for {} s, still listening: is X-Plane running? You can \
                 also give its address",
                TIMEOUT.as_secs()
            );
        }
        None
    }
}

/// A socket that receives the beacons; other programs on this host can receive them too.
fn socket() -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.set_reuse_address(true)?;
    #[cfg(unix)]
    socket.set_reuse_port(true)?;
    socket.bind(&SocketAddr::from((Ipv4Addr::UNSPECIFIED, becn::PORT)).into())?;
    join(&socket)?;
    Ok(socket.into())
}

/// Joins the beacons' group on every interface, those that it has joined already included: X-Plane sends its beacon over
/// the interface of its own choice. Call it again for interfaces that came up later.
///
/// # Errors
/// If the group can be joined on no interface.
fn join(socket: &Socket) -> io::Result<()> {
    let group = Ipv4Addr::from(becn::GROUP);
    // The default interface and the loopback need no list of interfaces.
    let known = [Ipv4Addr::UNSPECIFIED, Ipv4Addr::LOCALHOST].into_iter();
    let mut outcome = Err(io::ErrorKind::NotFound.into());
    for via in known.chain(interfaces().into_iter().map(|(_, address)| address)) {
        let joined = socket.join_multicast_v4(&group, &via);
        // An interface has been joined already, by this address or by another one of its own.
        let is_joined = joined.as_ref().is_err_and(|error| error.kind() == io::ErrorKind::AddrInUse);
        if joined.is_ok() || is_joined {
            outcome = Ok(());
        } else if outcome.is_err() {
            outcome = joined;
        }
    }
    outcome
}

/// Names and IPv4 addresses of this computer's interfaces; none if the system does not tell.
fn interfaces() -> Vec<(String, Ipv4Addr)> {
    let of = |interface: if_addrs::Interface| match interface.ip() {
        IpAddr::V4(address) => Some((interface.name, address)),
        IpAddr::V6(_) => None,
    };
    if_addrs::get_if_addrs().unwrap_or_default().into_iter().filter_map(of).collect()
}

/// Name of the interface over which this computer sends to this address.
fn interface_towards(address: SocketAddr) -> Option<String> {
    let own = own_address_towards(address)?;
    interfaces().into_iter().find(|(_, address)| *address == own).map(|(name, _)| name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_master_is_found_once() {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let to = socket.local_addr().unwrap();
        let beacon = |port: u16, role: u32| {
            let mut bytes = Vec::new();
            let beacon = Beacon {
                minor: 2,
                host_id: 1,
                version: 121_400,
                role,
                port,
                name: "heli".to_owned(),
                raknet_port: Some(becn::RAKNET_PORT),
            };
            beacon.encode(&mut bytes).unwrap();
            bytes
        };
        let from = UdpSocket::bind("127.0.0.1:0").unwrap();
        for bytes in [beacon(49_010, 1), beacon(49_000, 1), beacon(49_000, 1), beacon(49_020, 2), b"BECN?".to_vec()] {
            from.send_to(&bytes, to).unwrap();
        }
        let found = listen_on(socket, Duration::from_millis(200)).unwrap();
        assert_eq!(found.keys().map(|(_, port)| *port).collect::<Vec<_>>(), [49_000, 49_010]);
        assert!(found.values().all(|found| found.version == 121_400 && found.computer == "heli"));
        let loopback = interfaces().into_iter().find(|(_, address)| address.is_loopback()).map(|(name, _)| name);
        assert!(loopback.is_some() && found.values().all(|found| found.interface == loopback), "{found:?}");
    }
}
