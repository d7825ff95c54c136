//! Follows which vehicles are up. On plain links a vehicle is up while its liveliness token is. On secured links it is
//! up while it has a link under its own certificate: no other node can make or break that, whereas any node can declare
//! any token.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use skein_common::id::VehicleId;
use skein_common::topic::{Topic, all};
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};

use super::{LinkError, Sessions, declaring};
use skein_host::clock::now;

/// The same refusal is logged at most once in this time.
const LOG_EVERY: Duration = Duration::from_secs(60);
/// Largest number of different refusals logged within that time.
const LOG_AT_MOST: usize = 32;

/// A change of the vehicles that are up.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Change {
    /// A vehicle is up.
    Appeared(VehicleId),
    /// A vehicle is gone.
    Vanished(VehicleId),
    /// A link with this address was refused, by this host or by the other.
    Refused(String),
}

type Listener = Box<dyn Fn(Change) + Send + Sync>;

/// Follows which vehicles are up.
#[derive(Default)]
pub struct Presence {
    /// Whether links decide; otherwise tokens do.
    by_links: bool,
    tracked: Mutex<Tracked>,
}

#[derive(Default)]
struct Tracked {
    /// Number of links of each vehicle. A broken link may be detected after the vehicle has made its next one.
    links: BTreeMap<VehicleId, u32>,
    listeners: Vec<Listener>,
    /// Refusals logged lately, and when.
    logged: Vec<(String, Instant)>,
}

impl Presence {
    /// Follows the vehicles' tokens.
    pub(super) fn by_tokens() -> Arc<Self> {
        Arc::default()
    }

    /// Follows the vehicles' links.
    pub(super) fn by_links() -> Arc<Self> {
        Arc::new(Self { by_links: true, ..Self::default() })
    }

    /// Reports every change from now on, starting with the vehicles already up, on threads that must not wait.
    ///
    /// # Errors
    /// If a session is closed.
    pub fn watch(&self, sessions: &Sessions, notify: impl Fn(Change) + Send + Sync + 'static) -> Result<(), LinkError> {
        if !self.by_links {
            let notify = Arc::new(notify);
            return sessions.all.iter().try_for_each(|session| {
                let notify = notify.clone();
                watch_tokens(session, move |id, kind| {
                    notify(if kind == SampleKind::Put { Change::Appeared(id) } else { Change::Vanished(id) });
                })
            });
        }
        let mut tracked = self.lock();
        tracked.links.keys().for_each(|id| notify(Change::Appeared(*id)));
        tracked.listeners.push(Box::new(notify));
        Ok(())
    }

    /// Whether a message can come from this vehicle itself. Peers do not relay, so a vehicle without a link sends
    /// nothing.
    pub fn may_send(&self, id: VehicleId) -> bool {
        !self.by_links || self.lock().links.contains_key(&id)
    }

    /// Registers a link that lasts until the returned value is dropped. `with` is `None` for an observer or operator.
    pub(super) fn link(self: &Arc<Self>, with: Option<VehicleId>) -> LinkGuard {
        if let Some(id) = with {
            let mut tracked = self.lock();
            let count = tracked.links.entry(id).or_default();
            *count += 1;
            if *count == 1 {
                tracked.notify(&Change::Appeared(id));
            }
        }
        LinkGuard { presence: self.clone(), with }
    }

    /// Reports a refused link. Repeated refusals are logged only once in [`LOG_EVERY`].
    pub(super) fn refuse(&self, address: &str, why: &str) {
        let mut tracked = self.lock();
        tracked.notify(&Change::Refused(address.to_owned()));
        let (line, at) = (format!("no link with {address}: {why}"), now());
        tracked.logged.retain(|(_, logged_at)| at.saturating_duration_since(*logged_at) < LOG_EVERY);
        if tracked.logged.len() < LOG_AT_MOST && tracked.logged.iter().all(|(text, _)| *text != line) {
            tracing::warn!("{line}");
            tracked.logged.push((line, at));
        }
    }

    /// Locks the state. No holder can panic, so poisoning is ignored. Changes are reported under the
    /// lock, so their order is the order in which they happened.
    fn lock(&self) -> MutexGuard<'_, Tracked> {
        self.tracked.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Tracked {
    fn notify(&self, change: &Change) {
        self.listeners.iter().for_each(|notify| notify(change.clone()));
    }
}

/// Keeps one link registered until it is dropped.
pub(super) struct LinkGuard {
    presence: Arc<Presence>,
    with: Option<VehicleId>,
}

impl Drop for LinkGuard {
    fn drop(&mut self) {
        let Some(id) = self.with else { return };
        let mut tracked = self.presence.lock();
        let left = tracked.links.get(&id).map_or(0, |count| count.saturating_sub(1));
        if left == 0 {
            tracked.links.remove(&id);
            tracked.notify(&Change::Vanished(id));
        } else {
            tracked.links.insert(id, left);
        }
    }
}

/// Reports each token that appears or vanishes. A vehicle with a token can be queried.
pub(super) fn watch_tokens(
    session: &Session,
    notify: impl Fn(VehicleId, SampleKind) + Send + Sync + 'static,
) -> Result<(), LinkError> {
    let token = move |sample: Sample| {
        if let Some(Topic::Alive(id)) = Topic::parse(sample.key_expr().as_str()) {
            notify(id, sample.kind());
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
    fn a_vehicle_is_up_while_it_has_a_link() {
        let presence = Presence::by_links();
        let changes = Arc::<Mutex<Vec<Change>>>::default();
        let into = changes.clone();
        presence.lock().listeners.push(Box::new(move |change| into.lock().unwrap().push(change)));
        let changes = || std::mem::take(&mut *changes.lock().unwrap());
        let first = presence.link(Some(id(1)));
        assert_eq!(changes(), [Change::Appeared(id(1))]);
        assert!(presence.may_send(id(1)) && !presence.may_send(id(2)));
        let second = presence.link(Some(id(1)));
        drop(first);
        assert_eq!(changes(), [], "a new link was made before the broken one was detected");
        drop(presence.link(Some(id(3))));
        assert_eq!(changes(), [Change::Appeared(id(3)), Change::Vanished(id(3))]);
        drop(second);
        assert_eq!(changes(), [Change::Vanished(id(1))]);
        drop(presence.link(None));
        presence.refuse("10.0.0.9", "no certificate");
        assert_eq!(changes(), [Change::Refused("10.0.0.9".to_owned())], "links with observers are not reported");
        assert!(!presence.may_send(id(1)));
    }

    #[test]
    fn on_plain_links_every_vehicle_may_send() {
        assert!(Presence::by_tokens().may_send(id(1)));
    }
}
