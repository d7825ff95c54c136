//! What time alone changes: every deadline of the core, with the reason why it wakes the vehicle.
//!
//! | what ends | since | after | by | then |
//! | --- | --- | --- | --- | --- |
//! | [`OwnDataStale`](Deadline::OwnDataStale) | last measurement | 0.1 s | local clock | controls neutral, no state sent |
//! | [`SimulatorLost`](Deadline::SimulatorLost) | last measurement | 2 s | local clock | no controls, the vehicle joins anew |
//! | [`ClockJumped`](Deadline::ClockJumped) | last step | 10 s | local clock | that time never passed |
//! | [`StateOld`](Deadline::StateOld) | peer's state sent | 0.5 s | local clock | its standing is stale |
//! | [`NeighbourSilent`](Deadline::NeighbourSilent) | peer's state received | `network.peer_stale_s` | local clock | it leaves the formation |
//! | [`PeerLost`](Deadline::PeerLost) | any message of a peer received | `network.peer_stale_s` | local clock | no vehicle waits for it |
//! | [`ObstacleGone`](Deadline::ObstacleGone) | peer lost | 10 s | local clock | it stops being an obstacle |
//! | [`PeerGivenUp`](Deadline::PeerGivenUp) | peer lost, or own begin | 60 s | local clock | it flies the mission no longer |
//! | [`LeniencyOver`](Deadline::LeniencyOver) | own agent late | 10 s | local clock | peers may be silent no longer than usual |
//! | [`RoundTripOld`](Deadline::RoundTripOld) | echo received | 60 s | local clock | it bounds no delay any more |
//! | [`Listened`](Deadline::Listened) | first measurement | 2 s | local clock | the vehicle becomes an active member |
//! | [`AltitudeStuck`](Deadline::AltitudeStuck) | no collective left | 20 s | plant time | the vehicle lands |
//! | [`HoldOver`](Deadline::HoldOver) | step begun | `hold_s` of the step | plant time | the vehicle has reached the step |
//! | [`Dwelt`](Deadline::Dwelt) | in place | `dwell_s` of the step | plant time | the vehicle has reached the step |
//! | [`TouchedDown`](Deadline::TouchedDown) | at rest near the ground | 1 s | plant time | the rotor is unloaded |
//! | [`Unloaded`](Deadline::Unloaded) | touchdown | 2 s | plant time | the vehicle has landed |
//! | [`HeartbeatDue`](Deadline::HeartbeatDue) | last heartbeat | 0.2 s | local clock | the next one is sent |
//! | [`StateDue`](Deadline::StateDue) | last state sent | `network.state_max_period_s` | local clock | the next one is sent |
//!
//! Nothing wakes the vehicle between two steps: a deadline that has passed is noticed in the next step. An external law is asked
//! every `formation.external.period_s` of plant time and is lost after `formation.external.misses` asks in a row without an answer
//! ([`crate::formation::external`]): that is counted, not timed.

/// The period of the heartbeat that carries the agreement state, s.
pub const HEARTBEAT_PERIOD_S: f64 = 0.2;
/// A period of messages ends this share of it early, so that a clock that runs slow, as quartz may by 100 ppm, does not make it a
/// frame longer.
const EARLY: f64 = 2e-4;

/// Something that happens because time has passed and nothing else has happened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Deadline {
    /// Five frames at 50 Hz without a measurement.
    OwnDataStale,
    /// The simulator sends nothing any more.
    SimulatorLost,
    /// No agent needs that long for a step: after it all that it knows is worthless anyway.
    ClockJumped,
    /// A peer's state has become stale.
    StateOld,
    /// A peer has sent no state for `network.peer_stale_s`, this long.
    NeighbourSilent(f64),
    /// A peer has sent nothing for `network.peer_stale_s`, this long.
    PeerLost(f64),
    /// A lost peer has flown out of the way.
    ObstacleGone,
    /// A lost member flies the mission no longer, and a vehicle that was never in contact does not come. A vehicle that has lost
    /// all peers takes itself for the only one left then, and one with a single peer takes the two for all that are left.
    PeerGivenUp,
    /// After this vehicle's own agent was late, peers may be silent for twice as long until then.
    LeniencyOver,
    /// A round trip is too old to bound a delay, because clocks drift.
    RoundTripOld,
    /// The vehicle has listened to its peers before it takes part.
    Listened,
    /// A vehicle off its altitude has come no nearer with its collective at the limit; with collective left the controller is
    /// still on its way.
    AltitudeStuck,
    /// A hold has lasted for this long.
    HoldOver(f64),
    /// The vehicle was in place for this long without interruption.
    Dwelt(f64),
    /// The vehicle, asked to descend, has not sunk near the ground.
    TouchedDown,
    /// The collective is out.
    Unloaded,
    /// The agreement state is sent again, changed or not.
    HeartbeatDue,
    /// The state is sent again, needed or not; the longest period, this long.
    StateDue(f64),
}

impl Deadline {
    /// How long it takes, s.
    pub const fn after_s(self) -> f64 {
        match self {
            Self::OwnDataStale => 0.1,
            Self::SimulatorLost => 2.0,
            Self::ClockJumped => 10.0,
            Self::StateOld => 0.5,
            Self::NeighbourSilent(stale_s) | Self::PeerLost(stale_s) => stale_s,
            Self::ObstacleGone => 10.0,
            Self::PeerGivenUp => 60.0,
            Self::LeniencyOver => 10.0,
            Self::RoundTripOld => 60.0,
            Self::Listened => 2.0,
            Self::AltitudeStuck => 20.0,
            Self::HoldOver(hold_s) => hold_s,
            Self::Dwelt(dwell_s) => dwell_s,
            Self::TouchedDown => 1.0,
            Self::Unloaded => 2.0,
            Self::HeartbeatDue => HEARTBEAT_PERIOD_S * (1.0 - EARLY),
            Self::StateDue(period_s) => period_s * (1.0 - EARLY),
        }
    }

    /// Whether it has passed, so long after it began, s. What has to last for a time has lasted at that very instant; what may be
    /// so old may still be so at that instant.
    pub fn is_past(self, since_s: f64) -> bool {
        match self {
            Self::PeerGivenUp
            | Self::Listened
            | Self::HoldOver(_)
            | Self::Dwelt(_)
            | Self::HeartbeatDue
            | Self::StateDue(_) => since_s >= self.after_s(),
            Self::OwnDataStale
            | Self::SimulatorLost
            | Self::ClockJumped
            | Self::StateOld
            | Self::NeighbourSilent(_)
            | Self::PeerLost(_)
            | Self::ObstacleGone
            | Self::LeniencyOver
            | Self::RoundTripOld
            | Self::AltitudeStuck
            | Self::TouchedDown
            | Self::Unloaded => since_s > self.after_s(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_instant_itself_ends_what_has_to_last_and_not_what_may_be_so_old() {
        assert!(
            Deadline::Listened.is_past(2.0) && Deadline::Dwelt(3.0).is_past(3.0) && Deadline::PeerGivenUp.is_past(60.0)
        );
        assert!(!Deadline::OwnDataStale.is_past(0.1) && Deadline::OwnDataStale.is_past(0.101));
        assert!(!Deadline::PeerLost(2.0).is_past(2.0) && Deadline::PeerLost(2.0).is_past(2.001));
    }

    #[test]
    fn a_period_of_messages_ends_before_a_slow_clock_makes_it_a_frame_longer() {
        assert!(Deadline::HeartbeatDue.is_past(0.2 - 0.2 * 1e-4) && !Deadline::HeartbeatDue.is_past(0.18));
        assert!(Deadline::StateDue(1.0).is_past(1.0 - 1e-4) && !Deadline::StateDue(1.0).is_past(0.98));
    }
}
