//! Follows which vehicles are up. On plain links a vehicle is up while its liveliness token is. On secured links it is
//! up while it has a link under its own certificate: no other node can make or break that, whereas any node can declare
//! any token.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use skein_common::id::{VehicleId, VehicleName};
use skein_common::topic::{Branch, Topic, all};
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};

use super::{LinkError, Sessions, declaring};
use skein_host::clock::now;

/// The same refusal is logged at most once in this time.
const LOG_EVERY: Duration = Duration::from_secs(60);
/// Largest number of different refusals logged within that time.
const LOG_AT_MOST: usize = 32;

/// A change of the vehicles of one swarm that are up.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Change {
    /// A vehicle is up.
    Appeared(VehicleId),
    /// A vehicle is gone.
    Vanished(VehicleId),
    /// A link with this address was refused, by this host or by the other.
    Refused(String),
}

/// Gets the changes of one swarm.
struct Listener {
    branch: Branch,
    notify: Box<dyn Fn(Change) + Send + Sync>,
}

/// Follows which vehicles are up.
#[derive(Default)]
pub struct Presence {
    /// Whether links decide; otherwise tokens do.
    by_links: bool,
    /// Changes are reported under this lock, so that their order is the order in which they happened.
    tracked: Mutex<Tracked>,
}

#[derive(Default)]
struct Tracked {
    /// Number of links of each vehicle. A broken link may be detected after the vehicle has made its next one.
    links: BTreeMap<VehicleName, u32>,
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

    /// Reports every change of one swarm's vehicles from now on, starting with those already up, on threads that must
    /// not wait.
    ///
    /// # Errors
    /// If a session is closed.
    pub fn watch(
        &self,
        sessions: &Sessions,
        branch: Branch,
        notify: impl Fn(Change) + Send + Sync + 'static,
    ) -> Result<(), LinkError> {
        if !self.by_links {
            let notify = Arc::new(notify);
            return sessions.all.iter().try_for_each(|session| {
                let notify = notify.clone();
                watch_tokens(session, branch, move |id, kind| {
                    notify(if kind == SampleKind::Put { Change::Appeared(id) } else { Change::Vanished(id) });
                })
            });
        }
        self.watch_links(branch, notify);
        Ok(())
    }

    /// Reports every change of one swarm's vehicles by their links from now on, starting with those already up.
    pub(super) fn watch_links(&self, branch: Branch, notify: impl Fn(Change) + Send + Sync + 'static) {
        let mut tracked = self.tracked.lock();
        let own = tracked.links.keys().filter(|name| name.team == branch.team());
        own.for_each(|name| notify(Change::Appeared(name.vehicle)));
        tracked.listeners.push(Listener { branch, notify: Box::new(notify) });
    }

    /// Whether a message can come from this vehicle itself. Peers do not relay, so a vehicle without a link sends
    /// nothing.
    pub fn may_send(&self, name: VehicleName) -> bool {
        !self.by_links || self.tracked.lock().links.contains_key(&name)
    }

    /// Number of vehicles with a link.
    pub(super) fn linked(&self) -> usize {
        self.tracked.lock().links.len()
    }

    /// Registers a link that lasts until the returned value is dropped. `with` is `None` for an observer or operator.
    pub(super) fn link(self: &Arc<Self>, with: Option<VehicleName>) -> LinkGuard {
        if let Some(name) = with {
            let mut tracked = self.tracked.lock();
            let count = tracked.links.entry(name).or_default();
            *count += 1;
            if *count == 1 {
                tracked.notify(name, Change::Appeared);
            }
        }
        LinkGuard { presence: self.clone(), with }
    }

    /// Reports a refused link. Repeated refusals are logged only once in [`LOG_EVERY`].
    pub(super) fn refuse(&self, address: &str, why: &str) {
        let mut tracked = self.tracked.lock();
        tracked.listeners.iter().for_each(|listener| (listener.notify)(Change::Refused(address.to_owned())));
        let (line, at) = (format!("no link with {address}: {why}"), now());
        tracked.logged.retain(|(_, logged_at)| at.saturating_duration_since(*logged_at) < LOG_EVERY);
        if tracked.logged.len() < LOG_AT_MOST && tracked.logged.iter().all(|(text, _)| *text != line) {
            tracing::warn!("{line}");
            tracked.logged.push((line, at));
        }
    }
}

impl Tracked {
    /// Reports a change of this vehicle to the listeners of its swarm.
    fn notify(&self, name: VehicleName, change: fn(VehicleId) -> Change) {
        let own = self.listeners.iter().filter(|listener| listener.branch.team() == name.team);
        own.for_each(|listener| (listener.notify)(change(name.vehicle)));
    }
}

/// Keeps one link registered until it is dropped.
pub(super) struct LinkGuard {
    presence: Arc<Presence>,
    with: Option<VehicleName>,
}

impl Drop for LinkGuard {
    fn drop(&mut self) {
        let Some(name) = self.with else { return };
        let mut tracked = self.presence.tracked.lock();
        let left = tracked.links.get(&name).map_or(0, |count| count.saturating_sub(1));
        if left == 0 {
            tracked.links.remove(&name);
            tracked.notify(name, Change::Vanished);
        } else {
            tracked.links.insert(name, left);
        }
    }
}

/// Reports each token of this swarm that appears or vanishes. A vehicle with a token can be queried.
pub(super) fn watch_tokens(
    session: &Session,
    branch: Branch,
    notify: impl Fn(VehicleId, SampleKind) + Send + Sync + 'static,
) -> Result<(), LinkError> {
    let token = move |sample: Sample| {
        if let Some(Topic::Alive(id)) = branch.own(sample.key_expr().as_str()) {
            notify(id, sample.kind());
        }
    };
    let keys = branch.all(all::ALIVE);
    let tokens = session.liveliness().declare_subscriber(&keys).history(true).callback(token);
    tokens.background().wait().map_err(declaring(&keys))
}

#[cfg(test)]
mod tests {
    use skein_common::id::TeamId;

    use super::*;

    fn id(number: u8) -> VehicleId {
        VehicleId::new(number).unwrap()
    }

    #[test]
    fn a_vehicle_is_up_while_it_has_a_link() {
        let presence = Presence::by_links();
        let changes = Arc::<Mutex<Vec<Change>>>::default();
        let into = changes.clone();
        let notify = Box::new(move |change| into.lock().push(change));
        presence.tracked.lock().listeners.push(Listener { branch: Branch::SWARM, notify });
        let changes = || std::mem::take(&mut *changes.lock());
        let first = presence.link(Some(id(1).into()));
        assert_eq!(changes(), [Change::Appeared(id(1))]);
        assert!(presence.may_send(id(1).into()) && !presence.may_send(id(2).into()));
        let second = presence.link(Some(id(1).into()));
        drop(first);
        assert_eq!(changes(), [], "a new link was made before the broken one was detected");
        drop(presence.link(Some(id(3).into())));
        assert_eq!(changes(), [Change::Appeared(id(3)), Change::Vanished(id(3))]);
        drop(second);
        assert_eq!(changes(), [Change::Vanished(id(1))]);
        let foreign = VehicleName { team: TeamId::new(2).ok(), vehicle: id(1) };
        drop(presence.link(Some(foreign)));
        assert_eq!(changes(), [], "a vehicle of a team that is not watched");
        drop(presence.link(None));
        presence.refuse("10.0.0.9", "no certificate");
        assert_eq!(changes(), [Change::Refused("10.0.0.9".to_owned())], "links with observers are not reported");
        assert!(!presence.may_send(id(1).into()));
    }

    #[test]
    fn on_plain_links_every_vehicle_may_send() {
        assert!(Presence::by_tokens().may_send(id(1).into()));
    }
}
