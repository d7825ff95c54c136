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

use alloc::vec::Vec;
use core::ops::Range;

use skein_common::id::VehicleId;
use skein_common::scenario::Scenario;
use skein_common::time::LocalTime;

use super::cuts::{self, Outage};
use crate::peers::{PeerMessage, Received};

/// The receiver's end of a link.
#[derive(Clone, Debug)]
pub(super) struct Link {
    peer: VehicleId,
    outages: Vec<Outage>,
    /// Times without messages from the peer, s after take-off.
    silences: Vec<Range<f64>>,
    session: Session,
    /// Whether the peer's liveliness token is present, as last reported by the network; `None` before the first report.
    token: Option<bool>,
    /// The token's presence as last reported to the agent.
    reported: Option<bool>,
    held: Held,
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

/// The newest messages that were not delivered.
#[derive(Clone, Copy, Debug, Default)]
struct Held {
    /// The newest state: TCP retransmits it while the session lasts.
    state: Option<Received>,
    /// The newest heartbeat: the peer keeps it for late joiners.
    mission: Option<Received>,
}

impl Link {
    /// The end at `own` of the link to `peer`; `None` if no cut ever affects it.
    pub(super) fn new(scenario: &Scenario, own: VehicleId, peer: VehicleId) -> Option<Self> {
        let outages = cuts::outages(scenario, own, peer);
        let silences = cuts::silences(&scenario.mission.events, peer, own);
        let (token, reported, held) = (None, None, Held::default());
        (!outages.is_empty()).then_some(Self { peer, outages, silences, session: Session::Open, token, reported, held })
    }

    pub(super) fn peer(&self) -> VehicleId {
        self.peer
    }

    /// Whether no message from the peer arrives now.
    pub(super) fn is_dead(&self) -> bool {
        matches!(self.session, Session::Failing { incoming_dead: true } | Session::Closed)
    }

    /// Whether no event affects a message from the peer now.
    pub(super) fn is_open(&self) -> bool {
        self.session == Session::Open
    }

    /// Whether both ends have closed the session.
    pub(super) fn is_closed(&self) -> bool {
        self.session == Session::Closed
    }

    /// The next time after `flown_s` at which the session may change, s after take-off; infinite if it never does.
    pub(super) fn next_change_s(&self, flown_s: f64) -> f64 {
        let of_outages = self.outages.iter().flat_map(|outage| {
            let Outage { from_s, closes_s, until_s, back_s } = *outage;
            [from_s, closes_s, until_s, back_s]
        });
        let of_silences = self.silences.iter().flat_map(|silence| [silence.start, silence.end]);
        of_outages.chain(of_silences).filter(|at_s| *at_s > flown_s).fold(f64::INFINITY, f64::min)
    }

    /// Advances to `flown_s` after take-off; calls `deliver` with the messages that the change of the session delivers.
    pub(super) fn update(&mut self, flown_s: f64, now: LocalTime, mut deliver: impl FnMut(Received)) {
        let session = self.session_at(flown_s);
        if session == self.session {
            return;
        }
        self.session = session;
        match session {
            Session::Closed => {
                self.held.state = None;
                if self.reported == Some(true) {
                    self.reported = Some(false);
                    deliver(Received { message: PeerMessage::Vanished(self.peer), at: now });
                }
            }
            Session::Open => self.catch_up(now, deliver),
            // An existing session stays open.
            Session::Failing { incoming_dead: false } if self.reported == Some(true) => self.catch_up(now, deliver),
            Session::Failing { .. } => {}
        }
    }

    /// Whether the agent receives this message now. A message that is held back may be delivered later.
    pub(super) fn lets_through(&mut self, received: &Received) -> bool {
        let message = &received.message;
        match message {
            PeerMessage::Appeared(_) => self.token = Some(true),
            // Messages of a vehicle that has gone are dropped.
            PeerMessage::Vanished(_) => (self.token, self.held) = (Some(false), Held::default()),
            PeerMessage::State(_) | PeerMessage::Mission(_) | PeerMessage::Order(_) => {}
        }
        let is_received = match self.session {
            Session::Open => true,
            // A session does not reopen with one dead direction.
            Session::Failing { incoming_dead } => {
                !incoming_dead && self.reported == Some(true) && !matches!(message, PeerMessage::Appeared(_))
            }
            Session::Closed => false,
        };
        match message {
            PeerMessage::Appeared(_) | PeerMessage::Vanished(_) if is_received => self.reported = self.token,
            PeerMessage::State(_) if !is_received && self.session != Session::Closed => {
                self.held.state = Some(*received)
            }
            PeerMessage::Mission(_) if !is_received => self.held.mission = Some(*received),
            _ => {}
        }
        is_received
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

    /// Delivers the held messages.
    fn catch_up(&mut self, now: LocalTime, mut deliver: impl FnMut(Received)) {
        if let Some(is_there) = self.token.filter(|_| self.token != self.reported) {
            self.reported = self.token;
            let message = if is_there { PeerMessage::Appeared(self.peer) } else { PeerMessage::Vanished(self.peer) };
            deliver(Received { message, at: now });
        }
        let Held { state, mission } = core::mem::take(&mut self.held);
        state.into_iter().chain(mission).for_each(deliver);
    }
}
