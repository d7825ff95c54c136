//! The failures of a built-in vehicle, and when a scenario injects them.

use alloc::vec::Vec;
use core::ops::Range;

use skein_common::id::VehicleId;
use skein_common::scenario::{EventAction, Fault, ScriptedEvent};

use super::dynamics::Dynamics;
use crate::impairments::lasting;

/// The failures present in a vehicle; by default none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Failures {
    /// The engine gives no power: the rotor spins down.
    pub engine_out: bool,
    /// The yaw gyro is off and the tail rotor's pitch stays at the gyro's integral: pedals and yaw rate have no effect.
    pub gyro_off: bool,
    /// Servos stuck at their current blade pitch: roll, pitch, collective.
    pub stuck: [bool; 3],
    /// The measured position is frozen. Height above the ground and velocity have other sensors and stay live.
    pub position_frozen: bool,
}

impl Failures {
    /// The dynamics with these failures: without engine power, with zero gyro gains, or with infinitely slow servos.
    pub(super) fn applied_to(&self, healthy: &Dynamics) -> Dynamics {
        let mut dynamics = healthy.clone();
        if self.engine_out {
            dynamics.drive.stop();
        }
        if self.gyro_off {
            dynamics.tail.hold_pitch();
        }
        for (rate, stuck) in dynamics.inverse_servo_lags.iter_mut().zip(self.stuck) {
            *rate *= f64::from(u8::from(!stuck));
        }
        dynamics
    }
}

/// The faults of one vehicle over time, each with its begin and its end. The script has no clock: the caller passes the time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Script(Vec<(Range<f64>, Fault)>);

/// The plant faults active at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ActiveFaults {
    /// Failures of the vehicle.
    pub failures: Failures,
    /// The simulator sends no frames and its time is stopped.
    pub simulator_frozen: bool,
}

impl Script {
    /// The faults of this vehicle among these events.
    pub fn of(events: &[ScriptedEvent], vehicle: VehicleId) -> Self {
        let entry = |event: &ScriptedEvent| match &event.what {
            EventAction::Fault(fault) if fault.vehicle() == Some(vehicle) => Some((lasting(event), fault.clone())),
            _ => None,
        };
        Self(events.iter().filter_map(entry).collect())
    }

    /// The faults of the plant that are active this long after the vehicle's take-off. Overlapping faults combine.
    pub fn at(&self, since_take_off_s: f64) -> ActiveFaults {
        let mut now = ActiveFaults::default();
        let failures = &mut now.failures;
        for (_, fault) in self.0.iter().filter(|(lasts, _)| lasts.contains(&since_take_off_s)) {
            match fault {
                Fault::EngineOut { .. } => failures.engine_out = true,
                Fault::GyroOff { .. } => failures.gyro_off = true,
                Fault::ServoStuck { servo, .. } => failures.stuck[*servo as usize] = true,
                Fault::GpsFrozen { .. } => failures.position_frozen = true,
                Fault::SimulatorFreeze { .. } => now.simulator_frozen = true,
                // These do not act on the plant.
                Fault::Kill { .. }
                | Fault::Cut { .. }
                | Fault::Delay { .. }
                | Fault::ClockJump { .. }
                | Fault::KillControl
                | Fault::Isolate { .. } => {}
            }
        }
        now
    }
}

#[cfg(test)]
mod tests;
