//! Who is there. Where links are plain, whoever's liveliness token is. Where they are secured, whoever has a link under its own
//! certificate: that, nobody else can make or break, while a token can be anybody's.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};

use skein_common::id::VehicleId;
use skein_common::topic::{Topic, all};
use zenoh::sample::{Sample, SampleKind};
use zenoh::session::LinkEvent;
use zenoh::{Session, Wait};

use super::{LinkError, declaring};

/// Follows who is there, in all the sessions that it is told to watch.
#[derive(Debug)]
pub struct Presence {
    /// Whose a certificate of this common name is; none where links are plain.
    certificates: Option<BTreeMap<String, VehicleId>>,
    links: Mutex<Links>,
}

/// Own session's number, both ends' addresses; whose it is. A link that broke may be found dead after the next one stands.
type Links = BTreeMap<(String, String, String), VehicleId>;

impl Presence {
    /// By certificates of these common names; without any, by tokens.
    pub fn new(certificates: Option<BTreeMap<String, VehicleId>>) -> Arc<Self> {
        Arc::new(Self { certificates, links: Mutex::default() })
    }

    /// Tells from now on, on Zenoh's threads, who comes (put) and who goes (delete), those already there included.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn watch(
        self: &Arc<Self>,
        session: &Session,
        tell: impl Fn(VehicleId, SampleKind) + Send + Sync + 'static,
    ) -> Result<(), LinkError> {
        if self.certificates.is_none() {
            return watch_tokens(session, tell);
        }
        let (presence, own) = (self.clone(), session.zid().to_string());
        let note = move |event: LinkEvent| {
            let link = event.link();
            let link_of = (own.clone(), link.src().to_string(), link.dst().to_string());
            presence.note(event.kind(), link_of, link.auth_identifier(), &tell);
        };
        session
            .info()
            .link_events_listener()
            .history(true)
            .callback(note)
            .background()
            .wait()
            .map_err(declaring("links"))
    }

    /// Whether words of this vehicle can be its own: peers hand nothing on, so who has no link says nothing.
    pub(super) fn may_speak(&self, id: VehicleId) -> bool {
        self.certificates.is_none() || self.lock().values().any(|there| *there == id)
    }

    /// `tell` is called while nobody else can note anything: who comes and goes at once ends as it is told last.
    fn note(
        &self,
        kind: SampleKind,
        link: (String, String, String),
        name: Option<&str>,
        tell: impl Fn(VehicleId, SampleKind),
    ) {
        let mut links = self.lock();
        let before: BTreeSet<VehicleId> = links.values().copied().collect();
        match kind {
            SampleKind::Put => {
                let known = self.certificates.as_ref().zip(name).and_then(|(known, name)| known.get(name));
                match known {
                    Some(id) => _ = links.insert(link, *id),
                    None => tracing::info!("linked to {}, which speaks for no vehicle", name.unwrap_or("nobody")),
                }
            }
            SampleKind::Delete => _ = links.remove(&link),
        }
        let after: BTreeSet<VehicleId> = links.values().copied().collect();
        after.difference(&before).for_each(|id| tell(*id, SampleKind::Put));
        before.difference(&after).for_each(|id| tell(*id, SampleKind::Delete));
    }

    /// Nothing that holds the lock can panic half way.
    fn lock(&self) -> std::sync::MutexGuard<'_, Links> {
        self.links.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Tells whose token comes and goes. Whoever declares one can be asked.
pub(super) fn watch_tokens(
    session: &Session,
    tell: impl Fn(VehicleId, SampleKind) + Send + Sync + 'static,
) -> Result<(), LinkError> {
    let token = move |sample: Sample| {
        if let Some(Topic::Alive(id)) = Topic::parse(sample.key_expr().as_str()) {
            tell(id, sample.kind());
        }
    };
    let tokens = session.liveliness().declare_subscriber(all::ALIVE).history(true).callback(token);
    tokens.background().wait().map_err(declaring(all::ALIVE))
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;

    #[test]
    fn a_vehicle_is_there_while_one_of_its_links_stands() {
        let id = |number| VehicleId::new(number).unwrap();
        let names = (1..=3).map(|number| (format!("vehicle-{number}"), id(number))).collect();
        let presence = Presence::new(Some(names));
        let told = RefCell::new(Vec::new());
        let note = |kind, there: &str, name: Option<&str>| {
            let link = ["own", "here", there].map(str::to_owned);
            presence.note(kind, link.into(), name, |id, kind| told.borrow_mut().push((id.get(), kind)));
            told.take()
        };
        let (put, delete) = (SampleKind::Put, SampleKind::Delete);
        assert_eq!(note(put, "a", Some("vehicle-1")), [(1, put)]);
        assert!(presence.may_speak(id(1)) && !presence.may_speak(id(2)));
        assert_eq!(note(put, "b", Some("vehicle-1")), [], "dialled again before the first link was found dead");
        assert_eq!(note(delete, "a", None), []);
        assert_eq!(note(put, "c", Some("vehicle-3")), [(3, put)]);
        assert_eq!(note(delete, "b", None), [(1, delete)]);
        assert!(!presence.may_speak(id(1)) && presence.may_speak(id(3)));
        for name in [Some("vehicle-1.old"), Some("observer"), None] {
            assert_eq!(note(put, "d", name), [], "a name that is nobody's");
            assert_eq!(note(delete, "d", name), []);
        }
    }

    #[test]
    fn without_certificates_anybody_may_speak() {
        assert!(Presence::new(None).may_speak(VehicleId::new(1).unwrap()));
    }
}
