//! One session, one certificate.
//!
//! Zenoh knows the session at the other end by a number that it gives itself, and which everybody is shown. A link that
//! comes in under a number that is linked already joins that session, under the rules of its first link, whatever its own
//! certificate says: so a valid node that takes vehicle 1's number could speak for vehicle 1. Zenoh tells of every link before
//! anything is read from it. While links of one session show different names, neither is believed.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, MutexGuard, PoisonError};

use skein_common::id::{VehicleId, VehicleSet};
use zenoh::sample::SampleKind;
use zenoh::session::LinkEvent;

/// The links that there are, by what Zenoh calls the other end; and what follows from them.
#[derive(Debug, Default)]
pub(super) struct Doubles {
    /// Whose a certificate of this common name is. Empty where nobody has one.
    certificates: BTreeMap<String, VehicleId>,
    links: Mutex<Links>,
}

#[derive(Debug, Default)]
struct Links {
    /// Numbers of both sessions, both ends' addresses, common name.
    all: BTreeSet<(String, String, String, String)>,
    /// Whoever shares a session.
    double: VehicleSet,
}

impl Doubles {
    pub(super) fn new(certificates: BTreeMap<String, VehicleId>) -> Self {
        Self { certificates, links: Mutex::default() }
    }

    /// Takes up that a link of the session of this own number came or went; the log is told if that changes who is believed.
    pub(super) fn take_up(&self, own: &str, event: &LinkEvent) {
        let link = event.link();
        let name = link.auth_identifier().unwrap_or_default();
        self.note(event.kind(), [&format!("{own} {}", link.zid()), link.src().as_str(), link.dst().as_str(), name]);
    }

    fn note(&self, kind: SampleKind, [session, here, there, name]: [&str; 4]) {
        let mut links = self.lock();
        let link = (session.to_owned(), here.to_owned(), there.to_owned(), name.to_owned());
        match kind {
            SampleKind::Put => _ = links.all.insert(link),
            SampleKind::Delete => {
                links.all.retain(|known| (&known.0, &known.1, &known.2) != (&link.0, &link.1, &link.2))
            }
        }
        let mut names = BTreeMap::<&str, BTreeSet<&str>>::new();
        for (session, _, _, name) in &links.all {
            names.entry(session).or_default().insert(name);
        }
        let shared = names.values().filter(|names| names.len() > 1).flatten();
        let double: VehicleSet = shared.filter_map(|name| self.certificates.get(*name).copied()).collect();
        if double != links.double {
            match double.is_empty() {
                true => tracing::info!("no session is shared any more"),
                false => {
                    tracing::warn!("vehicle {double}: a session is shared by different certificates; not believed")
                }
            }
            links.double = double;
        }
    }

    /// Whether somebody else may be speaking in this vehicle's name.
    pub(super) fn is_double(&self, id: VehicleId) -> bool {
        self.lock().double.contains(id)
    }

    /// Nothing that holds the lock can panic half way.
    fn lock(&self) -> MutexGuard<'_, Links> {
        self.links.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_shares_a_session_is_not_believed_until_it_is_alone_again() {
        let id = |number| VehicleId::new(number).unwrap();
        let doubles = Doubles::new((1..=3).map(|number| (format!("vehicle-{number}"), id(number))).collect());
        let believed = || [1, 2, 3].map(|number| !doubles.is_double(id(number)));
        doubles.note(SampleKind::Put, ["a", "here", "one", "vehicle-1"]);
        doubles.note(SampleKind::Put, ["b", "here", "two", "vehicle-2"]);
        assert_eq!(believed(), [true; 3]);
        doubles.note(SampleKind::Put, ["a", "here", "one again", "vehicle-1"]);
        assert_eq!(believed(), [true; 3], "dialled again before the first link was found dead");
        doubles.note(SampleKind::Put, ["a", "here", "three", "vehicle-3"]);
        assert_eq!(believed(), [false, true, false]);
        doubles.note(SampleKind::Delete, ["a", "here", "one", ""]);
        assert_eq!(believed(), [false, true, false]);
        doubles.note(SampleKind::Delete, ["a", "here", "three", ""]);
        assert_eq!(believed(), [true; 3]);
        doubles.note(SampleKind::Put, ["b", "here", "revoked", "vehicle-2.old"]);
        assert_eq!(believed(), [true, false, true], "a name that is nobody's");
    }
}
