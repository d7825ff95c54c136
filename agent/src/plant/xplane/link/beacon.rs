//! Finds the X-Plane on this computer by its beacon.

use std::io;
use std::net::UdpSocket;
use std::time::{Duration, Instant};

use skein_host::clock::now;

use crate::plant::xplane::discovery;
use crate::plant::xplane::socket::{Port, Received, is_this_host};
use crate::plant::xplane::wire::becn::Beacon;

/// Time without a beacon before a warning: an X-Plane that loads scenery may miss two beacons.
const TIMEOUT: Duration = Duration::from_secs(3);

/// Listens for a beacon of an X-Plane on this host.
pub(super) struct Search {
    port: Port,
    since: Instant,
    /// When the group was last joined on every interface.
    joined: Instant,
    is_reported: bool,
}

impl Search {
    /// Begins to listen.
    pub(super) fn new() -> io::Result<Self> {
        Self::on(discovery::socket()?)
    }

    /// Listens on a socket that is already bound.
    pub(super) fn on(socket: UdpSocket) -> io::Result<Self> {
        let since = now();
        Ok(Self { port: Port::new(socket)?, since, joined: since, is_reported: false })
    }

    /// Port of the first master X-Plane on this host whose beacon arrives before the deadline. Beacons of other hosts
    /// are ignored, because their aircraft are not ours to fly.
    pub(super) fn find(&mut self, deadline: Instant, malformed: &mut u64) -> Option<u16> {
        loop {
            match self.port.receive(Some(deadline)) {
                Received::Datagram(size, from) if is_this_host(from.ip()) => {
                    match Beacon::decode(self.port.datagram(size)) {
                        Ok(beacon) if beacon.is_master() => {
                            tracing::info!(computer = beacon.name, version = beacon.version, "found X-Plane");
                            return Some(beacon.port);
                        }
                        Ok(_) => {}
                        Err(_) => *malformed += 1,
                    }
                }
                // A beacon of another host.
                Received::Datagram(..) => {}
                Received::Fault => {}
                Received::Nothing => break,
            }
            if now() >= deadline {
                break;
            }
        }
        self.join_again();
        self.report();
        None
    }

    /// Includes the interfaces that came up since the beginning: an agent may start before its computer's network.
    fn join_again(&mut self) {
        if now() >= self.joined + TIMEOUT {
            self.joined = now();
            // The socket is open, so that it has joined at least one interface before.
            let _ = discovery::join(&self.port.options());
        }
    }

    fn report(&mut self) {
        if !self.is_reported && now() >= self.since + TIMEOUT {
            self.is_reported = true;
            tracing::warn!(
                "no beacon from an X-Plane on this computer for {} s, still listening: is X-Plane running? You can \
                 also give its address",
                TIMEOUT.as_secs()
            );
        }
    }
}
