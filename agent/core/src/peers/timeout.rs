//! The time for which a peer may be silent before it counts as lost.
//!
//! Agents send several messages a second. Over a link that loses no messages, a silence of half of T_stale means that the peer hangs
//! or is cut off. Over a link that loses messages, a silence may last T_stale. Gaps in the numbers of the heartbeats show that a link
//! loses messages. A peer that has just appeared may also be silent for T_stale, because a whole swarm is starting then.
//!
//! When this computer is the slow one, a peer must not be suspected. Time in which the own agent did not run is not
//! counted, and after it every silence may last twice T_stale. A peer that was suspected and is back soon shows overload too:
//! then a silence may last T_stale over every link, and after another such sign twice as long. After ten seconds without a
//! sign the load is taken to be one step lower.

use skein_common::time::LocalTime;

use crate::deadlines::Deadline;

/// The duration of silence after which peers are lost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct SilenceTimeout {
    stale_s: f64,
    load: Load,
    /// The time at which a sign of overload was last seen, or the load was last taken to be lower.
    calm_since: LocalTime,
}

/// The load of this computer, by the signs of overload, and how long peers may be silent under it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
enum Load {
    /// The computer keeps up: half of T_stale over a link that loses nothing, T_stale over another.
    #[default]
    Low,
    /// T_stale over every link.
    Raised,
    /// Twice T_stale.
    High,
}

impl SilenceTimeout {
    /// The timeouts on a computer that keeps up, with this T_stale, s.
    pub(super) fn new(stale_s: f64) -> Self {
        Self { stale_s, ..Self::default() }
    }

    /// The time for which a peer may send no state without leaving the formation, s.
    pub(super) fn without_state_s(&self) -> f64 {
        if self.load == Load::High { 2.0 * self.stale_s } else { self.stale_s }
    }

    /// The time for which a peer may send nothing, s. `loses_nothing` is whether its link does.
    pub(super) fn silent_s(&self, loses_nothing: bool) -> f64 {
        match self.load {
            Load::Low if loses_nothing => 0.5 * self.stale_s,
            Load::Low | Load::Raised => self.stale_s,
            Load::High => 2.0 * self.stale_s,
        }
    }

    /// Takes a sign of overload: a peer was back soon after it had been suspected, `at` this time.
    pub(super) fn suspected_too_early(&mut self, at: LocalTime) {
        self.load = if self.load == Load::Low { Load::Raised } else { Load::High };
        self.calm_since = at;
    }

    /// Whether a peer is back so soon after its loss that it was suspected too early.
    pub(super) fn is_soon(&self, since_lost_s: f64) -> bool {
        since_lost_s <= self.stale_s
    }

    /// Takes the other sign of overload: the own agent did not run, until this time.
    pub(super) fn was_late(&mut self, until: LocalTime) {
        (self.load, self.calm_since) = (Load::High, until);
    }

    /// Takes the load to be lower once no sign of overload has been seen for long. Returns whether timeouts are shorter from now on.
    pub(super) fn pass(&mut self, now: LocalTime) -> bool {
        let is_over = self.load > Load::Low && Deadline::OverloadOver.is_past(now.seconds_since(self.calm_since));
        if is_over {
            self.load = if self.load == Load::High { Load::Raised } else { Load::Low };
            self.calm_since = now;
        }
        is_over
    }
}
