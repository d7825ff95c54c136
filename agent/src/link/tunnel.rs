//! Carries Zenoh's traffic between hosts: over mutual TLS 1.3 on secured links, over TCP on plain ones. On each host
//! Zenoh uses local sockets that other users cannot reach ([`local`]), and the tunnel forwards their bytes to the other
//! hosts:
//!
//! ```text
//! Zenoh -- local socket -- tunnel == TLS over TCP, or TCP == tunnel -- local socket -- Zenoh
//! ```
//!
//! Owning the network sockets has three advantages: a cut link ends when the other host's kernel has acknowledged
//! nothing for [`UNACKNOWLEDGED_TIMEOUT`], however busy the processes at both ends are; closing a link never blocks a
//! thread (Zenoh's own TCP sockets linger for ten seconds); and the tunnel gives up early on a host that cannot be
//! reached.
//!
//! The links of observers and operators, the *guests*, do not lead to the session that the vehicle flies with but to another
//! one, the feed ([`super::Sessions`]). Handshakes and the links of guests have a thread of their own beside the one that carries
//! the vehicles' messages, and what a guest may send and receive is limited (`budget`).
//!
//! Zenoh's own TLS links are not used: they let two threads use one TLS connection at once, which corrupts memory
//! ([zenoh#2557](https://github.com/eclipse-zenoh/zenoh/issues/2557)). Here each end is identified by its certificate
//! before Zenoh sees the connection: a replaced certificate name makes no link, and a vehicle is up while it has a link
//! ([`super::presence`]).

mod budget;
mod local;
mod tls;

use std::hash::{BuildHasher, RandomState};
use std::io;
use std::net::{IpAddr, TcpListener as StdListener};
use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, copy, split};
use tokio::net::{TcpListener, TcpStream};
use tokio::runtime::{Builder, Handle, Runtime};
use tokio::time::{sleep, timeout};
use zenoh::Session;

use super::LinkError;
use super::presence::Presence;
use super::security::Tls;
use crate::unix;
use budget::{ByteLimit, GuestRates, HandshakeRate, Quota, QuotaUse};
use local::{FEED, FLIGHT, Place};
use skein_host::clock::now;
pub(super) use tls::{Peer, TlsContext};

/// Longest time to reach another host and to complete the TLS handshake. Zenoh dials again afterwards.
const CONNECT_TIMEOUT: Duration = Duration::from_millis(900);
/// Largest number of pending handshakes, in total and of one network. An attacker that never completes its handshake holds
/// one of them for [`CONNECT_TIMEOUT`].
const MAX_PENDING: usize = 256;
const MAX_PENDING_PER_NETWORK: usize = 16;
/// Largest number of links with certificates, in total, of one network, and of one certificate. Agents on one host may
/// share a network. A vehicle has one link with another, and for a moment its old one beside it; all observers of one PC
/// have the same certificate.
const MAX_LINKS: usize = 512;
const MAX_LINKS_PER_NETWORK: usize = 128;
const MAX_LINKS_PER_VEHICLE: usize = 4;
const MAX_LINKS_PER_GUEST: usize = 16;
/// Longest random pause before a host that could not be reached is dialled again, so that the agents that a switch has cut
/// off do not all dial in the same instant.
const MAX_DIAL_JITTER: Duration = Duration::from_millis(200);
/// A link is cut when the other end has acknowledged nothing for this long. An agent sends at least five times a
/// second.
const UNACKNOWLEDGED_TIMEOUT: Duration = Duration::from_secs(1);
/// Bytes read at once from a guest or for one.
const GUEST_BYTES_AT_ONCE: usize = 8192;
/// Time to announce the end of a link to the other host.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_millis(200);
/// Pause after a failed accept, for example because no file descriptor is left.
const PAUSE: Duration = Duration::from_millis(100);

/// All links of one agent or observer to other hosts; dropping it ends them.
pub(super) struct Tunnel {
    shared: Arc<TunnelState>,
    listeners: Vec<StdListener>,
    place: Place,
    /// Local endpoints for Zenoh to dial, one for each host to reach.
    pub(super) zenoh_dials: Vec<String>,
    /// The sockets behind them, each with the endpoint of its host.
    dialled: Vec<(local::Listener, String)>,
    /// Carries the links with vehicles. Taken on drop, because a runtime must not wait for its own last thread.
    runtime: Option<Runtime>,
    /// Completes handshakes of hosts that dial this one, if any do, and carries the links with guests. Taken on drop too.
    for_guests: Option<Runtime>,
}

struct TunnelState {
    /// Certificates and keys; `None` on plain links.
    tls_context: Option<TlsContext>,
    presence: Arc<Presence>,
    /// The links that other hosts have made with this one, counted by network and by certificate.
    links_of_network: Arc<Quota<IpAddr>>,
    links_of_certificate: Arc<Quota<String>>,
    guests: GuestRates,
}

impl TunnelState {
    /// Counts one more link of another host with this one until the returned value is dropped.
    ///
    /// # Errors
    /// [`io::ErrorKind::InvalidData`] if the network or the certificate has as many links as one may have.
    fn admit(
        &self,
        connection: &Connection,
        network: IpAddr,
    ) -> io::Result<(QuotaUse<IpAddr>, Option<QuotaUse<String>>)> {
        let full = |what: String| io::Error::new(io::ErrorKind::InvalidData, what);
        let of_network = self.links_of_network.take(network, MAX_LINKS_PER_NETWORK, MAX_LINKS);
        let of_network = of_network.ok_or_else(|| full(format!("{network} has too many links already")))?;
        let Some(peer) = &connection.peer else { return Ok((of_network, None)) };
        let most = if peer.vehicle.is_some() { MAX_LINKS_PER_VEHICLE } else { MAX_LINKS_PER_GUEST };
        let of_certificate = self.links_of_certificate.take(peer.name.clone(), most, MAX_LINKS);
        let of_certificate = of_certificate
            .ok_or_else(|| full(format!("{most} links under the certificate {:?} exist already", peer.name)))?;
        Ok((of_network, Some(of_certificate)))
    }
}

impl Tunnel {
    /// Binds `listen` and a local socket for each of `dial`: endpoints like `tls/10.0.0.11:7447`, or
    /// `tcp/10.0.0.11:7447` without keys. No traffic flows before [`Self::carry`].
    ///
    /// # Errors
    /// If a key is not valid, or an address cannot be listened on.
    pub(super) fn open(listen: &[String], dial: &[String], tls: Option<&Tls>) -> Result<Self, LinkError> {
        let tls_context = tls.map(TlsContext::new).transpose()?;
        let taken = |source: io::Error| LinkError::Open(listen.to_vec(), source.into());
        let bind = |endpoint: &String| {
            let listener = StdListener::bind(address(endpoint))?;
            listener.set_nonblocking(true)?;
            Ok(listener)
        };
        let listeners: Vec<_> = listen.iter().map(bind).collect::<io::Result<_>>().map_err(taken)?;
        let thread = |name: &str| Builder::new_multi_thread().worker_threads(1).thread_name(name).enable_all().build();
        let runtime = thread("tunnel").map_err(taken)?;
        let for_guests = (!listeners.is_empty()).then(|| thread("guests")).transpose().map_err(taken)?;
        let place = Place::new().map_err(taken)?;
        let bind = |(nth, host): (usize, &String)| place.bind(nth).map(|(local, at)| (at, (local, host.clone())));
        let locals =
            runtime.block_on(async { dial.iter().enumerate().map(bind).collect::<io::Result<(Vec<_>, Vec<_>)>>() });
        let (zenoh_dials, dialled) = locals.map_err(taken)?;
        // Only a certificate identifies the vehicle at the other end.
        let presence = if tls_context.is_some() { Presence::by_links() } else { Presence::by_tokens() };
        Ok(Self {
            shared: Arc::new(TunnelState {
                tls_context,
                presence,
                links_of_network: Quota::new(),
                links_of_certificate: Quota::new(),
                guests: GuestRates::default(),
            }),
            listeners,
            place,
            zenoh_dials,
            dialled,
            runtime: Some(runtime),
            for_guests,
        })
    }

    /// Local endpoint for Zenoh to listen on, if other hosts dial this one.
    pub(super) fn zenoh_listens(&self) -> Option<String> {
        (!self.listeners.is_empty()).then(|| self.place.endpoint(FLIGHT))
    }

    /// Local endpoint for the feed to listen on, if guests can dial this host and be distinguished from vehicles: only a certificate
    /// says which of the two dials.
    pub(super) fn feed_listens(&self) -> Option<String> {
        let is_secured = self.shared.tls_context.is_some();
        (is_secured && !self.listeners.is_empty()).then(|| self.place.endpoint(FEED))
    }

    /// Endpoints that other hosts dial, with the actual ports.
    pub(super) fn endpoints(&self) -> Vec<String> {
        let addresses = self.listeners.iter().filter_map(|listener| listener.local_addr().ok());
        let protocol = if self.shared.tls_context.is_some() { "tls" } else { "tcp" };
        addresses.map(|address| format!("{protocol}/{address}")).collect()
    }

    /// Follows which vehicles are up.
    pub(super) fn presence(&self) -> &Arc<Presence> {
        &self.shared.presence
    }

    /// Starts to carry the traffic of the listening session and of the feed, if there are any, and of every session that
    /// dials a local socket.
    pub(super) fn carry(&mut self, listening: Option<&Session>, feed: Option<&Session>) -> io::Result<()> {
        let Some(runtime) = &self.runtime else { return Ok(()) };
        if let (Some(session), Some(for_guests)) = (listening, &self.for_guests) {
            let host = Arc::new(Host {
                shared: self.shared.clone(),
                zenoh: self.place.address(FLIGHT, session)?,
                feed: feed.map(|feed| self.place.address(FEED, feed)).transpose()?,
                for_vehicles: runtime.handle().clone(),
                for_guests: for_guests.handle().clone(),
            });
            let _in_runtime = for_guests.enter();
            for listener in &self.listeners {
                let listener = TcpListener::from_std(listener.try_clone()?)?;
                for_guests.spawn(accept(listener, host.clone()));
            }
        }
        let _in_runtime = runtime.enter();
        for (local, endpoint) in self.dialled.drain(..) {
            let shared = self.shared.clone();
            runtime.spawn(async move {
                loop {
                    match local::accept(&local).await {
                        Ok(zenoh) => _ = tokio::spawn(dial(zenoh, endpoint.clone(), shared.clone())),
                        Err(_) => sleep(PAUSE).await,
                    }
                }
            });
        }
        Ok(())
    }
}

impl Drop for Tunnel {
    fn drop(&mut self) {
        for runtime in [self.runtime.take(), self.for_guests.take()].into_iter().flatten() {
            runtime.shutdown_background();
        }
    }
}

/// The sessions to which a host that dials this one is connected.
struct Host {
    shared: Arc<TunnelState>,
    /// The address at which the session listens that is linked with the other vehicles.
    zenoh: local::Address,
    /// The address at which the feed listens; `None` without a feed.
    feed: Option<local::Address>,
    /// Carry the links with vehicles and with guests.
    for_vehicles: Handle,
    for_guests: Handle,
}

/// Accepts connections that show a known certificate, as far as the budgets allow.
async fn accept(listener: TcpListener, host: Arc<Host>) {
    let pending = Quota::new();
    let mut rate = HandshakeRate::new(now());
    loop {
        let Ok((socket, from)) = listener.accept().await else {
            sleep(PAUSE).await;
            continue;
        };
        let network = budget::network(from.ip());
        if !rate.allows(network, now()) {
            tracing::debug!("no link from {from}: too many handshakes a second");
            continue;
        }
        let Some(handshake) = pending.take(network, MAX_PENDING_PER_NETWORK, MAX_PENDING) else {
            tracing::debug!("no link from {from}: too many handshakes are pending");
            continue;
        };
        let host = host.clone();
        tokio::spawn(async move {
            let shared = &host.shared;
            let accepted = async {
                prepare(&socket)?;
                let socket = host.hand_over(socket)?;
                io::Result::Ok(match &shared.tls_context {
                    Some(tls_context) => tls_context.accept(socket).await?,
                    None => Connection { stream: Box::new(socket), peer: None },
                })
            };
            let accepted = timeout(CONNECT_TIMEOUT, accepted).await.unwrap_or(Err(io::ErrorKind::TimedOut.into()));
            drop(handshake);
            let address = from.ip().to_string();
            match accepted.and_then(|connection| Ok((shared.admit(&connection, network)?, connection))) {
                Ok((within_budget, connection)) => host.link(connection, within_budget, address),
                // A port scan, or a network that failed during the handshake.
                Err(error) if error.kind() != io::ErrorKind::InvalidData => {
                    tracing::debug!("no link from {from}: {error}")
                }
                Err(error) => shared.presence.refuse(&address, &error.to_string()),
            }
        });
    }
}

impl Host {
    /// Lets the vehicles' thread wait for this socket, so that no guest delays a vehicle's link.
    fn hand_over(&self, socket: TcpStream) -> io::Result<TcpStream> {
        let socket = socket.into_std()?;
        let _in_runtime = self.for_vehicles.enter();
        TcpStream::from_std(socket)
    }

    /// Carries the traffic of this connection until it ends, on the thread of its kind. `within_budget` counts the link until
    /// then.
    fn link(self: Arc<Self>, connection: Connection, within_budget: impl Send + 'static, address: String) {
        let thread = if connection.guest().is_some() { &self.for_guests } else { &self.for_vehicles };
        thread.clone().spawn(async move {
            let _within_budget = within_budget;
            let guest = connection.guest().map(|guest| self.shared.guests.link(&guest.name, now()));
            let zenoh = if guest.is_some() { self.feed.as_ref() } else { Some(&self.zenoh) };
            let Some(zenoh) = zenoh else { return };
            if let Ok(here) = local::connect(zenoh).await {
                carry(connection, here, &address, guest, &self.shared.presence).await;
            }
        });
    }
}

/// Connects to another host for Zenoh, which dials again if that fails.
async fn dial(here: local::Stream, endpoint: String, shared: Arc<TunnelState>) {
    let address = address(&endpoint);
    let reach = async {
        let socket = TcpStream::connect(address).await?;
        prepare(&socket)?;
        io::Result::Ok(match &shared.tls_context {
            Some(tls_context) => tls_context.connect(host(address), socket).await?,
            None => Connection { stream: Box::new(socket), peer: None },
        })
    };
    match timeout(CONNECT_TIMEOUT, reach).await {
        Ok(Ok(connection)) => return carry(connection, here, address, None, &shared.presence).await,
        Ok(Err(error)) if error.kind() == io::ErrorKind::InvalidData => {
            shared.presence.refuse(address, &error.to_string());
        }
        Ok(Err(error)) => tracing::debug!("cannot reach {address}: {error}"),
        Err(_) => tracing::debug!("cannot reach {address}: no reply"),
    }
    // Zenoh dials again when `here` closes.
    sleep(MAX_DIAL_JITTER.mul_f64(random_share())).await;
    drop(here);
}

/// A random number from 0 to 1, different in every process.
fn random_share() -> f64 {
    f64::from(RandomState::new().hash_one(()) as u32) / f64::from(u32::MAX)
}

/// Sets the options of a socket to another host.
fn prepare(socket: &TcpStream) -> io::Result<()> {
    socket.set_nodelay(true)?;
    unix::set_unacknowledged_timeout(socket, UNACKNOWLEDGED_TIMEOUT)
}

/// A stream of bytes in both directions.
trait Duplex: AsyncRead + AsyncWrite + Send + Unpin {}
impl<S: AsyncRead + AsyncWrite + Send + Unpin> Duplex for S {}

/// A connection to another host.
struct Connection {
    stream: Box<dyn Duplex>,
    /// The identified other end; `None` on a plain link.
    peer: Option<Peer>,
}

impl Connection {
    /// The observer or operator at the other end, if it is one.
    fn guest(&self) -> Option<&Peer> {
        self.peer.as_ref().filter(|peer| peer.vehicle.is_none())
    }
}

/// Copies bytes between a link and the local socket `here` in both directions until one end closes. A link outlives the
/// certificates that it was made with, because a flight must not be cut in the air; the next link needs valid ones.
async fn carry(
    Connection { stream, peer }: Connection,
    here: local::Stream,
    address: &str,
    guest: Option<(ByteLimit, ByteLimit)>,
    presence: &Arc<Presence>,
) {
    let _link = presence.link(peer.and_then(|peer| peer.vehicle));
    let (mut from_there, mut to_there) = split(stream);
    let (mut from_here, mut to_here) = split(here);
    let (received, sent) = guest.unzip();
    // Neither direction waits for the other, or a cut link would go unnoticed for a quarter of an hour.
    tokio::select! {
        copied = copy_within(&mut from_there, &mut to_here, received) => match copied {
            // TLS 1.3 reports a refused client certificate only after the handshake.
            Err(error) if error.kind() == io::ErrorKind::InvalidData => {
                presence.refuse(address, &error.to_string());
            }
            _ => {}
        },
        _ = copy_within(&mut from_here, &mut to_there, sent) => {}
    }
    let _ = timeout(SHUTDOWN_TIMEOUT, to_there.shutdown()).await;
}

/// Copies bytes until one end closes, no faster and no more than the limit allows, if there is one.
async fn copy_within<R: AsyncRead + Unpin, W: AsyncWrite + Unpin>(
    from: &mut R,
    to: &mut W,
    limit: Option<ByteLimit>,
) -> io::Result<()> {
    let Some(mut limit) = limit else { return copy(from, to).await.map(drop) };
    let mut bytes = vec![0; GUEST_BYTES_AT_ONCE];
    loop {
        let count = from.read(&mut bytes).await?;
        let Some(wait) = limit.take(count, now()).filter(|_| count > 0) else { return Ok(()) };
        if !wait.is_zero() {
            sleep(wait).await;
        }
        to.write_all(&bytes[..count]).await?;
        to.flush().await?;
    }
}

/// `10.0.0.11:7447` of `tls/10.0.0.11:7447`.
fn address(endpoint: &str) -> &str {
    endpoint.split_once('/').map_or(endpoint, |(_, address)| address)
}

/// `10.0.0.11` of `10.0.0.11:7447`, `::1` of `[::1]:7447`.
fn host(address: &str) -> &str {
    address.rsplit_once(':').map_or(address, |(host, _)| host).trim_matches(['[', ']'])
}
