//! The Zenoh sessions of one agent.

use std::sync::Arc;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use skein_common::id::SwarmName;
use zenoh::{Session, Wait};

use super::{LinkError, Security, open};

/// Sessions that do not close within this time are left to the end of the process.
const CLOSE_WITHIN: Duration = Duration::from_secs(1);

/// One that listens and one that dials, or one that does both. Each of the others is linked to one of them.
///
/// Whoever comes in under the number of a session that was *dialled* joins it; under the number of one that came in itself,
/// it is turned away. So secured agents dial from a session that nobody can come in to, whose number only those are shown who
/// are dialled: else everybody with a certificate, a replaced one included, could break the links between the others.
#[derive(Clone)]
pub struct Sessions(pub(super) Vec<Arc<Session>>);

impl From<Session> for Sessions {
    fn from(session: Session) -> Self {
        Self(vec![Arc::new(session)])
    }
}

impl Sessions {
    /// Opens what an agent needs; as [`open`] otherwise.
    ///
    /// # Errors
    /// As [`open`].
    pub fn open(swarm: &SwarmName, listen: &[String], dial: &[String], security: &Security) -> Result<Self, LinkError> {
        if *security == Security::Plain || listen.is_empty() || dial.is_empty() {
            return Ok(open(swarm, listen, dial, security)?.into());
        }
        security.check(listen, dial)?;
        let sessions = [(listen, &[][..]), (&[][..], dial)].map(|(listen, dial)| open(swarm, listen, dial, security));
        let [listening, dialling] = sessions;
        Ok(Self(vec![Arc::new(listening?), Arc::new(dialling?)]))
    }

    /// Closes them and drops what stands on them, soon or else in the background: on a bad network Zenoh's own closing can take
    /// ten seconds.
    pub(super) fn close(&self, rest: impl Send + 'static) {
        let sessions: Vec<_> = self.0.iter().map(|session| Session::clone(session)).collect();
        let (done, is_done) = mpsc::channel();
        thread::spawn(move || {
            // A session that cannot be closed ends with the process.
            let closing = sessions.into_iter().map(|session| thread::spawn(move || drop(session.close().wait())));
            closing.collect::<Vec<_>>().into_iter().for_each(|closing| drop(closing.join()));
            drop(rest);
            let _ = done.send(());
        });
        let _ = is_done.recv_timeout(CLOSE_WITHIN);
    }
}
