//! X-Plane's reports of its human pilot: the positions of the controls, and of the pilot's own stick.

use std::time::Instant;

use super::STALE;
use super::session::Reading;
use skein_core::plant::Controls;

/// The axes of the stick, and all controls.
const STICK: [Reading; 3] = [Reading::StickRoll, Reading::StickPitch, Reading::StickYaw];
const CONTROLS: [Reading; 4] = [Reading::Roll, Reading::Pitch, Reading::Yaw, Reading::Collective];

/// The newest positions.
#[derive(Debug, Default)]
pub(super) struct Pilot {
    controls: [Option<(Instant, f32)>; CONTROLS.len()],
    stick: [Option<(Instant, f32)>; STICK.len()],
    /// Deflection beyond which the pilot takes the controls, 0 to 1; `None` if the pilot never does.
    takes_at: Option<f32>,
    /// Whether the pilot has ever had the controls: before, the agent knows them.
    has_flown: bool,
}

impl Pilot {
    /// From now on the pilot takes the controls beyond this deflection, 0 to 1.
    pub(super) fn take_at(&mut self, deflection: f32) {
        self.takes_at = Some(deflection);
    }

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

    /// Takes a value that X-Plane has sent; another than the pilot's changes nothing.
    pub(super) fn read(&mut self, part: Reading, value: f32, now: Instant) {
        let controls = CONTROLS.iter().zip(&mut self.controls);
        let kept = controls.chain(STICK.iter().zip(&mut self.stick)).find(|(known, _)| **known == part);
        kept.into_iter().for_each(|(_, kept)| *kept = Some((now, value)));
    }

    /// The controls; `None` if one has not arrived lately or is outside its travel.
    pub(super) fn controls(&self, now: Instant) -> Option<Controls> {
        let is_new = |at: Instant| now.saturating_duration_since(at) < STALE;
        let value = |nth: usize| self.controls[nth].filter(|(at, _)| is_new(*at)).map(|(_, value)| f64::from(value));
        let controls = Controls { roll: value(0)?, pitch: value(1)?, yaw: value(2)?, collective: value(3)? };
        controls.is_within_limits().then_some(controls)
    }

    /// Whether the stick is moved beyond the deflection at which the pilot takes the controls.
    pub(super) fn takes_over(&self, now: Instant) -> bool {
        let is_new = |at: Instant| now.saturating_duration_since(at) < STALE;
        let is_beyond =
            |takes_at: f32| self.stick.iter().flatten().any(|(at, value)| is_new(*at) && value.abs() > takes_at);
        self.takes_at.is_some_and(is_beyond)
    }
}
