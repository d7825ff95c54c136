//! A UDP socket that can be read with a deadline or without waiting, and whose errors are never fatal.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use skein_host::clock::{now, sleep};

use super::wire::MAX_DATAGRAM;

/// Pause after an error that may last, so that it does not make the thread spin.
const FAULT_PAUSE: Duration = Duration::from_millis(10);

/// Whether an error means that the receiver is not up: an ICMP reply to an earlier datagram, which sockets report at a
/// later call (on Windows as a reset), or a signal.
pub(super) fn is_receiver_down(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionRefused, ConnectionReset, Interrupted};
    matches!(error.kind(), ConnectionReset | ConnectionRefused | Interrupted)
}

/// Whether a datagram with this source came from this host: only a host's own addresses can be bound.
pub(super) fn is_this_host(ip: IpAddr) -> bool {
    let is_unicast = match ip {
        IpAddr::V4(ip) => !ip.is_broadcast(),
        IpAddr::V6(_) => true,
    };
    let is_one_host = is_unicast && !ip.is_unspecified() && !ip.is_multicast();
    is_one_host && (ip.is_loopback() || UdpSocket::bind((ip, 0)).is_ok())
}

/// Address from which this computer sends to an IPv4 address, found without sending anything.
pub(super) fn own_address_towards(address: SocketAddr) -> Option<IpAddr> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).ok()?;
    socket.connect(address).ok()?;
    Some(socket.local_addr().ok()?.ip())
}

/// Result of one attempt to receive.
pub(super) enum Received {
    /// A datagram of this many bytes, from this address.
    Datagram(usize, SocketAddr),
    /// An error without further consequences.
    Fault,
    /// No datagram before the deadline.
    Nothing,
}

/// A bound, unconnected socket with its buffer.
pub(super) struct Port {
    pub(super) socket: UdpSocket,
    is_blocking: bool,
    buffer: Box<[u8; MAX_DATAGRAM]>,
    /// Number of errors so far, sending and receiving.
    pub(super) faults: u64,
}

impl Port {
    pub(super) fn new(socket: UdpSocket) -> io::Result<Self> {
        socket.set_nonblocking(false)?;
        Ok(Self { socket, is_blocking: true, buffer: Box::new([0; MAX_DATAGRAM]), faults: 0 })
    }

    /// The last received datagram, of this many bytes.
    pub(super) fn datagram(&self, size: usize) -> &[u8] {
        self.buffer.get(..size).unwrap_or_default()
    }

    /// Receives a datagram, waiting until the deadline or not at all.
    pub(super) fn receive(&mut self, deadline: Option<Instant>) -> Received {
        let timeout = deadline.map(|deadline| deadline.saturating_duration_since(now())).filter(|wait| !wait.is_zero());
        let outcome = self.set_timeout(timeout).and_then(|()| self.socket.recv_from(&mut *self.buffer));
        self.assess(outcome, timeout)
    }

    /// Interprets an attempt to receive. Pauses after an error that may last.
    fn assess(&mut self, outcome: io::Result<(usize, SocketAddr)>, timeout: Option<Duration>) -> Received {
        match outcome {
            Ok((size, from)) => Received::Datagram(size, from),
            Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {
                Received::Nothing
            }
            Err(error) => {
                self.faults += 1;
                if !is_receiver_down(&error) && timeout.is_some() {
                    sleep(timeout.unwrap_or_default().min(FAULT_PAUSE));
                }
                Received::Fault
            }
        }
    }

    fn set_timeout(&mut self, timeout: Option<Duration>) -> io::Result<()> {
        if self.is_blocking != timeout.is_some() {
            self.socket.set_nonblocking(timeout.is_none())?;
            self.is_blocking = timeout.is_some();
        }
        if timeout.is_some() { self.socket.set_read_timeout(timeout) } else { Ok(()) }
    }

    /// Sends a datagram. An error is counted.
    ///
    /// # Errors
    /// If the datagram cannot be sent; it is then lost.
    pub(super) fn send(&mut self, datagram: &[u8], to: SocketAddr) -> io::Result<()> {
        let sent = self.socket.send_to(datagram, to);
        self.faults += u64::from(sent.is_err());
        sent.map(|_| ())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resets_and_refusals_mean_that_the_receiver_is_not_up() {
        for kind in [io::ErrorKind::ConnectionReset, io::ErrorKind::ConnectionRefused, io::ErrorKind::Interrupted] {
            assert!(is_receiver_down(&kind.into()), "{kind:?}");
        }
        assert!(!is_receiver_down(&io::ErrorKind::PermissionDenied.into()));
    }

    #[test]
    fn only_this_hosts_own_addresses_are_this_host() {
        assert!(is_this_host(Ipv4Addr::LOCALHOST.into()));
        assert!(is_this_host("127.0.0.7".parse().unwrap()));
        for stranger in
            ["203.0.113.77", "198.51.100.7", "0.0.0.0", "255.255.255.255", "239.255.1.1", "2001:db8::1", "::"]
        {
            assert!(!is_this_host(stranger.parse().unwrap()), "{stranger}");
        }
    }

    #[test]
    fn sending_to_a_closed_port_does_not_stop_reception() {
        let local = (Ipv4Addr::LOCALHOST, 0);
        let closed = UdpSocket::bind(local).unwrap().local_addr().unwrap();
        let mut port = Port::new(UdpSocket::bind(local).unwrap()).unwrap();
        for _ in 0..3 {
            let _ = port.send(b"hello", closed);
            let received = port.receive(Some(now() + Duration::from_millis(5)));
            assert!(!matches!(received, Received::Datagram(..)));
        }
        let friend = UdpSocket::bind(local).unwrap();
        friend.send_to(b"here", port.socket.local_addr().unwrap()).unwrap();
        let mut attempts = (0..10).map(|_| port.receive(Some(now() + Duration::from_secs(1))));
        assert!(attempts.any(|received| matches!(received, Received::Datagram(4, _))));
    }

    #[test]
    fn an_injected_reset_is_counted_and_causes_no_pause() {
        let mut port = Port::new(UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap()).unwrap();
        let friend = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let begin = now();
        for _ in 0..1000 {
            let reset = Err(io::ErrorKind::ConnectionReset.into());
            assert!(matches!(port.assess(reset, Some(Duration::from_secs(1))), Received::Fault));
        }
        assert!(now() < begin + Duration::from_secs(1), "a thousand resets cause no pause");
        assert_eq!(port.faults, 1000);
        friend.send_to(b"here", port.socket.local_addr().unwrap()).unwrap();
        assert!(matches!(port.receive(Some(now() + Duration::from_secs(1))), Received::Datagram(4, _)));
    }

    #[test]
    fn a_refusal_reported_by_the_socket_is_not_fatal() {
        // On Linux only a connected socket reports the refusal; on Windows an unconnected one reports the same error.
        let local = (Ipv4Addr::LOCALHOST, 0);
        let closed = UdpSocket::bind(local).unwrap().local_addr().unwrap();
        let socket = UdpSocket::bind(local).unwrap();
        socket.connect(closed).unwrap();
        socket.send(b"hello").unwrap();
        let mut port = Port::new(socket).unwrap();
        let received = port.receive(Some(now() + Duration::from_secs(1)));
        assert!(matches!(received, Received::Fault) && port.faults == 1);
        assert!(matches!(port.receive(None), Received::Nothing));
    }
}
