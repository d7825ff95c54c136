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
//! Zenoh's own TLS links are not used: they let two threads use one TLS connection at once, which corrupts memory
//! ([zenoh#2557](https://github.com/eclipse-zenoh/zenoh/issues/2557)). Here each end is identified by its certificate
//! before Zenoh sees the connection: a replaced certificate name makes no link, and a vehicle is up while it has a link
//! ([`super::presence`]).

mod local;
mod tls;

use std::collections::BTreeMap;
use std::io;
use std::net::{IpAddr, TcpListener as StdListener};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use skein_common::id::VehicleName;
use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt, copy, split};
use tokio::net::{TcpListener, TcpStream};
use tokio::runtime::{Builder, Runtime};
use tokio::sync::Semaphore;
use tokio::time::{sleep, timeout};
use tokio_rustls::TlsStream;
use zenoh::Session;

use super::LinkError;
use super::presence::Presence;
use super::security::Tls;
use crate::unix;
use local::{Locals, ZenohListener};
pub(super) use tls::{Peer, TlsContext};

/// Longest time to reach another host and to complete the TLS handshake. Zenoh dials again afterwards.
const CONNECT_TIMEOUT: Duration = Duration::from_millis(900);
/// Largest number of handshakes at once, in total and from one address, so that a stranger that never completes its
/// handshake does not keep the others waiting. Several agents may share a host; a refused one dials again.
const MAX_PENDING: usize = 64;
const MAX_PENDING_PER_ADDRESS: usize = 16;
/// A link is cut when the other end has acknowledged nothing for this long. An agent sends at least five times a
/// second.
const UNACKNOWLEDGED_TIMEOUT: Duration = Duration::from_secs(1);
/// Time to announce the end of a link to the other host.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_millis(200);
/// Pause after a failed accept, for example because no file descriptor is left.
const PAUSE: Duration = Duration::from_millis(100);

/// All links of one agent or observer to other hosts; dropping it ends them.
pub(super) struct Tunnel {
    shared: Arc<Shared>,
    listeners: Vec<StdListener>,
    locals: Locals,
    /// Taken on drop, because a runtime must not wait for its own last thread.
    runtime: Option<Runtime>,
}

struct Shared {
    /// Certificates and keys; `None` on plain links.
    tls_context: Option<TlsContext>,
    presence: Arc<Presence>,
}

impl Tunnel {
    /// Binds `listen` and a local socket for each of `dial`: endpoints like `tls/10.0.0.11:7447`, or
    /// `tcp/10.0.0.11:7447` without keys. No traffic flows before [`Self::carry`].
    ///
    /// # Errors
    /// If a key is not valid, or an address cannot be listened on.
    pub(super) fn open(listen: &[String], dial: &[String], tls: Option<&Tls>) -> Result<Self, LinkError> {
        let tls_context = tls.map(TlsContext::new).transpose()?;
        let taken = |source: io::Error| LinkError::Open { listen: listen.to_vec(), source: source.into() };
        let bind = |endpoint: &String| {
            let listener = StdListener::bind(address(endpoint))?;
            listener.set_nonblocking(true)?;
            Ok(listener)
        };
        let listeners = listen.iter().map(bind).collect::<io::Result<_>>().map_err(taken)?;
        let runtime =
            Builder::new_multi_thread().worker_threads(1).thread_name("tunnel").enable_all().build().map_err(taken)?;
        let locals = runtime.block_on(async { Locals::open(dial) }).map_err(taken)?;
        // Only a certificate identifies the vehicle at the other end.
        let presence = if tls_context.is_some() { Presence::by_links() } else { Presence::by_tokens() };
        Ok(Self { shared: Arc::new(Shared { tls_context, presence }), listeners, locals, runtime: Some(runtime) })
    }

    /// Local endpoint for Zenoh to listen on, if other hosts dial this one.
    pub(super) fn zenoh_listens(&self) -> Vec<String> {
        if self.listeners.is_empty() { Vec::new() } else { vec![self.locals.zenoh_listens()] }
    }

    /// Local endpoints for Zenoh to dial, one for each host to reach.
    pub(super) fn zenoh_dials(&self) -> Vec<String> {
        self.locals.zenoh_dials()
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

    /// Starts to carry the traffic of the listening session, if there is one, and of every session that dials a local
    /// socket.
    pub(super) fn carry(&mut self, listening: Option<&Session>) -> io::Result<()> {
        let Some(runtime) = &self.runtime else { return Ok(()) };
        let _in_runtime = runtime.enter();
        if let Some(session) = listening {
            let zenoh = Arc::new(self.locals.zenoh(session)?);
            for listener in &self.listeners {
                let listener = TcpListener::from_std(listener.try_clone()?)?;
                runtime.spawn(accept(listener, zenoh.clone(), self.shared.clone()));
            }
        }
        for (local, endpoint) in self.locals.take_dial_sockets() {
            let shared = self.shared.clone();
            runtime.spawn(async move {
                loop {
                    match local.accept().await {
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
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

/// Accepts connections that show a known certificate.
async fn accept(listener: TcpListener, zenoh: Arc<ZenohListener>, shared: Arc<Shared>) {
    let permits = Arc::new(Semaphore::new(MAX_PENDING));
    let pending = Arc::new(PendingHandshakes::default());
    loop {
        let Ok((socket, from)) = listener.accept().await else {
            sleep(PAUSE).await;
            continue;
        };
        let Some(handshake) = PendingHandshake::new(&pending, from.ip()) else {
            tracing::debug!("no link from {from}: {MAX_PENDING_PER_ADDRESS} handshakes from that address are pending");
            continue;
        };
        // The semaphore is never closed.
        let Ok(permit) = permits.clone().acquire_owned().await else { return };
        let (zenoh, shared) = (zenoh.clone(), shared.clone());
        tokio::spawn(async move {
            let accepted = async {
                prepare(&socket)?;
                io::Result::Ok(match &shared.tls_context {
                    Some(tls_context) => Connection::secured(tls_context.accept(socket).await?),
                    None => Connection::Plain(socket),
                })
            };
            let accepted = timeout(CONNECT_TIMEOUT, accepted).await.unwrap_or(Err(io::ErrorKind::TimedOut.into()));
            drop((permit, handshake));
            match accepted {
                Ok(connection) => {
                    if let Ok(here) = zenoh.connect().await {
                        connection.carry(here, &from.ip().to_string(), &shared.presence).await;
                    }
                }
                // A port scan, or a network that failed during the handshake.
                Err(error) if error.kind() != io::ErrorKind::InvalidData => {
                    tracing::debug!("no link from {from}: {error}")
                }
                Err(error) => shared.presence.refuse(&from.ip().to_string(), &error.to_string()),
            }
        });
    }
}

/// Number of pending handshakes by address.
type PendingHandshakes = Mutex<BTreeMap<IpAddr, usize>>;

/// One pending handshake.
struct PendingHandshake {
    pending: Arc<PendingHandshakes>,
    from: IpAddr,
}

impl PendingHandshake {
    /// Returns `None` if too many handshakes from this address are pending.
    fn new(pending: &Arc<PendingHandshakes>, from: IpAddr) -> Option<Self> {
        let mut counts = lock(pending);
        let count = counts.entry(from).or_default();
        if *count >= MAX_PENDING_PER_ADDRESS {
            return None;
        }
        *count += 1;
        Some(Self { pending: pending.clone(), from })
    }
}

impl Drop for PendingHandshake {
    fn drop(&mut self) {
        let mut counts = lock(&self.pending);
        counts.entry(self.from).and_modify(|count| *count -= 1);
        counts.retain(|_, count| *count > 0);
    }
}

/// Locks the counts. No holder can panic, so poisoning is ignored.
fn lock(pending: &PendingHandshakes) -> MutexGuard<'_, BTreeMap<IpAddr, usize>> {
    pending.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Connects to another host for Zenoh, which dials again if that fails.
async fn dial(here: local::Stream, endpoint: String, shared: Arc<Shared>) {
    let address = address(&endpoint);
    let reach = async {
        let socket = TcpStream::connect(address).await?;
        prepare(&socket)?;
        io::Result::Ok(match &shared.tls_context {
            Some(tls_context) => Connection::secured(tls_context.connect(host(address), socket).await?),
            None => Connection::Plain(socket),
        })
    };
    match timeout(CONNECT_TIMEOUT, reach).await {
        Ok(Ok(connection)) => connection.carry(here, address, &shared.presence).await,
        Ok(Err(error)) if error.kind() == io::ErrorKind::InvalidData => {
            shared.presence.refuse(address, &error.to_string());
        }
        Ok(Err(error)) => tracing::debug!("cannot reach {address}: {error}"),
        Err(_) => tracing::debug!("cannot reach {address}: no reply"),
    }
}

/// Sets the options of a socket to another host.
fn prepare(socket: &TcpStream) -> io::Result<()> {
    socket.set_nodelay(true)?;
    unix::set_unacknowledged_timeout(socket, UNACKNOWLEDGED_TIMEOUT)
}

/// A connection to another host.
enum Connection {
    Plain(TcpStream),
    Tls(Box<TlsStream<TcpStream>>, Peer),
}

impl Connection {
    fn secured((stream, peer): (TlsStream<TcpStream>, Peer)) -> Self {
        Self::Tls(Box::new(stream), peer)
    }

    /// Carries the traffic of the local socket `here` until the link ends.
    async fn carry(self, here: local::Stream, address: &str, presence: &Arc<Presence>) {
        match self {
            Self::Plain(there) => carry(there, here, (address, &Peer::unknown()), presence).await,
            Self::Tls(there, peer) => carry(there, here, (address, &peer), presence).await,
        }
    }
}

/// Copies bytes in both directions until one end closes or the other host's certificate expires.
async fn carry(
    there: impl AsyncRead + AsyncWrite + Unpin,
    here: impl AsyncRead + AsyncWrite + Unpin,
    (address, peer): (&str, &Peer),
    presence: &Arc<Presence>,
) {
    let _link = presence.link(peer.vehicle);
    let (mut from_there, mut to_there) = split(there);
    let (mut from_here, mut to_here) = split(here);
    // Neither direction waits for the other, or a cut link would go unnoticed for a quarter of an hour.
    tokio::select! {
        copied = copy(&mut from_there, &mut to_here) => match copied {
            // TLS 1.3 reports a refused client certificate only after the handshake.
            Err(error) if error.kind() == io::ErrorKind::InvalidData => {
                presence.refuse(address, &error.to_string());
            }
            _ => {}
        },
        _ = copy(&mut from_here, &mut to_there) => {}
        () = sleep(peer.valid_for) => tracing::warn!("the link with {} was closed: its certificate has expired", peer.name),
    }
    let _ = timeout(SHUTDOWN_TIMEOUT, to_there.shutdown()).await;
}

/// `10.0.0.11:7447` of `tls/10.0.0.11:7447`.
fn address(endpoint: &str) -> &str {
    endpoint.split_once('/').map_or(endpoint, |(_, address)| address)
}

/// `10.0.0.11` of `10.0.0.11:7447`, `::1` of `[::1]:7447`.
fn host(address: &str) -> &str {
    address.rsplit_once(':').map_or(address, |(host, _)| host).trim_matches(['[', ']'])
}

/// The other end of a link.
impl Peer {
    /// A host with this certificate name, whose certificate is valid for `valid_for`.
    fn new(name: String, vehicle: Option<VehicleName>, valid_for: Duration) -> Self {
        Self { name, vehicle, valid_for }
    }

    /// The other end of a plain link.
    fn unknown() -> Self {
        Self::new("a plain link".to_owned(), None, Duration::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_address_cannot_take_all_pending_handshakes() {
        let pending = Arc::new(PendingHandshakes::default());
        let [stranger, other] = ["10.0.0.9", "10.0.0.11"].map(|ip| ip.parse::<IpAddr>().unwrap());
        let mut strangers: Vec<_> =
            (0..MAX_PENDING).filter_map(|_| PendingHandshake::new(&pending, stranger)).collect();
        assert_eq!(strangers.len(), MAX_PENDING_PER_ADDRESS);
        assert!(PendingHandshake::new(&pending, other).is_some());
        strangers.pop();
        assert!(PendingHandshake::new(&pending, stranger).is_some(), "one of its handshakes has ended");
        strangers.clear();
        assert!(lock(&pending).is_empty(), "an address without pending handshakes is forgotten");
    }
}
