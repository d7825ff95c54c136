//! The failures of a built-in vehicle, and when a scenario injects them.

use alloc::vec::Vec;

use skein_common::id::VehicleId;
use skein_common::scenario::{EventAction, Fault, ScriptedEvent, Servo};

use super::dynamics::Dynamics;

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

/// The failures of one vehicle over time. The script has no clock: the caller passes the time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Script(Vec<Entry>);

#[derive(Clone, Copy, Debug, PartialEq)]
struct Entry {
    from_s: f64,
    /// End of the failure, s; infinite if it is permanent.
    until_s: f64,
    what: Failure,
}

/// A scenario's fault that acts on the plant.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Failure {
    EngineOut,
    GyroOff,
    Stuck(Servo),
    PositionFrozen,
    SimulatorFrozen,
}

/// The plant faults active at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ActiveFaults {
    /// Failures of the vehicle.
    pub failures: Failures,
    /// The simulator sends no frames and its time is stopped.
    pub simulator_frozen: bool,
}

impl Script {
    /// The events that affect this vehicle's plant; all other events are ignored.
    pub fn of(events: &[ScriptedEvent], vehicle: VehicleId) -> Self {
        let entry = |event: &ScriptedEvent| {
            let EventAction::Fault(fault) = &event.what else { return None };
            let what = Failure::of(fault, vehicle)?;
            let until_s = event.for_s.map_or(f64::INFINITY, |for_s| event.at_s + for_s);
            Some(Entry { from_s: event.at_s, until_s, what })
        };
        Self(events.iter().filter_map(entry).collect())
    }

    /// The faults active this long after the vehicle's take-off. Overlapping faults combine.
    pub fn at(&self, since_take_off_s: f64) -> ActiveFaults {
        let mut now = ActiveFaults::default();
        for entry in self.0.iter().filter(|entry| (entry.from_s..entry.until_s).contains(&since_take_off_s)) {
            let failures = &mut now.failures;
            match entry.what {
                Failure::EngineOut => failures.engine_out = true,
                Failure::GyroOff => failures.gyro_off = true,
                Failure::Stuck(Servo::Roll) => failures.stuck[0] = true,
                Failure::Stuck(Servo::Pitch) => failures.stuck[1] = true,
                Failure::Stuck(Servo::Collective) => failures.stuck[2] = true,
                Failure::PositionFrozen => failures.position_frozen = true,
                Failure::SimulatorFrozen => now.simulator_frozen = true,
            }
        }
        now
    }
}

impl Failure {
    fn of(fault: &Fault, own: VehicleId) -> Option<Self> {
        let (vehicle, what) = match *fault {
            Fault::EngineOut { vehicle } => (vehicle, Self::EngineOut),
            Fault::GyroOff { vehicle } => (vehicle, Self::GyroOff),
            Fault::ServoStuck { vehicle, servo } => (vehicle, Self::Stuck(servo)),
            Fault::GpsFrozen { vehicle } => (vehicle, Self::PositionFrozen),
            Fault::SimulatorFreeze { vehicle } => (vehicle, Self::SimulatorFrozen),
            Fault::Kill { .. }
            | Fault::KillControl
            | Fault::Isolate { .. }
            | Fault::Cut { .. }
            | Fault::Delay { .. }
            | Fault::ClockJump { .. } => return None,
        };
        (vehicle == own).then_some(what)
    }
}

#[cfg(test)]
mod tests;
