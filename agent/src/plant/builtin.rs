//! The built-in helicopter in real time: an agent's plant when no simulator is there.

use std::time::{Duration, Instant};

use super::helicopter::{BuiltInVehicle, TICK_S};
use super::{Plant, Sticks, Wake};
use crate::clock::{now, sleep_until};

/// A helicopter that moves one tick of 20 ms at each deadline of a fixed grid.
///
/// A tick that is late is made up at once if the next one is not due yet. Beyond that it is left out and counted, never
/// made up in a burst: simulated time then falls behind, as a simulator's does on a slow computer, and every frame's plant
/// time stays what the helicopter has really flown.
pub struct BuiltIn {
    vehicle: BuiltInVehicle,
    sticks: Option<Sticks>,
    due: Option<Instant>,
    skipped: u64,
}

const TICK: Duration = Duration::from_nanos((TICK_S * 1e9) as u64);

impl BuiltIn {
    /// Time begins with the first [`Plant::wait`].
    pub fn new(vehicle: BuiltInVehicle) -> Self {
        Self { vehicle, sticks: None, due: None, skipped: 0 }
    }
}

impl Plant for BuiltIn {
    fn wait(&mut self, deadline: Instant) -> Wake {
        let due = *self.due.get_or_insert_with(|| now() + TICK);
        sleep_until(due.min(deadline));
        if deadline < due {
            return Wake::Deadline;
        }
        self.vehicle.advance(self.sticks);
        let (next, skipped) = next_due(due, now());
        self.due = Some(next);
        self.skipped += skipped;
        Wake::Frame(self.vehicle.frame())
    }

    fn command(&mut self, sticks: Sticks) {
        self.sticks = Some(sticks);
    }

    fn release(&mut self) {
        self.sticks = None;
    }

    fn frame_period_s(&self) -> f64 {
        TICK_S
    }

    fn skipped_frames(&self) -> u64 {
        self.skipped
    }

    fn malformed(&self) -> u64 {
        0
    }
}

/// The next deadline of the grid after the one that was due and is being served at `now`: at most one tick ago. And how
/// many were left out for it.
fn next_due(due: Instant, now: Instant) -> (Instant, u64) {
    let late_ticks = now.saturating_duration_since(due).as_nanos() / TICK.as_nanos();
    let skipped = u32::try_from(late_ticks.saturating_sub(1)).unwrap_or(u32::MAX - 1);
    (due + TICK * (skipped + 1), skipped.into())
}

#[cfg(test)]
mod tests {
    use skein_common::frame::{Geodetic, Origin};
    use skein_common::id::VehicleId;

    use super::*;
    use crate::aircraft::Aircraft;
    use crate::plant::helicopter::{Start, Weather};

    fn plant() -> BuiltIn {
        let parameters = Aircraft::shipped("xcell60").unwrap().unwrap().helicopter.unwrap();
        let origin = Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0));
        let id = VehicleId::new(1).unwrap();
        let (start, weather) = (Start::default(), Weather::default());
        BuiltIn::new(BuiltInVehicle::new(&origin, &parameters, &start, &weather, 1, id))
    }

    #[test]
    fn late_ticks_are_left_out_and_the_grid_stands() {
        let due = now();
        let ms = Duration::from_millis;
        for (late_ms, next_ms, skipped) in
            [(0, 20, 0), (19, 20, 0), (21, 20, 0), (39, 20, 0), (41, 40, 1), (205, 200, 9)]
        {
            assert_eq!(next_due(due, due + ms(late_ms)), (due + ms(next_ms), skipped), "{late_ms} ms late");
        }
    }

    #[test]
    fn frames_come_a_tick_apart_and_deadlines_are_kept() {
        let mut plant = plant();
        let begin = now();
        assert_eq!(plant.wait(begin + TICK / 4), Wake::Deadline);
        assert!(now() >= begin + TICK / 4);
        let mut times = Vec::new();
        while times.len() < 10 {
            if let Wake::Frame(frame) = plant.wait(now() + 2 * TICK) {
                times.push(frame.time);
            }
        }
        assert!(now() >= begin + 10 * TICK, "faster than time");
        for (tick, time) in (1..).zip(times) {
            assert_eq!(time.nanoseconds(), tick * TICK.as_nanos() as u64);
        }
    }
}
