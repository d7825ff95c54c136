//! Links between hosts: where they are secured, mutual TLS 1.3 around what Zenoh says; where they are plain, TCP. On each host
//! Zenoh speaks over sockets that nobody else gets at ([`local`]), and this carries what it says to the other hosts:
//!
//! ```text
//! Zenoh -- local socket -- tunnel == TLS over TCP, or TCP == tunnel -- local socket -- Zenoh
//! ```
//!
//! The sockets of the network are ours, so that a link that was cut ends when the other host's kernel has acknowledged nothing
//! for [`CUT_AFTER`], whatever the processes at both ends have time for; so that closing it never blocks a thread (Zenoh's own
//! TCP sockets linger for ten seconds); and so that a host that cannot be reached is given up soon.
//!
//! Zenoh's own TLS links are not used: they let two threads use one TLS connection at once, which corrupts memory
//! ([zenoh#2557](https://github.com/eclipse-zenoh/zenoh/issues/2557)). Here each end is known by its certificate before
//! Zenoh hears of it: a name that does not count, because it was replaced, makes no link; and who has a link is who is there
//! ([`super::presence`]).

mod local;
mod tls;

use std::collections::BTreeMap;
use std::io;
use std::net::{IpAddr, TcpListener as StdListener};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use skein_common::id::VehicleId;
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
pub(super) use tls::{Ends, Peer};

/// Longest time to reach another host, and then to agree with it on who is who. Zenoh tries again when this has ended.
const REACH_WITHIN: Duration = Duration::from_millis(900);
/// So many may be asked at once who they are, and so many of them from one address: a stranger who never tells must not keep
/// the others waiting. Several agents may share a host; who is sent away dials again.
const AT_ONCE: usize = 64;
const AT_ONCE_OF_ONE: usize = 16;
/// A link whose other end has acknowledged nothing for so long is cut. Something is sent at least five times a second.
const CUT_AFTER: Duration = Duration::from_secs(1);
/// A link that ends says so within this time.
const GOODBYE_WITHIN: Duration = Duration::from_millis(200);
/// What a PC without a file descriptor left waits before it accepts again.
const PAUSE: Duration = Duration::from_millis(100);

/// All links of one agent or observer to other hosts; they end with it.
pub(super) struct Tunnel {
    shared: Arc<Shared>,
    listeners: Vec<StdListener>,
    locals: Locals,
    /// Taken when it ends: the last thread of a runtime must not be waited for by itself.
    runtime: Option<Runtime>,
}

struct Shared {
    /// Absent where links are plain.
    ends: Option<Ends>,
    presence: Arc<Presence>,
}

impl Tunnel {
    /// Binds `listen` and a local socket for each of `dial`, endpoints like `tls/10.0.0.11:7447`, or `tcp/10.0.0.11:7447` without
    /// keys. Nothing is carried before [`Self::carry`].
    ///
    /// # Errors
    /// Keys that are none, or an address that cannot be listened on.
    pub(super) fn open(listen: &[String], dial: &[String], tls: Option<&Tls>) -> Result<Self, LinkError> {
        let ends = tls.map(Ends::new).transpose()?;
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
        // Only a certificate tells whose link it is.
        let presence = if ends.is_some() { Presence::by_links() } else { Presence::by_tokens() };
        Ok(Self { shared: Arc::new(Shared { ends, presence }), listeners, locals, runtime: Some(runtime) })
    }

    /// Where Zenoh is to listen here, if it is reached from other hosts.
    pub(super) fn zenoh_listens(&self) -> Vec<String> {
        if self.listeners.is_empty() { Vec::new() } else { vec![self.locals.zenoh_listens()] }
    }

    /// What Zenoh is to dial here, to reach each of the others.
    pub(super) fn zenoh_dials(&self) -> Vec<String> {
        self.locals.zenoh_dials()
    }

    /// Where others reach this host, with the ports that it was given.
    pub(super) fn endpoints(&self) -> Vec<String> {
        let addresses = self.listeners.iter().filter_map(|listener| listener.local_addr().ok());
        let protocol = if self.shared.ends.is_some() { "tls" } else { "tcp" };
        addresses.map(|address| format!("{protocol}/{address}")).collect()
    }

    /// Who is there.
    pub(super) fn presence(&self) -> &Arc<Presence> {
        &self.shared.presence
    }

    /// Carries from now on what the session that listens, if one does, and whoever dials the local sockets say and hear.
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
        for (local, endpoint) in self.locals.take_dialled() {
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

/// Lets in who shows a certificate that counts.
async fn accept(listener: TcpListener, zenoh: Arc<ZenohListener>, shared: Arc<Shared>) {
    let at_once = Arc::new(Semaphore::new(AT_ONCE));
    let doorstep = Arc::new(Doorstep::default());
    loop {
        let Ok((socket, from)) = listener.accept().await else {
            sleep(PAUSE).await;
            continue;
        };
        let Some(waiting) = Waiting::new(&doorstep, from.ip()) else {
            tracing::debug!("no link from {from}: {AT_ONCE_OF_ONE} others from there do not tell who they are");
            continue;
        };
        // It is never closed.
        let Ok(asked) = at_once.clone().acquire_owned().await else { return };
        let (zenoh, shared) = (zenoh.clone(), shared.clone());
        tokio::spawn(async move {
            let let_in = async {
                prepare(&socket)?;
                io::Result::Ok(match &shared.ends {
                    Some(ends) => Way::secured(ends.accept(socket).await?),
                    None => Way::Plain(socket),
                })
            };
            let let_in = timeout(REACH_WITHIN, let_in).await.unwrap_or(Err(io::ErrorKind::TimedOut.into()));
            drop((asked, waiting));
            match let_in {
                Ok(way) => {
                    if let Ok(here) = zenoh.connect().await {
                        way.carry(here, &from.ip().to_string(), &shared.presence).await;
                    }
                }
                // Somebody who only looked whether the port is open, or whose network has gone.
                Err(error) if error.kind() != io::ErrorKind::InvalidData => {
                    tracing::debug!("no link from {from}: {error}")
                }
                Err(error) => shared.presence.refuse(&from.ip().to_string(), &error.to_string()),
            }
        });
    }
}

/// How many wait to be let in, from each address.
type Doorstep = Mutex<BTreeMap<IpAddr, usize>>;

/// One of them, until it is let in or sent away.
struct Waiting {
    doorstep: Arc<Doorstep>,
    from: IpAddr,
}

impl Waiting {
    /// `None` if there are too many from this address.
    fn new(doorstep: &Arc<Doorstep>, from: IpAddr) -> Option<Self> {
        let mut counts = lock(doorstep);
        let count = counts.entry(from).or_default();
        if *count >= AT_ONCE_OF_ONE {
            return None;
        }
        *count += 1;
        Some(Self { doorstep: doorstep.clone(), from })
    }
}

impl Drop for Waiting {
    fn drop(&mut self) {
        let mut counts = lock(&self.doorstep);
        counts.entry(self.from).and_modify(|count| *count -= 1);
        counts.retain(|_, count| *count > 0);
    }
}

/// Nothing that holds it can panic half way.
fn lock(doorstep: &Doorstep) -> MutexGuard<'_, BTreeMap<IpAddr, usize>> {
    doorstep.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Reaches another host for Zenoh, which tries again if that fails.
async fn dial(here: local::Stream, endpoint: String, shared: Arc<Shared>) {
    let address = address(&endpoint);
    let reach = async {
        let socket = TcpStream::connect(address).await?;
        prepare(&socket)?;
        io::Result::Ok(match &shared.ends {
            Some(ends) => Way::secured(ends.connect(host(address), socket).await?),
            None => Way::Plain(socket),
        })
    };
    match timeout(REACH_WITHIN, reach).await {
        Ok(Ok(way)) => way.carry(here, address, &shared.presence).await,
        Ok(Err(error)) if error.kind() == io::ErrorKind::InvalidData => {
            shared.presence.refuse(address, &error.to_string());
        }
        Ok(Err(error)) => tracing::debug!("{address} is not reached: {error}"),
        Err(_) => tracing::debug!("{address} is not reached: no answer"),
    }
}

/// A socket to another host.
fn prepare(socket: &TcpStream) -> io::Result<()> {
    socket.set_nodelay(true)?;
    unix::give_up_unacknowledged(socket, CUT_AFTER)
}

/// The way to another host.
enum Way {
    Plain(TcpStream),
    Tls(Box<TlsStream<TcpStream>>, Peer),
}

impl Way {
    fn secured((stream, peer): (TlsStream<TcpStream>, Peer)) -> Self {
        Self::Tls(Box::new(stream), peer)
    }

    /// Carries what Zenoh says `here` and hears, while the link stands.
    async fn carry(self, here: local::Stream, address: &str, presence: &Arc<Presence>) {
        match self {
            Self::Plain(there) => carry(there, here, (address, &Peer::unknown()), presence).await,
            Self::Tls(there, peer) => carry(there, here, (address, &peer), presence).await,
        }
    }
}

/// Carries everything both ways until one of the two ends, or the other's certificate.
async fn carry(
    there: impl AsyncRead + AsyncWrite + Unpin,
    here: impl AsyncRead + AsyncWrite + Unpin,
    (address, peer): (&str, &Peer),
    presence: &Arc<Presence>,
) {
    let _is_there = presence.link(peer.vehicle);
    let (mut from_there, mut to_there) = split(there);
    let (mut from_here, mut to_here) = split(here);
    // Neither waits for the other: one that was cut off would not be missed for a quarter of an hour.
    tokio::select! {
        copied = copy(&mut from_there, &mut to_here) => match copied {
            // It tells so only when the link stands already.
            Err(error) if error.kind() == io::ErrorKind::InvalidData => {
                presence.refuse(address, &error.to_string());
            }
            _ => {}
        },
        _ = copy(&mut from_here, &mut to_there) => {}
        () = sleep(peer.lasts) => tracing::warn!("the link with {} has ended with its certificate", peer.name),
    }
    let _ = timeout(GOODBYE_WITHIN, to_there.shutdown()).await;
}

/// `10.0.0.11:7447` of `tls/10.0.0.11:7447`.
fn address(endpoint: &str) -> &str {
    endpoint.split_once('/').map_or(endpoint, |(_, address)| address)
}

/// `10.0.0.11` of `10.0.0.11:7447`, `::1` of `[::1]:7447`.
fn host(address: &str) -> &str {
    address.rsplit_once(':').map_or(address, |(host, _)| host).trim_matches(['[', ']'])
}

/// Whose a link is.
impl Peer {
    /// Of this name, as long as its certificate lasts.
    fn new(name: String, vehicle: Option<VehicleId>, lasts: Duration) -> Self {
        Self { name, vehicle, lasts }
    }

    /// Where links are plain.
    fn unknown() -> Self {
        Self::new("a plain link".to_owned(), None, Duration::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nobody_holds_the_whole_doorstep() {
        let doorstep = Arc::new(Doorstep::default());
        let [stranger, other] = ["10.0.0.9", "10.0.0.11"].map(|ip| ip.parse::<IpAddr>().unwrap());
        let mut strangers: Vec<_> = (0..AT_ONCE).filter_map(|_| Waiting::new(&doorstep, stranger)).collect();
        assert_eq!(strangers.len(), AT_ONCE_OF_ONE);
        assert!(Waiting::new(&doorstep, other).is_some());
        strangers.pop();
        assert!(Waiting::new(&doorstep, stranger).is_some(), "one of them was sent away");
        strangers.clear();
        assert!(lock(&doorstep).is_empty(), "nothing is kept of who has gone");
    }
}
