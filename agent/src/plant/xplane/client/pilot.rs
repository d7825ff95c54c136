//! X-Plane's reports of its human pilot: the positions of the controls, and of the pilot's own stick.

use std::time::Instant;

use super::session::{Reading, Readings};
use skein_core::plant::Controls;

/// The axes of the stick.
const STICK: [Reading; 3] = [Reading::StickRoll, Reading::StickPitch, Reading::StickYaw];

/// Whether the pilot flies, and when.
#[derive(Debug, Default)]
pub(super) struct Pilot {
    /// Deflection beyond which the pilot takes the controls, 0 to 1; `None` if the pilot never does.
    pub(super) takes_at: Option<f32>,
    /// Whether the pilot has ever had the controls: before, the agent knows them.
    has_flown: bool,
}

impl Pilot {
    /// Notes that the pilot has the controls; returns whether it is for the first time.
    pub(super) fn flies(&mut self) -> bool {
        !std::mem::replace(&mut self.has_flown, true)
    }

    /// Whether X-Plane has to be asked for this value: for one of the pilot's only if it is used, for any other always.
    pub(super) fn needs(&self, value: Reading) -> bool {
        match value {
            Reading::StickRoll | Reading::StickPitch | Reading::StickYaw => self.takes_at.is_some(),
            Reading::Pitch | Reading::Yaw | Reading::Collective => self.has_flown,
            _ => true,
        }
    }

    /// Whether the stick is moved beyond the deflection at which the pilot takes the controls.
    pub(super) fn takes_over(&self, readings: &Readings, now: Instant) -> bool {
        let mut stick = STICK.iter().filter_map(|axis| readings.fresh(*axis, now));
        self.takes_at.is_some_and(|takes_at| stick.any(|value| value.abs() > takes_at))
    }
}

/// The controls; `None` if one has not arrived lately or is outside its travel.
pub(super) fn controls(readings: &Readings, now: Instant) -> Option<Controls> {
    let value = |reading| readings.fresh(reading, now).map(f64::from);
    let controls = Controls {
        roll: value(Reading::Roll)?,
        pitch: value(Reading::Pitch)?,
        yaw: value(Reading::Yaw)?,
        collective: value(Reading::Collective)?,
    };
    controls.is_within_limits().then_some(controls)
}
