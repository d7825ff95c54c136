//! The severity of each event: one decision for logs, recordings, reports, pages, terminals and ground stations.

use serde::{Deserialize, Serialize};

use super::EventKind;

/// Frames a second with which a vehicle flies as well as it can.
const FULL_FRAME_RATE_HZ: u32 = 50;

/// Severity of an event, from the mildest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// The flight goes as it should.
    #[default]
    Info,
    /// Something is not as it should be, and the vehicle flies its mission all the same.
    Warning,
    /// The vehicle, its agent or its network has failed: the vehicle does not fly its mission as it should.
    Error,
}

impl EventKind {
    /// The severity of this event for the vehicle to which it happens.
    pub fn severity(&self) -> Severity {
        match self {
            Self::BecameActive
            | Self::PeerFound(_)
            | Self::OrderTaken(_)
            | Self::Reached(_)
            | Self::Advanced(_)
            | Self::QuorumBack
            | Self::AtAltitude
            | Self::Landed
            | Self::OwnDataBack
            | Self::LawBack
            | Self::ControlsReleased
            | Self::ControlsTakenBack => Severity::Info,
            Self::PeerLost(_)
            | Self::PlanDiffers(_)
            | Self::ForcedAdvance { .. }
            | Self::Skipped { .. }
            | Self::SimulatorStopped(_)
            | Self::SettingRefused(_)
            | Self::LandingWaits
            | Self::LawAnswerRefused(_) => Severity::Warning,
            Self::FrameRate(rate_hz) if *rate_hz >= FULL_FRAME_RATE_HZ => Severity::Info,
            Self::FrameRate(_) => Severity::Warning,
            Self::SimulatorFault(fault) if fault.is_wanted() => Severity::Info,
            Self::SimulatorFault(_) => Severity::Warning,
            Self::Failed(_)
            | Self::AllPeersLost
            | Self::QuorumLost
            | Self::OwnDataStale
            | Self::SimulatorLost
            | Self::ControlFault
            | Self::LawLost
            | Self::ClockJumped => Severity::Error,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Failure, SimulatorFault};
    use super::*;

    #[test]
    fn a_vehicle_that_is_alone_or_blind_is_an_error_and_a_change_for_the_better_is_not() {
        for error in [
            EventKind::AllPeersLost,
            EventKind::QuorumLost,
            EventKind::OwnDataStale,
            EventKind::SimulatorLost,
            EventKind::Failed(Failure::Position),
            EventKind::LawLost,
        ] {
            assert_eq!(error.severity(), Severity::Error, "{error}");
        }
        for good in [EventKind::QuorumBack, EventKind::OwnDataBack, EventKind::LawBack, EventKind::FrameRate(50)] {
            assert_eq!(good.severity(), Severity::Info, "{good}");
        }
        let few = EventKind::FrameRate(49);
        assert_eq!(few.severity(), Severity::Warning, "{few}");
        let [fault, wanted] = [SimulatorFault::RandomFailures, SimulatorFault::WantedRandomFailures];
        let severity = |fault| EventKind::SimulatorFault(fault).severity();
        assert_eq!((severity(fault), severity(wanted)), (Severity::Warning, Severity::Info));
        assert!(Severity::Info < Severity::Warning && Severity::Warning < Severity::Error);
    }
}
