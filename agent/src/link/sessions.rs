//! The Zenoh sessions of one agent or observer.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use skein_common::id::SwarmName;
use zenoh::{Session, Wait};

use super::presence::Presence;
use super::tunnel::Tunnel;
use super::{LinkError, Security, open_zenoh};

/// Whether this endpoint is one of this PC's loopback.
fn is_loopback(endpoint: &str) -> bool {
    let address = endpoint.split_once('/').map_or(endpoint, |(_, address)| address);
    address.parse::<SocketAddr>().is_ok_and(|address| address.ip().is_loopback())
}

/// Sessions that do not close within this time are left to the end of the process.
const CLOSE_WITHIN: Duration = Duration::from_secs(1);

/// One that listens and one that dials, or one that does both; and what carries their words to other hosts, if they have
/// links to any. Each of the others is linked to one of them.
///
/// Whoever comes in under the number of a session that was *dialled* joins it; under the number of one that came in itself,
/// it is turned away. So secured agents dial from a session that nobody can come in to, whose number only those are shown who
/// are dialled: else everybody with a certificate could break the links between the others.
#[derive(Clone)]
pub struct Sessions {
    pub(super) all: Vec<Arc<Session>>,
    tunnel: Option<Arc<Tunnel>>,
}

impl From<Session> for Sessions {
    fn from(session: Session) -> Self {
        Self { all: vec![Arc::new(session)], tunnel: None }
    }
}

impl Sessions {
    /// Opens what an agent or observer of this swarm needs, which listens only on `listen` (an observer: nowhere) and keeps
    /// dialling `dial`: endpoints like `tls/10.0.0.11:7447`, or `tcp/127.0.0.1:7447` where nothing is secured. Peers do not
    /// relay for each other, so every pair needs one direction, and exactly one, in somebody's `dial`.
    ///
    /// It succeeds with nobody there. Blocks for up to half a second; not for a Tokio thread.
    ///
    /// # Errors
    /// An endpoint that is none, keys that are none, or an address that cannot be listened on.
    pub fn open(swarm: &SwarmName, listen: &[String], dial: &[String], security: &Security) -> Result<Self, LinkError> {
        security.check(listen, dial)?;
        let tls = match security {
            Security::Tls(tls) => Some(tls),
            // Of this PC alone nothing is ever cut off.
            Security::Plain if listen.iter().chain(dial).all(|endpoint| is_loopback(endpoint)) => {
                return Ok(open_zenoh(swarm, listen, dial, &[])?.into());
            }
            Security::Plain => None,
        };
        Self::through(Tunnel::open(listen, dial, tls)?, |listen, dial| open_zenoh(swarm, listen, dial, &[]))
    }

    /// Sessions as `open` makes them, which speak through this tunnel.
    pub(super) fn through(
        mut tunnel: Tunnel,
        open: impl Fn(&[String], &[String]) -> Result<Session, LinkError>,
    ) -> Result<Self, LinkError> {
        let (listen, dial) = (tunnel.zenoh_listens(), tunnel.zenoh_dials());
        let listening = if listen.is_empty() { None } else { Some(Arc::new(open(&listen, &[])?)) };
        // Before the one that dials: it waits half a second for those whom it cannot reach.
        let carried = tunnel.carry(listening.as_deref());
        carried.map_err(|source| LinkError::Open { listen: tunnel.endpoints(), source: source.into() })?;
        let dialling = if dial.is_empty() && listening.is_some() { None } else { Some(Arc::new(open(&[], &dial)?)) };
        Ok(Self { all: listening.into_iter().chain(dialling).collect(), tunnel: Some(Arc::new(tunnel)) })
    }

    /// The first of them: the only one of an observer.
    pub fn first(&self) -> &Session {
        &self.all[0]
    }

    /// Where others reach them, with the ports that they were given.
    pub fn endpoints(&self) -> Vec<String> {
        match &self.tunnel {
            Some(tunnel) => tunnel.endpoints(),
            None => self.first().info().locators().wait().iter().map(ToString::to_string).collect(),
        }
    }

    /// Follows who is there.
    pub fn presence(&self) -> Arc<Presence> {
        self.tunnel.as_ref().map_or_else(Presence::by_tokens, |tunnel| tunnel.presence().clone())
    }

    /// Closes them and drops what stands on them, soon or else in the background: on a bad network Zenoh's own closing can take
    /// ten seconds.
    pub(super) fn close(&self, rest: impl Send + 'static) {
        let Self { all, tunnel } = self.clone();
        let (done, is_done) = mpsc::channel();
        thread::spawn(move || {
            // A session that cannot be closed ends with the process.
            let closing = all.into_iter().map(|session| thread::spawn(move || drop(session.close().wait())));
            closing.collect::<Vec<_>>().into_iter().for_each(|closing| drop(closing.join()));
            drop((rest, tunnel));
            let _ = done.send(());
        });
        let _ = is_done.recv_timeout(CLOSE_WITHIN);
    }
}
