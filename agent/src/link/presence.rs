//! Who is there. Where links are plain, whoever's liveliness token is. Where they are secured, whoever has a link under its own
//! certificate: that, nobody else can make or break, while a token can be anybody's.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use skein_common::id::VehicleId;
use skein_common::topic::{Topic, all};
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};

use super::{LinkError, Sessions, declaring};
use skein_host::clock::now;

/// The log is told the same of somebody who was refused so often.
const LOG_EVERY: Duration = Duration::from_secs(60);
/// And of so many within that time.
const LOG_AT_MOST: usize = 32;

/// What changes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Change {
    /// A vehicle is there.
    Came(VehicleId),
    /// It is gone.
    Went(VehicleId),
    /// Whoever is at this address was not let in, or does not let this one in.
    Refused(String),
}

type Tell = Box<dyn Fn(Change) + Send + Sync>;

/// Follows who is there.
#[derive(Default)]
pub struct Presence {
    /// By tokens, if not by links.
    by_links: bool,
    noted: Mutex<Noted>,
}

#[derive(Default)]
struct Noted {
    /// How many links each has: one that broke may be found dead after the next one stands.
    links: BTreeMap<VehicleId, u32>,
    tell: Vec<Tell>,
    /// What the log was told of those who were refused, and when.
    logged: Vec<(String, Instant)>,
}

impl Presence {
    /// Of those who have tokens.
    pub(super) fn by_tokens() -> Arc<Self> {
        Arc::default()
    }

    /// Of those who have links.
    pub(super) fn by_links() -> Arc<Self> {
        Arc::new(Self { by_links: true, ..Self::default() })
    }

    /// Tells from now on what changes, beginning with those already there; on threads that must not wait.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn watch(&self, sessions: &Sessions, tell: impl Fn(Change) + Send + Sync + 'static) -> Result<(), LinkError> {
        if !self.by_links {
            let tell = Arc::new(tell);
            return sessions.all.iter().try_for_each(|session| {
                let tell = tell.clone();
                watch_tokens(session, move |id, kind| {
                    tell(if kind == SampleKind::Put { Change::Came(id) } else { Change::Went(id) });
                })
            });
        }
        let mut noted = self.lock();
        noted.links.keys().for_each(|id| tell(Change::Came(*id)));
        noted.tell.push(Box::new(tell));
        Ok(())
    }

    /// Whether messages of this vehicle can be its own: peers hand nothing on, so a vehicle without a link sends nothing.
    pub fn may_speak(&self, id: VehicleId) -> bool {
        !self.by_links || self.lock().links.contains_key(&id)
    }

    /// A link stands until the answer is dropped; with whom, unless with an observer or an operator.
    pub(super) fn link(self: &Arc<Self>, with: Option<VehicleId>) -> Linked {
        if let Some(id) = with {
            let mut noted = self.lock();
            let count = noted.links.entry(id).or_default();
            *count += 1;
            if *count == 1 {
                noted.tell(&Change::Came(id));
            }
        }
        Linked { presence: self.clone(), with }
    }

    /// No link with whoever is at this address. However often that is tried, the log is told once in a while.
    pub(super) fn refuse(&self, address: &str, why: &str) {
        let mut noted = self.lock();
        noted.tell(&Change::Refused(address.to_owned()));
        let (line, at) = (format!("no link with {address}: {why}"), now());
        noted.logged.retain(|(_, told)| at.saturating_duration_since(*told) < LOG_EVERY);
        if noted.logged.len() < LOG_AT_MOST && noted.logged.iter().all(|(told, _)| *told != line) {
            tracing::warn!("{line}");
            noted.logged.push((line, at));
        }
    }

    /// Nothing that holds the lock can panic half way. While one tells nobody else does: who comes and goes at once ends as it
    /// is told last.
    fn lock(&self) -> MutexGuard<'_, Noted> {
        self.noted.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Noted {
    fn tell(&self, change: &Change) {
        self.tell.iter().for_each(|tell| tell(change.clone()));
    }
}

/// A link that stands.
pub(super) struct Linked {
    presence: Arc<Presence>,
    with: Option<VehicleId>,
}

impl Drop for Linked {
    fn drop(&mut self) {
        let Some(id) = self.with else { return };
        let mut noted = self.presence.lock();
        let left = noted.links.get(&id).map_or(0, |count| count.saturating_sub(1));
        if left == 0 {
            noted.links.remove(&id);
            noted.tell(&Change::Went(id));
        } else {
            noted.links.insert(id, left);
        }
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
    use super::*;

    fn id(number: u8) -> VehicleId {
        VehicleId::new(number).unwrap()
    }

    #[test]
    fn a_vehicle_is_there_while_one_of_its_links_stands() {
        let presence = Presence::by_links();
        let told = Arc::<Mutex<Vec<Change>>>::default();
        let into = told.clone();
        presence.lock().tell.push(Box::new(move |change| into.lock().unwrap().push(change)));
        let told = || std::mem::take(&mut *told.lock().unwrap());
        let first = presence.link(Some(id(1)));
        assert_eq!(told(), [Change::Came(id(1))]);
        assert!(presence.may_speak(id(1)) && !presence.may_speak(id(2)));
        let second = presence.link(Some(id(1)));
        drop(first);
        assert_eq!(told(), [], "dialled again before the first link was found dead");
        drop(presence.link(Some(id(3))));
        assert_eq!(told(), [Change::Came(id(3)), Change::Went(id(3))]);
        drop(second);
        assert_eq!(told(), [Change::Went(id(1))]);
        drop(presence.link(None));
        presence.refuse("10.0.0.9", "no certificate");
        assert_eq!(told(), [Change::Refused("10.0.0.9".to_owned())], "observers are not told of");
        assert!(!presence.may_speak(id(1)));
    }

    #[test]
    fn where_links_have_no_names_anybody_may_speak() {
        assert!(Presence::by_tokens().may_speak(id(1)));
    }
}
