//! The aircraft of a stand-in: the built-in helicopter, at frames that need not be multiples of the model's tick.

use std::collections::VecDeque;

use skein_common::frame::{Attitude, Origin, PositionNed, wrap_rad};
use skein_core::helicopter::{BuiltInVehicle, TICK_S};
use skein_core::plant::{Controls, Frame};

/// How far back a replay reaches, s.
const REPLAY_S: f64 = 10.0;
/// Share of a tick below which a rest is a rounding error.
const NEGLIGIBLE_TICKS: f64 = 1e-9;

/// The helicopter, what is left to simulate of the last frame, and the last ten seconds.
pub(super) struct Aircraft {
    pub(super) vehicle: BuiltInVehicle,
    /// Simulated time beyond the vehicle's last tick, in ticks, below one.
    rest: f64,
    past: VecDeque<Frame>,
    /// The frame of the past that a replay shows next.
    replayed: usize,
}

impl Aircraft {
    pub(super) fn new(vehicle: BuiltInVehicle) -> Self {
        Self { vehicle, rest: 0.0, past: VecDeque::new(), replayed: 0 }
    }

    /// Advances by the simulated time, s, in whole ticks of the model; the rest is kept for the next frame.
    pub(super) fn advance(&mut self, controls: Option<Controls>, simulated_s: f64) {
        let ticks = self.rest + simulated_s / TICK_S;
        let whole = (ticks + NEGLIGIBLE_TICKS).floor();
        self.rest = (ticks - whole).max(0.0);
        for _ in 0..whole as u32 {
            self.vehicle.advance(controls);
        }
        self.replayed = 0;
        let newest = self.frame();
        self.past.push_back(newest);
        while self.past.front().is_some_and(|oldest| oldest.time.seconds() < newest.time.seconds() - REPLAY_S) {
            self.past.pop_front();
        }
    }

    /// The state now. Between two ticks the helicopter moves and turns at its last rates: X-Plane simulates every frame,
    /// so that a repeated state would be a fault that no client of X-Plane sees.
    pub(super) fn frame(&self) -> Frame {
        let frame = self.vehicle.frame();
        let beyond_s = self.rest * TICK_S;
        if self.rest < NEGLIGIBLE_TICKS {
            return frame;
        }
        let mut measurement = frame.measurement;
        let (velocity, rates) = (measurement.velocity, measurement.rates);
        let moved = PositionNed(velocity.0 * beyond_s);
        measurement.position = Origin::new(measurement.position).geodetic_from_ned(moved);
        measurement.height_m -= moved.down_m();
        let Attitude { roll_rad, pitch_rad, heading_rad } = measurement.attitude;
        measurement.attitude = Attitude {
            roll_rad: wrap_rad(roll_rad + rates.roll_rad_s * beyond_s),
            pitch_rad: pitch_rad + rates.pitch_rad_s * beyond_s,
            heading_rad: wrap_rad(heading_rad + rates.yaw_rad_s * beyond_s),
        };
        Frame { time: frame.time.plus_seconds(beyond_s), measurement, ..frame }
    }

    /// The next frame of a replay of the last ten seconds, from the oldest one on and again.
    pub(super) fn replay(&mut self) -> Frame {
        let shown = self.past.get(self.replayed).copied().unwrap_or_else(|| self.frame());
        self.replayed = if self.replayed + 1 < self.past.len() { self.replayed + 1 } else { 0 };
        shown
    }
}
