//! Honest agents, the words under way between them, who has been left behind, and what one liar does to them.
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
//!
//! # The liar
//!
//! One further vehicle may say anything to any agent at any time, different things to different ones, or be silent. What it said
//! matters only when an agent acts on it, so it is said just then, in the same action, and taken back after it: whether an agent
//! hears the liar is part of the state, what the liar says is not. A lie that keeps agents waiting needs no action at all.

use std::hash::{Hash, Hasher};

use skein_common::id::Incarnation;
use skein_common::message::MessageOrder;
use skein_common::scenario::Partition;
use skein_common::state::Membership;
use skein_core::mission::agreement::{AgreementState, Progress};

use super::agent::{Agent, Bits, PeerMessage, has, known_key, others, said_key};
use super::{MISLED, P1, P2, P3, P4, VOUCHED};

/// Every way to name three.
const NAMINGS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

/// Every way to name so many, three at most.
fn namings<const N: usize>() -> impl Iterator<Item = [usize; N]> {
    let is_of_so_many = |naming: &&[usize; 3]| naming[N..].iter().zip(N..).all(|(&name, own)| name == own);
    NAMINGS.iter().filter(is_of_so_many).map(|naming| std::array::from_fn(|nth| naming[nth]))
}

/// What may happen to so many honest agents.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds<const HONEST: usize> {
    pub(super) last_step: u32,
    pub(super) partition: Partition,
    /// A further vehicle lies.
    pub(super) liar: bool,
    /// How often somebody falls: crashes, or loses its own data and takes part no longer. Each may come back.
    pub(super) outages: u8,
    /// How often one is cut off from the others. Each cut may heal.
    pub(super) cuts: u8,
    /// Whether a cut may last a minute, after which no further vehicle is taken to be flying on its other side.
    pub(super) long_cuts: bool,
    /// Whether somebody can be suspected who is up and not cut off.
    pub(super) false_suspicion: bool,
}

impl<const HONEST: usize> Bounds<HONEST> {
    /// Nothing happens but that words are late, lost and repeated.
    pub(super) const fn new(last_step: u32, partition: Partition) -> Self {
        let (liar, outages, cuts, long_cuts, false_suspicion) = (false, 0, 0, false, false);
        Self { last_step, partition, liar, outages, cuts, long_cuts, false_suspicion }
    }

    pub(super) fn vehicles(&self) -> usize {
        HONEST + usize::from(self.liar)
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Swarm<const N: usize> {
    agents: [Agent; N],
    /// The liar's words so far.
    lies: u64,
    /// The latest step that an agent has come to by having reached the one before with all that it saw, and not after the liar.
    earned: u32,
    /// The one that is cut off.
    cut_off: Option<usize>,
    outages_left: u8,
    cuts_left: u8,
    settled: Bits,
    /// Whether somebody of the others, and the one cut off, advanced in this cut with nobody of the other side in view.
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
        message: usize,
    },
    Suspect {
        by: usize,
        whom: usize,
    },
    /// A minute after it was suspected.
    GiveUp {
        by: usize,
        whom: usize,
    },
    /// The liar vouches for a step.
    Lie {
        to: usize,
        vouched: u32,
    },
    /// An agent advances while the liar says that it has reached everything.
    AdvanceWithLiar(usize),
    /// The liar falls silent, or says that it has left.
    Silence {
        to: usize,
    },
    Crash(usize),
    Restart(usize),
    Withdraw(usize),
    /// The end of listening: everybody up and not cut off has been heard.
    Activate(usize),
    CutOff(usize),
    Heal,
}

impl<const N: usize> Swarm<N> {
    const ALL: Bits = (1 << N) - 1;

    /// Everybody is active and has heard so.
    pub(super) fn start(bounds: &Bounds<N>) -> Self {
        let mut swarm = Self {
            agents: std::array::from_fn(|_| Agent::new(bounds, 0)),
            lies: 0,
            earned: 0,
            cut_off: None,
            outages_left: bounds.outages,
            cuts_left: bounds.cuts,
            settled: Self::ALL,
            advanced: [false; 2],
            broken: None,
        };
        for agent in &mut swarm.agents {
            agent.set_membership(Membership::Active);
            agent.say();
        }
        for to in 0..N {
            others::<N>(to).for_each(|from| swarm.deliver(to, from, 0));
        }
        swarm
    }

    /// What may happen next.
    pub(super) fn actions(&self, bounds: &Bounds<N>, actions: &mut Vec<Action>) {
        for agent in 0..N {
            let Agent { agreement, is_up, .. } = &self.agents[agent];
            if !is_up {
                actions.push(Action::Restart(agent));
                continue;
            }
            actions.push(Action::Advance(agent));
            let own = agreement.own();
            let is_there = own.reached >= Some(own.step) || own.step >= bounds.last_step;
            let is_active = self.agents[agent].is_active();
            actions.extend((is_active && !is_there).then_some(Action::Reach(agent)));
            if self.outages_left > 0 {
                actions.push(Action::Crash(agent));
                actions.extend(is_active.then_some(Action::Withdraw(agent)));
            }
            if self.may_activate(agent) {
                actions.push(Action::Activate(agent));
            }
            if bounds.liar {
                actions.extend((0..=bounds.last_step).map(|vouched| Action::Lie { to: agent, vouched }));
                actions.extend([Action::AdvanceWithLiar(agent), Action::Silence { to: agent }]);
            }
            for other in others::<N>(agent) {
                let gives_up = self.may_give_up(agent, other, bounds.long_cuts);
                actions.extend(gives_up.then_some(Action::GiveUp { by: agent, whom: other }));
                let suspects = self.may_suspect(agent, other, bounds.false_suspicion);
                actions.extend(suspects.then_some(Action::Suspect { by: agent, whom: other }));
                let arrives = |(_, message): &(usize, &PeerMessage)| {
                    self.are_linked(agent, other) && self.is_news(agent, other, message)
                };
                let messages = self.agents[other].said.iter().enumerate().filter(arrives);
                actions.extend(messages.map(|(message, _)| Action::Deliver { to: agent, from: other, message }));
            }
        }
        match self.cut_off {
            Some(_) => actions.push(Action::Heal),
            None if self.cuts_left > 0 => actions.extend((0..N).map(Action::CutOff)),
            None => {}
        }
    }

    /// How it is after that, unless it changes nothing.
    pub(super) fn after(&self, action: Action, bounds: &Bounds<N>) -> Option<Self> {
        let mut swarm = self.clone();
        swarm.apply(action, bounds);
        swarm.verifier(self);
        swarm.settle();
        (swarm != *self).then_some(swarm)
    }

    fn are_linked(&self, one: usize, other: usize) -> bool {
        self.cut_off.is_none_or(|lone| (lone == one) == (lone == other))
    }

    fn may_suspect(&self, by: usize, whom: usize, falsely: bool) -> bool {
        has(self.agents[by].sees, whom) && (falsely || !self.agents[whom].is_up || !self.are_linked(by, whom))
    }

    fn may_give_up(&self, by: usize, whom: usize, in_cuts: bool) -> bool {
        let Agent { sees, given_up, .. } = self.agents[by];
        let is_silent = !self.agents[whom].is_up || in_cuts && !self.are_linked(by, whom);
        is_silent && !has(sees | given_up, whom)
    }

    fn may_activate(&self, agent: usize) -> bool {
        let own = &self.agents[agent];
        let has_heard = |other: usize| {
            let life = Incarnation(self.agents[other].incarnation);
            own.known[other].is_some_and(|message| message.order.incarnation == life)
        };
        let mut linked = others::<N>(agent).filter(|&other| self.agents[other].is_up && self.are_linked(agent, other));
        own.agreement.own().membership == Membership::Joining && linked.all(has_heard)
    }

    /// Whether a word changes anything for the one who hears it.
    fn is_news(&self, to: usize, from: usize, message: &PeerMessage) -> bool {
        let (to, sender) = (&self.agents[to], &self.agents[from]);
        to.is_news(from, message)
            || (sender.is_up && !has(to.sees, from))
            || (sender.is_latest(message) && !has(to.admitted, from))
    }

    fn deliver(&mut self, to: usize, from: usize, message: usize) {
        let sender = &self.agents[from];
        let (message, is_up) = (sender.said[message], sender.is_up);
        let admits = sender.is_latest(&message);
        let receiver = &mut self.agents[to];
        receiver.receive(from, message);
        receiver.see::<N>(to, receiver.sees | Bits::from(is_up) << from);
        receiver.admitted |= Bits::from(admits) << from;
    }

    /// The liar's word, newer than any before.
    fn lie(&mut self, to: usize, part: AgreementState) {
        self.lies += 1;
        let order = MessageOrder { incarnation: Incarnation(self.lies), sequence: 0 };
        self.agents[to].receive(N, PeerMessage { order, part });
    }

    /// An agent hears this from the liar, does something, and the liar takes it back.
    fn lie_while(&mut self, to: usize, vouched: u32, bounds: &Bounds<N>, act: impl FnOnce(&mut Self)) {
        let (step, reached) = (bounds.last_step, Some(bounds.last_step));
        self.lie(to, AgreementState { membership: Membership::Active, step, vouched, reached });
        let sees = self.agents[to].sees | 1 << N;
        let progress = self.agents[to].see::<N>(to, sees);
        let is_unearned = self.agents[to].agreement.own().step > self.earned;
        self.agents[to].is_misled |= progress.is_some() && sees == 1 << N && is_unearned;
        act(self);
        self.lie(to, AgreementState::default());
    }

    /// Nobody has it admitted any longer.
    fn expel(&mut self, agent: usize) {
        self.agents.iter_mut().for_each(|other| other.admitted &= !(1 << agent));
    }

    fn apply(&mut self, action: Action, bounds: &Bounds<N>) {
        match action {
            Action::Reach(agent) => self.agents[agent].agreement.reach(),
            Action::Advance(agent) => self.advance(agent),
            Action::Deliver { to, from, message } => self.deliver(to, from, message),
            Action::Suspect { by, whom } => {
                let sees = self.agents[by].sees & !(1 << whom);
                self.agents[by].see::<N>(by, sees);
            }
            Action::GiveUp { by, whom } => {
                self.agents[by].given_up |= 1 << whom;
                let sees = self.agents[by].sees;
                self.agents[by].see::<N>(by, sees);
            }
            Action::Lie { to, vouched } => self.lie_while(to, vouched, bounds, |_| {}),
            Action::AdvanceWithLiar(agent) => self.lie_while(agent, 0, bounds, |swarm| swarm.advance(agent)),
            Action::Silence { to } => {
                let sees = self.agents[to].sees & !(1 << N);
                self.agents[to].see::<N>(to, sees);
            }
            Action::Crash(agent) => {
                self.outages_left -= 1;
                let dead = &mut self.agents[agent];
                let (next, said) = (dead.incarnation + 1, std::mem::take(&mut dead.said));
                *dead = Agent { said, is_up: false, ..Agent::new(bounds, next) };
                self.expel(agent);
            }
            Action::Restart(agent) => self.agents[agent].is_up = true,
            Action::Withdraw(agent) => {
                self.outages_left -= 1;
                self.agents[agent].set_membership(Membership::Joining);
                self.expel(agent);
            }
            Action::Activate(agent) => self.agents[agent].set_membership(Membership::Active),
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
        let left = self.agents[agent].agreement.own().step;
        if self.agents[agent].advance::<N>(agent) != Some(Progress::Advanced) {
            return;
        }
        let own = self.agents[agent].agreement.own();
        if !self.agents[agent].is_misled || own.vouched == own.step {
            self.earned = self.earned.max(own.step);
        }
        let Agent { known, sees, .. } = &self.agents[agent];
        let is_member =
            |&other: &usize| has(*sees, other) && known[other].is_some_and(|message| message.part.is_active());
        let in_view: Vec<usize> = (0..N).filter(is_member).collect();
        for &other in &in_view {
            let life = known[other].map(|message| message.order.incarnation);
            let reports =
                |message: &PeerMessage| Some(message.order.incarnation) == life && message.part.has_reached(left);
            if !self.agents[other].said.iter().any(reports) {
                self.broken = Some(P2);
            }
        }
        if self.cut_off.is_some() && in_view.iter().all(|&other| self.are_linked(agent, other)) {
            self.advanced[usize::from(self.cut_off == Some(agent))] = true;
        }
    }

    /// Notes what an action broke, given how things were before it.
    fn verifier(&mut self, before: &Self) {
        for agent in 0..N {
            let (was, is) = (&before.agents[agent], &self.agents[agent]);
            if was.incarnation != is.incarnation {
                continue;
            }
            let (was, is) = (was.agreement.own(), is.agreement.own());
            if is.step < was.step || is.reached < was.reached || is.vouched < was.vouched {
                self.broken = Some(P1);
            }
            if is.vouched > self.earned {
                self.broken = Some(VOUCHED);
            }
            if is.step <= was.step {
                continue;
            }
            if self.agents[agent].is_misled {
                continue;
            }
            if is.step > self.earned {
                self.broken = Some(MISLED);
            }
            let left = is.step - 1;
            let is_late =
                |&other: &usize| self.are_linked(agent, other) && !self.agents[other].agreement.own().has_reached(left);
            if (0..N).any(|other| has(before.settled, other) && is_late(&other)) {
                self.broken = Some(P3);
            }
            if !self.agents.iter().flat_map(|agent| &agent.said).any(|message| message.part.reached >= Some(left)) {
                self.broken = Some(P4);
            }
        }
    }

    /// Finds who is settled now, given who was.
    fn settle(&mut self) {
        let is_settled = |&agent: &usize| {
            let is_linked = |&other: &usize| self.are_linked(agent, other);
            let mut peers = others::<N>(agent).filter(is_linked).filter(|&other| self.agents[other].is_active());
            let mut messages = (0..N).filter(is_linked).flat_map(|other| &self.agents[other].said);
            self.agents[agent].is_active()
                && peers.all(|peer| has(self.agents[peer].admitted, agent))
                && (has(self.settled, agent)
                    || messages.all(|message| message.part.step <= self.agents[agent].agreement.own().step))
        };
        self.settled = (0..N).filter(is_settled).fold(0, |settled, agent| settled | 1 << agent);
    }

    pub(super) fn breaks(&self, property: &str) -> bool {
        self.broken == Some(property)
    }

    pub(super) fn is_behind(&self) -> bool {
        self.agents.iter().any(Agent::is_behind::<N>)
    }

    /// Somebody has followed the liar.
    pub(super) fn is_misled(&self) -> bool {
        self.agents.iter().any(|agent| agent.is_misled)
    }

    /// Both sides of the cut have gone on without the other.
    pub(super) fn is_split(&self) -> bool {
        self.advanced == [true; 2]
    }

    /// Whether somebody is two steps ahead of a settled agent.
    pub(super) fn is_skewed(&self) -> bool {
        (0..N).filter(|&late| has(self.settled, late)).any(|late| {
            let step = |agent: &Agent| agent.agreement.own().step;
            let is_ahead = |other: &Agent| step(other) > step(&self.agents[late]) + 1;
            others::<N>(late).any(|other| self.are_linked(late, other) && is_ahead(&self.agents[other]))
        })
    }

    /// All that may go wrong has, and all are settled, still at the first step.
    pub(super) fn has_recovered(&self) -> bool {
        let is_over = self.outages_left + self.cuts_left == 0 && self.cut_off.is_none();
        is_over && self.settled == Self::ALL && self.agents.iter().all(|agent| agent.agreement.own().step == 0)
    }

    /// Whether everybody up comes to the last step if from here on links are whole, words arrive, the liar is silent, and
    /// everybody reaches the step that it is at: in a round of publishing for every step. Who is down is given up.
    pub(super) fn completes(mut self, bounds: &Bounds<N>) -> bool {
        let last_step = bounds.last_step;
        self.cut_off = None;
        let up: Vec<usize> = (0..N).filter(|&agent| self.agents[agent].is_up).collect();
        if bounds.partition == Partition::Quorum && 2 * up.len() <= bounds.vehicles() {
            return true;
        }
        let sees = up.iter().fold(0, |sees, &agent| sees | 1 << agent);
        (0..=last_step).any(|_| {
            up.iter().for_each(|&agent| self.agents[agent].say());
            for &to in &up {
                self.agents[to].given_up = !sees;
                self.agents[to].see::<N>(to, sees & !(1 << to));
                for from in others::<N>(to).filter(|&from| has(sees, from)) {
                    self.deliver(to, from, self.agents[from].said.len() - 1);
                }
            }
            for &own in &up {
                let agent = &mut self.agents[own];
                if agent.agreement.own().membership == Membership::Joining {
                    agent.set_membership(Membership::Active);
                }
                agent.advance::<N>(own);
                agent.agreement.reach();
            }
            up.iter().all(|&agent| self.agents[agent].agreement.own().step == last_step)
        })
    }

    /// What matters of an agent, whoever the others are.
    fn own_key(&self, agent: usize) -> impl Ord + Hash + Copy + use<N> {
        let Agent { is_up, said, is_misled, sees, .. } = &self.agents[agent];
        let own = self.agents[agent].message();
        let mut keys = [0_u64; 4];
        for message in said {
            let key = said_key(message);
            keys[usize::from(key >> 6)] |= 1 << (key & 63);
        }
        (keys, said_key(&own), *is_up, self.cut_off == Some(agent), *is_misled, has(*sees, N))
    }

    /// What matters of a swarm to whatever may happen yet, beside the agents' own keys. Of a word in an agent's table this
    /// does: whose life, whether that one takes part, which of the agent's own and later steps it has reached, and how far
    /// beyond what the agent itself vouches for it vouches.
    fn key(&self, naming: &[usize; N]) -> impl Ord + Hash + use<N> {
        let rename = |bits: Bits| naming.iter().fold(0, |renamed, &agent| renamed << 1 | u8::from(has(bits, agent)));
        let views = naming.map(|agent| {
            let Agent { agreement, known, sees, given_up, admitted, .. } = &self.agents[agent];
            let own = agreement.own();
            let known = naming.map(|other| known[other].map(|message| known_key(&message, &own)));
            (known, rename(*sees), rename(*given_up), rename(*admitted))
        });
        (views, self.outages_left, self.cuts_left, rename(self.settled), self.advanced, self.earned, self.broken)
    }
}

/// Swarms are one to the checker if they differ in names only, or in what does not matter.
impl<const N: usize> Hash for Swarm<N> {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        let own: [_; N] = std::array::from_fn(|agent| self.own_key(agent));
        let sorting = namings::<N>().filter(|naming| naming.is_sorted_by_key(|&agent| own[agent]));
        sorting.map(|naming| (naming.map(|agent| own[agent]), self.key(&naming))).min().hash(hasher);
    }
}
