//! One honest agent: its own agreement, the very code that flies, and what it has received.
//!
//! As in the peers stage, an agent keeps the newest message of every other, and what it receives that is not newer changes nothing.
//! Here the number of a message grows only when its sender's membership changes: between two such changes the one that says more
//! is the newer, because nothing of a record goes back in one life, which is checked.

use skein_common::id::Incarnation;
use skein_common::message::MessageOrder;
use skein_common::state::Membership;
use skein_core::mission::agreement::{Agreement, AgreementState, OtherStates, Progress};

use super::swarm::Bounds;

/// Agents by index, one bit each; the liar's is that after the last.
pub(super) type Bits = u8;

/// A message with an agent's record.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct PeerMessage {
    pub(super) order: MessageOrder,
    pub(super) part: AgreementState,
}

impl PeerMessage {
    fn is_newer_than(&self, other: &Self) -> bool {
        let age = |message: &Self| (message.order, message.part.step, message.part.vouched, message.part.reached);
        age(self) > age(other)
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Agent {
    pub(super) agreement: Agreement,
    pub(super) incarnation: u64,
    /// How often its membership has changed in this life.
    pub(super) sequence: u64,
    pub(super) is_up: bool,
    /// Every word that it ever said.
    pub(super) said: Vec<PeerMessage>,
    /// The newest that it has received of each, the liar included.
    pub(super) known: Vec<Option<PeerMessage>>,
    /// Who it takes to be there.
    pub(super) sees: Bits,
    /// Those that it does not see and takes to be flying no longer.
    pub(super) given_up: Bits,
    pub(super) admitted: Bits,
    /// In this life it has followed the liar, which it saw alone, to a step that no honest agent had earned.
    pub(super) is_misled: bool,
}

pub(super) fn others<const N: usize>(agent: usize) -> impl Iterator<Item = usize> {
    (0..N).filter(move |&other| other != agent)
}

pub(super) fn has(bits: Bits, agent: usize) -> bool {
    bits & 1 << agent != 0
}

impl Agent {
    /// At the beginning of a life.
    pub(super) fn new<const N: usize>(bounds: &Bounds<N>, incarnation: u64) -> Self {
        Self {
            agreement: Agreement::new(bounds.vehicles() as u8, bounds.last_step, bounds.partition),
            incarnation,
            sequence: 0,
            is_up: true,
            said: Vec::new(),
            known: vec![None; N + 1],
            sees: 0,
            given_up: 0,
            admitted: 0,
            is_misled: false,
        }
    }

    pub(super) fn message(&self) -> PeerMessage {
        let order = MessageOrder { incarnation: Incarnation(self.incarnation), sequence: self.sequence };
        PeerMessage { order, part: self.agreement.own() }
    }

    pub(super) fn is_active(&self) -> bool {
        self.is_up && self.agreement.own().is_active()
    }

    /// Takes part from now on, or no longer.
    pub(super) fn set_membership(&mut self, membership: Membership) {
        self.agreement.set_membership(membership);
        self.sequence += 1;
    }

    pub(super) fn say(&mut self) {
        let message = self.message();
        if self.said.last() != Some(&message) {
            self.said.push(message);
        }
    }

    pub(super) fn receive(&mut self, from: usize, message: PeerMessage) {
        if self.is_news(from, &message) {
            self.known[from] = Some(message);
        }
    }

    /// Whether a word is newer than all that it has received of this one.
    pub(super) fn is_news(&self, from: usize, message: &PeerMessage) -> bool {
        self.known[from].is_none_or(|known| message.is_newer_than(&known))
    }

    /// What it knows as agent `own` of `N` that are honest. A liar that is not heard may have left: it is not missed.
    fn others<const N: usize>(&self, own: usize) -> OtherStates<impl Iterator<Item = AgreementState> + Clone> {
        let seen = self.known.iter().enumerate().filter(|(other, _)| has(self.sees, *other));
        let states = seen.filter_map(|(_, known)| known.map(|message| message.part));
        OtherStates { states, absent_may_fly: others::<N>(own).any(|other| !has(self.sees | self.given_up, other)) }
    }

    /// Sees these from now on.
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

    /// Whether two that it sees vouch for a step that it has not come to.
    pub(super) fn is_behind<const N: usize>(&self) -> bool {
        let step = self.agreement.own().step;
        let honest = self.known.iter().take(N).enumerate().filter(|(other, _)| has(self.sees, *other));
        honest.filter(|(_, known)| known.is_some_and(|message| message.part.vouched > step)).count() >= 2
    }

    /// Whether it has said this since it became active, and is.
    pub(super) fn is_latest(&self, message: &PeerMessage) -> bool {
        self.is_active() && message.order == self.message().order
    }
}

/// One of the 256 words that an agent can have said.
pub(super) fn said_key(message: &PeerMessage) -> u8 {
    let part = &message.part;
    key(message, part.step << 1 | u32::from(part.has_reached(part.step)), part.vouched)
}

/// One of the 256 words that differ in what matters to an agent whose own part is this.
pub(super) fn known_key(message: &PeerMessage, own: &AgreementState) -> u8 {
    let part = &message.part;
    let past = part.step.max(part.reached.map_or(0, |reached| reached + 1));
    key(message, past.max(own.step), part.vouched.max(own.vouched))
}

fn key(message: &PeerMessage, past: u32, vouched: u32) -> u8 {
    let MessageOrder { incarnation: Incarnation(life), sequence } = message.order;
    assert!(life < 2 && sequence < 4 && past < 8 && vouched < 4, "too large for a key: {message:?}");
    (life as u8) << 7 | (sequence as u8) << 5 | (past as u8) << 2 | vouched as u8
}
