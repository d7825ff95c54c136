//! Ground truth of a live swarm: which agents ended and restarted, and which links the scenario cuts.

use std::collections::BTreeMap;
use std::time::Instant;

use skein_common::id::{Incarnation, VehicleId, VehicleSet};
use skein_common::message::Trace;
use skein_common::scenario::Scenario;
use skein_common::state::Membership;

use skein_lab::faults::{InjectedFault, LinkChange, LinkChanges, link_changes};

/// The ground truth of a flight.
#[derive(Debug)]
pub struct Ground {
    /// Changes of links, from a sender to a receiver, that are still to come, each with its time, s.
    schedule: Vec<(f64, (VehicleId, VehicleId), LinkChange)>,
    /// The time at which each vehicle first was active: the times of the scenario's cuts count from the receiver's.
    took_off: BTreeMap<VehicleId, Instant>,
    /// The incarnations that ended last; without a number for agents that were never in contact.
    ended: BTreeMap<VehicleId, Option<Incarnation>>,
    /// Agents that were restarted from here and are not in contact yet.
    restarted: VehicleSet,
}

impl Ground {
    /// Nothing has happened yet to the swarm of this scenario.
    pub fn new(scenario: &Scenario) -> Self {
        let links = scenario.ids().flat_map(|sender| scenario.ids().map(move |receiver| (sender, receiver)));
        let actions = links.flat_map(|link| {
            let changes = link_changes(&scenario.mission.events, link.0, link.1).into_iter();
            changes.map(move |(at_s, change)| (at_s, link, change))
        });
        Self {
            schedule: actions.collect(),
            took_off: BTreeMap::new(),
            ended: BTreeMap::new(),
            restarted: VehicleSet::default(),
        }
    }

    /// Takes a step received from an agent. Gives its restart, if the step is the first of an unknown incarnation.
    pub fn received(&mut self, now: Instant, step: &Trace) -> Option<InjectedFault> {
        let id = step.header.sender;
        if step.membership != Membership::Joining {
            self.took_off.entry(id).or_insert(now);
        }
        let is_new = self.lives(step) && self.ended.remove(&id).is_some();
        let was_known = self.restarted.contains(id);
        if is_new {
            self.restarted.remove(id);
        }
        (is_new && !was_known).then_some(InjectedFault::Restarted(id))
    }

    /// The agent of this vehicle was started again.
    pub fn restarted(&mut self, id: VehicleId) -> InjectedFault {
        self.restarted.insert(id);
        InjectedFault::Restarted(id)
    }

    /// Notes that the agent of this vehicle has ended; `life` is its last known incarnation.
    pub fn ended(&mut self, id: VehicleId, life: Option<Incarnation>) -> InjectedFault {
        self.ended.insert(id, life);
        self.restarted.remove(id);
        InjectedFault::Died(id)
    }

    /// Whether the incarnation that sent this step is not known to have ended.
    pub fn lives(&self, step: &Trace) -> bool {
        let ended = self.ended.get(&step.header.sender);
        ended.is_none_or(|life| *life < Some(step.header.incarnation))
    }

    /// Time since this vehicle first was active, s.
    pub fn since_take_off_s(&self, now: Instant, id: VehicleId) -> Option<f64> {
        self.took_off.get(&id).map(|at| now.saturating_duration_since(*at).as_secs_f64())
    }

    /// Takes the faults of links since the last call.
    pub fn due(&mut self, now: Instant) -> Vec<InjectedFault> {
        let Self { schedule, took_off, .. } = self;
        let is_due = |(at_s, (_, receiver), _): &mut (f64, (VehicleId, VehicleId), LinkChange)| {
            let took_off = took_off.get(receiver);
            took_off.is_some_and(|at| now.saturating_duration_since(*at).as_secs_f64() >= *at_s)
        };
        let mut changes = LinkChanges::default();
        schedule.extract_if(.., is_due).for_each(|(_, link, change)| changes.add(change, link));
        changes.faults().collect()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use skein_common::message::{Header, VehicleFacts};
    use skein_common::scenario::{Source, load};
    use skein_common::state::Activity;
    use skein_common::time::{PlantTime, SenderStamp};

    use super::*;
    use skein_host::clock;

    fn id(number: u8) -> VehicleId {
        VehicleId::new(number).unwrap()
    }

    fn ground(events: &str) -> Ground {
        let text = format!("swarm.vehicles = 3\n{events}");
        Ground::new(&load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario)
    }

    fn step(sender: u8, life: u64, membership: Membership) -> Trace {
        let header =
            Header { sender: id(sender), incarnation: Incarnation(life), sequence: 1, stamp: SenderStamp::ZERO };
        let facts = VehicleFacts { membership, activity: Activity::Formation, ..VehicleFacts::default() };
        Trace::new(header, PlantTime::ZERO, facts)
    }

    #[test]
    fn a_new_incarnation_is_a_restart_and_steps_of_the_old_one_are_ignored() {
        let mut ground = ground("");
        let now = clock::now();
        let (old, new) = (step(2, 7, Membership::Active), step(2, 8, Membership::Joining));
        assert_eq!(ground.received(now, &old), None);
        assert!(ground.lives(&old));
        assert_eq!(ground.ended(id(2), Some(Incarnation(7))), InjectedFault::Died(id(2)));
        assert_eq!(ground.received(now, &old), None, "a late step of the agent that ended");
        assert!(!ground.lives(&old) && ground.lives(&new));
        assert_eq!(ground.received(now, &new), Some(InjectedFault::Restarted(id(2))));
        assert_eq!(ground.received(now, &new), None, "once");
        ground.ended(id(2), Some(Incarnation(8)));
        assert_eq!(ground.restarted(id(2)), InjectedFault::Restarted(id(2)));
        assert!(!ground.lives(&new));
        let third = step(2, 9, Membership::Joining);
        assert_eq!(ground.received(now, &third), None, "that is known");
        assert!(ground.lives(&third));
    }

    #[test]
    fn a_cut_begins_and_ends_on_the_hearers_own_clock() {
        let mut ground =
            ground("mission.events = [{ at_s = 10, fault = \"cut\", from = [1], to = [2, 3], for_s = 5 }]");
        let zero = clock::now();
        let at = |t_s: f64| zero + Duration::from_secs_f64(t_s);
        assert_eq!(ground.due(at(20.0)), [], "no vehicle has taken off");
        ground.received(at(0.0), &step(2, 1, Membership::Active));
        ground.received(at(0.0), &step(3, 1, Membership::Joining));
        ground.received(at(2.0), &step(3, 1, Membership::Active));
        let [to_2, to_3] = [2, 3].map(|receiver| vec![(id(1), id(receiver))]);
        assert_eq!(ground.due(at(9.9)), []);
        assert_eq!(ground.due(at(10.1)), [InjectedFault::Cut { links: to_2.clone() }]);
        assert_eq!(ground.due(at(10.2)), []);
        let both = [InjectedFault::Healed { links: to_2 }, InjectedFault::Cut { links: to_3.clone() }];
        assert_eq!(ground.due(at(15.5)), both);
        assert_eq!(ground.due(at(30.0)), [InjectedFault::Healed { links: to_3 }]);
    }
}
