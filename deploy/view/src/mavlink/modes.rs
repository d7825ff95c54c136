//! The flight modes that ground stations show, in the numbers of PX4: QGroundControl and MAVSDK know those.

use mavlink::dialects::common::{MavLandedState, MavModeFlag, MavState};
use skein_common::message::{Failure, VehicleFacts};
use skein_common::state::Activity;

/// Main mode of a vehicle that a pilot flies.
const MANUAL: u32 = 1;
/// Main mode of a vehicle that flies itself; the sub-mode says what it does.
const AUTO: u32 = 4;

/// A flight mode of PX4, with its sub-mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mode {
    Manual = 0,
    Ready = 1,
    Takeoff = 2,
    Hold = 3,
    Mission = 4,
    Return = 5,
    Land = 6,
}

impl Mode {
    const ALL: [Self; 7] =
        [Self::Manual, Self::Ready, Self::Takeoff, Self::Hold, Self::Mission, Self::Return, Self::Land];

    /// The mode that shows this activity.
    pub(super) fn of(activity: Activity) -> Self {
        match activity {
            Activity::Joining | Activity::Blind => Self::Ready,
            Activity::TakingOff => Self::Takeoff,
            Activity::Formation => Self::Mission,
            Activity::Holding => Self::Hold,
            Activity::Landing | Activity::Landed => Self::Land,
            Activity::Released => Self::Manual,
        }
    }

    /// The mode with these numbers, if it is one of these.
    pub(super) fn from_numbers(main: u32, sub: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|mode| mode.numbers() == (main, sub))
    }

    /// Main mode and sub-mode in a field `custom_mode`.
    pub(super) fn split(custom_mode: u32) -> (u32, u32) {
        (custom_mode >> 16 & 0xff, custom_mode >> 24)
    }

    /// The field `custom_mode`.
    pub(super) fn custom(self) -> u32 {
        let (main, sub) = self.numbers();
        main << 16 | sub << 24
    }

    fn numbers(self) -> (u32, u32) {
        (if self == Self::Manual { MANUAL } else { AUTO }, self as u32)
    }
}

/// Whether the rotor is driven by the agent or a pilot, as far as the agent knows.
pub(super) fn is_armed(activity: Activity) -> bool {
    !matches!(activity, Activity::Joining | Activity::Landed)
}

/// The flags of the mode.
pub(super) fn flags(activity: Activity) -> MavModeFlag {
    let flown_by = match Mode::of(activity) {
        Mode::Manual => MavModeFlag::MAV_MODE_FLAG_MANUAL_INPUT_ENABLED,
        _ => {
            MavModeFlag::MAV_MODE_FLAG_STABILIZE_ENABLED
                | MavModeFlag::MAV_MODE_FLAG_GUIDED_ENABLED
                | MavModeFlag::MAV_MODE_FLAG_AUTO_ENABLED
        }
    };
    let armed = if is_armed(activity) { MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED } else { MavModeFlag::empty() };
    MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | flown_by | armed
}

/// The state of the vehicle as MAVLink names it.
pub(super) fn state(sample: &VehicleFacts) -> MavState {
    if sample.failures.contains(&Failure::Engine) {
        MavState::MAV_STATE_EMERGENCY
    } else if !sample.failures.is_empty() || sample.activity == Activity::Blind {
        MavState::MAV_STATE_CRITICAL
    } else if is_armed(sample.activity) {
        MavState::MAV_STATE_ACTIVE
    } else {
        MavState::MAV_STATE_STANDBY
    }
}

/// Whether it is on the ground; an agent that is joining, or has no data, does not know.
pub(super) fn landed(activity: Activity) -> MavLandedState {
    match activity {
        Activity::Joining | Activity::Blind => MavLandedState::MAV_LANDED_STATE_UNDEFINED,
        Activity::TakingOff => MavLandedState::MAV_LANDED_STATE_TAKEOFF,
        Activity::Formation | Activity::Holding | Activity::Released => MavLandedState::MAV_LANDED_STATE_IN_AIR,
        Activity::Landing => MavLandedState::MAV_LANDED_STATE_LANDING,
        Activity::Landed => MavLandedState::MAV_LANDED_STATE_ON_GROUND,
    }
}
