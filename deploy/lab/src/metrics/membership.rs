//! Who counts on whom, held against who lives and who can be heard.

use std::mem;

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::Happening;

use super::series::Worst;
use super::{VehicleNow, index};

/// What is not noticed in this time never is, s.
const LIMIT_S: f64 = 30.0;
/// A loss this soon after a cut was healed or a life began still comes from what was before, s.
const AFTERMATH_S: f64 = 2.0;

/// From who speaks to who hears.
type Link = (VehicleId, VehicleId);

/// What the swarm makes of deaths, returns, cuts and failures.
#[derive(Clone, Debug)]
pub(super) struct Membership {
    vehicles: usize,
    /// Farther apart, nobody can count on being heard, m.
    reach_m: f64,
    alive: VehicleSet,
    members: VehicleSet,
    /// Have been members in their present life.
    joined: VehicleSet,
    /// Whom each vehicle does not count as lost, by id.
    hears: Vec<VehicleSet>,
    /// When each vehicle's present life began, by id, s.
    born_s: Vec<f64>,
    /// Whose links to each vehicle are cut, by its id.
    deaf_to: Vec<VehicleSet>,
    /// When each link was last healed, s; by speaker, then hearer.
    healed_s: Vec<f64>,
    awaited: Vec<Awaited>,
    failed: Vec<(VehicleId, f64)>,
    /// Losses told of since the last look.
    suspected: Vec<Link>,
    detection: Worst,
    rejoin: Worst,
    response: Worst,
    false_suspicions: u64,
}

/// Something that hearers are to notice of speakers.
#[derive(Clone, Debug)]
struct Awaited {
    since_s: f64,
    what: Notice,
    links: Vec<Link>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Notice {
    /// That the speaker is lost.
    Loss,
    /// That it is there again, and takes part.
    Return,
}

impl Membership {
    /// Everybody lives, nobody hears anybody, nothing is cut. Farther apart than `reach_m` distance loses words.
    pub(super) fn new(vehicles: usize, reach_m: Option<f64>) -> Self {
        Self {
            vehicles,
            reach_m: reach_m.unwrap_or(f64::INFINITY),
            alive: VehicleId::first(vehicles).collect(),
            members: VehicleSet::default(),
            joined: VehicleSet::default(),
            hears: vec![VehicleSet::default(); vehicles],
            born_s: vec![f64::NEG_INFINITY; vehicles],
            deaf_to: vec![VehicleSet::default(); vehicles],
            healed_s: vec![f64::NEG_INFINITY; vehicles * vehicles],
            awaited: Vec::new(),
            failed: Vec::new(),
            suspected: Vec::new(),
            detection: Worst::default(),
            rejoin: Worst::default(),
            response: Worst::default(),
            false_suspicions: 0,
        }
    }

    /// Its agent is dead.
    pub(super) fn died(&mut self, t_s: f64, id: VehicleId) {
        // Who has landed and ended is not missed.
        let is_missed = !self.has_left(id);
        let links = self.others(id).filter(|&link| is_missed && self.is_heard(link)).collect();
        self.awaited.push(Awaited { since_s: t_s, what: Notice::Loss, links });
        self.alive.remove(id);
        self.members.remove(id);
        self.failed.retain(|(failed, _)| *failed != id);
    }

    /// It has a new agent.
    pub(super) fn restarted(&mut self, t_s: f64, id: VehicleId) {
        self.alive.insert(id);
        self.joined.remove(id);
        if let Some(born_s) = self.born_s.get_mut(index(id)) {
            *born_s = t_s;
        }
        let links = self.others(id).collect();
        self.awaited.push(Awaited { since_s: t_s, what: Notice::Return, links });
    }

    /// Something of its vehicle does not work any more.
    pub(super) fn failed(&mut self, t_s: f64, id: VehicleId) {
        self.failed.push((id, t_s));
    }

    /// What is said on these links is not heard any more.
    pub(super) fn cut(&mut self, t_s: f64, links: &[Link]) {
        for &(speaker, hearer) in links {
            if let Some(deaf_to) = self.deaf_to.get_mut(index(hearer)) {
                deaf_to.insert(speaker);
            }
        }
        let links = links.iter().copied().filter(|&link| self.is_heard(link)).collect();
        self.awaited.push(Awaited { since_s: t_s, what: Notice::Loss, links });
    }

    /// It is heard again.
    pub(super) fn healed(&mut self, t_s: f64, links: &[Link]) {
        for &(speaker, hearer) in links {
            let Some(deaf_to) = self.deaf_to.get_mut(index(hearer)) else { continue };
            deaf_to.remove(speaker);
            if let Some(healed_s) = self.healed_s.get_mut(index(speaker) * self.vehicles + index(hearer)) {
                *healed_s = t_s;
            }
        }
        // One dead direction ends the session, and with it the other direction.
        let both_ways = links.iter().flat_map(|&(speaker, hearer)| [(speaker, hearer), (hearer, speaker)]);
        let links = both_ways.filter(|&link| !self.is_heard(link)).collect();
        self.awaited.push(Awaited { since_s: t_s, what: Notice::Return, links });
    }

    /// What a vehicle said of itself.
    pub(super) fn told(&mut self, t_s: f64, speaker: VehicleId, what: &Happening) {
        match what {
            // Judged when it is known who still lives: a death may come to be known after its detection.
            Happening::PeerLost(lost) => self.suspected.push((*lost, speaker)),
            Happening::Failed(_)
            | Happening::OwnDataStale
            | Happening::SimulatorLost
            | Happening::ControlFault
            | Happening::ClockJumped => {
                for (_, since_s) in self.failed.extract_if(.., |(failed, _)| *failed == speaker) {
                    self.response.took(t_s - since_s);
                }
            }
            _ => {}
        }
    }

    pub(super) fn observe(&mut self, t_s: f64, vehicles: &[VehicleNow]) {
        for vehicle in vehicles {
            let Some(hears) = self.hears.get_mut(index(vehicle.id)) else { continue };
            *hears = vehicle.hears;
            if vehicle.takes_part() {
                self.members.insert(vehicle.id);
                self.joined.insert(vehicle.id);
            } else {
                self.members.remove(vehicle.id);
            }
        }
        for link in mem::take(&mut self.suspected) {
            let is_false = self.is_falsely_suspected(t_s, link) && !self.is_far(vehicles, link);
            self.false_suspicions += u64::from(is_false);
        }
        for mut awaited in mem::take(&mut self.awaited) {
            awaited.links.retain(|&link| self.is_still_awaited(awaited.what, link));
            if awaited.links.is_empty() {
                continue;
            }
            if !awaited.links.iter().all(|&link| self.has_come(awaited.what, link)) {
                self.awaited.push(awaited);
                continue;
            }
            let worst = match awaited.what {
                Notice::Loss => &mut self.detection,
                Notice::Return => &mut self.rejoin,
            };
            worst.took(t_s - awaited.since_s);
        }
    }

    /// Live members, as they really are.
    pub(super) fn members(&self) -> VehicleSet {
        self.members
    }

    /// Whether any link is cut.
    pub(super) fn is_split(&self) -> bool {
        self.deaf_to.iter().any(|deaf_to| !deaf_to.is_empty())
    }

    /// From a death or a cut until everybody who heard the speaker has it lost; in a window that ends at `t_s`.
    pub(super) fn detection(&self, t_s: f64) -> Worst {
        self.with_open(self.detection, Notice::Loss, t_s)
    }

    /// From a restart or a healed cut until everybody counts on the speaker again; in a window that ends at `t_s`.
    pub(super) fn rejoin(&self, t_s: f64) -> Worst {
        self.with_open(self.rejoin, Notice::Return, t_s)
    }

    /// From a failure until its vehicle tells of one; in a window that ends at `t_s`.
    pub(super) fn response(&self, t_s: f64) -> Worst {
        let mut worst = self.response;
        if self.failed.iter().any(|(_, since_s)| t_s - since_s > LIMIT_S) {
            worst.never_came();
        }
        worst
    }

    /// How often somebody was lost who lived, could be heard, and had not left.
    pub(super) fn false_suspicions(&self) -> u64 {
        self.false_suspicions
    }

    fn with_open(&self, mut worst: Worst, what: Notice, t_s: f64) -> Worst {
        if self.awaited.iter().any(|open| open.what == what && t_s - open.since_s > LIMIT_S) {
            worst.never_came();
        }
        worst
    }

    /// The links from this vehicle to all others that live.
    fn others(&self, speaker: VehicleId) -> impl Iterator<Item = Link> {
        let others = VehicleId::first(self.vehicles).filter(move |&id| id != speaker && self.alive.contains(id));
        others.map(move |hearer| (speaker, hearer))
    }

    fn is_cut(&self, (speaker, hearer): Link) -> bool {
        self.deaf_to.get(index(hearer)).is_some_and(|deaf_to| deaf_to.contains(speaker))
    }

    fn is_heard(&self, (speaker, hearer): Link) -> bool {
        self.hears.get(index(hearer)).is_some_and(|hears| hears.contains(speaker))
    }

    /// Whether it had taken part in this life and does not any more.
    fn has_left(&self, id: VehicleId) -> bool {
        self.joined.contains(id) && !self.members.contains(id)
    }

    /// Nobody can notice what is over, and nobody dead notices anything.
    fn is_still_awaited(&self, what: Notice, link: Link) -> bool {
        let (speaker, hearer) = link;
        let can_be_heard = self.alive.contains(speaker) && !self.is_cut(link);
        let is_so = match what {
            Notice::Loss => !can_be_heard,
            Notice::Return => can_be_heard && !self.has_left(speaker),
        };
        is_so && self.alive.contains(hearer)
    }

    fn has_come(&self, what: Notice, link: Link) -> bool {
        match what {
            Notice::Loss => !self.is_heard(link),
            Notice::Return => self.is_heard(link) && self.members.contains(link.0),
        }
    }

    /// The speaker is too far away to be heard for certain.
    fn is_far(&self, vehicles: &[VehicleNow], (speaker, hearer): Link) -> bool {
        let place = |id| vehicles.iter().find(|vehicle| vehicle.id == id).map(|vehicle| vehicle.truth.position);
        let apart_m = place(speaker).zip(place(hearer)).map(|(one, other)| (one - other).norm());
        apart_m.is_some_and(|apart_m| apart_m > self.reach_m)
    }

    fn is_falsely_suspected(&self, t_s: f64, (speaker, hearer): Link) -> bool {
        let is_long_ago = |since_s: Option<&f64>| since_s.is_none_or(|since_s| t_s - since_s >= AFTERMATH_S);
        let is_open = |speaker, hearer| {
            let healed_s = self.healed_s.get(index(speaker) * self.vehicles + index(hearer));
            !self.is_cut((speaker, hearer)) && is_long_ago(healed_s)
        };
        self.alive.contains(speaker)
            && !self.has_left(speaker)
            && is_long_ago(self.born_s.get(index(speaker)))
            && is_open(speaker, hearer)
            && is_open(hearer, speaker)
    }
}

#[cfg(test)]
mod tests;
