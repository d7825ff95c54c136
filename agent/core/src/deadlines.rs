//! Every deadline of the core: the events that occur because time has passed, and their effects.
//!
//! | deadline | counted from | after | by | effect |
//! | --- | --- | --- | --- | --- |
//! | `OwnDataStale` | last measurement | 0.1 s | local clock | controls neutral, no state sent |
//! | `SimulatorLost` | last measurement | 2 s | local clock | no controls; the vehicle rejoins later |
//! | `ClockJumped` | last step | 10 s | local clock | the elapsed time is not counted |
//! | `StateOld` | peer's state sent | 0.5 s | local clock | the peer is stale |
//! | `NeighbourSilent` | peer's state received | `network.peer_stale_s`, or twice of it | local clock | the peer leaves the formation |
//! | `PeerLost` | any message of a peer received | half of `network.peer_stale_s` to twice of it | local clock | the swarm does not wait for the peer |
//! | `ObstacleGone` | peer lost | 10 s | local clock | the peer stops being an obstacle |
//! | `PeerGivenUp` | peer lost, or own start | 60 s | local clock | the peer counts as out of the mission |
//! | `LinkProven` | peer found, or a heartbeat of it lost | 10 s | local clock | the peer's link counts as one that loses nothing |
//! | `OverloadOver` | sign of overload | 10 s | local clock | the peers may be silent for half as long |
//! | `RoundTripOld` | echo received | 60 s | local clock | the round trip bounds no delay |
//! | `Listened` | first measurement | 2 s | local clock | the vehicle becomes an active member |
//! | `AltitudeStuck` | no collective left | 20 s | plant time | the vehicle lands |
//! | `NoProgress` | last time nearer to the step | `mission.progress_timeout_s` | plant time | the vehicle lands |
//! | `HoldOver` | begin of the step | `hold_s` of the step | plant time | the vehicle has completed the step |
//! | `Dwelt` | arrival in place | `dwell_s` of the step | plant time | the vehicle has completed the step |
//! | `TouchedDown` | rest near the ground | 1 s | plant time | the rotor is unloaded |
//! | `Unloaded` | touchdown | 2 s | plant time | the vehicle has landed |
//! | `SettingBegins` | setting received | 2 s | plant time | it takes effect although a member has not repeated it |
//! | `HeartbeatDue` | last heartbeat | 0.2 s | local clock | the next heartbeat is sent |
//! | `StateDue` | last state sent | `network.state_max_period_s` | local clock | the next state is sent |
//!
//! A vehicle on the ground that has listened before and has not lost all peers, as after a restart of its simulator, does
//! not wait for [`Deadline::Listened`]: its agent has received its peers all the time.
//!
//! Deadlines do not wake the vehicle: a step notices those that have passed since the last step. The external law's
//! limit is counted, not timed: the agent queries the law every `formation.external.period_s` of plant time and drops
//! it after `formation.external.misses` queries in a row without a reply ([`crate::formation::external`]).

/// The period of the heartbeat that carries the agreement state, s.
pub const HEARTBEAT_PERIOD_S: f64 = 0.2;
/// Share by which a message period is shortened. Otherwise a slow clock (a quartz may be off by 100 ppm) would make the
/// period a frame longer.
const EARLY: f64 = 2e-4;

/// An event that occurs because time has passed and nothing else has happened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Deadline {
    /// Five frames at 50 Hz passed without a measurement.
    OwnDataStale,
    /// The simulator sends no measurements.
    SimulatorLost,
    /// A step was longer than any agent needs: everything the agent knows is outdated.
    ClockJumped,
    /// A peer's newest state is stale.
    StateOld,
    /// A peer has sent no state for the given time, s: `network.peer_stale_s`, or twice of it on an overloaded computer.
    NeighbourSilent(f64),
    /// A peer has sent no message for the given time, s, which follows from `network.peer_stale_s`, from the peer's link and
    /// from the load of this computer.
    PeerLost(f64),
    /// A lost peer has flown away and stops being an obstacle.
    ObstacleGone,
    /// A lost member counts as out of the mission, and a vehicle that was never in contact counts as absent. From then
    /// on a vehicle that has lost all peers counts itself as the only one left, and one with a single peer counts the
    /// two as all.
    PeerGivenUp,
    /// No heartbeat of a peer was lost for so long that its link counts as one that loses nothing.
    LinkProven,
    /// No sign of overload was seen for so long that peers may be silent for half as long as before.
    OverloadOver,
    /// A round trip is too old to bound a delay, because clocks drift.
    RoundTripOld,
    /// The vehicle has listened to its peers and becomes an active member. A vehicle on the ground that has listened
    /// before and has not lost all peers does not wait for it.
    Listened,
    /// A vehicle off its altitude has come no nearer with the collective at its limit. With collective left the
    /// controller is still correcting.
    AltitudeStuck,
    /// A vehicle has come no nearer to its step for `mission.progress_timeout_s`, the given time, s.
    NoProgress(f64),
    /// A hold has lasted for the given time, s.
    HoldOver(f64),
    /// The vehicle has been in place for the given time without interruption, s.
    Dwelt(f64),
    /// The vehicle near the ground has not sunk despite the command to descend.
    TouchedDown,
    /// The collective has been at its lowest long enough.
    Unloaded,
    /// A setting takes effect even though a member in contact has not repeated it.
    SettingBegins,
    /// The next heartbeat is due, whether the agreement state changed or not.
    HeartbeatDue,
    /// The next state is due, whether the peers need it or not; the given longest period, s.
    StateDue(f64),
}

impl Deadline {
    /// Time from the deadline's start to the deadline, s.
    #[inline]
    pub const fn after_s(self) -> f64 {
        match self {
            Self::OwnDataStale => 0.1,
            Self::SimulatorLost => 2.0,
            Self::ClockJumped => 10.0,
            Self::StateOld => 0.5,
            Self::NeighbourSilent(stale_s) | Self::PeerLost(stale_s) => stale_s,
            Self::ObstacleGone => 10.0,
            Self::PeerGivenUp => 60.0,
            Self::LinkProven | Self::OverloadOver => 10.0,
            Self::RoundTripOld => 60.0,
            Self::Listened => 2.0,
            Self::AltitudeStuck => 20.0,
            Self::NoProgress(timeout_s) => timeout_s,
            Self::HoldOver(hold_s) => hold_s,
            Self::Dwelt(dwell_s) => dwell_s,
            Self::TouchedDown => 1.0,
            Self::Unloaded | Self::SettingBegins => 2.0,
            Self::HeartbeatDue => HEARTBEAT_PERIOD_S * (1.0 - EARLY),
            Self::StateDue(period_s) => period_s * (1.0 - EARLY),
        }
    }

    /// Whether the deadline has passed, for this time since its start, s. A required duration is complete at exactly
    /// that instant; a tolerated age is still tolerated at that instant.
    #[inline]
    pub fn is_past(self, since_s: f64) -> bool {
        let is_complete_at_once = matches!(
            self,
            Self::PeerGivenUp
                | Self::Listened
                | Self::HoldOver(_)
                | Self::Dwelt(_)
                | Self::HeartbeatDue
                | Self::StateDue(_)
        );
        if is_complete_at_once { since_s >= self.after_s() } else { since_s > self.after_s() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_its_exact_instant_a_duration_is_complete_and_an_age_still_tolerated() {
        assert!(
            Deadline::Listened.is_past(2.0) && Deadline::Dwelt(3.0).is_past(3.0) && Deadline::PeerGivenUp.is_past(60.0)
        );
        assert!(!Deadline::OwnDataStale.is_past(0.1) && Deadline::OwnDataStale.is_past(0.101));
        assert!(!Deadline::PeerLost(2.0).is_past(2.0) && Deadline::PeerLost(2.0).is_past(2.001));
    }

    #[test]
    fn a_slow_clock_does_not_lengthen_a_message_period_by_a_frame() {
        assert!(Deadline::HeartbeatDue.is_past(0.2 - 0.2 * 1e-4) && !Deadline::HeartbeatDue.is_past(0.18));
        assert!(Deadline::StateDue(1.0).is_past(1.0 - 1e-4) && !Deadline::StateDue(1.0).is_past(0.98));
    }
}
