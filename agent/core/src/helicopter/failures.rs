//! What may fail of a built-in vehicle, and when.

use alloc::vec::Vec;

use skein_common::id::VehicleId;
use skein_common::scenario::{Event, EventAction, Fault, Servo};

use super::dynamics::Dynamics;

/// What has failed of a vehicle; by default nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Failures {
    /// The engine gives no power: the rotor turns on by itself and slows down.
    pub engine_out: bool,
    /// The yaw gyro holds the tail rotor's pitch where its integral stood: pedals and yaw rate do nothing to it.
    pub gyro_off: bool,
    /// Servos that keep the blade pitch they had: roll, pitch, collective.
    pub stuck: [bool; 3],
    /// The measured position repeats. Height above the ground and velocity are measured by something else and go on.
    pub position_frozen: bool,
}

impl Failures {
    /// A failure is another machine: one without power, without gains of its gyro, or with servos that take for ever.
    pub(super) fn applied_to(&self, sound: &Dynamics) -> Dynamics {
        let mut dynamics = sound.clone();
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

/// What fails of one vehicle, and when. It has no clock: whoever asks counts the time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Script(Vec<Entry>);

#[derive(Clone, Copy, Debug, PartialEq)]
struct Entry {
    from_s: f64,
    /// Infinite if it is for good.
    until_s: f64,
    what: Failure,
}

/// What a plant can do of the faults that a scenario knows.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Failure {
    EngineOut,
    GyroOff,
    Stuck(Servo),
    PositionFrozen,
    SimulatorFrozen,
}

/// How a script stands at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Now {
    /// Of the vehicle.
    pub failures: Failures,
    /// No frame comes, and the vehicle's time stands still.
    pub simulator_frozen: bool,
}

impl Script {
    /// What the events do to this vehicle's plant; the others are not for a plant.
    pub fn of(events: &[Event], vehicle: VehicleId) -> Self {
        let entry = |event: &Event| {
            let EventAction::Fault(fault) = &event.what else { return None };
            let what = Failure::of(fault, vehicle)?;
            let until_s = event.for_s.map_or(f64::INFINITY, |for_s| event.at_s + for_s);
            Some(Entry { from_s: event.at_s, until_s, what })
        };
        Self(events.iter().filter_map(entry).collect())
    }

    /// How it stands so long after the vehicle's take-off. What overlaps adds up.
    pub fn at(&self, since_take_off_s: f64) -> Now {
        let mut now = Now::default();
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
            | Fault::Cut { .. }
            | Fault::Delay { .. }
            | Fault::ClockJump { .. } => return None,
        };
        (vehicle == own).then_some(what)
    }
}

#[cfg(test)]
mod tests;
