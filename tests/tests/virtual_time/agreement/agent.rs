//! One honest agent: its agreement, which is the code that flies, and the messages that it has received.
//!
//! As in the peers stage, an agent keeps the newest message of every other agent. A message that is not newer changes
//! nothing. Here the number of a message grows only when its sender's membership changes. Between two such changes the
//! message with the larger values is the newer one, because no value of the agreement state decreases in one
//! incarnation; this is checked too.

use skein_common::id::Incarnation;
use skein_common::message::MessageOrder;
use skein_common::state::Membership;
use skein_core::mission::agreement::{Agreement, AgreementState, OtherStates, Progress};

use super::swarm::Bounds;

/// Set of agents: one bit for each index; the bit after the last honest agent is the liar's.
pub(super) type Bits = u8;

/// A message with an agent's agreement state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct PeerMessage {
    pub(super) order: MessageOrder,
    pub(super) state: AgreementState,
}

impl PeerMessage {
    fn is_newer_than(&self, other: &Self) -> bool {
        let age = |message: &Self| (message.order, message.state.step, message.state.vouched, message.state.reached);
        age(self) > age(other)
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Agent {
    pub(super) agreement: Agreement,
    pub(super) incarnation: u64,
    /// Number of changes of its membership in this incarnation.
    pub(super) sequence: u64,
    pub(super) is_up: bool,
    /// Every message that it ever sent.
    pub(super) sent: Vec<PeerMessage>,
    /// Newest message that it received from each agent, the liar included.
    pub(super) known: Vec<Option<PeerMessage>>,
    /// Agents that it takes to be in contact.
    pub(super) sees: Bits,
    /// Agents out of contact that it takes to have stopped flying.
    pub(super) given_up: Bits,
    /// Agents that it admitted; the docs of [`super::swarm`] define it.
    pub(super) admitted: Bits,
    /// Whether in this incarnation, with only the liar in contact, it followed the liar to a step that no honest agent
    /// had earned.
    pub(super) is_misled: bool,
}

pub(super) fn others<const N: usize>(agent: usize) -> impl Iterator<Item = usize> {
    (0..N).filter(move |&other| other != agent)
}

pub(super) fn has(bits: Bits, agent: usize) -> bool {
    bits & 1 << agent != 0
}

impl Agent {
    /// An agent at the start of an incarnation.
    pub(super) fn new<const N: usize>(bounds: &Bounds<N>, incarnation: u64) -> Self {
        Self {
            agreement: Agreement::new(bounds.vehicles() as u8, bounds.last_step, bounds.partition),
            incarnation,
            sequence: 0,
            is_up: true,
            sent: Vec::new(),
            known: vec![None; N + 1],
            sees: 0,
            given_up: 0,
            admitted: 0,
            is_misled: false,
        }
    }

    pub(super) fn message(&self) -> PeerMessage {
        let order = MessageOrder { incarnation: Incarnation(self.incarnation), sequence: self.sequence };
        PeerMessage { order, state: self.agreement.own() }
    }

    pub(super) fn is_active(&self) -> bool {
        self.is_up && self.agreement.own().is_active()
    }

    /// Makes the agent an active member, or ends that.
    pub(super) fn set_membership(&mut self, membership: Membership) {
        self.agreement.set_membership(membership);
        self.sequence += 1;
    }

    pub(super) fn publish(&mut self) {
        let message = self.message();
        if self.sent.last() != Some(&message) {
            self.sent.push(message);
        }
    }

    pub(super) fn receive(&mut self, from: usize, message: PeerMessage) {
        if self.is_news(from, &message) {
            self.known[from] = Some(message);
        }
    }

    /// Whether a message is newer than every message that it received from this sender.
    pub(super) fn is_news(&self, from: usize, message: &PeerMessage) -> bool {
        self.known[from].is_none_or(|known| message.is_newer_than(&known))
    }

    /// The states that agent `own` of `N` honest agents knows of the others. A silent liar may have left: it does not
    /// count as an absent vehicle that may fly.
    fn others<const N: usize>(&self, own: usize) -> OtherStates<impl Iterator<Item = AgreementState> + Clone> {
        let seen = self.known.iter().enumerate().filter(|(other, _)| has(self.sees, *other));
        let states = seen.filter_map(|(_, known)| known.map(|message| message.state));
        OtherStates { states, absent_may_fly: others::<N>(own).any(|other| !has(self.sees | self.given_up, other)) }
    }

    /// Sets the agents in contact.
    pub(super) fn see<const N: usize>(&mut self, own: usize, sees: Bits) -> Option<Progress> {
        self.sees = sees;
        self.given_up &= !sees;
        let mut agreement = self.agreement.clone();
        let progress = agreement.follow(&self.others::<N>(own));
        self.agreement = agreement;
        progress
    }

    pub(super) fn advance<const N: usize>(&mut self, own: usize) -> Option<Progress> {
        let mut agreement = self.agreement.clone();
        let progress = agreement.advance(&self.others::<N>(own));
        self.agreement = agreement;
        progress
    }

    /// Whether two agents in contact vouch for a step that it has not entered.
    pub(super) fn is_behind<const N: usize>(&self) -> bool {
        let step = self.agreement.own().step;
        let honest = self.known.iter().take(N).enumerate().filter(|(other, _)| has(self.sees, *other));
        honest.filter(|(_, known)| known.is_some_and(|message| message.state.vouched > step)).count() >= 2
    }

    /// Whether it is active, and sent this message since it became active.
    pub(super) fn is_latest(&self, message: &PeerMessage) -> bool {
        self.is_active() && message.order == self.message().order
    }
}

/// Key of a message among the 256 that an agent can have sent.
pub(super) fn sent_key(message: &PeerMessage) -> u8 {
    let state = &message.state;
    key(message, state.step << 1 | u32::from(state.has_reached(state.step)), state.vouched)
}

/// Key of a received message among the 256 that an agent with the state `own` distinguishes.
pub(super) fn known_key(message: &PeerMessage, own: &AgreementState) -> u8 {
    let state = &message.state;
    let past = state.step.max(state.reached.map_or(0, |reached| reached + 1));
    key(message, past.max(own.step), state.vouched.max(own.vouched))
}

fn key(message: &PeerMessage, past: u32, vouched: u32) -> u8 {
    let MessageOrder { incarnation: Incarnation(incarnation), sequence } = message.order;
    assert!(incarnation < 2 && sequence < 4 && past < 8 && vouched < 4, "too large for a key: {message:?}");
    (incarnation as u8) << 7 | (sequence as u8) << 5 | (past as u8) << 2 | vouched as u8
}
