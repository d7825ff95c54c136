//! The state of the model: honest agents, the messages in flight between them, and one liar.
//!
//! # Settled agents
//!
//! The third property is about all live agents. But an agent that has just returned is live before any peer can know
//! it. Therefore the model defines:
//!
//! * Agent `i` has *admitted* agent `j` when `i` has received a message that `j` sent since `j` became active. This
//!   ends when `j` is no longer active, when `i` crashes, or when the link between them is cut. It does not end when
//!   `i` suspects `j`, so that a false suspicion shows.
//! * Agent `j` is *settled* when every other active agent on its side of a cut has admitted it, and `j` is at least at
//!   the step of every message that was sent there. It stays settled until it has an outage, an agent that has not
//!   admitted it becomes active, or a cut ends: then messages of the other side arrive.
//!
//! All agents are settled at first, and can be settled again after every sequence of events; that is checked too.
//!
//! # The liar
//!
//! One further vehicle may send anything to any agent at any time, different messages to different agents, or be
//! silent. A lie matters only when an agent acts on it. The model therefore sends the lie in the same action, and
//! withdraws it after the action: whether the liar is in contact is part of the state, the content of the lie is not. A
//! lie that keeps agents waiting needs no action at all.

use std::hash::{Hash, Hasher};

use skein_common::id::{Incarnation, VehicleId};
use skein_common::message::MessageOrder;
use skein_common::scenario::Partition;
use skein_common::state::Membership;
use skein_core::mission::agreement::{Agreement, Event, Part, Progress};

use super::{MISLED, P1, P2, P3, P4, VOUCHED};

/// A set of agents, one bit each by index; the liar's bit is the one after the last agent's.
type Bits = u8;
/// All permutations of three agents.
const PERMUTATIONS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

/// All permutations of `N` agents, three at most.
fn permutations<const N: usize>() -> impl Iterator<Item = [usize; N]> {
    let keeps_the_rest = |permutation: &&[usize; 3]| permutation[N..].iter().zip(N..).all(|(&name, own)| name == own);
    PERMUTATIONS.iter().filter(keeps_the_rest).map(|permutation| std::array::from_fn(|nth| permutation[nth]))
}

/// Limits of the events that may happen to this number of honest agents.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds<const HONEST: usize> {
    pub(super) last_step: u32,
    pub(super) partition: Partition,
    /// Whether a further vehicle lies.
    pub(super) liar: bool,
    /// Number of outages: an agent crashes, or loses its own data and is no longer active. Each agent may return.
    pub(super) outages: u8,
    /// Number of cuts, each of one agent from the others. Each cut may end.
    pub(super) cuts: u8,
    /// Whether a cut may last a minute, after which agents assume that no vehicle flies any more on its other side.
    pub(super) long_cuts: bool,
    /// Whether an agent can be suspected that is up and not cut off.
    pub(super) false_suspicion: bool,
}

impl<const HONEST: usize> Bounds<HONEST> {
    /// No events except that messages are late, lost and repeated.
    pub(super) const fn new(last_step: u32, partition: Partition) -> Self {
        let (liar, outages, cuts, long_cuts, false_suspicion) = (false, 0, 0, false, false);
        Self { last_step, partition, liar, outages, cuts, long_cuts, false_suspicion }
    }

    fn vehicles(&self) -> usize {
        HONEST + usize::from(self.liar)
    }
}

#[derive(Clone, Debug, PartialEq)]
struct Agent {
    agreement: Agreement,
    incarnation: u64,
    /// Number of changes of its membership in this incarnation.
    sequence: u64,
    is_up: bool,
    /// Every message that it ever sent.
    sent: Vec<Part>,
    /// Peers in contact.
    sees: Bits,
    /// Peers out of contact that it assumes to have stopped flying.
    given_up: Bits,
    admitted: Bits,
    /// Whether in this incarnation it followed the liar, its only peer in contact, to a step that no honest agent had
    /// earned.
    is_misled: bool,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Swarm<const N: usize> {
    agents: [Agent; N],
    /// Number of lies so far: each is a new incarnation of the liar, so that nothing remains of the lie before.
    lies: u64,
    /// The latest step that an agent entered because it and all its peers in contact had reached the step before, and
    /// not by following the liar.
    earned: u32,
    /// The agent that is cut off.
    cut_off: Option<usize>,
    outages_left: u8,
    cuts_left: u8,
    settled: Bits,
    /// Whether one of the others, and the agent cut off, advanced in this cut with no agent of the other side in view.
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
    /// A peer is assumed to have stopped flying, a minute after it was suspected.
    GiveUp {
        by: usize,
        whom: usize,
    },
    /// The liar vouches for a step.
    Lie {
        to: usize,
        vouched: u32,
    },
    /// An agent advances while the liar reports that it has reached everything.
    AdvanceWithLiar(usize),
    /// The liar becomes silent, or reports that it has left.
    Silence {
        to: usize,
    },
    Crash(usize),
    Restart(usize),
    Withdraw(usize),
    /// An agent becomes active: it has received messages of every agent that is up and not cut off.
    Activate(usize),
    CutOff(usize),
    Heal,
}

fn id(agent: usize) -> VehicleId {
    VehicleId::new(agent as u8 + 1).unwrap()
}

fn others<const N: usize>(agent: usize) -> impl Iterator<Item = usize> {
    (0..N).filter(move |&other| other != agent)
}

fn has(bits: Bits, agent: usize) -> bool {
    bits & 1 << agent != 0
}

impl Agent {
    /// An agent at the start of an incarnation.
    fn new<const N: usize>(own: usize, bounds: &Bounds<N>, incarnation: u64) -> Self {
        Self {
            agreement: Agreement::new(id(own), bounds.vehicles() as u8, bounds.last_step, bounds.partition),
            incarnation,
            sequence: 0,
            is_up: true,
            sent: Vec::new(),
            sees: 0,
            given_up: 0,
            admitted: 0,
            is_misled: false,
        }
    }

    fn part(&self) -> Part {
        Part {
            order: MessageOrder { incarnation: Incarnation(self.incarnation), sequence: self.sequence },
            membership: self.agreement.membership(),
            step: self.agreement.at(),
            vouched: self.agreement.vouched(),
            reached: self.agreement.reached(),
        }
    }

    fn is_active(&self) -> bool {
        self.is_up && self.agreement.membership() == Membership::Active
    }

    /// Changes the membership.
    fn change_membership(&mut self, membership: Membership) {
        self.agreement.step(Event::Became(membership));
        self.sequence += 1;
    }

    fn send(&mut self) {
        let part = self.part();
        if self.sent.last() != Some(&part) {
            self.sent.push(part);
        }
    }

    /// Sets the peers in contact; `own` is the agent's index among `N` honest ones. A liar out of contact may have
    /// left: it does not count as lost.
    fn see<const N: usize>(&mut self, own: usize, sees: Bits) -> Option<Progress> {
        self.sees = sees;
        self.given_up &= !sees;
        let heard = (0..=N).filter(|&other| has(sees, other)).map(id).collect();
        let misses_any = others::<N>(own).any(|other| !has(self.sees | self.given_up, other));
        self.agreement.step(Event::Sees { heard, misses_any })
    }

    /// Whether two peers in contact vouch for a later step than its own.
    fn is_behind<const N: usize>(&self) -> bool {
        let vouches = |&other: &usize| {
            let part = self.agreement.part(id(other));
            has(self.sees, other) && part.is_some_and(|part| part.vouched > self.agreement.at())
        };
        (0..N).filter(vouches).count() >= 2
    }

    /// Whether it is active and has sent this message since it became active.
    fn is_latest(&self, word: &Part) -> bool {
        self.is_active() && word.order == self.part().order
    }
}

impl<const N: usize> Swarm<N> {
    const ALL: Bits = (1 << N) - 1;

    /// All agents are active, and each has received that of the others.
    pub(super) fn start(bounds: &Bounds<N>) -> Self {
        let mut swarm = Self {
            agents: std::array::from_fn(|agent| Agent::new(agent, bounds, 0)),
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
            agent.change_membership(Membership::Active);
            agent.send();
        }
        for to in 0..N {
            others::<N>(to).for_each(|from| swarm.deliver(to, from, 0));
        }
        swarm
    }

    /// Actions that are possible in this state.
    pub(super) fn actions(&self, bounds: &Bounds<N>, actions: &mut Vec<Action>) {
        for agent in 0..N {
            let Agent { agreement, is_up, .. } = &self.agents[agent];
            if !is_up {
                actions.push(Action::Restart(agent));
                continue;
            }
            actions.push(Action::Advance(agent));
            let is_there = agreement.reached() >= Some(agreement.at()) || agreement.at() >= bounds.last_step;
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
                let arrives =
                    |(_, word): &(usize, &Part)| self.are_linked(agent, other) && self.is_news(agent, other, word);
                let words = self.agents[other].sent.iter().enumerate().filter(arrives);
                actions.extend(words.map(|(word, _)| Action::Deliver { to: agent, from: other, word }));
            }
        }
        match self.cut_off {
            Some(_) => actions.push(Action::Heal),
            None if self.cuts_left > 0 => actions.extend((0..N).map(Action::CutOff)),
            None => {}
        }
    }

    /// The state after the action; `None` if the action changes nothing.
    pub(super) fn after(&self, action: Action, bounds: &Bounds<N>) -> Option<Self> {
        let mut swarm = self.clone();
        swarm.apply(action, bounds);
        swarm.note_violations(self);
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
        let own = &self.agents[agent].agreement;
        let has_received = |other: usize| {
            let life = Incarnation(self.agents[other].incarnation);
            own.part(id(other)).is_some_and(|part| part.order.incarnation == life)
        };
        let mut linked = others::<N>(agent).filter(|&other| self.agents[other].is_up && self.are_linked(agent, other));
        own.membership() == Membership::Joining && linked.all(has_received)
    }

    /// Whether a message changes anything for its receiver.
    fn is_news(&self, to: usize, from: usize, word: &Part) -> bool {
        let (to, speaker) = (&self.agents[to], &self.agents[from]);
        let known = to.agreement.part(id(from));
        known.is_none_or(|known| known.merge(*word) != *known)
            || (speaker.is_up && !has(to.sees, from))
            || (speaker.is_latest(word) && !has(to.admitted, from))
    }

    fn deliver(&mut self, to: usize, from: usize, word: usize) {
        let speaker = &self.agents[from];
        let (part, is_up) = (speaker.sent[word], speaker.is_up);
        let admits = speaker.is_latest(&part);
        let hearer = &mut self.agents[to];
        hearer.agreement.step(Event::Heard(id(from), part));
        hearer.see::<N>(to, hearer.sees | Bits::from(is_up) << from);
        hearer.admitted |= Bits::from(admits) << from;
    }

    /// Delivers a lie, as a message of a new incarnation of the liar.
    fn lie(&mut self, to: usize, lie: Part) {
        self.lies += 1;
        let lie = Part { order: MessageOrder { incarnation: Incarnation(self.lies), ..lie.order }, ..lie };
        self.agents[to].agreement.step(Event::Heard(id(N), lie));
    }

    /// Delivers a lie, performs an action, and withdraws the lie.
    fn lie_while(&mut self, to: usize, vouched: u32, bounds: &Bounds<N>, act: impl FnOnce(&mut Self)) {
        let (step, reached) = (bounds.last_step, Some(bounds.last_step));
        self.lie(to, Part { membership: Membership::Active, step, vouched, reached, ..Part::default() });
        let sees = self.agents[to].sees | 1 << N;
        let progress = self.agents[to].see::<N>(to, sees);
        let is_unearned = self.agents[to].agreement.at() > self.earned;
        self.agents[to].is_misled |= progress.is_some() && sees == 1 << N && is_unearned;
        act(self);
        self.lie(to, Part::default());
    }

    /// Removes the agent from the admitted peers of all others.
    fn expel(&mut self, agent: usize) {
        self.agents.iter_mut().for_each(|other| other.admitted &= !(1 << agent));
    }

    fn apply(&mut self, action: Action, bounds: &Bounds<N>) {
        match action {
            Action::Reach(agent) => {
                self.agents[agent].agreement.step(Event::Reached);
            }
            Action::Advance(agent) => self.advance(agent),
            Action::Deliver { to, from, word } => self.deliver(to, from, word),
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
                *dead = Agent { sent, is_up: false, ..Agent::new(agent, bounds, next) };
                self.expel(agent);
            }
            Action::Restart(agent) => self.agents[agent].is_up = true,
            Action::Withdraw(agent) => {
                self.outages_left -= 1;
                self.agents[agent].change_membership(Membership::Joining);
                self.expel(agent);
            }
            Action::Activate(agent) => self.agents[agent].change_membership(Membership::Active),
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
        self.agents.iter_mut().filter(|agent| agent.is_up).for_each(Agent::send);
    }

    fn advance(&mut self, agent: usize) {
        let Agent { agreement, .. } = &mut self.agents[agent];
        let (left, view) = (agreement.at(), agreement.members());
        if agreement.step(Event::Free) != Some(Progress::Advanced) {
            return;
        }
        let own = self.agents[agent].part();
        if !self.agents[agent].is_misled || own.vouched == own.step {
            self.earned = self.earned.max(own.step);
        }
        let in_view: Vec<usize> = (0..N).filter(|&other| view.contains(id(other))).collect();
        for &other in &in_view {
            let life = self.agents[agent].agreement.part(id(other)).map(|part| part.order.incarnation);
            let reports = |word: &Part| Some(word.order.incarnation) == life && word.has_reached(left);
            if !self.agents[other].sent.iter().any(reports) {
                self.broken = Some(P2);
            }
        }
        if self.cut_off.is_some() && in_view.iter().all(|&other| self.are_linked(agent, other)) {
            self.advanced[usize::from(self.cut_off == Some(agent))] = true;
        }
    }

    /// Notes which property the action violated, given the state before it.
    fn note_violations(&mut self, before: &Self) {
        for agent in 0..N {
            let (was, is) = (before.agents[agent].part(), self.agents[agent].part());
            if was.order.incarnation != is.order.incarnation {
                continue;
            }
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
                |&other: &usize| self.are_linked(agent, other) && !self.agents[other].part().has_reached(left);
            if (0..N).any(|other| has(before.settled, other) && is_late(&other)) {
                self.broken = Some(P3);
            }
            if !self.agents.iter().flat_map(|agent| &agent.sent).any(|word| word.reached >= Some(left)) {
                self.broken = Some(P4);
            }
        }
    }

    /// Updates the set of settled agents.
    fn settle(&mut self) {
        let is_settled = |&agent: &usize| {
            let is_linked = |&other: &usize| self.are_linked(agent, other);
            let mut peers = others::<N>(agent).filter(is_linked).filter(|&other| self.agents[other].is_active());
            let mut words = (0..N).filter(is_linked).flat_map(|other| &self.agents[other].sent);
            self.agents[agent].is_active()
                && peers.all(|peer| has(self.agents[peer].admitted, agent))
                && (has(self.settled, agent) || words.all(|word| word.step <= self.agents[agent].agreement.at()))
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

    /// Whether both sides of the cut have advanced without the other.
    pub(super) fn is_split(&self) -> bool {
        self.advanced == [true; 2]
    }

    /// Whether an agent is two steps ahead of a settled agent.
    pub(super) fn is_skewed(&self) -> bool {
        (0..N).filter(|&late| has(self.settled, late)).any(|late| {
            let is_ahead = |other: &Agent| other.agreement.at() > self.agents[late].agreement.at() + 1;
            others::<N>(late).any(|other| self.are_linked(late, other) && is_ahead(&self.agents[other]))
        })
    }

    /// Whether all outages and cuts have happened and ended, and all agents are settled and still at the first step.
    pub(super) fn has_recovered(&self) -> bool {
        let is_over = self.outages_left + self.cuts_left == 0 && self.cut_off.is_none();
        is_over && self.settled == Self::ALL && self.agents.iter().all(|agent| agent.agreement.at() == 0)
    }

    /// Whether every agent that is up reaches the last step, in one round of heartbeats for every step, if from here on
    /// no link is cut, messages arrive, the liar is silent and every agent reaches its step. Agents that are down are
    /// assumed to have stopped flying.
    pub(super) fn completes(mut self, bounds: &Bounds<N>) -> bool {
        let last_step = bounds.last_step;
        self.cut_off = None;
        let up: Vec<usize> = (0..N).filter(|&agent| self.agents[agent].is_up).collect();
        if bounds.partition == Partition::Quorum && 2 * up.len() <= bounds.vehicles() {
            return true;
        }
        let sees = up.iter().fold(0, |sees, &agent| sees | 1 << agent);
        (0..=last_step).any(|_| {
            up.iter().for_each(|&agent| self.agents[agent].send());
            for &to in &up {
                self.agents[to].given_up = !sees;
                self.agents[to].see::<N>(to, sees & !(1 << to));
                for from in others::<N>(to).filter(|&from| has(sees, from)) {
                    self.deliver(to, from, self.agents[from].sent.len() - 1);
                }
            }
            for &agent in &up {
                let agent = &mut self.agents[agent];
                if agent.agreement.membership() == Membership::Joining {
                    agent.change_membership(Membership::Active);
                }
                agent.agreement.step(Event::Free);
                agent.agreement.step(Event::Reached);
            }
            up.iter().all(|&agent| self.agents[agent].agreement.at() == last_step)
        })
    }

    /// The part of an agent's state that does not refer to other agents.
    fn own_key(&self, agent: usize) -> impl Ord + Hash + Copy + use<N> {
        let Agent { is_up, sent, is_misled, sees, .. } = &self.agents[agent];
        let own = self.agents[agent].part();
        let mut keys = [0_u64; 4];
        for word in sent {
            let key = sent_key(word);
            keys[usize::from(key >> 6)] |= 1 << (key & 63);
        }
        (keys, sent_key(&own), *is_up, self.cut_off == Some(agent), *is_misled, has(*sees, N))
    }

    /// The rest of the state that influences later events, beside the agents' own keys. Of a message in an agent's
    /// table these matter: the sender's incarnation, whether it is active, which of the agent's own and later steps it
    /// has reached, and which steps beyond the agent's own vouched step it vouches for.
    fn key(&self, permutation: &[usize; N]) -> impl Ord + Hash + use<N> {
        let rename =
            |bits: Bits| permutation.iter().fold(0, |renamed, &agent| renamed << 1 | u8::from(has(bits, agent)));
        let views = permutation.map(|agent| {
            let Agent { agreement, sees, given_up, admitted, .. } = &self.agents[agent];
            let (at, vouched) = (agreement.at(), agreement.vouched());
            let known = permutation.map(|other| agreement.part(id(other)).map(|part| known_key(part, at, vouched)));
            (known, rename(*sees), rename(*given_up), rename(*admitted))
        });
        (views, self.outages_left, self.cuts_left, rename(self.settled), self.advanced, self.earned, self.broken)
    }
}

/// Key of a message among the 256 that an agent can have sent.
fn sent_key(word: &Part) -> u8 {
    key(word, word.step << 1 | u32::from(word.has_reached(word.step)), word.vouched)
}

/// Key of a message among the 256 that differ for an agent at this step with this vouched step.
fn known_key(word: &Part, step: u32, vouched: u32) -> u8 {
    let past = word.step.max(word.reached.map_or(0, |reached| reached + 1));
    key(word, past.max(step), word.vouched.max(vouched))
}

fn key(word: &Part, past: u32, vouched: u32) -> u8 {
    let MessageOrder { incarnation: Incarnation(life), sequence } = word.order;
    assert!(life < 2 && sequence < 4 && past < 8 && vouched < 4, "too large for a key: {word:?}");
    (life as u8) << 7 | (sequence as u8) << 5 | (past as u8) << 2 | vouched as u8
}

/// Two states are the same to the checker if they differ only in the order of the agents, or in values without effect.
impl<const N: usize> Hash for Swarm<N> {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        let own: [_; N] = std::array::from_fn(|agent| self.own_key(agent));
        let sorting = permutations::<N>().filter(|permutation| permutation.is_sorted_by_key(|&agent| own[agent]));
        sorting.map(|permutation| (permutation.map(|agent| own[agent]), self.key(&permutation))).min().hash(hasher);
    }
}
