//! One link under the scenario's cuts, as Zenoh shows it to one of its ends. A link is one TCP session:
//!
//! ```text
//!          a direction is dead              one is dead for a lease: both ends close the session
//!   Open ----------------------> Failing --------------------------------------> Closed
//!    ^   whole before the lease:    |                                               |
//!    +----- the newest, late -------+                                               |
//!    +---- whole, and a retry later: the token and the agreement's register --------+
//! ```
//!
//! Until the session is closed a direction that is alive delivers; after that none does.

use alloc::vec::Vec;
use core::ops::Range;

use skein_common::id::VehicleId;
use skein_common::scenario::Scenario;
use skein_common::time::LocalTime;

use super::cuts::{self, Outage};
use crate::peers::{Heard, Word};

/// The hearing end of a link.
#[derive(Clone, Debug)]
pub(super) struct Link {
    peer: VehicleId,
    outages: Vec<Outage>,
    /// When nothing comes from the peer, s after take-off.
    silences: Vec<Range<f64>>,
    session: Session,
    /// Whether the peer's token is there, as far as anybody said.
    token: Option<bool>,
    /// What the agent was told of it.
    told: Option<bool>,
    held: Held,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Session {
    Open,
    Failing {
        /// Nothing comes from the peer.
        deaf: bool,
    },
    Closed,
}

/// The newest words that have not got through.
#[derive(Clone, Copy, Debug, Default)]
struct Held {
    /// TCP sends it again while the session lasts.
    state: Option<Heard>,
    /// The peer keeps it for whoever comes late.
    mission: Option<Heard>,
}

impl Link {
    /// The end at `own` of the link to `peer`; `None` if it is never cut.
    pub(super) fn new(scenario: &Scenario, own: VehicleId, peer: VehicleId) -> Option<Self> {
        let outages = cuts::outages(scenario, own, peer);
        let silences = cuts::silences(&scenario.mission.events, peer, own);
        let (token, told, held) = (None, None, Held::default());
        (!outages.is_empty()).then_some(Self { peer, outages, silences, session: Session::Open, token, told, held })
    }

    pub(super) fn peer(&self) -> VehicleId {
        self.peer
    }

    /// Whether nothing comes from the peer now.
    pub(super) fn is_dead(&self) -> bool {
        matches!(self.session, Session::Failing { deaf: true } | Session::Closed)
    }

    /// Time goes on to `flown_s` after take-off; `hear` is called with what that alone brings, as it was said first.
    pub(super) fn update(&mut self, flown_s: f64, now: LocalTime, mut hear: impl FnMut(Heard)) {
        let session = self.session_at(flown_s);
        if session == self.session {
            return;
        }
        self.session = session;
        match session {
            Session::Closed => {
                self.held.state = None;
                if self.told == Some(true) {
                    self.told = Some(false);
                    hear(Heard { word: Word::Vanished(self.peer), at: now });
                }
            }
            Session::Open => self.catch_up(now, hear),
            // A session that was there is there.
            Session::Failing { deaf: false } if self.told == Some(true) => self.catch_up(now, hear),
            Session::Failing { .. } => {}
        }
    }

    /// Whether the agent hears this word now. What it does not may come back later.
    pub(super) fn carries(&mut self, heard: &Heard) -> bool {
        let word = &heard.word;
        match word {
            Word::Appeared(_) => self.token = Some(true),
            // Nothing is kept of who is gone.
            Word::Vanished(_) => (self.token, self.held) = (Some(false), Held::default()),
            Word::State(_) | Word::Mission(_) | Word::Order(_) => {}
        }
        let is_heard = match self.session {
            Session::Open => true,
            // Over half a link nobody opens a session anew.
            Session::Failing { deaf } => !deaf && self.told == Some(true) && !matches!(word, Word::Appeared(_)),
            Session::Closed => false,
        };
        match word {
            Word::Appeared(_) | Word::Vanished(_) if is_heard => self.told = self.token,
            Word::State(_) if !is_heard && self.session != Session::Closed => self.held.state = Some(*heard),
            Word::Mission(_) if !is_heard => self.held.mission = Some(*heard),
            _ => {}
        }
        is_heard
    }

    fn session_at(&self, flown_s: f64) -> Session {
        let Some(outage) = self.outages.iter().rfind(|outage| outage.from_s <= flown_s) else { return Session::Open };
        let is_given_up = self.session == Session::Closed || outage.closes_s <= flown_s;
        if is_given_up && flown_s < outage.back_s {
            Session::Closed
        } else if flown_s < outage.until_s {
            Session::Failing { deaf: self.silences.iter().any(|silence| silence.contains(&flown_s)) }
        } else {
            Session::Open
        }
    }

    /// Tells what was missed.
    fn catch_up(&mut self, now: LocalTime, mut hear: impl FnMut(Heard)) {
        if let Some(is_there) = self.token.filter(|_| self.token != self.told) {
            self.told = self.token;
            let word = if is_there { Word::Appeared(self.peer) } else { Word::Vanished(self.peer) };
            hear(Heard { word, at: now });
        }
        let Held { state, mission } = core::mem::take(&mut self.held);
        state.into_iter().chain(mission).for_each(hear);
    }
}
