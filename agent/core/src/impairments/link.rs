//! One link under the scenario's cuts, as Zenoh presents it to one of its ends. A link is one TCP session:
//!
//! ```text
//!          a direction is dead              one is dead for a lease: both ends close the session
//!   Open ----------------------> Failing --------------------------------------> Closed
//!    ^   healed before the lease:   |                                               |
//!    +----- the newest, late -------+                                               |
//!    +---- healed, and a retry later: the token and the agreement's register -------+
//! ```
//!
//! Until the session is closed, a direction that is alive delivers; after that neither direction does.

use alloc::boxed::Box;
use core::ops::Range;

use skein_common::id::VehicleId;
use skein_common::scenario::Scenario;
use skein_common::time::LocalTime;

use super::cuts::{self, Outage};
use crate::peers::{PeerMessage, Received};

/// The receiver's end of a link.
#[derive(Clone, Debug)]
pub(super) struct LinkEnd {
    peer: VehicleId,
    outages: Box<[Outage]>,
    /// Times without messages from the peer, s after take-off.
    silences: Box<[Range<f64>]>,
    /// The time in which the session does not change, s after take-off.
    unchanged_s: Range<f64>,
    session: Session,
    /// Whether the peer's liveliness token is present, as last reported by the network; `None` before the first report.
    token: Option<bool>,
    /// The token's presence as last reported to the agent.
    reported: Option<bool>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Session {
    Open,
    Failing {
        /// Whether no message from the peer arrives.
        incoming_dead: bool,
    },
    Closed,
}

/// The effect of a change of the session on the messages that the link has held back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SessionChange {
    /// They stay held back.
    Keeps,
    /// No state is retransmitted any more, and the agent learns that the token has vanished if it had seen it.
    Closed { has_vanished: bool },
    /// They are delivered, after the token if its presence has changed.
    CatchesUp { token: Option<bool> },
}

/// An empty time.
pub(super) const NEVER: Range<f64> = 0.0..0.0;

impl LinkEnd {
    /// The end at `own` of the link to `peer`; `None` if no cut ever affects it.
    pub(super) fn new(scenario: &Scenario, own: VehicleId, peer: VehicleId) -> Option<Self> {
        let [incoming, outgoing] =
            [(peer, own), (own, peer)].map(|(from, to)| cuts::silences(&scenario.mission.events, from, to));
        let outages = cuts::outages(scenario.seed, [own, peer], [&incoming, &outgoing]);
        (!outages.is_empty()).then(|| Self {
            peer,
            outages: outages.into(),
            silences: incoming.into(),
            unchanged_s: NEVER,
            session: Session::Open,
            token: None,
            reported: None,
        })
    }

    /// Begins again, with the agent at this end.
    pub(super) fn begin_again(&mut self) {
        (self.unchanged_s, self.session) = (NEVER, Session::Open);
        (self.token, self.reported) = (None, None);
    }

    pub(super) fn peer(&self) -> VehicleId {
        self.peer
    }

    /// Whether no message from the peer arrives now.
    pub(super) fn is_dead(&self) -> bool {
        matches!(self.session, Session::Failing { incoming_dead: true } | Session::Closed)
    }

    /// Whether both ends have closed the session.
    pub(super) fn is_closed(&self) -> bool {
        self.session == Session::Closed
    }

    /// Whether the agent receives the peer's states and heartbeats now.
    pub(super) fn lets_through(&self) -> bool {
        match self.session {
            Session::Open => true,
            // A session does not reopen with one dead direction.
            Session::Failing { incoming_dead } => !incoming_dead && self.reported == Some(true),
            Session::Closed => false,
        }
    }

    /// The time at which the session may change next, s after take-off; infinite if it never does.
    pub(super) fn next_change_s(&self) -> f64 {
        self.unchanged_s.end
    }

    /// Advances to `flown_s` after take-off. `None` if the session does not change.
    pub(super) fn update(&mut self, flown_s: f64) -> Option<SessionChange> {
        if self.unchanged_s.contains(&flown_s) {
            return None;
        }
        self.unchanged_s = flown_s..self.change_after_s(flown_s);
        let session = self.session_at(flown_s);
        if session == self.session {
            return None;
        }
        self.session = session;
        Some(match session {
            Session::Closed => {
                let has_vanished = self.reported == Some(true);
                self.reported = self.reported.map(|_| false);
                SessionChange::Closed { has_vanished }
            }
            // An existing session stays open.
            Session::Open => self.catches_up(),
            Session::Failing { incoming_dead: false } if self.reported == Some(true) => self.catches_up(),
            Session::Failing { .. } => SessionChange::Keeps,
        })
    }

    /// Notes that the peer's token appeared or vanished. Returns whether the agent learns of it now.
    pub(super) fn note_token(&mut self, is_there: bool) -> bool {
        self.token = Some(is_there);
        let is_received = match self.session {
            Session::Open => true,
            Session::Failing { .. } => !is_there && self.lets_through(),
            Session::Closed => false,
        };
        if is_received {
            self.reported = self.token;
        }
        is_received
    }

    fn catches_up(&mut self) -> SessionChange {
        let token = self.token.filter(|_| self.token != self.reported);
        self.reported = token.or(self.reported);
        SessionChange::CatchesUp { token }
    }

    /// The first time after `flown_s` at which the session may change, s after take-off.
    fn change_after_s(&self, flown_s: f64) -> f64 {
        let of_outages = self.outages.iter().flat_map(|outage| {
            let Outage { from_s, closes_s, until_s, back_s } = *outage;
            [from_s, closes_s, until_s, back_s]
        });
        let of_silences = self.silences.iter().flat_map(|silence| [silence.start, silence.end]);
        of_outages.chain(of_silences).filter(|at_s| *at_s > flown_s).fold(f64::INFINITY, f64::min)
    }

    fn session_at(&self, flown_s: f64) -> Session {
        let Some(outage) = self.outages.iter().rfind(|outage| outage.from_s <= flown_s) else { return Session::Open };
        let is_given_up = self.session == Session::Closed || outage.closes_s <= flown_s;
        if is_given_up && flown_s < outage.back_s {
            Session::Closed
        } else if flown_s < outage.until_s {
            Session::Failing { incoming_dead: self.silences.iter().any(|silence| silence.contains(&flown_s)) }
        } else {
            Session::Open
        }
    }
}

/// The receiver's end of a link, with the newest messages that it has held back.
#[derive(Clone, Debug)]
pub(super) struct Link {
    end: LinkEnd,
    /// The newest state: TCP retransmits it while the session lasts.
    state: Option<Received>,
    /// The newest heartbeat: the peer keeps it for late joiners.
    mission: Option<Received>,
}

impl Link {
    /// The link of this end, before any message.
    pub(super) fn new(end: LinkEnd) -> Self {
        Self { end, state: None, mission: None }
    }

    pub(super) fn peer(&self) -> VehicleId {
        self.end.peer()
    }

    /// Whether no message from the peer arrives now.
    pub(super) fn is_dead(&self) -> bool {
        self.end.is_dead()
    }

    /// Advances to `flown_s` after take-off; calls `deliver` with the messages that the change of the session delivers.
    pub(super) fn update(&mut self, flown_s: f64, now: LocalTime, mut deliver: impl FnMut(Received)) {
        let mut deliver_token = |message| deliver(Received { message, at: now });
        match self.end.update(flown_s) {
            None | Some(SessionChange::Keeps) => {}
            Some(SessionChange::Closed { has_vanished }) => {
                self.state = None;
                has_vanished.then(|| deliver_token(PeerMessage::Vanished(self.peer())));
            }
            Some(SessionChange::CatchesUp { token }) => {
                let peer = self.peer();
                let message = |there| if there { PeerMessage::Appeared(peer) } else { PeerMessage::Vanished(peer) };
                token.map(message).into_iter().for_each(deliver_token);
                self.state.take().into_iter().chain(self.mission.take()).for_each(deliver);
            }
        }
    }

    /// Whether the agent receives this message now. A message that is held back may be delivered later.
    pub(super) fn lets_through(&mut self, received: &Received) -> bool {
        match &received.message {
            PeerMessage::Appeared(_) => self.end.note_token(true),
            PeerMessage::Vanished(_) => {
                // Messages of a vehicle that has gone are dropped.
                (self.state, self.mission) = (None, None);
                self.end.note_token(false)
            }
            _ if self.end.lets_through() => true,
            PeerMessage::State(_) => {
                self.state = Some(*received).filter(|_| !self.end.is_closed());
                false
            }
            PeerMessage::Mission(_) => {
                self.mission = Some(*received);
                false
            }
            PeerMessage::Order(_) => false,
        }
    }
}
