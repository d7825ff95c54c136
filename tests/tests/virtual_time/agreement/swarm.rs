//! Honest agents, the messages in flight between them, the agents left behind, and the effect of one liar.
//!
//! # Settled agents
//!
//! The third property is about all live agents. But an agent that has just restarted is live before another agent can
//! know it. Therefore the model defines:
//!
//! * `i` has *admitted* `j` when it received a message that `j` sent since `j` became active. This ends when `j` stops
//!   being active, when `i` crashes, or when the link between them is cut. It does not end when `i` suspects `j`, so
//!   that the effect of a false suspicion shows.
//! * `j` is *settled* when every other active agent on its side of a cut has admitted it, and its step is at least as
//!   late as that of every message sent on that side. It stays settled until it fails, until an agent that has not
//!   admitted it becomes active, or until a cut heals: then messages of the other side arrive.
//!
//! All agents are settled at first. They can be settled again after every failure and cut; this is checked too.
//!
//! # The liar
//!
//! One further vehicle may send any message to any agent at any time, different ones to different agents, or be silent.
//! A lie matters only when an agent acts on it. The liar therefore sends it in the same action, and withdraws it
//! afterwards: the state contains whether an agent is in contact with the liar, and not the content of the lie. A lie
//! that keeps agents waiting needs no action at all.

use std::hash::{Hash, Hasher};

use skein_common::id::Incarnation;
use skein_common::message::MessageOrder;
use skein_common::scenario::Partition;
use skein_common::state::Membership;
use skein_core::mission::agreement::{AgreementState, Progress};

use super::agent::{Agent, Bits, PeerMessage, has, known_key, others, sent_key};
use super::{MISLED, P1, P2, P3, P4, VOUCHED};

/// All orders of three agents.
const NAMINGS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

/// All orders of `N` agents, three at most.
fn namings<const N: usize>() -> impl Iterator<Item = [usize; N]> {
    let is_of_so_many = |naming: &&[usize; 3]| naming[N..].iter().zip(N..).all(|(&name, own)| name == own);
    NAMINGS.iter().filter(is_of_so_many).map(|naming| std::array::from_fn(|nth| naming[nth]))
}

/// Faults and cuts that may happen to `HONEST` honest agents.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds<const HONEST: usize> {
    pub(super) last_step: u32,
    pub(super) partition: Partition,
    /// Whether a further vehicle lies.
    pub(super) liar: bool,
    /// Number of failures of an agent: it crashes, or loses its simulator's data and becomes inactive. Each agent may
    /// return.
    pub(super) outages: u8,
    /// Number of times that one agent is cut off from the others. Each cut may heal.
    pub(super) cuts: u8,
    /// Whether a cut may last a minute. After a minute each side takes the vehicles of the other to have stopped
    /// flying.
    pub(super) long_cuts: bool,
    /// Whether an agent can be suspected although it is up and not cut off.
    pub(super) false_suspicion: bool,
}

impl<const HONEST: usize> Bounds<HONEST> {
    /// Bounds without failures and cuts: messages are only delayed, lost and repeated.
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
    /// Number of messages that the liar has sent.
    lies: u64,
    /// Latest step that an agent entered because it and all agents in contact had reached the step before, and not
    /// because it followed the liar.
    earned: u32,
    /// The agent that is cut off.
    cut_off: Option<usize>,
    outages_left: u8,
    cuts_left: u8,
    settled: Bits,
    /// Whether an agent of the others, and the agent cut off, advanced in this cut with no agent of the other side in
    /// view.
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
    /// `by` takes `whom` to have stopped flying, a minute after it suspected it.
    GiveUp {
        by: usize,
        whom: usize,
    },
    /// The liar vouches for a step.
    Lie {
        to: usize,
        vouched: u32,
    },
    /// An agent advances while the liar claims to have reached every step.
    AdvanceWithLiar(usize),
    /// The liar falls silent, or reports that it has left.
    Silence {
        to: usize,
    },
    Crash(usize),
    Restart(usize),
    Withdraw(usize),
    /// The agent becomes active: it received a message of every agent that is up and not cut off.
    Activate(usize),
    CutOff(usize),
    Heal,
}

impl<const N: usize> Swarm<N> {
    const ALL: Bits = (1 << N) - 1;

    /// A swarm whose agents are all active, and know that of each other.
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
            agent.publish();
        }
        for to in 0..N {
            others::<N>(to).for_each(|from| swarm.deliver(to, from, 0));
        }
        swarm
    }

    /// Appends the actions that may happen next.
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
                let messages = self.agents[other].sent.iter().enumerate().filter(arrives);
                actions.extend(messages.map(|(message, _)| Action::Deliver { to: agent, from: other, message }));
            }
        }
        match self.cut_off {
            Some(_) => actions.push(Action::Heal),
            None if self.cuts_left > 0 => actions.extend((0..N).map(Action::CutOff)),
            None => {}
        }
    }

    /// The swarm after an action; `None` if the action changes nothing.
    pub(super) fn after(&self, action: Action, bounds: &Bounds<N>) -> Option<Self> {
        let mut swarm = self.clone();
        swarm.apply(action, bounds);
        swarm.check(self);
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
        let has_received = |other: usize| {
            let incarnation = Incarnation(self.agents[other].incarnation);
            own.known[other].is_some_and(|message| message.order.incarnation == incarnation)
        };
        let mut linked = others::<N>(agent).filter(|&other| self.agents[other].is_up && self.are_linked(agent, other));
        own.agreement.own().membership == Membership::Joining && linked.all(has_received)
    }

    /// Whether a message changes anything at its receiver.
    fn is_news(&self, to: usize, from: usize, message: &PeerMessage) -> bool {
        let (to, sender) = (&self.agents[to], &self.agents[from]);
        to.is_news(from, message)
            || (sender.is_up && !has(to.sees, from))
            || (sender.is_latest(message) && !has(to.admitted, from))
    }

    fn deliver(&mut self, to: usize, from: usize, message: usize) {
        let sender = &self.agents[from];
        let (message, is_up) = (sender.sent[message], sender.is_up);
        let admits = sender.is_latest(&message);
        let receiver = &mut self.agents[to];
        receiver.receive(from, message);
        receiver.see::<N>(to, receiver.sees | Bits::from(is_up) << from);
        receiver.admitted |= Bits::from(admits) << from;
    }

    /// Delivers a message of the liar, newer than every earlier one.
    fn lie(&mut self, to: usize, state: AgreementState) {
        self.lies += 1;
        let order = MessageOrder { incarnation: Incarnation(self.lies), sequence: 0 };
        self.agents[to].receive(N, PeerMessage { order, state });
    }

    /// Delivers a lie to an agent, lets it act, and withdraws the lie.
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

    /// Ends the admission of an agent at all others.
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
                let (next, sent) = (dead.incarnation + 1, std::mem::take(&mut dead.sent));
                *dead = Agent { sent, is_up: false, ..Agent::new(bounds, next) };
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
        self.agents.iter_mut().filter(|agent| agent.is_up).for_each(Agent::publish);
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
            |&other: &usize| has(*sees, other) && known[other].is_some_and(|message| message.state.is_active());
        let in_view: Vec<usize> = (0..N).filter(is_member).collect();
        for &other in &in_view {
            let incarnation = known[other].map(|message| message.order.incarnation);
            let reports = |message: &PeerMessage| {
                Some(message.order.incarnation) == incarnation && message.state.has_reached(left)
            };
            if !self.agents[other].sent.iter().any(reports) {
                self.broken = Some(P2);
            }
        }
        if self.cut_off.is_some() && in_view.iter().all(|&other| self.are_linked(agent, other)) {
            self.advanced[usize::from(self.cut_off == Some(agent))] = true;
        }
    }

    /// Notes the property that an action broke, given the swarm before it.
    fn check(&mut self, before: &Self) {
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
            if !self.agents.iter().flat_map(|agent| &agent.sent).any(|message| message.state.reached >= Some(left)) {
                self.broken = Some(P4);
            }
        }
    }

    /// Updates the set of settled agents.
    fn settle(&mut self) {
        let is_settled = |&agent: &usize| {
            let is_linked = |&other: &usize| self.are_linked(agent, other);
            let mut peers = others::<N>(agent).filter(is_linked).filter(|&other| self.agents[other].is_active());
            let mut messages = (0..N).filter(is_linked).flat_map(|other| &self.agents[other].sent);
            self.agents[agent].is_active()
                && peers.all(|peer| has(self.agents[peer].admitted, agent))
                && (has(self.settled, agent)
                    || messages.all(|message| message.state.step <= self.agents[agent].agreement.own().step))
        };
        self.settled = (0..N).filter(is_settled).fold(0, |settled, agent| settled | 1 << agent);
    }

    pub(super) fn breaks(&self, property: &str) -> bool {
        self.broken == Some(property)
    }

    pub(super) fn is_behind(&self) -> bool {
        self.agents.iter().any(Agent::is_behind::<N>)
    }

    /// Whether an agent has followed the liar.
    pub(super) fn is_misled(&self) -> bool {
        self.agents.iter().any(|agent| agent.is_misled)
    }

    /// Whether both sides of the cut advanced without the other.
    pub(super) fn is_split(&self) -> bool {
        self.advanced == [true; 2]
    }

    /// Whether an agent is two steps ahead of a settled agent.
    pub(super) fn is_skewed(&self) -> bool {
        (0..N).filter(|&late| has(self.settled, late)).any(|late| {
            let step = |agent: &Agent| agent.agreement.own().step;
            let is_ahead = |other: &Agent| step(other) > step(&self.agents[late]) + 1;
            others::<N>(late).any(|other| self.are_linked(late, other) && is_ahead(&self.agents[other]))
        })
    }

    /// Whether all failures and cuts are over, and all agents are settled and still at the first step.
    pub(super) fn has_recovered(&self) -> bool {
        let is_over = self.outages_left + self.cuts_left == 0 && self.cut_off.is_none();
        is_over && self.settled == Self::ALL && self.agents.iter().all(|agent| agent.agreement.own().step == 0)
    }

    /// Whether all agents that are up come to the last step, in one round of publishing for every step. From here on
    /// the links are whole, messages arrive, the liar is silent, every agent reaches the step that it is at, and agents
    /// that are down are given up.
    pub(super) fn completes(self, bounds: &Bounds<N>) -> bool {
        self.completes_without(bounds, None)
    }

    /// As [`Self::completes`], whichever one agent comes no nearer to its step: it leaves, and all others complete.
    pub(super) fn completes_without_any(&self, bounds: &Bounds<N>) -> bool {
        (0..N)
            .filter(|&agent| self.agents[agent].is_up)
            .all(|stuck| self.clone().completes_without(bounds, Some(stuck)))
    }

    fn completes_without(mut self, bounds: &Bounds<N>, stuck: Option<usize>) -> bool {
        let last_step = bounds.last_step;
        self.cut_off = None;
        let up: Vec<usize> = (0..N).filter(|&agent| self.agents[agent].is_up).collect();
        let flying = up.len() - usize::from(stuck.is_some());
        if flying == 0 || bounds.partition == Partition::Quorum && 2 * flying <= bounds.vehicles() {
            return true;
        }
        let sees = up.iter().fold(0, |sees, &agent| sees | 1 << agent);
        // The one that leaves says so in the first round.
        let rounds = last_step + u32::from(stuck.is_some());
        (0..=rounds).any(|_| {
            if let Some(stuck) =
                stuck.filter(|&stuck| self.agents[stuck].agreement.own().membership != Membership::Left)
            {
                self.agents[stuck].set_membership(Membership::Left);
            }
            up.iter().for_each(|&agent| self.agents[agent].publish());
            for &to in &up {
                self.agents[to].given_up = !sees;
                self.agents[to].see::<N>(to, sees & !(1 << to));
                for from in others::<N>(to).filter(|&from| has(sees, from)) {
                    self.deliver(to, from, self.agents[from].sent.len() - 1);
                }
            }
            for &own in up.iter().filter(|&&own| Some(own) != stuck) {
                let agent = &mut self.agents[own];
                if agent.agreement.own().membership == Membership::Joining {
                    agent.set_membership(Membership::Active);
                }
                agent.advance::<N>(own);
                agent.agreement.reach();
            }
            let mut others = up.iter().filter(|&&own| Some(own) != stuck);
            others.all(|&agent| self.agents[agent].agreement.own().step == last_step)
        })
    }

    /// The part of an agent's state that does not refer to other agents.
    fn own_key(&self, agent: usize) -> impl Ord + Hash + Copy + use<N> {
        let Agent { is_up, sent, is_misled, sees, .. } = &self.agents[agent];
        let own = self.agents[agent].message();
        let mut keys = [0_u64; 4];
        for message in sent {
            let key = sent_key(message);
            keys[usize::from(key >> 6)] |= 1 << (key & 63);
        }
        (keys, sent_key(&own), *is_up, self.cut_off == Some(agent), *is_misled, has(*sees, N))
    }

    /// The part of the swarm's state that can affect later actions, beside the agents' own keys. Of a message in an
    /// agent's table these affect them: the incarnation and membership of its sender, which of the agent's own and
    /// later steps the sender reached, and how far the sender vouches beyond the agent's own vouched step.
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

/// To the checker two swarms are the same state if they differ only in the order of their agents, or in data that
/// cannot affect later actions.
impl<const N: usize> Hash for Swarm<N> {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        let own: [_; N] = std::array::from_fn(|agent| self.own_key(agent));
        let sorting = namings::<N>().filter(|naming| naming.is_sorted_by_key(|&agent| own[agent]));
        sorting.map(|naming| (naming.map(|agent| own[agent]), self.key(&naming))).min().hash(hasher);
    }
}
