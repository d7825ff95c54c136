//! Three agents, the words under way between them, and who has been left behind.
//!
//! # Who counts
//!
//! The third property speaks of all live agents. But who has just come back lives before anybody can know it. Here
//!
//! * `i` has *admitted* `j` when it has heard a word that `j` said since it became active. It ends when `j` is no longer
//!   active, when `i` crashes, or when the link between them is cut: not when `i` suspects `j`, so a false one shows.
//! * `j` is *settled* when every other active agent on its side of a cut has admitted it, and it has been as far as every
//!   word that was said there. It stays so until it falls, somebody who has not admitted it becomes active, or a cut
//!   heals: then words of the other side arrive.
//!
//! All are settled at first, and can be again after everything that happens, which is checked too.

use std::hash::{Hash, Hasher};

use skein_agent::mission::agreement::{Agreement, Event, Part, Progress};
use skein_common::id::{Incarnation, VehicleId};
use skein_common::scenario::Partition;
use skein_common::state::Membership;

use super::{P1, P2, P3, P4};

const AGENTS: usize = 3;
/// Agents by index, one bit each.
type Bits = u8;
const ALL: Bits = (1 << AGENTS) - 1;
/// Every way to name them.
const NAMINGS: [[usize; AGENTS]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

/// What may happen.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    pub(super) last_step: u32,
    pub(super) partition: Partition,
    /// How often somebody falls: crashes, or loses its own data and takes part no longer. Each may come back.
    pub(super) falls: u8,
    /// How often one is cut off from the two others. Each cut may heal.
    pub(super) cuts: u8,
    /// Whether somebody can be suspected who is up and not cut off.
    pub(super) false_suspicion: bool,
}

#[derive(Clone, Debug, PartialEq)]
struct Agent {
    agreement: Agreement,
    incarnation: u64,
    /// How often its membership has changed in this life.
    sequence: u64,
    is_up: bool,
    /// Every word that it ever said.
    said: Vec<Part>,
    /// Who it takes to be there.
    sees: Bits,
    admitted: Bits,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Swarm {
    agents: [Agent; AGENTS],
    /// The one that is cut off.
    cut_off: Option<usize>,
    falls_left: u8,
    cuts_left: u8,
    settled: Bits,
    /// Whether somebody of the two, and the one cut off, advanced in this cut with nobody of the other side in view.
    advanced: [bool; 2],
    broken: Option<&'static str>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Action {
    Reach(usize),
    Advance(usize),
    Deliver {
        to: usize,
        from: usize,
        word: usize,
    },
    Suspect {
        by: usize,
        whom: usize,
    },
    Crash(usize),
    Restart(usize),
    Withdraw(usize),
    /// The end of listening: everybody up and not cut off has been heard.
    Activate(usize),
    CutOff(usize),
    Heal,
}

fn id(agent: usize) -> VehicleId {
    VehicleId::new(agent as u8 + 1).unwrap()
}

fn others(agent: usize) -> impl Iterator<Item = usize> {
    (0..AGENTS).filter(move |&other| other != agent)
}

fn has(bits: Bits, agent: usize) -> bool {
    bits & 1 << agent != 0
}

impl Agent {
    /// At the beginning of a life.
    fn new(own: usize, bounds: &Bounds, incarnation: u64) -> Self {
        Self {
            agreement: Agreement::new(id(own), AGENTS as u8, bounds.last_step, bounds.partition),
            incarnation,
            sequence: 0,
            is_up: true,
            said: Vec::new(),
            sees: 0,
            admitted: 0,
        }
    }

    fn part(&self) -> Part {
        Part {
            incarnation: Incarnation(self.incarnation),
            sequence: self.sequence,
            membership: self.agreement.membership(),
            step: self.agreement.at(),
            reached: self.agreement.reached(),
        }
    }

    fn is_active(&self) -> bool {
        self.is_up && self.agreement.membership() == Membership::Active
    }

    /// Takes part from now on, or no longer.
    fn turn(&mut self, membership: Membership) {
        self.agreement.step(Event::Became(membership));
        self.sequence += 1;
    }

    fn say(&mut self) {
        let part = self.part();
        if self.said.last() != Some(&part) {
            self.said.push(part);
        }
    }

    fn see(&mut self, sees: Bits) {
        self.sees = sees;
        self.agreement.step(Event::Sees((0..AGENTS).filter(|&other| has(sees, other)).map(id).collect()));
    }

    /// Whether it has heard of a step that it has not come to.
    fn is_behind(&self) -> bool {
        (0..AGENTS).filter_map(|other| self.agreement.part(id(other))).any(|part| part.step > self.agreement.at())
    }

    /// Whether it has said this since it became active, and is.
    fn is_latest(&self, word: &Part) -> bool {
        self.is_active() && (word.incarnation, word.sequence) == (Incarnation(self.incarnation), self.sequence)
    }
}

impl Swarm {
    /// Everybody is active and has heard so.
    pub(super) fn start(bounds: &Bounds) -> Self {
        let mut swarm = Self {
            agents: std::array::from_fn(|agent| Agent::new(agent, bounds, 0)),
            cut_off: None,
            falls_left: bounds.falls,
            cuts_left: bounds.cuts,
            settled: ALL,
            advanced: [false; 2],
            broken: None,
        };
        for agent in &mut swarm.agents {
            agent.turn(Membership::Active);
            agent.say();
        }
        for to in 0..AGENTS {
            others(to).for_each(|from| swarm.deliver(to, from, 0));
        }
        swarm
    }

    /// What may happen next.
    pub(super) fn actions(&self, bounds: &Bounds, actions: &mut Vec<Action>) {
        for agent in 0..AGENTS {
            let Agent { agreement, is_up, .. } = &self.agents[agent];
            if !is_up {
                actions.push(Action::Restart(agent));
                continue;
            }
            actions.push(Action::Advance(agent));
            let is_there = agreement.reached() >= Some(agreement.at()) || agreement.at() >= bounds.last_step;
            let is_active = self.agents[agent].is_active();
            actions.extend((is_active && !is_there).then_some(Action::Reach(agent)));
            if self.falls_left > 0 {
                actions.push(Action::Crash(agent));
                actions.extend(is_active.then_some(Action::Withdraw(agent)));
            }
            if self.may_activate(agent) {
                actions.push(Action::Activate(agent));
            }
            for other in others(agent) {
                let suspects = self.may_suspect(agent, other, bounds.false_suspicion);
                actions.extend(suspects.then_some(Action::Suspect { by: agent, whom: other }));
                let arrives =
                    |(_, word): &(usize, &Part)| self.are_linked(agent, other) && self.is_news(agent, other, word);
                let words = self.agents[other].said.iter().enumerate().filter(arrives);
                actions.extend(words.map(|(word, _)| Action::Deliver { to: agent, from: other, word }));
            }
        }
        match self.cut_off {
            Some(_) => actions.push(Action::Heal),
            None if self.cuts_left > 0 => actions.extend((0..AGENTS).map(Action::CutOff)),
            None => {}
        }
    }

    /// How it is after that, unless it changes nothing.
    pub(super) fn after(&self, action: Action, bounds: &Bounds) -> Option<Self> {
        let mut swarm = self.clone();
        swarm.apply(action, bounds);
        swarm.judge(self);
        swarm.settle();
        (swarm != *self).then_some(swarm)
    }

    fn are_linked(&self, one: usize, other: usize) -> bool {
        self.cut_off.is_none_or(|lone| (lone == one) == (lone == other))
    }

    fn may_suspect(&self, by: usize, whom: usize, falsely: bool) -> bool {
        has(self.agents[by].sees, whom) && (falsely || !self.agents[whom].is_up || !self.are_linked(by, whom))
    }

    fn may_activate(&self, agent: usize) -> bool {
        let own = &self.agents[agent].agreement;
        let has_heard = |other: usize| {
            let life = Incarnation(self.agents[other].incarnation);
            own.part(id(other)).is_some_and(|part| part.incarnation == life)
        };
        let mut linked = others(agent).filter(|&other| self.agents[other].is_up && self.are_linked(agent, other));
        own.membership() == Membership::Joining && linked.all(has_heard)
    }

    /// Whether a word changes anything for the one who hears it.
    fn is_news(&self, to: usize, from: usize, word: &Part) -> bool {
        let (to, speaker) = (&self.agents[to], &self.agents[from]);
        let known = to.agreement.part(id(from));
        known.is_none_or(|known| known.merge(*word) != *known)
            || word.step > to.agreement.at()
            || (speaker.is_up && !has(to.sees, from))
            || (speaker.is_latest(word) && !has(to.admitted, from))
    }

    fn deliver(&mut self, to: usize, from: usize, word: usize) {
        let speaker = &self.agents[from];
        let (part, is_up) = (speaker.said[word], speaker.is_up);
        let admits = speaker.is_latest(&part);
        let to = &mut self.agents[to];
        to.agreement.step(Event::Heard(id(from), part));
        to.see(to.sees | Bits::from(is_up) << from);
        to.admitted |= Bits::from(admits) << from;
    }

    /// Nobody has it admitted any longer.
    fn expel(&mut self, agent: usize) {
        self.agents.iter_mut().for_each(|other| other.admitted &= !(1 << agent));
    }

    fn apply(&mut self, action: Action, bounds: &Bounds) {
        match action {
            Action::Reach(agent) => {
                self.agents[agent].agreement.step(Event::Reached);
            }
            Action::Advance(agent) => self.advance(agent),
            Action::Deliver { to, from, word } => self.deliver(to, from, word),
            Action::Suspect { by, whom } => {
                let sees = self.agents[by].sees & !(1 << whom);
                self.agents[by].see(sees);
            }
            Action::Crash(agent) => {
                self.falls_left -= 1;
                let dead = &mut self.agents[agent];
                let (next, said) = (dead.incarnation + 1, std::mem::take(&mut dead.said));
                *dead = Agent { said, is_up: false, ..Agent::new(agent, bounds, next) };
                self.expel(agent);
            }
            Action::Restart(agent) => self.agents[agent].is_up = true,
            Action::Withdraw(agent) => {
                self.falls_left -= 1;
                self.agents[agent].turn(Membership::Joining);
                self.expel(agent);
            }
            Action::Activate(agent) => self.agents[agent].turn(Membership::Active),
            Action::CutOff(lone) => {
                self.cuts_left -= 1;
                self.cut_off = Some(lone);
                self.expel(lone);
                self.agents[lone].admitted = 0;
            }
            Action::Heal => {
                self.cut_off = None;
                self.advanced = [false; 2];
                self.settled = 0;
            }
        }
        self.agents.iter_mut().filter(|agent| agent.is_up).for_each(Agent::say);
    }

    fn advance(&mut self, agent: usize) {
        let Agent { agreement, .. } = &mut self.agents[agent];
        let (left, view) = (agreement.at(), agreement.members());
        if agreement.step(Event::Free) != Some(Progress::Advanced) {
            return;
        }
        let in_view: Vec<usize> = (0..AGENTS).filter(|&other| view.contains(id(other))).collect();
        for &other in &in_view {
            let life = self.agents[agent].agreement.part(id(other)).map(|part| part.incarnation);
            let reports = |word: &Part| Some(word.incarnation) == life && word.has_reached(left);
            if !self.agents[other].said.iter().any(reports) {
                self.broken = Some(P2);
            }
        }
        if self.cut_off.is_some() && in_view.iter().all(|&other| self.are_linked(agent, other)) {
            self.advanced[usize::from(self.cut_off == Some(agent))] = true;
        }
    }

    /// Notes what an action broke, given how things were before it.
    fn judge(&mut self, before: &Self) {
        for agent in 0..AGENTS {
            let (was, is) = (before.agents[agent].part(), self.agents[agent].part());
            if was.incarnation != is.incarnation {
                continue;
            }
            if is.step < was.step || is.reached < was.reached {
                self.broken = Some(P1);
            }
            if is.step <= was.step {
                continue;
            }
            let left = is.step - 1;
            let is_late =
                |&other: &usize| self.are_linked(agent, other) && !self.agents[other].part().has_reached(left);
            if (0..AGENTS).any(|other| has(before.settled, other) && is_late(&other)) {
                self.broken = Some(P3);
            }
            if !self.agents.iter().flat_map(|agent| &agent.said).any(|word| word.reached >= Some(left)) {
                self.broken = Some(P4);
            }
        }
    }

    /// Finds who is settled now, given who was.
    fn settle(&mut self) {
        let is_settled = |&agent: &usize| {
            let is_linked = |&other: &usize| self.are_linked(agent, other);
            let mut peers = others(agent).filter(is_linked).filter(|&other| self.agents[other].is_active());
            let mut words = (0..AGENTS).filter(is_linked).flat_map(|other| &self.agents[other].said);
            self.agents[agent].is_active()
                && peers.all(|peer| has(self.agents[peer].admitted, agent))
                && (has(self.settled, agent) || words.all(|word| word.step <= self.agents[agent].agreement.at()))
        };
        self.settled = (0..AGENTS).filter(is_settled).fold(0, |settled, agent| settled | 1 << agent);
    }

    pub(super) fn breaks(&self, property: &str) -> bool {
        self.broken == Some(property)
    }

    pub(super) fn is_behind(&self) -> bool {
        self.agents.iter().any(Agent::is_behind)
    }

    /// Both sides of the cut have gone on without the other.
    pub(super) fn is_split(&self) -> bool {
        self.advanced == [true; 2]
    }

    /// Whether somebody is two steps ahead of a settled agent.
    pub(super) fn is_skewed(&self) -> bool {
        (0..AGENTS).filter(|&late| has(self.settled, late)).any(|late| {
            let is_ahead = |other: &Agent| other.agreement.at() > self.agents[late].agreement.at() + 1;
            others(late).any(|other| self.are_linked(late, other) && is_ahead(&self.agents[other]))
        })
    }

    /// All that may go wrong has, and all are settled, still at the first step.
    pub(super) fn has_recovered(&self) -> bool {
        let is_over = self.falls_left + self.cuts_left == 0 && self.cut_off.is_none();
        is_over && self.settled == ALL && self.agents.iter().all(|agent| agent.agreement.at() == 0)
    }

    /// Whether everybody up comes to the last step if from here on links are whole, words arrive, and everybody reaches
    /// the step that it is at: in a round of publishing for every step.
    pub(super) fn completes(mut self, last_step: u32) -> bool {
        self.cut_off = None;
        let up: Vec<usize> = (0..AGENTS).filter(|&agent| self.agents[agent].is_up).collect();
        let sees = up.iter().fold(0, |sees, &agent| sees | 1 << agent);
        (0..=last_step).any(|_| {
            up.iter().for_each(|&agent| self.agents[agent].say());
            for &to in &up {
                self.agents[to].see(sees & !(1 << to));
                for from in others(to).filter(|&from| has(sees, from)) {
                    self.deliver(to, from, self.agents[from].said.len() - 1);
                }
            }
            for &agent in &up {
                let agent = &mut self.agents[agent];
                if agent.agreement.membership() == Membership::Joining {
                    agent.turn(Membership::Active);
                }
                agent.agreement.step(Event::Free);
                agent.agreement.step(Event::Reached);
            }
            up.iter().all(|&agent| self.agents[agent].agreement.at() == last_step)
        })
    }

    /// What matters of an agent, whoever the others are.
    fn own_key(&self, agent: usize) -> impl Ord + Hash + Copy + use<> {
        let Agent { is_up, said, .. } = &self.agents[agent];
        let own = self.agents[agent].part();
        let said = said.iter().fold(0_u64, |said, word| said | 1 << word_key(word, word.step));
        (said, word_key(&own, own.step), *is_up, self.cut_off == Some(agent))
    }

    /// What matters of a swarm to whatever may happen yet, beside the agents' own keys. An agent is never behind a step
    /// that it has heard of, so of a word in its table only this does: whose life, whether that one takes part, and
    /// whether it has reached the agent's own step.
    fn key(&self, naming: &[usize; AGENTS]) -> impl Ord + Hash + use<> {
        let rename = |bits: Bits| naming.iter().fold(0, |renamed, &agent| renamed << 1 | u8::from(has(bits, agent)));
        let views = naming.map(|agent| {
            let Agent { agreement, sees, admitted, .. } = &self.agents[agent];
            let known = |other| agreement.part(id(other)).map(|part| Part { step: 0, ..*part });
            let known = naming.map(|other| known(other).map(|part| word_key(&part, agreement.at())));
            (known, rename(*sees), rename(*admitted))
        });
        (views, self.falls_left, self.cuts_left, rename(self.settled), self.advanced, self.broken)
    }
}

/// One of the 64 words that differ in what matters to somebody at this step.
fn word_key(word: &Part, step: u32) -> u8 {
    let key = (word.incarnation.0 << 2 | word.sequence) << 3 | u64::from(word.step) << 1;
    key as u8 | u8::from(word.has_reached(step))
}

/// Swarms are one to the checker if they differ in names only, or in what does not matter.
impl Hash for Swarm {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        let own: [_; AGENTS] = std::array::from_fn(|agent| self.own_key(agent));
        let sorting = NAMINGS.iter().filter(|naming| naming.is_sorted_by_key(|&agent| own[agent]));
        sorting.map(|naming| (naming.map(|agent| own[agent]), self.key(naming))).min().hash(hasher);
    }
}
