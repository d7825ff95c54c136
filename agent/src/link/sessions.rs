//! The Zenoh sessions of one agent or observer.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use serde_json::json;
use skein_common::id::SwarmName;
use zenoh::{Session, Wait};

use super::presence::Presence;
use super::tunnel::Tunnel;
use super::{LinkError, Security, open_zenoh};

/// Whether this endpoint is on the loopback.
fn is_loopback(endpoint: &str) -> bool {
    let address = endpoint.split_once('/').map_or(endpoint, |(_, address)| address);
    address.parse::<SocketAddr>().is_ok_and(|address| address.ip().is_loopback())
}

/// Time in which a host that has a link must also open its Zenoh session: idle links hold no place of those that may be
/// opening.
const ACCEPT_TIMEOUT: Duration = Duration::from_secs(1);

/// Time for the sessions to close; afterwards they close in the background.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(1);

/// The sessions of one agent or observer: one that listens and one that dials, or one that does both. A tunnel carries
/// their messages to other hosts, if there are any. Each peer is linked to one of the sessions.
///
/// Zenoh lets a node that comes in under the number (Zenoh id) of a *dialled* session join that session, but turns it
/// away if the session of that number came in itself. Secured agents therefore dial from a session that accepts no
/// links, and show its number only to the peers that they dial; otherwise any node with a certificate could break the
/// links between other nodes.
///
/// On secured links the observers and operators are linked to a session of their own, the feed. The sessions that a vehicle
/// flies with have links with vehicles only.
#[derive(Clone, Default)]
pub struct Sessions {
    /// The sessions that are linked with the other vehicles; on plain links, with observers too.
    pub(super) all: Vec<Arc<Session>>,
    /// The session to which observers and operators are linked: they receive all that the agent publishes, and of what they send only
    /// orders and queries are received. `None` on plain links and in an observer's own sessions.
    pub(super) feed: Option<Arc<Session>>,
    tunnel: Option<Arc<Tunnel>>,
}

impl From<Session> for Sessions {
    fn from(session: Session) -> Self {
        Self { all: vec![Arc::new(session)], feed: None, tunnel: None }
    }
}

impl Sessions {
    /// Opens the sessions of an agent or observer. They listen only on `listen` (an observer: nowhere) and keep
    /// dialling `dial`: endpoints like `tls/10.0.0.11:7447`, or `tcp/127.0.0.1:7447` on plain links. Peers do not relay
    /// for each other, so each pair of agents needs exactly one of the two to dial the other.
    ///
    /// Succeeds even if no peer is up. Blocks for up to half a second: do not call it on a Tokio thread.
    ///
    /// # Errors
    /// If an endpoint or a key is not valid, or an address cannot be listened on.
    pub fn open(swarm: &SwarmName, listen: &[String], dial: &[String], security: &Security) -> Result<Self, LinkError> {
        security.check(listen, dial)?;
        let tls = match security {
            Security::Tls(tls) => Some(tls),
            // Links within this PC are never cut, so they need no tunnel.
            Security::Plain if listen.iter().chain(dial).all(|endpoint| is_loopback(endpoint)) => {
                return Ok(open_zenoh(swarm, listen, dial, &[])?.into());
            }
            Security::Plain => None,
        };
        Self::open_through(Tunnel::open(listen, dial, tls)?, |listen, dial| {
            open_zenoh(swarm, listen, dial, &[("transport/unicast/accept_timeout", json!(ACCEPT_TIMEOUT.as_millis()))])
        })
    }

    /// Opens the sessions with `open` and sends their messages through this tunnel.
    pub(super) fn open_through(
        mut tunnel: Tunnel,
        open: impl Fn(&[String], &[String]) -> Result<Session, LinkError>,
    ) -> Result<Self, LinkError> {
        let listens =
            |endpoint: Option<String>| endpoint.map(|endpoint| open(&[endpoint], &[]).map(Arc::new)).transpose();
        let listening = listens(tunnel.zenoh_listens())?;
        let feed = listens(tunnel.feed_listens())?;
        // Before the session that dials, which waits half a second for peers that it cannot reach.
        let carried = tunnel.carry(listening.as_deref(), feed.as_deref());
        carried.map_err(|source| LinkError::Open(tunnel.endpoints(), source.into()))?;
        let dial = &tunnel.zenoh_dials;
        let dialling = if dial.is_empty() && listening.is_some() { None } else { Some(Arc::new(open(&[], dial)?)) };
        Ok(Self { all: listening.into_iter().chain(dialling).collect(), feed, tunnel: Some(Arc::new(tunnel)) })
    }

    /// The sessions in which everything is published: those with the other vehicles, then the feed.
    pub(super) fn published(&self) -> impl Iterator<Item = &Arc<Session>> {
        self.all.iter().chain(&self.feed)
    }

    /// The first session: the only one of an observer.
    pub fn first(&self) -> &Session {
        &self.all[0]
    }

    /// Endpoints that others dial, with the actual ports.
    pub fn endpoints(&self) -> Vec<String> {
        match &self.tunnel {
            Some(tunnel) => tunnel.endpoints(),
            None => self.first().info().locators().wait().iter().map(ToString::to_string).collect(),
        }
    }

    /// Follows which vehicles are up.
    pub fn presence(&self) -> Arc<Presence> {
        self.tunnel.as_ref().map_or_else(Presence::by_tokens, |tunnel| tunnel.presence().clone())
    }

    /// Closes the sessions and drops `rest`, within a second or else in the background: on a bad network Zenoh's own
    /// closing can take ten seconds.
    pub(super) fn close(&self, rest: impl Send + 'static) {
        let Self { all, feed, tunnel } = self.clone();
        let (done, is_done) = mpsc::channel();
        thread::spawn(move || {
            // A session that cannot be closed ends with the process.
            let closing =
                all.into_iter().chain(feed).map(|session| thread::spawn(move || drop(session.close().wait())));
            closing.collect::<Vec<_>>().into_iter().for_each(|closing| drop(closing.join()));
            drop((rest, tunnel));
            let _ = done.send(());
        });
        let _ = is_done.recv_timeout(CLOSE_TIMEOUT);
    }
}
