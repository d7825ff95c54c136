//! Compares the contacts that the agents report with the agents that really run and the links that really work.

use std::collections::BTreeMap;
use std::mem;

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::EventKind;
use skein_common::state::Membership;

use super::series::Worst;
use super::{VehicleNow, index};

/// Time after which an undetected change counts as never detected, s.
const LIMIT_S: f64 = 30.0;
/// Time after a healed cut or a restart in which a loss still results from the fault before, s.
const AFTERMATH_S: f64 = 2.0;

/// One direction of a link: sender and receiver.
type Link = (VehicleId, VehicleId);

/// Measures how the swarm detects deaths, returns, cuts and failures.
#[derive(Clone, Debug)]
pub(super) struct Detection {
    vehicles: usize,
    /// Distance beyond which messages may be lost, m.
    reach_m: f64,
    alive: VehicleSet,
    /// The live members, by ground truth.
    pub(super) members: VehicleSet,
    /// Vehicles that have left the swarm since their agent started.
    left: VehicleSet,
    /// The peers that each vehicle does not count as lost, by id.
    in_contact: Vec<VehicleSet>,
    /// Start time of each vehicle's present agent, by id, s.
    born_s: Vec<f64>,
    /// The senders whose links to each vehicle are cut, by its id.
    cut_from: Vec<VehicleSet>,
    /// Time at which each link that was ever cut was last healed, s.
    healed_s: BTreeMap<Link, f64>,
    pending: Vec<PendingTransition>,
    failed: Vec<(VehicleId, f64)>,
    /// Losses that were reported since the last observation.
    suspected: Vec<Link>,
    /// Whether an observation of the same contacts, members and running agents as at the last one would change nothing.
    pub(super) is_settled: bool,
    /// The reactions to each [`Transition`].
    reactions: [Worst; 2],
    response: Worst,
    /// Number of losses of a sender that lived, could be received, and had not left.
    pub(super) false_suspicions: u64,
}

/// A change of senders that receivers still have to detect.
#[derive(Clone, Debug)]
struct PendingTransition {
    since_s: f64,
    what: Transition,
    links: Vec<Link>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Transition {
    /// The sender is lost.
    Loss,
    /// The sender is received again and is an active member.
    Return,
}

impl Detection {
    /// A swarm in which all agents run, no agents are in contact, and no link is cut. Messages over more than `reach_m`
    /// may be lost.
    pub(super) fn new(vehicles: usize, reach_m: Option<f64>) -> Self {
        Self {
            vehicles,
            reach_m: reach_m.unwrap_or(f64::INFINITY),
            alive: VehicleId::first(vehicles).collect(),
            members: VehicleSet::default(),
            left: VehicleSet::default(),
            in_contact: vec![VehicleSet::default(); vehicles],
            born_s: vec![f64::NEG_INFINITY; vehicles],
            cut_from: vec![VehicleSet::default(); vehicles],
            healed_s: BTreeMap::new(),
            pending: Vec::new(),
            failed: Vec::new(),
            suspected: Vec::new(),
            is_settled: false,
            reactions: Default::default(),
            response: Worst::default(),
            false_suspicions: 0,
        }
    }

    /// Observes that the agent of this vehicle died.
    pub(super) fn died(&mut self, t_s: f64, id: VehicleId) {
        self.is_settled = false;
        // The peers do not have to detect the end of a vehicle that has landed.
        let must_be_detected = !self.has_left(id);
        let links = self.others(id).filter(|&link| must_be_detected && self.has_contact(link)).collect();
        self.pending.push(PendingTransition { since_s: t_s, what: Transition::Loss, links });
        self.alive.remove(id);
        self.members.remove(id);
        self.failed.retain(|(failed, _)| *failed != id);
    }

    /// Observes that the agent of this vehicle started again.
    pub(super) fn restarted(&mut self, t_s: f64, id: VehicleId) {
        self.is_settled = false;
        self.alive.insert(id);
        self.left.remove(id);
        if let Some(born_s) = self.born_s.get_mut(index(id)) {
            *born_s = t_s;
        }
        let links = self.others(id).collect();
        self.pending.push(PendingTransition { since_s: t_s, what: Transition::Return, links });
    }

    /// Observes that a part of this vehicle failed.
    pub(super) fn failed(&mut self, t_s: f64, id: VehicleId) {
        self.failed.push((id, t_s));
    }

    /// Observes that these links are cut.
    pub(super) fn cut(&mut self, t_s: f64, links: &[Link]) {
        self.is_settled = false;
        for &(sender, receiver) in links {
            if let Some(cut_from) = self.cut_from.get_mut(index(receiver)) {
                cut_from.insert(sender);
            }
        }
        let links = links.iter().copied().filter(|&link| self.has_contact(link)).collect();
        self.pending.push(PendingTransition { since_s: t_s, what: Transition::Loss, links });
    }

    /// Observes that these links work again.
    pub(super) fn healed(&mut self, t_s: f64, links: &[Link]) {
        self.is_settled = false;
        for &(sender, receiver) in links {
            let Some(cut_from) = self.cut_from.get_mut(index(receiver)) else { continue };
            cut_from.remove(sender);
            self.healed_s.insert((sender, receiver), t_s);
        }
        // A cut of one direction ends the session, and so the other direction too.
        let both_directions = links.iter().flat_map(|&(sender, receiver)| [(sender, receiver), (receiver, sender)]);
        let links = both_directions.filter(|&link| !self.has_contact(link)).collect();
        self.pending.push(PendingTransition { since_s: t_s, what: Transition::Return, links });
    }

    /// Observes an event that a vehicle reported of itself.
    pub(super) fn reported(&mut self, t_s: f64, sender: VehicleId, what: &EventKind) {
        self.is_settled = false;
        match what {
            // Judged at the next observation: in a live run the report may arrive before the death itself.
            EventKind::PeerLost(lost) => self.suspected.push((*lost, sender)),
            EventKind::Failed(_)
            | EventKind::OwnDataStale
            | EventKind::SimulatorLost
            | EventKind::SimulatorStopped(_)
            | EventKind::ControlFault
            | EventKind::ClockJumped => {
                for (_, since_s) in self.failed.extract_if(.., |(failed, _)| *failed == sender) {
                    self.response.add_time(t_s - since_s);
                }
            }
            _ => {}
        }
    }

    pub(super) fn observe(&mut self, t_s: f64, vehicles: &[VehicleNow]) {
        for vehicle in vehicles {
            let Some(in_contact) = self.in_contact.get_mut(index(vehicle.id)) else { continue };
            *in_contact = vehicle.in_contact;
            self.members.set(vehicle.id, vehicle.is_live_member());
            if vehicle.runs && vehicle.membership == Membership::Left {
                self.left.insert(vehicle.id);
            }
        }
        for link in mem::take(&mut self.suspected) {
            let is_false = self.is_falsely_suspected(t_s, link) && !self.is_far(vehicles, link);
            self.false_suspicions += u64::from(is_false);
        }
        for mut pending in mem::take(&mut self.pending) {
            pending.links.retain(|&link| self.is_still_pending(pending.what, link));
            if pending.links.is_empty() {
                continue;
            }
            if !pending.links.iter().all(|&link| self.is_observed(pending.what, link)) {
                self.pending.push(pending);
                continue;
            }
            self.reactions[pending.what as usize].add_time(t_s - pending.since_s);
        }
        self.is_settled = self.pending.is_empty();
    }

    /// Whether any link is cut.
    pub(super) fn is_split(&self) -> bool {
        self.cut_from.iter().any(|cut_from| !cut_from.is_empty())
    }

    /// Time from a death or a cut until every agent in contact with the sender has lost it, in a window that ends at
    /// `t_s`.
    pub(super) fn detection(&self, t_s: f64) -> Worst {
        self.reaction(Transition::Loss, t_s)
    }

    /// Time from a restart or a healed cut until every agent is in contact with the sender again, in a window that ends
    /// at `t_s`.
    pub(super) fn rejoin(&self, t_s: f64) -> Worst {
        self.reaction(Transition::Return, t_s)
    }

    /// Time from a failure until the vehicle reports one, in a window that ends at `t_s`.
    pub(super) fn response(&self, t_s: f64) -> Worst {
        let mut worst = self.response;
        if self.failed.iter().any(|(_, since_s)| t_s - since_s > LIMIT_S) {
            worst.is_never = true;
        }
        worst
    }

    fn reaction(&self, what: Transition, t_s: f64) -> Worst {
        let mut worst = self.reactions[what as usize];
        if self.pending.iter().any(|open| open.what == what && t_s - open.since_s > LIMIT_S) {
            worst.is_never = true;
        }
        worst
    }

    /// The links from this vehicle to all other running agents.
    fn others(&self, sender: VehicleId) -> impl Iterator<Item = Link> {
        let others = VehicleId::first(self.vehicles).filter(move |&id| id != sender && self.alive.contains(id));
        others.map(move |receiver| (sender, receiver))
    }

    fn is_cut(&self, (sender, receiver): Link) -> bool {
        self.cut_from.get(index(receiver)).is_some_and(|cut_from| cut_from.contains(sender))
    }

    fn has_contact(&self, (sender, receiver): Link) -> bool {
        self.in_contact.get(index(receiver)).is_some_and(|in_contact| in_contact.contains(sender))
    }

    /// Whether the vehicle has left the swarm: its peers do not have to count it as active.
    fn has_left(&self, id: VehicleId) -> bool {
        self.left.contains(id)
    }

    /// Whether the receiver can still detect the change: it runs, and the change is not over.
    fn is_still_pending(&self, what: Transition, link: Link) -> bool {
        let (sender, receiver) = link;
        let can_be_received = self.alive.contains(sender) && !self.is_cut(link);
        let still_holds = match what {
            Transition::Loss => !can_be_received,
            Transition::Return => can_be_received && !self.has_left(sender),
        };
        still_holds && self.alive.contains(receiver)
    }

    fn is_observed(&self, what: Transition, link: Link) -> bool {
        match what {
            Transition::Loss => !self.has_contact(link),
            Transition::Return => self.has_contact(link) && self.members.contains(link.0),
        }
    }

    /// Whether the sender is so far away that its messages may be lost.
    fn is_far(&self, vehicles: &[VehicleNow], (sender, receiver): Link) -> bool {
        let place = |id| vehicles.iter().find(|vehicle| vehicle.id == id).map(|vehicle| vehicle.truth.position);
        let apart_m = place(sender).zip(place(receiver)).map(|(one, other)| (one - other).norm());
        apart_m.is_some_and(|apart_m| apart_m > self.reach_m)
    }

    fn is_falsely_suspected(&self, t_s: f64, (sender, receiver): Link) -> bool {
        let is_long_ago = |since_s: Option<&f64>| since_s.is_none_or(|since_s| t_s - since_s >= AFTERMATH_S);
        let is_open =
            |sender, receiver| !self.is_cut((sender, receiver)) && is_long_ago(self.healed_s.get(&(sender, receiver)));
        self.alive.contains(sender)
            && !self.has_left(sender)
            && is_long_ago(self.born_s.get(index(sender)))
            && is_open(sender, receiver)
            && is_open(receiver, sender)
    }
}

#[cfg(test)]
mod tests;
